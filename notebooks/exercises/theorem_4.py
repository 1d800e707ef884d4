"""Theorem 4: what moves where nothing was seen, and the error after boosts."""

import numpy as np

from . import Exercise


def moves(phi, seen, residual):
    """The weight is residual / φ(seen); Q moves by weight · φ."""
    return residual / phi[seen] * phi


def worst_error(error, alpha, gamma, epsilon):
    """(1 − α(1 − γ)) e + αε."""
    return (1 - alpha * (1 - gamma)) * error + alpha * epsilon


def boosts_needed(error, wanted, alpha, gamma):
    """The least n with (1 − α(1 − γ))ⁿ error ≤ wanted."""
    return int(np.ceil(np.log(wanted / error) / np.log(1 - alpha * (1 - gamma))))


EXERCISES = [
    Exercise(
        "moves",
        "One weight w with w · φ(seen) = residual; then Q moves by w · φ everywhere.",
        moves,
        {
            "The weight is residual / φ(seen), not the residual.": lambda phi, k, r: (
                r * phi
            ),
            "A linear learner does not move all pairs alike.": lambda phi, k, r: (
                np.full(len(phi), r)
            ),
            "It moves pairs that were not seen, too.": lambda phi, k, r: (
                r * (np.arange(len(phi)) == k)
            ),
            "Only one pair was seen: divide by φ(seen).": lambda phi, k, r: (
                r * phi[k] / (phi @ phi) * phi
            ),
            "Upside down: the weight is residual / φ(seen).": lambda phi, k, r: (
                phi[k] / r * phi
            ),
        },
        [
            (np.array([1.0, 1000.0]), 0, 1.0),
            (np.array([2.0, 3.0]), 0, 1.0),
            (np.array([2.0, 4.0, -1.0]), 1, 3.0),
        ],
    ),
    Exercise(
        "worst_error",
        "Three terms: (1 − α) e, then αγe, then αε.",
        worst_error,
        {
            "ε is multiplied by α as well: the whole fit is.": lambda e, a, g, eps: (
                (1 - a * (1 - g)) * e + eps
            ),
            "The targets' share αγe is missing.": lambda e, a, g, eps: (
                (1 - a) * e + a * eps
            ),
            "The old error's share (1 − α) e is missing.": lambda e, a, g, eps: (
                a * g * e + a * eps
            ),
            "The misses are missing.": lambda e, a, g, eps: (1 - a * (1 - g)) * e,
            "A worst case adds the misses.": lambda e, a, g, eps: (
                (1 - a * (1 - g)) * e - a * eps
            ),
        },
        [(1.0, 1.0, 0.9, 0.1), (2.0, 0.5, 0.9, 0.1), (10.0, 0.1, 0.99, 1.0)],
    ),
    Exercise(
        "boosts_needed",
        "Each boost keeps 1 − α(1 − γ) of the error; take logarithms, and round up.",
        boosts_needed,
        {
            "α is missing: a small step keeps more.": lambda e, to, a, g: boosts_needed(
                e, to, 1, g
            ),
            "Round up: one boost fewer is too few.": lambda e, to, a, g: (
                boosts_needed(e, to, a, g) - 1
            ),
            "A boost keeps 1 − α(1 − γ), not αγ.": lambda e, to, a, g: int(
                np.ceil(np.log(to / e) / np.log(a * g))
            ),
            "Each boost keeps a part of what is left.": lambda e, to, a, g: int(
                np.ceil((e - to) / (a * (1 - g) * e))
            ),
            "The number of boosts is a whole number.": lambda e, to, a, g: (
                np.log(to / e) / np.log(1 - a * (1 - g))
            ),
        },
        [(10.0, 1.0, 0.5, 0.5), (100.0, 1.0, 1.0, 0.99), (100.0, 1.0, 0.1, 0.99)],
    ),
]

"""Theorem 1: the fall of the squared residual, a shrunk step, a moving target."""

import numpy as np

from . import Exercise


def fall(residual, h):
    """A² / B, with A = Σ r h and B = Σ h²."""
    return (residual @ h) ** 2 / (h @ h)


def part(eta):
    """(2ηA²/B − η²A²/B) / (A²/B)."""
    return 2 * eta - eta**2


def own_residual(Q, h, alpha, r, gamma):
    """The target is r + γ max Q′, with the same Q′ that is subtracted."""
    after = Q + alpha * h
    return r + gamma * after.max() - after


def frozen(Q, h, alpha, r, gamma):
    """The target of the old Q."""
    return r + gamma * Q.max() - (Q + alpha * h)


def unscaled(Q, h, alpha, r, gamma):
    """α left out."""
    return own_residual(Q, h, 1, r, gamma)


def each_door(Q, h, alpha, r, gamma):
    """No maximum over the doors."""
    return r + (gamma - 1) * (Q + alpha * h)


def undiscounted(Q, h, alpha, r, gamma):
    """γ left out."""
    return own_residual(Q, h, alpha, r, 1)


def turned(Q, h, alpha, r, gamma):
    """Q′ − 𝒯Q′."""
    return -own_residual(Q, h, alpha, r, gamma)


EXERCISES = [
    Exercise(
        "fall",
        "Put α = A/B into L(0) − L(α) = 2αA − α²B.",
        fall,
        {
            "That is α itself, the step; its fall is A times as large.": lambda r, h: (
                (r @ h) / (h @ h)
            ),
            "That is the squared step: square A, but not B.": lambda residual, h: (
                ((residual @ h) / (h @ h)) ** 2
            ),
            "A² is there, B is missing.": lambda residual, h: (residual @ h) ** 2,
            "That is what is left of the sum of squares, not its fall.": lambda r, h: (
                r @ r - fall(r, h)
            ),
            "That is the fall for a step of 1; use the α of Eq. 8.": lambda r, h: (
                2 * r @ h - h @ h
            ),
        },
        [
            (np.array([2.0]), np.array([1.0])),
            (np.array([2.0, -1.0]), np.array([1.0, 1.0])),
            (np.array([1.0, 0.0, 3.0]), np.array([2.0, 5.0, -1.0])),
        ],
    ),
    Exercise(
        "part",
        "L(0) − L(ηα) = 2ηαA − η²α²B, and α = A/B.",
        part,
        {
            "A parabola is not straight: the fall is not η times it.": lambda eta: eta,
            "That is only the quadratic term of the parabola.": lambda eta: eta**2,
            "The quadratic term is missing.": lambda eta: 2 * eta,
            "That is the part of the fall that is lost.": lambda eta: (1 - eta) ** 2,
            "Both terms are there, with the signs exchanged.": lambda eta: (
                eta**2 - 2 * eta
            ),
        },
        [(1.0,), (0.5,), (0.1,), (2.0,)],
    ),
    Exercise(
        "own_residual",
        "Compute Q′ first. It stands in the target and after the minus sign.",
        own_residual,
        {
            "Your target is frozen: it has the max of Q, not of Q′.": frozen,
            "α does not count: Q′ is Q + α h.": unscaled,
            "The best door counts in every target, not each for itself.": each_door,
            "γ is missing.": undiscounted,
            "The sign: a residual is target minus Q.": turned,
        },
        [
            (np.zeros(2), np.array([0.0, 1.0]), 1.0, np.array([0.0, 1.0]), 0.9),
            (np.zeros(2), np.array([0.0, 1.0]), 0.5, np.array([0.0, 1.0]), 0.9),
            (
                np.array([1.0, 2.0]),
                np.array([3.0, -1.0]),
                0.5,
                np.array([0.0, 1.0]),
                0.5,
            ),
        ],
    ),
]

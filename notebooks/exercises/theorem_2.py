"""Theorem 2: what boosts with given steps leave, and how far off Q may be."""

import numpy as np

from . import Exercise


def left_over(alphas, gamma):
    """g = γQ − Q, so each boost multiplies Q by 1 − α(1 − γ)."""
    Q = 1.0
    for alpha in alphas:
        Q += alpha * (gamma * Q - Q)
    return Q


def off_by(E, mu_min, gamma):
    """√(E / min μ) / (1 − γ)."""
    return np.sqrt(E / mu_min) / (1 - gamma)


EXERCISES = [
    Exercise(
        "left_over",
        "With r = 0 the residual is γQ − Q. Add α times that, once for each α.",
        left_over,
        {
            "The sign: target minus Q makes Q shrink.": lambda steps, g: np.prod(
                1 + steps * (1 - g)
            ),
            "The target moves with Q: the residual is (γ − 1)Q.": lambda steps, g: (
                np.prod(1 - steps)
            ),
            "1 − γ, not γ: the residual of Q = 1 is γ − 1.": lambda steps, g: np.prod(
                1 - steps * g
            ),
            "Each boost has a residual of its own; steps multiply.": lambda steps, g: (
                1 - (1 - g) * np.sum(steps)
            ),
            "That is one boost too few: all the steps count.": lambda steps, g: (
                left_over(steps[:-1], g)
            ),
        },
        [
            (np.array([1.0]), 0.9),
            (np.array([0.5]), 0.8),
            (np.array([1.0, 0.5]), 0.9),
            (np.array([0.3, 0.2, 0.1]), 0.5),
        ],
    ),
    Exercise(
        "off_by",
        "Solve the second inequality for the sup norm of g, and put it into the first.",
        off_by,
        {
            "The root is missing: E is a squared residual.": lambda E, mu, g: (
                E / mu / (1 - g)
            ),
            "The rarest pair counts: divide by min μ.": lambda E, mu, g: (
                np.sqrt(E) / (1 - g)
            ),
            "That is the bound on the residual, not on Q.": lambda E, mu, g: np.sqrt(
                E / mu
            ),
            "A rare pair makes the bound larger: divide by min μ.": lambda E, mu, g: (
                np.sqrt(E * mu) / (1 - g)
            ),
            "1 − γ stands outside the root.": lambda E, mu, g: np.sqrt(
                E / mu / (1 - g)
            ),
        },
        [(1.0, 1.0, 0.5), (4.0, 0.25, 0.9), (0.5, 0.1, 0.99)],
    ),
]

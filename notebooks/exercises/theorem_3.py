"""Theorem 3: how far the rule is from the ideal, and the share of recency."""

import numpy as np

from . import Exercise


def distance_to_ideal(p_td, p_time, mix):
    """Half of Σ |P − P*|, both of sum 1."""
    p, ideal = mix * p_td + (1 - mix) * p_time, p_td * p_time
    return np.abs(p / p.sum() - ideal / ideal.sum()).sum() / 2


def not_normalised(p_td, p_time, mix):
    """Priorities compared as they are."""
    return np.abs(mix * p_td + (1 - mix) * p_time - p_td * p_time).sum() / 2


def without_half(p_td, p_time, mix):
    """Σ |P − P*|."""
    return 2 * distance_to_ideal(p_td, p_time, mix)


def mixed_the_other_way(p_td, p_time, mix):
    """β on recency."""
    return distance_to_ideal(p_td, p_time, 1 - mix)


def without_absolute(p_td, p_time, mix):
    """Σ (P − P*), which is 0."""
    return 0.0


def largest(p_td, p_time, mix):
    """The largest |P − P*|."""
    p, ideal = mix * p_td + (1 - mix) * p_time, p_td * p_time
    return np.abs(p / p.sum() - ideal / ideal.sum()).max()


def share_of_recency(n, rate, mix):
    """(1 − β) Σ e^{−rate · age} of βN + (1 − β) Σ e^{−rate · age}."""
    recency = (1 - mix) * np.exp(-rate * np.arange(n)).sum()
    return recency / (mix * n + recency)


def unmixed(n, rate, mix):
    """β left out."""
    return share_of_recency(n, rate, 0.5)


def swapped(n, rate, mix):
    """β on recency."""
    return share_of_recency(n, rate, 1 - mix)


def of_td(n, rate, mix):
    """The other share."""
    return 1 - share_of_recency(n, rate, mix)


def as_ratio(n, rate, mix):
    """Recency over |δ|."""
    share = share_of_recency(n, rate, mix)
    return share / (1 - share)


def without_newest(n, rate, mix):
    """Ages from 1 on."""
    recency = (1 - mix) * np.exp(-rate * np.arange(1, n + 1)).sum()
    return recency / (mix * n + recency)


EXERCISES = [
    Exercise(
        "distance_to_ideal",
        "Divide both priorities by their sums first; then half of Σ |P − P*|.",
        distance_to_ideal,
        {
            "Priorities are not probabilities: divide by their sums.": not_normalised,
            "The half is missing: disjoint distributions are 1 apart.": without_half,
            "β belongs to |δ|, and 1 − β to recency.": mixed_the_other_way,
            "Without absolute values the differences cancel.": without_absolute,
            "That is the largest difference, not half of the sum.": largest,
        },
        [
            (np.array([2.0, 1.0]), np.array([1.0, 0.5]), 0.3),
            (np.array([1.0, 2.0, 4.0]), np.array([1.0, 0.5, 0.25]), 0.25),
            (np.array([4.0, 3.0, 1.0, 1.0]), np.array([1.0, 1.0, 0.5, 0.4]), 0.9),
        ],
    ),
    Exercise(
        "share_of_recency",
        "The ages are 0, 1, …, N − 1; each term is (1 − β) e^(−rate · age).",
        share_of_recency,
        {
            "β is missing: it weighs |δ|, and 1 − β recency.": unmixed,
            "β belongs to |δ|, and 1 − β to recency.": swapped,
            "That is the share of |δ|.": of_td,
            "That is recency over |δ|; a share is a part of the whole.": as_ratio,
            "The newest transition has age 0, not 1.": without_newest,
        },
        [(1, 0.1, 0.2), (3, 0.5, 0.75), (100, 0.01, 0.3)],
    ),
]

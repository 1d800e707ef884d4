"""Notebook 3: what an update changes elsewhere, and what is forgotten."""

import numpy as np

from . import Exercise


def elsewhere(x, x2, delta, rate):
    return rate * delta * (x * x2 + 1)


def forgotten(was_right, is_right):
    return int((was_right & ~is_right).sum())


YES, NO = True, False
EXERCISES = [
    Exercise(
        "elsewhere",
        "w grows by rate * delta * x, and b by rate * delta; put both into w x2 + b.",
        elsewhere,
        {
            "The constant b moves too: it adds rate * delta in every room.": (
                lambda x, x2, delta, rate: rate * delta * x * x2
            ),
            "The slope w moves too, by rate * delta * x.": (
                lambda x, x2, delta, rate: rate * delta
            ),
            "The sign is wrong: the step moves Q(x) towards y.": (
                lambda x, x2, delta, rate: -elsewhere(x, x2, delta, rate)
            ),
            "The gradient is taken at x2; the update happens at x.": (
                lambda x, x2, delta, rate: rate * delta * (x2 * x2 + 1)
            ),
            "That is the change at x itself; the question is about x2.": (
                lambda x, x2, delta, rate: rate * delta * (x * x + 1)
            ),
            "The rate is missing.": (
                lambda x, x2, delta, rate: elsewhere(x, x2, delta, 1)
            ),
        },
        [(1.0, 0.0, 2.0, 0.5), (1.0, 0.5, 2.0, 0.5), (0.5, -1.0, 4.0, 0.1)],
    ),
    Exercise(
        "forgotten",
        "a room counts if it was right and is not right now.",
        forgotten,
        {
            "Rooms that are newly right must not make up for lost ones.": (
                lambda was, now: int(was.sum()) - int(now.sum())
            ),
            "That is how many rooms are wrong now; some were wrong before.": (
                lambda was, now: int((~now).sum())
            ),
            "That is how many rooms are kept.": lambda was, now: int((was & now).sum()),
            "Rooms that are newly right count too; they are not forgotten.": (
                lambda was, now: int((was != now).sum())
            ),
            "That is a share; a number of rooms is asked for.": (
                lambda was, now: (was & ~now).mean()
            ),
        },
        [
            (np.array([YES, YES]), np.array([YES, NO])),
            (np.array([YES, YES, YES]), np.array([YES, YES, NO])),
            (np.array([YES, NO]), np.array([NO, YES])),
            (np.array([YES, NO, YES]), np.array([NO, NO, YES])),
            (np.array([YES, YES, YES, YES]), np.array([NO, NO, YES, NO])),
        ],
    ),
]

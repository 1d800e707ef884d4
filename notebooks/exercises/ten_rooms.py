"""Notebook 1: the return, the target and one update."""

import numpy as np

from . import Exercise, written


def discounted(rewards, gamma):
    total = 0
    for k, reward in enumerate(rewards):
        total += gamma**k * reward
    return total


def target(reward, terminated, q_next, gamma):
    if terminated:
        return reward
    return reward + gamma * max(q_next)


def update(Q, room, action, y, rate):
    delta = y - Q[room, action]
    Q[room, action] += rate * delta


def changed(attempt, Q, *rest):
    """Q as an attempt leaves it; None if nothing is written."""
    before = Q.copy()
    attempt(Q, *rest)
    if (before == Q).all():
        return "Q as it was" if written(attempt) else None
    return Q


def wrong_sign(Q, room, action, y, rate):
    Q[room, action] += rate * (Q[room, action] - y)


def all_the_way(Q, room, action, y, rate):
    Q[room, action] = y


def without_q(Q, room, action, y, rate):
    Q[room, action] += rate * y


def without_keeping(Q, room, action, y, rate):
    Q[room, action] = rate * (y - Q[room, action])


def both_actions(Q, room, action, y, rate):
    Q[room] += rate * (y - Q[room])


def in_a_copy(Q, room, action, y, rate):
    return Q + rate


def first_alone(rewards, gamma):
    for k, reward in enumerate(rewards):
        return gamma**k * reward


TWO_ROOMS = np.array([[0.0, -1.0], [-2.0, -3.0]])
EXERCISES = [
    Exercise(
        "discounted",
        "the k-th reward, counted from 0, is multiplied by gamma ** k.",
        discounted,
        {
            "Nothing is discounted.": lambda rewards, gamma: sum(rewards),
            "The first reward is discounted too; it counts in full.": (
                lambda rewards, gamma: gamma * discounted(rewards, gamma)
            ),
            "The factor is gamma * k; it should be gamma ** k.": (
                lambda rewards, gamma: sum(gamma * k * r for k, r in enumerate(rewards))
            ),
            "Every reward has the same factor gamma.": (
                lambda rewards, gamma: gamma * sum(rewards)
            ),
            "The order is reversed: the last reward counts in full.": (
                lambda rewards, gamma: discounted(rewards[::-1], gamma)
            ),
            "It returns inside the loop, after the first reward.": first_alone,
        },
        [([-1.0], 0.5), ([-1.0, -1.0], 0.5), ([1.0, 0.0, 4.0], 0.5), ([-1.0] * 3, 0.9)],
    ),
    Exercise(
        "target",
        "after a terminal state nothing comes, so only the reward is left.",
        target,
        {
            "At the end, y is the reward alone.": (
                lambda r, end, q, gamma: r + gamma * max(q)
            ),
            "At the end, y is the reward, not 0: the last step has its cost too.": (
                lambda r, end, q, gamma: 0 if end else r + gamma * max(q)
            ),
            "Gamma is missing.": lambda r, end, q, gamma: r + (0 if end else max(q)),
            "Gamma multiplies the reward too; the reward counts in full.": (
                lambda r, end, q, gamma: r if end else gamma * (r + max(q))
            ),
            "A discount of 0.9 is written in; use gamma.": (
                lambda r, end, q, gamma: r + (0 if end else 0.9 * max(q))
            ),
            "That is the mean over the next actions; the best one counts.": (
                lambda r, end, q, gamma: r + (0 if end else gamma * np.mean(q))
            ),
            "That is the index of the best action; its value is meant.": (
                lambda r, end, q, gamma: r + (0 if end else gamma * np.argmax(q))
            ),
            "That is the smallest value; the largest is meant.": (
                lambda r, end, q, gamma: r + (0 if end else gamma * min(q))
            ),
        },
        [
            (-1.0, False, np.array([-4.0, -2.0]), 0.5),
            (-1.0, False, np.array([-2.0, -4.0]), 0.9),
            (2.0, True, np.array([-4.0, -2.0]), 0.5),
        ],
    ),
    Exercise(
        "update",
        "delta is y minus the old value; add rate * delta to the old value.",
        update,
        {
            "The sign of delta is wrong: Q moves away from y.": wrong_sign,
            "Q jumps all the way to y; only the part `rate` is wanted.": all_the_way,
            "The old value is not subtracted from y.": without_q,
            "The old value is lost: delta must be added to it.": without_keeping,
            "The other action of the room moves too.": both_actions,
            "Q itself does not change: change Q[room, action] in place.": in_a_copy,
        },
        [
            (TWO_ROOMS, 0, 1, -2.0, 0.5),
            (TWO_ROOMS, 1, 0, -1.0, 0.5),
            (TWO_ROOMS, 1, 1, 1.0, 0.25),
        ],
        changed,
        in_place=True,
    ),
]

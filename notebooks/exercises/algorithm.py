"""Algorithm 1: the residual that a booster learns, and what perfect boosters do."""

import numpy as np

from . import Exercise


def residual_target(r, terminated, next_frozen, frozen, h_next, live, gamma):
    """y − Q_{m−1}(s, a), where y bootstraps with Q_m if live and not at the end."""
    q_next = next_frozen + h_next if live else next_frozen
    y = r + (0 if terminated else gamma * q_next.max())
    return y - frozen


def unmasked(r, terminated, next_frozen, frozen, h_next, live, gamma):
    """As printed: bootstraps at a terminal state, too."""
    return residual_target(r, False, next_frozen, frozen, h_next, live, gamma)


def always_frozen(r, terminated, next_frozen, frozen, h_next, live, gamma):
    """The switch left out."""
    return residual_target(r, terminated, next_frozen, frozen, h_next, False, gamma)


def always_live(r, terminated, next_frozen, frozen, h_next, live, gamma):
    """The switch stuck."""
    return residual_target(r, terminated, next_frozen, frozen, h_next, True, gamma)


def two_maxima(r, terminated, next_frozen, frozen, h_next, live, gamma):
    """max Q + max h, not max (Q + h)."""
    best = next_frozen.max() + (h_next.max() if live else 0)
    return r + (0 if terminated else gamma * best) - frozen


def turned_round(r, terminated, next_frozen, frozen, h_next, live, gamma):
    """Q − y."""
    return -residual_target(r, terminated, next_frozen, frozen, h_next, live, gamma)


def target_only(r, terminated, next_frozen, frozen, h_next, live, gamma):
    """y."""
    return residual_target(r, terminated, next_frozen, 0.0, h_next, live, gamma)


def perfect_boost(reading, Q, eta, backup, q_star):
    """The five rows of the table."""
    if reading == 1:
        return backup(Q)
    if reading == 2:
        return Q + eta * (backup(Q) - Q)
    if reading == 3:
        return q_star
    if reading == 5:
        return Q + eta * (q_star - Q)
    after = Q
    for _ in range(200):
        after = (1 - eta) * Q + eta * backup(after)
    return after


def shrunk_anyway(reading, Q, eta, backup, q_star):
    """η in row 1."""
    return perfect_boost(2 if reading == 1 else reading, Q, eta, backup, q_star)


def whole_anyway(reading, Q, eta, backup, q_star):
    """No η in row 2."""
    return perfect_boost(1 if reading == 2 else reading, Q, eta, backup, q_star)


def one_backup_live(reading, Q, eta, backup, q_star):
    """Row 3 as one backup."""
    return perfect_boost(1 if reading == 3 else reading, Q, eta, backup, q_star)


def frozen_fourth(reading, Q, eta, backup, q_star):
    """Row 4 with 𝒯Q in place of 𝒯Q′."""
    return perfect_boost(2 if reading == 4 else reading, Q, eta, backup, q_star)


def drifting_fourth(reading, Q, eta, backup, q_star):
    """Row 4 with Q replaced at each repetition."""
    if reading != 4:
        return perfect_boost(reading, Q, eta, backup, q_star)
    for _ in range(200):
        Q = (1 - eta) * Q + eta * backup(Q)
    return Q


def example(r):
    """𝒯 of one room with one door at γ = ½."""
    return lambda Q: r + 0.5 * Q


def tell(attempt, reading, Q, eta, r):
    """Run a boost in one room with one door; its reward is r, γ = ½, and Q* = 2r."""
    return attempt(reading, np.array([[Q]]), eta, example(r), np.array([[2 * r]]))


def said(name, reading, Q, eta, r):
    """The case in words."""
    return f"In a room with 𝒯Q = {r:g} + Q/2, {name}({reading}, {Q:g}, {eta:g}, …)"


EXERCISES = [
    Exercise(
        "residual_target",
        "First Q(s′, ·): frozen, or frozen + αh. Then y, then y − Q_{m−1}(s, a).",
        residual_target,
        {
            "No mask: after a terminal state nothing comes, and y = r.": unmasked,
            "Frozen for live: if live, αh(s′, ·) belongs to the target.": always_frozen,
            "Live for frozen: if not live, h does not count.": always_live,
            "The maximum of the sum counts, not the sum of maxima.": two_maxima,
            "The sign: a residual is target minus Q.": turned_round,
            "That is the target; Q_{m−1}(s, a) is not yet subtracted.": target_only,
        },
        [
            (-1.0, False, np.array([-5.0, -4.0]), -6.0, np.zeros(2), False, 0.9),
            (-1.0, True, np.array([-5.0, -4.0]), -6.0, np.zeros(2), False, 0.9),
            (
                -1.0,
                False,
                np.array([-5.0, -4.0]),
                -6.0,
                np.array([3.0, 1.0]),
                True,
                0.9,
            ),
            (
                -1.0,
                False,
                np.array([-5.0, -4.0]),
                -6.0,
                np.array([3.0, 1.0]),
                False,
                0.9,
            ),
            (
                -2.0,
                True,
                np.array([-5.0, -4.0]),
                -6.0,
                np.array([3.0, 1.0]),
                True,
                0.5,
            ),
        ],
    ),
    Exercise(
        "perfect_boost",
        "Rows 1, 2, 3 and 5 are one line each. Row 4 keeps Q and repeats for Q′.",
        perfect_boost,
        {
            "Row 1 has no η: α = 1, or it cancels.": shrunk_anyway,
            "Row 2 moves by η of the backup's step, not by all of it.": whole_anyway,
            "Row 3: live, it goes on until Q*.": one_backup_live,
            "Row 4 is live: 𝒯 is applied to Q′, not to Q.": frozen_fourth,
            "Row 4: the Q beside 1 − η is the frozen one, it stays.": drifting_fourth,
        },
        [(reading, 4.0, 0.25, 1.0) for reading in (1, 2, 3, 4, 5)],
        tell,
        said,
    ),
]

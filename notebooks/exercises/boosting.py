"""The exercises of 04_boosting: residual, weighted fit, step size, folding in."""

import numpy as np

from . import Exercise


def residual(r, terminated, a, q_frozen, q_frozen_next, gamma):
    y = np.where(terminated, r, r + gamma * q_frozen_next.max(1))
    return y - q_frozen[np.arange(len(a)), a]


def residual_backwards(r, terminated, a, q_frozen, q_frozen_next, gamma):
    return -residual(r, terminated, a, q_frozen, q_frozen_next, gamma)


def residual_unmasked(r, terminated, a, q_frozen, q_frozen_next, gamma):
    return residual(r, np.zeros(len(r), bool), a, q_frozen, q_frozen_next, gamma)


def residual_undiscounted(r, terminated, a, q_frozen, q_frozen_next, gamma):
    return residual(r, terminated, a, q_frozen, q_frozen_next, 1.0)


def residual_is_y(r, terminated, a, q_frozen, q_frozen_next, gamma):
    return residual(r, terminated, a, 0 * q_frozen, q_frozen_next, gamma)


def residual_of_best(r, terminated, a, q_frozen, q_frozen_next, gamma):
    return residual(r, terminated, q_frozen.argmax(1), q_frozen, q_frozen_next, gamma)


def constant(r, w):
    return (w * r).sum() / w.sum()


def constant_of_w_r(r, w):
    return (w * r).mean()


def constant_of_root(r, w):
    return (np.sqrt(w) * r).mean()


def constant_without_weights(r, w):
    return r.mean()


def constant_not_normalised(r, w):
    return (w * r).sum()


def constant_weights_twice(r, w):
    return constant(w * r, w)


def step_size(r, h, w):
    return (w * r * h).sum() / (w * h * h).sum()


def step_size_plain(r, h, w):
    return step_size(r, h, np.ones(len(w)))


def step_size_upside_down(r, h, w):
    return 1 / step_size(r, h, w)


def step_size_weights_above(r, h, w):
    return (w * r * h).sum() / (h * h).sum()


def step_size_norm_of_r(r, h, w):
    return (w * r * h).sum() / (w * r * r).sum()


def step_size_positive(r, h, w):
    return abs(step_size(r, h, w))


def fold_in(q_frozen, a, h, alpha):
    return q_frozen + alpha * h[np.arange(len(a)), a]


def fold_in_whole(q_frozen, a, h, alpha):
    return fold_in(q_frozen, a, h, 1.0)


def fold_in_twice(q_frozen, a, h, alpha):
    return fold_in(q_frozen, a, h, alpha**2)


def fold_in_average(q_frozen, a, h, alpha):
    return (1 - alpha) * q_frozen + fold_in(0 * q_frozen, a, h, alpha)


def fold_in_replaces(q_frozen, a, h, alpha):
    return fold_in(0 * q_frozen, a, h, alpha)


def fold_in_best(q_frozen, a, h, alpha):
    return fold_in(q_frozen, h.argmax(1), h, alpha)


ROOM_8 = np.array([-1.0]), np.array([True]), np.array([1]), np.array([[-2.71, -1.5]])
THREE = (
    np.array([-1.0, -1.0, -1.0]),
    np.array([False, True, False]),
    np.array([1, 1, 0]),
    np.array([[-4.0, -3.0], [-1.9, -5.0], [-2.0, -6.0]]),
)
NEXT = np.array([[-2.0, -3.0], [-7.0, -8.0], [-6.0, -5.0]])

EXERCISES = [
    Exercise(
        "residual",
        "first the target y, with nothing after the end; then subtract what the frozen"
        " ensemble says of the action that was taken.",
        residual,
        {
            "The sign is turned: it is y − Q, what Q lacks.": residual_backwards,
            "After the end nothing comes: where terminated, y = r.": residual_unmasked,
            "The discount γ is missing in the target.": residual_undiscounted,
            "This is the target y; the frozen Q is not subtracted yet.": residual_is_y,
            "Subtract Q of the action taken, not of the best one.": residual_of_best,
        },
        [
            (*ROOM_8, np.array([[-9.0, -8.0]]), 0.9),
            (*THREE, NEXT, 0.9),
            (*THREE, NEXT, 0.5),
        ],
    ),
    Exercise(
        "constant",
        "set the derivative of Σ w (r − h)² with respect to h to zero.",
        constant,
        {
            "This fits w r: the weights moved into the residual.": constant_of_w_r,
            "This fits √w r: the root belongs on both terms, residual and learner.": (
                constant_of_root
            ),
            "The weights are not used.": constant_without_weights,
            "Divide by the sum of the weights.": constant_not_normalised,
            "The weights count twice.": constant_weights_twice,
        },
        [
            (np.array([2.0]), np.array([0.25])),
            (np.array([3.0, -1.0]), np.array([0.25, 1.0])),
            (np.array([1.0, -2.0, 0.5]), np.array([0.5, 2.0, 1.0])),
        ],
    ),
    Exercise(
        "step_size",
        "Σ w r² − 2αA + α²B is lowest at A/B; the weights are in both sums.",
        step_size,
        {
            "These are Eq. 8's sums, without the weights of the loss.": step_size_plain,
            "This is B/A: the fraction is upside down.": step_size_upside_down,
            "The weights are missing in the sum below.": step_size_weights_above,
            "The sum below the line has h² in it, not r².": step_size_norm_of_r,
            "α may be negative: a booster can point the wrong way.": step_size_positive,
        },
        [
            (np.array([1.0]), np.array([2.0]), np.array([0.5])),
            (np.array([3.0, -1.0]), np.array([-0.5, -0.2]), np.array([0.25, 1.0])),
            (
                np.array([1.0, -2.0, 0.5]),
                np.array([0.5, 0.5, 3.0]),
                np.array([1.0, 2.0, 0.1]),
            ),
        ],
    ),
    Exercise(
        "fold_in",
        "Eq. 9 for the stored action of each transition.",
        fold_in,
        {
            "α is missing.": fold_in_whole,
            "α counts twice.": fold_in_twice,
            "Eq. 9 adds to the ensemble; it does not average with it.": fold_in_average,
            "The frozen ensemble is gone: Eq. 9 adds to it.": fold_in_replaces,
            "Take h of the stored action, not of the best one.": fold_in_best,
        },
        [
            (np.array([-3.0]), np.array([1]), np.array([[2.0, -1.0]]), 0.5),
            (
                np.array([-3.0, 1.0]),
                np.array([0, 1]),
                np.array([[2.0, -1.0], [0.5, 0.25]]),
                0.1,
            ),
        ],
    ),
]

"""The exercises of 05_dqn: the target, the gradient of its loss, the target network."""

import numpy as np

from . import Exercise


def td_target(r, terminated, q_next, gamma):
    return np.where(terminated, r, r + gamma * q_next.max(1))


def td_target_printed(r, terminated, q_next, gamma):
    return r + gamma * q_next.max(1)


def td_target_drops_reward(r, terminated, q_next, gamma):
    return np.where(terminated, 0.0, r + gamma * q_next.max(1))


def td_target_mask_turned(r, terminated, q_next, gamma):
    return np.where(terminated, r + gamma * q_next.max(1), r)


def td_target_mean(r, terminated, q_next, gamma):
    return np.where(terminated, r, r + gamma * q_next.mean(1))


def td_target_discounts_reward(r, terminated, q_next, gamma):
    return np.where(terminated, gamma * r, gamma * (r + q_next.max(1)))


def td_gradient(error, weight, a, n_actions):
    gradient = np.zeros((len(a), n_actions))
    gradient[np.arange(len(a)), a] = -weight * error / len(a)
    return gradient


def td_gradient_uphill(error, weight, a, n_actions):
    return -td_gradient(error, weight, a, n_actions)


def td_gradient_of_sum(error, weight, a, n_actions):
    return len(a) * td_gradient(error, weight, a, n_actions)


def td_gradient_without_weights(error, weight, a, n_actions):
    return td_gradient(error, np.ones(len(a)), a, n_actions)


def td_gradient_doubled(error, weight, a, n_actions):
    return 2 * td_gradient(error, weight, a, n_actions)


def td_gradient_of_all(error, weight, a, n_actions):
    return np.tile((-weight * error / len(a))[:, None], n_actions)


def polyak(target, online, tau):
    return (1 - tau) * target + tau * online


def polyak_swapped(target, online, tau):
    return tau * target + (1 - tau) * online


def polyak_copy(target, online, tau):
    return 1.0 * online


def polyak_adds(target, online, tau):
    return target + tau * online


def polyak_away(target, online, tau):
    return target - tau * (online - target)


def polyak_shrinks(target, online, tau):
    return (1 - tau) * target


LAST = np.array([-1.0]), np.array([True]), np.array([[-50.0, -60.0]])
STEPS = (
    np.array([-1.0, -1.0, -2.0]),
    np.array([False, True, False]),
    np.array([[-5.0, -4.0], [-3.0, -2.0], [1.0, 4.0]]),
)

EXERCISES = [
    Exercise(
        "td_target",
        "np.where(terminated, …, …); the largest entry of each row is q_next.max(1).",
        td_target,
        {
            "As printed: after the end nothing comes, there y = r.": td_target_printed,
            "The last step has a reward, too.": td_target_drops_reward,
            "The mask is turned around.": td_target_mask_turned,
            "The best next action counts, not the mean of all.": td_target_mean,
            "The reward of this step is not discounted.": td_target_discounts_reward,
        },
        [(*LAST, 0.9), (*STEPS, 0.9), (*STEPS, 0.5)],
    ),
    Exercise(
        "td_gradient",
        "Q appears in the error with a minus; ½ cancels the 2; other actions have 0.",
        td_gradient,
        {
            "The sign is turned: the error falls as Q rises.": td_gradient_uphill,
            "This is the gradient of a sum; the loss is a mean.": td_gradient_of_sum,
            "The weights are not used.": td_gradient_without_weights,
            "The ½ of the loss cancels the 2 of the square.": td_gradient_doubled,
            "Only the action that was taken has a gradient.": td_gradient_of_all,
        },
        [
            (np.array([2.0]), np.array([0.5]), np.array([1]), 2),
            (np.array([2.0, -1.0]), np.array([0.5, 1.0]), np.array([1, 0]), 3),
        ],
    ),
    Exercise(
        "polyak",
        "with τ = 0 the target network stays, with τ = 1 it becomes the online one.",
        polyak,
        {
            "τ and 1 − τ are swapped.": polyak_swapped,
            "This copies the network at once, whatever τ is.": polyak_copy,
            "The old target network keeps only the share 1 − τ.": polyak_adds,
            "This moves away from the online network.": polyak_away,
            "The online network is missing.": polyak_shrinks,
        },
        [
            (np.array([2.0]), np.array([4.0]), 0.25),
            (np.array([1.0, -2.0]), np.array([0.0, 3.0]), 0.01),
        ],
    ),
]

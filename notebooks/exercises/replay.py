"""The exercises of 06_replay: age, priority, drawing an age, importance weights."""

import numpy as np

from . import Exercise


def age(slot, added, capacity):
    return (added - 1 - slot) % capacity


def age_off_by_one(slot, added, capacity):
    return (added - slot) % capacity


def age_without_ring(slot, added, capacity):
    return added - 1 - slot


def age_of_slot(slot, added, capacity):
    return slot


def age_backwards(slot, added, capacity):
    return (slot - added) % capacity


def age_of_full_ring(slot, added, capacity):
    return capacity - 1 - slot


def probabilities(p_td, p_time, mix):
    p = mix * p_td + (1 - mix) * p_time
    return p / p.sum()


def probabilities_swapped(p_td, p_time, mix):
    return probabilities(p_td, p_time, 1 - mix)


def probabilities_of_product(p_td, p_time, mix):
    return p_td * p_time / (p_td * p_time).sum()


def probabilities_of_shares(p_td, p_time, mix):
    return mix * p_td / p_td.sum() + (1 - mix) * p_time / p_time.sum()


def probabilities_not_normalised(p_td, p_time, mix):
    return mix * p_td + (1 - mix) * p_time


def probabilities_by_largest(p_td, p_time, mix):
    p = mix * p_td + (1 - mix) * p_time
    return p / p.max()


def age_at(u, rate, n):
    return np.floor(-np.log(1 - u * (1 - np.exp(-rate * n))) / rate)


def age_at_without_end(u, rate, n):
    return np.floor(-np.log(1 - u) / rate)


def age_at_not_whole(u, rate, n):
    return -np.log(1 - u * (1 - np.exp(-rate * n))) / rate


def age_at_rounded_up(u, rate, n):
    return age_at(u, rate, n) + 1


def age_at_oldest_first(u, rate, n):
    return n - 1 - age_at(u, rate, n)


def age_at_even(u, rate, n):
    return np.floor(u * n)


def weights(P, n, exponent):
    return (1 / (n * P)) ** exponent


def weights_upside_down(P, n, exponent):
    return (n * P) ** exponent


def weights_divided(P, n, exponent):
    return weights(P, n, exponent) / weights(P, n, exponent).max()


def weights_without_n(P, n, exponent):
    return (1 / P) ** exponent


def weights_n_outside(P, n, exponent):
    return (1 / P) ** exponent / n


def weights_of_batch(P, n, exponent):
    return (1 / (len(P) * P)) ** exponent


EXERCISES = [
    Exercise(
        "age",
        "the newest one is transition number added − 1; the ring has capacity slots.",
        age,
        {
            "The newest has age 0, not 1.": age_off_by_one,
            "The ring is missing: count modulo capacity.": age_without_ring,
            "This is the slot, not how long ago it was filled.": age_of_slot,
            "The direction is turned around.": age_backwards,
            "The newest is not always in the last slot.": age_of_full_ring,
        },
        [(3, 4, 5), (0, 4, 5), (1, 7, 5), (2, 7, 5), (0, 9, 3)],
    ),
    Exercise(
        "probabilities",
        "first p by Eq. 10, then divide it by its sum.",
        probabilities,
        {
            "β is the share of the error, not of recency.": probabilities_swapped,
            "Eq. 10 adds the two, it does not multiply them.": probabilities_of_product,
            "Divide once, at the end: β weighs priorities.": probabilities_of_shares,
            "They do not add up to 1.": probabilities_not_normalised,
            "Divide by the sum, not by the largest.": probabilities_by_largest,
        },
        [
            (np.array([3.0, 1.0]), np.array([0.5, 1.0]), 0.25),
            (np.array([1.0, 2.0, 0.1]), np.array([0.25, 0.5, 1.0]), 0.6),
        ],
    ),
    Exercise(
        "age_at",
        "solve u = Pr(age ≤ k) for k + 1, and round down.",
        age_at,
        {
            "The buffer ends: there are n ages only.": age_at_without_end,
            "An age is a whole number.": age_at_not_whole,
            "Round down: the newest has age 0.": age_at_rounded_up,
            "New ones are to be drawn more often, not old ones.": age_at_oldest_first,
            "This draws all ages alike.": age_at_even,
        },
        [
            (np.array([0.0, 0.5, 0.999]), 0.5, 4),
            (np.array([0.1, 0.7, 0.95]), 0.1, 10),
        ],
    ),
    Exercise(
        "weights",
        "what is drawn often is to count less.",
        weights,
        {
            "Upside down: what is drawn often would count more.": weights_upside_down,
            "Do not divide by the largest here.": weights_divided,
            "N is missing.": weights_without_n,
            "N belongs inside the power.": weights_n_outside,
            "N is the size of the buffer, not of the batch.": weights_of_batch,
        },
        [
            (np.array([0.5]), 4, 0.5),
            (np.array([0.5, 0.25]), 3, 0.4),
            (np.array([0.5, 0.25]), 10, 1.0),
        ],
    ),
]

"""The exercises of notebook 12: adaptation, forgetting, and the largest spread."""

import numpy as np

from . import Exercise

# Drop, recovery, area


def adaptation(returns, before, random):
    """On the scale on which 0 is the random policy and 1 the level before the drift."""
    levels = (returns - random) / (before - random)
    means = [levels[k - 10 : k].mean() for k in range(10, len(levels) + 1)]
    recovery = next((k for k, mean in enumerate(means, start=10) if mean >= 0.9), None)
    return 1 - levels[:20].mean(), recovery, levels.mean()


def without_random(returns, before, random):
    return adaptation(returns, before, 0)


def drop_of_all(returns, before, random):
    _, recovery, area = adaptation(returns, before, random)
    return 1 - area, recovery, area


def level_for_drop(returns, before, random):
    drop, recovery, area = adaptation(returns, before, random)
    return 1 - drop, recovery, area


def one_episode(returns, before, random):
    drop, _, area = adaptation(returns, before, random)
    levels = (returns - random) / (before - random)
    found = np.flatnonzero(levels >= 0.9)
    return drop, int(found[0]) + 1 if len(found) else None, area


def start_of_ten(returns, before, random):
    drop, recovery, area = adaptation(returns, before, random)
    return drop, None if recovery is None else recovery - 10, area


def length_for_never(returns, before, random):
    drop, recovery, area = adaptation(returns, before, random)
    return drop, len(returns) if recovery is None else recovery, area


# Forgetting


def forgetting(returns):
    """For each regime but the last: its best evaluation, minus the final one."""
    return [
        max(row[j] for row in returns[j:]) - returns[-1][j]
        for j in range(len(returns) - 1)
    ]


def before_it_was_met(returns):
    return [
        max(row[j] for row in returns) - returns[-1][j] for j in range(len(returns) - 1)
    ]


def since_its_end(returns):
    return [returns[j][j] - returns[-1][j] for j in range(len(returns) - 1)]


def wrong_way_round(returns):
    return [-x for x in forgetting(returns)]


def last_one_too(returns):
    return [*forgetting(returns), 0.0]


def rows_for_columns(returns):
    return forgetting(returns.T)


# The largest standard deviation


def largest_std(mean, low, high):
    """All values at the two ends, in the shares that give the mean."""
    return np.sqrt((high - mean) * (mean - low))


def variance(mean, low, high):
    return (high - mean) * (mean - low)


def half_the_range(mean, low, high):
    return (high - low) / 2


def of_even_values(mean, low, high):
    return (high - low) / np.sqrt(12)


def to_the_nearer_end(mean, low, high):
    return min(high - mean, mean - low)


def to_the_farther_end(mean, low, high):
    return max(high - mean, mean - low)


EXERCISES = [
    Exercise(
        "adaptation",
        "turn the returns into levels; take means; for recovery count the episodes.",
        adaptation,
        {
            "The random policy is the 0: subtract its return.": without_random,
            "The drop is that of the first 20 episodes.": drop_of_all,
            "That is a level; the drop is 1 minus it.": level_for_drop,
            "One good episode is no recovery; ten are.": one_episode,
            "The ten episodes of the mean count, too.": start_of_ten,
            "Never recovered is None, not the length of the regime.": length_for_never,
        },
        [
            (np.array([20.0] * 5 + [104.0] * 17), 100.0, 20.0),
            (np.array([104.0] + [20.0] * 21), 100.0, 20.0),
            (5.0 * np.arange(30), 80.0, 10.0),
        ],
    ),
    Exercise(
        "forgetting",
        "returns[k][j] is the return in regime j, measured at the end of regime k.",
        forgetting,
        {
            "Only evaluations from a regime's own end on count.": before_it_was_met,
            "The best evaluation counts, not the first.": since_its_end,
            "The sign: what is lost is positive.": wrong_way_round,
            "The last regime is left out: nothing came after it.": last_one_too,
            "Rows are times, columns are regimes.": rows_for_columns,
        },
        [
            (np.array([[9.0, 2.0], [4.0, 8.0]]),),
            (np.array([[5.0, 9.0, 0.0], [7.0, 6.0, 1.0], [3.0, 4.0, 2.0]]),),
        ],
    ),
    Exercise(
        "largest_std",
        "the variance is largest if all values sit at the two ends.",
        largest_std,
        {
            "That is the variance; take the root.": variance,
            "Half the range is right only for a mean in the middle.": half_the_range,
            "Values need not be spread evenly.": of_even_values,
            "That is the distance to the nearer end.": to_the_nearer_end,
            "That is the distance to the farther end.": to_the_farther_end,
        },
        [(1.0, 0.0, 4.0), (-200.0, -200.0, 0.0), (-195.0, -200.0, 0.0)],
    ),
]

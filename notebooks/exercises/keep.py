"""The exercises of notebook 13: trials, a chart, its change point, the data to keep."""

import numpy as np

from . import Exercise

# Which stage goes on


def choose(returns):
    return int(np.argmax(returns))  # the first of equals


def oldest_of_equals(returns):
    return len(returns) - 1 - choose(returns[::-1])


def smallest(returns):
    return choose([-value for value in returns])


def newest(returns):
    return 0


def its_return(returns):
    return max(returns)


def from_the_oldest(returns):
    return len(returns) - 1 - choose(returns)


def nearest_to_zero(returns):
    return choose([-abs(value) for value in returns])


# The chart


def cusum(z, slack):
    S, sums = 0.0, []
    for value in z:
        S = max(0.0, S + value - slack)
        sums.append(S)
    return sums


def without_zero(z, slack):
    return np.cumsum(np.array(z) - slack).tolist()


def slack_added(z, slack):
    return cusum(z, -slack)


def without_slack(z, slack):
    return cusum(z, 0)


def of_both_sides(z, slack):
    return cusum(np.abs(z), slack)


def forgets(z, slack):
    return [max(0.0, value - slack) for value in z]


def zero_before_slack(z, slack):
    S, sums = 0.0, []
    for value in z:
        S = max(0.0, S + value) - slack
        sums.append(S)
    return sums


def last_sum(z, slack):
    return cusum(z, slack)[-1]


# Its change point


def change_point(S, level):
    alarm = next(k for k in range(len(S)) if S[k] > level)
    change = alarm
    while change > 0 and S[change - 1] > 0:
        change -= 1
    return change, alarm


def last_zero(S, level):
    change, alarm = change_point(S, level)
    return change - 1, alarm


def alarm_twice(S, level):
    _, alarm = change_point(S, level)
    return alarm, alarm


def first_above_zero(S, level):
    _, alarm = change_point(S, level)
    return next(k for k in range(len(S)) if S[k] > 0), alarm


def at_the_level(S, level):
    return change_point(S, np.nextafter(level, 0))


def at_the_peak(S, level):
    change, _ = change_point(S, level)
    return change, int(np.argmax(S))


def swapped(S, level):
    return change_point(S, level)[::-1]


# The data to keep


def keep(added, change, now):
    return added >= change


def since_the_alarm(added, change, now):
    return added >= now


def the_old_ones(added, change, now):
    return added < change


def everything(added, change, now):
    return added < now


def without_the_first(added, change, now):
    return added > change


def by_length(added, change, now):
    return added >= now - change


def as_places(added, change, now):
    return np.flatnonzero(added >= change)


EXERCISES = [
    Exercise(
        "choose",
        "the place of the largest return; of equals np.argmax takes the first.",
        choose,
        {
            "Of equals the newest goes on, and that is the first.": oldest_of_equals,
            "The largest return is the best, also if all are negative.": smallest,
            "The newest is not always the best: compare the returns.": newest,
            "Return the stage's place, not its return.": its_return,
            "The newest stage has place 0; count from there.": from_the_oldest,
            "A return above 0 is good too: compare without abs.": nearest_to_zero,
        },
        [
            ([-3.0],),
            ([-9.0, -4.0],),
            ([-4.0, -9.0, -4.0],),
            ([-7.0, -2.0, -5.0],),
            ([1.0, 3.0, 2.0],),
        ],
    ),
    Exercise(
        "cusum",
        "begin with S = 0; for each z set S to max(0, S + z − slack), and collect it.",
        cusum,
        {
            "Without the max good values pile up, and hide bad ones.": without_zero,
            "The slack is added; it should be subtracted.": slack_added,
            "The slack is missing.": without_slack,
            "Only rises count: |z| charts falls too.": of_both_sides,
            "The S before is missing: this charts single values.": forgets,
            "Subtract the slack inside the max.": zero_before_slack,
            "Return S after each z, not only the last.": last_sum,
        },
        [
            (np.array([2.0]), 0.5),
            (np.array([-2.0]), 0.5),
            (np.array([1.0, 2.0]), 0.5),
            (np.array([-3.0, 1.0, 2.0, -1.0]), 0.25),
        ],
    ),
    Exercise(
        "change_point",
        "find the first S above the level; from there go back while S before is not 0.",
        change_point,
        {
            "The change is the value after the last 0, not that 0.": last_zero,
            "The change comes before the alarm: where S last left 0.": alarm_twice,
            "Not the first rise of all: S was 0 again since.": first_above_zero,
            "S must exceed the level, not only reach it.": at_the_level,
            "The alarm is the first S above the level, not the largest.": at_the_peak,
            "The change first, then the alarm.": swapped,
        },
        [
            (np.array([0.0, 2.0, 4.0, 6.0]), 5.0),
            (np.array([3.0, 6.0, 9.0]), 5.0),
            (np.array([0.0, 1.0, 0.0, 2.0, 5.0, 7.0, 9.0, 0.0]), 5.0),
        ],
    ),
    Exercise(
        "keep",
        "compare the step at which each was added with one of the other two.",
        keep,
        {
            "Since the alarm there are none yet: keep those since the change.": (
                since_the_alarm
            ),
            "That keeps the old world's, and drops the new one's.": the_old_ones,
            "That keeps everything.": everything,
            "The transition of the change itself belongs to the new world.": (
                without_the_first
            ),
            "change is a step, not a number of transitions.": by_length,
            "Give True or False for each, not the places.": as_places,
        },
        [
            (np.arange(4), 2, 4),
            (np.arange(10, 18), 15, 18),
        ],
    ),
]

"""What a learning curve says, and what several of them say together.

Of one curve: final return, and per regime the mean, the drop at its start, the recovery and the
area under it. Of several, one per seed: interquartile mean, bootstrap intervals, paired
differences, forgetting.

Returns of different regimes are compared on one scale, level = (return − random) / (reference −
random): 0 is the random policy, 1 the mean of the 20 episodes before the drift. (A tenth more or
less than a return of −100 would mean opposite things.)
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Rows = Sequence[Mapping[str, Any]]  # the records of a run, or the summaries of some runs
EDGE, WINDOW, RECOVERED = (
    20,
    10,
    0.9,
)  # episodes at a regime's edge, episodes of a trailing mean, level that counts


def final_return(returns, last=50):
    """Mean return of the last 50 episodes (the paper does not say what its "Final Return" is:
    D12).
    """
    return float(np.mean(returns[-last:]))


def trailing_mean(x, window):
    """Mean of each element and the window − 1 before it: (n,) → (n − window + 1,); empty if x is
    shorter.

    >>> trailing_mean(np.array([1.0, 2.0, 6.0]), 2).tolist()
    [1.5, 4.0]
    """
    if len(x) < window:
        return np.empty(0)
    return np.lib.stride_tricks.sliding_window_view(x, window).mean(-1)


def recovery(levels):
    """Episodes until the trailing mean of 10 levels first reaches 0.9, or None if it never does
    (censored).
    """
    reached = np.flatnonzero(trailing_mean(np.asarray(levels), WINDOW) >= RECOVERED)
    return int(reached[0]) + WINDOW if len(reached) else None


def regime_table(records, random_return):
    """One dict per regime: first episode, episodes, event, mean return; drop, recovery, area
    against the one before.

    drop = 1 − mean level of the first 20 episodes, area = mean level of all of them. All three are
    None in the first regime, and where the 20 episodes before the drift were not better than the
    random policy by two standard errors, so that nothing could be lost.
    """
    regimes = [record["regime"] for record in records]
    starts = [i for i in range(len(records)) if i == 0 or regimes[i] != regimes[i - 1]]
    table = []
    for start, end in zip(starts, [*starts[1:], len(records)], strict=True):
        returns = np.array([record["return"] for record in records[start:end]])
        row = {
            "regime": regimes[start],
            "first_episode": records[start]["episode"],
            "episodes": end - start,
            "event": records[start]["event"],
            "mean_return": float(returns.mean()),
            "drop": None,
            "recovery": None,
            "area": None,
        }
        if table:
            before = np.array(
                [record["return"] for record in records[max(0, start - EDGE) : start]]
            )
            span = before.mean() - random_return
            if span > 2 * before.std() / np.sqrt(len(before)):
                levels = (returns - random_return) / span
                row |= {"drop": float(1 - levels[:EDGE].mean()), "recovery": recovery(levels)}
                row["area"] = float(levels.mean())
        table.append(row)
    return table


def iqm(x, axis=-1):
    """Interquartile mean: the mean of the middle half, 2 ∫ F⁻¹(u) du from ¼ to ¾, F⁻¹ the sorted
    values as steps.

    Of 5 values each fills a fifth: the second and the fourth count by 3/4 of it (from 0.25 to 0.4),
    the third whole.

    >>> float(iqm(np.array([0.0, 1.0, 2.0, 3.0, 100.0])))
    2.0
    """
    x = np.sort(x, axis)
    n = x.shape[axis]
    edges = np.arange(n + 1) / n
    weight = np.diff(edges.clip(0.25, 0.75)) * 2
    return np.tensordot(x, weight, (axis, 0))[()]


def bootstrap_interval(x, rng, statistic=iqm, level=0.95, resamples=2000):
    """(low, high): percentiles of the statistic over resamples of the runs, x (runs,) or
    (environments, runs).

    Stratified: runs are drawn with replacement within each environment, and the statistic is
    averaged over them. With five runs such an interval is too narrow: of normal data the nominal 95
    % cover 88 % (measured; the mean's 81 %).
    """
    x = np.atleast_2d(x)
    draws = rng.integers(x.shape[1], size=(resamples, *x.shape))
    values = statistic(
        np.take_along_axis(np.broadcast_to(x, draws.shape), draws, -1), axis=-1
    ).mean(-1)
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def paired_difference(x, y, rng, **options):
    """(iqm of x − y, low, high) for two methods' results on the same seeds, (runs,) each."""
    difference = np.asarray(x) - np.asarray(y)
    return (float(iqm(difference)), *bootstrap_interval(difference, rng, **options))


def same_seeds(runs: Rows, others: Rows) -> tuple[np.ndarray, np.ndarray]:
    """The final returns of two agents' summaries, paired by seed: two arrays (seeds,).

    Seeds that only one of them has are left out.
    """
    ours, theirs = ({run["seed"]: run["final_return"] for run in each} for each in (runs, others))
    seeds = sorted(ours.keys() & theirs.keys())
    return np.array([ours[seed] for seed in seeds]), np.array([theirs[seed] for seed in seeds])


def mean_std(x):
    """(mean, std) over runs, as the paper's tables seem to give them; the std with n − 1, None for
    one run.
    """
    return float(np.mean(x)), float(np.std(x, ddof=1)) if len(x) > 1 else None


def median_recovery(recoveries):
    """The median of recovery times of which None (never within the regime) is later than any; None
    if it is that.
    """
    ordered = sorted(recoveries, key=lambda time: (time is None, time))
    low, high = ordered[(len(ordered) - 1) // 2], ordered[len(ordered) // 2]
    return None if high is None else (low + high) / 2


def forgetting(returns):
    """What is lost of each regime: its best return so far less its last one, from returns (after k,
    on j), (R, R).

    Only evaluations after a regime was first met count; of the last one nothing can be forgotten
    yet.
    """
    returns = np.asarray(returns)
    return [float(returns[j:, j].max() - returns[-1, j]) for j in range(len(returns) - 1)]

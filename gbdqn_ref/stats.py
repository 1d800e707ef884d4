"""What a learning curve says: final return, and per regime the mean, the drop at its start and the recovery.

Returns of different regimes are compared on one scale, level = (return − random) / (reference − random): 0 is the
random policy, 1 the mean of the 20 episodes before the drift. (A tenth more or less than a return of −100 would mean
opposite things.)
"""

import numpy as np

EDGE, WINDOW, RECOVERED = 20, 10, 0.9  # episodes at a regime's edge, episodes of a trailing mean, level that counts


def final_return(returns, last=50):
    """Mean return of the last 50 episodes (the paper does not say what its "Final Return" is: D12)."""
    return float(np.mean(returns[-last:]))


def trailing_mean(x, window):
    """Mean of each element and the window − 1 before it: (n,) → (n − window + 1,); empty if x is shorter.

    >>> trailing_mean(np.array([1.0, 2.0, 6.0]), 2).tolist()
    [1.5, 4.0]
    """
    if len(x) < window:
        return np.empty(0)
    return np.lib.stride_tricks.sliding_window_view(x, window).mean(-1)


def recovery(levels):
    """Episodes until the trailing mean of 10 levels first reaches 0.9, or None if it never does (censored)."""
    reached = np.flatnonzero(trailing_mean(np.asarray(levels), WINDOW) >= RECOVERED)
    return int(reached[0]) + WINDOW if len(reached) else None


def regime_table(records, random_return):
    """One dict per regime: first episode, episodes, event, mean return, drop and recovery against the one before.

    drop = 1 − mean level of the first 20 episodes. Both are None in the first regime, and where the 20 episodes before
    the drift were not better than the random policy by two standard errors, so that nothing could be lost.
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
        }
        if table:
            before = np.array([record["return"] for record in records[max(0, start - EDGE) : start]])
            span = before.mean() - random_return
            if span > 2 * before.std() / np.sqrt(len(before)):
                levels = (returns - random_return) / span
                row |= {"drop": float(1 - levels[:EDGE].mean()), "recovery": recovery(levels)}
        table.append(row)
    return table

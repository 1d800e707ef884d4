"""Drift detection with a CUSUM chart of one number per episode (Page 1954).

Letters: x the charted number, z its distance from the reference in standard deviations, S the
cumulative sum, k the slack. x rises when the agent gets worse: it is minus the return, or log |δ|.
"""

from math import log, sqrt

SIGNALS = ("return", "td_error")
SLACK, LARGEST, REFERENCE = 0.5, 3.0, 30  # k, the largest z, the reference's memory in episodes


def cusum(S, z, slack=SLACK):
    """S ← max(0, S + z − k): near 0 while z is 0 on average, and rising with z.

    >>> cusum(1.0, 2.0), cusum(1.0, -2.0)
    (2.5, 0.0)
    """
    return max(0.0, S + z - slack)


def symptom(signal, total, td_error):
    """The charted number x of an episode; None if it has none.

    An episode without an update has no TD error (nan).
    """
    if signal == "return":
        return -total
    return log(td_error) if td_error > 0 else None


class Chart:
    """A one-sided CUSUM chart, which detects rises of x above a reference that follows x.

    The reference is the mean μ and the standard deviation σ of x, with exponential weights from the
    30th value on. z is cut off at 3, so a single value raises no alarm and barely moves the
    reference. Falls are not cut off, so the reference follows an agent that learns.

    >>> chart = Chart(level=5.0)
    >>> calm = [chart.update(x=float(k % 2), at=k) for k in range(41)]
    >>> [chart.update(x=9.0, at=k) for k in range(41, 44)]      # the change came at step 41
    [None, None, 41]
    """

    def __init__(self, level):
        self.level = level
        self.restart()

    def restart(self):
        """Forget the reference and the sum."""
        self.n, self.mean, self.variance, self.S, self.since = 0, 0.0, 0.0, 0.0, 0

    def update(self, x, at):
        """Chart x, observed from step `at` on; if S > level, restart and return the change's step.

        That is the step of the x at which S last left 0.
        """
        away, sigma = x - self.mean, sqrt(self.variance) + 1e-9
        if self.n >= REFERENCE:
            z = min(away / sigma, LARGEST)
            self.since = self.since if self.S else at
            self.S, away = cusum(self.S, z), z * sigma
            if self.level < self.S:
                since = self.since
                self.restart()
                return since
        self.n += 1
        weight = 1 / min(self.n, REFERENCE)
        self.mean += weight * away
        self.variance = (1 - weight) * (self.variance + weight * away**2)
        return None

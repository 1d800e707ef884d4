"""Have the physics drifted? A CUSUM chart of one number per episode (Page 1954).

Letters: x the number that is charted, z its distance from the reference in standard deviations,
S the sum, k the slack. What is charted rises when things get worse: minus the return, or log |δ|.
"""

from math import log, sqrt

SIGNALS = ("return", "td_error")
SLACK, LARGEST, REFERENCE = 0.5, 3.0, 30  # k, the largest z, episodes that the reference remembers


def cusum(S, z, slack=SLACK):
    """S ← max(0, S + z − k): it stays near 0 while z is 0 on average, and rises with z.

    >>> cusum(1.0, 2.0), cusum(1.0, -2.0)
    (2.5, 0.0)
    """
    return max(0.0, S + z - slack)


def symptom(signal, total, td_error):
    """The number that rises when the physics change; None where an episode has none.

    An episode without an update has no TD error (nan).
    """
    if signal == "return":
        return -total
    return log(td_error) if td_error > 0 else None


class Chart:
    """A one-sided CUSUM of the rises of x above a reference that follows it.

    The reference is the mean μ and the standard deviation σ of x, with exponential weights from the
    30th value on. z is at most 3, so that one value is no alarm and does not carry the reference
    away. Falls are not cut, so that the reference follows an agent that learns.

    >>> chart = Chart(level=5.0)
    >>> calm = [chart.update(x=float(k % 2), at=k) for k in range(41)]
    >>> [chart.update(x=9.0, at=k) for k in range(41, 44)]      # the change came with step 41
    [None, None, 41]
    """

    def __init__(self, level):
        self.level = level
        self.restart()

    def restart(self):
        """Forget the reference."""
        self.n, self.mean, self.variance, self.S, self.since = 0, 0.0, 0.0, 0.0, 0

    def update(self, x, at):
        """Chart x, observed from step `at` on; where S > level, restart and return when it began.

        That is the step of the x with which S last left 0.
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

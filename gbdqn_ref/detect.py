"""Drift detection with a CUSUM chart of one number per episode (Page 1954).

Letters: x the charted number, z its distance from the reference in standard deviations, S the
cumulative sum, k the slack. x rises when something gets worse: it is minus the return, log |δ|, or
the log error of a model of the physics.
"""

from math import isnan, log, sqrt

import numpy as np

from .nn import MLP
from .optim import Adam

# k by symptom: half of the shift to be found in standard deviations: a model's error shifts more
SLACK = {"return": 0.5, "td_error": 0.5, "model": 2.0}
LARGEST, REFERENCE = 3.0, 30  # the largest z, and the reference's memory in episodes
STEPS, LEAST, BATCH = 8, 8, 64  # a model's steps per update, updates per episode, batch size


def cusum(S, z, slack=0.5):
    """S ← max(0, S + z − k): near 0 while z is 0 on average, and rising with z.

    >>> cusum(1.0, 2.0), cusum(1.0, -2.0)
    (2.5, 0.0)
    """
    return max(0.0, S + z - slack)


class Chart:
    """A one-sided CUSUM chart, which detects rises of x above a reference that follows x.

    The reference is the mean μ and the standard deviation σ of x. The first 30 values, in which
    an agent learns or relearns, are passed over; the next 30 make a reference; then the weights are
    exponential. z is cut off at 3, so a single value barely moves the reference, and raises no
    alarm at levels of 3 and above. Falls are not cut off, so the reference follows an agent that
    learns.

    >>> chart = Chart(level=5.0)
    >>> calm = [chart.update(x=float(k % 2), at=k) for k in range(71)]
    >>> [chart.update(x=9.0, at=k) for k in range(71, 74)]      # the change came at step 71
    [None, None, 71]
    """

    def __init__(self, level, slack=0.5):
        self.level, self.slack = level, slack
        self.restart()

    def restart(self):
        """Forget the reference and the sum, and pass over the next 30 values."""
        self.n, self.mean, self.variance, self.S, self.since = -REFERENCE, 0.0, 0.0, 0.0, 0

    def update(self, x, at):
        """Chart x, observed from step `at` on; if S > level, restart and return the change's step.

        That is the step of the x at which S last left 0.
        """
        if self.n < 0:
            self.n += 1
            return None
        away, sigma = x - self.mean, sqrt(self.variance) + 1e-9
        if self.n >= REFERENCE:
            z = min(away / sigma, LARGEST)
            self.since = self.since if self.S else at
            self.S, away = cusum(self.S, z, self.slack), z * sigma
            if self.level < self.S:
                since = self.since
                self.restart()
                return since
        self.n += 1
        weight = 1 / min(self.n, REFERENCE)
        self.mean += weight * away
        self.variance = (1 - weight) * (self.variance + weight * away**2)
        return None


class TransitionModel:
    """A network that predicts the step s' − s from s and a, trained on draws from a replay buffer.

    Its error rises when the physics change, even if the return does not fall. s and s' − s are in
    units of their mean sizes so far, coordinate by coordinate; the loss is Huber's.
    """

    def __init__(self, state_dim, n_actions, rng, width=32, lr=1e-3):
        self.net = MLP((state_dim + n_actions, width, state_dim))
        self.theta, self.adam = self.net.init(rng), Adam(self.net.size, lr)
        self.n_actions, self.rng = n_actions, rng
        self.n, self.sizes = 0, np.zeros((2, state_dim))  # transitions, Σ|s| and Σ|s' − s|

    def update(self, replay, index):
        """Learn after an episode, whose slots are `index`; the model's median error on it before.

        The median passes over single steps that no smooth model fits, like a hit against a wall.
        """
        s, s2, slots = replay.s[index], replay.s2[index], replay.slots()
        self.n += len(index)
        self.sizes += np.abs([s, s2 - s]).sum(1)
        errors, _ = self._errors(replay, index)
        for _ in range(max(LEAST, len(index) // STEPS)):
            batch_errors, cache = self._errors(replay, self.rng.choice(slots, BATCH))
            gradient = np.clip(batch_errors, -1, 1) / batch_errors.size
            self.adam.step(self.theta, self.net.backward(self.theta, cache, gradient))
        return float(np.median(np.abs(errors).mean(1)))

    def _errors(self, replay, index):
        """Predicted minus actual steps (B, d) of the transitions in these slots, and the cache."""
        of_s, of_step = self.sizes / self.n + 1e-9
        s, one_hot = replay.s[index], np.eye(self.n_actions)[replay.a[index]]
        x = np.concatenate([s / of_s, one_hot], 1, dtype=np.float32)
        predicted, cache = self.net.forward(self.theta, x)
        return predicted - ((replay.s2[index] - s) / of_step).astype(np.float32), cache


class Detector:
    """Charts one symptom per episode of an agent that stores its transitions in a replay buffer."""

    def __init__(self, symptom, level, model):
        self.symptom, self.model = symptom, model
        self.chart = Chart(level, SLACK[symptom])

    def update(self, replay, start, total, td_error):
        """Chart the episode that began at step `start`; the step of a change, or None.

        An error of nan (an episode without an update) or 0 has no logarithm, and is not charted; a
        return of nan (an older stage's) is not either.
        """
        if self.symptom == "return":
            return None if isnan(total) else self.chart.update(-total, start)
        error = td_error
        if self.symptom == "model":
            first = max(start, replay.added - replay.capacity)
            error = self.model.update(replay, np.arange(first, replay.added) % replay.capacity)
        return self.chart.update(log(error), start) if error > 0 else None


class Deaf:
    """The detector of an agent that is told of drifts."""

    def update(self, replay, start, total, td_error):
        """There is no alarm."""


def make_detector(config, state_dim, n_actions, rng):
    """The detector that the config names."""
    if config.drift_signal != "detector":
        return Deaf()  # it is told of drifts, as in the paper (D22)
    modelled = config.symptom == "model"
    model = TransitionModel(state_dim, n_actions, rng) if modelled else None
    return Detector(config.symptom, config.alarm_level, model)

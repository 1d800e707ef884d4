"""For physics that recur: after each drift stored stages of Q compete, and the best continues."""

import numpy as np

from .gbdqn import GBDQN

# In the paper all stages add up to one Q; here their sums so far compete (D22).
SHELF = 3  # stages that compete
PATIENCE, WINDOW = 50, 10  # the learner's episodes: for its recovery, and in the mean return
TURNS = 5  # episodes each, of a stage and of the learner that started from it


class ReuseGBDQN(GBDQN):
    """GB-DQN whose stages Q_1, …, Q_m compete when the physics change.

    The current Q is frozen and put on a shelf. Each of the last three stages on it plays one
    episode; the best continues, with a new booster on top. Once the learner itself has played 50
    episodes since, they compete again whenever the mean of its last ten returns is below the
    midpoint between the worst return and the mean before the change. With a warm start this is DQN
    that stores and reuses its networks.

    A learner begins on probation where the stage that it started from still does well, above that
    midpoint: the two play in turn until the learner's last five returns are at least as good.
    """

    def __init__(self, state_dim, n_actions, config, rng):
        super().__init__(state_dim, n_actions, config, rng)
        self.shelf = np.empty(0, int)  # stages, the newest last
        self.returns = np.empty(0)  # of the trials so far, the newest stage first
        self.on_trial = False
        self.recent = np.empty(0)  # the learner's returns since the last change, at most PATIENCE
        self.worst, self.before = np.inf, -np.inf  # the worst return, the mean before the change
        self.base, self.on_probation = 0, False  # the stage that the learner started from
        self.turns = np.empty(0)  # returns of the base, the learner, the base, … on probation

    def act(self, s, greedy=False):
        stage = None if greedy else self._playing()
        if stage is None:
            return super().act(s, greedy)
        return int(self.ensemble.staged_q(s)[stage].argmax())

    def _playing(self):
        """The stage that plays this episode; None if the learner does."""
        if self.on_trial:
            return self.shelf[-1 - len(self.returns)]
        return self.base if self.on_probation and len(self.turns) % 2 == 0 else None

    def on_drift(self, event, fresh=0):
        """Freeze the current Q and let the stages compete, at a drift and at a reset."""
        if len(self.recent) and self._recovered():
            self.before = self.recent[-WINDOW:].mean()
        super().on_drift("drift" if event == "reset" else event, fresh)
        self.shelf = np.append(self.shelf, len(self.ensemble) - 1)[-SHELF:]
        self.returns, self.recent, self.turns = np.empty(0), np.empty(0), np.empty(0)
        self.base, self.on_probation = len(self.ensemble) - 1, True
        self.on_trial = len(self.shelf) > 1

    def end_episode(self, total, td_error):
        """Record a return. One that a stage played is not charted, nor counted for recovery."""
        stage, self.worst = self._playing(), min(self.worst, total)
        if self.on_trial:
            self.returns = np.append(self.returns, total)
            if len(self.returns) == len(self.shelf):
                self._choose()
        elif self.on_probation:
            self.turns = np.append(self.turns, total)
            of_base, of_learner = self.turns[::2][-TURNS:], self.turns[1::2][-TURNS:]
            passed = len(of_learner) == TURNS and of_learner.mean() >= of_base.mean()
            self.on_probation = bool(self.turns[0] >= self._midpoint() and not passed)
        if stage is None:
            self.recent = np.append(self.recent, total)[-PATIENCE:]
        super().end_episode(total if stage is None else np.nan, td_error)
        if len(self.recent) == PATIENCE and not self._recovered():
            self.on_drift("drift", len(self.replay))

    def _recovered(self):
        return self.recent[-WINDOW:].mean() >= self._midpoint()

    def _midpoint(self):
        """Between the worst return and the mean before the change."""
        return (self.worst + self.before) / 2

    def _choose(self):
        """The best stage continues, the newest of equals."""
        self.on_trial, best = False, self.shelf[-1 - self.returns.argmax()]
        self.base = int(best)
        if best < len(self.ensemble) - 1:
            self.shelf = self.shelf[self.shelf != best]  # its successor joins later
            self._continue_from(best)

    def _continue_from(self, k):
        """Continue from stage k, with a new booster on top."""
        slots = self.replay.slots()
        self.theta, self.theta_target = self.ensemble.theta[[k, k]]
        self.ensemble.use(k, self._carried())
        a = self.replay.a[slots]
        self.q_frozen[slots] = self.ensemble.q(self.replay.s[slots])[np.arange(len(a)), a]
        self.q_frozen_next[slots] = self.ensemble.q(self.replay.s2[slots])
        self.memo = np.empty(0), np.empty(0)
        self._new_booster()

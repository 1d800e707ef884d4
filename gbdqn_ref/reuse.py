"""For physics that come back: stored stages of Q compete after each drift, and the best goes on."""

import numpy as np

from .gbdqn import GBDQN

SHELF = 3  # stages that compete
PATIENCE, WINDOW = 50, 10  # episodes until an agent should have recovered, and of its mean return


class ReuseGBDQN(GBDQN):
    """GB-DQN whose stages Q_1, …, Q_m compete when the physics change.

    What has been learnt is frozen and put on a shelf. Each of the last three stages there plays one
    episode; the best goes on, with a new booster on top of it. Where the mean return stays below
    the middle between the worst return and the level before the change, they compete again after
    50 episodes. With a warm start this is DQN that stores and reuses its networks.
    """

    def __init__(self, state_dim, n_actions, config, rng):
        super().__init__(state_dim, n_actions, config, rng)
        self.shelf = np.empty(0, int)  # stages, the newest last
        self.returns = np.empty(0)  # of the trial episodes so far, the newest stage first
        self.on_trial = False
        self.recent = np.empty(0)  # returns since the last change, at most PATIENCE
        self.worst, self.before = np.inf, -np.inf  # the worst return, the level before the change

    def act(self, s, greedy=False):
        if self.on_trial and not greedy:
            stage = self.shelf[-1 - len(self.returns)]
            return int(self.ensemble.staged_q(s)[stage].argmax())
        return super().act(s, greedy)

    def on_drift(self, event, fresh=0):
        """Freeze what has been learnt and let the stages compete, at "drift" and "reset" alike."""
        if len(self.recent) and self._recovered():
            self.before = self.recent[-WINDOW:].mean()
        super().on_drift("drift" if event == "reset" else event, fresh)
        self.shelf = np.append(self.shelf, len(self.ensemble) - 1)[-SHELF:]
        self.returns, self.recent = np.empty(0), np.empty(0)
        self.on_trial = len(self.shelf) > 1

    def end_episode(self, total, td_error):
        """Note how a stage on trial did; once all have played, the best goes on, of equals the
        newest.
        """
        self.worst = min(self.worst, total)
        if not self.on_trial:
            self.recent = np.append(self.recent, total)[-PATIENCE:]
            super().end_episode(total, td_error)
            if len(self.recent) == PATIENCE and not self._recovered():
                self.on_drift("drift", len(self.replay))
            return
        self.episode_start = self.steps
        self.returns = np.append(self.returns, total)
        if len(self.returns) == len(self.shelf):
            self._choose()

    def _recovered(self):
        return self.recent[-WINDOW:].mean() >= (self.worst + self.before) / 2

    def _choose(self):
        self.on_trial, best = False, self.shelf[-1 - self.returns.argmax()]
        if best < len(self.ensemble) - 1:
            self.shelf = self.shelf[self.shelf != best]  # it returns, as what it becomes, later
            self._go_on_from(best)

    def _go_on_from(self, k):
        """Go on from stage k, with a new booster on top of it."""
        slots = self.replay.slots()
        self.theta, self.theta_target = self.ensemble.theta[[k, k]]
        self.ensemble.use(k, self._carried())
        a = self.replay.a[slots]
        self.q_frozen[slots] = self.ensemble.q(self.replay.s[slots])[np.arange(len(a)), a]
        self.q_frozen_next[slots] = self.ensemble.q(self.replay.s2[slots])
        self.memo = np.empty(0), np.empty(0)
        self._new_booster()

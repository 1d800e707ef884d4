"""The paper's baselines other than DQN, and the controls that a comparison needs.

Two more controls reuse a class and swap its replay: dqn-recency is DQN with GB-DQN's, gbdqn-per is
GB-DQN with DQN's.
"""

import copy
from dataclasses import replace

import numpy as np

from . import bellman
from .dqn import DQN
from .optim import Adam, clip_by_norm, polyak


class EnsembleDQN(DQN):
    """Ensemble-DQN (Anschel et al. 2017): K networks are fitted to one target (D18).

        y = r + γ max_a' mean_k Q̄_k(s', a')

    The members are one stack θ (K, P). They start from different weights. With bootstrap < 1 they
    also see different data: a member sees a transition with that probability, drawn once.
    """

    def __init__(self, state_dim, n_actions, config, rng):
        super().__init__(state_dim, n_actions, config, rng)
        others = self.net.init(rng, config.members - 1)
        self.theta = np.concatenate([self.theta[None], others])  # (K, P), the first is DQN's
        self.theta_target = self.theta.copy()
        self.adam = Adam(self.theta.shape, config.lr)
        self.seen = np.ones((config.capacity, config.members), bool)  # slot by slot, by whom

    def q(self, s):
        """Q(s, ·) = mean_k Q_k(s, ·): (…, d) → (…, A)."""
        q, _ = self.net.forward(self.theta, s.reshape(-1, s.shape[-1]))  # (K, B, A)
        return q.mean(0).reshape(*s.shape[:-1], self.n_actions)

    def observe(self, s, a, r, s2, terminated):
        slot = self.replay.add(s, a, r, s2, terminated)
        if self.config.bootstrap < 1:
            self.seen[slot] = self.rng.random(self.config.members) < self.config.bootstrap
        self.steps += 1

    def learn(self):
        """One update of every member from one batch; returns the TD errors δ (B,) of the mean."""
        c = self.config
        batch = self.replay.sample(c.batch_size, self.rng)
        q_next, _ = self.net.forward(self.theta_target, batch.s2)  # (K, B, A)
        y = bellman.td_target(batch.r, batch.terminated, q_next.mean(0), c.gamma)  # (B,)
        q_all, cache = self.net.forward(self.theta, batch.s)  # (K, B, A)
        q = q_all[:, np.arange(len(y)), batch.a]  # (K, B)
        weight = batch.weight * self.seen[batch.index].T  # (K, B), 0 where not seen
        dq = bellman.loss_gradient(y - q, weight, batch.a, self.n_actions)  # (K, B, A)
        grad = self.net.backward(self.theta, cache, dq)  # (K, P)
        self.adam.step(self.theta, clip_by_norm(grad, c.max_grad_norm))  # clips each by itself
        polyak(self.theta_target, self.theta, c.tau)  # D9
        delta = y - q.mean(0)
        self.replay.update_priorities(batch.index, delta)
        return delta


class ResetDQN(DQN):
    """Reset-DQN (Nikishin et al. 2022): a new network at each drift, but the old replay."""

    def on_drift(self, event, fresh=0):
        """Replace the network and its target at a drift, and at a reset to stock physics (D20)."""
        super().on_drift(event, fresh)
        self.theta = self.net.init(self.rng)
        self.theta_target = self.theta.copy()


def sliding_dqn(state_dim, n_actions, config, rng):
    """Sliding-window DQN: DQN whose replay holds only the last `window` transitions."""
    return DQN(state_dim, n_actions, replace(config, capacity=config.window), rng)


class FrozenDQN(DQN):
    """A control: DQN that stops learning at the first drift, so it neither adapts nor forgets.

    It still explores, stores transitions and measures its TD errors.
    """

    def on_drift(self, event, fresh=0):
        """Set the step size to 0 at the first drift."""
        stopped = event == "drift" or self.adam.lr == 0
        super().on_drift(event, fresh)
        if stopped:
            self.adam.lr = 0.0


class Random:
    """A control: uniformly random actions, for the return without any learning.

    Evaluation draws from a second generator, so it does not change the training.
    """

    epsilon, replay = 1.0, None

    def __init__(self, state_dim, n_actions, config, rng):
        self.config, self.n_actions = config.resolved(), n_actions
        self.rng, self.evaluation_rng = rng, copy.deepcopy(rng)
        self.steps, self.learning_starts = 0, config.learning_starts

    def act(self, s, greedy=False):
        rng = self.evaluation_rng if greedy else self.rng
        return int(rng.integers(self.n_actions))

    def observe(self, s, a, r, s2, terminated):
        self.steps += 1

    def learn(self):
        """A random policy has no Q, hence no TD error."""
        return np.empty(0)

    def on_drift(self, event, fresh=0):
        """Nothing changes."""

    def end_episode(self, total, td_error):
        """Nothing changes."""

    def finish(self):
        return self

"""What GB-DQN is compared with beside DQN: the paper's other baselines, and the controls that a
comparison needs.

Two more controls are a class that is there already with the other one's replay
(config.Config.replay): dqn-recency is DQN, gbdqn-per GB-DQN.
"""

import copy
from dataclasses import replace

import numpy as np

from . import bellman
from .dqn import DQN
from .optim import Adam, clip_by_norm, polyak


class EnsembleDQN(DQN):
    """Ensemble-DQN (Anschel et al. 2017): K networks, each fitted to one y = r + γ max_a' mean_k
    Q̄_k(s', a') (D18).

    The members are one stack θ (K, P). They differ in where they start and, with bootstrap < 1, in
    what they see: each transition is shown to a member with that probability, once and for all.
    """

    def __init__(self, state_dim, n_actions, config, rng):
        super().__init__(state_dim, n_actions, config, rng)
        others = self.net.init(rng, config.members - 1)
        self.theta = np.concatenate([self.theta[None], others])  # (K, P), the first one as DQN's
        self.theta_target = self.theta.copy()
        self.adam = Adam(self.theta.shape, config.lr)
        self.seen = np.ones(
            (config.capacity, config.members), bool
        )  # slot by slot, who looks at the transition

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
        weight = batch.weight * self.seen[batch.index].T  # (K, B), 0 where a member does not look
        dq = bellman.loss_gradient(y - q, weight, batch.a, self.n_actions)  # (K, B, A)
        grad = clip_by_norm(
            self.net.backward(self.theta, cache, dq), c.max_grad_norm
        )  # of each member by itself
        self.adam.step(self.theta, grad)
        polyak(self.theta_target, self.theta, c.tau)  # D9
        delta = y - q.mean(0)
        self.replay.update_priorities(batch.index, delta)
        return delta


class ResetDQN(DQN):
    """Reset-DQN (Nikishin et al. 2022): DQN that starts anew whenever the physics change, and keeps
    its replay.
    """

    def on_drift(self, event, fresh=0):
        """A fresh network and target at a drift, and at the return to the stock physics (D20)."""
        super().on_drift(event, fresh)
        self.theta = self.net.init(self.rng)
        self.theta_target = self.theta.copy()


def sliding_dqn(state_dim, n_actions, config, rng):
    """Sliding-window DQN: a DQN whose replay holds no more than the last `window` transitions."""
    return DQN(state_dim, n_actions, replace(config, capacity=config.window), rng)


class FrozenDQN(DQN):
    """A control: DQN that learns nothing after the first drift, so that it neither adapts nor
    forgets.

    It goes on as it is: it acts ε-greedily, remembers, and measures its TD errors.
    """

    def on_drift(self, event, fresh=0):
        """From the first drift on the step size is 0."""
        frozen = event == "drift" or self.adam.lr == 0
        super().on_drift(event, fresh)
        if frozen:
            self.adam.lr = 0.0


class Random:
    """A control: every action equally likely, whatever the state; the level of no learning.

    Evaluation has a generator of its own, so that it leaves the training as it was.
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
        """No TD error: a random policy has no Q."""
        return np.empty(0)

    def on_drift(self, event, fresh=0):
        """Nothing changes."""

    def end_episode(self, total, td_error):
        """Nothing changes."""

    def finish(self):
        return self

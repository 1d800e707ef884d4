"""GB-DQN, the paper: at each drift freeze Q and fit a new network to its Bellman residual.

    Q_m = Q_{m−1} + α_m h_m        Q_{m−1} = Σ_{j<m} α_j h_j  is frozen,  h_m(·; θ)  learns

Raw predictions are cached, as in gradient-boosting libraries: Q_{m−1}(s_i, a_i) and
Q_{m−1}(s'_i, ·) are stored beside the replay buffer, slot by slot. A training step evaluates only
h_m, however many boosters there are.
"""

import copy

import numpy as np

from . import bellman
from .boosting import Ensemble, closed_form_alpha
from .dqn import DQN
from .optim import Adam, clip_by_norm, polyak


class GBDQN(DQN):
    """Gradient-boosted DQN (Algorithm 1); settings choose between the readings of the paper.

    target (D6): "live" acts and bootstraps with Q_m, so h_m counts while it learns; "frozen" uses
    Q_{m−1}, as in Algorithm 1, so h_m counts only after the next drift. alpha: a number, or the
    closed form of Eq. 8 (then α is 1 while h_m learns). loss_on: fit α h (Eq. 5) or h (Algorithm 1)
    to the residual. Under every reading the first learner is a plain DQN (D8): live, α₁ = 1.
    """

    def __init__(self, state_dim, n_actions, config, rng):
        super().__init__(state_dim, n_actions, config, rng)
        self.ensemble = Ensemble(self.net)  # Q_{m−1}; it is its own target, Q̄_{m−1} = Q_{m−1} (D3)
        self.alpha = 1.0  # α_m
        self.q_frozen = np.zeros(config.capacity, np.float32)  # Q_{m−1}(s_i, a_i)
        self.q_frozen_next = np.zeros((config.capacity, n_actions), np.float32)  # Q_{m−1}(s'_i, ·)
        self.memo = np.empty(0), np.empty(0)  # the last s, Q_{m−1}(s, ·)

    @property
    def live(self):
        """Whether Q includes h_m while it learns."""
        return self.config.target == "live" or not len(self.ensemble)

    def q(self, s):
        """Q_m(s, ·) if live, else Q_{m−1}(s, ·): (…, d) → (…, A)."""
        q_frozen = self._frozen(s)
        return q_frozen + self.alpha * super().q(s) if self.live else q_frozen.copy()

    def staged_q(self, s):
        """Q_1(s, ·), Q_2(s, ·), … up to q(s): (…, d) → (stages, …, A)."""
        stages = self.ensemble.staged_q(s)
        return np.concatenate([stages, self.q(s)[None]]) if self.live else stages

    def observe(self, s, a, r, s2, terminated):
        slot = self.replay.add(s, a, r, s2, terminated)
        self.q_frozen[slot] = self._frozen(s)[a]
        self.q_frozen_next[slot] = self._frozen(s2)  # remembered for the next action
        self.steps += 1

    def _frozen(self, s):
        """Q_{m−1}(s, ·), remembered for the last s."""
        if not np.array_equal(s, self.memo[0]):
            self.memo = s.copy(), self.ensemble.q(s)
        return self.memo[1]

    def learn(self):
        """One update of θ_m towards the residual (Algorithm 1, lines 13–21); returns δ (B,)."""
        c, factor = self.config, self.alpha if self.config.loss_on == "alpha_h" else 1.0
        batch = self.replay.sample(c.batch_size, self.rng)
        q_next = self.q_frozen_next[batch.index]  # Q̄_{m−1}(s', ·)
        if self.live:
            h_next, _ = self.net.forward(self.theta_target, batch.s2)
            q_next = q_next + self.alpha * h_next  # Q̄_m(s', ·)
        y = bellman.td_target(batch.r, batch.terminated, q_next, c.gamma)  # (B,)
        residual = y - self.q_frozen[batch.index]  # Eq. 4
        h_all, cache = self.net.forward(self.theta, batch.s)  # (B, A)
        h = h_all[np.arange(len(y)), batch.a]
        error = residual - factor * h
        dq = factor * bellman.loss_gradient(error, batch.weight, batch.a, self.n_actions)
        grad = clip_by_norm(self.net.backward(self.theta, cache, dq), c.max_grad_norm)
        self.adam.step(self.theta, grad)
        polyak(self.theta_target, self.theta, c.tau)  # D9
        delta = residual - self.alpha * h if self.live else residual
        self.replay.update_priorities(batch.index, delta)
        return delta

    def on_drift(self, event, fresh=0):
        """Add a booster at a drift, none at a reset."""
        if event == "drift":
            self.fold_in(self._carried())
            self._new_booster()
        super().on_drift(event, fresh)

    def finish(self):
        """The agent with its last learner folded in if it does not count yet (Algorithm 1, end)."""
        if self.live:
            return self
        finished = copy.deepcopy(self)
        finished.fold_in()
        return finished

    def fold_in(self, carried=0.0):
        """Q_m = Q_{m−1} + α_m h_m (Eq. 9): freeze h_m and add it to the cached predictions, once.

        `carried` is the part of α_m that the next learner takes over if it starts from θ.
        """
        c, replay, slots = self.config, self.replay, self.replay.slots()
        h = self._predict(replay.s[slots])[np.arange(len(slots)), replay.a[slots]]  # (n,)
        h_next = self._predict(replay.s2[slots])  # (n, A)
        if len(slots) and c.alpha == "closed-form" and len(self.ensemble):
            q_next = self.q_frozen_next[slots] + (h_next if self.live else 0)
            y = bellman.td_target(replay.r[slots], replay.terminated[slots], q_next, c.gamma)
            # proportional to P · w (D7): the loss draws with P and weights with w
            weights = (len(slots) * replay.probabilities()) ** (1 - c.is_exponent)
            self.alpha = closed_form_alpha(y - self.q_frozen[slots], h, weights)
        self.ensemble.add(self.theta, self.alpha, carried)
        self.q_frozen[slots] += (self.alpha - carried) * h
        self.q_frozen_next[slots] += (self.alpha - carried) * h_next
        self.memo = np.empty(0), np.empty(0)

    def _predict(self, x, rows=1024):
        """h_m(x), (n, d) → (n, A), in pieces that fit into the processor's cache."""
        starts = range(0, max(len(x), 1), rows)
        return np.concatenate([self.net.forward(self.theta, x[i : i + rows])[0] for i in starts])

    def _new_booster(self):
        """Start h_{m+1} as a new network or, with warm_start, from the last learner."""
        c = self.config
        if not c.warm_start:
            self.theta = self.net.init(self.rng)
        if c.zero_output:
            self.net.layers(self.theta)[-1][...] = 0
        if not c.warm_start or c.zero_output:
            self.theta_target = self.theta.copy()
        if not (c.warm_start and c.keep_adam):
            self.adam = Adam(self.net.size, c.lr * c.lr_factor)
        self.alpha = self._next_alpha()

    def _next_alpha(self):
        # D15: a number takes the place of Eq. 8
        return 1.0 if self.config.alpha == "closed-form" else self.config.alpha

    def _carried(self):
        """The part of α_m that the next learner takes over: its whole α if it starts as h_m."""
        c = self.config
        return self._next_alpha() if c.warm_start and not c.zero_output else 0.0

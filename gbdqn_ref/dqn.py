"""DQN (Mnih et al. 2015) with a soft target network: GB-DQN's ancestor and first baseline."""

import numpy as np

from . import bellman, detect
from .nn import MLP
from .optim import Adam, clip_by_norm, polyak
from .replay import ProportionalReplay, RecencyReplay, UniformReplay


class DQN:
    """One network Q(s, a; θ), fitted to y = r + γ (1 − terminated) max_a' Q(s', a'; θ̄).

    An agent acts, observes and learns. It is told when the physics drift and when an episode
    ends. `config` is a config.Config; `rng` is the agent's only source of random numbers.
    """

    def __init__(self, state_dim, n_actions, config, rng):
        config = config.resolved()
        self.config, self.rng, self.n_actions = config, rng, n_actions
        self.net = MLP((state_dim, *config.hidden, n_actions))
        self.theta = self.net.init(rng)  # (P,)
        self.theta_target = self.theta.copy()
        self.adam = Adam(self.net.size, config.lr)
        self.replay = make_replay(config, state_dim)
        self.steps, self.episode_start, self.learning_starts = 0, 0, config.learning_starts
        self.explored_from, self.explore = 0, config.epsilon_start  # where ε starts to fall
        self.detector = detect.make_detector(config, state_dim, n_actions, rng)
        self.alarms = np.empty(0, int)  # steps

    def q(self, s):
        """Q(s, ·): (…, d) → (…, A)."""
        return self.net.forward(self.theta, s)[0]

    @property
    def epsilon(self):
        """ε of the next action; 0 where the behaviour is softmax."""
        c = self.config
        if c.behaviour == "softmax":
            return 0.0
        steps = self.steps - self.explored_from
        return bellman.epsilon_schedule(steps, self.explore, c.epsilon_end, c.epsilon_decay_steps)

    def act(self, s, greedy=False):
        """An action for the state s (d,): by the behaviour policy, or the greedy one."""
        if greedy:
            return int(self.q(s).argmax())
        if self.config.behaviour == "softmax":
            return bellman.softmax_sample(self.q(s), self.config.temperature, self.rng)
        return bellman.epsilon_greedy(self.q(s), self.epsilon, self.rng)

    def observe(self, s, a, r, s2, terminated):
        """Store a transition; `terminated` must not include truncation by a time limit."""
        self.replay.add(s, a, r, s2, terminated)
        self.steps += 1

    def learn(self):
        """One update of θ and θ̄ from one batch; returns the batch's TD errors δ (B,)."""
        c = self.config
        batch = self.replay.sample(c.batch_size, self.rng)
        q_next, _ = self.net.forward(self.theta_target, batch.s2)
        y = bellman.td_target(batch.r, batch.terminated, q_next, c.gamma)  # (B,)
        q, cache = self.net.forward(self.theta, batch.s)  # (B, A)
        delta = y - q[np.arange(len(y)), batch.a]
        dq = bellman.loss_gradient(delta, batch.weight, batch.a, self.n_actions)
        grad = clip_by_norm(self.net.backward(self.theta, cache, dq), c.max_grad_norm)
        self.adam.step(self.theta, grad)
        polyak(self.theta_target, self.theta, c.tau)  # at each update, not at each step (D9)
        self.replay.update_priorities(batch.index, delta)
        return delta

    def on_drift(self, event, fresh=0):
        """React to an event, a "drift" or "reset" of the physics `fresh` transitions ago.

        The settings decide what is kept. By default DQN keeps everything and continues to learn.
        """
        if event not in ("drift", "reset"):
            raise ValueError(f"an event is 'drift' or 'reset', not {event!r}")
        c = self.config  # D22: what is kept
        if not c.keep_adam:
            self.adam = Adam(self.theta.shape, c.lr)
        self.adam.lr = c.lr * c.lr_factor
        self._drop_data(fresh)
        if c.epsilon_restart:
            self.explored_from, self.explore = self.steps, max(self.epsilon, c.epsilon_restart)

    def _drop_data(self, fresh):
        """Keep the newest share of the older data; learning pauses until there is a full batch."""
        c, old = self.config, len(self.replay) - fresh
        if c.keep_data < 1:
            self.replay.keep(fresh + int(c.keep_data * old))
            wait = c.batch_size - len(self.replay)
            self.learning_starts = max(self.learning_starts, self.steps + wait)

    def end_episode(self, total, td_error):
        """Note an episode's return and mean |δ|; an agent that detects drifts looks for one.

        td_error is nan if the episode had no update.
        """
        start, self.episode_start = self.episode_start, self.steps
        change = self.detector.update(self.replay, start, total, td_error)
        if change is not None:
            self.alarms = np.append(self.alarms, self.steps)
            self.on_drift("drift", self.steps - change)

    def finish(self):
        """The agent to evaluate and save when training ends; self can still go on training."""
        return self


def make_replay(config, state_dim):
    """The replay buffer that the config names."""
    c = config
    if c.replay == "uniform":
        return UniformReplay(c.capacity, state_dim)
    proportional = dict(
        priority_offset=c.priority_offset,
        priority_exponent=c.priority_exponent,
        is_exponent=c.is_exponent,
        normalise=c.normalise,
    )
    if c.replay == "proportional":
        return ProportionalReplay(c.capacity, state_dim, **proportional)
    return RecencyReplay(
        c.capacity, state_dim, mix=c.mix, recency_rate=c.recency_rate, **proportional
    )

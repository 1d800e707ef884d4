"""One-step Q-learning in plain functions: target, loss, gradient, action selection.

Everything per sample has shape (B,). A (B, 1) would broadcast to (B, B), and the mean would then
silently cancel the weights.
"""

import numpy as np


def td_target(r, terminated, q_next, gamma):
    """y = r + γ (1 − terminated) max_a' Q̄(s', a')  (Eq. 4), shapes (B,), (B,), (B, A) → (B,).

    The paper omits (1 − terminated), so it adds the value of a state after the end (D1). Eq. 4
    prints Q_{m−1} for Q̄, the target network of its own section.
    A time limit is not a termination: a truncated transition still bootstraps.

    >>> r, terminated = np.array([-1.0, -1.0]), np.array([True, False])
    >>> td_target(r, terminated, np.array([[-50.0, -60.0], [-50.0, -60.0]]), 0.99)
    array([ -1. , -50.5])
    """
    shapes = r.shape, terminated.shape, q_next.shape
    assert r.shape == terminated.shape == q_next.shape[:-1], shapes
    return np.where(terminated, r, r + gamma * q_next.max(-1))


def weighted_loss(error, weight):
    """L = 1/B Σ ½ w_i e_i²  (Eq. 3 with e = y − Q, as a mean over the batch: D2), from two (B,)."""
    assert error.shape == weight.shape, (error.shape, weight.shape)
    return 0.5 * np.mean(weight * error**2)


def loss_gradient(error, weight, a, n_actions):
    """∂L/∂q (…, B, A) of weighted_loss: −w_i e_i / B at the action taken, 0 elsewhere.

    e_i = y_i − q_{i, a_i}. a has shape (B,), error and weight (…, B): each member of a stack has
    its own errors and weights.

    >>> loss_gradient(np.array([2.0, -1.0]), np.array([0.5, 1.0]), np.array([1, 0]), 2).tolist()
    [[0.0, -0.5], [0.5, 0.0]]
    """
    shapes = error.shape, weight.shape, a.shape
    assert error.shape == weight.shape and error.shape[-1:] == a.shape, shapes
    dq = np.zeros((*error.shape, n_actions), error.dtype)
    dq[..., np.arange(len(a)), a] = -weight * error / len(a)
    return dq


def softmax_policy(q, temperature):
    """π(a|s) = exp(Q(s, a)/τ) / Σ_a' exp(Q(s, a')/τ), over the last axis; τ > 0.

    >>> softmax_policy(np.array([1000.0, 1000.0, 999.0]), 1.0).round(3).tolist()
    [0.422, 0.422, 0.155]
    """
    if not temperature > 0:
        raise ValueError(f"temperature must be positive, not {temperature}")
    weights = np.exp((q - q.max(-1, keepdims=True)) / temperature)
    return weights / weights.sum(-1, keepdims=True)


def epsilon_schedule(step, start, end, decay_steps):
    """ε after `step` environment steps: linear from start to end over decay_steps, then constant.

    >>> [round(epsilon_schedule(step, 1.0, 0.05, 20_000), 4) for step in (0, 10_000, 90_000)]
    [1.0, 0.525, 0.05]
    """
    return start + (end - start) * min(1.0, step / decay_steps)


def epsilon_greedy(q, epsilon, rng):
    """A uniformly random action with probability ε, else the first best one: q (A,) → action."""
    if rng.random() < epsilon:
        return int(rng.integers(len(q)))
    return int(q.argmax())


def softmax_sample(q, temperature, rng):
    """An action drawn from π = softmax_policy(q, τ) (Algorithm 1 line 7): q (A,) → action."""
    return int(rng.choice(len(q), p=softmax_policy(q.astype(np.float64), temperature)))

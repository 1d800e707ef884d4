"""Adam, gradient clipping and Polyak averaging, on a flat θ (P,) or a stack of them (K, P)."""

import numpy as np

# Smaller moments of Adam are set to 0. They would become denormal numbers, which are slow.
TINY = 1e-30


class Adam:
    """Adam (Kingma & Ba 2015, Algorithm 1): θ ← θ − lr · m̂ / (√v̂ + eps).

    m̂ = m/(1 − β₁ᵗ), v̂ = v/(1 − β₂ᵗ), with m and v the running means of g and g². The first step
    moves every coordinate by lr against the sign of its gradient:

    >>> theta = np.zeros(3)
    >>> Adam(3, lr=0.1).step(theta, np.array([5.0, -0.01, 2.0]))
    >>> theta.round(6).tolist()
    [-0.1, 0.1, -0.1]
    """

    def __init__(self, size, lr, betas=(0.9, 0.999), eps=1e-8):
        self.lr, self.betas, self.eps = lr, betas, eps
        self.m, self.v = np.zeros(size, np.float32), np.zeros(size, np.float32)  # E[g], E[g²]
        self.t = 0

    def step(self, theta, grad):
        """Update θ in place; θ and grad have the shape `size`.

        The moments take θ's precision.
        """
        beta1, beta2 = self.betas
        self.m, self.v = (moment.astype(theta.dtype, copy=False) for moment in (self.m, self.v))
        self.t += 1
        self.m *= beta1
        self.m += (1 - beta1) * grad
        self.v *= beta2
        self.v += (1 - beta2) * grad**2
        correction1, correction2 = 1 - beta1**self.t, 1 - beta2**self.t
        theta -= self.lr / correction1 * self.m / (np.sqrt(self.v / correction2) + self.eps)
        if self.t % 100 == 0:
            for moment in (self.m, self.v):
                moment[np.abs(moment) < TINY] = 0


def clip_by_norm(grad, max_norm):
    """grad · min(1, max_norm / ‖grad‖₂), separately for each member of a stack.

    >>> clip_by_norm(np.array([[3.0, 4.0], [0.3, 0.4]]), 1.0).tolist()
    [[0.6000000000000001, 0.8], [0.3, 0.4]]
    """
    norm = np.sqrt(np.vecdot(grad, grad))[..., None]
    if norm.max() == np.inf:  # squares overflow before the gradient does: scale these rows down
        scale = np.where(norm == np.inf, np.abs(grad).max(-1, keepdims=True), 1)
        return clip_by_norm(grad / scale, max_norm / scale) * scale
    return grad * (max_norm / np.maximum(norm, max_norm))


def polyak(theta_target, theta, tau):
    """θ̄ ← (1 − τ) θ̄ + τ θ, in place (section "Ensemble Target Networks")."""
    theta_target *= 1 - tau
    theta_target += tau * theta

"""Adam, gradient clipping and Polyak averaging, each a line or two on a flat θ (P,) or a stack of them (K, P)."""

import numpy as np

TINY = 1e-30  # below this Adam's sums count as 0: on their way there they would become denormal, which is slow


class Adam:
    """Adam (Kingma & Ba 2015, Algorithm 1): θ ← θ − lr · m̂ / (√v̂ + eps).

    m̂ and v̂ are weighted means of g and of g² over the t steps so far, β₁ᵏ and β₂ᵏ being the weights k steps back:
    m̂ = Σ β₁ᵏ g / Σ β₁ᵏ. Kept are the sums above; those below are (1 − βᵗ)/(1 − β). (The authors keep (1 − β) times
    the sums, and call the division by 1 − βᵗ a bias correction.)

    The first step moves every coordinate by lr against the sign of its gradient:

    >>> theta = np.zeros(3)
    >>> Adam(3, lr=0.1).step(theta, np.array([5.0, -0.01, 2.0]))
    >>> theta.round(6).tolist()
    [-0.1, 0.1, -0.1]
    """

    def __init__(self, size, lr, betas=(0.9, 0.999), eps=1e-8):
        self.lr, self.betas, self.eps = lr, betas, eps
        self.m, self.v = np.zeros(size, np.float32), np.zeros(size, np.float32)  # Σ β₁ᵏ g, Σ β₂ᵏ g²
        self.t = 0

    def step(self, theta, grad):
        """Update θ in place; θ and grad have the shape given as size. The sums take on θ's precision."""
        beta1, beta2 = self.betas
        self.m, self.v = (total.astype(theta.dtype, copy=False) for total in (self.m, self.v))
        self.t += 1
        self.m *= beta1
        self.m += grad
        self.v *= beta2
        self.v += grad**2
        n1, n2 = (1 - beta1**self.t) / (1 - beta1), (1 - beta2**self.t) / (1 - beta2)
        k = n2**0.5  # √v̂ = √v / k: k goes to the scalars, which spares a pass over θ
        theta -= self.lr * k / n1 * self.m / (np.sqrt(self.v) + self.eps * k)
        if self.t % 100 == 0:
            for total in (self.m, self.v):
                total[np.abs(total) < TINY] = 0


def clip_by_norm(grad, max_norm):
    """grad · min(1, max_norm / ‖grad‖₂), the norm over the last axis: members of a stack are clipped independently.

    >>> clip_by_norm(np.array([[3.0, 4.0], [0.3, 0.4]]), 1.0).tolist()
    [[0.6000000000000001, 0.8], [0.3, 0.4]]
    """
    norm = np.sqrt(np.vecdot(grad, grad))[..., None]
    return grad * (max_norm / np.maximum(norm, max_norm))


def polyak(theta_target, theta, tau):
    """θ̄ ← (1 − τ) θ̄ + τ θ, in place (section "Ensemble Target Networks"); τ = 1 copies, τ = 0 does nothing."""
    theta_target *= 1 - tau
    theta_target += tau * theta

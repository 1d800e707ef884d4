"""Gradient boosting of a Q-function (Eqs. 1–9): the additive ensemble Q_m = Σ α_j h_j and the step
size α_m.

Letters: h a booster (one network) or its predictions, α its weight, r_i its target, the Bellman
residual y_i − Q_{m−1}(s_i, a_i) of Eq. 4; m boosters, θ (m, P) their parameters as one stack.
"""

import numpy as np

LARGEST, LARGEST_32 = (float(np.finfo(kind).max) for kind in (np.float64, np.float32))


def closed_form_alpha(residual, h, weights=None):
    """α = A/B = Σ w_i r_i h_i / Σ w_i h_i² (Eq. 8), which minimises Σ w_i (r_i − α h_i)² (Eq. 7),
    shapes (n,).

    The loss falls by exactly A²/B (Theorem 1). Without weights all w_i = 1, as the paper prints it;
    only with the weights of the training loss does it minimise that loss (D7). Where h = 0 on the
    whole sample every α is optimal and the formula reads 0/0: the answer is 0, which adds nothing.
    An α that no float can hold becomes the largest float.

    >>> closed_form_alpha(np.array([2.0, -1.0]), np.array([1.0, 1.0]))
    0.5
    >>> closed_form_alpha(np.array([2.0, -1.0]), np.array([1.0, 1.0]), np.array([0.25, 1.0]))
    -0.4
    """
    residual, h = np.asarray(residual, np.float64), np.asarray(h, np.float64)
    weights = np.ones_like(h) if weights is None else np.asarray(weights, np.float64)
    assert residual.shape == h.shape == weights.shape, (residual.shape, h.shape, weights.shape)
    scale = np.abs(h).max(initial=0.0) or 1.0  # h² of a tiny h would underflow to 0
    unit = h / scale
    A, B = np.vecdot(weights * residual, unit), np.vecdot(weights * unit, unit)
    alpha = float(A / B) / float(scale) if B != 0 else 0.0
    return min(max(alpha, -LARGEST), LARGEST)


class Ensemble:
    """Q_m(s, a) = Σ_{j≤m} α_j h_j(s, a) = Q_{m−1}(s, a) + α_m h_m(s, a)  (Eq. 1).

    All m boosters are frozen: add() is the only change there is. The empty ensemble is the zero
    function.
    """

    def __init__(self, net):
        self.net = net
        self.theta = np.empty((0, net.size), np.float32)  # (m, P)
        self.alpha = np.empty(0, np.float32)  # (m,)

    def __len__(self):
        return len(self.alpha)

    def add(self, theta, alpha):
        """Q_m = Q_{m−1} + α_m h_m (Eq. 9): freeze a copy of θ (P,) as the newest booster.

        FloatingPointError if α is beyond float32.
        """
        if not abs(alpha) <= LARGEST_32:
            raise FloatingPointError(f"float32 cannot hold this step size of a booster: {alpha}")
        self.theta = np.concatenate([self.theta, theta[None]])
        self.alpha = np.append(self.alpha, np.float32(alpha))

    def terms(self, x):
        """α_j h_j(x) of every booster: x (…, d) → (m, …, A)."""
        h, _ = self.net.forward(self.theta, x.reshape(-1, x.shape[-1]))  # (m, B, A)
        return (self.alpha[:, None, None] * h).reshape(
            len(self), *x.shape[:-1], self.net.widths[-1]
        )

    def q(self, x):
        """Q_m(x), (…, d) → (…, A)."""
        return (
            self.terms(x).sum(0)
            if len(self)
            else np.zeros((*x.shape[:-1], self.net.widths[-1]), np.float32)
        )

    def staged_q(self, x):
        """Q_1(x), …, Q_m(x), (…, d) → (m, …, A): how the ensemble's answer grew, booster by
        booster.
        """
        return self.terms(x).cumsum(0)

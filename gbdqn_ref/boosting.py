"""Gradient boosting of a Q-function (Eqs. 1–9): the ensemble Q_m = Σ α_j h_j and its step α_m.

Letters: h a booster (one network) or its predictions, α its weight, r_i its target, which is the
Bellman residual y_i − Q_{m−1}(s_i, a_i) of Eq. 4; m boosters, θ (m, P) their stacked parameters.
"""

import numpy as np

LARGEST, LARGEST_32 = (float(np.finfo(kind).max) for kind in (np.float64, np.float32))


def closed_form_alpha(residual, h, weights=None):
    """α = A/B = Σ w_i r_i h_i / Σ w_i h_i² (Eq. 8), the minimiser of Σ w_i (r_i − α h_i)² (Eq. 7).

    All shapes are (n,). The loss falls by exactly A²/B (Theorem 1). Without weights all w_i = 1, as
    the paper prints it; α minimises the training loss only with that loss's weights (D7). If h = 0
    on the whole sample, the formula is 0/0 and every α is optimal; the result is 0, which adds
    nothing. An α beyond the largest float becomes that float.

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

    All m boosters are frozen; the empty ensemble is the zero function. Stage k is Q right after
    booster k was frozen, stored as a row of weights:

        | α₁        |     Q_1 = α₁ h₁
        | α₁ α₂     |     Q_2 = α₁ h₁ + α₂ h₂
        | α₁ 0  α₃  |     Q_3 = α₁ h₁ + α₃ h₃, after use(0)
    """

    def __init__(self, net):
        self.net = net
        self.theta = np.empty((0, net.size), np.float32)  # (m, P)
        self.alpha = np.empty(0, np.float32)  # (m,)
        self.weight = np.empty(0, np.float32)  # (m,) of each booster in the current sum
        self.rows = np.empty(0, np.float32)  # the stages' weights, concatenated

    def __len__(self):
        return len(self.alpha)

    def add(self, theta, alpha, carried=0.0):
        """Q_m = Q_{m−1} + α_m h_m (Eq. 9): freeze a copy of θ (P,) as the newest booster.

        If the next learner starts from θ, it takes over `carried` of α_m, and the current sum keeps
        the rest. FloatingPointError if float32 cannot hold α.
        """
        if not abs(alpha) <= LARGEST_32:
            raise FloatingPointError(f"float32 cannot hold a booster's step size of {alpha}")
        self.theta = np.concatenate([self.theta, theta[None]])
        self.alpha = np.append(self.alpha, np.float32(alpha))
        self.rows = np.concatenate([self.rows, self.weight, self.alpha[-1:]])
        self.use(len(self) - 1, carried)

    def use(self, k, carried=0.0):
        """Make stage k the current sum, less `carried` of its last booster."""
        self.weight = self.stages()[k]
        self.weight[k] -= np.float32(carried)

    def stages(self):
        """The weights (m, m) of the boosters in Q_1, …, Q_m."""
        weights = np.zeros((len(self), len(self)), np.float32)
        weights[np.tril_indices(len(self))] = self.rows
        return weights

    def boosters(self, x):
        """h_j(x) of every booster: x (…, d) → (m, …, A)."""
        h, _ = self.net.forward(self.theta, x.reshape(-1, x.shape[-1]))  # (m, B, A)
        return h.reshape(len(self), *x.shape[:-1], self.net.widths[-1])

    def terms(self, x):
        """w_j h_j(x) of every booster in the current sum: x (…, d) → (m, …, A)."""
        h = self.boosters(x)
        return self.weight.reshape(-1, *[1] * (h.ndim - 1)) * h

    def q(self, x):
        """Q_m(x), (…, d) → (…, A)."""
        if not len(self):
            return np.zeros((*x.shape[:-1], self.net.widths[-1]), np.float32)
        return self.terms(x).sum(0)

    def staged_q(self, x):
        """Q_1(x), …, Q_m(x), (…, d) → (m, …, A): Q after each booster was frozen."""
        return np.tensordot(self.stages(), self.boosters(x), 1)

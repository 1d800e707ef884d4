"""Finite MDPs, where the Bellman operator and Q* are exact, so the theorems can be decided.

Letters: S states, A actions, P (S, A, S) transition probabilities, r (S, A) expected rewards, γ
discount; Q (S, A). A terminal state loops on itself with reward 0, so its value is 0 and needs no
special case. Arrays of Fractions (dtype object) work everywhere but in q_star, which takes a limit.
"""

import numpy as np


class MDP:
    """A finite Markov decision process (P, r, γ).

    One state that loops on itself for a reward of 1: Q* = 1 / (1 − γ).

    >>> MDP(np.ones((1, 1, 1)), np.ones((1, 1)), 0.5).q_star().round(9)
    array([[2.]])
    """

    def __init__(self, P, r, gamma):
        self.P, self.r, self.gamma = np.asarray(P), np.asarray(r), gamma
        if self.r.ndim != 2 or self.P.shape != (*self.r.shape, self.r.shape[0]):
            raise ValueError(
                f"P must be (S, A, S) and r (S, A), not {self.P.shape} and {self.r.shape}"
            )
        if not 0 <= gamma < 1:
            raise ValueError(f"gamma must be in [0, 1), not {gamma}")
        if (self.P < 0).any() or not np.allclose(self.P.sum(-1).astype(float), 1):
            raise ValueError("each P[s, a] must be a probability distribution over the next states")

    def bellman(self, Q):
        """(𝒯*Q)(s, a) = r(s, a) + γ Σ_s' P(s'|s, a) max_a' Q(s', a')."""
        return self.r + self.gamma * (self.P @ Q.max(-1))

    def residual(self, Q):
        """g = 𝒯*Q − Q, the Bellman residual, (S, A)."""
        return self.bellman(Q) - Q

    def bellman_error(self, Q, mu):
        """E_μ(Q) = Σ μ(s, a) (𝒯*Q − Q)²  (Theorem 2), with μ (S, A)."""
        return (mu * self.residual(Q) ** 2).sum()

    def q_star(self, tolerance=1e-12):
        """Q*, by value iteration: ‖Q − Q*‖∞ ≤ tolerance.

        It stops once ‖𝒯*Q − Q‖∞ ≤ (1 − γ) · tolerance, or when rounding keeps the residual from
        falling.
        """
        Q, last = np.zeros(self.r.shape), np.inf
        while True:
            g = self.residual(Q)
            size = np.abs(g).max()
            if not tolerance * (1 - self.gamma) < size < last:
                return Q
            Q, last = Q + g, size

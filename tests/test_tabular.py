"""The Bellman operator, compared with loops and with the theory of finite MDPs."""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from strategies import mdps, rngs

from gbdqn_ref.tabular import MDP


def loops(mdp, Q):
    """(𝒯*Q)(s, a) = r(s, a) + γ Σ_s' P(s'|s, a) max_a' Q(s', a'), one number at a time."""
    backup = np.empty_like(Q)
    for s, a in np.ndindex(Q.shape):
        expected = sum(mdp.P[s, a, s2] * max(Q[s2]) for s2 in range(len(Q)))
        backup[s, a] = mdp.r[s, a] + mdp.gamma * expected
    return backup


def chain():
    """Action 0 stays for reward 0; action 1 moves 0 to 1 with probability ½ and earns 1 in 1."""
    P = np.array([[[F(1), F(0)], [F(1, 2), F(1, 2)]], [[F(0), F(1)], [F(0), F(1)]]])
    return MDP(P, np.array([[F(0), F(0)], [F(0), F(1)]]), F(1, 2))


@given(mdps(), rngs())
def test_the_bellman_operator_matches_the_loops(mdp, rng):
    Q = rng.normal(size=mdp.r.shape)
    np.testing.assert_allclose(mdp.bellman(Q), loops(mdp, Q), atol=1e-12)
    np.testing.assert_allclose(mdp.residual(Q), loops(mdp, Q) - Q, atol=1e-12)


@given(mdps(), rngs())
def test_the_bellman_operator_is_a_gamma_contraction(mdp, rng):
    one, other = rng.normal(scale=10, size=(2, *mdp.r.shape))
    apart = np.abs(mdp.bellman(one) - mdp.bellman(other)).max()
    assert apart <= mdp.gamma * np.abs(one - other).max() + 1e-12


@given(mdps())
def test_q_star_is_the_fixed_point(mdp):
    Q = mdp.q_star()
    np.testing.assert_allclose(mdp.bellman(Q), Q, atol=1e-12)


@given(mdps(), rngs())
def test_no_policy_is_better_than_q_star(mdp, rng):
    """Q^π = r + γ P_π Q^π is nowhere above Q*, and equals it if π is greedy in Q*."""
    Q, S = mdp.q_star(), np.arange(len(mdp.r))

    def value(policy):
        V = np.linalg.solve(np.eye(len(S)) - mdp.gamma * mdp.P[S, policy], mdp.r[S, policy])
        return mdp.r + mdp.gamma * mdp.P @ V

    assert (value(rng.integers(mdp.r.shape[1], size=len(S))) <= Q + 1e-9).all()
    np.testing.assert_allclose(value(Q.argmax(-1)), Q, atol=1e-9)


def test_fractions_stay_fractions():
    mdp, Q = chain(), np.array([[F(1), F(-1)], [F(1, 3), F(2)]])
    # max Q = (1, 2), so half of P max Q is (1/2, 3/4) in state 0, and (1, 1) in state 1
    assert mdp.bellman(Q).tolist() == [[F(1, 2), F(3, 4)], [F(1), F(2)]]
    assert mdp.residual(Q).tolist() == [[F(-1, 2), F(7, 4)], [F(2, 3), F(0)]]
    assert mdp.bellman_error(Q, np.full((2, 2), F(1, 4))) == (F(1, 4) + F(49, 16) + F(4, 9)) / 4


def test_q_star_by_hand():
    """V(1) = 1 + V(1)/2 = 2, and V(0) = (V(0) + V(1))/4 = 2/3."""
    mdp = chain()
    Q = MDP(mdp.P.astype(float), mdp.r.astype(float), 0.5).q_star()
    np.testing.assert_allclose(Q, [[1 / 3, 2 / 3], [1, 2]], atol=1e-12)


def test_the_bellman_error_by_hand():
    """One state that loops with reward 1: the residual of Q = 3 is 1 + 3/2 − 3 = −1/2."""
    loop = MDP(np.ones((1, 1, 1)), np.ones((1, 1)), 0.5)
    assert loop.bellman_error(np.array([[3.0]]), np.array([[0.8]])) == pytest.approx(0.8 * 0.25)


LOOP = np.ones((1, 1, 1))
NEGATIVE = np.array([[[1.5, -0.5]], [[0.0, 1.0]]])
BAD = {
    "P without actions": (np.ones((1, 1)), np.ones((1, 1)), 0.5, "P must be"),
    "P and r of other sizes": (LOOP, np.ones((1, 2)), 0.5, "P must be"),
    "P with an axis too many": (np.ones((1, 1, 1, 1)), np.ones((1, 1)), 0.5, "P must be"),
    "r without actions": (np.eye(2), np.ones(2), 0.5, "P must be"),
    "negative probabilities": (NEGATIVE, np.ones((2, 1)), 0.5, "probability"),
    "probabilities that do not sum to 1": (0.9 * LOOP, np.ones((1, 1)), 0.5, "probability"),
    "probabilities that are NaN": (np.nan * LOOP, np.ones((1, 1)), 0.5, "probability"),
    "a discount of 1": (LOOP, np.ones((1, 1)), 1.0, "gamma"),
    "a negative discount": (LOOP, np.ones((1, 1)), -0.1, "gamma"),
    "a discount that is NaN": (LOOP, np.ones((1, 1)), np.nan, "gamma"),
}


@pytest.mark.parametrize(("P", "r", "gamma", "message"), BAD.values(), ids=BAD)
def test_an_invalid_mdp_is_refused(P, r, gamma, message):
    with pytest.raises(ValueError, match=message):
        MDP(P, r, gamma)


@pytest.mark.parametrize(("gamma", "r"), [(0.99, 100.0), (0.999, 1.0), (0.999, 100.0)])
def test_value_iteration_ends_despite_rounding(gamma, r):
    """With two alternating states, errors of a few units in the last place rotate forever."""
    Q = MDP(np.eye(2)[[[1], [0]]], np.array([[r], [-r]]), gamma).q_star()
    np.testing.assert_allclose(Q, [[r / (1 + gamma)], [-r / (1 + gamma)]], rtol=1e-9)

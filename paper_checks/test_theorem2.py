"""Theorem 2: boosting whose Bellman error E_μ falls at each step converges to Q*. Its hypothesis does not give it.

E_μ(Q) = Σ μ (𝒯Q − Q)². A strict fall need not reach 0; the residual is not its gradient; and E_μ = 0 is Q* only where
μ looks everywhere.
"""

from fractions import Fraction as F
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.tabular import MDP

SEEDS = st.integers(0, 10**6)


def loops(rewards, gamma):
    """One state whose actions all stay in it, for these rewards."""
    return MDP(np.full((1, len(rewards), 1), F(1)), row(*rewards), gamma)


def row(*values):
    return np.array([[F(value) for value in values]])


def random_mdp(seed, gamma, S=3, A=2):
    rng = np.random.default_rng(seed)
    mdp = MDP(rng.dirichlet(np.ones(S), size=(S, A)), rng.normal(size=(S, A)), gamma)
    return mdp, rng.normal(size=(S, A)), rng.dirichlet(np.ones(S * A)).reshape(S, A)


def shrinking_steps(boosts):
    """E after each boost with the exact residual and α_m = 2/(m + 1)², on one loop without reward from Q = 2."""
    mdp, Q, errors = loops((0,), F(1, 2)), row(2), []
    for m in range(1, boosts + 1):
        errors.append(mdp.bellman_error(Q, row(1)))
        Q = Q + F(2, (m + 1) ** 2) * mdp.residual(Q)
    return Q, errors


@claim(
    "T2-a",
    place="Theorem 2",
    says="if every booster strictly lowers E_μ, E_μ tends to 0",
    verdict="fails: it may tend to anything",
    uses="tabular.MDP",
)
@pytest.mark.parametrize("boosts", [1, 5, 40])
def test_a_strict_fall_need_not_reach_0(boosts):
    """Q_m = (m + 2)/(m + 1) → 1: E falls from 1 at every step, to ¼, since the product of 1 − 1/(m + 1)² is ½."""
    Q, errors = shrinking_steps(boosts)
    assert Q[0, 0] == F(boosts + 2, boosts + 1)
    assert all(later < earlier for earlier, later in pairwise(errors))
    assert errors[-1] > F(1, 4)
    shows("1 state, 1 action, r = 0, γ = ½, exact residual, α_m = 2/(m + 1)²: E falls from 1 to ¼, strictly")


@control("T2-a")
def test_control_a_fall_by_a_fixed_part_does_reach_0():
    """Negative control, and what takes its place: E_m ≤ (1 − c) E_{m−1} with one c > 0; here α = 1 gives 1 − c = γ²."""
    mdp, Q = loops((0,), F(1, 2)), row(2)
    for m in range(12):
        assert mdp.bellman_error(Q, row(1)) == F(1, 4) ** m
        Q = Q + mdp.residual(Q)


def rising(gamma=F(9, 10)):
    """One state, two loops, Q = (0, 1) = Q*_old of r = (−0.9, 0.1), new rewards (0.1, 2.1): the residual is (1, 2)."""
    mdp, Q = loops((F(1, 10), F(21, 10)), gamma), row(0, 1)
    assert loops((F(-9, 10), F(1, 10)), F(9, 10)).residual(Q).tolist() == [[0, 0]]
    return mdp, Q


def error_along(mdp, Q, mu, alpha):
    return mdp.bellman_error(Q + alpha * mdp.residual(Q), mu)


@claim(
    "T2-b",
    place="Theorem 2, proof",
    says="the functional gradient of E_μ is proportional to the Bellman residual g",
    verdict="fails: it is 2 (γ P_π − I)ᵀ D g, which needs as many pairs as there are",
    uses="tabular.MDP",
)
@given(SEEDS, st.floats(0, 0.9))
def test_the_gradient_passes_through_the_target(seed, gamma):
    """Central differences of E_μ against the formula, away from ties; −2 D g is the gradient for a frozen target."""
    mdp, Q, mu = random_mdp(seed, gamma)
    gaps = np.sort(Q, -1)
    assume((gaps[:, -1] - gaps[:, -2]).min() > 1e-3)
    greedy = np.eye(2)[Q.argmax(-1)]  # (S, A)
    flow = gamma * mdp.P[..., None] * greedy  # how Q(s', a') enters 𝒯Q(s, a)
    weighted = mu * mdp.residual(Q)
    gradient = 2 * (np.einsum("sa,satb->tb", weighted, flow) - weighted)
    step = 1e-5
    for s, a in np.ndindex(3, 2):
        d = np.zeros((3, 2))
        d[s, a] = step
        slope = (mdp.bellman_error(Q + d, mu) - mdp.bellman_error(Q - d, mu)) / (2 * step)
        assert slope == pytest.approx(gradient[s, a], abs=1e-6)
    shows("central differences agree with 2 (γ P_π − I)ᵀ D g; with the target frozen it is −2 D g")


@claim(
    "T2-c",
    place="Theorem 2, proof",
    says="a small step along the Bellman residual lowers E_μ",
    verdict="fails: it can rise for every positive step",
    uses="tabular.MDP",
)
@pytest.mark.parametrize("alpha", [F(1, 1000), F(1, 10), F(1)])
def test_the_error_can_rise_along_the_residual(alpha):
    mdp, Q = rising()
    mu = row(F(1, 2), F(1, 2))
    assert error_along(mdp, Q, mu, alpha) == F(5, 2) + F(2, 5) * alpha + F(34, 100) * alpha**2
    shows("γ = 0.9, r = (0.1, 2.1), Q = (0, 1), uniform μ: E(α) = 2.5 + 0.4 α + 0.34 α²")


@claim(
    "T2-d",
    place="Theorem 2, proof",
    says="exact line search along the exact residual lowers E_μ unless Q is Q*",
    verdict="fails: the best step can be 0 far from Q*",
    uses="tabular.MDP",
)
def test_the_best_step_can_be_0():
    """A parabola with its vertex at 0 is given by three values; Q* = (19, 21), and E stays at 3."""
    mdp, Q = rising()
    mu = row(F(1, 3), F(2, 3))
    assert [error_along(mdp, Q, mu, alpha) for alpha in (F(-1), F(0), F(1))] == [F(81, 25), 3, F(81, 25)]
    np.testing.assert_allclose(MDP(mdp.P.astype(float), mdp.r.astype(float), 0.9).q_star(), [[19, 21]])
    shows("the same with μ = (⅓, ⅔): E(α) = 3 + 0.24 α², whose best step is 0; Q* = (19, 21)")


@control("T2-b", "T2-c", "T2-d")
@pytest.mark.parametrize("alpha", [F(1, 1000), F(1, 10), F(1)])
def test_control_with_a_frozen_target_or_a_short_horizon_it_falls(alpha):
    """Negative control: with γ = 0 nothing passes through the target, and the residual is the way down."""
    mdp, Q = loops((F(1, 10), F(21, 10)), F(0)), row(0, 1)
    for mu in (row(F(1, 2), F(1, 2)), row(F(1, 3), F(2, 3))):
        before, after = mdp.bellman_error(Q, mu), error_along(mdp, Q, mu, alpha)
        assert after == (1 - alpha) ** 2 * before < before


@claim(
    "T2-e",
    place="Theorem 2",
    says="learners that are dense in L2(μ) make E_μ fall monotonically to 0",
    verdict="fails: where μ leaves pairs out, an exact fit on μ can make it grow without bound",
    uses="tabular.MDP",
)
def test_a_class_that_is_dense_where_mu_looks_can_diverge():
    """μ on a₀ alone, so span{(1, 2)} is dense in L2(μ); r = 0, γ = 0.9: each exact fit multiplies E by (2γ)² = 3.24."""
    mdp, Q, mu = loops((0, 0), F(9, 10)), row(1, 2), row(1, 0)
    errors = []
    for _ in range(4):
        errors.append(mdp.bellman_error(Q, mu))
        Q = Q + mdp.residual(Q)[0, 0] * row(1, 2)
    assert errors == [F(64, 100) * F(324, 100) ** m for m in range(4)]
    shows("0.64, 2.0736, 6.7185, … × 3.24: μ on one of two actions, learners c · (1, 2)")


@claim(
    "T2-f",
    place="Theorem 2",
    says="what takes its place: with every pair in μ and exact fits, E_μ(Q_m) ≤ γ^{2m} E_μ(Q_0) / min μ, not monotone",
    verdict="holds",
    uses="tabular.MDP",
)
@given(SEEDS, st.floats(0, 0.95), st.integers(1, 8))
def test_with_full_support_exact_boosters_converge(seed, gamma, boosts):
    """‖g_m‖∞ ≤ γ^m ‖g_0‖∞, E_μ ≤ ‖g‖∞² and ‖g‖∞² ≤ E_μ / min μ."""
    mdp, Q, mu = random_mdp(seed, gamma)
    assume(mu.min() > 1e-6)
    start = mdp.bellman_error(Q, mu)
    for _ in range(boosts):
        Q = Q + mdp.residual(Q)
    assert mdp.bellman_error(Q, mu) <= gamma ** (2 * boosts) * start / mu.min() * (1 + 1e-9) + 1e-12
    shows(
        "random MDPs; it may rise first, 1 → 2γ² on the drifted loop, so the hypothesis fails where the outcome holds"
    )


@control("T2-e", "T2-f")
def test_control_with_both_actions_in_the_data_the_same_start_converges():
    """Negative control: fit the residual on both actions, and 3.24 a step becomes 0.81."""
    mdp, Q, mu = loops((0, 0), F(9, 10)), row(1, 2), row(F(1, 2), F(1, 2))
    errors = []
    for _ in range(4):
        errors.append(mdp.bellman_error(Q, mu))
        Q = Q + mdp.residual(Q)
    assert all(later == F(81, 100) * earlier for earlier, later in pairwise(errors[1:]))


@claim(
    "T2-i",
    place="Theorem 2, proof",
    says="E_μ → 0 implies Q → Q*",
    verdict="holds if every pair is in μ and there are finitely many: ‖Q − Q*‖∞ ≤ √(E_μ / min μ) / (1 − γ)",
    uses="tabular.MDP.q_star, tabular.MDP.bellman_error",
)
@given(SEEDS, st.floats(0, 0.95))
def test_a_small_error_everywhere_is_a_q_near_q_star(seed, gamma):
    """Q − Q* = (Q − 𝒯Q) + (𝒯Q − 𝒯Q*), whose second part is at most γ ‖Q − Q*‖∞."""
    mdp, Q, mu = random_mdp(seed, gamma)
    assume(mu.min() > 1e-6)
    bound = np.sqrt(mdp.bellman_error(Q, mu) / mu.min()) / (1 - gamma)
    assert np.abs(Q - mdp.q_star()).max() <= bound * (1 + 1e-9) + 1e-9
    shows("random MDPs; a loop with r = 1 meets the factor 1/(1 − γ) at Q = 0: residual 1, error 100 at γ = 0.99")


@control("T2-i")
def test_control_an_error_of_0_where_mu_looks_can_be_a_wrong_q():
    """Negative control: μ on a₀ alone, Q = (9, 10), r = 0, γ = 0.9: E = 0, Q* = (0, 0), wrong by 9 where μ looks."""
    mdp = loops((0, 0), F(9, 10))
    assert mdp.bellman_error(row(9, 10), row(1, 0)) == 0
    assert mdp.residual(row(0, 0)).tolist() == [[0, 0]]


@claim(
    "T2-k",
    place="Theorem 2, proof",
    says="𝒯 is a contraction in L2(μ)",
    verdict="fails: it is one in the sup norm; in L2(μ) it can stretch by √2 γ",
    uses="tabular.MDP.bellman",
)
def test_the_operator_can_stretch_in_l2():
    """Two states, both lead to the second: a difference of (0, 1) becomes (γ, γ)."""
    P = np.array([[[F(0), F(1)]], [[F(0), F(1)]]])
    mdp, gamma = MDP(P, np.array([[F(0)], [F(0)]]), F(9, 10)), F(9, 10)
    zero, d = np.array([[F(0)], [F(0)]]), np.array([[F(0)], [F(1)]])
    image = mdp.bellman(d) - mdp.bellman(zero)
    assert (image**2).sum() / (d**2).sum() == 2 * gamma**2 > 1
    shows("two states that lead to the second, uniform μ, γ = 0.9: a distance grows by the factor 1.27")


@control("T2-k")
def test_control_in_the_sup_norm_it_shrinks():
    """Negative control: the same two Qs are γ apart in the largest entry."""
    P = np.array([[[F(0), F(1)]], [[F(0), F(1)]]])
    mdp = MDP(P, np.array([[F(0)], [F(0)]]), F(9, 10))
    assert abs(mdp.bellman(np.array([[F(0)], [F(1)]])) - mdp.bellman(np.array([[F(0)], [F(0)]]))).max() == F(9, 10)


@claim(
    "T2-m",
    place="Theorem 2",
    says="the squared TD error of samples estimates E_μ",
    verdict="fails: it estimates E_μ plus the variance of the target",
    uses="tabular.MDP",
)
def test_noise_of_the_target_counts_as_error():
    """E[(y − Q)²] = (𝒯Q − Q)² + Var(y): a terminal reward of ±1 leaves 1 at Q*, where E_μ is 0."""
    P = np.array([[[F(0), F(1), F(0)]], [[F(0), F(1), F(0)]], [[F(0), F(1), F(0)]]])
    mdp = MDP(P, np.array([[F(0)], [F(0)], [F(0)]]), F(1, 2))  # the mean of ±1 is 0, and so is Q*
    Q, mu = np.array([[F(0)], [F(0)], [F(0)]]), np.array([[F(1)], [F(0)], [F(0)]])
    assert mdp.bellman_error(Q, mu) == 0
    assert sum(F(1, 2) * (y - Q[0, 0]) ** 2 for y in (-1, 1)) == 1
    shows("a terminal reward of ±1 with even odds: E_μ(Q*) = 0, mean squared TD error 1")


@control("T2-m")
def test_control_without_noise_the_two_agree():
    """Negative control: for a deterministic reward the squared TD error is E_μ."""
    mdp, Q = loops((F(3),), F(1, 2)), row(2)
    assert mdp.bellman_error(Q, row(1)) == (3 + F(1, 2) * 2 - 2) ** 2

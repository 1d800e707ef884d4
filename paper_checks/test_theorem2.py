"""Theorem 2: boosting whose Bellman error E_μ falls at each step converges to Q*. Its hypothesis
does not give it.

E_μ(Q) = Σ μ (𝒯Q − Q)². A strict fall need not reach 0; the residual is not its gradient; and E_μ =
0 is Q* only where μ looks everywhere.
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
    """E after each boost with the exact residual and α_m = 2/(m + 1)², on one loop without reward
    from Q = 2.
    """
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
    """Q_m = (m + 2)/(m + 1) → 1: E falls from 1 at every step, to ¼, since the product of 1 − 1/(m
    + 1)² is ½.
    """
    Q, errors = shrinking_steps(boosts)
    assert Q[0, 0] == F(boosts + 2, boosts + 1)
    assert all(later < earlier for earlier, later in pairwise(errors))
    assert errors[-1] > F(1, 4)
    shows(
        "1 state, 1 action, r = 0, γ = ½, exact residual, α_m = 2/(m + 1)²: E falls from 1 to ¼,"
        " strictly"
    )


@control("T2-a")
def test_control_a_fall_by_a_fixed_part_does_reach_0():
    """Negative control, and what takes its place: E_m ≤ (1 − c) E_{m−1} with one c > 0; here α = 1
    gives 1 − c = γ².
    """
    mdp, Q = loops((0,), F(1, 2)), row(2)
    for m in range(12):
        assert mdp.bellman_error(Q, row(1)) == F(1, 4) ** m
        Q = Q + mdp.residual(Q)


def rising(gamma=F(9, 10)):
    """One state, two loops, Q = (0, 1) = Q*_old of r = (−0.9, 0.1), new rewards (0.1, 2.1): the
    residual is (1, 2).
    """
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
    """Central differences of E_μ against the formula, away from ties; −2 D g is the gradient for a
    frozen target.
    """
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
    assert [error_along(mdp, Q, mu, alpha) for alpha in (F(-1), F(0), F(1))] == [
        F(81, 25),
        3,
        F(81, 25),
    ]
    np.testing.assert_allclose(
        MDP(mdp.P.astype(float), mdp.r.astype(float), 0.9).q_star(), [[19, 21]]
    )
    shows("the same with μ = (⅓, ⅔): E(α) = 3 + 0.24 α², whose best step is 0; Q* = (19, 21)")


@control("T2-b", "T2-c", "T2-d")
@pytest.mark.parametrize("alpha", [F(1, 1000), F(1, 10), F(1)])
def test_control_with_a_frozen_target_or_a_short_horizon_it_falls(alpha):
    """Negative control: with γ = 0 nothing passes through the target, and the residual is the way
    down.
    """
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
    """μ on a₀ alone, so span{(1, 2)} is dense in L2(μ); r = 0, γ = 0.9: each exact fit multiplies E
    by (2γ)² = 3.24.
    """
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
    says=(
        "what takes its place: with every pair in μ and exact fits, E_μ(Q_m) ≤ γ^{2m} E_μ(Q_0) /"
        " min μ, not monotone"
    ),
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
        "random MDPs; it may rise first, 1 → 2γ² on the drifted loop, so the hypothesis fails where"
        " the outcome holds"
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
    verdict=(
        "holds if every pair is in μ and there are finitely many: ‖Q − Q*‖∞ ≤ √(E_μ / min μ) / (1"
        " − γ)"
    ),
    uses="tabular.MDP.q_star, tabular.MDP.bellman_error",
)
@given(SEEDS, st.floats(0, 0.95))
def test_a_small_error_everywhere_is_a_q_near_q_star(seed, gamma):
    """Q − Q* = (Q − 𝒯Q) + (𝒯Q − 𝒯Q*), whose second part is at most γ ‖Q − Q*‖∞."""
    mdp, Q, mu = random_mdp(seed, gamma)
    assume(mu.min() > 1e-6)
    bound = np.sqrt(mdp.bellman_error(Q, mu) / mu.min()) / (1 - gamma)
    assert np.abs(Q - mdp.q_star()).max() <= bound * (1 + 1e-9) + 1e-9
    shows(
        "random MDPs; a loop with r = 1 meets the factor 1/(1 − γ) at Q = 0: residual 1, error 100"
        " at γ = 0.99"
    )


@control("T2-i")
def test_control_an_error_of_0_where_mu_looks_can_be_a_wrong_q():
    """Negative control: μ on a₀ alone, Q = (9, 10), r = 0, γ = 0.9: E = 0, Q* = (0, 0), wrong by 9
    where μ looks.
    """
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
    shows(
        "two states that lead to the second, uniform μ, γ = 0.9: a distance grows by the factor"
        " 1.27"
    )


@control("T2-k")
def test_control_in_the_sup_norm_it_shrinks():
    """Negative control: the same two Qs are γ apart in the largest entry."""
    P = np.array([[[F(0), F(1)]], [[F(0), F(1)]]])
    mdp = MDP(P, np.array([[F(0)], [F(0)]]), F(9, 10))
    assert abs(
        mdp.bellman(np.array([[F(0)], [F(1)]])) - mdp.bellman(np.array([[F(0)], [F(0)]]))
    ).max() == F(9, 10)


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


def test_countably_many_states_with_all_of_them_in_mu_are_not_enough():
    """k → k + 1 without reward, γ = 0.9, μ_k = 2^{−(k+1)}, Q_m(k) = 0.9^{−k} up to k = m: E → 0,
    and Q_m(0) = 1 stays.

    The residual is 0 but at k = m, where it is −0.9^{−m}: E_m = 2^{−(m+1)} 0.81^{−m}. Cut off at 80
    states.
    """
    P = np.zeros((81, 1, 81))
    P[np.arange(80), 0, np.arange(1, 81)] = P[80, 0, 80] = 1
    mdp, mu = MDP(P, np.zeros((81, 1)), 0.9), 0.5 ** np.arange(1, 82)[:, None]
    errors = []
    for m in (10, 30, 60):
        Q = np.where(np.arange(81) <= m, 0.9 ** -np.arange(81.0), 0)[:, None]
        errors.append(mdp.bellman_error(Q, mu))
        assert Q[0, 0] == 1 and mdp.q_star()[0, 0] == 0
        assert errors[-1] == pytest.approx(0.5 ** (m + 1) * 0.81**-m, rel=1e-9)
    assert errors[-1] < 1e-12


@claim(
    "T2-g",
    place="Theorem 2, proof",
    says="a falling sequence that is bounded below converges",
    verdict="holds",
    uses="tabular.MDP",
)
@pytest.mark.parametrize("boosts", [2, 10, 30])
def test_the_falling_errors_do_converge(boosts):
    """To their infimum, not to 0: of T2-a's sequence the m-th error is ((m + 1)/2m)², within 1/m of
    ¼.
    """
    _, errors = shrinking_steps(boosts)
    assert errors[-1] == F(boosts + 1, 2 * boosts) ** 2
    assert 0 < errors[-1] - F(1, 4) < F(1, boosts)
    shows("E_m = ((m + 1)/2m)² falls to its infimum ¼")


@claim(
    "T2-h",
    place="Theorem 2, proof",
    says="were the limit positive, one more step would lower it, a contradiction",
    verdict="fails: a step that lowers E_m below E_m need not lower it below the limit",
    uses="tabular.MDP",
)
@pytest.mark.parametrize("boosts", [2, 10, 30])
def test_each_further_step_lowers_it_and_none_reaches_the_limit(boosts):
    """At every m the next step lowers E, and it ends above ¼: no contradiction with a limit of
    ¼.
    """
    _, errors = shrinking_steps(boosts + 1)
    assert F(1, 4) < errors[-1] < errors[-2]
    shows("of T2-a's sequence: E_{m+1} < E_m and E_{m+1} > ¼ at every m")


@control("T2-g", "T2-h")
def test_control_steps_of_a_fixed_part_do_pass_every_positive_level():
    """Negative control: if each step takes a fixed part, as here with α = 1, no positive number is
    a limit.
    """
    mdp, Q = loops((0,), F(1, 2)), row(2)
    for _ in range(3):
        Q = Q + mdp.residual(Q)
    assert mdp.bellman_error(Q, row(1)) == F(1, 64) < F(1, 4)


@claim(
    "T2-j",
    place="Theorem 2",
    says="E_μ is a functional on L2(μ)",
    verdict=(
        "fails: 𝒯 looks where μ does not, so functions that are equal in L2(μ) have different E_μ"
    ),
    uses="tabular.MDP.bellman_error",
)
def test_equal_functions_have_different_errors():
    """μ on the first of two loops: Q = (9, 0) and (9, 10) are equal μ-almost everywhere."""
    mdp, mu = loops((0, 0), F(9, 10)), row(1, 0)
    assert mdp.bellman_error(row(9, 0), mu) == F(81, 100)
    assert mdp.bellman_error(row(9, 10), mu) == 0
    shows("μ = (1, 0), r = 0, γ = 0.9: E(9, 0) = 0.81, E(9, 10) = 0")


@control("T2-j")
def test_control_with_every_pair_in_mu_equal_functions_are_equal():
    mdp, mu = loops((0, 0), F(9, 10)), row(F(1, 2), F(1, 2))
    assert mdp.bellman_error(row(9, 0), mu) != mdp.bellman_error(row(9, 10), mu)
    assert (row(9, 0) != row(9, 10)).any()


@claim(
    "T2-l",
    place="Theorem 2",
    says="μ may be the distribution of the replay buffer",
    verdict="holds if it stands still; a μ that changes can undo each step by the next",
    uses="tabular.MDP.bellman_error",
)
def test_a_changing_mu_can_go_round_in_circles():
    """γ = 0, targets (1, 1), learners w · (1, −1): fitted to the first pair w = 1, to the second w
    = −1, and so on.
    """
    mdp, phi, w = loops((1, 1), 0), row(1, -1), F(0)
    for m in range(6):
        mu = row(1, 0) if m % 2 == 0 else row(0, 1)
        before = mdp.bellman_error(w * phi, mu)
        w += (mu * phi * mdp.residual(w * phi)).sum()  # the exact fit on this μ
        assert mdp.bellman_error(w * phi, mu) == 0 < before
        assert mdp.bellman_error(w * phi, row(1, 1)) == 4
    shows("γ = 0, μ on either pair in turn: every step takes its own E_μ to 0, and w = 1, −1, 1, …")


@control("T2-l")
def test_control_with_a_fixed_mu_it_settles():
    """Negative control: with both pairs in μ the best w is 0, found at once and kept."""
    mdp, phi, w, mu = loops((1, 1), 0), row(1, -1), F(1), row(F(1, 2), F(1, 2))
    for _ in range(3):
        w += (mu * phi * mdp.residual(w * phi)).sum()
        assert w == 0


@claim(
    "T2-o",
    place="Theorem 2, proof",
    says=(
        "what takes the place of the residual as a direction: d with d = g + 𝒯′(Q; d) lowers E_μ"
        " until Q = Q*"
    ),
    verdict=(
        "holds if there are finitely many pairs and μ has them all: E_μ has no other local minimum"
    ),
    uses="tabular.MDP",
)
@given(SEEDS, st.floats(0, 0.95))
def test_newtons_direction_always_descends(seed, gamma):
    """With one greedy action per state 𝒯′(Q; d) = γ P_π d, so d = (I − γ P_π)⁻¹ g, and E(Q + εd) =
    (1 − ε)² E(Q).

    Proof: 𝒯(Q + εd) − Q − εd = g + ε(γ P_π d − d) = (1 − ε) g as long as no greedy action changes.
    """
    mdp, Q, mu = random_mdp(seed, gamma)
    best = np.sort(Q, axis=1)
    assume((best[:, -1] - best[:, -2]).min() > 1e-3)
    g, greedy = mdp.residual(Q), np.eye(2)[Q.argmax(1)]
    P_pi = (mdp.P[..., None] * greedy[None, None]).reshape(6, 6)
    d = np.linalg.solve(np.eye(6) - gamma * P_pi, g.ravel()).reshape(3, 2)
    step = 1e-4 / (1 + np.abs(d).max())  # no greedy action changes
    change = mdp.bellman_error(Q + step * d, mu) / mdp.bellman_error(Q, mu)
    assert change == pytest.approx((1 - step) ** 2, rel=1e-9)
    shows("E(Q + εd) = (1 − ε)² E(Q) for small ε, d = (I − γP_π)⁻¹ g, on random MDPs")


@control("T2-o")
def test_control_the_residual_is_not_that_direction():
    """Negative control: in the example of T2-d the residual's best step is 0, and Newton's takes E
    to 0 at once.
    """
    mdp, Q = rising()
    mu, g = row(F(1, 3), F(2, 3)), mdp.residual(Q)
    P_pi = np.array([[0, 1], [0, 1]])  # the second action is greedy
    d = np.linalg.solve(np.eye(2) - 0.9 * P_pi, g.ravel().astype(float))
    assert mdp.bellman_error(Q.astype(float) + d, mu.astype(float)) == pytest.approx(0, abs=1e-12)
    assert error_along(mdp, Q, mu, F(1, 100)) > mdp.bellman_error(Q, mu)


@claim(
    "T2-p",
    place="Theorem 2, proof",
    says=(
        "where the residual does descend: evaluating a fixed policy, with μ its stationary"
        " distribution"
    ),
    verdict="holds",
    uses="tabular.MDP",
)
@given(SEEDS, st.floats(0, 0.95))
def test_policy_evaluation_descends_along_the_residual(seed, gamma):
    """There ‖P_π x‖_μ ≤ ‖x‖_μ (Jensen, and μP = μ), so ‖g + α(γP − I)g‖² ≤ (1 − 2α(1 − γ) + α²(1 +
    γ)²) ‖g‖².

    One action per state makes the MDP a policy. Least at α = (1 − γ)/(1 + γ)²: 1 − ((1 − γ)/(1 +
    γ))²; at α = 1 the residual is γ P g, so E falls to γ² E at least.
    """
    rng = np.random.default_rng(seed)
    P = rng.dirichlet(np.ones(4), size=4)
    mu = np.linalg.matrix_power(P, 200)[0]
    mdp, Q = MDP(P[:, None], rng.normal(size=(4, 1)), gamma), rng.normal(size=(4, 1))
    before = mdp.bellman_error(Q, mu[:, None])
    for alpha, factor in (
        ((1 - gamma) / (1 + gamma) ** 2, 1 - ((1 - gamma) / (1 + gamma)) ** 2),
        (1, gamma**2),
    ):
        assert (
            mdp.bellman_error(Q + alpha * mdp.residual(Q), mu[:, None])
            <= factor * before * (1 + 1e-9) + 1e-12
        )
    shows(
        "E falls to at most 1 − ((1 − γ)/(1 + γ))² of itself at α = (1 − γ)/(1 + γ)², to γ² at"
        " α = 1"
    )


@control("T2-p")
def test_control_with_another_mu_it_can_rise():
    """Negative control: s₀ → s₁ → s₁ and μ = (0.9, 0.1) is not stationary: at α = 1 E becomes 10 γ²
    of itself.
    """
    mdp = MDP(np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), np.zeros((2, 1)), 0.9)
    Q = np.array([[0.9], [1.0]])  # residuals 0 and −0.1
    mu = np.array([[0.9], [0.1]])
    before, after = mdp.bellman_error(Q, mu), mdp.bellman_error(Q + mdp.residual(Q), mu)
    assert before == pytest.approx(0.1 * 0.01) and after == pytest.approx(8.1 * before)

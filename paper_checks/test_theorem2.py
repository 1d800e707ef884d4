"""Theorem 2: boosting whose Bellman error E_μ falls at each step converges to Q*. Its hypothesis
does not give it.

E_μ(Q) = Σ μ (𝒯Q − Q)². A strict fall need not reach 0; the residual is its gradient only for a
fixed target; and E_μ = 0 is Q* only where μ looks everywhere.
"""

from fractions import Fraction as F
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import by_definition, column, exact, funnel, loop, loops, random_mdp, row

from gbdqn_ref.tabular import MDP

SEEDS = st.integers(0, 10**6)


def random_start(seed, gamma):
    """(a random MDP, Q, μ)."""
    rng = np.random.default_rng(seed)
    mdp = random_mdp(rng, gamma)
    return mdp, rng.normal(size=(3, 2)), rng.dirichlet(np.ones(6)).reshape(3, 2)


HALF = F(1, 2)


def errors_with_steps(alphas, gamma=HALF):
    """E before each boost with the exact residual and after the last, on one loop without reward
    from Q = 2.
    """
    mdp, Q, errors = loop(0, gamma), row(2), []
    for alpha in [*alphas, 0]:
        errors.append(mdp.bellman_error(Q, row(1)))
        Q = Q + alpha * mdp.residual(Q)
    return errors


def shrinking(boosts):
    """The steps α_m = 2/(m + 1)²."""
    return [F(2, (m + 1) ** 2) for m in range(1, boosts + 1)]


LIMIT = F(1, 4)  # of E with these steps, since the product of 1 − 1/(m + 1)² tends to ½


@claim("T2-a")
@pytest.mark.parametrize("boosts", [1, 5, 40])
def test_a_strict_fall_need_not_reach_0(boosts):
    """E falls from 1 at every step and stays above ¼, since Q_m = (m + 2)/(m + 1) → 1."""
    errors = errors_with_steps(shrinking(boosts))
    assert all(LIMIT < later < earlier for earlier, later in pairwise(errors))
    assert errors[-1] == F(boosts + 2, 2 * boosts + 2) ** 2
    shows(
        "1 state, 1 action, r = 0, γ = {}, exact residual, α_m = 2/(m + 1)²: E falls from {} to"
        " {}, strictly",
        *(HALF, errors[0], LIMIT),
    )


@control("T2-a")
def test_control_a_fall_by_a_fixed_part_does_reach_0():
    """With α = 1 every step leaves γ² of E."""
    assert errors_with_steps([1] * 12) == [F(1, 4) ** m for m in range(13)]


def rising(gamma=F(9, 10)):
    """Two loops and a Q that was right before the rewards drifted: the residual is (1, 2)."""
    old, rewards, Q = loops((F(-9, 10), F(1, 10)), F(9, 10)), (F(1, 10), F(21, 10)), row(0, 1)
    assert not old.residual(Q).any()
    return loops(rewards, gamma), Q


def parabola(mdp, Q, mu):
    """(a, b, c) with E(Q + αg) = a + b α + c α², from three values of α, where no greedy action
    changes.
    """
    low, middle, high = (mdp.bellman_error(Q + alpha * mdp.residual(Q), mu) for alpha in (-1, 0, 1))
    return middle, (high - low) / 2, (high + low) / 2 - middle


def slopes(error, Q, step=1e-5):
    """∂E/∂Q by central differences."""
    found = 0 * Q
    for pair in np.ndindex(Q.shape):
        d = 0 * Q
        d[pair] = step
        found[pair] = (error(Q + d) - error(Q - d)) / (2 * step)
    return found


def away_from_ties(Q):
    """Whether the two actions of every state differ by more than a small step."""
    return np.ptp(Q, axis=-1).min() > 1e-3


@claim("T2-b")
@given(SEEDS, st.floats(0, 0.9))
def test_with_the_target_held_fixed_it_is_the_residual(seed, gamma):
    """∂/∂Q(s, a) of Σ μ (y − Q)² is −2 μ g, and −2 g in L2(μ), which divides by μ."""
    mdp, Q, mu = random_start(seed, gamma)
    y = mdp.bellman(Q)
    frozen = slopes(lambda q: (mu * (y - q) ** 2).sum(), Q)
    np.testing.assert_allclose(frozen, -2 * mu * by_definition(mdp, Q), atol=1e-6)
    shows("target held fixed: −2 g in L2(μ), by central differences")


@claim("T2-b")
@given(SEEDS, st.floats(0, 0.9))
def test_the_gradient_passes_through_the_target(seed, gamma):
    """Central differences of E_μ against the formula, away from ties."""
    mdp, Q, mu = random_start(seed, gamma)
    assume(away_from_ties(Q))
    weighted = mu * mdp.residual(Q)
    flow = gamma * mdp.P[..., None] * np.eye(2)[Q.argmax(-1)]  # how Q(s', a') enters 𝒯Q(s, a)
    gradient = 2 * (np.einsum("sa,satb->tb", weighted, flow) - weighted)
    found = slopes(lambda q: (mu * by_definition(mdp, q) ** 2).sum(), Q)
    np.testing.assert_allclose(found, gradient, atol=1e-6)
    shows("target moving with Q: 2 (γ P_π − I)ᵀ D g, D = diag μ, away from ties")


@control("T2-b")
def test_control_with_a_target_that_moves_it_can_be_orthogonal_to_the_residual():
    """In the example of T2-d, by central differences, which are exact of a parabola; in L2(μ) the
    inner product with g is Σ μ (∇E/μ) g = Σ ∂E/∂Q g.
    """
    mdp, Q = rising()
    gradient, g = slopes(lambda q: mdp.bellman_error(q, UNEVEN), Q, F(1, 100)), mdp.residual(Q)
    assert gradient.tolist() == [[F(-2, 3), F(1, 3)]] and (gradient * g).sum() == 0


EVEN, UNEVEN = row(F(1, 2), F(1, 2)), row(F(1, 3), F(2, 3))


@claim("T2-c")
@pytest.mark.parametrize("alpha", [F(1, 1000), F(1, 10), F(1)])
def test_the_error_can_rise_along_the_residual(alpha):
    """E is a parabola whose slope at 0 is positive."""
    mdp, Q = rising()
    a, b, c = parabola(mdp, Q, EVEN)
    along = mdp.bellman_error(Q + alpha * mdp.residual(Q), EVEN)
    assert along == a + b * alpha + c * alpha**2 > a
    shows(
        "γ = {:g}, r = ({:g}), Q = ({}), uniform μ: E(α) = {:g} + {:g} α + {:g} α²",
        *(mdp.gamma, mdp.r, Q, a, b, c),
    )


@claim("T2-d")
def test_the_best_step_can_be_0():
    """The parabola has its vertex at 0, and Q is far from Q*."""
    mdp, Q = rising()
    a, b, c = parabola(mdp, Q, UNEVEN)
    optimal = MDP(mdp.P.astype(float), mdp.r.astype(float), 0.9).q_star()
    assert b == 0 < min(a, c) and abs(optimal - Q.astype(float)).min() > 10
    shows(
        "γ = {:g}, r = ({:g}), Q = ({}), μ = ({}): E(α) = {:g} + {:g} α², whose best step is {:g};"
        " Q* = ({:.0f})",
        *(mdp.gamma, mdp.r, Q, UNEVEN, a, c, -b / (2 * c), optimal),
    )


@control("T2-c", "T2-d")
@pytest.mark.parametrize("mu", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_control_without_a_future_it_falls(mu):
    """With γ = 0 nothing passes through the target, and E(α) = (1 − α)² E(0)."""
    a, b, c = parabola(*rising(gamma=F(0)), mu)
    assert (b, c) == (-2 * a, a)


def fitted(mu, boosts=4):
    """E at each boost, where the residual of the loops without reward is fitted in span{(1, 2)} on
    the pairs of μ alone, or on all if μ has them all.
    """
    mdp, Q, phi, errors = loops((0, 0), F(9, 10)), row(1, 2), row(1, 2), []
    for _ in range(boosts):
        errors.append(mdp.bellman_error(Q, mu))
        residual = mdp.residual(Q)
        Q = Q + (residual if mu.all() else residual[0, 0] * phi)
    return errors


@claim("T2-e")
def test_a_class_that_is_dense_where_mu_looks_can_diverge():
    """μ has the first pair alone, so the class is dense in L2(μ); each exact fit multiplies E by
    (2γ)².
    """
    errors = fitted(row(1, 0))
    factor = (2 * F(9, 10)) ** 2
    assert all(later == factor * earlier for earlier, later in pairwise(errors))
    shows(
        "{:.5g}, … × {:g}: μ on one of two actions, learners c · ({})",
        *(errors[:3], factor, row(1, 2)),
    )


@control("T2-e")
def test_control_with_both_actions_in_the_data_the_same_start_converges():
    """With the residual fitted on both, every further step leaves γ² of E."""
    errors = fitted(EVEN)
    assert all(later == F(81, 100) * earlier for earlier, later in pairwise(errors[1:]))


def after_exact_fits(mdp, Q, boosts):
    """Q after so many boosts with the exact residual."""
    for _ in range(boosts):
        Q = Q + mdp.residual(Q)
    return Q


@claim("T2-f")
@given(SEEDS, st.floats(0, 0.95), st.integers(1, 8))
def test_with_full_support_exact_boosters_converge(seed, gamma, boosts):
    """On random MDPs E, by the definition of 𝒯*, is at most γ^{2m} / min μ of the first one."""
    mdp, Q, mu = random_start(seed, gamma)
    assume(mu.min() > 1e-6)
    before, after = (
        (mu * by_definition(mdp, q) ** 2).sum() for q in (Q, after_exact_fits(mdp, Q, boosts))
    )
    assert after <= gamma ** (2 * boosts) * before / mu.min() * (1 + 1e-9) + 1e-12
    shows("random MDPs of {} states and {} actions", *Q.shape)


@claim("T2-f")
@pytest.mark.parametrize("boosts", [1, 2, 9])
def test_the_drifted_loop_attains_the_bound(boosts):
    """So no smaller factor would do, and E may rise before it falls."""
    gamma, mu = F(9, 10), row(F(3, 4), F(1, 4))
    mdp, Q = loops((0, 1), gamma), row(0, 0)
    found = [mdp.bellman_error(after_exact_fits(mdp, Q, m), mu) for m in (0, 1, boosts)]
    assert found[-1] == gamma ** (2 * boosts) * found[0] / mu.min()
    assert found[0] < found[1]
    shows(
        "two loops, r = ({}), Q = ({}), μ = ({}), γ = {:g}: E = {:g}, then {:g} = γ² E / min μ",
        *(mdp.r, Q, mu, gamma, *found[:2]),
    )


@control("T2-f")
def test_control_with_a_pair_that_mu_leaves_out_there_is_no_bound():
    """Where μ leaves out the pair with the error E starts at 0, and one exact fit of the rest does
    not keep it there.
    """
    mdp, Q, mu = loops((0, 0), F(9, 10)), row(9, 10), row(1, 0)
    before = mdp.bellman_error(Q, mu)
    assert before == 0 < mdp.bellman_error(after_exact_fits(mdp, Q, 1), mu)


def distance_and_bound(mdp, Q, mu):
    """(‖Q − Q*‖∞, √(E_μ / min μ) / (1 − γ)), E by the definition of 𝒯*."""
    Q = Q.astype(float)
    error = (mu * by_definition(mdp, Q) ** 2).sum()
    bound = np.sqrt(float(error / mu[mu > 0].min())) / (1 - mdp.gamma)
    return np.abs(Q - mdp.q_star()).max(), float(bound)


@claim("T2-i")
@given(SEEDS, st.floats(0, 0.95))
def test_a_small_error_everywhere_is_a_q_near_q_star(seed, gamma):
    """On random MDPs the distance to Q* is within the bound."""
    mdp, Q, mu = random_start(seed, gamma)
    assume(mu.min() > 1e-6)
    distance, bound = distance_and_bound(mdp, Q, mu)
    assert distance <= bound * (1 + 1e-9) + 1e-9
    shows("random MDPs of {} states and {} actions", *Q.shape)


@claim("T2-i")
def test_where_the_error_is_0_q_is_q_star():
    """Two loops with rewards (1, 0): E is 0 at (2, 1), and nothing else is Q*."""
    mdp, Q, mu = loops((1, 0), 0.5), row(2, 1), EVEN
    distance, bound = distance_and_bound(mdp, Q, mu)
    assert bound == 0 and distance < 1e-9
    shows("r = ({:g}), γ = {}: E = {:.0f} at Q = ({})", mdp.r, mdp.gamma, bound, Q)


@claim("T2-i")
def test_a_loop_meets_the_bound():
    """There the whole factor 1/(1 − γ) is between the residual and the distance."""
    mdp, Q, mu = loop(1, 0.99), row(0), row(1)
    distance, bound = distance_and_bound(mdp, Q, mu)
    assert distance == pytest.approx(bound)
    shows(
        "a loop with r = {} meets the factor 1/(1 − γ) at Q = {}: residual {}, error {:.0f} at"
        " γ = {}",
        *(mdp.r, Q, mdp.residual(Q), distance, mdp.gamma),
    )


@control("T2-i")
def test_control_an_error_of_0_where_mu_looks_can_be_a_wrong_q():
    """μ on the first pair alone: E = 0, and Q is wrong by 9 there."""
    distance, bound = distance_and_bound(loops((0, 0), 0.9), row(9, 10), row(1, 0))
    assert distance > bound + 9


@control("T2-i")
def test_control_countably_many_states_are_not_enough():
    """k → k + 1 without reward, γ = 0.9, μ_k = 2^{−(k+1)}, Q_m(k) = 0.9^{−k} up to k = m: E → 0,
    and Q_m(0) = 1 stays. Cut off at 80 states, where min μ is next to 0.
    """
    P = np.zeros((81, 1, 81))
    P[np.arange(80), 0, np.arange(1, 81)] = P[80, 0, 80] = 1
    mdp, mu = MDP(P, np.zeros((81, 1)), 0.9), 0.5 ** np.arange(1, 82)[:, None]
    for m in (10, 30, 60):
        Q = np.where(np.arange(81) <= m, 0.9 ** -np.arange(81.0), 0)[:, None]
        found = mdp.bellman_error(Q, mu)
        assert Q[0, 0] - mdp.q_star()[0, 0] == 1
        assert found == pytest.approx(0.5 ** (m + 1) * 0.81**-m, rel=1e-9)
    assert found < 1e-12


def stretched(size):
    """How much 𝒯 stretches a difference of (0, 1), by this measure of size; two states that both
    lead to the second, γ = 0.9.
    """
    mdp, zero, d = funnel(0, 0, F(9, 10)), column(0, 0), column(0, 1)
    return mdp.gamma, size(mdp.bellman(d) - mdp.bellman(zero)) / size(d)


@claim("T2-k")
def test_the_operator_can_stretch_in_l2():
    """Under the uniform μ, by √2 γ."""
    gamma, squared = stretched(lambda x: (x**2).sum())
    assert squared == 2 * gamma**2 > 1
    shows(
        "two states that lead to the second, uniform μ, γ = {:g}: a distance grows by the factor"
        " {:.2f}",
        *(gamma, float(squared) ** 0.5),
    )


@control("T2-k")
def test_control_in_the_sup_norm_it_shrinks():
    """The same two Qs are γ apart in the largest entry."""
    gamma, factor = stretched(lambda x: abs(x).max())
    assert factor == gamma < 1


def errors_of_samples(rewards):
    """(E_μ(Q*), the mean squared TD error at Q*) where the first state of the funnel pays these
    rewards with even odds.
    """
    mean = sum(exact(*rewards)) / len(rewards)
    mdp, Q = funnel(mean, 0, F(1, 2)), column(mean, 0)
    y = exact(*rewards) + mdp.gamma * Q[1].max()
    return mdp.bellman_error(Q, column(1, 0)), ((y - Q[0, 0]) ** 2).sum() / len(rewards)


@claim("T2-m")
def test_noise_of_the_target_counts_as_error():
    """E[(y − Q)²] = (𝒯Q − Q)² + Var(y)."""
    rewards = (1, -1)
    error, squared = errors_of_samples(rewards)
    assert (error, squared) == (0, np.var(rewards))
    shows(
        "a terminal reward of ±{} with even odds: E_μ(Q*) = {}, mean squared TD error {}",
        *(rewards[0], error, squared),
    )


@control("T2-m")
def test_control_without_noise_the_two_agree():
    """For a certain reward the squared TD error is E_μ."""
    error, squared = errors_of_samples((3, 3))
    assert error == squared == 0


@claim("T2-g")
@pytest.mark.parametrize("boosts", [1, 9, 29])
def test_the_falling_errors_do_converge(boosts):
    """To their infimum, not to 0: the m-th error of T2-a's sequence is within 1/m of it."""
    m, last = boosts + 1, errors_with_steps(shrinking(boosts))[-1]
    assert last == F(m + 1, 2 * m) ** 2
    assert 0 < last - LIMIT < F(1, m)
    shows("E_m = ((m + 1)/2m)² falls to its infimum {}", LIMIT)


@claim("T2-h")
@pytest.mark.parametrize("boosts", [2, 10, 30])
def test_each_further_step_lowers_it_and_none_reaches_the_limit(boosts):
    """At every m the next step lowers E, and it ends above the limit: no contradiction."""
    *_, before, after = errors_with_steps(shrinking(boosts))
    assert LIMIT < after < before
    shows("of T2-a's sequence: E_{{m+1}} < E_m and E_{{m+1}} > {} at every m", LIMIT)


@control("T2-g", "T2-h")
def test_control_steps_of_a_fixed_part_do_pass_every_positive_level():
    """If each step takes a fixed part, as with α = 1, no positive number is a limit."""
    assert errors_with_steps([1] * 3)[-1] < LIMIT


FIRST, SECOND = row(9, 0), row(9, 10)


@claim("T2-j")
def test_equal_functions_have_different_errors():
    """μ has the first of two pairs alone, where the two functions agree."""
    mdp, mu = loops((0, 0), F(9, 10)), row(1, 0)
    first, second = (mdp.bellman_error(Q, mu) for Q in (FIRST, SECOND))
    assert not (mu * (FIRST - SECOND) ** 2).any() and first != second
    shows(
        "μ = ({}), r = {}, γ = {:g}: E({}) = {:g}, E({}) = {:g}",
        *(mu, mdp.r[0, 0], mdp.gamma, FIRST, first, SECOND, second),
    )


@control("T2-j")
def test_control_where_nothing_comes_after_they_have_one_error():
    """With γ = 0 𝒯 looks nowhere else, and both have the same E."""
    mdp, mu = loops((0, 0), F(0)), row(1, 0)
    assert mdp.bellman_error(FIRST, mu) == mdp.bellman_error(SECOND, mu)


def fits(measures):
    """[(w, E before on this μ, after)] of exact fits in span{(1, −1)} on one μ after the other;
    γ = 0, targets (1, 1), from w = 0.
    """
    mdp, phi, w, found = loops((1, 1), 0), row(1, -1), F(0), []
    for mu in measures:
        before = mdp.bellman_error(w * phi, mu)
        w += (mu * phi * mdp.residual(w * phi)).sum() / (mu * phi**2).sum()
        found.append((w, before, mdp.bellman_error(w * phi, mu)))
    return found


@claim("T2-l")
def test_a_changing_mu_can_go_round_in_circles():
    """Fitted to the first pair and to the second in turn, each step takes its own E to 0 and undoes
    the one before.
    """
    found = fits([row(1, 0), row(0, 1)] * 3)
    assert all(after == 0 < before for _, before, after in found)
    w = [each for each, _, _ in found]
    assert w[2:] == w[:-2] and w[0] != w[1]
    shows(
        "γ = 0, μ on either pair in turn: every step takes its own E_μ to {}, and w = {}, …",
        *(found[-1][2], w[:3]),
    )


@control("T2-l")
def test_control_with_a_fixed_mu_it_settles():
    """With both pairs in μ the best w is found at once and kept."""
    assert len({w for w, _, _ in fits([EVEN] * 3)}) == 1


def newton(mdp, Q):
    """d = (I − γ P_π)⁻¹ g, with π greedy."""
    greedy = np.eye(Q.shape[1])[Q.argmax(1)]
    P_pi = (mdp.P.astype(float)[..., None] * greedy).reshape(Q.size, Q.size)
    g = mdp.residual(Q).astype(float)
    d = np.linalg.solve(np.eye(Q.size) - float(mdp.gamma) * P_pi, g.ravel())
    return d.reshape(Q.shape)


@claim("T2-o")
@given(SEEDS, st.floats(0, 0.95))
def test_newtons_direction_always_descends(seed, gamma):
    """Away from ties, by the factor (1 − ε)²."""
    mdp, Q, mu = random_start(seed, gamma)
    assume(away_from_ties(Q))
    d = newton(mdp, Q)
    step = 1e-4 / (1 + np.abs(d).max())  # no greedy action changes
    change = mdp.bellman_error(Q + step * d, mu) / mdp.bellman_error(Q, mu)
    assert change == pytest.approx((1 - step) ** 2, rel=1e-9)
    shows("E(Q + εd) = (1 − ε)² E(Q) for small ε, d = (I − γP_π)⁻¹ g, on random MDPs")


def test_newtons_direction_takes_the_example_to_0_at_once():
    """In the example of T2-d a whole step leaves nothing."""
    mdp, Q = rising()
    left = mdp.bellman_error(Q.astype(float) + newton(mdp, Q), UNEVEN.astype(float))
    assert left == pytest.approx(0, abs=1e-12)


@control("T2-o")
def test_control_the_residual_is_not_that_direction():
    """Without the term γ P_π d, d is the residual, whose best step in the example of T2-d is 0."""
    mdp, Q = rising()
    small = F(1, 100)
    assert mdp.bellman_error(Q + small * mdp.residual(Q), UNEVEN) > mdp.bellman_error(Q, UNEVEN)


def part_left(P, mu, Q, alpha, gamma, rewards=0):
    """E after a step along the residual, as a part of E before: evaluating one fixed policy."""
    mdp = MDP(P[:, None], np.zeros((len(P), 1)) + rewards, gamma)
    before = mdp.bellman_error(Q, mu[:, None])
    return mdp.bellman_error(Q + alpha * mdp.residual(Q), mu[:, None]) / before


@claim("T2-p")
@given(SEEDS, st.floats(0, 0.95))
def test_policy_evaluation_descends_along_the_residual(seed, gamma):
    """On random chains, at steps below 1, at 1 and above it."""
    rng = np.random.default_rng(seed)
    P = rng.dirichlet(np.ones(4), size=4)
    mu, rewards = np.linalg.matrix_power(P, 200)[0], rng.normal(size=(4, 1))
    Q = rng.normal(size=(4, 1))
    for alpha in (0.1, 0.5, 1, 1 + (1 - gamma) / (1 + gamma) / 2):  # half-way to 2/(1 + γ)
        factor = (abs(1 - alpha) + alpha * gamma) ** 2
        assert factor < 1
        assert part_left(P, mu, Q, alpha, gamma, rewards) <= factor * (1 + 1e-9) + 1e-12
    shows("E falls to at most (|1 − α| + αγ)² of itself for 0 < α < 2/(1 + γ)")


STICKY = np.array([exact(0, 1), exact(F(1, 9), F(8, 9))])  # stays nearly always in the second state
STATIONARY = exact(F(1, 10), F(9, 10))


def part_left_of_sticky(mu):
    """What a whole step leaves of E where the second state of STICKY alone has a residual."""
    return part_left(STICKY, mu, column(0, 0), 1, F(9, 10), column(0, 1))


@claim("T2-p")
def test_of_a_chain_that_stays_in_one_state_it_descends():
    """Under the stationary μ, though the residual moves to both states."""
    assert (STATIONARY @ STICKY).tolist() == STATIONARY.tolist()
    left = part_left_of_sticky(STATIONARY)
    assert left < F(9, 10) ** 2
    shows(
        "P = ({}; {}), μ = ({}), g = ({}), γ = {:g}: α = {:g} leaves {:.2f} of E",
        *(STICKY[0], STICKY[1], STATIONARY, column(0, 1), F(9, 10), F(1), left),
    )


@control("T2-p")
def test_control_under_a_uniform_mu_it_can_rise():
    """On the same chain."""
    assert part_left_of_sticky(exact(HALF, HALF)) > 1


def least_error(mdp, Q, mu, h):
    """(α, E) of the smallest E(Q + αh) on a grid of α, E by the definition of 𝒯*."""
    alphas = [F(n, 4) for n in range(-12, 13)]
    errors = [(mu * by_definition(mdp, Q + alpha * h) ** 2).sum() for alpha in alphas]
    return min(zip(errors, alphas, strict=True))[::-1]


@claim("T2-q")
@given(SEEDS, st.floats(0, 0.95))
def test_the_best_booster_and_step_take_e_to_0_at_once(seed, gamma):
    """On random MDPs with h = Q* − Q, the best step is 1."""
    mdp, Q, mu = random_start(seed, gamma)
    alpha, error = least_error(mdp, Q, mu, mdp.q_star() - Q)
    assert alpha == 1 and error < 1e-18
    shows("random MDPs: h = Q* − Q and α = {} leave E = {:.0f}", alpha, error)


@claim("T2-q")
def test_the_stuck_example_is_left_at_once():
    """There no step along the residual lowers E."""
    mdp, Q = rising()
    q_star = row(19, 21)
    assert not by_definition(mdp, q_star).any()
    alpha, error = least_error(mdp, Q, UNEVEN, q_star - Q)
    stuck, before = least_error(mdp, Q, UNEVEN, mdp.residual(Q))
    assert (alpha, error) == (1, 0) and stuck == 0 < before
    shows(
        "Q = ({}) of T2-d: the best step along g is {} and leaves E = {}, along h = ({}) it is {}"
        " and leaves {}",
        *(Q, stuck, before, q_star - Q, alpha, error),
    )


@control("T2-q")
def test_control_where_mu_leaves_a_pair_out_a_dense_class_may_have_no_better_function():
    """μ on the first of two loops, r = (1, 0), Q = 0, learners c · (γ, 1), which fit anything where
    μ looks: no c lowers E, so the best step is 0.
    """
    mdp, h = loops((1, 0), F(9, 10)), row(F(9, 10), 1)
    for sign in (1, -1):
        _, error = least_error(mdp, row(0, 0), row(1, 0), sign * h)
        assert error == mdp.bellman_error(row(0, 0), row(1, 0)) == 1

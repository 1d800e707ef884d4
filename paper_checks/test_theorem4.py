"""Theorem 4 and what the paper says of drift: stability, adaptation, and the signal that a drift
gives.

Part 1 is an identity, true of every update and so no guarantee. Part 2 fails under either reading
of its hypothesis.
"""

from fractions import Fraction as F
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import by_definition, column, exact, loop, loops, random_mdp, row

from gbdqn_ref.boosting import Ensemble, closed_form_alpha
from gbdqn_ref.nn import MLP
from gbdqn_ref.tabular import MDP

GAMMA = F(9, 10)


def change_and_h(alpha, seed=0):
    """(|Q_m − Q_{m−1}|, |h|, the rounding to expect) of a random ensemble and booster."""
    rng, net = np.random.default_rng(seed), MLP((2, 4, 3))
    ensemble, x = Ensemble(net), rng.normal(size=(5, 2)).astype(np.float32)
    ensemble.add(net.init(rng), 1.0)
    before = ensemble.q(x)
    ensemble.add(net.init(rng), alpha)
    rounding = 1e-6 * np.abs(ensemble.terms(x)).sum(0).max()
    h = np.abs(net.forward(ensemble.theta[-1], x)[0])
    return np.abs(ensemble.q(x) - before), h, rounding


@claim("T4-a")
@given(st.integers(0, 10**6), st.floats(-3, 3))
def test_a_booster_moves_q_by_alpha_h(seed, alpha):
    """|Q_m − Q_{m−1}| = |α| |h|, hence at most |α| ‖h‖∞."""
    change, h, rounding = change_and_h(alpha, seed)
    np.testing.assert_allclose(change, abs(np.float32(alpha)) * h, atol=rounding)
    assert change.max() <= abs(alpha) * h.max() + rounding
    shows("|Q_m − Q_{{m−1}}| = |α| |h| on random ensembles")


@claim("T4-a")
def test_the_closed_form_can_give_a_negative_bound():
    """Where the booster has the sign of the residual turned round."""
    residual, h = np.array([1.0, -3.0]), np.ones(2)
    alpha = closed_form_alpha(residual, h)
    assert alpha * np.abs(h).max() < 0
    shows(
        "Eq. 8 can give α < 0, as for r = ({}), h = ({}), where the printed bound is {}",
        *(residual, h, alpha * np.abs(h).max()),
    )


@control("T4-a")
def test_control_with_a_negative_alpha_the_printed_bound_does_not_hold():
    """No change is below 0, which α ‖h‖∞ is."""
    alpha = -1.0
    change, h, rounding = change_and_h(alpha)
    assert change.max() > alpha * h.max() + rounding


def moved(phi):
    """How the exact fit of one residual of 1 at the first pair moves Q, in span{φ}."""
    phi, residual = np.array(phi), np.array([1.0])
    return residual, closed_form_alpha(residual, phi[:1]) * phi


@claim("T4-b")
def test_a_residual_of_1_moves_an_unsampled_pair_by_1000():
    """The pair that is never sampled moves a thousand times as far as the one that is."""
    phi = (1.0, 1000.0)
    residual, (here, there) = moved(phi)
    assert here == residual and there == 1000 * here
    shows(
        "φ = ({}), sampled only at {} with residual {}: Q moves by {} there and by {} at the other"
        " pair",
        *(phi, phi.index(here), residual, here, there),
    )


@control("T4-b")
def test_control_a_table_moves_only_what_is_sampled():
    """Without generalisation, φ = (1, 0), the other pair stays."""
    assert moved((1.0, 0.0))[1].tolist() == [1, 0]


@control("T4-b")
@given(st.lists(st.floats(-9, 9), min_size=1, max_size=6), st.integers(0, 99))
def test_control_on_the_sample_it_is_bounded(residual, seed):
    """There ‖α h‖₂ ≤ ‖r‖₂, by Cauchy–Schwarz, so it is what is unseen that moves."""
    residual = np.array(residual)
    h = np.random.default_rng(seed).normal(size=len(residual))
    step = closed_form_alpha(residual, h) * h
    assert np.linalg.norm(step) <= np.linalg.norm(residual) * (1 + 1e-12)


def read_literally(boosts, slope=2):
    """Q(a₀) after each boost, where each α is Theorem 1's on the sample {a₀}, h the exact fit in
    span{(1, slope)}, y the frozen target. Q* = 0, and Q was right before the drift.
    """
    mdp, phi, values = loops((0, 0), GAMMA), row(1, slope), []
    assert not mdp.residual(row(0, 0)).any()
    Q = phi
    assert not loops(Q[0] - GAMMA * Q.max(), GAMMA).residual(Q).any()
    for _ in range(boosts):
        Q = Q + mdp.residual(Q)[0, 0] * phi
        values.append(Q[0, 0])
    return values


def boosted_on_the_data(data, boosts=1):
    """(Q, E on the data before and after exact boosts on it): two loops, whose rewards drift from
    (−9, 1) to (0, 0).
    """
    old, new, Q = loops((-9, 1), GAMMA), loops((0, 0), GAMMA), row(0, 10)
    assert not old.residual(Q).any() and not new.residual(row(0, 0)).any()
    before = new.bellman_error(Q, data)
    for _ in range(boosts):
        Q = Q + data * new.residual(Q)
    return Q, (before, new.bellman_error(Q, data))


@claim("T4-c")
def test_read_with_the_frozen_residual_it_diverges():
    """Each boost multiplies Q by 2γ on the data, where Q* is 0."""
    values = read_literally(4)
    assert all(later == 2 * GAMMA * earlier > earlier for earlier, later in pairwise(values))
    shows("frozen: {:.3g}, … for Q* = 0", values)


@claim("T4-c")
def test_read_with_the_true_residual_it_ends_at_a_wrong_q():
    """The error on the data falls to 0 in one boost, and Q is wrong on the data itself, where it
    was right.
    """
    after, (before, left) = boosted_on_the_data(row(1, 0))
    assert before > left == 0 and (after > 8).all()
    shows("true: error {} → {} in one boost, at ({}) for ({})", before, left, after, row(0, 0))


@pytest.mark.parametrize("boosts", [1, 10])
@pytest.mark.parametrize("slope", [2, F(3, 2)])
def test_the_literal_reading_multiplies_the_error_by_gamma_times_the_slope(boosts, slope):
    """With φ = (1, c) by γc at each boost."""
    assert read_literally(boosts, slope)[-1] == (GAMMA * slope) ** boosts


@control("T4-c")
def test_control_with_a_slope_of_1_the_literal_reading_converges():
    """Where the pair that is not sampled moves no further than the sampled one, γ is left each
    time.
    """
    assert read_literally(10, slope=1)[-1] == GAMMA**10


@control("T4-c")
@pytest.mark.parametrize(
    ("data", "adapts"), [(row(1, 0), False), (row(1, 1), True)], ids=["one", "both"]
)
def test_control_with_every_pair_in_the_data_it_adapts(data, adapts):
    """With both pairs in the data fifty boosts leave γ⁵⁰ of Q, with one of them they leave it."""
    after, _ = boosted_on_the_data(data, boosts=50)
    assert (abs(after).max() <= 10 * GAMMA**50) == adapts


def errors_with_misses(seed, gamma, alpha, miss, boosts=20):
    """‖Q_m − Q*‖∞ on a random MDP, at the start and after each booster that misses the residual, by
    the definition of 𝒯*, by at most so much at every pair.
    """
    rng = np.random.default_rng(seed)
    mdp = random_mdp(rng, gamma)
    Q, q_star, errors = rng.normal(size=(3, 2)), mdp.q_star(), []
    for _ in range(boosts + 1):
        errors.append(np.abs(Q - q_star).max())
        Q = Q + alpha * (by_definition(mdp, Q) + rng.uniform(-miss, miss, Q.shape))
    return errors


@claim("T4-d")
@given(st.integers(0, 10**6), st.floats(0, 0.9), st.floats(0.05, 1), st.floats(0, 0.5))
def test_with_sup_norm_errors_and_full_support_it_adapts(seed, gamma, alpha, miss):
    """The recursion, at every booster."""
    errors = errors_with_misses(seed, gamma, alpha, miss)
    kappa = 1 - alpha * (1 - gamma)
    assert all(later <= kappa * before + alpha * miss + 1e-9 for before, later in pairwise(errors))
    shows("e_m ≤ (1 − α(1 − γ)) e_{{m−1}} + α ε at every step, on random MDPs")


def signal_and_move(old, new):
    """(‖𝒯_new Q*_old − Q*_old‖∞ by the definition of 𝒯*, ‖ΔQ*‖∞)."""
    q_old = old.q_star()
    return np.abs(by_definition(new, q_old)).max(), np.abs(new.q_star() - q_old).max()


@claim("C1")
def test_a_drift_can_leave_q_star_and_delta_alone():
    """One action pays 1 and stays, then it pays 2 and ends the episode; the other one stays."""
    gamma, (paid, last), end = F(1, 2), (1, 2), column(0, 0).T
    old = loops((paid, 0), gamma)
    P = np.array([[exact(0, 1), exact(1, 0)], [exact(0, 1)] * 2])
    new, q_star = MDP(P, np.vstack([row(last, 0), end]), gamma), row(2, 1)
    delta = new.residual(np.vstack([q_star, end]))
    assert not old.residual(q_star).any() and not delta.any()
    shows(
        "two actions that stay, r = ({}); the first one then pays {} and ends: at γ = {} Q* = "
        "({}) before and after, δ = ({})",
        *(old.r, last, gamma, q_star, delta[0]),
    )


@claim("C1")
def test_any_new_transitions_can_leave_delta_at_0():
    """Where the reward is −1 everywhere."""
    reward, (stay, swap) = -1.0, (np.eye(2)[:, None], np.eye(2)[::-1, None])
    old, new = (MDP(P, np.full((2, 1), reward), 0.9) for P in (stay, swap))
    signal, _ = signal_and_move(old, new)
    assert signal < 1e-9
    shows("r = {} everywhere: any new transitions, δ = {:.0f}", reward, signal)


@claim("C1")
def test_a_drift_can_make_delta_negative():
    """A loop that paid nothing and now costs 1."""
    old, new, q_old = loop(0, GAMMA), loop(-1, GAMMA), row(0)
    assert old.residual(q_old) == 0 > new.residual(q_old)
    shows("r {} → {}: δ = {}", old.r, new.r, new.residual(q_old))


@claim("C1")
def test_a_drift_can_lower_the_error():
    """A Q of 10 was not right before, and is afterwards."""
    before, after = (abs(loop(reward, GAMMA).residual(row(10))).item() for reward in (0, 1))
    assert after < before
    shows("Q = {}, r {} → {}: |δ| {} → {}", row(10), *exact(0, 1), before, after)


@claim("C1")
@given(st.integers(0, 10**6), st.floats(0, 0.95))
def test_where_q_star_moves_some_td_error_is_not_0(seed, gamma):
    """On random pairs of MDPs |δ| is at least (1 − γ) ‖ΔQ*‖∞ > 0 somewhere (C2)."""
    rng = np.random.default_rng(seed)
    signal, moved = signal_and_move(random_mdp(rng, gamma), random_mdp(rng, gamma))
    assert signal > 0.99 * (1 - gamma) * moved > 0
    shows("where Q* moves, some |δ| > 0, on random pairs of MDPs")


@claim("C2")
@given(st.integers(0, 10**6), st.floats(0, 0.95))
def test_the_largest_td_error_tells_how_far_q_star_has_moved(seed, gamma):
    """On random pairs of MDPs."""
    rng = np.random.default_rng(seed)
    signal, moved = signal_and_move(random_mdp(rng, gamma), random_mdp(rng, gamma))
    assert (1 - gamma) * moved - 1e-9 <= signal <= (1 + gamma) * moved + 1e-9
    shows("random pairs of MDPs")


@claim("C2")
def test_one_more_reward_everywhere_attains_the_lower_bound():
    """Two loops that each pay 1 more than before."""
    gamma = 0.5
    signal, moved = signal_and_move(loops((0, -1), gamma), loops((1, 0), gamma))
    assert (signal, moved) == pytest.approx((1, 1 / (1 - gamma)), abs=1e-9)
    shows(
        "two loops, γ = {}, 1 more on each: largest |δ| {:.0f}, Q* moves by {:.0f}",
        gamma,
        signal,
        moved,
    )


@control("C1", "C2")
def test_control_a_pair_without_data_hides_the_drift():
    """The reward of the second action alone drifts; at the first, all that is sampled, δ is 0."""
    old, new = loops((1, 0), F(0)), loops((1, F(1, 2)), F(0))
    _, moved = signal_and_move(old, new)
    assert new.residual(old.r)[0, 0] == 0 < moved


def variance_of(weights, variance, correlation):
    """wᵀ Σ w for members with this variance and pairwise correlation."""
    k = len(weights)
    identity = np.array([[F(int(i == j)) for j in range(k)] for i in range(k)])
    return weights @ (variance * (correlation + (1 - correlation) * identity)) @ weights


@claim("C3")
def test_averaging_keeps_what_the_members_share():
    """The mean has σ²(ρ + (1 − ρ)/k), and the sum more than one member."""
    k, variance, correlation = 5, F(2), F(6, 10)
    mean, total = (
        variance_of(np.full(k, weight), variance, correlation) for weight in (F(1, k), F(1))
    )
    assert mean == variance * (correlation + (1 - correlation) / k) < variance < total
    shows(
        "k = {}, σ² = {}, ρ = {:g}: the mean {:g}, the additive sum {}",
        *(k, variance, correlation, mean, total),
    )


def test_gb_dqn_adds_and_does_not_average():
    """Five equal members give five times one of them."""
    net, x = MLP((1, 1)), np.ones((1, 1), np.float32)
    ensemble = Ensemble(net)
    for _ in range(5):
        ensemble.add(net.init(np.random.default_rng(0)), 1.0)
    np.testing.assert_allclose(ensemble.q(x), 5 * ensemble.terms(x)[0], rtol=1e-6)


@control("C3")
def test_control_without_correlation_the_mean_has_a_kth_of_the_variance():
    """Without the common error nothing of the floor is left."""
    assert variance_of(np.full(5, F(1, 5)), F(2), F(0)) == F(2) / 5

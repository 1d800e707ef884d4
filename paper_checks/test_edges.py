"""The edges of the theorems that hold instead: without any one of its assumptions, each fails.

Of T1-h, T2-o, T3-b and T4-d. The first test of each shows an example that meets all of the
assumptions; the others leave out one. Exact fractions wherever no limit is taken.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from ledger import claim, control, shows
from worlds import column, loops, row, swap

from gbdqn_ref.replay import mixed_priority, time_priority

GAMMA = F(9, 10)
OPPOSITE = column(1, -1)  # on the swap


# T1-h: for every finite MDP, Q and α ≥ 0, ‖res(Q + αg)‖∞ ≤ (|1 − α| + αγ) ‖g‖∞


def stretch(mdp, Q, alpha):
    """‖res(Q + αg)‖∞ / ‖g‖∞."""
    g = mdp.residual(Q)
    return abs(mdp.residual(Q + alpha * g)).max() / abs(g).max()


@claim("T1-h")
@pytest.mark.parametrize("alpha", [F(0), F(1, 10), F(1), F(20, 19), F(3, 2), F(2)])
def test_the_bound_is_attained_for_every_step(alpha):
    """Up to α = 1 by the drifted loop, from there on by two states that swap, and by the loop no
    longer; the bound is below 1 if and only if 0 < α < 2/(1 + γ).
    """
    bound = abs(1 - alpha) + alpha * GAMMA
    by_loop = stretch(loops((0, 1), GAMMA), row(0, 0), alpha)
    by_swap = stretch(swap(GAMMA), OPPOSITE, alpha)
    assert max(by_loop, by_swap) == bound
    assert (by_loop < bound) == (alpha > 1)
    assert (bound < 1) == (0 < alpha < 2 / (1 + GAMMA))
    shows("attained: by the drifted loop up to α = {}, by two states that swap from there on", F(1))


@control("T1-h")
def test_edge_a_negative_step_stretches_more():
    """α = −1 on the swap: 1 + |α| + |α| γ = 2.9, where the bound would be 2 − γ = 1.1."""
    assert stretch(swap(GAMMA), OPPOSITE, F(-1)) == 2 + GAMMA > 2 - GAMMA


@control("T1-h")
def test_edge_in_squares_the_residual_can_grow():
    """The loop with rewards (0, 1) at Q = 0 and α = 1: 1 becomes 2γ²; ‖g‖∞ falls to γ."""
    mdp, Q = loops((0, 1), GAMMA), row(0, 0)
    after = mdp.residual(Q + mdp.residual(Q))
    assert (after**2).sum() == 2 * GAMMA**2 > 1 and abs(after).max() == GAMMA


# T2-o: finitely many pairs, μ > 0 on all, Q ≠ Q*: d = g + 𝒯′(Q; d) has E(Q + εd) = (1 − ε)² E(Q)


def newton(slope):
    """On loops with rewards (0, 1) at the tie Q = (0, 0): d = g + γ 𝒯′, given the slope 𝒯′."""
    return loops((0, 1), GAMMA), row(0, 0), row(GAMMA * slope, 1 + GAMMA * slope)


EVERYWHERE = row(F(1, 4), F(3, 4))


@claim("T2-o")
@pytest.mark.parametrize("step", [F(1, 100), F(1, 2), F(1)])
def test_newtons_direction_passes_a_tie(step):
    """The steepest of the tied actions has slope d₁ = 1 + γ d₁ = 10."""
    mdp, Q, d = newton(F(10))
    assert d[0].max() == 10
    before, after = (mdp.bellman_error(q, EVERYWHERE) for q in (Q, Q + step * d))
    assert after == (1 - step) ** 2 * before < before
    shows("at the tie Q = ({}) of two loops, r = ({}): d = ({})", Q, mdp.r, d)


@control("T2-o")
def test_edge_at_a_tie_the_first_of_the_best_actions_is_not_enough():
    """With π(s) the first action d₀ = γ d₀ = 0 is its slope: E falls to other than (1 − ε)²."""
    mdp, Q, d = newton(F(0))
    assert d.tolist() == [[0, 1]]
    after = mdp.bellman_error(Q + F(1, 2) * d, EVERYWHERE)
    assert after > F(1, 4) * mdp.bellman_error(Q, EVERYWHERE)


@control("T2-o")
def test_edge_where_mu_leaves_a_pair_out_e_has_another_minimum():
    """μ on a₀ alone: E = 0 at Q = (9, 10), and Q* = (0, 0)."""
    mdp, Q = loops((0, 0), GAMMA), row(9, 10)
    assert mdp.bellman_error(Q, row(1, 0)) == 0 != mdp.bellman_error(Q, EVERYWHERE)


@control("T2-o")
def test_edge_too_long_a_step_lets_another_action_overtake():
    """Rewards (−0.9, 30), Q = (1, 0): d = (−10, 21.9), so from ε = 1/31.9 on a₁ is greedy."""
    mdp, Q, d = loops((F(-9, 10), 30), GAMMA), row(1, 0), row(-10, F(219, 10))
    assert (d == mdp.residual(Q) + GAMMA * d[0, 0]).all()
    before = mdp.bellman_error(Q, EVERYWHERE)
    for step, small in ((F(1, 32), True), (F(1, 31), False)):
        after = mdp.bellman_error(Q + step * d, EVERYWHERE)
        assert (after == (1 - step) ** 2 * before) == small


# T3-b: α > 0 and 0 < β ≤ 1 fixed, 0 < m ≤ |δ_i| ≤ M for all i: the distance P, P* tends to 1 with N


def distance(errors, rate=0.01, mix=0.5):
    """Total variation between the mixed rule and the product; errors (N,), the newest first."""
    time = time_priority(np.arange(len(errors)), rate)
    P, product = mixed_priority(errors, time, mix), errors * time
    return np.abs(P / P.sum() - product / product.sum()).sum() / 2


SIZES = (1_000, 10_000, 100_000)


@claim("T3-b")
def test_the_distance_to_the_product_tends_to_1():
    """Where |δ| waves between ½ and 1½."""
    found = [distance(1 + 0.5 * np.sin(np.arange(n))) for n in SIZES]
    assert found == sorted(found) and found[0] > 0.5 and found[-1] > 0.99
    shows("|δ| between two positive bounds: {:.3f} apart at N = {}", found, SIZES)


@control("T3-b")
def test_edge_errors_that_fade_with_age_keep_a_distance_of_a_quarter():
    """|δ| = e^{−α age}: no m > 0 bounds it, and 0.25 is the largest e^{−x} − e^{−2x}."""
    assert [distance(time_priority(np.arange(n), 0.01)) for n in SIZES] == pytest.approx(
        [0.25] * 3, abs=0.002
    )


@control("T3-b")
def test_edge_one_error_that_grows_with_the_buffer_takes_all_of_both():
    """|δ| = 1 but for the newest, with N²: no M bounds it, and both put all mass there."""
    found = [distance(np.append(n**2.0, np.ones(n - 1))) for n in SIZES]
    assert found == sorted(found, reverse=True) and found[-1] < 1e-4


@control("T3-b")
@pytest.mark.parametrize(("setting", "limit"), [("rate", 0.2551), ("mix", 0.0)])
def test_edge_a_rate_that_falls_with_the_buffer_or_no_td_error_at_all(setting, limit):
    """α = 3/N, or β = 0, with |δ| = 1."""
    for n in SIZES[1:]:
        settings = {"rate": 3 / n} if setting == "rate" else {"mix": 0.0}
        assert distance(np.ones(n), **settings) == pytest.approx(limit, abs=5e-4)


# T4-d: ‖h_m − g_{m−1}‖∞ ≤ ε on every pair, 0 < α_m ≤ 1, Σ α_m = ∞: limsup ‖Q_m − Q*‖∞ ≤ ε/(1 − γ)


def path(mdp, Q, steps, miss=0, data=1):
    """Q after boosters h = data · (g + miss), with these α."""
    for alpha in steps:
        Q = Q + alpha * data * (mdp.residual(Q) + miss)
    return Q


@claim("T4-d")
def test_boosters_that_miss_by_epsilon_end_at_epsilon_over_1_minus_gamma():
    """On the swap from (20, 20), α_m = 1/√m, h = g + ε: the error falls to the bound and stays."""
    start, gamma, miss = np.full((2, 1), 20.0), 0.9, 0.1
    boosts = (10, 100, 1_000, 10_000)
    errors = [
        abs(path(swap(gamma), start, [m**-0.5 for m in range(1, n)], miss)).max() for n in boosts
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == pytest.approx(miss / (1 - gamma), abs=1e-6)
    shows(
        "two states that swap, γ = {}, ε = {}, α_m = 1/√m: errors {:.4g} after {} boosters, ε/(1 −"
        " γ) = {:.3g}",
        *(gamma, miss, errors, boosts, miss / (1 - gamma)),
    )


@control("T4-d")
def test_edge_steps_with_a_finite_sum_stop_on_the_way():
    """α_m = 2^{−(m+2)}, ε = 0 and even γ = 0: 77 % of the error stays."""
    left = path(loops((0,), F(0)), row(1), [F(1, 2 ** (m + 2)) for m in range(1, 60)])
    assert 0.77 < left[0, 0] < 0.771


@control("T4-d")
def test_edge_steps_beyond_1_can_diverge():
    """α = 3/2 on the swap: the error is multiplied by α(1 + γ) − 1 = 1.85 each time."""
    assert (
        abs(path(swap(GAMMA), OPPOSITE, [F(3, 2)] * 5)).max()
        == (F(3, 2) * (1 + GAMMA) - 1) ** 5
        > 20
    )


@control("T4-d")
def test_edge_a_pair_without_data_keeps_its_error():
    """h = g at a₀ and 0 at a₁, which is the greedy action: (0, 10) ends at (9, 10), Q* = (0, 0)."""
    end = path(loops((0, 0), GAMMA), row(0, 10), [F(1)] * 5, data=row(1, 0))
    assert end.tolist() == [[9, 10]]

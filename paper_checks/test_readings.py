"""Where the equations can be read in two ways, or say less than the text makes of them: Eqs. 2,
4–7.
"""

from fractions import Fraction as F

import numpy as np
import paper
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import loop, row

from gbdqn_ref.bellman import loss_gradient, td_target, weighted_loss
from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.optim import polyak
from gbdqn_ref.replay import importance_weights

SEEDS = st.integers(0, 10**6)


@claim("M3")
@given(SEEDS)
def test_the_residual_is_the_negative_gradient(seed):
    """The loss is quadratic in Q, so a central difference of any width is exact."""
    residual, ones = np.random.default_rng(seed).normal(size=4), np.ones(4)
    gradient = loss_gradient(residual, ones, np.zeros(4, int), 1)[:, 0]
    for i, d in enumerate(np.eye(4)):
        slope = (weighted_loss(residual + d, ones) - weighted_loss(residual - d, ones)) / 2
        assert slope == pytest.approx(-gradient[i], abs=1e-12)
        assert slope == pytest.approx(residual[i] / 4, abs=1e-12)
    shows("−∂L/∂Q_i = r_i (a mean over the batch divides it by B), on random residuals")


@control("M3")
def test_control_with_a_moving_target_the_slope_is_another():
    """On a loop y = r + γQ moves with Q, and the slope is (1 − γ) of the residual."""
    mdp, Q, step = loop(1, F(9, 10)), row(2), F(1, 10)
    losses = [weighted_loss(mdp.residual(Q - d)[0], np.ones(1)) for d in (step, -step)]
    assert (losses[0] - losses[1]) / (2 * step) == pytest.approx(
        float((1 - mdp.gamma) * mdp.residual(Q)[0, 0])
    )


@claim("M5")
@given(SEEDS, st.integers(1, 6))
def test_the_weighted_loss_is_that_of_uniform_sampling(seed, n):
    """E_P[w e²/2] = Σ P · (1/(nP)) · e²/2 = mean e²/2."""
    rng = np.random.default_rng(seed)
    P, error = rng.dirichlet(np.ones(n)) * 0.9 + 0.1 / n, rng.normal(size=n)
    assert expected_loss(P, error) == pytest.approx(weighted_loss(error, np.ones(n)), rel=1e-9)
    shows("Σ P(i) L_w(i) = the uniform loss, on random P and errors; what they correct is in W1–W3")


def expected_loss(P, error):
    """The mean weighted loss of one transition drawn by P, with exponent 1."""
    return sum(
        P[i] * weighted_loss(error[[i]], importance_weights(P[[i]], len(P), 1.0, None))
        for i in np.flatnonzero(P)
    )


@control("M5")
def test_control_what_is_never_drawn_is_never_corrected():
    """With P = 0 where the error is, it has no part in the expectation."""
    error = np.array([0.0, 3.0])
    assert expected_loss(np.array([1.0, 0.0]), error) == 0 < weighted_loss(error, np.ones(2))


def boosted_sums(tau):
    """(Q, Q̄, y, Q + h for h = y − Q, and for h = y − Q̄) on a loop with r = 1 and γ = ½, for Q = 3
    and a target network that has made one Polyak step from 2.
    """
    Q, Q_target = np.array([3.0]), np.array([2.0])
    polyak(Q_target, Q, tau)
    y = td_target(np.ones(1), np.array([False]), Q_target[None], 0.5)
    fits = [closed_form_alpha(y - q, np.ones(1)) for q in (Q, Q_target)]
    return Q, Q_target, y, *(Q + h for h in fits)


@claim("M6")
def test_two_ensembles_in_the_residual_give_two_fits():
    """With Q in the residual Q + h is the target y; with Q̄ it is off by Q − Q̄."""
    Q, Q_target, y, with_q, with_target = boosted_sums(tau=0.0)
    assert with_q == y == 1 + Q_target / 2 and with_target - y == Q - Q_target
    shows(
        "Q = {}, Q̄ = {}, y = {}: the fitted Q_m is {} with Q in the residual, {} with Q̄",
        *(Q, Q_target, y, with_q, with_target),
    )


@control("M6")
def test_control_a_target_that_has_caught_up_gives_one_fit():
    """With Q̄ = Q, as for a frozen network, there is one residual."""
    *_, with_q, with_target = boosted_sums(tau=1.0)
    assert with_q == with_target


def two_losses(residual, w):
    """J_m as Eq. 5 and as Eq. 6 has it."""
    return weighted_loss(residual, np.ones_like(w)), weighted_loss(residual, w)


@claim("M7")
def test_two_functions_are_called_j_m():
    """One sample, and a booster of 0."""
    residual, w = np.array([1.0]), np.array([0.25])
    plain, weighted = two_losses(residual, w)
    assert plain != weighted == w[0] * plain
    shows(
        "r = {}, h = 0, w = {:/}: {:/} and {:/}; equal only where w = 1 wherever r ≠ αh",
        *(residual, w, plain, weighted),
    )


@control("M7")
@pytest.mark.parametrize(("residual", "w"), [([1.0, -2.0], [1.0, 1.0]), ([0.0, 0.0], [0.25, 3.0])])
def test_control_with_weights_of_1_or_a_perfect_fit_they_are_one(residual, w):
    """The weights make no difference where they are 1, nor where nothing is left."""
    plain, weighted = two_losses(np.array(residual), np.array(w))
    assert plain == weighted


def least_and_where(residual, h):
    """(the least Σ (r − αh)², the α at which it is)."""
    alpha = closed_form_alpha(residual, h)
    return ((residual - alpha * h) ** 2).sum(), alpha


@claim("M10")
def test_the_minimum_is_not_where_it_is():
    """An exact fit leaves nothing, with a step of 1."""
    residual = h = np.array([1.0])
    least, alpha = least_and_where(residual, h)
    assert (least, alpha) == (0, 1)
    shows("r = h = {}: the least value is {}, and it is at α = {}", residual, least, alpha)


@control("M10")
def test_control_they_can_agree_by_chance():
    """Where the booster misses a residual of 1 the least value is 1, and so is α."""
    least, alpha = least_and_where(np.array([1.0, 1.0]), np.array([1.0, 0.0]))
    assert least == alpha == 1


def inside_and_outside(residual, eta):
    """The constant h fitted with α = η inside the loss, min (r − η h)², and outside, min (r − h)²;
    and what r − η h leaves for each.
    """
    fits = [closed_form_alpha(np.array([residual]), np.array([scale])) for scale in (eta, 1.0)]
    return fits, [residual - eta * h for h in fits]


@claim("M13")
@given(st.floats(0.05, 1), st.floats(-9, 9))
def test_inside_or_outside_is_a_factor_of_eta(eta, residual):
    """Inside, Q moves by the whole residual; outside, by η of it."""
    (inside, outside), left = inside_and_outside(residual, eta)
    assert eta * inside == pytest.approx(outside, abs=1e-9)
    assert left == pytest.approx([0, (1 - eta) * residual], abs=1e-9)
    shows("h inside is h outside divided by η, on random residuals and η")


@claim("M13")
def test_with_the_printed_shrinkage_inside_is_ten_times_outside():
    """The whole residual is gone under one, nine tenths are left under the other."""
    residual, eta = 3.0, paper.SHRINKAGE
    (inside, outside), (gone, left) = inside_and_outside(residual, eta)
    assert (gone, left) == pytest.approx((0, (1 - eta) * residual))
    shows(
        "residual {}, η = {}: inside h = {} and the whole residual is gone, outside h = {} and {}"
        " is left",
        *(residual, eta, inside, outside, left),
    )


@control("M13")
def test_control_without_shrinkage_the_two_are_one():
    """At η = 1 it does not matter."""
    (inside, outside), left = inside_and_outside(3.0, 1.0)
    assert inside == outside and left == [0, 0]


@claim("M14")
@given(SEEDS)
def test_a_second_fit_of_the_same_linear_class_is_zero(seed):
    """What least squares leaves is orthogonal to the whole class, so the next fit is 0."""
    rng = np.random.default_rng(seed)
    features, residual = rng.normal(size=(6, 2)), rng.normal(size=6)
    first = fitted(features, residual)
    left = residual - closed_form_alpha(residual, first) * first
    assert residual @ residual - left @ left == pytest.approx(first @ first)
    second = abs(fitted(features, left)).max()
    assert second < 1e-9
    shows(
        "linear learners on random data: Σ r² falls once, and the second booster is {:.0f}", second
    )


def fitted(features, residual):
    """The least-squares fit in the span of the features."""
    return features @ np.linalg.lstsq(features, residual)[0]


@control("M14")
def test_control_a_learner_of_another_class_finds_more():
    """What two features leave, a third one that correlates with it takes up."""
    rng = np.random.default_rng(0)
    features, residual = rng.normal(size=(6, 3)), rng.normal(size=6)
    left = residual - fitted(features[:, :2], residual)
    assert abs(fitted(features, left)).max() > 0.01


def boosted(cosines):
    """Σ r² after boosters at these angles to the residual, from 1 on, each with its closed-form
    α.
    """
    residual = np.array([1.0, 0.0])
    for cos in cosines:
        along = residual / np.sqrt(residual @ residual)
        h = cos * along + np.sqrt(1 - cos**2) * np.array([-along[1], along[0]])
        alpha = closed_form_alpha(residual, h)
        assert alpha > 0
        residual = residual - alpha * h
    return residual @ residual


@claim("M15")
@pytest.mark.parametrize("boosts", [1, 4, 40])
def test_ever_smaller_gains_end_at_a_half(boosts):
    """The m-th booster leaves a part 1 − 1/(m + 1)²: the product is (m + 2)/(2(m + 1))."""
    left, limit = boosted([1 / (m + 1) for m in range(1, boosts + 1)]), F(1, 2)
    assert left == pytest.approx((boosts + 2) / (2 * (boosts + 1)), abs=1e-9)
    assert left - float(limit) == pytest.approx(1 / (2 * (boosts + 1)), abs=1e-9)
    shows("2 samples, optimal α > 0 at every step: Σ r² = (m + 2)/(2(m + 1)) → {}", limit)


@control("M15")
def test_control_with_a_fixed_angle_it_does_go_to_0():
    """At 45° every booster leaves a half."""
    assert boosted([np.sqrt(1 / 2)] * 20) == pytest.approx(0.5**20, abs=1e-12)

"""Where the equations can be read in two ways, or say less than the text makes of them: Eqs. 2,
4–7.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.bellman import loss_gradient, td_target, weighted_loss
from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.replay import importance_weights

SEEDS = st.integers(0, 10**6)


@claim(
    "M3",
    place="Eq. 2",
    says="the residual is the negative gradient of half the squared loss",
    verdict="holds if the target is held fixed",
    uses="bellman.weighted_loss, bellman.loss_gradient",
)
@given(SEEDS)
def test_the_residual_is_the_negative_gradient(seed):
    """The loss is quadratic in Q, so a central difference of any width is exact: (L(Q − d) − L(Q +
    d)) / 2d = r / B.
    """
    residual, ones = np.random.default_rng(seed).normal(size=4), np.ones(4)
    gradient = loss_gradient(residual, ones, np.zeros(4, int), 1)[:, 0]
    for i, d in enumerate(np.eye(4)):
        slope = (weighted_loss(residual + d, ones) - weighted_loss(residual - d, ones)) / 2
        assert slope == pytest.approx(-gradient[i], abs=1e-12)
        assert slope == pytest.approx(residual[i] / 4, abs=1e-12)
    shows("−∂L/∂Q_i = r_i (a mean over the batch divides it by B), on random residuals")


@control("M3")
def test_control_with_a_moving_target_the_slope_is_another():
    """Negative control: on a loop y = r + γQ moves with Q, and the slope of ½ (y − Q)² is (1 − γ)
    of it.
    """
    gamma, Q, step = 0.9, 2.0, 1e-6
    residuals = [1 + gamma * q - q for q in (Q - step, Q + step)]
    slope = (residuals[0] ** 2 - residuals[1] ** 2) / (4 * step)
    assert slope == pytest.approx((1 - gamma) * (1 + gamma * Q - Q), rel=1e-6)


@claim(
    "M5",
    place="section Gradient Boosted DQN, after Eq. 3",
    says="the weights of the loss correct the bias of non-uniform sampling",
    verdict=(
        "holds if their exponent is 1, they are not normalised, and nothing that matters has P = 0"
    ),
    uses="replay.importance_weights, bellman.weighted_loss",
)
@given(SEEDS, st.integers(1, 6))
def test_the_weighted_loss_is_that_of_uniform_sampling(seed, n):
    """E_P[w e²/2] = Σ P · (1/(nP)) · e²/2 = mean e²/2."""
    rng = np.random.default_rng(seed)
    P, error = rng.dirichlet(np.ones(n)) * 0.9 + 0.1 / n, rng.normal(size=n)
    losses = [weighted_loss(error[[i]], importance_weights(P[[i]], n, 1.0, None)) for i in range(n)]
    assert P @ losses == pytest.approx(weighted_loss(error, np.ones(n)), rel=1e-9)
    shows("Σ P(i) L_w(i) = the uniform loss, on random P and errors; what they correct is in W1–W3")


@control("M5")
def test_control_what_is_never_drawn_is_never_corrected():
    """Negative control: with P = (1, 0) the second error, 3, has no part in the expectation: 0 for
    9/4.
    """
    error = np.array([0.0, 3.0])
    assert 1.0 * weighted_loss(error[[0]], importance_weights(np.array([1.0]), 2, 1.0, None)) == 0
    assert weighted_loss(error, np.ones(2)) == 9 / 4


@claim(
    "M6",
    place="Eq. 4",
    says="which ensemble is in the residual",
    verdict=(
        "ambiguous: Q_{m−1} in Eq. 4, its target network in Algorithm 1 and in the text; one, if"
        " frozen (D3)"
    ),
    uses="bellman.td_target",
)
def test_two_ensembles_in_the_residual_give_two_fits():
    """Q(s, a) = 3, Q̄(s, a) = 2, y = 7: h = y − Q gives Q + h = 7, h = y − Q̄ gives 8."""
    y = td_target(np.array([1.0]), np.array([False]), np.array([[6.0]]), 1.0)[0]
    Q, Q_target = 3.0, 2.0
    assert (Q + (y - Q), Q + (y - Q_target)) == (7, 8)
    shows("Q = 3, Q̄ = 2, y = 7: the fitted Q_m is 7 with Q in the residual, 8 with Q̄")


@control("M6")
def test_control_a_frozen_network_is_its_own_target():
    """Negative control: with Q̄ = Q the two are the same."""
    Q = Q_target = 3.0
    assert Q + (7 - Q) == Q + (7 - Q_target) == 7


@claim(
    "M7",
    place="Eqs. 5–6",
    says="what J_m is",
    verdict="ambiguous: the plain sum of squares in Eq. 5, the weighted one in Eq. 6",
    uses="bellman.weighted_loss",
)
def test_two_functions_are_called_j_m():
    """One sample with residual 1 and h = 0: ½ against ⅛ for w = ¼."""
    residual = np.array([1.0])
    assert (weighted_loss(residual, np.ones(1)), weighted_loss(residual, np.array([0.25]))) == (
        0.5,
        0.125,
    )
    shows("r = 1, h = 0, w = ¼: ½ and ⅛; equal only where w = 1 wherever r ≠ αh")


@control("M7")
def test_control_where_every_weight_is_1_they_are_one():
    """Negative control, and with a perfect fit the weights make no difference either."""
    residual, w = np.array([1.0, -2.0]), np.array([0.25, 3.0])
    assert weighted_loss(residual, np.ones(2)) == weighted_loss(residual, w / w)
    assert weighted_loss(residual - residual, w) == 0


@claim(
    "M10",
    place="Eq. 7",
    says="α_m is the minimum of the squared loss",
    verdict="fails: it is where the minimum is; Eq. 7 prints min for argmin",
    uses="boosting.closed_form_alpha",
)
def test_the_minimum_is_not_where_it_is():
    residual = h = np.array([1.0])
    assert closed_form_alpha(residual, h) == 1
    assert ((residual - closed_form_alpha(residual, h) * h) ** 2).sum() == 0
    shows("r = h = 1: the least value is 0, and it is at α = 1")


@control("M10")
def test_control_they_can_agree_by_chance():
    """Negative control: r = (1, 1), h = (1, 0) has the least value 1, at α = 1."""
    residual, h = np.array([1.0, 1.0]), np.array([1.0, 0.0])
    assert (
        closed_form_alpha(residual, h)
        == ((residual - closed_form_alpha(residual, h) * h) ** 2).sum()
        == 1
    )


@claim(
    "M13",
    place="Eq. 5, Algorithm 1, line 19",
    says="whether α_m is in the loss that the booster is trained on",
    verdict="ambiguous: inside in Eq. 5, outside in Algorithm 1; a factor of 1/η in what is learnt",
    uses="boosting.closed_form_alpha",
)
@given(st.fractions(F(1, 20), 1), st.fractions(-9, 9))
def test_inside_or_outside_is_a_factor_of_eta(eta, residual):
    """One sample, learners c · 1. Inside: c = r/η, and Q moves by η c = r. Outside: c = r, and Q
    moves by η r.
    """
    inside = closed_form_alpha(
        np.array([float(residual)]), np.array([float(eta)])
    )  # the c of min (r − c η)²
    outside = closed_form_alpha(np.array([float(residual)]), np.ones(1))
    assert float(eta) * inside == pytest.approx(float(residual), abs=1e-9)
    assert float(eta) * outside == pytest.approx(float(eta * residual), abs=1e-9)
    shows(
        "residual 3, η = 0.1: inside h = 30 and the whole residual is gone, outside h = 3 and 2.7"
        " is left"
    )


@control("M13")
def test_control_without_shrinkage_the_two_are_one():
    """Negative control: at η = 1 it does not matter; and of the two at η = 0.1, one leaves 2.7 of
    3.
    """
    assert closed_form_alpha(np.array([3.0]), np.array([1.0])) == 3
    assert 3 - 0.1 * closed_form_alpha(np.array([3.0]), np.ones(1)) == pytest.approx(2.7)


@claim(
    "M14",
    place="section Gradient Boosted DQN, after Eq. 8",
    says="the boosters reduce the residual one after the other",
    verdict=(
        "holds if the target stays frozen; a learner of the same linear class then finds nothing"
        " more"
    ),
    uses="boosting.closed_form_alpha",
)
@given(SEEDS)
def test_a_second_fit_of_the_same_linear_class_is_zero(seed):
    """What least squares leaves is orthogonal to the whole class, so the next fit is h = 0, and α
    is 0/0: 0 here.
    """
    rng = np.random.default_rng(seed)
    features, residual = rng.normal(size=(6, 2)), rng.normal(size=6)
    sizes = [residual @ residual]
    for _ in range(2):
        h = features @ np.linalg.lstsq(features, residual)[0]
        residual = residual - closed_form_alpha(residual, h) * h
        sizes.append(residual @ residual)
    assert sizes[1] <= sizes[0] and sizes[2] == pytest.approx(sizes[1], abs=1e-12 * sizes[0])
    assert closed_form_alpha(residual, np.zeros(6)) == 0
    shows("linear learners on random data: Σ r² falls once, and the second booster is 0")


@control("M14")
def test_control_a_learner_of_another_class_finds_more():
    """Negative control: what two features leave, a third one that correlates with it takes up."""
    rng = np.random.default_rng(0)
    features, residual = rng.normal(size=(6, 3)), rng.normal(size=6)
    left = residual - features[:, :2] @ np.linalg.lstsq(features[:, :2], residual)[0]
    h = features @ np.linalg.lstsq(features, left)[0]
    assert ((left - h) ** 2).sum() < 0.999 * (left**2).sum()


@claim(
    "M15",
    place="section Gradient Boosted DQN, after Eq. 8",
    says="boosters each of which lowers the residual lower it to 0",
    verdict="fails: steps that help less and less may end anywhere",
    uses="boosting.closed_form_alpha",
)
@pytest.mark.parametrize("boosts", [1, 4, 40])
def test_ever_smaller_gains_end_at_a_half(boosts):
    """h at an angle to r, cos² = 1/(m + 1)²: each leaves 1 − 1/(m + 1)², whose product (m + 2)/(2(m
    + 1)) → ½.
    """
    residual = np.array([1.0, 0.0])
    for m in range(1, boosts + 1):
        length, cos = np.sqrt(residual @ residual), 1 / (m + 1)
        along, across = residual / length, np.array([-residual[1], residual[0]]) / length
        h = cos * along + np.sqrt(1 - cos**2) * across
        alpha = closed_form_alpha(residual, h)
        assert alpha > 0
        residual = residual - alpha * h
    assert residual @ residual == pytest.approx((boosts + 2) / (2 * (boosts + 1)), abs=1e-9)
    shows("2 samples, optimal α > 0 at every step: Σ r² = (m + 2)/(2(m + 1)) → ½")


@control("M15")
def test_control_with_a_fixed_angle_it_does_go_to_0():
    """Negative control: cos² ≥ c at every step leaves at most (1 − c)^m."""
    residual = np.array([1.0, 0.0])
    for m in range(20):
        assert residual @ residual == pytest.approx(0.5**m, abs=1e-12)
        across = np.array([-residual[1], residual[0]])
        h = (residual + across) / np.sqrt(2)  # 45°
        residual = residual - closed_form_alpha(residual, h) * h

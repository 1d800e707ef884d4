"""Eqs. 1–9 and the lines around them, decided with the functions that implement them."""

import numpy as np
import paper
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.bellman import loss_gradient, softmax_policy, td_target, weighted_loss
from gbdqn_ref.boosting import Ensemble, closed_form_alpha
from gbdqn_ref.nn import MLP
from gbdqn_ref.optim import polyak

SEEDS = st.integers(0, 10**6)


def samples(seed, n=5):
    """Random residuals, predictions of a booster, and weights."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=n), rng.normal(size=n), rng.uniform(0.1, 1, n)


@claim("M1")
@given(SEEDS, st.integers(1, 5))
def test_the_ensemble_telescopes(seed, m):
    """Q_m − Q_{m−1} = α_m h_m, and the empty sum is the zero function."""
    rng, net = np.random.default_rng(seed), MLP((2, 3, 2))
    ensemble, x = Ensemble(net), rng.normal(size=(4, 2)).astype(np.float32)
    empty = np.abs(ensemble.q(x)).max()
    assert empty == 0
    for _ in range(m):
        before, theta, alpha = ensemble.q(x), net.init(rng), rng.normal()
        ensemble.add(theta, alpha)
        scale = np.abs(ensemble.terms(x)).sum(0).max()
        np.testing.assert_allclose(
            ensemble.q(x), before + alpha * net.forward(theta, x)[0], atol=1e-6 * scale
        )
    shows("Q_m = Q_{{m−1}} + α_m h_m on random ensembles; Q_0 = {}", empty)


@control("M1")
def test_control_one_booster_left_out_is_seen():
    """The sum without its first term is another function."""
    rng, net = np.random.default_rng(0), MLP((2, 3, 2))
    ensemble, x = Ensemble(net), np.ones((1, 2), np.float32)
    for _ in range(2):
        ensemble.add(net.init(rng), 1.0)
    terms = ensemble.terms(x)
    np.testing.assert_allclose(ensemble.q(x), terms.sum(0), atol=1e-6)
    assert not np.allclose(ensemble.q(x), terms[1:].sum(0))


def slopes(residual, w, step=1e-6):
    """The slope of the weighted loss in each Q_i, by central differences."""
    return [
        (weighted_loss(residual - d, w) - weighted_loss(residual + d, w)) / (2 * step)
        for d in step * np.eye(len(residual))
    ]


@claim("M4")
@given(SEEDS)
def test_the_weighted_residual_is_the_gradient(seed):
    """Central differences of the mean loss (D2) over Q are −w r / B, which is loss_gradient."""
    residual, _, w = samples(seed)
    gradient = loss_gradient(residual, w, np.zeros(5, int), 1)[:, 0]
    np.testing.assert_allclose(slopes(residual, w), gradient, atol=1e-7)
    np.testing.assert_allclose(gradient, -w * residual / 5)
    shows("central differences of ½ Σ w r² agree with −w r, for random residuals and weights")


@control("M4")
def test_control_the_unweighted_residual_is_not():
    """Without its weight the residual is another direction."""
    residual, _, w = samples(0)
    unweighted = loss_gradient(residual, np.ones(5), np.zeros(5, int), 1)[:, 0]
    assert not np.allclose(slopes(residual, w), unweighted, atol=1e-3)


@claim("M8")
@given(SEEDS, st.floats(-3, 3))
def test_a_weight_can_be_moved_inside_as_its_root(seed, alpha):
    """The plain loss of √w r and √w h is the weighted loss of r and h."""
    residual, h, w = samples(seed)
    inside, outside = two_losses(residual, h, w, alpha, np.sqrt(w))
    assert inside == pytest.approx(outside, rel=1e-12)
    shows("Σ w (r − αh)² = Σ (√w r − α √w h)², to rounding")


def two_losses(residual, h, w, alpha, on_h):
    """The plain loss of √w r and on_h · h, and the weighted loss of r and h."""
    inside = weighted_loss(np.sqrt(w) * residual - alpha * on_h * h, np.ones_like(w))
    return inside, weighted_loss(residual - alpha * h, w)


@control("M8")
def test_control_with_the_root_left_out_of_h_it_is_another_loss():
    """√w on the residual alone is not enough."""
    residual, h, w = samples(0)
    inside, outside = two_losses(residual, h, w, 1.0, np.ones_like(w))
    assert abs(inside - outside) > 0.1


def four_fits(r, w):
    """The constants fitted to r, to r with weights w, to w r and to √w r."""
    one = np.ones_like(r)
    return [
        closed_form_alpha(r, one),
        closed_form_alpha(r, one, w),
        closed_form_alpha(w * r, one),
        closed_form_alpha(np.sqrt(w) * r, one),
    ]


@claim("M9")
def test_four_readings_of_the_weighted_fit_differ():
    """The learners are constants, so a fit is the closed-form α of the learner 1."""
    r, w = np.array([2.0, -1.0]), np.array([0.25, 1.0])
    fits = four_fits(r, w)
    assert len(set(fits)) == 4
    shows(
        "r = ({}), w = ({:/}), constants: fitted to r {:/}, weighted {:/}, to w r {:/}, to √w r"
        " alone {:/}",
        *(r, w, *fits),
    )


@control("M9")
def test_control_with_equal_weights_all_agree():
    """With w = 1 the four readings are one."""
    assert len(set(four_fits(np.array([2.0, -1.0]), np.ones(2)))) == 1


@claim("M11")
@given(SEEDS, st.floats(-2, 2))
def test_the_closed_form_is_the_minimiser(seed, away):
    """f(α + d) − f(α) = d² Σ h², so every other step is worse."""
    residual, h, _ = samples(seed)
    alpha = closed_form_alpha(residual, h)
    assert rise(residual, h, alpha, away) == pytest.approx(away**2 * (h @ h), abs=1e-9)
    shows("f(α + d) − f(α) = d² Σ h² for every d")


def rise(residual, h, alpha, away):
    """f(α + away) − f(α), with f(α) = Σ (r − αh)²."""
    return ((residual - (alpha + away) * h) ** 2).sum() - ((residual - alpha * h) ** 2).sum()


@claim("M11")
def test_the_minimum_and_the_argmin_are_two_numbers():
    """For an exact fit the least value is 0, and the step that reaches it is 1."""
    residual = h = np.ones(1)
    alpha = closed_form_alpha(residual, h)
    least = ((residual - alpha * h) ** 2).sum()
    assert rise(residual, h, alpha, 0.1) > 0 and rise(residual, h, alpha, -0.1) > 0
    assert least != alpha
    shows("with r = h = {} the minimum is {} and the argmin {}", h[0], least, alpha)


@control("M11")
def test_control_from_another_step_some_steps_are_better():
    """A tenth more than the closed form is no minimiser: the way back lowers f."""
    residual, h, _ = samples(0)
    alpha = 1.1 * closed_form_alpha(residual, h)
    assert rise(residual, h, alpha, closed_form_alpha(residual, h) - alpha) < 0


@claim("M2")
def test_the_closed_form_can_be_negative():
    """A booster with the sign of the residual turned round has a negative weight."""
    residual, h = np.array([-1.0]), np.array([1.0])
    alpha = closed_form_alpha(residual, h)
    assert alpha < 0
    shows("r = {}, h = {}: α = {}", residual, h, alpha)


@claim("M2")
def test_the_closed_form_can_be_0():
    """Where the booster is orthogonal to the residual."""
    alpha = closed_form_alpha(np.array([1.0, 1.0]), np.array([1.0, -1.0]))
    assert alpha == 0
    shows("r ⟂ h: {}", alpha)


def no_worse_than_none(residual, h):
    """Whether h fits the residual no worse than 0 does."""
    return ((residual - h) ** 2).sum() <= (residual**2).sum()


@claim("M2")
@given(SEEDS, st.floats(-2, 2))
def test_a_learner_no_worse_than_none_has_alpha_of_at_least_half(seed, size):
    """Σ (r − h)² − Σ r² = (1 − 2α) Σ h², so h fits no worse than 0 does where α ≥ ½."""
    residual, h, _ = samples(seed)
    assume(abs(size) > 1e-3)
    h = size * h
    least, alpha = 1 / 2, closed_form_alpha(residual, h)
    change = ((residual - h) ** 2).sum() - (residual**2).sum()
    assert change == pytest.approx((1 - 2 * alpha) * (h @ h), abs=1e-9)
    assert not no_worse_than_none(residual, h) or alpha >= least - 1e-9
    shows("positive, at least {:/}, where h fits no worse than 0 does", least)


@control("M2")
def test_control_a_learner_worse_than_none_can_have_a_negative_one():
    """A booster that points the wrong way fits worse than 0 does."""
    residual, h = np.array([1.0]), np.array([-3.0])
    assert not no_worse_than_none(residual, h)
    assert closed_form_alpha(residual, h) < 0


@claim("M12")
def test_the_unweighted_alpha_can_raise_the_weighted_loss():
    """h is the exact weighted fit of a constant; Σ w r² is twice the mean loss times B."""
    r, w = np.array([2.0, -1.0]), np.array([0.25, 1.0])
    h = np.full(2, closed_form_alpha(r, np.ones(2), w))
    alpha = closed_form_alpha(r, h)
    before, after = weighted_squares(r, w), weighted_squares(r - alpha * h, w)
    assert after > before
    shows(
        "r = ({}), w = ({:/}), h = {:/}: α = {:/}, and the weighted loss rises from {} to {:/}",
        *(r, w, h[0], alpha, before, after),
    )


def weighted_squares(error, w):
    """Σ w e²."""
    return 2 * len(error) * weighted_loss(error, w)


@control("M12")
@given(SEEDS)
def test_control_the_weighted_alpha_lowers_it(seed):
    """With its own weights the weighted loss falls by A_w²/B_w."""
    residual, h, w = samples(seed)
    alpha = closed_form_alpha(residual, h, w)
    fall = weighted_squares(residual, w) - weighted_squares(residual - alpha * h, w)
    assert fall == pytest.approx((w * residual * h).sum() ** 2 / (w * h * h).sum(), abs=1e-9)


@claim("M16")
@given(SEEDS, st.floats(0.01, 10), st.floats(-100, 100))
def test_the_softmax_policy(seed, temperature, shift):
    """It sums to 1, ignores shifts of Q, keeps its order, and earns at least max Q − τ ln |A|."""
    q = np.random.default_rng(seed).normal(size=4)
    policy = softmax_policy(q, temperature)
    assert policy.sum() == pytest.approx(1, abs=1e-12) and (policy >= 0).all()
    np.testing.assert_allclose(softmax_policy(q + shift, temperature), policy, atol=1e-9)
    assert (np.diff(policy[np.argsort(q)]) >= 0).all()
    assert policy @ q >= q.max() - temperature * np.log(4) - 1e-9
    shows("sums to 1, ignores shifts, keeps the order, loses at most τ ln |A| of the best Q")


@control("M16")
@given(SEEDS, st.floats(0.1, 10))
def test_control_a_temperature_below_0_prefers_the_smaller_q(seed, temperature):
    """exp(Q/τ) at −τ is exp(−Q/τ), which turns the order round."""
    q = np.random.default_rng(seed).normal(size=4)
    policy = softmax_policy(-q, temperature)
    assert policy[q.argmin()] > policy[q.argmax()]


@claim("P1")
@given(SEEDS, st.floats(0, 1), st.integers(0, 30))
def test_the_target_closes_the_gap_geometrically(seed, tau, k):
    """After k updates a part (1 − τ)^k of the gap is left."""
    target, theta = np.random.default_rng(seed).normal(size=(2, 4))
    start = target.copy()
    for _ in range(k):
        polyak(target, theta, tau)
    np.testing.assert_allclose(
        target, (1 - tau) ** k * start + (1 - (1 - tau) ** k) * theta, atol=1e-10
    )
    shows("θ̄_k = (1 − τ)^k θ̄_0 + (1 − (1 − τ)^k) θ")


@claim("P1")
def test_half_of_the_gap_is_left_after_69_updates():
    """At the printed τ, counted."""
    tau, target, updates = 0.01, np.zeros(1), 0
    while target < 0.5:
        polyak(target, np.ones(1), tau)
        updates += 1
    assert (1 - tau) ** updates < 0.5 <= (1 - tau) ** (updates - 1)
    shows("at τ = {} half of the gap is left after {} updates", tau, updates)


@control("P1")
def test_control_if_theta_moves_another_gap_is_left():
    """θ moves from 1 to 2 between two updates: not (1 − τ)² of the gap is left."""
    tau, target = 0.5, np.zeros(1)
    for theta in (1.0, 2.0):
        polyak(target, np.full(1, theta), tau)
    assert 2 - target == 0.75 != (1 - tau) ** 2 * 2


def targets(q_next):
    """(y where s′ is terminal, y as printed) for r = −1 and γ = 0.99."""
    r = np.array([-1.0, -1.0])
    return td_target(r, np.array([True, False]), np.array([q_next, q_next]), paper.GAMMA)


@control("P4")
@claim("P4")
def test_a_terminal_transition_must_not_bootstrap():
    """The value of the reward alone, and the printed target, which adds γ max Q̄."""
    q_next = [-50.0, -60.0]
    true, printed = targets(q_next)
    assert true == -1 and printed == -1 + paper.GAMMA * max(q_next)
    shows(
        "r = {}, Q̄(s′, ·) = ({}), γ = {}: {} as printed, {} in truth",
        *(true, q_next, paper.GAMMA, printed, true),
    )


@claim("P4")
@given(st.floats(-100, 100))
def test_with_a_terminal_value_of_0_the_printed_target_is_right(below):
    """Where max Q̄ is 0 at the terminal state nothing is added."""
    true, printed = targets([0.0, -abs(below)])
    assert true == printed
    shows("with max Q̄(s′, ·) = 0 both are r")

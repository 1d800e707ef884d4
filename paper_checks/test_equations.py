"""Eqs. 1–9 and the lines around them, decided with the functions that implement them."""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.bellman import loss_gradient, softmax_policy, td_target, weighted_loss
from gbdqn_ref.boosting import Ensemble, closed_form_alpha
from gbdqn_ref.nn import MLP
from gbdqn_ref.optim import polyak

SEEDS = st.integers(0, 10**6)


def samples(seed, n=5):
    rng = np.random.default_rng(seed)
    return rng.normal(size=n), rng.normal(size=n), rng.uniform(0.1, 1, n)


@claim(
    "M1",
    place="Eq. 1, Eq. 9",
    says="the ensemble is the sum of its weighted boosters, and adding one adds its term",
    verdict="holds",
    uses="boosting.Ensemble",
)
@given(SEEDS, st.integers(1, 5))
def test_the_ensemble_telescopes(seed, m):
    """The empty sum is the zero function, from which Algorithm 1 starts."""
    rng, net = np.random.default_rng(seed), MLP((2, 3, 2))
    ensemble, x = Ensemble(net), rng.normal(size=(4, 2)).astype(np.float32)
    assert not ensemble.q(x).any()
    for _ in range(m):
        before, theta, alpha = ensemble.q(x), net.init(rng), rng.normal()
        ensemble.add(theta, alpha)
        scale = np.abs(ensemble.terms(x)).sum(0).max()
        np.testing.assert_allclose(
            ensemble.q(x), before + alpha * net.forward(theta, x)[0], atol=1e-6 * scale
        )
    shows("Q_m = Q_{m−1} + α_m h_m on random ensembles; Q_0 = 0")


@control("M1")
def test_control_one_booster_left_out_is_seen():
    """Negative control: the sum without its first term is another function."""
    rng, net = np.random.default_rng(0), MLP((2, 3, 2))
    ensemble, x = Ensemble(net), np.ones((1, 2), np.float32)
    for _ in range(2):
        ensemble.add(net.init(rng), 1.0)
    assert not np.allclose(ensemble.q(x), ensemble.terms(x)[1])


@claim(
    "M4",
    place="Eqs. 2–3",
    says="the residual, weighted by w, is the negative gradient of the weighted loss",
    verdict="holds if the target is held fixed",
    uses="bellman.weighted_loss, bellman.loss_gradient",
)
@given(SEEDS)
def test_the_weighted_residual_is_the_gradient(seed):
    """Central differences of the mean loss (D2), whose gradient is −w r / B."""
    residual, _, w = samples(seed)
    a, step = np.zeros(5, int), 1e-6
    gradient = loss_gradient(residual, w, a, 1)[:, 0]
    for i, d in enumerate(step * np.eye(5)):
        slope = (weighted_loss(residual - d, w) - weighted_loss(residual + d, w)) / (2 * step)
        assert slope == pytest.approx(gradient[i], abs=1e-7)
    shows("central differences of ½ Σ w r² agree with −w r, for random residuals and weights")


@control("M4")
def test_control_the_unweighted_residual_is_not():
    """Negative control: without its weight the residual is another direction."""
    residual, _, w = samples(0)
    assert not np.allclose(-loss_gradient(residual, w, np.zeros(5, int), 1)[:, 0] * 5, residual)


@claim(
    "M8",
    place="Eq. 6",
    says="a weighted squared loss is the plain one of residual and learner multiplied by √w",
    verdict="holds if w ≥ 0",
    uses="bellman.weighted_loss",
)
@given(SEEDS, st.floats(-3, 3))
def test_a_weight_can_be_moved_inside_as_its_root(seed, alpha):
    residual, h, w = samples(seed)
    root = np.sqrt(w)
    inside = weighted_loss(root * residual - alpha * root * h, np.ones(5))
    assert inside == pytest.approx(weighted_loss(residual - alpha * h, w), rel=1e-12)
    shows("Σ w (r − αh)² = Σ (√w r − α √w h)², to rounding")


@claim(
    "M9",
    place="Eq. 6, the sentence after it",
    says="so r can take the place of w r in what the learner is fitted to",
    verdict="fails: it does not follow, and four readings give four learners",
    uses="boosting.closed_form_alpha",
)
def test_four_readings_of_the_weighted_fit_differ():
    """r = (2, −1), w = (¼, 1), constant learners: the constant is the closed-form α of the learner
    1.
    """
    r, w, one = np.array([2.0, -1.0]), np.array([0.25, 1.0]), np.ones(2)
    fits = [
        closed_form_alpha(r, one),
        closed_form_alpha(r, one, w),
        closed_form_alpha(w * r, one),
        closed_form_alpha(np.sqrt(w) * r, one),
    ]
    assert fits == [0.5, -0.4, -0.25, 0.0]
    shows(
        "r = (2, −1), w = (¼, 1), constants: fitted to r ½, weighted −2/5, to w r −¼, to √w r"
        " alone 0"
    )


@control("M8", "M9")
def test_control_with_equal_weights_all_agree():
    """Negative control: for w = 1 the four readings are one, and leaving the root out of h changes
    nothing.
    """
    r, one = np.array([2.0, -1.0]), np.ones(2)
    assert (
        closed_form_alpha(r, one)
        == closed_form_alpha(r, one, one)
        == closed_form_alpha(one * r, one)
        == 0.5
    )
    w = np.array([0.25, 1.0])
    assert weighted_loss(np.sqrt(w) * r - one, one) != weighted_loss(r - one, w)


@claim(
    "M11",
    place="Eqs. 7–8",
    says="α = Σ r h / Σ h² minimises Σ (r − αh)²",
    verdict="holds if h is not 0 on the whole sample, and Eq. 7 means argmin where it prints min",
    uses="boosting.closed_form_alpha",
)
@given(SEEDS, st.floats(-2, 2))
def test_the_closed_form_is_the_minimiser(seed, away):
    """f(α + d) − f(α) = d² Σ h², so every other step is worse."""
    residual, h, _ = samples(seed)
    alpha = closed_form_alpha(residual, h)
    rise = ((residual - (alpha + away) * h) ** 2).sum() - ((residual - alpha * h) ** 2).sum()
    assert rise == pytest.approx(away**2 * (h @ h), abs=1e-9)
    shows("f(α + d) − f(α) = d² Σ h² for every d; with r = h = 1 the minimum is 0 and the argmin 1")


@claim(
    "M2",
    place="Eq. 1",
    says="the weights α_i are positive",
    verdict="fails: Eq. 8 gives any sign",
    uses="boosting.closed_form_alpha",
)
def test_the_closed_form_can_be_negative():
    assert closed_form_alpha(np.array([-1.0]), np.array([1.0])) == -1
    shows("r = −1, h = 1: α = −1; r ⟂ h: 0; positive at least ½ where h fits no worse than 0 does")


@control("M2", "M11")
@given(SEEDS)
def test_control_a_learner_no_worse_than_none_has_alpha_of_at_least_half(seed):
    """Negative control: Σ (r − h)² − Σ r² = (1 − 2α) Σ h², so h fits no worse than 0 does just
    where α ≥ ½.
    """
    residual, h, _ = samples(seed)
    alpha = closed_form_alpha(residual, h)
    change = ((residual - h) ** 2).sum() - (residual**2).sum()
    assert change == pytest.approx((1 - 2 * alpha) * (h @ h), abs=1e-9)


@claim(
    "M12",
    place="Eq. 8",
    says="the same α serves the loss with importance weights",
    verdict="fails: it can raise the weighted loss; A_w/B_w minimises it",
    uses="boosting.closed_form_alpha, bellman.weighted_loss",
)
def test_the_unweighted_alpha_can_raise_the_weighted_loss():
    """r = (2, −1), w = (¼, 1), the exact weighted fit h = −2/5: twice the mean loss is the sum, 2 →
    45/16.
    """
    r, w, h = np.array([2.0, -1.0]), np.array([0.25, 1.0]), np.full(2, -0.4)
    alpha = closed_form_alpha(r, h)
    assert alpha == pytest.approx(-5 / 4)
    assert 4 * weighted_loss(r, w) == 2
    assert 4 * weighted_loss(r - alpha * h, w) == pytest.approx(float(F(45, 16)))
    shows(
        "r = (2, −1), w = (¼, 1), h = −2/5: α = −5/4, and the weighted loss rises from 2 to 45/16"
    )


@control("M12")
@given(SEEDS)
def test_control_the_weighted_alpha_lowers_it(seed):
    """Negative control: with its own weights the weighted loss falls by A_w²/B_w."""
    residual, h, w = samples(seed)
    alpha = closed_form_alpha(residual, h, w)
    fall = 10 * (weighted_loss(residual, w) - weighted_loss(residual - alpha * h, w))
    assert fall == pytest.approx((w * residual * h).sum() ** 2 / (w * h * h).sum(), abs=1e-9)


@claim(
    "M16",
    place="section Gradient Boosted DQN",
    says="the softmax policy is a distribution that prefers larger Q",
    verdict="holds if τ > 0",
    uses="bellman.softmax_policy",
)
@given(SEEDS, st.floats(0.01, 10), st.floats(-100, 100))
def test_the_softmax_policy(seed, temperature, shift):
    q = np.random.default_rng(seed).normal(size=4)
    policy = softmax_policy(q, temperature)
    assert policy.sum() == pytest.approx(1, abs=1e-12) and (policy >= 0).all()
    np.testing.assert_allclose(softmax_policy(q + shift, temperature), policy, atol=1e-9)
    assert (np.diff(policy[np.argsort(q)]) >= 0).all()
    assert policy @ q >= q.max() - temperature * np.log(4) - 1e-9
    shows("sums to 1, ignores shifts, keeps the order, loses at most τ ln |A| of the best Q")


@control("M16")
def test_control_a_temperature_of_0_or_less_is_no_policy():
    """Negative control: a negative τ would turn the order round, and is refused."""
    with pytest.raises(ValueError, match="temperature must be positive"):
        softmax_policy(np.array([0.0, 1.0]), -1.0)


@claim(
    "P1",
    place="section Ensemble Target Networks",
    says="target networks follow by Polyak averaging",
    verdict="holds",
    uses="optim.polyak",
)
@given(SEEDS, st.floats(0, 1), st.integers(0, 30))
def test_the_target_closes_the_gap_geometrically(seed, tau, k):
    target, theta = np.random.default_rng(seed).normal(size=(2, 4))
    start = target.copy()
    for _ in range(k):
        polyak(target, theta, tau)
    np.testing.assert_allclose(
        target, (1 - tau) ** k * start + (1 - (1 - tau) ** k) * theta, atol=1e-10
    )
    shows(
        "θ̄_k = (1 − τ)^k θ̄_0 + (1 − (1 − τ)^k) θ; at τ = 0.01 half of the gap is left after 69"
        " updates"
    )


@control("P1")
def test_control_averaged_parameters_are_not_averaged_functions():
    """Negative control: x ↦ θ₁ θ₂ x with (1, 1) and (−1, −1) is the same function, and their
    average is 0.
    """
    theta, other = np.array([1.0, 1.0]), np.array([-1.0, -1.0])
    assert theta.prod() == other.prod() == 1
    polyak(theta, other, 0.5)
    assert theta.prod() == 0


@claim(
    "P4",
    place="section Ensemble Target Networks, Algorithm 1",
    says="y = r + γ max Q̄(s′, ·) is the target of every transition",
    verdict="fails: where s′ is terminal it counts a value that is never learnt",
    uses="bellman.td_target",
)
def test_a_terminal_transition_must_not_bootstrap():
    r, q_next = np.array([-1.0, -1.0]), np.array([[-50.0, -60.0], [-50.0, -60.0]])
    y = td_target(r, np.array([True, False]), q_next, 0.99)
    assert y.tolist() == [-1.0, -50.5]
    shows("r = −1, Q̄(s′, ·) = (−50, −60), γ = 0.99: −50.5 as printed, −1 in truth")


@control("P4")
def test_control_with_a_value_of_0_both_agree():
    """Negative control: the two differ by γ max Q̄ at the terminal state, and by nothing where that
    is 0.
    """
    r, nothing = np.array([-1.0]), np.zeros((1, 2))
    assert td_target(r, np.array([True]), nothing, 0.99) == td_target(
        r, np.array([False]), nothing, 0.99
    )

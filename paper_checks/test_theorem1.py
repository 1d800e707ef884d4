"""Theorem 1: a boosting step with the closed-form α lowers the squared residual. True of a frozen
target, only of it.

With A = Σ r_i h_i and B = Σ h_i² the frozen residual falls by exactly A²/B. The paper's reading,
that the *Bellman* residual falls, is false: its target moves with Q. What holds for it is a bound
in the sup norm.
"""

from fractions import Fraction as F

import numpy as np
import paper
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import GAMMA_99, by_definition, loops, random_mdp, row

from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.nn import MLP

numbers = st.floats(-100, 100).filter(lambda x: x == 0 or abs(x) > 1e-3)
vectors = st.integers(1, 8).flatmap(
    lambda n: st.tuples(*[st.lists(numbers, min_size=n, max_size=n).map(np.array)] * 2)
)


def squares(x):
    """Σ x²."""
    return float(x @ x)


def fall(residual, step):
    """How far Σ r² falls when the step is taken off the residual."""
    return squares(residual) - squares(residual - step)


@claim("T1-a")
@given(vectors)
def test_the_frozen_residual_falls_by_exactly_a_squared_over_b(vectors):
    """Σ(y − Q_{m−1})² − Σ(y − Q_m)² = A²/B. No argmin is needed, only h ≠ 0."""
    residual, h = vectors
    assume(h.any())
    A, B = residual @ h, h @ h
    step = closed_form_alpha(residual, h) * h
    assert fall(residual, step) == pytest.approx(A**2 / B, abs=1e-12 * squares(residual))
    shows("it falls by exactly A²/B, A = Σ r h, B = Σ h²")


@control("T1-a")
@given(vectors, st.floats(0.01, 0.99))
def test_control_any_other_step_falls_by_less(vectors, part):
    """A part of α lowers it by less than A²/B, so the identity does pick out α."""
    residual, h = vectors
    A, B = residual @ h, h @ h
    assume(abs(A) > 1e-3 * np.sqrt(squares(residual) * B))
    step = part * closed_form_alpha(residual, h) * h
    assert fall(residual, step) < A**2 / B * (1 - (1 - part) ** 2 / 2)


OLD, NEW = (0, 0), (0, 1)  # rewards before and after the drift


def bellman_squares(gamma, eta=1, copies=1):
    """Σ of the squared Bellman residual before and after a perfect booster with step η: one state,
    two actions that stay in it, rewards that drift from OLD to NEW, Q = Q*_old = 0. The
    unpaid action counts so many times.
    """
    mdp, Q, counts = loops(NEW, gamma), row(0, 0), row(copies, 1)
    assert not loops(OLD, gamma).residual(Q).any()
    after = Q + eta * mdp.residual(Q)
    return [(counts * mdp.residual(q) ** 2).sum() for q in (Q, after)]


@claim("T1-g")
@pytest.mark.parametrize("gamma", [F(9, 10), F(99, 100)])
def test_the_bellman_residual_can_rise_under_a_perfect_booster(gamma):
    """With y recomputed from Q_m: the new value of the state raises the target of both actions."""
    before, after = bellman_squares(gamma)
    assert before == 1 < after == 2 * gamma**2
    shows("1 state, 2 actions, r ({}) → ({}), Q = Q*_old: {} becomes 2γ²", *(OLD, NEW, before))


@claim("T1-g")
def test_it_rises_by_more_than_half_at_0_9():
    """The same at γ = 0.9."""
    before, after = bellman_squares(F(9, 10))
    assert after > 1.5 * before
    shows("{:g} at γ = {:g}", after, F(9, 10))


@claim("T1-g")
def test_it_rises_even_with_the_papers_own_constants():
    """With the printed γ and the printed shrinkage."""
    eta = F(paper.SHRINKAGE).limit_denominator()
    before, after = bellman_squares(GAMMA_99, eta)
    assert before < after
    shows("{:.7g} at γ = {:g} with η = {:g}", after, GAMMA_99, eta)


@pytest.mark.parametrize("copies", [1, 3, 30])
def test_replayed_more_often_it_rises_without_bound(copies):
    """With the unpaid action k times in the sample the sum rises from 1 to (k + 1) γ²."""
    assert bellman_squares(F(9, 10), copies=copies) == [1, (copies + 1) * F(81, 100)]


@control("T1-g")
def test_control_with_a_short_horizon_it_does_fall():
    """Below γ = 1/√2 the same example falls, so the rise is due to the moving target."""
    before, after = bellman_squares(F(7, 10))
    assert after < before


@pytest.mark.parametrize("gamma", [F(9, 10), F(99, 100)])
def test_with_function_approximation_one_sample_is_enough(gamma):
    """Two loops without reward, φ = (1, 2), the first action alone in the sample: an exact fit
    moves the other action twice as far, and the residual with it: × (2γ)².
    """
    mdp, phi = loops((0, 0), gamma), row(1, 2)
    residual = mdp.residual(phi)[0, 0]
    after = mdp.residual(phi + residual * phi)[0, 0]
    assert after**2 == (2 * gamma) ** 2 * residual**2 > residual**2


def residual_and_bound(mdp, Q, alpha):
    """(‖res(Q + αg)‖∞ by the definition of 𝒯*, (|1 − α| + αγ) ‖g‖∞)."""
    g = mdp.residual(Q)
    bound = (abs(1 - alpha) + alpha * mdp.gamma) * abs(g).max()
    return abs(by_definition(mdp, Q + alpha * g)).max(), bound


@claim("T1-h")
@given(st.integers(0, 10**6), st.floats(0, 2.5), st.floats(0, 0.99))
def test_what_holds_instead_is_a_bound_in_the_sup_norm(seed, alpha, gamma):
    """On random MDPs, whatever Q and α ≥ 0 are."""
    rng, (states, actions) = np.random.default_rng(seed), (4, 3)
    mdp = random_mdp(rng, gamma, states, actions)
    left, bound = residual_and_bound(mdp, rng.normal(size=(states, actions)), alpha)
    assert left <= bound * (1 + 1e-9) + 1e-12
    shows("random MDPs of {} states and {} actions", states, actions)


@control("T1-h")
def test_control_without_its_first_term_the_bound_does_not_hold():
    """α γ ‖g‖∞ alone is too small for a step that is not whole."""
    mdp, Q, alpha = loops(NEW, F(9, 10)), row(0, 0), F(1, 2)
    left, bound = residual_and_bound(mdp, Q, alpha)
    assert left > bound - (1 - alpha) * abs(mdp.residual(Q)).max()


fractions = st.fractions(-5, 5, max_denominator=9)
exact_pairs = st.integers(1, 5).flatmap(
    lambda n: st.tuples(*[st.lists(fractions, min_size=n, max_size=n)] * 2)
)


@claim("T1-b")
@given(exact_pairs)
def test_every_line_of_the_proof(pair):
    """Σ(r − αh)² = Σr² − 2αA + α²B for every α; at α = A/B it is Σr² − 2A²/B + A²/B = Σr² − A²/B.
    In fractions.
    """
    r, h = (np.array([F(x) for x in values]) for values in pair)
    A, B = (r * h).sum(), (h * h).sum()
    assume(B > 0)
    for alpha in (F(0), F(1), A / B):
        assert exact_fall(r, h, alpha) == 2 * alpha * A - alpha**2 * B
    assert exact_fall(r, h, A / B) == A**2 / B
    assert closed_form_alpha(r, h) == pytest.approx(float(A / B), rel=1e-9)
    shows("expansion, α = A/B and −2A²/B + A²/B = −A²/B, exactly, on random fractions")


def exact_fall(r, h, alpha):
    """Σ r² − Σ (r − αh)², in fractions."""
    return (r * r).sum() - ((r - alpha * h) ** 2).sum()


@control("T1-b")
def test_control_another_alpha_breaks_the_last_line():
    """With half of α the fall is ¾ A²/B."""
    r, h = np.array([F(2), F(1)]), np.array([F(1), F(1)])
    A, B = (r * h).sum(), (h * h).sum()
    assert exact_fall(r, h, A / (2 * B)) == F(3, 4) * A**2 / B


def sampled(states):
    """h(s) = s(1 − s) on these states, and its B."""
    h = np.array(states) * (1 - np.array(states))
    return h, h @ h


@claim("T1-c")
def test_a_learner_can_vanish_on_the_sample():
    """h is not 0 elsewhere; Eq. 8 reads 0/0, and the package adds nothing."""
    states = [0.0, 1.0]
    h, B = sampled(states)
    elsewhere, _ = sampled([0.5])
    assert B == 0 < elsewhere
    assert closed_form_alpha(np.array([3.0, -1.0]), h) == 0
    shows(
        "h(s) = s(1 − s) sampled at s = {} and {}: B = {} though h(½) = {:/}", *states, B, elsewhere
    )


@control("T1-c")
def test_control_one_sample_off_its_zeros_is_enough():
    """With one state moved to ½ B is positive, and α is A/B."""
    h, B = sampled([0.0, 0.5])
    assert B > 0 and closed_form_alpha(np.array([3.0, 0.5]), h) == 0.5 * h[1] / B


def falls_with(residual, h, eta):
    """What Σ r² falls by with the step η α h, and with η h."""
    return fall(residual, eta * closed_form_alpha(residual, h) * h), fall(residual, eta * h)


@claim("T1-d")
@given(vectors, st.floats(0, 3))
def test_what_shrinkage_leaves_of_the_fall(vectors, eta):
    """(2η − η²) A²/B where η multiplies α, 2ηA − η²B where it takes the place of α."""
    residual, h = vectors
    assume(h.any())
    A, B, scale = residual @ h, h @ h, squares(residual) + 9 * squares(h)
    times, instead = falls_with(residual, h, eta)
    assert times == pytest.approx((2 * eta - eta**2) * A**2 / B, abs=1e-11 * scale)
    assert instead == pytest.approx(2 * eta * A - eta**2 * B, abs=1e-11 * scale)
    shows("η · α: (2η − η²) A²/B; η for α: 2ηA − η²B, negative where α < η/2")


@claim("T1-d")
def test_the_printed_shrinkage_leaves_a_fifth_of_the_fall():
    """Compared with the whole step on the same residual."""
    residual, h = np.array([2.0, -1.0]), np.array([1.0, 1.0])
    (part, _), (whole, _) = (falls_with(residual, h, eta) for eta in (paper.SHRINKAGE, 1))
    assert 0 < part < whole
    shows("η · α at η = {} has {:.0%} of the fall", paper.SHRINKAGE, part / whole)


@control("T1-d")
@pytest.mark.parametrize(("eta", "alpha", "reading"), [(2.5, 1.0, 0), (0.1, 0.04, 1)])
def test_control_too_large_a_step_raises_it(eta, alpha, reading):
    """η above 2 as a factor of α, and η above 2α in its place."""
    h = np.array([1.0, 1.0])
    assert falls_with(alpha * h, h, eta)[reading] < 0


def weighted_fall(residual, h, w, alpha):
    """How far Σ w r² falls with the step αh."""
    return (w * residual**2).sum() - (w * (residual - alpha * h) ** 2).sum()


@claim("T1-e")
@given(vectors, st.integers(0, 10**6))
def test_the_weighted_residual_falls_under_the_weighted_alpha(vectors, seed):
    """By A_w²/B_w, with the same weights in α."""
    residual, h = vectors
    w = np.random.default_rng(seed).uniform(0, 1, len(h))
    A, B = (w * residual * h).sum(), (w * h * h).sum()
    assume(B > 1e-6)
    found = weighted_fall(residual, h, w, closed_form_alpha(residual, h, w))
    assert found == pytest.approx(A**2 / B, abs=1e-10 * squares(residual))
    shows("Σ w r² falls by exactly A_w²/B_w, A_w = Σ w r h, B_w = Σ w h²")


@control("T1-e")
def test_control_the_unweighted_alpha_does_not_give_that_fall():
    """Without weights in α the weighted residual can rise."""
    residual, h, w = np.array([2.0, -1.0]), np.array([1.0, 1.0]), np.array([0.25, 1.0])
    assert weighted_fall(residual, h, w, closed_form_alpha(residual, h)) < 0


def least_squares(features, residual):
    """The fit in the span of the features."""
    return features @ np.linalg.lstsq(features, residual)[0]


@claim("T1-f")
@given(st.integers(0, 10**6))
def test_an_exact_fit_has_alpha_1(seed):
    """r − h ⟂ h after least squares, so A = B, and the fall is Σ h² (Pythagoras)."""
    rng = np.random.default_rng(seed)
    features, residual = rng.normal(size=(6, 2)), rng.normal(size=6)
    fit = least_squares(features, residual)
    alpha = closed_form_alpha(residual, fit)
    assert alpha == pytest.approx(1, abs=1e-6)
    assert fall(residual, fit) == pytest.approx(squares(fit), abs=1e-9)
    shows("linear class: α = {:.0f}, fall Σ h²", alpha)


# A network with a linear output layer (v, b) has h = ∂h/∂v · v + ∂h/∂b · b. With L = ½ Σ (r − h)²,
# hence Σ (r − h) h = −(v · ∂L/∂v + b ∂L/∂b), and A − B = Σ (r − h) h.


@claim("T1-f")
@given(st.integers(0, 10**6))
def test_a_network_at_a_stationary_point_has_alpha_1(seed):
    """1 − α = (v · ∂L/∂v + b ∂L/∂b)/B at every θ, so it is 0 where the gradient is."""
    rng = np.random.default_rng(seed)
    features, residual, net = rng.normal(size=(6, 2)), rng.normal(size=6), MLP((2, 4, 1))
    theta = net.init(rng).astype(np.float64)
    h, cache = net.forward(theta, features)
    gradient = net.backward(theta, cache, h - residual[:, None])
    output = net.layers(theta)[-1] * net.layers(gradient)[-1]
    excess = 1 - closed_form_alpha(residual, h[:, 0])
    assert excess == pytest.approx(output.sum() / squares(h[:, 0]), abs=1e-9 * (1 + abs(excess)))
    shows("network: 1 − α = (v · ∂L/∂v + b ∂L/∂b)/B, 0 at a stationary point")


@control("T1-f")
def test_control_half_a_fit_has_alpha_2():
    """What is not fitted to the end has another α: of half of the fit, 2."""
    features, residual = np.eye(3)[:, :2], np.array([1.0, 2.0, 3.0])
    fit = least_squares(features, residual)
    assert closed_form_alpha(residual, fit / 2) == pytest.approx(2)


def left_by_constants(residual, boosts=2):
    """Σ r² at the start and after each best constant, of boosters that see one pair (s, a)."""
    found, h = [squares(residual)], np.ones_like(residual)
    for _ in range(boosts):
        residual = residual - closed_form_alpha(residual, h) * h
        found.append(squares(residual))
    return found


@claim("T1-i")
def test_it_falls_until_only_noise_is_left():
    """One pair twice, with targets ±1 and Q = 1: one booster finds Q* = 0, the mean of the targets,
    and the next one has A = 0.
    """
    targets, Q = np.array([1.0, -1.0]), 1
    before, after, later = left_by_constants(targets - Q)
    assert before > after == later == squares(targets) > 0
    shows(
        "(s, a) twice with y = ±{}, Q = {}: Σ r² = {}, then {}, Q being Q*, then {}",
        *(targets[0], Q, before, after, later),
    )


@control("T1-i")
def test_control_without_noise_nothing_is_left():
    """Both targets are 1, and Q is 0: the residual falls to 0."""
    before, *_, after = left_by_constants(np.ones(2))
    assert before > after == 0


def whole_before_and_after(sampled):
    """(α from the first so many samples, Σ r² of all of them before and after the step)."""
    residual, h = np.array([1.0, -3.0]), np.array([1.0, 1.0])
    alpha = closed_form_alpha(residual[:sampled], h[:sampled])
    return residual, h, alpha, squares(residual), squares(residual - alpha * h)


@claim("T1-j")
def test_a_minibatch_can_raise_the_whole():
    """The first of two samples alone is the batch."""
    residual, h, alpha, before, after = whole_before_and_after(sampled=1)
    assert after > before
    shows(
        "r = ({}), h = ({}), the first one sampled: α = {}, {} → {}",
        *(residual, h, alpha, before, after),
    )


@control("T1-j")
def test_control_from_the_whole_buffer_it_falls():
    """With both samples in α."""
    *_, before, after = whole_before_and_after(sampled=2)
    assert after < before


@claim("T1-k")
@given(vectors)
def test_a_regression_booster_lowers_the_training_loss(vectors):
    """The same identity, since labels do not move."""
    residual, h = vectors
    A, B = residual @ h, h @ h
    assume(abs(A) > 1e-3 * np.sqrt(squares(residual) * B))
    after = squares(residual - closed_form_alpha(residual, h) * h)
    assert after < squares(residual)
    assert after == pytest.approx(squares(residual) - A**2 / B, abs=1e-12 * squares(residual))
    shows(
        "Σ r² falls by A²/B on the training sample; on other samples of the same function it can"
        " rise"
    )


@control("T1-k")
def test_control_on_other_samples_it_can_rise():
    """Labels (1, −1) at two points, a constant trained on the first alone."""
    labels, h = np.array([1.0, -1.0]), np.ones(2)
    alpha = closed_form_alpha(labels[:1], h[:1])
    assert fall(labels[:1], alpha * h[:1]) > 0 > fall(labels[1:], alpha * h[1:])

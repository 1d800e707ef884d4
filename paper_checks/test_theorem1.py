"""Theorem 1: a boosting step with the closed-form α lowers the squared residual. True of a frozen
target, only of it.

With A = Σ r_i h_i and B = Σ h_i² the frozen residual falls by exactly A²/B. The paper's reading,
that the *Bellman* residual falls, is false: its target moves with Q. What holds for it is a bound
in the sup norm.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.nn import MLP
from gbdqn_ref.tabular import MDP

numbers = st.floats(-100, 100).filter(lambda x: x == 0 or abs(x) > 1e-3)
vectors = st.integers(1, 8).flatmap(
    lambda n: st.tuples(*[st.lists(numbers, min_size=n, max_size=n).map(np.array)] * 2)
)


def squares(x):
    return float(x @ x)


@claim(
    "T1-a",
    place="Theorem 1",
    says="a boosting step with the closed-form α strictly lowers the squared residual",
    verdict="holds if the target is frozen and A ≠ 0",
    uses="boosting.closed_form_alpha",
)
@given(vectors)
def test_the_frozen_residual_falls_by_exactly_a_squared_over_b(vectors):
    """Theorem 1 as its proof has it: Σ(y − Q_m)² − Σ(y − Q_{m−1})² = −A²/B. No argmin is needed,
    only h ≠ 0.
    """
    residual, h = vectors
    assume(h.any())
    alpha = closed_form_alpha(residual, h)
    fall = squares(residual) - squares(residual - alpha * h)
    assert fall == pytest.approx((residual @ h) ** 2 / (h @ h), abs=1e-12 * squares(residual))
    shows("it falls by exactly A²/B, A = Σ r h, B = Σ h²")


@control("T1-a")
@given(vectors, st.floats(0.01, 0.99))
def test_control_any_other_step_falls_by_less(vectors, part):
    """Negative control: with part · α the fall is (2 part − part²) A²/B, so the identity does pick
    out α.
    """
    residual, h = vectors
    assume(abs(residual @ h) > 1e-3 * np.sqrt(squares(residual) * squares(h)))
    alpha = part * closed_form_alpha(residual, h)
    fall, best = squares(residual) - squares(residual - alpha * h), (residual @ h) ** 2 / (h @ h)
    assert fall == pytest.approx((2 * part - part**2) * best, abs=1e-12 * squares(residual))
    assert fall < best * (1 - (1 - part) ** 2 / 2)


def drifted_loop(gamma):
    """One state, two actions that stay in it; the rewards drift from (0, 0) to (0, 1), so Q*_old =
    0.
    """
    P = np.array([[[F(1)], [F(1)]]])
    return MDP(P, np.array([[F(0), F(1)]]), gamma), np.array([[F(0), F(0)]])


@claim(
    "T1-g",
    place="Theorem 1",
    says="each boosting step strictly lowers the squared Bellman residual",
    verdict="fails: the Bellman residual's target moves with Q",
    uses="tabular.MDP, boosting.closed_form_alpha",
)
@pytest.mark.parametrize("gamma", [F(9, 10), F(99, 100)])
def test_the_bellman_residual_can_rise_under_a_perfect_booster(gamma):
    """The statement fails with y recomputed from Q_m: α = 1, h = the whole residual, and 1 becomes
    2γ² > 1.
    """
    mdp, Q = drifted_loop(gamma)
    h = mdp.residual(Q)
    assert closed_form_alpha(mdp.residual(Q).ravel().astype(float), h.ravel().astype(float)) == 1
    assert (mdp.residual(Q) ** 2).sum() == 1
    assert (mdp.residual(Q + h) ** 2).sum() == 2 * gamma**2 > 1
    shows("1 state, 2 actions, r (0, 0) → (0, 1), Q = Q*_old: 1 becomes 2γ² (1.62 at γ = 0.9)")


def test_it_rises_even_with_the_papers_own_constants():
    """γ = 0.99 and η = 0.1: 1 becomes 1.007802, exactly."""
    mdp, Q = drifted_loop(F(99, 100))
    assert (mdp.residual(Q + F(1, 10) * mdp.residual(Q)) ** 2).sum() == F(1007802, 1000000)


@control("T1-g")
def test_control_with_a_short_horizon_it_does_fall():
    """Negative control: below γ = 1/√2 the same example falls, so the rise above is the doing of
    the moving target.
    """
    mdp, Q = drifted_loop(F(7, 10))
    assert (mdp.residual(Q + mdp.residual(Q)) ** 2).sum() == 2 * F(49, 100) < 1


@claim(
    "T1-h",
    place="Theorem 1",
    says="what takes its place: ‖res(Q + αg)‖∞ ≤ (|1 − α| + αγ) ‖g‖∞",
    verdict="holds",
    uses="tabular.MDP",
)
@given(st.integers(0, 10**6), st.floats(0, 2.5), st.floats(0, 0.99))
def test_what_holds_instead_is_a_bound_in_the_sup_norm(seed, alpha, gamma):
    """‖res(Q + αg)‖∞ ≤ (|1 − α| + αγ) ‖g‖∞: res(Q + αg) = (1 − α) g + 𝒯(Q + αg) − 𝒯Q, and 𝒯 is a
    γ-contraction.
    """
    rng = np.random.default_rng(seed)
    mdp = MDP(rng.dirichlet(np.ones(4), size=(4, 3)), rng.normal(size=(4, 3)), gamma)
    Q = rng.normal(size=(4, 3))
    g = mdp.residual(Q)
    bound = (abs(1 - alpha) + alpha * gamma) * np.abs(g).max()
    assert np.abs(mdp.residual(Q + alpha * g)).max() <= bound * (1 + 1e-9) + 1e-12
    shows(
        "random MDPs of 4 states and 3 actions; tight on the loop; a contraction iff 0 < α < 2/(1"
        " + γ)"
    )


@control("T1-h")
def test_control_the_bound_is_tight():
    """Negative control: on the loop with γ = 9/10 the bound is met at α = 1, so no smaller factor
    would do.
    """
    mdp, Q = drifted_loop(F(9, 10))
    g = mdp.residual(Q)
    assert abs(mdp.residual(Q + g)).max() == F(9, 10) * abs(g).max()


def linear_class(gamma):
    """One state, two loops without reward, φ = (1, 2), Q = φ, only the first action in the sample:
    γ and the MDP.
    """
    return MDP(np.array([[[F(1)], [F(1)]]]), np.array([[F(0), F(0)]]), gamma), np.array(
        [[F(1), F(2)]]
    )


@pytest.mark.parametrize("gamma", [F(9, 10), F(99, 100)])
def test_with_function_approximation_one_sample_is_enough(gamma):
    """h = c φ fits the only residual exactly, moves the other action by 2c, and the target with it:
    × (2γ)².
    """
    mdp, phi = linear_class(gamma)
    residual = mdp.residual(phi)[0, 0]
    after = phi + residual * phi  # φ is 1 at the sampled action: an exact fit, α = 1
    assert mdp.residual(after)[0, 0] ** 2 == (2 * gamma) ** 2 * residual**2 > residual**2
    assert gamma != F(9, 10) or (residual**2, mdp.residual(after)[0, 0] ** 2) == (
        F(64, 100),
        F(20736, 10000),
    )


@pytest.mark.parametrize("copies", [1, 3, 30])
def test_replayed_more_often_it_rises_without_bound(copies):
    """With the silent action k times in the sample the sum rises from 1 to (k + 1) γ²."""
    mdp, Q = drifted_loop(F(9, 10))
    after = mdp.residual(Q + mdp.residual(Q))[0]
    assert copies * after[0] ** 2 + after[1] ** 2 == (copies + 1) * F(81, 100)


fractions = st.fractions(-5, 5, max_denominator=9)
exact_pairs = st.integers(1, 5).flatmap(
    lambda n: st.tuples(*[st.lists(fractions, min_size=n, max_size=n)] * 2)
)


@claim(
    "T1-b",
    place="Theorem 1, proof",
    says="each line of the proof",
    verdict="holds",
    uses="boosting.closed_form_alpha",
)
@given(exact_pairs)
def test_every_line_of_the_proof(pair):
    """Σ(r − αh)² = Σr² − 2αA + α²B for every α; at α = A/B it is Σr² − 2A²/B + A²/B = Σr² − A²/B.
    In fractions.
    """
    r, h = (np.array([F(x) for x in values]) for values in pair)
    A, B = (r * h).sum(), (h * h).sum()
    assume(B > 0)
    for alpha in (F(0), F(1), A / B):
        assert ((r - alpha * h) ** 2).sum() == (r * r).sum() - 2 * alpha * A + alpha**2 * B
    assert ((r - A / B * h) ** 2).sum() == (r * r).sum() - A**2 / B
    assert closed_form_alpha(r.astype(float), h.astype(float)) == pytest.approx(
        float(A / B), rel=1e-9
    )
    shows("expansion, α = A/B and −2A²/B + A²/B = −A²/B, exactly, on random fractions")


@control("T1-b")
def test_control_another_alpha_breaks_the_last_line():
    """Negative control: with α = A/(2B) the fall is ¾ A²/B."""
    r, h = np.array([F(2), F(1)]), np.array([F(1), F(1)])
    A, B = (r * h).sum(), (h * h).sum()
    assert (r * r).sum() - ((r - A / (2 * B) * h) ** 2).sum() == F(3, 4) * A**2 / B


@claim(
    "T1-c",
    place="Theorem 1, proof",
    says="B > 0 for a weak learner other than 0",
    verdict="holds if it is other than 0 on the sample; elsewhere does not count",
    uses="boosting.closed_form_alpha",
)
def test_a_learner_can_vanish_on_the_sample():
    """h(s) = s(1 − s) on states 0 and 1: B = 0, Eq. 8 is 0/0, and the package adds nothing."""
    states = np.array([0.0, 1.0])
    h = states * (1 - states)
    assert h @ h == 0 and 0.5 * (1 - 0.5) != 0
    assert closed_form_alpha(np.array([3.0, -1.0]), h) == 0
    shows("h(s) = s(1 − s) sampled at s = 0 and 1: B = 0 though h(½) = ¼")


@control("T1-c")
def test_control_one_sample_off_its_zeros_is_enough():
    states = np.array([0.0, 0.5])
    h = states * (1 - states)
    assert h @ h > 0 and closed_form_alpha(np.array([3.0, 0.5]), h) == 2


@claim(
    "T1-d",
    place="Theorem 1, section Acrobot",
    says="with a shrinkage η the step still lowers the residual",
    verdict="holds if η multiplies α and 0 < η < 2; if η takes the place of α, only where η < 2α",
    uses="boosting.closed_form_alpha",
)
@given(vectors, st.floats(0, 3))
def test_what_shrinkage_leaves_of_the_fall(vectors, eta):
    """Σ(r − ηαh)² = Σr² − (2η − η²) A²/B; Σ(r − ηh)² = Σr² − 2ηA + η²B."""
    residual, h = vectors
    assume(h.any())
    A, B, scale = residual @ h, h @ h, squares(residual) + 9 * squares(h)
    part = squares(residual) - squares(residual - eta * closed_form_alpha(residual, h) * h)
    assert part == pytest.approx((2 * eta - eta**2) * A**2 / B, abs=1e-11 * scale)
    assert squares(residual) - squares(residual - eta * h) == pytest.approx(
        2 * eta * A - eta**2 * B, abs=1e-11 * scale
    )
    shows(
        "η · α: (2η − η²) A²/B, at η = 0.1 19 % of the fall; η for α: 2ηA − η²B, negative where α"
        " < η/2"
    )


@control("T1-d")
def test_control_too_large_a_step_raises_it():
    """Negative control: η = 2.5, and η = 0.1 in the place of α = 0.04."""
    residual, h = np.array([1.0, 1.0]), np.array([1.0, 1.0])
    assert squares(residual - 2.5 * closed_form_alpha(residual, h) * h) > squares(residual)
    assert closed_form_alpha(0.04 * h, h) == pytest.approx(0.04)
    assert squares(0.04 * h - 0.1 * h) > squares(0.04 * h)


@claim(
    "T1-e",
    place="Theorem 1, Eq. 6",
    says="it holds of the weighted residual too",
    verdict=(
        "holds if α is weighted as well: the fall is A_w²/B_w; with Eq. 8's α it may rise (M12)"
    ),
    uses="boosting.closed_form_alpha",
)
@given(vectors, st.integers(0, 10**6))
def test_the_weighted_residual_falls_under_the_weighted_alpha(vectors, seed):
    residual, h = vectors
    w = np.random.default_rng(seed).uniform(0, 1, len(h))
    assume((w * h * h).sum() > 1e-6)
    alpha = closed_form_alpha(residual, h, w)
    fall = (w * residual**2).sum() - (w * (residual - alpha * h) ** 2).sum()
    expected = (w * residual * h).sum() ** 2 / (w * h * h).sum()
    assert fall == pytest.approx(expected, abs=1e-10 * squares(residual))
    shows("Σ w r² falls by exactly A_w²/B_w, A_w = Σ w r h, B_w = Σ w h²")


@control("T1-e")
def test_control_the_unweighted_alpha_does_not_give_that_fall():
    residual, h, w = np.array([2.0, -1.0]), np.array([1.0, 1.0]), np.array([0.25, 1.0])
    alpha = closed_form_alpha(residual, h)
    assert (w * (residual - alpha * h) ** 2).sum() > (w * residual**2).sum()


@claim(
    "T1-f",
    place="Theorem 1, Eqs. 7–8",
    says="after an exact fit there is a step size left to choose",
    verdict=(
        "fails: a least-squares fit in a linear class has α = 1, and so has a network at a"
        " stationary point"
    ),
    uses="boosting.closed_form_alpha, nn.MLP",
)
@given(st.integers(0, 10**6))
def test_an_exact_fit_has_alpha_1(seed):
    """Least squares: r − h ⟂ h, so A = B and the fall is Σh² (Pythagoras).

    Any network with a linear output layer (v, b): h = ∂h/∂v · v + ∂h/∂b · b, so Σ (r − h) h = −(v
    ∂L + b ∂L)/∂(v, b), with L = ½ Σ (r − h)²: 1 − α = (v · ∂L/∂v + b ∂L/∂b)/B without any training,
    and 0 where the gradient is.
    """
    rng = np.random.default_rng(seed)
    features, residual = rng.normal(size=(6, 2)), rng.normal(size=6)
    fit = features @ np.linalg.lstsq(features, residual)[0]
    assert closed_form_alpha(residual, fit) == pytest.approx(1, abs=1e-6)
    assert squares(residual) - squares(residual - fit) == pytest.approx(squares(fit), abs=1e-9)
    net = MLP((2, 4, 1))
    theta = net.init(rng).astype(np.float64)
    h, cache = net.forward(theta, features)
    gradient = net.backward(theta, cache, h - residual[:, None])
    output = net.layers(theta)[-1] * net.layers(gradient)[-1]
    excess = 1 - closed_form_alpha(residual, h[:, 0])
    assert excess == pytest.approx(output.sum() / squares(h[:, 0]), abs=1e-9 * (1 + abs(excess)))
    shows(
        "linear class: α = 1, fall Σ h²; network: 1 − α = (v · ∂L/∂v + b ∂L/∂b)/B, 0 at a"
        " stationary point"
    )


@control("T1-f")
def test_control_half_a_fit_has_alpha_2():
    """Negative control: what is not fitted to the end has another α: of half of the fit, 2."""
    features, residual = np.eye(3)[:, :2], np.array([1.0, 2.0, 3.0])
    fit = features @ np.linalg.lstsq(features, residual)[0]
    assert closed_form_alpha(residual, fit / 2) == pytest.approx(2)


@claim(
    "T1-i",
    place="Theorem 1",
    says="with random rewards too the residual falls at each step",
    verdict=(
        "holds if the target is frozen, down to the noise: where only that is left, A = 0 and"
        " nothing falls"
    ),
    uses="boosting.closed_form_alpha",
)
def test_noise_is_a_floor():
    """The same (s, a) twice, y = ±1, Q = Q* = 0: the best constant is 0, and Σ r² = 2 stays for
    ever.
    """
    residual, h = np.array([1.0, -1.0]), np.array([1.0, 1.0])
    assert closed_form_alpha(residual, h) == 0
    assert squares(residual - closed_form_alpha(residual, h) * h) == 2
    shows("(s, a) twice with y = ±1: Q = Q*, Σ r² = 2, and no function of (s, a) lowers it")


@control("T1-i")
def test_control_above_the_floor_it_falls():
    """Negative control: from Q = 1 on the same two samples, to the floor of 2."""
    residual, h = np.array([0.0, -2.0]), np.array([1.0, 1.0])
    assert squares(residual - closed_form_alpha(residual, h) * h) == 2 < squares(residual) == 4


@claim(
    "T1-j",
    place="Theorem 1",
    says="α from a minibatch lowers the residual of the replay buffer",
    verdict="fails: it lowers that of the minibatch",
    uses="boosting.closed_form_alpha",
)
def test_a_minibatch_can_raise_the_whole():
    """r = (1, −3), h = (1, 1), the first one sampled: α = 1, and Σ r² rises from 10 to 16."""
    residual, h = np.array([1.0, -3.0]), np.array([1.0, 1.0])
    alpha = closed_form_alpha(residual[:1], h[:1])
    assert (squares(residual), squares(residual - alpha * h)) == (10, 16)
    shows("r = (1, −3), h = (1, 1), batch {1}: α = 1, 10 → 16")


@control("T1-j")
def test_control_from_the_whole_buffer_it_falls():
    residual, h = np.array([1.0, -3.0]), np.array([1.0, 1.0])
    assert squares(residual - closed_form_alpha(residual, h) * h) == 8


@claim(
    "T1-k",
    place="section Theoretical Analysis",
    says="in supervised learning each boosting step strictly lowers the loss",
    verdict="holds if it is the training loss, α is exact and A ≠ 0",
    uses="boosting.closed_form_alpha",
)
@given(vectors)
def test_a_regression_booster_never_raises_the_training_loss(vectors):
    """The same identity: labels do not move."""
    residual, h = vectors
    after = squares(residual - closed_form_alpha(residual, h) * h)
    assert after <= squares(residual) * (1 + 1e-12)
    shows(
        "Σ r² falls by A²/B ≥ 0 on the training sample; on other samples of the same function it"
        " can rise"
    )


@control("T1-k")
def test_control_on_other_samples_it_can_rise():
    """Negative control: labels (1, −1) at two points, a constant trained on the first alone."""
    train, test, h = np.array([1.0]), np.array([-1.0]), np.array([1.0])
    alpha = closed_form_alpha(train, h)
    assert squares(train - alpha * h) == 0 and squares(test - alpha * h) == 4 > squares(test)

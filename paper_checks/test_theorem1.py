"""Theorem 1: a boosting step with the closed-form α lowers the squared residual. True of a frozen target, only of it.

With A = Σ r_i h_i and B = Σ h_i² the frozen residual falls by exactly A²/B. The paper's reading, that the *Bellman*
residual falls, is false: its target moves with Q. What holds for it is a bound in the sup norm.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.tabular import MDP

numbers = st.floats(-100, 100).filter(lambda x: x == 0 or abs(x) > 1e-3)
vectors = st.integers(1, 8).flatmap(lambda n: st.tuples(*[st.lists(numbers, min_size=n, max_size=n).map(np.array)] * 2))


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
    """Theorem 1 as its proof has it: Σ(y − Q_m)² − Σ(y − Q_{m−1})² = −A²/B. No argmin is needed, only h ≠ 0."""
    residual, h = vectors
    assume(h.any())
    alpha = closed_form_alpha(residual, h)
    fall = squares(residual) - squares(residual - alpha * h)
    assert fall == pytest.approx((residual @ h) ** 2 / (h @ h), abs=1e-12 * squares(residual))
    shows("it falls by exactly A²/B, A = Σ r h, B = Σ h²")


@control("T1-a")
@given(vectors, st.floats(0.01, 0.99))
def test_control_any_other_step_falls_by_less(vectors, part):
    """Negative control: with part · α the fall is (2 part − part²) A²/B, so the identity does pick out α."""
    residual, h = vectors
    assume(abs(residual @ h) > 1e-3 * np.sqrt(squares(residual) * squares(h)))
    alpha = part * closed_form_alpha(residual, h)
    fall, best = squares(residual) - squares(residual - alpha * h), (residual @ h) ** 2 / (h @ h)
    assert fall == pytest.approx((2 * part - part**2) * best, abs=1e-12 * squares(residual))
    assert fall < best * (1 - (1 - part) ** 2 / 2)


def drifted_loop(gamma):
    """One state, two actions that stay in it; the rewards drift from (0, 0) to (0, 1), so Q*_old = 0."""
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
    """The statement fails with y recomputed from Q_m: α = 1, h = the whole residual, and 1 becomes 2γ² > 1."""
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
    """Negative control: below γ = 1/√2 the same example falls, so the rise above is the doing of the moving target."""
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
    """‖res(Q + αg)‖∞ ≤ (|1 − α| + αγ) ‖g‖∞: res(Q + αg) = (1 − α) g + 𝒯(Q + αg) − 𝒯Q, and 𝒯 is a γ-contraction."""
    rng = np.random.default_rng(seed)
    mdp = MDP(rng.dirichlet(np.ones(4), size=(4, 3)), rng.normal(size=(4, 3)), gamma)
    Q = rng.normal(size=(4, 3))
    g = mdp.residual(Q)
    bound = (abs(1 - alpha) + alpha * gamma) * np.abs(g).max()
    assert np.abs(mdp.residual(Q + alpha * g)).max() <= bound * (1 + 1e-9) + 1e-12
    shows("random MDPs of 4 states and 3 actions; tight on the loop; a contraction iff 0 < α < 2/(1 + γ)")


@control("T1-h")
def test_control_the_bound_is_tight():
    """Negative control: on the loop with γ = 9/10 the bound is met at α = 1, so no smaller factor would do."""
    mdp, Q = drifted_loop(F(9, 10))
    g = mdp.residual(Q)
    assert abs(mdp.residual(Q + g)).max() == F(9, 10) * abs(g).max()

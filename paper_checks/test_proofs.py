"""Rows of the ledger that are proved for every instance of a stated size, by an SMT solver.

Each test first has the statement proved, then leaves out one assumption, or changes one term, and
has a counterexample found, which the package's own functions confirm in exact fractions. Letters as
in the other files; G, E bound a sup norm, so that a statement about every G ≥ ‖g‖∞ is one about
‖g‖∞.
"""

from fractions import Fraction as F

import numpy as np
import pytest
import z3
from ledger import committed
from smt import (
    PROOFS,
    AnyMDP,
    both,
    counterexample,
    equal,
    maximum,
    proved,
    proves,
    size,
    symbols,
    unknowns,
    within,
)

from gbdqn_ref.bellman import loss_gradient, td_target, weighted_loss
from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.optim import polyak
from gbdqn_ref.replay import importance_weights, mixed_priority
from gbdqn_ref.tabular import MDP

alpha, eta, beta, G, E, eps = z3.Reals("alpha eta beta G E eps")
r, h, w = (unknowns(name, 3) for name in "rhw")
Q, X, g, zero = unknowns("Q", 2, 2), unknowns("X", 2, 2), unknowns("g", 2, 2), np.zeros((2, 2), int)


def squares(x, weights=1):
    return (weights * x * x).sum()


def fall(r, h, alpha, weights=1):
    """By how much Σ w r² falls when α h is taken off the residual r."""
    return squares(r, weights) - squares(r - h * alpha, weights)


def step(r, h, weights=1):
    """The numerator A and the denominator B of Eq. 8."""
    return (weights * r * h).sum(), squares(h, weights)


def floats(x):
    return np.asarray(x, float)


# Eqs. 1–9 and Theorem 1: samples

THREE = "every residual and learner on three samples"


@proves("T1-a", size=THREE, without="A ≠ 0")
def test_the_frozen_residual_falls_by_a_squared_over_b():
    A, B = step(r, h)
    assert proved(fall(r, h, alpha) * B == A * A, alpha * B == A)
    assert proved(fall(r, h, alpha) > 0, alpha * B == A, A != 0)
    found = counterexample(fall(r, h, alpha) > 0, alpha * B == A, B > 0)
    assert closed_form_alpha(floats(found(r)), floats(found(h))) == found(alpha) == 0


@proves("T1-b", size=THREE + ", every α", without="the factor 2 of the middle term")
def test_the_expansion_of_the_square():
    A, B = step(r, h)
    assert proved(squares(r - h * alpha) == squares(r) - 2 * alpha * A + alpha * alpha * B)
    found = counterexample(squares(r - h * alpha) == squares(r) - alpha * A + alpha * alpha * B)
    A, B = step(found(r), found(h))
    assert squares(found(r) - found(alpha) * found(h)) != (
        squares(found(r)) - found(alpha) * A + found(alpha) ** 2 * B
    )


@proves("T1-c", size=THREE, without="that the place where h is not 0 is in the sample")
def test_b_is_positive_if_h_is_not_zero_on_the_sample():
    elsewhere = z3.Real("elsewhere")
    assert proved(step(r, h)[1] > 0, z3.Not(equal(h, np.zeros(3, int))))
    found = counterexample(
        step(r, h)[1] > 0, z3.Or(elsewhere != 0, z3.Not(equal(h, np.zeros(3, int))))
    )
    assert found(elsewhere) != 0 and not found(h).any()
    assert closed_form_alpha(floats(found(r)), floats(found(h))) == 0


@proves("T1-d", size=THREE + ", every η", without="η < 2, or η < 2α")
def test_what_shrinkage_leaves_of_the_fall():
    A, B = step(r, h)
    best = [alpha * B == A, A != 0]
    assert proved((fall(r, h, eta * alpha) > 0) == z3.And(0 < eta, eta < 2), *best)
    assert proved(fall(r, h, eta) > 0, *best, 0 < eta, eta < 2 * alpha)
    for step_size in (eta * alpha, eta):
        found = counterexample(fall(r, h, step_size) > 0, *best, 0 < eta)
        exact = found(alpha)
        assert closed_form_alpha(floats(found(r)), floats(found(h))) == pytest.approx(float(exact))
        assert fall(found(r), found(h), found(step_size)) <= 0


@proves("T1-e", "M12", size="every residual, learner and weight ≥ 0 on three samples", without="w")
def test_the_weighted_residual_falls_under_the_weighted_step():
    """M12 is the control: Eq. 8's own α, without w, can raise the weighted residual."""
    A, B = step(r, h, w)
    weights = [weight >= 0 for weight in w]
    assert proved(fall(r, h, alpha, w) * B == A * A, alpha * B == A)
    assert proved(fall(r, h, alpha, w) >= 0, alpha * B == A, B > 0, *weights)
    plain = step(r, h)
    found = counterexample(
        fall(r, h, alpha, w) >= 0, alpha * plain[1] == plain[0], plain[1] > 0, *weights
    )
    unweighted = closed_form_alpha(floats(found(r)), floats(found(h)))
    assert unweighted == pytest.approx(float(found(alpha)))
    assert fall(found(r), found(h), found(alpha), found(w)) < 0


@proves("T1-f", size="every residual and feature on three samples", without="that c fits best")
def test_an_exact_fit_has_alpha_1():
    """h = c φ and Σ (r − c φ) φ = 0, the condition of least squares, give A = B."""
    c, phi = z3.Real("c"), unknowns("phi", 3)
    h = phi * c
    A, B = step(r, h)
    fitted = ((r - h) * phi).sum() == 0
    assert proved(alpha == 1, fitted, alpha * B == A, B > 0)
    found = counterexample(alpha == 1, alpha * B == A, B > 0)
    exact = closed_form_alpha(floats(found(r)), floats(found(h)))
    assert exact == pytest.approx(float(found(alpha))) and found(alpha) != 1


@proves("T1-i", size="two samples of one pair, their targets ± any noise", without="that h is one")
def test_noise_is_a_floor():
    """Q is the mean of the two targets, so r = (n, −n); whatever h does to the pair, A = 0."""
    noise, one = z3.Real("noise"), z3.Real("one")
    r, h = symbols([noise, -noise]), symbols([one, one])
    assert proved(both(step(r, h)[0] == 0, fall(r, h, alpha) <= 0))
    found = counterexample(fall(r, unknowns("h", 2), alpha) <= 0)
    assert fall(found(r), found(unknowns("h", 2)), found(alpha)) > 0


@proves("M2", size=THREE, without="that h fits no worse than 0")
def test_a_step_is_at_least_half_where_h_fits_no_worse_than_0():
    """Σ (r − h)² ≤ Σ r² says the same as α ≥ ½."""
    A, B = step(r, h)
    best = [alpha * B == A, B > 0]
    assert proved((squares(r - h) <= squares(r)) == (2 * alpha >= 1), *best)
    found = counterexample(alpha > 0, *best)
    assert closed_form_alpha(floats(found(r)), floats(found(h))) == float(found(alpha)) <= 0


@proves("M3", "M4", size=THREE + ", every w", without="that the target is held fixed")
def test_the_weighted_residual_is_the_gradient():
    """L(Q + t at one sample) = L(Q) + t ∂L/∂Q + ½ w t²/n for every t, so ∂L/∂Q is the slope."""
    t, moves = z3.Real("t"), z3.Real("moves")
    slope = loss_gradient(r, w, np.zeros(3, int), 1)[:, 0]

    def follows(change):
        after = weighted_loss(r - symbols([change, 0, 0]), w)
        return after == weighted_loss(r, w) + t * slope[0] + w[0] * t * t / 6

    assert proved(follows(t))
    found = counterexample(follows(t * (1 - moves)), moves != 0)  # y moves with Q
    change = np.array([found(t * (1 - moves)), 0, 0])
    assert weighted_loss(found(r) - change, found(w)) != pytest.approx(
        float(weighted_loss(found(r), found(w)) + found(t * slope[0] + w[0] * t * t / 6))
    )


@proves("M5", "W1", size="every P > 0 of three transitions and every loss", without="exponent 1")
def test_with_exponent_1_the_weights_are_unbiased():
    P, loss = unknowns("P", 3), unknowns("loss", 3)
    drawn = [*(p > 0 for p in P), P.sum() == 1]
    assert proved((P * loss / (P * 3)).sum() * 3 == loss.sum(), *drawn)
    found = counterexample((P * loss).sum() * 3 == loss.sum(), *drawn)  # exponent 0
    means = [
        (found(P) * importance_weights(found(P), 3, exponent, None) * found(loss)).sum()
        for exponent in (1, 0)
    ]
    assert means[0] == found(loss.sum()) / 3 != means[1]


@proves("M8", size=THREE + ", every w ≥ 0", without="the root")
def test_a_weight_can_be_moved_inside_as_its_root():
    root = unknowns("root", 3)
    inside = [both(s >= 0, s * s == weight) for s, weight in zip(root, w, strict=True)]
    assert proved(squares(r - h * alpha, w) == squares(r * root - h * root * alpha), *inside)
    found = counterexample(squares(r - h * alpha, w) == squares(r * w - h * w * alpha), w[0] > 0)
    error = found(r) - found(alpha) * found(h)
    assert squares(error, found(w)) != squares(found(w) * error)


@proves("M11", size=THREE + ", every other step", without="that h is not 0 on the sample")
def test_the_closed_form_is_the_only_minimiser():
    other, (A, B) = z3.Real("other"), step(r, h)
    best = alpha * B == A
    assert proved(squares(r - h * alpha) < squares(r - h * other), best, B > 0, other != alpha)
    found = counterexample(squares(r - h * alpha) < squares(r - h * other), best, other != alpha)
    assert not found(h).any() and found(other) != found(alpha)
    assert closed_form_alpha(floats(found(r)), floats(found(h))) == 0


@proves("M14", size="every residual and feature on three samples", without="the frozen target")
def test_a_second_fit_of_the_same_linear_class_finds_nothing():
    first, second, phi, moved = z3.Real("c"), z3.Real("c2"), unknowns("phi", 3), unknowns("m", 3)
    left = r - phi * first
    fits = [(left * phi).sum() == 0, squares(phi) > 0]
    assert proved(second == 0, *fits, ((left - phi * second) * phi).sum() == 0)
    found = counterexample(second == 0, *fits, ((left + moved - phi * second) * phi).sum() == 0)
    again = closed_form_alpha(floats(found(left + moved)), floats(found(phi)))
    assert again == pytest.approx(float(found(second))) and found(second) != 0


# MDPs with two states and two actions

ALL = "every MDP with 2 states and 2 actions, every Q"


def residual_after(mdp, alpha):
    return mdp.residual(Q + mdp.residual(Q) * alpha)


@proves("T1-h", size=ALL + ", α ≥ 0", without="α ≥ 0")
def test_the_sup_norm_of_the_residual_shrinks():
    mdp = AnyMDP(Q, g)
    bound = within(residual_after(mdp, alpha), (size(1 - alpha) + alpha * mdp.discount) * G)
    assert proved(bound, *mdp.lawful, within(g, G), alpha >= 0)
    found = counterexample(bound, *mdp.lawful, within(g, G))
    world, step = mdp.instance(found), found(alpha)
    before = world.residual(found(Q))
    after = world.residual(found(Q) + step * before)
    assert abs(after).max() > (abs(1 - step) + step * world.gamma) * abs(before).max()


@proves("T1-g", size="every MDP with 1 state and 2 actions, every Q, α = 1", without="2γ² ≤ 1")
def test_the_sum_of_squares_falls_only_with_a_short_horizon():
    Q, g = unknowns("Q", 1, 2), unknowns("g", 1, 2)
    mdp = AnyMDP(Q, g)
    falls = squares(mdp.residual(Q + g)) <= squares(g)
    assert proved(falls, *mdp.lawful, 2 * mdp.discount * mdp.discount <= 1)
    found = counterexample(falls, *mdp.lawful, 100 * mdp.discount == 99)
    world = mdp.instance(found)
    before = world.residual(found(Q))
    assert squares(world.residual(found(Q) + before)) > squares(before)


@proves("T2-k", "B5", size="every MDP with 2 states and 2 actions, two Qs", without="the sup norm")
def test_the_operator_contracts_in_the_sup_norm():
    """‖𝒯Q − 𝒯X‖∞ ≤ γ ‖Q − X‖∞; summed squares may grow."""
    mdp = AnyMDP(Q, g)
    change = mdp.bellman(X) - mdp.bellman(Q)
    assert proved(within(change, mdp.discount * G), *mdp.lawful, within(X - Q, G))
    found = counterexample(squares(change) <= squares(X - Q), *mdp.lawful)
    world = mdp.instance(found)
    moved = world.bellman(found(X)) - world.bellman(found(Q))
    assert squares(moved) > squares(found(X) - found(Q))


@proves("B1", "B6", size="every MDP with 2 states and 2 actions, Q and α in (0, 1]", without="α ≤ 1")
def test_a_damped_backup_keeps_its_part_of_the_error():
    """Q* = X: ‖Q + αg − X‖∞ ≤ (1 − α(1 − γ)) ‖Q − X‖∞."""
    mdp = AnyMDP(X, zero)
    after = Q + mdp.residual(Q) * alpha - X
    kept = within(after, (1 - alpha * (1 - mdp.discount)) * E)
    assert proved(kept, *mdp.lawful, within(Q - X, E), 0 < alpha, alpha <= 1)
    found = counterexample(kept, *mdp.lawful, within(Q - X, E), 0 < alpha)
    world, step = mdp.instance(found), found(alpha)
    missed = found(Q) + step * world.residual(found(Q)) - found(X)
    assert abs(missed).max() > (1 - step * (1 - world.gamma)) * abs(found(Q) - found(X)).max()

"""Rows of the ledger that are proved for every instance of a stated size, by an SMT solver.

Each test first has the statement proved, then leaves out one assumption, or changes one term, and
has a counterexample found, which is confirmed in numbers, by the package's own functions where
there is one. Letters as in the other files; G, E bound a sup norm, so that a statement about every
G ≥ ‖g‖∞ is one about ‖g‖∞.
"""

import numpy as np
import pytest
import z3
from ledger import proves
from smt import (
    AnyMDP,
    both,
    counterexample,
    equal,
    maximum,
    proved,
    size,
    symbols,
    unknowns,
    within,
)

from gbdqn_ref.bellman import loss_gradient, td_target, weighted_loss
from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.optim import polyak
from gbdqn_ref.replay import importance_weights, mixed_priority

alpha, eta, beta, G, E, eps = z3.Reals("alpha eta beta G E eps")
mix = symbols([beta])  # an array, which NumPy can multiply
r, h, w = (unknowns(name, 3) for name in "rhw")
Q, X, g, h2 = (unknowns(name, 2, 2) for name in ("Q", "X", "g", "h2"))
zero = np.zeros((2, 2), int)


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


@proves("T1-a", "T1-k", size=THREE, without="A ≠ 0")
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
    assert proved((fall(r, h, eta * alpha) > 0) == z3.And(eta > 0, eta < 2), *best)
    assert proved(fall(r, h, eta) > 0, *best, eta > 0, eta < 2 * alpha)
    for step_size in (eta * alpha, eta):
        found = counterexample(fall(r, h, step_size) > 0, *best, eta > 0)
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
    weight = importance_weights(P, 3, 1, None)
    assert proved((P * weight * loss).sum() * 3 == loss.sum(), *drawn)
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


@proves(
    "B1", "B5", size="every MDP with 2 states and 2 actions, Q and α in (0, 1]", without="α ≤ 1"
)
def test_a_damped_backup_keeps_its_part_of_the_error():
    """Q* = X: ‖Q + αg − X‖∞ ≤ (1 − α(1 − γ)) ‖Q − X‖∞."""
    mdp = AnyMDP(X, zero)
    after = Q + mdp.residual(Q) * alpha - X
    kept = within(after, (1 - alpha * (1 - mdp.discount)) * E)
    assert proved(kept, *mdp.lawful, within(Q - X, E), alpha > 0, alpha <= 1)
    found = counterexample(kept, *mdp.lawful, within(Q - X, E), alpha > 0)
    world, step = mdp.instance(found), found(alpha)
    missed = found(Q) + step * world.residual(found(Q)) - found(X)
    assert abs(missed).max() > (1 - step * (1 - world.gamma)) * abs(found(Q) - found(X)).max()


@proves(
    "T4-d",
    size="every MDP with 1 state and 3 actions, or 2 states and 1 action; every Q and h, 0 < α ≤ 1",
    without="data on one of the pairs",
)
@pytest.mark.parametrize("shape", [(1, 3), (2, 1)])
def test_the_recursion_of_boosters_that_miss_by_epsilon(shape):
    """Q* = X: e_m ≤ (1 − α(1 − γ)) e_{m−1} + α ε; `lost` is α (h − g), at most G = α ε."""
    X, gap, lost = (unknowns(name, *shape) for name in ("X", "gap", "lost"))
    mdp = AnyMDP(X, np.zeros(shape, int))
    after = gap + mdp.residual(X + gap) * alpha + lost
    kept = within(after, (1 - alpha * (1 - mdp.discount)) * E + G)
    given = [*mdp.lawful, within(gap, E), alpha > 0, alpha <= 1]
    assert proved(kept, *given, within(lost, G))
    found = counterexample(kept, *given, within(lost.ravel()[1:], G))
    world, step, error = mdp.instance(found), found(alpha), found(gap)
    h = world.residual(found(X) + error) + found(lost) / step
    missed = abs(h - world.residual(found(X) + error)).ravel()[1:].max()
    bound = (1 - step * (1 - world.gamma)) * abs(error).max() + step * missed
    assert abs(error + step * h).max() > bound


@proves("T2-i", size=ALL, without="data on one of the pairs")
def test_a_small_residual_everywhere_is_a_q_near_q_star():
    """Q* = X: (1 − γ) ‖Q − X‖∞ ≤ ‖g‖∞."""
    mdp = AnyMDP(X, zero)
    near = within((Q - X) * (1 - mdp.discount), G)
    assert proved(near, *mdp.lawful, within(mdp.residual(Q), G))
    found = counterexample(near, *mdp.lawful, within(mdp.residual(Q).ravel()[1:], G))
    world = mdp.instance(found)
    seen = abs(world.residual(found(Q))).ravel()[1:].max()
    assert (1 - world.gamma) * abs(found(Q) - found(X)).max() > seen


@proves("C2", size=ALL + "*_old, every drift", without="data on one of the pairs")
def test_the_largest_td_error_tells_how_far_q_star_has_moved():
    """Q is Q*_old, X is Q*_new: (1 − γ) ‖X − Q‖∞ ≤ ‖𝒯_new Q − Q‖∞ ≤ (1 + γ) ‖X − Q‖∞."""
    new = AnyMDP(X, zero)
    delta, moved = new.residual(Q), X - Q
    assert proved(within(delta, (1 + new.discount) * G), *new.lawful, within(moved, G))
    lower = within(moved * (1 - new.discount), G)
    assert proved(lower, *new.lawful, within(delta, G))
    found = counterexample(lower, *new.lawful, within(delta.ravel()[1:], G))
    world = new.instance(found)
    seen = abs(world.residual(found(Q))).ravel()[1:].max()
    assert (1 - world.gamma) * abs(found(moved)).max() > seen


@proves("C1", size="every two MDPs with 2 states and 2 actions", without="that Q* moves")
def test_a_drift_that_moves_q_star_shows_in_some_td_error():
    """What is true of C1: Q*_new ≠ Q*_old gives δ ≠ 0 somewhere; that P or r changes does not."""
    old, new, same = AnyMDP(Q, zero), AnyMDP(X, zero, "new"), AnyMDP(Q, g, "new")
    assert proved(z3.Not(equal(new.residual(Q), zero)), *new.lawful, z3.Not(equal(Q, X)))
    changed = [z3.Not(equal(old.P, same.P)), z3.Not(equal(old.r, same.r))]
    found = counterexample(z3.Not(equal(g, zero)), *old.lawful, *same.lawful, *changed)
    before, after = old.instance(found), same.instance(found)
    assert (before.P != after.P).any() and (before.r != after.r).any()
    assert not before.residual(found(Q)).any() and not after.residual(found(Q)).any()


@proves("B3", size="every MDP with 2 states and 2 actions", without="γ < 1")
def test_the_stage_with_a_live_target_has_one_fixed_point():
    mdp = AnyMDP(X, zero)
    fixed = equal(mdp.residual(Q), zero)
    assert proved(equal(Q, X), *mdp.lawful, fixed)
    found = counterexample(equal(Q, X), *mdp.lawful[:-1], fixed)
    assert (found(Q) != found(X)).any() and found(mdp.discount) >= 1
    with pytest.raises(ValueError, match="gamma must be in"):
        mdp.instance(found)


@proves("B5", size=ALL + ", η in (0, 1]", without="η ≤ 1")
def test_the_live_target_with_the_loss_on_h_keeps_its_part_of_the_error():
    """Z = (1 − η) Q + η 𝒯Z, Q* = X: (1 − ηγ) ‖Z − X‖∞ ≤ (1 − η) ‖Q − X‖∞."""
    mdp, Z = AnyMDP(X, zero), unknowns("Z", 2, 2)
    stage = equal(Z, Q * (1 - eta) + mdp.bellman(Z) * eta)
    given = [*mdp.lawful, within(Q - X, E), stage, eta > 0]
    kept = within((Z - X) * (1 - eta * mdp.discount), (1 - eta) * E)
    assert proved(kept, *given, eta <= 1)
    found = counterexample(kept, *given)
    world, step, after = mdp.instance(found), found(eta), found(Z)
    assert ((1 - step) * found(Q) + step * world.bellman(after) == after).all()
    assert abs(after - found(X)).max() * (1 - step * world.gamma) > (1 - step) * found(E)


@proves("B2", size=ALL + ", every α ≠ 0", without="the α in the loss")
def test_under_eq_5_the_step_size_cancels():
    """Eq. 5 fits α h to g; Algorithm 1 fits h to g."""
    mdp = AnyMDP(Q, g)
    whole = equal(Q + h2 * alpha, mdp.bellman(Q))
    assert proved(whole, equal(h2 * alpha, g))
    found = counterexample(whole, equal(h2, g), *mdp.lawful, alpha != 0)
    world = mdp.instance(found)
    assert (found(Q) + found(alpha) * found(h2) != world.bellman(found(Q))).any()


@proves("B6", size="every loop, its Q, γ and η in [0, 1]", without="that the state is not left")
def test_one_loop_attains_the_moduli():
    """The error is exactly 1 − η(1 − γ) of what it was, and with Z = (1 − η) Q + η 𝒯Z, (1 − ηγ) of
    it is 1 − η of what it was.
    """
    Q, X, Z = (unknowns(name, 1, 1) for name in "QXZ")
    loop = AnyMDP(X, np.zeros((1, 1), int))
    kept = equal(Q + loop.residual(Q) * eta - X, (Q - X) * (1 - eta * (1 - loop.discount)))
    stage = equal(Z, Q * (1 - eta) + loop.bellman(Z) * eta)
    live = equal((Z - X) * (1 - eta * loop.discount), (Q - X) * (1 - eta))
    assert proved(both(kept, live), stage)
    way = AnyMDP(unknowns("Y", 2, 1), np.zeros((2, 1), int))  # two states: the first can be left
    start, end = unknowns("S", 2, 1), unknowns("Y", 2, 1)
    after = start + way.residual(start) * eta
    same = after[0, 0] - end[0, 0] == (start - end)[0, 0] * (1 - eta * (1 - way.discount))
    found = counterexample(same, *way.lawful, eta > 0, eta <= 1)
    world, step = way.instance(found), found(eta)
    gap = found(start) + step * world.residual(found(start)) - found(end)
    assert gap[0, 0] != (1 - step * (1 - world.gamma)) * found(start - end)[0, 0]


@proves("B8", size=ALL + ", every α", without="that the next state has no residual")
def test_a_booster_changes_nothing_where_neither_it_nor_what_follows_has_a_residual():
    """g = 0 at a pair and in its only next state: Q stays there, and its residual stays 0."""
    mdp = AnyMDP(Q, g)
    still, first = both(residual_after(mdp, alpha)[0, 0] == 0), [g[0, 0] == 0, mdp.P[0, 0, 1] == 1]
    assert proved(still, *first, equal(g[1], zero[1]))
    found = counterexample(still, *mdp.lawful, *first)
    world = mdp.instance(found)
    after = found(Q) + found(alpha) * world.residual(found(Q))
    assert world.residual(found(Q))[0, 0] == 0 != world.residual(after)[0, 0]


@proves("B12", size="every loop, γ, ε and α", without="that the miss keeps its sign")
def test_a_lasting_miss_costs_the_same_under_every_step():
    """h = g + ε: Q* + ε/(1 − γ) stays where it is, and other Qs come nearer by 1 − α(1 − γ)."""
    Q, X, end = (unknowns(name, 1, 1) for name in ("Q", "X", "end"))
    loop = AnyMDP(X, np.zeros((1, 1), int))
    lasting = (end - X)[0, 0] * (1 - loop.discount) == eps

    def nears(miss):
        after = Q + (loop.residual(Q) + miss) * alpha
        return equal(after - end, (Q - end) * (1 - alpha * (1 - loop.discount)))

    assert proved(nears(eps), lasting)
    found = counterexample(nears(-eps), lasting, *loop.lawful, alpha > 0, alpha <= 1, eps > 0)
    world = loop.instance(found)
    after = found(Q) + found(alpha) * (world.residual(found(Q)) - found(eps))
    gap = found(Q) - found(end)
    assert after - found(end) != (1 - found(alpha) * (1 - world.gamma)) * gap


@proves(
    "T2-f", size="every MDP with 1 state and 2 actions, every Q and μ", without="μ on every pair"
)
def test_an_exact_booster_lowers_the_error_by_gamma_squared_over_the_least_mu():
    Q, g, mu, least = unknowns("Q", 1, 2), unknowns("g", 1, 2), unknowns("mu", 1, 2), z3.Real("mu")
    mdp = AnyMDP(Q, g)
    drawn = [*(m >= 0 for m in mu.ravel()), mu.sum() == 1]
    before, after = mdp.bellman_error(Q, mu), mdp.bellman_error(Q + g, mu)
    lower = after * least <= mdp.discount * mdp.discount * before
    assert proved(lower, *mdp.lawful, *drawn, least > 0, *(least <= m for m in mu.ravel()))
    found = counterexample(lower, *mdp.lawful, *drawn, least > 0, least <= mu[0, 0])
    world = mdp.instance(found)
    errors = [world.bellman_error(q, found(mu)) for q in (found(Q), found(Q + g))]
    assert errors[1] * found(least) > world.gamma**2 * errors[0]


@proves("T2-m", size="every two targets, their odds and Q", without="the variance")
def test_the_squared_td_error_has_the_variance_in_it():
    y, q, odds = unknowns("y", 2), z3.Real("q"), z3.Real("odds")
    P = symbols([odds, 1 - odds])
    mean = (P * y).sum()
    variance, bias = (P * (y - mean) * (y - mean)).sum(), (mean - q) * (mean - q)
    squared = (P * (y - q) * (y - q)).sum()
    assert proved(squared == bias + variance)
    found = counterexample(squared == bias, odds >= 0, odds <= 1)
    exact = found(P) @ (found(y) - found(q)) ** 2
    assert exact != (found(P) @ found(y) - found(q)) ** 2


def steepest(q, slopes):
    """𝒯′ of a maximum: the largest slope among the best of two actions."""
    first, second = slopes
    best = z3.If(q[0] > q[1], first, second)
    return z3.If(q[0] == q[1], maximum(slopes), best)


@proves(
    "T2-o",
    size="every MDP with 2 states and 2 actions, every Q, ties too",
    without="that ε is so small that no worse action overtakes",
)
def test_newtons_direction_descends():
    """d = g + γ P 𝒯′(Q; d): the residual is (1 − ε) g, so every E_μ falls by (1 − ε)²."""
    d, mdp = unknowns("d", 2, 2), AnyMDP(Q, g)
    slope = symbols([steepest(Q[s], d[s]) for s in range(2)])
    newton = equal(d, g + (mdp.P @ slope) * mdp.discount)
    given = [*mdp.lawful, newton, eps > 0, eps <= 1]
    shrinks = equal(mdp.residual(Q + d * eps), g * (1 - eps))
    small = equal((Q + d * eps).max(-1), Q.max(-1) + slope * eps)
    assert proved(shrinks, *given, small)
    found = counterexample(shrinks, *given)
    world = mdp.instance(found)
    after = world.residual(found(Q) + found(eps) * found(d))
    assert (after != (1 - found(eps)) * world.residual(found(Q))).any()


@proves("T2-p", size="every Markov chain of 2 states, every Q", without="that μ is stationary")
def test_policy_evaluation_descends_along_the_residual():
    Q, g, mu = unknowns("Q", 2, 1), unknowns("g", 2, 1), unknowns("mu", 2, 1)
    chain = AnyMDP(Q, g)
    before, after = chain.bellman_error(Q, mu), chain.bellman_error(Q + g, mu)
    drawn = [*(m >= 0 for m in mu.ravel()), mu.sum() == 1]
    stationary = equal(mu[:, 0] @ chain.P[:, 0], mu[:, 0])
    falls = after <= chain.discount * chain.discount * before
    assert proved(falls, *chain.lawful, *drawn, stationary)
    found = counterexample(falls, *chain.lawful, *drawn)
    world = chain.instance(found)
    errors = [world.bellman_error(q, found(mu)) for q in (found(Q), found(Q + g))]
    assert errors[1] > world.gamma**2 * errors[0]


@proves("R1", size=ALL + ", every behaviour", without="that all data have the same physics")
def test_the_mean_target_of_a_pair_is_its_backup_whatever_the_behaviour():
    mdp, drifted, visits = AnyMDP(Q, g), AnyMDP(Q, g, "old"), unknowns("visits", 2)
    y = td_target(mdp.r[0, [0, 0]], np.array([False, False]), Q, mdp.gamma)
    seen, stale = visits[:1] * mdp.P[0, 0], visits[1:] * drifted.P[0, 0]

    def mean_is_backup(weights):
        return (weights * y).sum() == weights.sum() * mdp.bellman(Q)[0, 0]

    given = [visits[0] > 0, visits[1] > 0, *mdp.lawful]
    assert proved(mean_is_backup(seen), *given)
    found = counterexample(mean_is_backup(seen + stale), *given, *drifted.lawful)
    world, weights = mdp.instance(found), found(seen + stale)
    targets = td_target(world.r[0, [0, 0]], np.array([False, False]), found(Q), world.gamma)
    assert weights @ targets != weights.sum() * world.bellman(found(Q))[0, 0]


@proves("P1", size="three updates of every θ̄, θ and τ", without="that θ stands still")
def test_the_target_closes_the_gap_geometrically():
    tau, target, theta, moved = (unknowns(name) for name in ("tau", "target", "theta", "moved"))
    left = (1 - tau) * (1 - tau) * (1 - tau)

    def after(*thetas):
        averaged = symbols([target.item()])
        for each in thetas:
            polyak(averaged, symbols([each.item()]), tau)
        return averaged[0]

    gap = left * (target - theta)
    assert proved(after(theta, theta, theta) - theta.item() == gap)
    found = counterexample(after(theta, moved, theta) - theta.item() == gap)
    averaged = np.array([found(target)])
    for each in (theta, moved, theta):
        polyak(averaged, found(each), found(tau))
    assert averaged[0] - found(theta) != found(gap)


@proves("T4-a", size="every booster on 2 states and 2 actions, every α", without="|α|, α for it")
def test_a_booster_moves_q_by_alpha_h():
    moved = (Q + h2 * alpha) - Q
    assert proved(within(moved, size(alpha) * G), within(h2, G))
    found = counterexample(within(moved, alpha * G), within(h2, G))
    assert found(alpha) < 0 and abs(found(alpha) * found(h2)).max() > found(alpha * G)


# Replay

d, tau = unknowns("d", 3), unknowns("tau", 3)
BUFFER = "every three transitions, their errors and ages, and β in [0, 1]"
positive = [x > 0 for x in (*d, *tau)]
mixing = [beta >= 0, beta <= 1]


def normalised(p):
    return p / p.sum()


@proves("R10", size=BUFFER, without="the sums in λ")
def test_the_rule_is_a_mixture_of_per_and_recency():
    """P = λ P_TD + (1 − λ) P_time, λ = β S_TD / (β S_TD + (1 − β) S_time), not β."""
    p, share = mixed_priority(d, tau, mix), z3.Real("share")
    mixture = equal(p / p.sum(), normalised(d) * share + normalised(tau) * (1 - share))
    assert proved(mixture, *positive, *mixing, share * p.sum() == beta * d.sum())
    found = counterexample(mixture, *positive, *mixing, share == beta)
    P, part = normalised(mixed_priority(found(d), found(tau), found(beta))), found(share)
    assert (part * normalised(found(d)) + (1 - part) * normalised(found(tau)) != P).any()


@proves("R11", size=BUFFER, without="that the newest has p^time = 1")
def test_the_probabilities_sum_to_1():
    p = mixed_priority(d, tau, mix)
    given = [*(x >= 0 for x in (*d, *tau)), *mixing, z3.Or(beta < 1, maximum(d) > 0)]
    assert proved(normalised(p).sum() == 1, *given, tau[0] == 1)
    found = counterexample(p.sum() > 0, *given)
    assert not mixed_priority(found(d), found(tau), found(beta)).any()


@proves("W5", size=BUFFER + ", p^TD at least ε^γ, exponent 1", without="ε > 0 or β > 0")
def test_the_weights_are_bounded():
    """w = S/(N p) ≤ S/(N β ε^γ), S = Σ p; the mean of w over draws is 1."""
    p, floor = mixed_priority(d, tau, mix), z3.Real("floor")
    P = normalised(p)
    bounded = both([p.sum() <= p.sum() / (beta * floor * 3) * 3 * each for each in p])
    given = [*positive, *mixing]
    assert proved(bounded, *given, beta > 0, floor > 0, *(each >= floor for each in d))
    assert proved((P * importance_weights(P, 3, 1, None)).sum() == 1, *given)
    found = counterexample(bounded, *given, beta > 0, floor > 0)
    P = normalised(mixed_priority(found(d), found(tau), found(beta)))
    w = importance_weights(P, 3, 1, None)
    assert max(w) > found(p.sum()) / (3 * found(beta) * found(floor))


@proves("T3-k", "T3-a", size=BUFFER + ", two of the three", without="that the newer errs more")
def test_the_newer_with_the_larger_error_never_gets_the_products_share():
    """P_i/P_j lies between the ratios of its parts, so it is below the product's if both are > 1.

    In products: p_i d_j τ_j < p_j d_i τ_i.
    """
    p = mixed_priority(d, tau, mix)
    short = p[0] * d[1] * tau[1] < p[1] * d[0] * tau[0]
    between = z3.Or(
        both(p[0] * d[1] <= p[1] * d[0], p[0] * tau[1] >= p[1] * tau[0]),
        both(p[0] * d[1] >= p[1] * d[0], p[0] * tau[1] <= p[1] * tau[0]),
    )
    given = [*positive, *mixing, tau[0] > tau[1]]
    assert proved(between, *given) and proved(short, *given, d[0] > d[1])
    found = counterexample(short, *given)
    p, product = mixed_priority(found(d), found(tau), found(beta)), found(d) * found(tau)
    assert p[0] / p[1] >= product[0] / product[1]


@proves("T3-c", size=BUFFER + ", β inside (0, 1)", without="0 < β < 1")
def test_where_the_product_is_a_mixture_the_error_rises_with_age():
    """β d + (1 − β) τ = c d τ for all i is the line a/τ + b/d = 1 with a = β/c, b = (1 − β)/c."""
    c = z3.Real("c")
    p = mixed_priority(d, tau, mix)
    given = [*positive, c > 0, equal(p, d * tau * c)]
    line = both([(beta / c) / t + ((1 - beta) / c) / x == 1 for x, t in zip(d, tau, strict=True)])
    rises = z3.Implies(tau[0] > tau[1], d[0] < d[1])
    assert proved(line, *given, *mixing) and proved(rises, *given, beta > 0, beta < 1)
    found = counterexample(rises, *given, *mixing)
    P, product = normalised(mixed_priority(found(d), found(tau), found(beta))), found(d * tau)
    assert (normalised(product) == P).all() and found(beta) in (0, 1)


@proves("T3-g", size="every P > 0 of three transitions and every integrand", without="Σ P = 1")
def test_the_best_distribution_follows_the_integrand():
    """E (f/P)² = Σ f²/P ≥ (Σ f)² for every f, so for |f|, where P ∝ |f| attains it."""
    P, ratio = unknowns("P", 3), unknowns("ratio", 3)  # f/P
    total = (P * ratio).sum()
    least = total * total <= (P * ratio * ratio).sum()
    given = [p > 0 for p in P]
    assert proved(least, *given, P.sum() == 1)
    found = counterexample(least, *given)
    f = found(P * ratio)
    assert (f**2 / found(P)).sum() < f.sum() ** 2 and sum(found(P)) != 1


@proves("R9", size="every three transitions and two rates", without="β = 0, for which ½ comes")
def test_a_larger_rate_is_more_recency_if_nothing_is_mixed_in():
    """q = e^{−α}: with P^time alone the newest two have more at the smaller q, in the mixture not
    always.
    """
    slow, fast = z3.Real("slow"), z3.Real("fast")

    def newest(q, d, mix):
        return normalised(mixed_priority(d, symbols([1, q, q * q]), mix))[:2].sum()

    given = [fast > 0, fast < slow, slow < 1, *positive]
    more = newest(slow, d, mix) < newest(fast, d, mix)
    assert proved(more, *given, beta == 0)
    found = counterexample(more, *given, 2 * beta == 1, equal(d, np.full(3, d[0])))
    shares = [newest(found(q), found(d), found(beta)) for q in (slow, fast)]
    assert shares[0] >= shares[1]


# Arithmetic of the tables


@proves("C3", size="three members, every variance and correlation", without="the 1/k, a sum for it")
def test_averaging_keeps_what_the_members_share():
    """σ²(ρ + (1 − ρ)/k) is the variance of the mean."""
    variance, rho = z3.Reals("variance rho")
    covariance = symbols(
        [[variance if i == j else variance * rho for j in range(3)] for i in range(3)]
    )
    shared = variance * (3 * rho + (1 - rho)) / 3
    mean = symbols([z3.Q(1, 3)] * 3)
    assert proved(mean @ covariance @ mean == shared)
    ones = np.ones(3, int)
    found = counterexample(ones @ covariance @ ones <= shared, variance > 0, rho >= 0, rho <= 1)
    assert found(covariance).sum() > found(shared)


@proves("X1", "X15", size="every three returns in a range", without="that one of them is in it")
def test_a_mean_near_the_edge_leaves_no_room_for_a_std():
    """Variance ≤ (mean − lowest)(highest − mean)."""
    returns, low, high = unknowns("returns", 3), z3.Real("low"), z3.Real("high")
    mean = returns.sum() / 3
    room = squares(returns - mean) / 3 <= (mean - low) * (high - mean)
    inside = [z3.And(low <= x, x <= high) for x in returns]
    assert proved(room, *inside)
    found = counterexample(room, *inside[1:], low < high)
    exact = found(returns)
    assert np.mean((exact - exact.mean()) ** 2) > (exact.mean() - found(low)) * (
        found(high) - exact.mean()
    )


@proves("X8", size="every five numbers", without="the division by n of the squares")
def test_the_smallest_is_well_below_the_mean():
    """min ≤ mean − s/√n with s the sample's standard deviation: n (mean − min)² ≥ s²."""
    x = unknowns("x", 5)
    mean, least = x.sum() / 5, -maximum(-x)
    far = (mean - least) * (mean - least) * 5
    assert proved(far >= squares(x - mean) / 4)
    found = counterexample(far >= squares(x - mean))
    exact = found(x)
    assert 5 * (exact.mean() - exact.min()) ** 2 < ((exact - exact.mean()) ** 2).sum()

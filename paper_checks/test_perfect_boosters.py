"""How far perfect boosters come, under five readings of Algorithm 1, on MDPs.

A booster is perfect if it is the least-squares optimum of its loss over all functions of (s, a).
Numbers are exact fractions where they are named. That the package's agent makes such boosters is in
test_one_backup_per_boost.py.

Letters: e = ‖Q − Q*‖∞ with the new Q*, κ the factor of e that a perfect booster may leave, η a step
size.
"""

from fractions import Fraction as F
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import GAMMA_99, ROOMS, chain, exact, funnel, loop, random_mdp, row

from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.tabular import MDP

ETA = F(1, 10)  # the printed shrinkage
gammas, etas = st.floats(0, 0.9), st.floats(0.01, 1)
fractions = st.fractions(F(1, 100), F(99, 100), max_denominator=100)


# The five readings: Q_m of a perfect booster on top of Q


def letter(mdp, Q, eta):
    """Frozen target, α = 1, or any α under Eq. 5 (B1, B2)."""
    return mdp.bellman(Q)


def damped(mdp, Q, eta):
    """Frozen target, loss on h, α = η (B1)."""
    return Q + eta * mdp.residual(Q)


def live(mdp, Q, eta):
    """Live target, loss on α h: the X with X = 𝒯X (B3)."""
    return fixed_point(mdp, Q)


def live_h(mdp, Q, eta):
    """Live target, loss on h, α = η: the X with X = (1 − η) Q + η 𝒯X, which is Q* for the rewards
    (1 − η) Q + η r and the discount ηγ (the control of B3).
    """
    return fixed_point(MDP(mdp.P, (1 - eta) * Q + eta * mdp.r, eta * mdp.gamma), Q)


def live_deployed(mdp, Q, eta):
    """Live target of Q + h, then deployed as Q + η h."""
    return Q + eta * (fixed_point(mdp, Q) - Q)


READINGS = {  # the reading: its κ, as B5 states it
    letter: lambda gamma, eta: gamma,
    damped: lambda gamma, eta: 1 - eta * (1 - gamma),
    live: lambda gamma, eta: 0,
    live_h: lambda gamma, eta: (1 - eta) / (1 - eta * gamma),
    live_deployed: lambda gamma, eta: 1 - eta,
}


def fixed_point(mdp, Q):
    """The X with X = 𝒯X, by policy iteration from Q: exact in fractions."""
    states, policy = np.arange(len(Q)), None
    while policy is None or (policy != Q.argmax(-1)).any():
        policy = Q.argmax(-1)
        A = np.eye(len(Q), dtype=int) - mdp.gamma * mdp.P[states, policy]
        Q = mdp.bellman(solve(A, mdp.r[states, policy])[:, None])
    return Q


def solve(A, b):
    """The x with A x = b by elimination, exact in fractions; I − γP needs no exchange of rows."""
    M = np.column_stack([A, b])
    for i in range(len(M)):
        M[i] = M[i] / M[i, i]
        for j in np.flatnonzero(np.arange(len(M)) != i):
            M[j] = M[j] - M[j, i] * M[i]
    return M[:, -1]


def error(mdp, Q):
    """‖Q − Q*‖∞, exact where the MDP is one loop, else with Q* by value iteration."""
    return abs(Q - (mdp.r / (1 - mdp.gamma) if mdp.r.size == 1 else mdp.q_star())).max()


def boosted(reading, mdp, Q, boosts, eta=ETA):
    """Q after so many boosters."""
    for _ in range(boosts):
        Q = reading(mdp, Q, eta)
    return Q


# The live stages as what learning does: k exact fits of h, each to the residual of the one before


def fits(mdp, Q, k, inside=1, outside=1):
    """Q + outside · h after k fits of h to 𝒯(Q + inside · h) − Q, from h = 0 on."""
    h = 0 * Q
    for _ in range(k):
        h = mdp.bellman(Q + inside * h) - Q
    return Q + outside * h


LIVE = {  # a live reading: (what it bootstraps with and deploys, its κ after k fits)
    live: lambda eta: (1, 1),
    live_h: lambda eta: (eta, eta),
    live_deployed: lambda eta: (1, eta),
}


def kappa_of_fits(reading, gamma, eta, k):
    """κ after k fits: in the limit κ, and at the start, less of the way by (ηγ)^k or γ^k."""
    kappa, inside = READINGS[reading](gamma, eta), LIVE[reading](eta)[0]
    return kappa + (1 - kappa) * (inside * gamma) ** k


@claim("B5")
@pytest.mark.parametrize("reading", LIVE)
@given(seed=st.integers(0, 10**6), gamma=gammas, eta=etas, k=st.integers(0, 9))
def test_a_live_stage_of_k_fits_leaves_its_part(reading, seed, gamma, eta, k):
    """On random MDPs; after many fits it is at the fixed point of the stage."""
    rng = np.random.default_rng(seed)
    mdp, Q = random_mdp(rng, gamma), rng.normal(size=(3, 2)) * 10
    factors, kappa = LIVE[reading](eta), kappa_of_fits(reading, gamma, eta, k)
    scale = 1e-9 * (error(mdp, Q) + np.abs(Q).max())
    assert error(mdp, fits(mdp, Q, k, *factors)) <= kappa * error(mdp, Q) + scale
    end = fits(mdp, Q, 300, *factors)
    np.testing.assert_allclose(end, reading(mdp, Q, eta), atol=1e-9 * np.abs([Q, end]).max())
    shows("live, after k exact fits: κ + (1 − κ) γ^k, on h κ + (1 − κ)(ηγ)^k; random MDPs")


@claim("B5")
@pytest.mark.parametrize("reading", [each for each in READINGS if each is not live])
@given(seed=st.integers(0, 10**6), gamma=gammas, eta=etas)
def test_each_reading_has_its_own_modulus(reading, seed, gamma, eta):
    """On random MDPs, from a random Q."""
    rng = np.random.default_rng(seed)
    mdp, Q = random_mdp(rng, gamma), rng.normal(size=(3, 2)) * 10
    after, kappa = reading(mdp, Q, eta), READINGS[reading](gamma, eta)
    assert error(mdp, after) <= kappa * error(mdp, Q) + 1e-9 * np.abs([Q, after]).max()
    shows(
        "frozen γ, damped 1 − η(1 − γ); live, at the fixed point, 0, on h (1 − η)/(1 − ηγ),"
        " deployed with η 1 − η; random MDPs"
    )


@given(st.integers(0, 10**6), gammas, etas)
def test_the_live_stages_are_fixed_points(seed, gamma, eta):
    """X = 𝒯X, and X = (1 − η) Q + η 𝒯X with the loss on h."""
    rng = np.random.default_rng(seed)
    mdp, Q = random_mdp(rng, gamma), rng.normal(size=(3, 2)) * 10
    X, Y = live(mdp, Q, eta), live_h(mdp, Q, eta)
    scale = 1e-9 * np.abs([Q, X, Y]).max()
    np.testing.assert_allclose(X, mdp.bellman(X), atol=scale)
    np.testing.assert_allclose(Y, (1 - eta) * Q + eta * mdp.bellman(Y), atol=scale)


@control("B5")
@pytest.mark.parametrize("alpha", [F(1), F(11, 10), F(3, 2)])
def test_control_too_long_a_step_guarantees_nothing(alpha):
    """Two states that swap, e = (1, −1): with α over 1 more is left than κ allows."""
    mdp = MDP([[exact(0, 1)], [exact(1, 0)]], np.array([[F(0)], [F(0)]]), GAMMA_99)
    Q = np.array([[F(1)], [F(-1)]])  # Q* = 0
    left = abs(damped(mdp, Q, alpha)).max()
    assert (left > READINGS[damped](GAMMA_99, alpha)) == (alpha > 1)


@claim("B6")
@pytest.mark.parametrize("reading", LIVE)
@given(gamma=fractions, eta=fractions, k=st.integers(0, 9))
def test_one_loop_attains_that_of_k_fits(reading, gamma, eta, k):
    """Exactly κ of k fits is left on the loop, and so no factor below κ can be guaranteed."""
    mdp, Q = loop(1, gamma), row(0)
    left = error(mdp, fits(mdp, Q, k, *LIVE[reading](eta)))
    assert left == kappa_of_fits(reading, gamma, eta, k) * error(mdp, Q)
    shows("exactly κ + (1 − κ) γ^k, or (ηγ)^k, after k fits")


@claim("B6")
@pytest.mark.parametrize("reading", [each for each in READINGS if each is not live])
@given(
    gamma=st.fractions(0, F(99, 100), max_denominator=100),
    eta=st.fractions(F(1, 100), 1, max_denominator=100),
)
def test_one_loop_attains_every_modulus(reading, gamma, eta):
    """One state that loops, its reward drifts from 0 to 1: exactly κ of the error is left."""
    mdp, Q = loop(1, gamma), row(0)
    left = error(mdp, reading(mdp, Q, eta))
    assert left == READINGS[reading](gamma, eta) * error(mdp, Q)
    shows("exactly κ of the error is left on one loop, for each reading, γ and η")


@claim("B6")
def test_what_three_boosters_leave_on_the_loop():
    """With the paper's γ and η, exactly κ³ of the error at the drift."""
    mdp, boosts = loop(1, GAMMA_99), 3
    left = [error(mdp, boosted(reading, mdp, row(0), boosts)) for reading in READINGS]
    start = error(mdp, row(0))
    assert left == [kappa(GAMMA_99, ETA) ** boosts * start for kappa in READINGS.values()]
    shows(
        "r {} → {}, γ = {:g}, η = {:g}: {} boosters make of an error of {} {:.6g}",
        *(0 * mdp.r, mdp.r, GAMMA_99, ETA, boosts, start, left),
    )


@control("B6")
def test_control_where_the_state_is_left_one_backup_is_enough():
    """It is the loop that makes a booster so slow. A reward that ends the episode needs but one."""
    mdp, Q = funnel(100, 0, GAMMA_99), np.array([[F(0)], [F(0)]])
    assert error(mdp, letter(mdp, Q, ETA)) == 0


def boosts_until(reading, gamma, parts, eta=0.1):
    """How many boosters until these parts of the error are left, on the loop of B6. In floats:
    exact numbers grow too long.
    """
    mdp, Q, counts, boosts = MDP([[[1.0]]], [[1.0]], gamma), np.zeros((1, 1)), [], 0
    start = error(mdp, Q)
    for part in parts:
        while error(mdp, Q) > part * start:
            Q, boosts = reading(mdp, Q, eta), boosts + 1
        counts.append(boosts)
    return counts


@claim("B7")
def test_how_many_boosters_it_takes():
    """The first k with κ^k ≤ 1/2, and with κ^k ≤ 1/100."""
    parts, gamma, eta = (0.5, 0.01), 0.99, 0.1
    counts = [boosts_until(reading, gamma, parts, eta) for reading in READINGS]
    for found, kappa in zip(counts, READINGS.values(), strict=True):
        for part, count in zip(parts, found, strict=True):
            assert kappa(gamma, eta) ** count <= part < kappa(gamma, eta) ** (count - 1)
    assert sum(half <= 3 for half, _ in counts) == 1  # the live target with the loss on α h
    shows(
        "to halve the error, and to bring it to {:.0%}, at γ = {}, η = {}: {} (readings as in B5)",
        *(parts[1], gamma, eta, ", ".join(f"{half} and {part}" for half, part in counts)),
    )


@control("B7")
def test_control_with_a_short_horizon_three_are_enough():
    """At γ = 1/2 an error is halved by one backup, and an eighth is left after three."""
    assert boosts_until(letter, 0.5, [1 / 2, 1 / 8]) == [1, 3]


def distance_to(wrong, P):
    """Steps from each pair (s, a) to the nearest pair in `wrong` (S, A): 0 there, inf where none
    can be reached.
    """
    distance = np.where(wrong, 0, np.inf)
    for _ in range(wrong.size):
        nearest = distance.min(-1)
        through = np.where(P > 0, nearest, np.inf).min(-1)
        distance = np.minimum(distance, 1 + through)
    return distance


def drifted(seed, states=6):
    """(Q_0, an MDP in which it is right but for a few pairs, these pairs (S, A)), exactly."""
    rng = np.random.default_rng(seed)
    successors = rng.integers(0, states, size=(states, 2, 2))
    hits = (np.arange(states) == successors[..., None]).astype(int).sum(-2)
    P, zero = F(1, 2) * hits.astype(object), np.full((states, 2), F(0))
    Q = zero + rng.integers(-9, 10, size=(states, 2)).astype(object)
    right = Q - MDP(P, zero, GAMMA_99).bellman(Q)  # with these rewards Q has no residual
    wrong = rng.random((states, 2)) < 0.15
    return Q, MDP(P, right + wrong * F(1), GAMMA_99), wrong


@claim("B8")
@given(st.integers(0, 10**6), st.integers(1, 5), st.sampled_from([F(1), F(1, 10)]))
def test_a_booster_carries_the_news_one_step(seed, boosts, eta):
    """Q_k = Q_0 at every pair that is k steps or more from the pairs with a residual."""
    Q, mdp, wrong = drifted(seed)
    after = boosted(damped, mdp, Q, boosts, eta)
    assert (after == Q)[distance_to(wrong, mdp.P) >= boosts].all()
    shows(
        "Q_k = Q_0, exactly, wherever k steps do not lead to a pair with a residual; random MDPs of"
        " {} states",
        len(Q),
    )


def ends(goal):
    """(ten rooms in a row that pay 1 for staying in the goal, one of the ends; their Q*)."""
    rewards = np.full((ROOMS, 2), F(0))
    rewards[goal, int(goal > 0)] = F(1)
    values = [GAMMA_99 ** abs(s - goal) / (1 - GAMMA_99) for s in range(ROOMS)]
    mdp = chain(rewards)
    return mdp, mdp.bellman(exact(*values)[:, None])


@control("B8")
def test_control_a_live_target_carries_it_through_all_rooms():
    """Ten fits inside one booster spread the change over all ten rooms; the frozen booster changes
    only the pairs with a residual, two of twenty.
    """
    (_, Q), (new, _) = ends(0), ends(ROOMS - 1)
    wrong = new.residual(Q) != 0
    assert ((letter(new, Q, ETA) != Q) == wrong).all() and wrong.sum() == 2
    assert (fits(new, Q, ROOMS) != Q).any(-1).all()


@control("B8")
def test_control_a_booster_with_one_parameter_carries_it_everywhere():
    """The same frozen target; the booster is a constant instead of a table."""
    (_, Q), (new, _) = ends(0), ends(ROOMS - 1)
    residual = new.residual(Q).astype(float).ravel()
    residual[:ROOMS] = 0  # one end has drifted
    h = closed_form_alpha(residual, np.ones(residual.size))
    assert np.count_nonzero(residual) == 1 and h != 0


def is_right(Q):
    """Whether right is the better action in all rooms."""
    return (Q[:, 1] > Q[:, 0]).all()


def boosts_until_right(reading):
    """How many boosters until the greedy policy is right everywhere after the goal has moved."""
    (_, Q), (new, _), boosts = ends(0), ends(ROOMS - 1), 0
    while not is_right(Q):
        Q, boosts = reading(new, Q, ETA), boosts + 1
    return boosts


@claim("B9")
def test_the_chain_needs_as_many_boosters_as_the_news_needs_steps_and_more():
    """The goal moves from the left end to the right one, and the greedy policy has to find out."""
    counts = [boosts_until_right(reading) for reading in (letter, damped)]
    assert ROOMS <= counts[0] < counts[1]
    shows(
        "exact, γ = {:g}: right everywhere first after {} boosters, with η = {:g} {}",
        *(GAMMA_99, counts[0], ETA, counts[1]),
    )


@claim("B9")
def test_after_three_boosters_the_middle_is_untouched():
    """No value there has changed."""
    (_, Q), (new, _), boosts = ends(0), ends(ROOMS - 1), 3
    first, last = boosts, ROOMS - boosts
    untouched = np.flatnonzero((boosted(letter, new, Q, boosts) == Q).all(-1))
    assert untouched.tolist() == list(range(first, last + 1))
    shows("after {}, states {}–{} are untouched", boosts, first, last)


@control("B9")
def test_control_with_a_live_target_one_booster_is_enough():
    """Its fixed point is the new Q*, which differs in every room and has the right policy."""
    (_, Q), (new, optimal) = ends(0), ends(ROOMS - 1)
    after = live(new, Q, ETA)
    assert (after == optimal).all() and (after != Q).any(-1).all()
    assert boosts_until_right(live) == 1


def errors_under_drifts(reading, Q, drifts=3):
    """The error at each of so many drifts after the booster, on a loop whose Q* rises by 1 at each
    drift.
    """
    Q, errors = row(Q), []
    for drift in range(1, drifts + 1):
        mdp = loop(drift * (1 - GAMMA_99), GAMMA_99)
        Q = reading(mdp, Q, ETA)
        errors.append(error(mdp, Q))
    return errors


@claim("B10")
def test_after_three_drifts_nearly_all_of_them_are_left():
    """κ + κ² + κ³ of the Δ of a drift."""
    drifts, left = 3, []
    for reading in (letter, damped):
        kappa = READINGS[reading](GAMMA_99, ETA)
        left.append(errors_under_drifts(reading, 0, drifts)[-1])
        assert left[-1] == sum(kappa**k for k in range(1, drifts + 1))
    shows(
        "after {} drifts {:.6f} Δ of {} Δ are left, shrunk {:.6f} Δ",
        drifts,
        left[0],
        drifts,
        left[1],
    )


@claim("B10")
@pytest.mark.parametrize("reading", [letter, damped])
def test_one_booster_per_drift_lags_behind(reading):
    """From an error of κ/(1 − κ) on, the error never changes."""
    kappas = [READINGS[each](GAMMA_99, ETA) for each in (letter, damped)]
    kappa = READINGS[reading](GAMMA_99, ETA)
    steady = kappa / (1 - kappa)
    assert errors_under_drifts(reading, -steady) == [steady] * 3
    shows("{} Δ and {} Δ stay as they are", *(kappa / (1 - kappa) for kappa in kappas))


@given(st.integers(0, 10**6), gammas, etas, st.sampled_from(list(READINGS)))
def test_the_lag_is_never_worse_than_that(seed, gamma, eta, reading):
    """e_j ≤ κ (e_{j−1} + Δ_j), on random MDPs."""
    rng = np.random.default_rng(seed)
    mdps = [random_mdp(rng, gamma) for _ in range(4)]
    Q, kappa = rng.normal(size=(3, 2)), READINGS[reading](gamma, eta)
    for mdp, new in pairwise(mdps):
        bound = kappa * (error(mdp, Q) + error(new, mdp.q_star()))
        Q = reading(new, Q, eta)
        assert error(new, Q) <= bound + 1e-9 * (abs(Q).max() + 1)


@control("B10")
def test_control_a_live_target_keeps_up():
    """With 2,000 fits inside each booster the error stays below a millionth of Δ."""

    def many_fits(mdp, Q, eta):
        return fits(mdp, Q.astype(float), 2000)

    assert 0 < max(errors_under_drifts(many_fits, 0)) < 1e-6


def errors_with_steps(alphas, gamma=F(1, 2)):
    """The errors on the loop with Q* = 0, from an error of 1 on."""
    mdp, Q, errors = loop(0, gamma), row(1), []
    for alpha in alphas:
        Q = damped(mdp, Q, alpha)
        errors.append(error(mdp, Q))
    return errors


@claim("B11")
@given(st.integers(0, 10**6), gammas, st.lists(st.floats(0.01, 1), min_size=1, max_size=20))
def test_the_error_falls_with_the_sum_of_the_steps(seed, gamma, alphas):
    """On random MDPs it is at most e^{−(1 − γ) Σ α} of the first error."""
    rng = np.random.default_rng(seed)
    mdp, Q = random_mdp(rng, gamma), rng.normal(size=(3, 2)) * 10
    bound = error(mdp, Q) * np.exp(-(1 - gamma) * sum(alphas))
    for alpha in alphas:
        Q = damped(mdp, Q, alpha)
    assert error(mdp, Q) <= bound + 1e-9 * (abs(Q).max() + 10)
    shows("random MDPs: e_m ≤ e^{{−(1 − γ) Σ α}} e_0")


@claim("B11")
def test_steps_with_a_finite_sum_stop_halfway():
    """On the loop, with α_m = 2/(m + 1)²."""
    gamma, limit, m = F(1, 2), F(1, 2), range(1, 51)
    (start,) = errors_with_steps([F(0)], gamma)
    errors = errors_with_steps([F(2, (k + 1) ** 2) for k in m], gamma)
    assert errors == [F(k + 2, 2 * k + 2) for k in m]
    assert all(left - limit == F(1, 2 * k + 2) for k, left in zip(m, errors, strict=True))
    shows(
        "loop, γ = {}, e_0 = {}: α_m = 2/(m + 1)² leaves (m + 2)/(2m + 2) → {}",
        *(gamma, start, limit),
    )


@claim("B11")
def test_steps_with_an_infinite_sum_go_all_the_way():
    """On the loop, with α_m = 2/(m + 1)."""
    m = range(1, 51)
    assert errors_with_steps([F(2, k + 1) for k in m]) == [F(1, k + 1) for k in m]
    shows("α_m = 2/(m + 1) leaves 1/(m + 1) → 0")


@control("B11")
def test_control_without_a_future_one_whole_step_is_enough():
    """At γ = 0 a finite sum reaches Q*, which at γ = ½ it does not."""
    alphas = [F(1), F(1, 4)]
    assert errors_with_steps(alphas, gamma=F(0)) == [0, 0]
    assert errors_with_steps(alphas, gamma=F(1, 2))[-1] > 0


def missed(alpha, Q, misses, reward):
    """Q after boosters that miss the residual by these amounts, on the loop."""
    mdp, found = loop(reward, GAMMA_99), []
    for miss in misses:
        Q = Q + alpha * (mdp.residual(Q) + miss)
        found.append(Q.item())
    return found


MISS = F(1, 10)


@claim("B12")
@given(st.fractions(F(1, 100), 1, max_denominator=100), st.integers(-50, 50))
def test_a_lasting_miss_costs_the_same_under_every_step(alpha, start):
    """On the loop: the gap to Q* + ε/(1 − γ) keeps 1 − α(1 − γ) at each booster, whatever α."""
    off = MISS / (1 - GAMMA_99)
    end = 1 / (1 - GAMMA_99) + off  # Q* + ε/(1 − γ)
    gaps = [Q - end for Q in [F(start), *missed(alpha, row(start), [MISS] * 3, reward=1)]]
    assert all(after == (1 - alpha * (1 - GAMMA_99)) * before for before, after in pairwise(gaps))
    shows(
        "loop, γ = {:g}, ε = {:g}: the error tends to {:g}, exactly, for every α in (0, 1]",
        *(GAMMA_99, MISS, off),
    )


@control("B12")
@pytest.mark.parametrize("alpha", [F(1), F(1, 10), F(1, 100)])
def test_control_misses_that_alternate_do_average_out(alpha):
    """With +ε, −ε, … there is a cycle of size αε/(2 − α(1 − γ)), which goes to 0 with α."""
    size = alpha * MISS / (2 - alpha * (1 - GAMMA_99))
    cycle = missed(alpha, row(-size), [MISS, -MISS, MISS], reward=0)
    assert cycle == [size, -size, size] and size < alpha / 10

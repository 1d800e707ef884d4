"""Theorem 3: the mixed priorities tend to the product of error and recency. They do not, and which
mixture is best depends on the integrand.

Letters: d = |δ|, τ = e^{−α age}, P the mixed rule, P* ∝ d τ the product that the theorem calls
ideal, V the variance of one draw. Exact fractions take α = ln 2, so that τ = 1, ½, ¼, …
"""

from fractions import Fraction as F
from itertools import combinations, pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import exact, normalise, with_errors

from gbdqn_ref.bellman import loss_gradient
from gbdqn_ref.nn import MLP
from gbdqn_ref.replay import (
    RecencyReplay,
    importance_weights,
    mixed_priority,
    td_priority,
    time_priority,
)

MIX, RATE = 0.5, 0.01  # β and α, where nothing else is said
MIXES = [F(0), F(1, 7), F(1, 2), F(9, 10), F(1)]
SEEDS = st.integers(0, 10**6)
PARTS = st.fractions(0, 1, max_denominator=12)
ERRORS = st.fractions(F(1, 6), 6, max_denominator=6)


def errors(*values):
    """p^TD of these |δ|, without offset and with exponent 1, exactly."""
    return td_priority(exact(*values), 0, 1)


def halves(*ages):
    """p^time of these ages for α = ln 2, exactly."""
    tau = exact(*[F(1, 2**age) for age in ages])
    np.testing.assert_allclose(time_priority(ages, np.log(2)), tau.astype(float), rtol=1e-12)
    return tau


def mixture(d, tau, mix):
    """P of Eqs. 10–11."""
    return normalise(mixed_priority(d, tau, mix))


def distance(P, R):
    """Total variation: the largest difference in the probability of any set of transitions."""
    return abs(P - R).sum() / 2


def filled(delta, mix=MIX, rate=RATE, **priority):
    """A full replay with these TD errors, the newest last, and the rule of the theorem: no offset,
    exponent 1.
    """
    settings = {"priority_offset": 0, "priority_exponent": 1} | priority
    return with_errors(RecencyReplay(len(delta), 1, mix, rate, **settings), delta)


def ideal(replay, delta):
    """P* ∝ |δ| e^{−α age}."""
    age = replay.age(np.arange(len(delta)))
    return normalise(np.abs(delta) * time_priority(age, replay.recency_rate))


@claim("T3-a")
def test_the_product_is_missed_whatever_the_mix():
    """The same P for every β, and the product is another distribution."""
    d, tau = errors(2, 1), halves(0, 1)
    product, (P,) = normalise(d * tau), {tuple(mixture(d, tau, mix)) for mix in MIXES}
    assert distance(np.array(P), product) > 0
    shows(
        "|δ| = ({}), e^{{−α age}} = ({}): P = ({}) for every β, the product ({}), {} apart",
        *(d, tau, P, product, distance(np.array(P), product)),
    )


@control("T3-a")
def test_control_a_sum_can_equal_the_product():
    """|δ| = (1, 2), e^{−α age} = (1, ¼), β = 1/7 gives P = P* exactly, on the line of T3-c."""
    d, tau = errors(1, 2), halves(0, 2)
    assert distance(mixture(d, tau, F(1, 7)), normalise(d * tau)) == 0


def gap(n, mix=MIX, rate=RATE):
    """How far P is from P* in a buffer of n transitions whose |δ| are all 1."""
    replay = filled(np.ones(n), mix, rate)
    return distance(replay.probabilities(), ideal(replay, np.ones(n)))


@claim("T3-b")
def test_the_distance_to_the_product_grows_to_1():
    """It rises with N, and 1 is the largest distance there is."""
    sizes = (100, 1_000, 10_000, 100_000)
    found = [gap(n) for n in sizes]
    assert found == sorted(found) and 0.99 < found[-1] < 1
    shows(
        "|δ| = 1, α = {}, β = {:/}: {:.3f} apart at N = {}; the most is {:.0f}",
        *(RATE, MIX, found, sizes, distance(*np.eye(2))),
    )


@claim("T3-b")
@given(
    SEEDS,
    st.integers(1, 3000),
    st.floats(0, 0.2),
    st.floats(0.01, 1),
    st.floats(0.01, 2),
    st.floats(1, 5),
)
def test_the_distance_to_the_product_is_bounded_from_below(seed, n, part, mix, rate, largest):
    """Where 1 ≤ |δ| ≤ M, by 1 − M e^{−αk} − (kM + (1 − β)/(β (1 − e^{−α})))/N for each k."""
    delta = np.random.default_rng(seed).uniform(1, largest, n)
    k, replay = round(part * n), filled(delta, mix, rate)
    bound = (
        1
        - largest * np.exp(-rate * k)
        - (k * largest + (1 - mix) / (mix * (1 - np.exp(-rate)))) / n
    )
    assert distance(replay.probabilities(), ideal(replay, delta)) >= bound - 1e-9
    shows("the bound for every k ≤ N, on random |δ| between two positive bounds")


def line(d, tau):
    """a, b ≥ 0 with a/τ_i + b/d_i = 1 for all i, or None: Cramer's rule for two, and a look at the
    others.
    """
    x, y = 1 / tau, 1 / d
    a, b = tau[0], F(0)  # where all points (x, y) are on one ray, they must all be the same
    for i, j in combinations(range(len(d)), 2):
        if det := x[i] * y[j] - x[j] * y[i]:
            a, b = (y[j] - y[i]) / det, (x[i] - x[j]) / det
            break
    return (a, b) if a >= 0 and b >= 0 and all(a * x + b * y == 1) else None


def place_on_segment(target, start, end):
    """λ in [0, 1] with target = λ start + (1 − λ) end, or None."""
    apart = np.flatnonzero(start != end)
    share = (target - end)[apart[0]] / (start - end)[apart[0]] if len(apart) else F(0)
    return share if 0 <= share <= 1 and all(target == share * start + (1 - share) * end) else None


@st.composite
def buffers(draw):
    """(d, τ), exact, of up to four transitions; half of them made so that the product is a
    mixture.
    """
    ages = draw(st.lists(st.integers(0, 4), min_size=1, max_size=4))
    tau = halves(*ages)
    if draw(st.booleans()):
        a, b = draw(PARTS) * tau.min() * F(11, 12), draw(ERRORS)
        return b / (1 - a / tau), tau
    return errors(*[draw(ERRORS) for _ in ages]), tau


# P* is a mixture iff d τ = a d + b τ with a and b ≥ 0; divide by d τ. Then β = a/(a + b), and
# d = b/(1 − a/τ). With b > 0 that asks for a < τ of the oldest: in a long buffer β is next to 0.


@claim("T3-c")
@given(buffers())
def test_the_product_is_a_mixture_only_on_a_line(buffer):
    """The line is found where and only where P* is on the segment from P_time to P_TD."""
    d, tau = buffer
    product, found = normalise(d * tau), line(d, tau)
    assert (found is None) == (place_on_segment(product, normalise(d), normalise(tau)) is None)
    if found:
        a, b = found
        assert mixture(d, tau, a / (a + b)).tolist() == product.tolist()
        if a and b:
            newest_first = sorted(set(zip(-tau, d, strict=True)))
            assert all(newer[1] < older[1] for newer, older in pairwise(newest_first))
    shows("random buffers of up to four transitions")


RISING = (F(1), F(7, 6), F(7, 4))  # |δ| of three transitions, the newest first


def orders_on_a_line(tau):
    """{order of these |δ|: the β whose mixture is the product}."""
    found = {order: line(errors(*order), tau) for order in permutations(RISING)}
    return found, {order: ab[0] / sum(ab) for order, ab in found.items() if ab}


@claim("T3-c")
def test_one_order_of_six_has_a_beta():
    """That in which |δ| grows with age."""
    tau = halves(0, 1, 2)
    orders, betas = orders_on_a_line(tau)
    assert list(betas) == [RISING]
    assert mixture(errors(*RISING), tau, betas[RISING]).tolist() == (
        normalise(errors(*RISING) * tau).tolist()
    )
    shows(
        "|δ| = ({}), τ = ({}): β = {}; of the {} orders of these |δ| no other will do",
        *(RISING, tau, betas[RISING], len(orders)),
    )


@control("T3-c")
def test_control_without_recency_every_order_will_do():
    """With α = 0 all τ are 1, and the product is P_TD itself, at β = 1."""
    orders, betas = orders_on_a_line(halves(0, 0, 0))
    assert len(betas) == len(orders)


def divergence_slope(target, start, end, share):
    """d/dλ KL(target ‖ λ start + (1 − λ) end), exactly; it rises with λ where start ≠ end, for KL
    is convex there.
    """
    return -(target * (start - end) / (share * start + (1 - share) * end)).sum()


def three():
    """(d, τ, P*, P_TD, P_time) of |δ| = (1, 2, 4) at the ages 0, 1, 2."""
    d, tau = errors(1, 2, 4), halves(0, 1, 2)
    return d, tau, normalise(d * tau), normalise(d), normalise(tau)


@claim("T3-d")
def test_the_closest_mixture_is_not_the_product():
    """The slope in λ is 0 at λ = ½, so the minimum is there, which is β = 1/5."""
    (d, tau, product, start, end), beta = three(), F(1, 5)
    closest = mixture(d, tau, beta)
    assert closest.tolist() == ((start + end) / 2).tolist() != product.tolist()
    assert divergence_slope(product, start, end, F(1, 2)) == 0
    nats = (product * np.log((product / closest).astype(float))).sum()
    shows(
        "|δ| = ({}), τ = ({}): product ({}), closest ({}) at β = {}, KL {:.6f}",
        *(d, tau, product, closest, beta, nats),
    )


@given(PARTS)
def test_the_divergence_falls_before_it_and_rises_after_it(share):
    """So there is no other minimum."""
    _, _, product, start, end = three()
    slope = divergence_slope(product, start, end, share)
    assert (slope < 0, slope > 0) == (share < F(1, 2), share > F(1, 2))


def test_with_two_transitions_the_closest_can_be_an_end():
    """P* = (8/9, 1/9) is beyond P_time = (4/5, 1/5), where the slope is positive."""
    d, tau = errors(2, 1), halves(0, 2)
    assert divergence_slope(normalise(d * tau), normalise(d), normalise(tau), F(0)) > 0


@control("T3-d")
def test_control_the_closest_is_the_product_where_that_is_a_mixture():
    """On the line of T3-c the slope is 0 at the product itself."""
    d, tau = errors(*RISING), halves(0, 1, 2)
    product, start, end = normalise(d * tau), normalise(d), normalise(tau)
    share = place_on_segment(product, start, end)
    assert divergence_slope(product, start, end, share) == 0


def most_apart(exponent):
    """(|δ| in [0, 1] at which |δ|^γ − |δ| is largest, how large it is there)."""
    return exponent ** (1 / (1 - exponent)), (1 - exponent) * exponent ** (
        exponent / (1 - exponent)
    )


# d^γ − d has slope 0 at d = γ^{1/(1 − γ)}, and
# d − d^γ = d (1 − e^{−(1 − γ) ln d}) ≤ d (1 − γ) ln d.


@claim("T3-e")
@given(st.floats(0.01, 0.999), st.floats(0, 1), st.floats(1, 1000))
def test_the_exponent_fades_as_it_tends_to_1(exponent, small, large):
    """On [0, 1] the gap is (1 − γ) γ^{γ/(1 − γ)} at most, on [1, M] (1 − γ) M ln M, and both tend
    to 0 with 1 − γ.
    """
    at, gap = most_apart(exponent)
    assert -1e-12 <= td_priority(small, 0, exponent) - small <= gap + 1e-12
    assert td_priority(at, 0, exponent) - at == pytest.approx(gap, abs=1e-12)
    relative = (large - td_priority(large, 0, exponent)) / large
    assert -1e-12 <= relative <= (1 - exponent) * np.log(large) + 1e-12
    shows("|δ| − |δ|^γ on [1, M] is (1 − γ) M ln M at most")


@claim("T3-e")
def test_the_gap_for_three_exponents():
    """It falls as γ rises."""
    exponents = (0.6, 0.9, 0.99)
    gaps = [td_priority(at, 0, g) - at for g in exponents for at in most_apart(g)[:1]]
    assert gaps == sorted(gaps, reverse=True)
    shows("|δ|^γ − |δ| on [0, 1] is {:.4f} at most for γ = {}", gaps, exponents)


@claim("T3-e")
def test_at_a_fixed_exponent_c_is_not_1():
    """At a small error: far from it at PER's usual exponent, and not there at one near 1."""
    small, exponents = 0.01, (0.6, 0.99)
    c = [td_priority(small, 0, exponent) / small for exponent in exponents]
    assert c[0] > 6 and c[1] > 1.04
    shows("c = {:.2f} at |δ| = {}, γ = {}", c, small, exponents)


@control("T3-e")
@pytest.mark.parametrize("copies", [1, 100, 10_000])
def test_control_a_growing_buffer_does_not_bring_c_to_1(copies):
    """N instead of γ: the draws of |δ| = 1 and 0.01 stay as far from those of γ = 1 as they are."""
    delta = np.repeat([1.0, 0.01], copies)
    P, limit = normalise(td_priority(delta, 0, 0.6)), normalise(td_priority(delta, 0, 1))
    assert distance(P, limit) == pytest.approx(0.01**0.6 / (1 + 0.01**0.6) - 0.01 / 1.01, rel=1e-9)


def variance(P, f):
    """Of n w f with one transition drawn from P and w = 1/(n P): an estimate of Σ f without
    bias.
    """
    draw = len(P) * importance_weights(P, len(P), 1, None) * f
    assert (P * draw).sum() == f.sum()
    return (P * draw**2).sum() - f.sum() ** 2


def variances(mix):
    """V of Σ |δ| τ and V of Σ |δ| drawn by the mixture of β, and V of Σ |δ| drawn by the product:
    |δ| = (1, 1), τ = (1, ½).
    """
    d, tau = errors(1, 1), halves(0, 1)
    P = mixture(d, tau, mix)
    return variance(P, d * tau), variance(P, d), variance(normalise(d * tau), d)


@claim("T3-f")
@given(PARTS)
def test_the_variance_depends_on_the_mix(mix):
    """β = 0 alone is best for Σ |δ| τ, and β = 1 alone for Σ |δ|, to which w = 1/(N P) leads."""
    product_sum, error_sum, by_product = variances(mix)
    assert product_sum == mix**2 / (2 * (1 + mix))
    assert error_sum == (1 - mix) ** 2 / (2 * (1 + mix))
    assert error_sum <= by_product == variances(F(0))[1]
    shows(
        "|δ| = ({}), τ = ({}): V = β²/(2 + 2β) for Σ |δ| τ, (1 − β)²/(2 + 2β) for Σ |δ|, {} from"
        " the product",
        *(errors(1, 1), halves(0, 1), by_product),
    )


@pytest.mark.parametrize(("mix", "value"), [(F(1, 5), F(1, 10)), (F(1, 2), F(127, 136))])
def test_the_best_mix_can_be_between_the_ends(mix, value):
    """|δ| = (1, 2, 4), τ = (1, ½, ¼), Σ |δ| τ: at β = ½ V is nine times that of β = 1/5."""
    d, tau, *_ = three()
    assert variance(mixture(d, tau, mix), d * tau) == value


@given(buffers(), st.tuples(PARTS, PARTS), PARTS, SEEDS)
def test_the_variance_is_convex_along_the_mixtures(buffer, ends, part, seed):
    """V is convex in λ, for 1/P is, so it has one least value, where f puts it."""
    d, tau = buffer
    f = exact(*np.random.default_rng(seed).integers(-3, 4, len(d)).tolist())
    start, end = (mixture(d, tau, mix) for mix in ends)
    between = part * start + (1 - part) * end
    assert variance(between, f) <= part * variance(start, f) + (1 - part) * variance(end, f)


@control("T3-f")
@given(buffers(), PARTS)
def test_control_each_mixture_is_the_best_for_its_own_integrand(buffer, mix):
    """Where f is in proportion to P there is no variance, so each β is the best for one f."""
    P = mixture(*buffer, mix)
    assert variance(P, 3 * P) == 0


@claim("T3-g")
@given(st.lists(st.tuples(ERRORS, ERRORS, st.sampled_from([-1, 1])), min_size=1, max_size=5))
def test_the_best_distribution_follows_the_integrand(draws):
    """V(P) − V(P_f) = Σ (|f| − S P)²/P, with S = Σ |f| and P_f = |f|/S, for each P."""
    priority, size, sign = (np.array(column) for column in zip(*draws, strict=True))
    P, f = normalise(priority), sign * size
    rest = ((size - size.sum() * P) ** 2 / P).sum()
    assert variance(P, f) - variance(normalise(size), f) == rest >= 0
    shows("V(P) − V(|f|/Σ|f|) = Σ (|f| − P Σ|f|)²/P ≥ 0 for random P and f, exactly")


@control("T3-g")
def test_control_another_power_of_the_integrand_is_worse():
    """f = (1, 2) has no variance under P ∝ |f|, and some under P ∝ f²."""
    f = exact(1, 2)
    assert variance(normalise(f), f) == 0 < variance(normalise(f**2), f)


def gradient_sizes(x, error):
    """‖∂/∂θ of ½ e²‖ of each transition, for a network that is one linear layer with bias."""
    net, sizes = MLP((1, 1)), []
    for value, e in zip(x, error, strict=True):
        _, cache = net.forward(np.zeros(2), np.array([[value]]))
        dq = loss_gradient(np.array([e]), np.ones(1), np.array([0]), 1)
        sizes.append(np.linalg.norm(net.backward(np.zeros(2), cache, dq)))
    return np.array(sizes)


def second_moments(x):
    """(‖∇h‖ of each transition, E‖f/P‖² drawn by |δ|, and drawn by |δ| ‖∇h‖), for δ = (1, 1) and a
    linear h = 0.
    """
    delta = np.ones(len(x))
    sizes = gradient_sizes(x, delta)
    by_error, at_best = normalise(td_priority(delta, 0, 1)), normalise(sizes)
    return sizes, (sizes**2 / by_error).sum(), (sizes**2 / at_best).sum()


@claim("T3-j")
def test_the_integrand_is_the_gradient():
    """Where the gradients of h differ, drawing by |δ| is not drawing by the integrand."""
    sizes, by_error, at_best = second_moments([0, np.sqrt(99)])
    assert by_error > at_best == pytest.approx(sizes.sum() ** 2)
    shows(
        "δ = ({}), a linear h = 0, ‖∇h‖ = ({:.3g}): E‖f/P‖² = {:.6g} by |δ|, {:.6g} by |δ| ‖∇h‖",
        *(np.ones(2), sizes, by_error, at_best),
    )


@claim("T3-j")
def test_a_fitted_transition_adds_nothing_and_is_still_drawn():
    """Where h = δ nothing is left to learn, and |δ| gives it most of the draws."""
    delta, h = np.array([5.0, 1.0]), np.array([5.0, 0.0])
    P, sizes = normalise(td_priority(delta, 0, 1)), gradient_sizes(np.zeros(2), delta - h)
    assert sizes[0] == 0 < sizes[1] and P[0] > P[1]
    shows("δ = ({}), h = ({}): P = ({:/}), gradients of size {}", delta, h, P, sizes)


@control("T3-j")
def test_control_by_error_is_best_where_all_gradients_of_h_are_as_long():
    """With x = ±1, hence one ‖∇h‖, drawing by |δ| is drawing by the integrand."""
    _, by_error, at_best = second_moments([1, -1])
    assert by_error == pytest.approx(at_best)


def probabilities_of_the_theorem(delta, mix, exponent, rate):
    """P ∝ β |δ|^γ + (1 − β) e^{−α(T − t)}, in a plain loop."""
    n = len(delta)
    return normalise(
        np.array(
            [
                mix * abs(e) ** exponent + (1 - mix) * np.exp(-rate * (n - 1 - i))
                for i, e in enumerate(delta)
            ]
        )
    )


@claim("T3-h")
@given(SEEDS, st.integers(1, 40), st.floats(0.01, 0.99), st.floats(0.1, 1), st.floats(0, 2))
def test_the_rule_of_the_theorem_has_no_offset(seed, n, mix, exponent, rate):
    """With ε = 0 the probabilities are the theorem's."""
    delta = np.random.default_rng(seed).normal(size=n)
    replay = filled(delta, mix, rate, priority_exponent=exponent)
    expected = probabilities_of_the_theorem(delta, mix, exponent, rate)
    np.testing.assert_allclose(replay.probabilities(), expected, rtol=1e-9)
    shows("random buffers: the same P with ε = 0")


@claim("T3-h")
def test_with_an_offset_a_transition_without_error_has_a_td_priority():
    """In the theorem it has none."""
    offset, exponent = 0.01, 0.6
    kept, dropped = (td_priority(0.0, each, exponent) for each in (offset, 0))
    assert kept > dropped == 0
    shows(
        "δ = 0, γ = {}: p^TD is {:.4f} with ε = {}, and {} in the theorem",
        *(exponent, kept, offset, dropped),
    )


@control("T3-h")
def test_control_with_an_offset_the_rules_differ():
    """The one without error has 2 points more with ε."""
    delta, mix, exponent, rate = np.array([0.0, 1.0]), 0.5, 0.6, 1.0
    replay = filled(delta, mix, rate, priority_offset=0.01, priority_exponent=exponent)
    expected = probabilities_of_the_theorem(delta, mix, exponent, rate)
    assert replay.probabilities()[0] > expected[0] + 0.02


def newest_and_oldest(n, mix=MIX):
    """(P, P*) of the newest and of the oldest transition when all |δ| are 1, so that they have
    converged.
    """
    replay = filled(np.ones(n), mix)
    P, product = replay.probabilities(), ideal(replay, np.ones(n))
    return (P[-1], product[-1]), (P[0], product[0])


@pytest.mark.parametrize("n", [1_000, 10_000, 100_000])
def test_of_the_oldest_both_rules_leave_nothing(n):
    """The one that was stored first has 1/N at most under both rules, as under many others."""
    _, oldest = newest_and_oldest(n)
    assert max(oldest) <= 1 / n


@claim("T3-i")
def test_p_of_the_newest_tends_to_0_and_the_product_does_not():
    """All |δ| are 1, so that they have converged; i is an age, 0."""
    sizes = (1_000, 10_000, 100_000)
    for n in sizes:
        (P, product), _ = newest_and_oldest(n)
        assert n * P < 3 and product == pytest.approx(1 - np.exp(-RATE), rel=1e-4)
    shows(
        "|δ| = 1, α = {}, β = {:/}, N = {}: the newest has P = {:.5f}, P* = {:.5f}",
        *(RATE, MIX, n, P, product),
    )


@control("T3-i")
@pytest.mark.parametrize("n", [1_000, 100_000])
def test_control_without_the_td_term_the_newest_has_its_share(n):
    """With β = 0 and |δ| = 1 the rule is the product at every N, so by age it can hold."""
    (P, product), _ = newest_and_oldest(n, mix=0)
    assert pytest.approx(product, rel=1e-9) == P


def between(P, d, tau):
    """Whether every P_i/P_j lies between d_i/d_j and τ_i/τ_j."""
    for i, j in permutations(range(len(d)), 2):
        low, high = sorted((d[i] / d[j], tau[i] / tau[j]))
        if not low <= P[i] / P[j] <= high:
            return False
    return True


# The mediant: if r ≤ d_i/d_j, τ_i/τ_j ≤ R, then β d_i + (1 − β) τ_i is r to R times
# β d_j + (1 − β) τ_j. The product has d_i/d_j times τ_i/τ_j, which is beyond both where both are
# above 1. So a mixture can be the product only if no newer transition has the larger error: of the
# n! orders of n errors that is one.


@claim("T3-k")
@given(buffers(), PARTS)
def test_the_ratio_of_a_mixture_lies_between_those_of_its_parts(buffer, mix):
    """On random buffers, exactly, for every pair of transitions."""
    d, tau = buffer
    assert between(mixture(d, tau, mix), d, tau)
    shows(
        "if i is newer than j and has the larger error, P_i/P_j is below the product's ratio for"
        " every β"
    )


@control("T3-k")
def test_control_the_product_is_beyond_both_ratios():
    """|δ| = (3, 1), τ = (1, ½): the product has a ratio of 6, and its parts have 3 and 2."""
    d, tau = errors(3, 1), halves(0, 1)
    assert not between(normalise(d * tau), d, tau)

"""Theorem 3: the mixed priorities tend to the product of error and recency. They do not, and no
mixture is best.

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

from gbdqn_ref.bellman import loss_gradient
from gbdqn_ref.nn import MLP
from gbdqn_ref.replay import (
    RecencyReplay,
    importance_weights,
    mixed_priority,
    td_priority,
    time_priority,
)

MIXES = [F(0), F(1, 7), F(1, 2), F(9, 10), F(1)]
SEEDS = st.integers(0, 10**6)
PARTS = st.fractions(0, 1, max_denominator=12)
ERRORS = st.fractions(F(1, 6), 6, max_denominator=6)


def exact(*values):
    return np.array([F(value) for value in values])


def errors(*values):
    """p^TD of these |δ|, without offset and with exponent 1, exactly."""
    return td_priority(exact(*values), 0, 1)


def halves(*ages):
    """p^time of these ages for α = ln 2, exactly."""
    tau = exact(*[F(1, 2**age) for age in ages])
    np.testing.assert_allclose(time_priority(ages, np.log(2)), tau.astype(float), rtol=1e-12)
    return tau


def normalise(p):
    return p / p.sum()


def mixture(d, tau, mix):
    return normalise(mixed_priority(d, tau, mix))


def distance(P, R):
    """Total variation: the largest difference in the probability of any set of transitions."""
    return abs(P - R).sum() / 2


def filled(delta, mix=0.5, rate=0.01, **priority):
    """A full replay with these TD errors, the newest last, and the rule of the theorem: no offset,
    exponent 1.
    """
    replay = RecencyReplay(
        len(delta), 1, mix, rate, **({"priority_offset": 0, "priority_exponent": 1} | priority)
    )
    replay.added = len(delta)
    replay.update_priorities(np.arange(len(delta)), delta)
    return replay


def ideal(replay, delta):
    return normalise(
        np.abs(delta) * time_priority(replay.age(np.arange(len(delta))), replay.recency_rate)
    )


@claim(
    "T3-a",
    place="Theorem 3",
    says="the mixed rule samples in proportion to |δ| e^{−α(T − t)}",
    verdict="fails: a sum is not a product, for whatever β",
    uses="replay.mixed_priority, replay.td_priority",
)
@pytest.mark.parametrize("mix", MIXES)
def test_the_product_is_missed_whatever_the_mix(mix):
    """|δ| = (2, 1), e^{−α age} = (1, ½): P = (2/3, 1/3) for every β, and the ideal product is P* =
    (4/5, 1/5).
    """
    d, tau = errors(2, 1), halves(0, 1)
    P, product = mixture(d, tau, mix), normalise(d * tau)
    assert P.tolist() == [F(2, 3), F(1, 3)]
    assert product.tolist() == [F(4, 5), F(1, 5)]
    assert distance(P, product) == F(2, 15)
    shows(
        "|δ| = (2, 1), e^{−α age} = (1, ½): P = (2/3, 1/3) for every β, the product (4/5, 1/5),"
        " 2/15 apart"
    )


@control("T3-a")
def test_control_a_sum_can_equal_the_product():
    """Negative control: |δ| = (1, 2), e^{−α age} = (1, ¼), β = 1/7 gives P = P* exactly, on the
    line of T3-c.
    """
    d, tau = errors(1, 2), halves(0, 2)
    assert mixture(d, tau, F(1, 7)).tolist() == normalise(d * tau).tolist()


@claim(
    "T3-b",
    place="Theorem 3",
    says="the mixed rule comes near the product as the buffer grows",
    verdict="fails: at fixed α and β > 0 it moves away from it, to the largest distance there is",
    uses=(
        "replay.RecencyReplay.probabilities, replay.RecencyReplay.td_share,"
        " replay.RecencyReplay.time_total"
    ),
)
def test_the_distance_to_the_product_grows_to_1():
    """|δ| = 1 for all, so P* = P_time, P = λ · uniform + (1 − λ) P*, and the distance is λ times
    that of uniform.
    """
    found = []
    for n in (100, 1_000, 10_000, 100_000):
        replay = filled(np.ones(n))
        product = time_priority(replay.age(np.arange(n)), 0.01) / replay.time_total()
        found.append(distance(replay.probabilities(), product))
        assert found[-1] == pytest.approx(replay.td_share() * distance(1 / n, product), rel=1e-9)
    assert found == sorted(found) and found[-1] > 0.99
    shows(
        f"|δ| = 1, α = 0.01, β = ½: {', '.join(f'{gap:.3f}' for gap in found)} apart at N = 10², …,"
        " 10⁵; the most is 1"
    )


@given(
    SEEDS,
    st.integers(1, 3000),
    st.floats(0, 0.2),
    st.floats(0.01, 1),
    st.floats(0.01, 2),
    st.floats(1, 5),
)
def test_the_distance_to_the_product_is_bounded_from_below(seed, n, part, mix, rate, largest):
    """1 ≤ |δ| ≤ M: TV ≥ 1 − M e^{−αk} − (kM + (1 − β)/(β (1 − e^{−α})))/N for each k, and k = ln N
    / α sends it to 1.

    For P*(newest k) − P(newest k) is no less. P* leaves the older ones M e^{−αk} at most, since
    their Σ τ is so small. P gives the newest k at most (β k M + (1 − β) S_time)/(β N), and S_time ≤
    1/(1 − e^{−α}).
    """
    delta = np.random.default_rng(seed).uniform(1, largest, n)
    k, replay = round(part * n), filled(delta, mix, rate)
    bound = (
        1
        - largest * np.exp(-rate * k)
        - (k * largest + (1 - mix) / (mix * (1 - np.exp(-rate)))) / n
    )
    assert distance(replay.probabilities(), ideal(replay, delta)) >= bound - 1e-9


@control("T3-b")
def test_control_it_stays_where_it_is_when_the_rate_falls_with_the_buffer():
    """Negative control: with α = 3/N it tends to 0.2551, not to 1 (nor to 0): the fixed rate is
    what drives it to 1.
    """
    gaps = []
    for n in (1_000, 100_000):
        replay = filled(np.ones(n), rate=3 / n)
        gaps.append(distance(replay.probabilities(), ideal(replay, np.ones(n))))
    assert gaps == pytest.approx([0.2551, 0.2551], abs=5e-4)


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


@claim(
    "T3-c",
    place="Theorem 3",
    says="for a suitable β the product is one of the mixtures",
    verdict=(
        "holds if one line a/τ_i + b/|δ_i| = 1, a and b ≥ 0, has all i; with 0 < β < 1, |δ| then"
        " grows with age"
    ),
    uses="replay.mixed_priority",
)
@given(buffers())
def test_the_product_is_a_mixture_only_on_a_line(buffer):
    """P* is a mixture iff d τ = a d + b τ, a and b ≥ 0; divide by d τ. Then β = a/(a + b), and d =
    b/(1 − a/τ).

    With b > 0 that asks for a < τ of the oldest: in a long buffer such a β is next to 0.
    """
    d, tau = buffer
    product, found = normalise(d * tau), line(d, tau)
    assert (found is None) == (place_on_segment(product, normalise(d), normalise(tau)) is None)
    if found:
        a, b = found
        assert mixture(d, tau, a / (a + b)).tolist() == product.tolist()
        if a and b:
            newest_first = sorted(set(zip(-tau, d, strict=True)))
            assert all(newer[1] < older[1] for newer, older in pairwise(newest_first))
    assert line(errors(1, F(7, 6), F(7, 4)), halves(0, 1, 2)) == (F(1, 8), F(7, 8))
    shows(
        "|δ| = (1, 7/6, 7/4), τ = (1, ½, ¼): β = 1/8; of the 6 orders of these |δ| no other will do"
    )


@control("T3-c")
def test_control_off_the_line_no_mix_gives_the_product():
    """Negative control: of the six orders of (1, 7/6, 7/4), five are off every line, and the
    product out of reach.
    """
    tau, reached = halves(0, 1, 2), []
    for order in permutations((F(1), F(7, 6), F(7, 4))):
        d = errors(*order)
        if place_on_segment(normalise(d * tau), normalise(d), normalise(tau)) is not None:
            reached.append(order)
    assert reached == [(F(1), F(7, 6), F(7, 4))]


def divergence_slope(target, start, end, share):
    """d/dλ KL(target ‖ λ start + (1 − λ) end), exactly; it rises with λ where start ≠ end, for KL
    is convex there.
    """
    return -(target * (start - end) / (share * start + (1 - share) * end)).sum()


@claim(
    "T3-d",
    place="Theorem 3, proof",
    says=(
        "the mixture closest to the product in Kullback–Leibler divergence is proportional to the"
        " product"
    ),
    verdict="fails: the closest one may be another distribution",
    uses="replay.mixed_priority",
)
@given(PARTS)
def test_the_closest_mixture_is_not_the_product(share):
    """The slope in λ is 0 at λ = ½ and rises, so the minimum is there, and λ = ½ is β = 1/5: (5, 4,
    5)/14.
    """
    d, tau = errors(1, 2, 4), halves(0, 1, 2)
    product, start, end = normalise(d * tau), normalise(d), normalise(tau)
    closest = mixture(d, tau, F(1, 5))
    assert closest.tolist() == [F(5, 14), F(4, 14), F(5, 14)] == ((start + end) / 2).tolist()
    assert product.tolist() == [F(1, 3)] * 3
    slope = divergence_slope(product, start, end, share)
    assert (slope < 0, slope > 0) == (share < F(1, 2), share > F(1, 2))
    assert distance(closest, product) == F(1, 21)
    nats = (product * np.log((product / closest).astype(float))).sum()
    shows(
        "|δ| = (1, 2, 4), τ = (1, ½, ¼): product uniform, closest (5, 4, 5)/14 at β = 1/5, KL"
        f" {nats:.6f}"
    )


def test_with_two_transitions_the_closest_can_be_an_end_or_the_only_one():
    """The smallest example is that of T3-a: all mixtures are (2/3, 1/3), so that is the closest,
    and not (4/5, 1/5).
    """
    d, tau = errors(2, 1), halves(0, 1)
    assert {tuple(mixture(d, tau, mix)) for mix in MIXES} == {(F(2, 3), F(1, 3))}
    d, tau = (
        errors(2, 1),
        halves(0, 2),
    )  # P* = (8/9, 1/9); closest is (4/5, 1/5) at β = 0, where the slope is positive
    assert divergence_slope(normalise(d * tau), normalise(d), normalise(tau), F(0)) > 0


@control("T3-d")
def test_control_the_closest_is_the_product_where_that_is_a_mixture():
    """Negative control: with |δ| = (1, 7/6, 7/4) the product is the mixture of β = 1/8, and there
    the slope is 0.
    """
    d, tau = errors(1, F(7, 6), F(7, 4)), halves(0, 1, 2)
    product, start, end = normalise(d * tau), normalise(d), normalise(tau)
    share = place_on_segment(product, start, end)
    assert mixture(d, tau, F(1, 8)).tolist() == product.tolist()
    assert divergence_slope(product, start, end, share) == 0


def most_apart(exponent):
    """(|δ| in [0, 1] at which |δ|^γ − |δ| is largest, how large it is there)."""
    return exponent ** (1 / (1 - exponent)), (1 - exponent) * exponent ** (
        exponent / (1 - exponent)
    )


@claim(
    "T3-e",
    place="Theorem 3, proof",
    says="|δ|^γ = |δ| c with c tending to 1",
    verdict=(
        "holds if it is γ that tends to 1, |δ| is bounded and not 0; a growing buffer at fixed γ"
        " changes nothing"
    ),
    uses="replay.td_priority",
)
@given(st.floats(0.01, 0.999), st.floats(0, 1), st.floats(1, 1000))
def test_the_exponent_fades_as_it_tends_to_1(exponent, small, large):
    """On [0, 1] the gap is (1 − γ) γ^{γ/(1 − γ)} at most, on [1, M] (1 − γ) M ln M, and both tend
    to 0 with 1 − γ.

    d^γ − d has slope 0 at d = γ^{1/(1 − γ)}; and d − d^γ = d (1 − e^{−(1 − γ) ln d}) ≤ d (1 − γ) ln
    d.
    """
    at, gap = most_apart(exponent)
    assert -1e-12 <= td_priority(small, 0, exponent) - small <= gap + 1e-12
    assert td_priority(at, 0, exponent) - at == pytest.approx(gap, abs=1e-12)
    assert (
        -1e-12
        <= (large - td_priority(large, 0, exponent)) / large
        <= (1 - exponent) * np.log(large) + 1e-12
    )
    gaps = ", ".join(f"{most_apart(g)[1]:.4f}" for g in (0.6, 0.9, 0.99))
    ratio = td_priority(0.01, 0, 0.6) / 0.01
    shows(
        f"|δ|^γ − |δ| on [0, 1] is {gaps} at most for γ = 0.6, 0.9, 0.99; c = {ratio:.2f} at |δ| ="
        " 0.01, γ = 0.6"
    )


@control("T3-e")
@pytest.mark.parametrize("copies", [1, 100, 10_000])
def test_control_a_growing_buffer_does_not_bring_c_to_1(copies):
    """Negative control: N instead of γ. The draws of |δ| = 1 and 0.01 stay as far from those of γ =
    1 as they are.
    """
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


@claim(
    "T3-f",
    place="Theorem 3",
    says="for 0 < β < 1 the mixed rule has the least variance of all mixtures",
    verdict=(
        "fails: the variance depends on β, and the best β, which may be 0 or 1, on what is"
        " estimated"
    ),
    uses="replay.importance_weights, replay.mixed_priority",
)
@given(PARTS)
def test_the_variance_depends_on_the_mix(mix):
    """|δ| = (1, 1), τ = (1, ½): β = 0 alone is best for Σ |δ| τ, and β = 1 alone for Σ |δ|, to
    which w = 1/(N P) leads.

    Both ends are outside 0 < β < 1. For Σ |δ| the product is P at β = 0, the worst of the mixtures.
    """
    d, tau = errors(1, 1), halves(0, 1)
    P = mixture(d, tau, mix)
    assert variance(P, d * tau) == mix**2 / (2 * (1 + mix))
    assert variance(P, d) == (1 - mix) ** 2 / (2 * (1 + mix))
    assert variance(normalise(d * tau), d) == F(1, 2)
    shows(
        "|δ| = (1, 1), τ = (1, ½): V = ½ β²/(1 + β) for Σ |δ| τ, ½ (1 − β)²/(1 + β) for Σ |δ|, ½"
        " from the product"
    )


@pytest.mark.parametrize(("mix", "value"), [(F(1, 5), F(1, 10)), (F(1, 2), F(127, 136))])
def test_the_best_mix_can_be_between_the_ends(mix, value):
    """|δ| = (1, 2, 4), τ = (1, ½, ¼), Σ |δ| τ: a best β between 0 and 1, 1/5, where ½ has nine
    times the variance.
    """
    d, tau = errors(1, 2, 4), halves(0, 1, 2)
    assert variance(mixture(d, tau, mix), d * tau) == value


@given(buffers(), st.tuples(PARTS, PARTS), PARTS, SEEDS)
def test_the_variance_is_convex_along_the_mixtures(buffer, ends, part, seed):
    """What is true of the best mixture: V is convex in λ, for 1/P is, so it has one least value,
    where f puts it.
    """
    d, tau = buffer
    f = exact(*np.random.default_rng(seed).integers(-3, 4, len(d)).tolist())
    start, end = (mixture(d, tau, mix) for mix in ends)
    between = part * start + (1 - part) * end
    assert variance(between, f) <= part * variance(start, f) + (1 - part) * variance(end, f)


@control("T3-f")
@given(buffers(), PARTS)
def test_control_each_mixture_is_the_best_for_its_own_integrand(buffer, mix):
    """Negative control: where f is in proportion to P there is no variance, so each β is the best
    for one f.
    """
    P = mixture(*buffer, mix)
    assert variance(P, 3 * P) == 0


@claim(
    "T3-g",
    place="Theorem 3, proof",
    says="the best of all distributions is proportional to the size of the integrand",
    verdict="holds",
    uses="replay.importance_weights",
)
@given(st.lists(st.tuples(ERRORS, ERRORS, st.sampled_from([-1, 1])), min_size=1, max_size=5))
def test_the_best_distribution_follows_the_integrand(draws):
    """V(P) − V(P_f) = Σ (|f| − S P)²/P, with S = Σ |f| and P_f = |f|/S, for each P: Cauchy–Schwarz,
    with its rest.
    """
    priority, size, sign = (np.array(column) for column in zip(*draws, strict=True))
    P, f = normalise(priority), sign * size
    rest = ((size - size.sum() * P) ** 2 / P).sum()
    assert variance(P, f) - variance(normalise(size), f) == rest >= 0
    shows("V(P) − V(|f|/Σ|f|) = Σ (|f| − P Σ|f|)²/P ≥ 0 for random P and f, exactly")


@control("T3-g")
def test_control_another_power_of_the_integrand_is_worse():
    """Negative control: f = (1, 2) has no variance under P ∝ |f|, and 1 under P ∝ f²."""
    f = exact(1, 2)
    assert [variance(normalise(f**power), f) for power in (1, 2)] == [0, 1]


def gradient_sizes(x, error):
    """‖∂/∂θ of ½ e²‖ of each transition, for a network that is one linear layer with bias."""
    net, sizes = MLP((1, 1)), []
    for value, e in zip(x, error, strict=True):
        _, cache = net.forward(np.zeros(2), np.array([[value]]))
        dq = loss_gradient(np.array([e]), np.ones(1), np.array([0]), 1)
        sizes.append(np.linalg.norm(net.backward(np.zeros(2), cache, dq)))
    return np.array(sizes)


@claim(
    "T3-j",
    place="Theorem 3, proof",
    says="the integrand, what a transition adds to the gradient, is of size |δ| e^{−α(T − t)}",
    verdict="fails: it is |δ − h| ‖∇h‖, without an age",
    uses="bellman.loss_gradient, nn.MLP.backward, replay.td_priority",
)
def test_the_integrand_is_the_gradient():
    """h = 0, |δ| = (1, 1), ‖∇h‖ = (1, 10) at whatever ages: E‖f/P‖² is 202 when drawn by |δ|, and
    121 at best.

    Later h = δ = 5 at one transition, where nothing is left to learn, and |δ| gives it five draws
    in six.
    """
    delta, x = np.ones(2), np.array([0, np.sqrt(99)])
    sizes = gradient_sizes(x, delta)
    np.testing.assert_allclose(sizes, [1, 10], rtol=1e-12)
    moments = [
        (sizes**2 / P).sum() for P in (normalise(td_priority(delta, 0, 1)), normalise(sizes))
    ]
    np.testing.assert_allclose(moments, [202, 121], rtol=1e-12)
    delta, h = np.array([5.0, 1.0]), np.array([5.0, 0.0])
    assert normalise(td_priority(delta, 0, 1))[0] == pytest.approx(5 / 6)
    assert gradient_sizes(np.zeros(2), delta - h).tolist() == [0, 1]
    shows("δ = (1, 1), a linear h = 0, ‖∇h‖ = (1, 10): E‖f/P‖² = 202 by |δ|, 121 by |δ| ‖∇h‖")


@control("T3-j")
def test_control_by_error_is_best_where_all_gradients_of_h_are_as_long():
    """Negative control: with x = ±1, hence one ‖∇h‖, and h = 0, drawing by |δ| is drawing by the
    integrand.
    """
    delta = np.array([2.0, 1.0])
    sizes = gradient_sizes(np.array([1, -1]), delta)
    np.testing.assert_allclose(normalise(sizes), normalise(td_priority(delta, 0, 1)), rtol=1e-12)


@claim(
    "T3-h",
    place="Theorem 3, Eqs. 10–11",
    says="the rule of the theorem is that of Eqs. 10–11",
    verdict="holds if ε = 0 and 0 < β < 1: the theorem leaves out the ε of p^TD and both ends of β",
    uses="replay.RecencyReplay.probabilities, replay.td_priority",
)
@given(SEEDS, st.integers(1, 40), st.floats(0.01, 0.99), st.floats(0.1, 1), st.floats(0, 2))
def test_the_rule_of_the_theorem_has_no_offset(seed, n, mix, exponent, rate):
    """With ε = 0 the probabilities are the theorem's; with ε > 0 a transition without error has a
    TD priority too.
    """
    delta = np.random.default_rng(seed).normal(size=n)
    replay = filled(delta, mix, rate, priority_exponent=exponent)
    p = [
        mix * abs(e) ** exponent + (1 - mix) * np.exp(-rate * (n - 1 - i))
        for i, e in enumerate(delta)
    ]
    np.testing.assert_allclose(replay.probabilities(), np.array(p) / sum(p), rtol=1e-9)
    dropped = [td_priority(0.0, offset, 0.6) for offset in (0.01, 0)]
    shows(
        f"δ = 0, γ = 0.6: p^TD is {dropped[0]:.4f} with ε = 0.01, and {dropped[1]:.0f} in the"
        " theorem"
    )


@control("T3-h")
def test_control_with_an_offset_the_rules_differ():
    """Negative control: δ = (0, 1), α = 1, β = ½, γ = 0.6. The older one, without error, has 2
    points more with ε.
    """
    with_offset, without = (
        filled(
            np.array([0.0, 1.0]), 0.5, 1.0, priority_offset=offset, priority_exponent=0.6
        ).probabilities()[0]
        for offset in (0.01, 0)
    )
    assert (with_offset, without) == (
        pytest.approx(0.1768, abs=1e-4),
        pytest.approx(0.1554, abs=1e-4),
    )


def newest_and_oldest(n, mix=0.5):
    """(P, P*) of the newest and of the oldest transition when all |δ| are 1, so that they have
    converged.
    """
    replay = filled(np.ones(n), mix)
    P, product = replay.probabilities(), ideal(replay, np.ones(n))
    return (P[-1], product[-1]), (P[0], product[0])


@claim(
    "T3-i",
    place="Theorem 3",
    says="if the TD errors converge, each P(i) tends to P*(i) as the buffer grows",
    verdict=(
        "ambiguous: of one stored transition it says nothing, as both tend to 0; of the newest it"
        " is false"
    ),
    uses="replay.RecencyReplay.probabilities",
)
def test_p_of_i_converges_in_no_sense_that_says_anything():
    """|δ_i| is one number per transition, here 1, so its convergence gives nothing; and i can be a
    slot or an age.

    The one that was stored first has 1/N at most under both rules, as it has under many others:
    both tend to 0.
    """
    for n in (1_000, 10_000, 100_000):
        newest, oldest = newest_and_oldest(n)
        assert max(oldest) <= 1 / n
        assert newest[1] == pytest.approx(1 - np.exp(-0.01), rel=1e-4)
        assert newest[0] < 3 / n
    shows(
        f"|δ| = 1, α = 0.01, β = ½, N = 10⁵: the newest has P = {newest[0]:.5f}, P* ="
        f" {newest[1]:.5f}"
    )


@control("T3-i")
def test_control_without_the_td_term_the_newest_has_its_share():
    """Negative control: with β = 0 and |δ| = 1 the rule is the product at every N, so by age it can
    hold.
    """
    for n in (1_000, 100_000):
        (P, product), _ = newest_and_oldest(n, mix=0)
        assert pytest.approx(product, rel=1e-9) == P


@claim(
    "T3-k",
    place="Theorem 3",
    says="what takes its place: P_i/P_j lies between |δ_i|^γ/|δ_j|^γ and τ_i/τ_j",
    verdict="holds",
    uses="replay.mixed_priority",
)
@given(buffers(), PARTS)
def test_the_ratio_of_a_mixture_lies_between_those_of_its_parts(buffer, mix):
    """The mediant: if r ≤ d_i/d_j, τ_i/τ_j ≤ R, then β d_i + (1 − β) τ_i is r to R times β d_j + (1
    − β) τ_j.

    The product has d_i/d_j times τ_i/τ_j, which is beyond both where both are above 1. So a mixture
    can be the product only if no newer transition has the larger error: of n! orders of n errors
    that is one.
    """
    d, tau = buffer
    P = mixture(d, tau, mix)
    for i, j in permutations(range(len(d)), 2):
        low, high = sorted((d[i] / d[j], tau[i] / tau[j]))
        assert low <= P[i] / P[j] <= high
        if low > 1:
            assert P[i] / P[j] < low * high
    shows(
        "if i is newer than j and has the larger error, P_i/P_j is below the product's ratio for"
        " every β"
    )


@control("T3-k")
def test_control_the_product_is_beyond_both_ratios():
    """Negative control: |δ| = (3, 1), τ = (1, ½). Mixtures have ratios from 2 to 3, and the product
    has 6.
    """
    d, tau = errors(3, 1), halves(0, 1)
    ratios = [P[0] / P[1] for P in (*(mixture(d, tau, mix) for mix in MIXES), normalise(d * tau))]
    assert (min(ratios[:-1]), max(ratios[:-1]), ratios[-1]) == (2, 3, 6)

"""Theorem 3: the mixed priorities tend to the product of error and recency. They do not, and no mixture is best.

Letters: d = |δ|, τ = e^{−α age}, P the mixed rule, P* ∝ d τ the product that the theorem calls ideal, V the variance of
one draw. Exact fractions take α = ln 2, so that τ = 1, ½, ¼, …
"""

from fractions import Fraction as F
from itertools import combinations, pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.replay import RecencyReplay, mixed_priority, td_priority, time_priority

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
    """A full replay with these TD errors, the newest last, and the rule of the theorem: no offset, exponent 1."""
    replay = RecencyReplay(len(delta), 1, mix, rate, **({"priority_offset": 0, "priority_exponent": 1} | priority))
    replay.added = len(delta)
    replay.update_priorities(np.arange(len(delta)), delta)
    return replay


def ideal(replay, delta):
    return normalise(np.abs(delta) * time_priority(replay.age(np.arange(len(delta))), replay.recency_rate))


@claim(
    "T3-a",
    place="Theorem 3",
    says="the mixed rule samples in proportion to |δ| e^{−α(T − t)}",
    verdict="fails: a sum is not a product, for whatever β",
    uses="replay.mixed_priority, replay.td_priority",
)
@pytest.mark.parametrize("mix", MIXES)
def test_the_product_is_missed_whatever_the_mix(mix):
    """|δ| = (2, 1), e^{−α age} = (1, ½): P = (2/3, 1/3) for every β, and the ideal product is P* = (4/5, 1/5)."""
    d, tau = errors(2, 1), halves(0, 1)
    P, product = mixture(d, tau, mix), normalise(d * tau)
    assert P.tolist() == [F(2, 3), F(1, 3)]
    assert product.tolist() == [F(4, 5), F(1, 5)]
    assert distance(P, product) == F(2, 15)
    shows("|δ| = (2, 1), e^{−α age} = (1, ½): P = (2/3, 1/3) for every β, the product (4/5, 1/5), 2/15 apart")


@control("T3-a")
def test_control_a_sum_can_equal_the_product():
    """Negative control: |δ| = (1, 2), e^{−α age} = (1, ¼), β = 1/7 gives P = P* exactly, an accident of n = 2."""
    d, tau = errors(1, 2), halves(0, 2)
    assert mixture(d, tau, F(1, 7)).tolist() == normalise(d * tau).tolist()


@claim(
    "T3-b",
    place="Theorem 3",
    says="the mixed rule comes near the product as the buffer grows",
    verdict="fails: at fixed α and β > 0 it moves away from it, to the largest distance there is",
    uses="replay.RecencyReplay.probabilities, replay.RecencyReplay.td_share, replay.RecencyReplay.time_total",
)
def test_the_distance_to_the_product_grows_to_1():
    """|δ| = 1 for all, so P* = P_time, P = λ · uniform + (1 − λ) P*, and the distance is λ times that of uniform."""
    found = []
    for n in (100, 1_000, 10_000, 100_000):
        replay = filled(np.ones(n))
        product = time_priority(replay.age(np.arange(n)), 0.01) / replay.time_total()
        found.append(distance(replay.probabilities(), product))
        assert found[-1] == pytest.approx(replay.td_share() * distance(1 / n, product), rel=1e-9)
    assert found == sorted(found) and found[-1] > 0.99
    shows(
        f"|δ| = 1, α = 0.01, β = ½: {', '.join(f'{gap:.3f}' for gap in found)} apart at N = 10², …, 10⁵; the most is 1"
    )


@given(SEEDS, st.integers(1, 3000), st.floats(0, 1), st.floats(0.01, 1), st.floats(0.01, 2), st.floats(1, 5))
def test_the_distance_to_the_product_is_bounded_from_below(seed, n, part, mix, rate, largest):
    """1 ≤ |δ| ≤ M: TV ≥ 1 − M e^{−αk} − (kM + (1 − β)/(β (1 − e^{−α})))/N for each k, and k = ln N / α sends it to 1.

    It is P*(newest k) − P(newest k). P* leaves the older ones M e^{−αk} at most, as Σ_{age ≥ k} τ ≤ e^{−αk} Σ τ. P gives
    the newest k at most (β k M + (1 − β) S_time)/(β N), with S_time ≤ 1/(1 − e^{−α}).
    """
    delta = np.random.default_rng(seed).uniform(1, largest, n)
    k, replay = round(part * n), filled(delta, mix, rate)
    bound = 1 - largest * np.exp(-rate * k) - (k * largest + (1 - mix) / (mix * (1 - np.exp(-rate)))) / n
    assert distance(replay.probabilities(), ideal(replay, delta)) >= bound - 1e-9


@control("T3-b")
def test_control_it_stays_where_it_is_when_the_rate_falls_with_the_buffer():
    """Negative control: with α = 3/N it tends to 0.2551, not to 1 (nor to 0): the fixed rate is what drives it to 1."""
    gaps = []
    for n in (1_000, 100_000):
        replay = filled(np.ones(n), rate=3 / n)
        gaps.append(distance(replay.probabilities(), ideal(replay, np.ones(n))))
    assert gaps == pytest.approx([0.2551, 0.2551], abs=5e-4)


def line(d, tau):
    """a, b ≥ 0 with a/τ_i + b/d_i = 1 for all i, or None: Cramer's rule for two, and a look at the others."""
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
    """(d, τ), exact, of up to four transitions; half of them made so that the product is a mixture."""
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
    verdict="holds if one line a/τ_i + b/|δ_i| = 1, a and b ≥ 0, has all i; with 0 < β < 1, |δ| then grows with age",
    uses="replay.mixed_priority",
)
@given(buffers())
def test_the_product_is_a_mixture_only_on_a_line(buffer):
    """P* is a mixture iff d τ = a d + b τ, a and b ≥ 0; divide by d τ. Then β = a/(a + b), and d = b/(1 − a/τ)."""
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
    shows("|δ| = (1, 7/6, 7/4), τ = (1, ½, ¼): β = 1/8; of the 6 orders of these |δ| no other will do")


@control("T3-c")
def test_control_off_the_line_no_mix_gives_the_product():
    """Negative control: of the six orders of (1, 7/6, 7/4), five are off every line, and the product out of reach."""
    tau, reached = halves(0, 1, 2), []
    for order in permutations((F(1), F(7, 6), F(7, 4))):
        d = errors(*order)
        if place_on_segment(normalise(d * tau), normalise(d), normalise(tau)) is not None:
            reached.append(order)
    assert reached == [(F(1), F(7, 6), F(7, 4))]

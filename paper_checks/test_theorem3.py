"""Theorem 3: the mixed priorities sample in proportion to error × recency, and with least variance. They do not.

A sum of two priorities is a mixture of two distributions; what the theorem wants is their product. τ_i = e^{−α age}
stands for the recency of a transition, P* ∝ |δ| τ for the theorem's ideal.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.replay import RecencyReplay, mixed_priority, td_priority, time_priority

MIXES = [F(0), F(1, 7), F(1, 2), F(9, 10), F(1)]
SEEDS = st.integers(0, 10**6)


def exact(*values):
    return np.array([F(value) for value in values])


def normalise(p):
    return p / p.sum()


def rule(delta, recency, mix):
    """P of Eqs. 10–11 with the exponent 1 and the offset 0 that the theorem assumes."""
    return normalise(mixed_priority(td_priority(delta, 0, 1), recency, mix))


def variance(P, f):
    """Of the estimate f_i / P_i of Σ f, drawn from P: Σ f²/P − (Σ f)²."""
    return (f**2 / P).sum() - f.sum() ** 2


@claim(
    "T3-a",
    place="Theorem 3",
    says="the mixed rule samples in proportion to |δ| e^{−α(T − t)}",
    verdict="fails: a sum is not a product, for whatever β",
    uses="replay.mixed_priority, replay.td_priority",
)
@pytest.mark.parametrize("mix", MIXES)
def test_theorem_3_fails_whatever_the_mix(mix):
    """|δ| = (2, 1), e^{−α age} = (1, ½): P = (2/3, 1/3) for every β, and the ideal product is P* = (4/5, 1/5)."""
    delta, recency = exact(2, 1), exact(1, F(1, 2))
    P, ideal = rule(delta, recency, mix), normalise(delta * recency)
    assert P.tolist() == [F(2, 3), F(1, 3)]
    assert ideal.tolist() == [F(4, 5), F(1, 5)]
    assert abs(P - ideal).sum() / 2 == F(2, 15)
    shows("|δ| = (2, 1), e^{−α age} = (1, ½): P = (2/3, 1/3) for every β, the product (4/5, 1/5), 2/15 apart")


@given(SEEDS, st.integers(2, 8), st.floats(0, 1))
def test_the_odds_of_a_mixture_lie_between_those_of_its_parts(seed, n, mix):
    """Why: P_i/P_j = (βδ_i + (1 − β)τ_i)/(βδ_j + (1 − β)τ_j) is a mediant of δ_i/δ_j and τ_i/τ_j, so it lies between.

    Where both are above 1 their product is above both, out of reach of every mixture.
    """
    delta, recency = np.random.default_rng(seed).uniform(0.1, 2, size=(2, n))
    P = rule(delta, recency, mix)
    odds = [np.divide.outer(x, x) for x in (delta, recency, P)]
    assert (odds[2] >= np.minimum(odds[0], odds[1]) * (1 - 1e-9)).all()
    assert (odds[2] <= np.maximum(odds[0], odds[1]) * (1 + 1e-9)).all()


def gap(n, rate):
    """(distance to the ideal, distance to plain PER) in total variation, for n transitions with |δ| in [½, 3/2]."""
    delta = 0.5 + (np.arange(n) * 0.6180339887) % 1  # spread evenly, in no order
    recency = time_priority(np.arange(n), rate)
    P = rule(delta, recency, 0.5)
    return [float(abs(P - normalise(other)).sum() / 2) for other in (delta * recency, delta)]


@claim(
    "T3-b",
    place="Theorem 3",
    says="it does so asymptotically, as the buffer grows",
    verdict="fails: at fixed α and β it tends to PER without recency, as far from the ideal as can be",
    uses="replay.mixed_priority, replay.time_priority",
)
def test_the_gap_grows_to_1_with_the_buffer():
    """Recency's share is at most (1 − β) / ((1 − e^{−α}) β N · mean |δ|), which tends to 0; P* stays on the newest."""
    gaps = [gap(n, 0.01) for n in (100, 1_000, 10_000, 100_000)]
    ideal, per = zip(*gaps, strict=True)
    assert list(ideal) == sorted(ideal) and ideal[-1] > 0.99
    assert list(per) == sorted(per, reverse=True) and per[-1] < 0.002
    shows(f"α = 0.01, β = ½, N = 10², 10³, 10⁴, 10⁵: total variation {', '.join(f'{x:.2f}' for x in ideal)}")


@control("T3-b")
def test_control_with_a_rate_of_3_over_n_the_gap_stays_where_it_is():
    """Negative control: the fixed rate is what drives the two apart; a rate that falls with N leaves them as near."""
    gaps = [gap(n, 3 / n)[0] for n in (1_000, 10_000, 100_000)]
    assert max(gaps) - min(gaps) < 0.01 and gaps[-1] < 0.35


@claim(
    "T3-c",
    place="Theorem 3",
    says="some mixing coefficient gives the product",
    verdict="holds if a/τ_i + b/|δ_i| = 1 for all i with some a, b ≥ 0, and then β = a/(a + b); in general for none",
    uses="replay.mixed_priority, replay.td_priority",
)
@given(st.lists(st.fractions(F(11, 10), 10, max_denominator=20), min_size=1, max_size=6), st.fractions(F(1, 9), 9))
def test_when_a_mixture_is_the_product(delta, a):
    """a δ + b τ = δ τ is what it takes; here δ and a are free, b = 1, and τ = a/(1 − b/δ) is made to fit."""
    delta = exact(*delta)
    recency = a / (1 - 1 / delta)
    assert (rule(delta, recency, a / (a + 1)) == normalise(delta * recency)).all()
    shows("|δ| = (2, 3, 4), τ = (1, ¾, ⅔): β = ⅓ gives the product exactly; |δ| = (2, 1), τ = (1, ½): no β does")


@control("T3-a", "T3-c")
@pytest.mark.parametrize("mix", MIXES)
def test_control_one_priority_changed_and_it_is_another_distribution(mix):
    """Negative control: |δ| = (2, 3, 4), τ = (1, ¾, ⅔) has β = ⅓; with τ = (1, ¾, ½) no β is left."""
    delta = exact(2, 3, 4)
    fits, other = exact(1, F(3, 4), F(2, 3)), exact(1, F(3, 4), F(1, 2))
    assert (rule(delta, fits, F(1, 3)) == normalise(delta * fits)).all()
    for each in (mix, F(1, 3)):
        assert (rule(delta, other, each) != normalise(delta * other)).any()


@claim(
    "T3-d",
    place="Theorem 3",
    says="the product is the mixture that is closest to the ideal",
    verdict="fails: the closest mixture, in KL divergence, is another distribution than the product",
    uses="replay.mixed_priority",
)
def test_the_closest_mixture_is_not_the_product():
    """|δ| = (1, 2, 4), τ = (1, ½, ¼): P* is uniform; by symmetry the closest is (5, 4, 5)/14, at β = 1/5."""
    delta, recency = exact(1, 2, 4), exact(1, F(1, 2), F(1, 4))
    P, ideal = rule(delta, recency, F(1, 5)), normalise(delta * recency)
    assert P.tolist() == [F(5, 14), F(4, 14), F(5, 14)] and ideal.tolist() == [F(1, 3)] * 3
    closest = divergence(ideal, P)
    for mix in np.linspace(0, 1, 101):
        other = rule(delta.astype(float), recency.astype(float), mix)
        assert divergence(ideal, other) >= closest - 1e-12
    assert closest == pytest.approx(0.005388, abs=1e-6)
    shows("|δ| = (1, 2, 4), τ = (1, ½, ¼): the product is uniform, the closest mixture (5, 4, 5)/14, KL 0.005388")


def divergence(P, Q):
    P, Q = P.astype(float), Q.astype(float)
    return float((P * np.log(P / Q)).sum())


@control("T3-d")
def test_control_where_the_product_can_be_reached_it_is_the_closest():
    """Negative control: |δ| = (2, 3, 4), τ = (1, ¾, ⅔): divergence 0 at β = ⅓."""
    delta, recency = exact(2, 3, 4), exact(1, F(3, 4), F(2, 3))
    assert divergence(normalise(delta * recency), rule(delta, recency, F(1, 3))) == pytest.approx(0, abs=1e-15)


@claim(
    "T3-e",
    place="Theorem 3, proof",
    says="|δ|^γ = |δ| c with c close to 1",
    verdict="holds if γ → 1 while |δ| stays between two positive bounds; it is no limit in N",
    uses="replay.td_priority",
)
@given(st.floats(0, 1), st.floats(0.05, 0.999))
def test_the_exponent_costs_at_most_a_known_part(delta, exponent):
    """On [0, 1], d^γ − d is largest where γ d^{γ−1} = 1: there it is (1 − γ) γ^{γ/(1−γ)}, and tends to 0 with 1 − γ."""
    largest = (1 - exponent) * exponent ** (exponent / (1 - exponent))
    assert -1e-12 <= td_priority(delta, 0, exponent) - delta <= largest + 1e-12
    peak = exponent ** (1 / (1 - exponent))
    assert td_priority(peak, 0, exponent) - peak == pytest.approx(largest, abs=1e-12)
    shows("sup over [0, 1] of d^γ − d = (1 − γ) γ^{γ/(1−γ)}: 0.186 at γ = 0.6, 0.004 at γ = 0.99")


@control("T3-e")
def test_control_at_a_small_error_the_factor_is_far_from_1():
    """Negative control: without a lower bound, |δ| = 0.01 at γ = 0.6, c = 6.31, however many transitions there are."""
    assert td_priority(0.01, 0, 0.6) / 0.01 == pytest.approx(6.3096, abs=1e-4)
    assert [(1 - g) * g ** (g / (1 - g)) for g in (0.6, 0.99)] == pytest.approx([0.1859, 0.0037], abs=1e-4)


@claim(
    "T3-f",
    place="Theorem 3",
    says="the rule has the least variance of its class, whatever β",
    verdict="fails: the variance depends on β, and on what is to be estimated",
    uses="replay.mixed_priority",
)
def test_the_variance_depends_on_the_mix():
    """|δ| = (1, 2, 4), τ = (1, ½, ¼). Of Σ |δ|τ: best at β = 1/5. Of Σ |δ|: best at β = 1, where P* itself has 14."""
    delta, recency = exact(1, 2, 4), exact(1, F(1, 2), F(1, 4))
    product = delta * recency
    assert variance(rule(delta, recency, F(1, 5)), product) == F(1, 10)
    assert variance(rule(delta, recency, F(1, 2)), product) == F(127, 136)
    assert variance(normalise(product), product) == 0
    assert variance(rule(delta, recency, 1), delta) == 0
    assert variance(normalise(product), delta) == 14
    shows("estimating Σ |δ|τ: 1/10 at β = 1/5, 127/136 at ½, 0 for the product; Σ |δ|: 0 at β = 1, 14 for the product")


@control("T3-f")
@given(SEEDS)
def test_control_with_equal_parts_the_mix_makes_no_difference(seed):
    """Negative control: where recency is proportional to |δ|, every β gives one distribution and one variance."""
    delta = np.random.default_rng(seed).uniform(0.1, 2, size=4)
    values = [variance(rule(delta, delta / 3, mix), delta) for mix in (0.1, 0.5, 0.9)]
    np.testing.assert_allclose(values, 0, atol=1e-9)


@claim(
    "T3-g",
    place="Theorem 3, proof",
    says="sampling in proportion to the integrand has the least variance, and the integrand is |δ|",
    verdict="holds if the integrand is meant: it is |residual − h| ‖∇h‖, and |δ| has another gradient's size in it",
    uses="replay.td_priority",
)
@given(SEEDS, st.integers(1, 6))
def test_the_integrand_is_the_best_proposal(seed, n):
    """Cauchy–Schwarz: (Σ |f|)² ≤ Σ f²/P · Σ P, with equality just where P ∝ |f|."""
    rng = np.random.default_rng(seed)
    f, P = rng.uniform(0.1, 2, size=n), rng.dirichlet(np.ones(n))
    assert variance(P, f) >= -1e-9
    assert variance(normalise(f), f) == pytest.approx(0, abs=1e-9)
    shows("|δ| = (1, 1), ‖∇‖ = (1, 10): sampling by |δ| has variance 81, by |δ| ‖∇‖ 0")


@control("T3-g")
def test_control_the_td_error_alone_is_not_the_integrand():
    """Negative control: two equal errors, one of which moves the parameters ten times as far."""
    delta, gradient = exact(1, 1), exact(1, 10)
    by_error = normalise(td_priority(delta, 0, 1))
    assert variance(by_error, delta * gradient) == 81
    assert variance(normalise(delta * gradient), delta * gradient) == 0


@claim(
    "T3-h",
    place="Theorem 3, Eqs. 10–11",
    says="the rule of the theorem is that of Eqs. 10 and 11",
    verdict="fails: Eq. 10 adds ε to |δ|, which the theorem drops, so a transition without error has no chance in it",
    uses="replay.td_priority, replay.RecencyReplay.probabilities",
)
def test_the_offset_is_missing_from_the_theorem():
    assert td_priority(0.0, 0.01, 0.6) == pytest.approx(0.0631, abs=1e-4)
    assert td_priority(0.0, 0.0, 0.6) == 0
    assert chance_of_no_error(offset=0.01) > 0.05
    shows("δ = 0, ε = 0.01, γ = 0.6: p^TD = 0.0631 by Eq. 10, 0 in the theorem")


@control("T3-h")
def test_control_without_the_offset_they_agree():
    """Negative control: with the offset taken away a transition without error is never drawn by PER alone."""
    assert chance_of_no_error(offset=0.0) == 0


def chance_of_no_error(offset):
    """P of the one of two transitions whose TD error is 0, by TD error alone (β = 1)."""
    replay = RecencyReplay(2, 1, mix=1.0, priority_offset=offset)
    for delta in (0.0, 1.0):
        replay.update_priorities(np.array([replay.add(0.0, 0, 0.0, 0.0, False)]), np.array([delta]))
    return replay.probabilities()[0]

"""Eqs. 10–11 and the importance weights: what the mixed priorities are, and what they are not."""

from fractions import Fraction as F
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import exact, filled, normalise, with_errors

from gbdqn_ref.replay import (
    RecencyReplay,
    importance_weights,
    mixed_priority,
    td_priority,
    time_priority,
)


@claim("R10")
@given(st.integers(0, 10**6), st.integers(1, 60), st.floats(0, 1), st.floats(0, 2))
def test_eq_10_and_11_are_a_mixture_of_per_and_recency(seed, added, mix, rate):
    """The replay's P is that of Eqs. 10–11, and the mixture of P_TD and P_time by its td_share."""
    replay = filled(RecencyReplay(40, 1, mix=mix, recency_rate=rate), [0] * added)
    n = len(replay)
    delta = np.random.default_rng(seed).normal(size=n)
    replay.update_priorities(np.arange(n), delta)
    p_td = td_priority(delta, replay.priority_offset, replay.priority_exponent)
    p_time = time_priority((added - 1 - np.arange(n)) % 40, rate)
    np.testing.assert_allclose(
        replay.probabilities(), normalise(mixed_priority(p_td, p_time, mix)), rtol=1e-9
    )
    np.testing.assert_allclose(
        replay.probabilities(), two_stages(replay.td_share(), p_td, p_time), rtol=1e-9
    )
    shows("P = λ P_TD + (1 − λ) P_time exactly, λ = β S_TD / (β S_TD + (1 − β) S_time)")


def two_stages(share, p_td, p_time):
    """λ P_TD + (1 − λ) P_time."""
    return share * normalise(p_td) + (1 - share) * normalise(p_time)


@control("R10")
def test_control_mixed_by_the_mix_itself_it_is_another_rule():
    """With λ = β the mixture is not that of Eqs. 10–11, where the two sums differ."""
    replay = with_errors(RecencyReplay(3, 1, mix=0.5, recency_rate=1.0), [1, 2, 3])
    p_td, p_time = replay.tree.leaves[:3], time_priority([2, 1, 0], 1.0)
    np.testing.assert_allclose(
        replay.probabilities(), two_stages(replay.td_share(), p_td, p_time), rtol=1e-9
    )
    assert not np.allclose(replay.probabilities(), two_stages(replay.mix, p_td, p_time))


MIX = 0.5


def recency_shares(rate_of):
    """Recency's share of the draws in growing buffers, β = ½; the rate may depend on N."""
    sizes = (100, 1_000, 10_000)
    replays = [filled(RecencyReplay(n, 1, MIX, rate_of(n)), [0] * n) for n in sizes]
    return sizes, [1 - replay.td_share() for replay in replays]


@claim("R12")
@given(st.integers(0, 10**6), st.integers(1, 60), st.floats(0.001, 2))
def test_in_a_given_buffer_every_balance_has_its_beta(seed, n, rate):
    """λ rises with β, and λ = c at β = c S_time / (c S_time + (1 − c) S_TD)."""
    delta = np.random.default_rng(seed).normal(size=n)
    p_td, p_time = td_priority(delta, 0.01, 0.6).sum(), time_priority(np.arange(n), rate).sum()
    balances = np.linspace(0, 1, 5)
    shares = [
        with_errors(RecencyReplay(n, 1, beta, rate), delta).td_share()
        for beta in balances * p_time / (balances * p_time + (1 - balances) * p_td)
    ]
    assert shares == pytest.approx(balances)
    shows("in a given buffer every share of TD error from 0 to 1 has its β")


@control("R12")
@claim("R12")
def test_the_recency_share_fades_as_the_buffer_fills():
    """S_time ≤ 1 / (1 − e^{−α}) is bounded, and S_TD grows with N."""
    rate = 0.01
    sizes, shares = recency_shares(lambda n: rate)
    assert shares == sorted(shares, reverse=True)
    for n, share in zip(sizes, shares, strict=True):
        assert share < 1 / (n * (1 - np.exp(-rate)))
    shows(
        "β = {}, α = {}: recency has {:.1%} of the draws from {} transitions",
        *(MIX, rate, shares[-1], sizes[-1]),
    )


@claim("R12")
def test_it_does_not_fade_when_the_rate_falls_with_the_buffer():
    """With α = 3/N the share keeps to a constant, so it is the fixed rate that makes it fade."""
    c = 3
    sizes, shares = recency_shares(lambda n: c / n)
    constant = (1 - np.exp(-c)) / c
    np.testing.assert_allclose(shares, constant / (1 + constant), atol=0.005)
    shows("with α = c/N, c = {:d}, {:.3f} and {:.3f} from {} and {}", c, *shares[1:], *sizes[1:])


RECENCY = exact(F(1, 2), 1)  # e^{−α age} of two transitions, the newer one last


def part_of_the_newer(scale, rule):
    """P of the newer of two transitions by a rule of (p^TD, p^time), with |δ| the same for both."""
    return rule(td_priority(exact(scale, scale), 0, 1), RECENCY)[1]


def printed_rule(p_td, p_time):
    """Eqs. 10–11 with β = ½."""
    return normalise(mixed_priority(p_td, p_time, F(MIX)))


@claim("R16")
def test_the_size_of_the_errors_sets_the_recency():
    """|δ| is the same for both, so it says nothing about which to prefer, and yet its size does."""
    scales = (1, 9)
    small, large = (part_of_the_newer(scale, printed_rule) for scale in scales)
    assert small > large > F(1, 2)
    shows(
        "two transitions, β = {:/}, e^{{−α age}} = ({}): P of the newer is {} with |δ| = {} for"
        " both, {} with {}",
        *(MIX, RECENCY, small, scales[0], large, scales[1]),
    )


@control("R16")
@given(st.integers(1, 99), st.fractions(0, 1, max_denominator=9))
def test_control_mixed_after_normalising_the_size_has_no_effect(scale, share):
    """With λ given and each part normalised first the newer one has the same P at every |δ|."""

    def rule(p_td, p_time):
        return two_stages(share, p_td, p_time)

    assert part_of_the_newer(scale, rule) == part_of_the_newer(1, rule)


def weighted_mean(P, f, exponent, normalise_by, batch_size):
    """E Σ w f / Σ 1 over every possible batch of that size, exactly enumerated."""
    total = 0.0
    for batch in product(range(len(P)), repeat=batch_size):
        batch = np.array(batch)
        weight = importance_weights(P[batch], len(P), exponent, normalise_by)
        total += P[batch].prod() * (weight * f[batch]).mean()
    return total


P, f = np.array([0.8, 0.2]), np.array([0.0, 1.0])


@claim("W1")
@pytest.mark.parametrize("batch_size", [1, 3])
def test_importance_weights_are_unbiased_with_exponent_1_and_no_normalisation(batch_size):
    """E_P[w f] is the mean of f, whatever the size of the batch."""
    assert weighted_mean(P, f, 1.0, None, batch_size) == pytest.approx(f.mean(), abs=1e-12)
    shows("every batch enumerated: E[w f] = mean f with exponent 1")


@claim("W1")
def test_with_exponent_a_half_they_are_biased():
    """The usual exponents are below 1."""
    exponent = 0.5
    value = weighted_mean(P, f, exponent, None, 1)
    assert value == pytest.approx(P[1] * (1 / (2 * P[1])) ** exponent)
    values = exponent, value, f.mean(), P, f
    shows("with exponent {:/} the mean is {:.3f}, not {}; P = ({}), f = ({})", *values)


@control("W1")
@pytest.mark.parametrize("batch_size", [1, 3])
def test_control_without_weights_the_mean_is_biased(batch_size):
    """With exponent 0 every weight is 1, and the mean is that under P."""
    assert weighted_mean(P, f, 0.0, None, batch_size) == pytest.approx(P @ f, abs=1e-12)
    assert P @ f != f.mean()


def ratio(batch_size, normalise_by):
    """How the two transitions weigh in the mean of a batch, 1 being unbiased; exponent 1."""
    first, second = (weighted_mean(P, each, 1.0, normalise_by, batch_size) for each in np.eye(2))
    return first / second


@claim("W2")
def test_dividing_by_the_batch_maximum_is_no_mere_scaling():
    """A batch of 1 always has weight 1, so the ratio is that of P; a larger batch keeps most of
    it.
    """
    alone, pair = ratio(1, "batch"), ratio(2, "batch")
    assert alone == pytest.approx(P[0] / P[1]) and alone > pair > 3
    shows(
        "P = ({}), exponent 1: a batch of 1 weighs the two {:.3g} : 1, a batch of 2 {:.3g} : 1,"
        " where {:.3g} : 1 is unbiased",
        *(P, alone, pair, ratio(2, None)),
    )


@control("W2")
@pytest.mark.parametrize("batch_size", [1, 2])
def test_control_without_the_division_the_two_weigh_the_same(batch_size):
    """Without it, or with a fixed divisor, which cancels in the ratio, the two are 1 : 1."""
    assert ratio(batch_size, None) == pytest.approx(1)


def stale_data(mix, is_exponent, rate=0.01):
    """What 900 old transitions have beside 100 new ones of equal |δ|: (of the draws, of the
    weighted loss).
    """
    n = OLD + NEW
    P = filled(RecencyReplay(n, 1, mix=mix, recency_rate=rate), [0] * n).probabilities()
    in_loss = normalise(P * importance_weights(P, n, is_exponent, None))
    return P[:OLD].sum(), in_loss[:OLD].sum()


OLD, NEW = 900, 100


@claim("W3")
def test_correcting_the_bias_undoes_the_priorities():
    """P w is in proportion to P^(1 − exponent); with exponent 1 every transition has the same part
    of the loss.
    """
    rate, exponent, full = 0.01, 0.5, 1
    drawn, halved = stale_data(mix=0, is_exponent=exponent)
    _, corrected = stale_data(mix=0, is_exponent=full)
    old, all = np.exp(-rate * NEW), np.exp(-rate * (OLD + NEW))
    assert drawn == pytest.approx((old - all) / (1 - all))
    old, all = np.sqrt(old), np.sqrt(all)
    assert halved == pytest.approx((old - all) / (1 - all))
    assert corrected == pytest.approx(OLD / (OLD + NEW))
    shows(
        "{} old, {} new, recency alone, α = {}: old data have {:.3f} of the draws, {:.3f} of the"
        " loss with exponent {:/}, {:.3f} with {}",
        *(OLD, NEW, rate, drawn, halved, exponent, corrected, full),
    )


@control("W3")
def test_control_without_the_correction_the_priority_stays():
    """With exponent 0 the part of the loss is that of the draws."""
    drawn, in_loss = stale_data(mix=0, is_exponent=0)
    assert in_loss == pytest.approx(drawn) and drawn < 0.37


@control("W3")
def test_control_without_priorities_there_is_nothing_to_correct():
    """At rate 0 every transition is drawn alike."""
    share = OLD / (OLD + NEW)
    assert stale_data(mix=0, is_exponent=1, rate=0) == pytest.approx((share, share))


def old_parts(mix, is_exponent):
    """The old transition's part of (the draws, the weighted loss), where e^{−α age} = (½, 1) and
    the old one has three times the |δ|.
    """
    replay = with_errors(
        RecencyReplay(
            2, 1, mix, recency_rate=np.log(2), priority_offset=0.0, priority_exponent=1.0
        ),
        DELTA,
    )
    P = replay.probabilities()
    return P[0], normalise(P * importance_weights(P, 2, is_exponent, None))[0]


DELTA, BETAS = (3, 1), (F(0), F(1, 2), F(1))


@claim("W4")
def test_with_a_single_beta_recency_and_correction_exclude_each_other():
    """At β = 0 the draws are by recency alone and w = 1; at β = 1 the correction is full, and P has
    no recency in it.
    """
    drawn, in_loss = zip(*(old_parts(float(beta), float(beta)) for beta in BETAS), strict=True)
    assert drawn[0] == in_loss[0] == pytest.approx(1 / 3)  # of ½ and 1
    assert (drawn[-1], in_loss[-1]) == pytest.approx((DELTA[0] / sum(DELTA), 1 / 2))
    shows(
        "|δ| = ({}), e^{{−α age}} = ({:/}): with β = {} P(1) = {:/}, its part of the loss {:.2f}",
        *(DELTA, time_priority([1, 0], np.log(2)), BETAS, drawn, in_loss),
    )


@control("W4")
def test_control_two_symbols_allow_recency_with_full_correction():
    """With a β each, 0 for the mixture and 1 for the weights, draws by recency alone are corrected
    in full.
    """
    drawn, in_loss = old_parts(0.0, 1.0)
    assert (drawn, in_loss) == pytest.approx((1 / 3, 1 / 2))


OFFSET = 0.01  # ε, the package's


def weights_and_bound(replay, delta, exponent):
    """(P, the weights, (Σp / (N β ε^γ))^b)."""
    n, P = len(replay), replay.probabilities()
    offset, power = replay.priority_offset, replay.priority_exponent
    p_time = time_priority(replay.age(np.arange(n)), replay.recency_rate)
    total = mixed_priority(td_priority(delta, offset, power), p_time, replay.mix).sum()
    bound = (total / (n * replay.mix * td_priority(0, OFFSET, power))) ** exponent
    return P, importance_weights(P, n, exponent, None), bound


@claim("W5")
@given(
    st.integers(0, 10**6),
    st.integers(1, 30),
    st.floats(0.01, 1),
    st.floats(0, 100),
    st.floats(0, 1),
)
def test_the_weights_are_bounded(seed, n, mix, rate, exponent):
    """p ≥ β ε^γ bounds them."""
    delta = np.random.default_rng(seed).standard_cauchy(n)
    replay = with_errors(RecencyReplay(n, 1, mix=mix, recency_rate=rate), delta)
    _, w, bound = weights_and_bound(replay, delta, exponent)
    assert (w <= bound * (1 + 1e-9)).all()
    shows("random buffers with Cauchy TD errors")


@claim("W5")
@given(st.integers(0, 10**6), st.integers(1, 30), st.floats(0, 1))
def test_their_mean_is_at_most_1(seed, n, exponent):
    """E_P[w] = Σ P (1/(N P))^b is 1 at b = 1, and at most 1 below it, as x^b is concave."""
    delta = np.random.default_rng(seed).standard_cauchy(n)
    P = with_errors(RecencyReplay(n, 1), delta).probabilities()
    assert P @ importance_weights(P, n, exponent, None) <= 1 + 1e-9
    full = P @ importance_weights(P, n, 1.0, None)
    assert full == pytest.approx(1)
    shows("E[w] = {:.0f} with b = 1", full)


@claim("W5")
@given(st.integers(1, 30), st.floats(0, 1))
def test_a_uniform_distribution_needs_no_weights(n, exponent):
    """With P = 1/N every weight is 1, whatever the exponent."""
    w = importance_weights(np.full(n, 1 / n), n, exponent, None)
    assert w == pytest.approx(np.ones(n))
    shows("a uniform P gives w = {:.0f}", w[0])


@claim("W5")
@given(st.integers(0, 10**6), st.integers(1, 30), st.floats(0, 1))
def test_divided_by_the_batchs_largest_none_is_above_1(seed, n, exponent):
    """And the largest is 1."""
    P = np.random.default_rng(seed).dirichlet(np.ones(n))
    largest = importance_weights(0.9 * P + 0.1 / n, n, exponent).max()
    assert largest == 1
    shows("divided by the batch's largest w ≤ {:.0f}", largest)


@control("W5")
def test_control_without_an_offset_they_are_not_bounded():
    """With ε = 0 a small |δ| has a weight beyond the bound of ε = 0.01."""
    delta = np.array([1.0, 1e-9])
    replay = with_errors(RecencyReplay(2, 1, mix=1.0, priority_offset=0.0), delta)
    _, w, bound = weights_and_bound(replay, delta, 1.0)
    assert w.max() > 1e3 * bound

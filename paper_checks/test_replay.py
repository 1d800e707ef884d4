"""Eqs. 10–11 and the importance weights: what the mixed priorities are, and what they are not."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.replay import (
    RecencyReplay,
    importance_weights,
    mixed_priority,
    td_priority,
    time_priority,
)


def normalise(p):
    return p / p.sum()


@claim(
    "R10",
    place="Eqs. 10–11",
    says="the sampling rule mixes TD error and recency",
    verdict="holds",
    uses=(
        "replay.RecencyReplay.probabilities, replay.mixed_priority, replay.time_priority,"
        " replay.td_priority"
    ),
)
@given(st.integers(0, 10**6), st.integers(1, 60), st.floats(0, 1), st.floats(0, 2))
def test_eq_10_and_11_are_a_mixture_of_per_and_recency(seed, added, mix, rate):
    """P = λ P_TD + (1 − λ) P_time with λ = β S_TD / (β S_TD + (1 − β) S_time): hence the sampler in
    two stages.
    """
    rng = np.random.default_rng(seed)
    replay = RecencyReplay(40, 1, mix=mix, recency_rate=rate)
    for _ in range(added):
        replay.add(0.0, 0, 0.0, 0.0, False)
    n, delta = len(replay), rng.normal(size=len(replay))
    replay.update_priorities(np.arange(n), delta)
    age = (added - 1 - np.arange(n)) % 40
    p_td = td_priority(delta, replay.priority_offset, replay.priority_exponent)
    p_time = time_priority(age, rate)
    np.testing.assert_allclose(
        replay.probabilities(), normalise(mixed_priority(p_td, p_time, mix)), rtol=1e-9
    )
    share = replay.td_share()
    np.testing.assert_allclose(
        replay.probabilities(), share * normalise(p_td) + (1 - share) * normalise(p_time), rtol=1e-9
    )
    shows("P = λ P_TD + (1 − λ) P_time exactly, λ = β S_TD / (β S_TD + (1 − β) S_time)")


@claim(
    "R12",
    place="section Recency and TD-error",
    says="β sets the balance of recency and TD error",
    verdict="fails: at fixed α and β recency's share of the draws tends to 0 as the buffer fills",
    uses="replay.RecencyReplay.td_share",
)
def test_the_recency_share_fades_as_the_buffer_fills():
    """S_time ≤ 1 / (1 − e^{−α}) is bounded and S_TD grows with N: at fixed α and β the rule tends
    to plain PER.
    """
    shares = []
    for n in (100, 1_000, 10_000):
        replay = RecencyReplay(n, 1, mix=0.5, recency_rate=0.01)
        for _ in range(n):
            replay.add(0.0, 0, 0.0, 0.0, False)
        shares.append(1 - replay.td_share())
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] < 0.011
    shows("β = 0.5, α = 0.01: recency has less than 1.1 % of the draws from 10,000 transitions")


@control("R10", "R12")
def test_control_it_does_not_fade_when_the_rate_falls_with_the_buffer():
    """Negative control: with α = 3/N the share keeps to a constant, so it is the fixed rate that
    makes it fade.
    """
    shares = []
    for n in (100, 1_000, 10_000):
        replay = RecencyReplay(n, 1, mix=0.5, recency_rate=3 / n)
        for _ in range(n):
            replay.add(0.0, 0, 0.0, 0.0, False)
        shares.append(1 - replay.td_share())
    np.testing.assert_allclose(
        shares, (1 - np.exp(-3)) / 3 / (1 + (1 - np.exp(-3)) / 3), atol=0.005
    )


def weighted_mean(P, f, exponent, normalise_by, batch_size):
    """E Σ w f / Σ 1 over every possible batch of that size, exactly enumerated."""
    total = 0.0
    for batch in product(range(len(P)), repeat=batch_size):
        batch = np.array(batch)
        weight = importance_weights(P[batch], len(P), exponent, normalise_by)
        total += P[batch].prod() * (weight * f[batch]).mean()
    return total


@claim(
    "W1",
    place="section Recency and TD-error, importance weights",
    says="the importance weights correct the bias of prioritized sampling",
    verdict="holds if their exponent is 1 and they are not normalised",
    uses="replay.importance_weights",
)
def test_importance_weights_are_unbiased_with_exponent_1_and_no_normalisation():
    """E_P[w f] = mean f for every f, here f = (0, 1), P = (4/5, 1/5); true mean 1/2."""
    P, f = np.array([0.8, 0.2]), np.array([0.0, 1.0])
    assert weighted_mean(P, f, 1.0, None, 1) == pytest.approx(0.5, abs=1e-12)
    assert weighted_mean(P, f, 1.0, None, 3) == pytest.approx(0.5, abs=1e-12)
    shows(
        "every batch enumerated: E[w f] = mean f with exponent 1; with ½ 0.316 for 0.5, P = (0.8,"
        " 0.2), f = (0, 1)"
    )


@control("W1")
@pytest.mark.parametrize(("exponent", "value"), [(0.0, 0.2), (0.5, 0.2 * 2.5**0.5)])
def test_control_a_smaller_exponent_is_biased(exponent, value):
    """Negative control: the claim "to correct for the bias" fails for every exponent below 1."""
    P, f = np.array([0.8, 0.2]), np.array([0.0, 1.0])
    assert weighted_mean(P, f, exponent, None, 1) == pytest.approx(value, abs=1e-12)


@claim(
    "W2",
    place="section Recency and TD-error, importance weights",
    says="dividing the weights by their largest only scales the update",
    verdict="fails: by the batch's largest it brings the bias back",
    uses="replay.importance_weights",
)
def test_dividing_by_the_batch_maximum_is_no_mere_scaling():
    """A batch of 1 always has weight 1: the ratio of the two states stays 4 : 1, where a scaling
    would leave 1 : 1.
    """
    P = np.array([0.8, 0.2])
    first, second = (weighted_mean(P, np.eye(2)[i], 1.0, "batch", 1) for i in (0, 1))
    assert first / second == pytest.approx(4)
    first, second = (weighted_mean(P, np.eye(2)[i], 1.0, "batch", 2) for i in (0, 1))
    assert first / second == pytest.approx(3.4)
    shows(
        "P = (0.8, 0.2), exponent 1: a batch of 1 weighs the two 4 : 1, a batch of 2 3.4 : 1, where"
        " 1 : 1 is unbiased"
    )


@control("W2")
def test_control_a_fixed_divisor_does_only_scale():
    """Negative control: the largest of the whole buffer divides the unbiased mean by 2.5, for both
    f.
    """
    P = np.array([0.8, 0.2])
    largest = importance_weights(P, 2, 1.0, None).max()
    for i in (0, 1):
        assert weighted_mean(P, np.eye(2)[i], 1.0, None, 2) / largest == pytest.approx(0.5 / 2.5)


def stale_data(mix, is_exponent, rate=0.01):
    """What 900 old transitions have beside 100 new ones of equal |δ|: (of the draws, of the
    weighted loss).
    """
    replay = RecencyReplay(1000, 1, mix=mix, recency_rate=rate)
    for _ in range(1000):
        replay.add(0.0, 0, 0.0, 0.0, False)
    P = replay.probabilities()
    in_loss = normalise(P * importance_weights(P, 1000, is_exponent, None))
    return P[:900].sum(), in_loss[:900].sum()


@claim(
    "W3",
    place="section Recency and TD-error",
    says="the data from after a drift are prioritised, and the bias of doing so is corrected",
    verdict=(
        "fails: the one undoes the other, and in the loss P^(1 − exponent) is left of the"
        " priorities"
    ),
    uses="replay.RecencyReplay.probabilities, replay.importance_weights",
)
def test_correcting_the_bias_undoes_the_priorities():
    """P w is in proportion to P^(1 − exponent); with exponent 1 every transition has the same part
    of the loss.
    """
    drawn, halved = stale_data(mix=0, is_exponent=0.5)
    _, corrected = stale_data(mix=0, is_exponent=1)
    assert drawn == pytest.approx((np.exp(-1) - np.exp(-10)) / (1 - np.exp(-10)))
    assert halved == pytest.approx((np.exp(-0.5) - np.exp(-5)) / (1 - np.exp(-5)))
    assert corrected == pytest.approx(0.9)
    shows(
        f"900 old, 100 new, recency alone, α = 0.01: old data have {drawn:.3f} of the draws, "
        f"{halved:.3f} of the loss with exponent ½, {corrected:.3f} with 1"
    )


@control("W3")
def test_control_there_is_a_conflict_only_with_both():
    """Negative control: without the correction the priority stays; without priorities there is
    nothing to correct.
    """
    drawn, in_loss = stale_data(mix=0, is_exponent=0)
    assert in_loss == pytest.approx(drawn) and drawn < 0.37
    assert stale_data(mix=0, is_exponent=1, rate=0) == pytest.approx((0.9, 0.9))


@claim(
    "W4",
    place="section Recency and TD-error, importance weights, Eq. 10",
    says="one β is the mixing coefficient and the exponent of the weights",
    verdict=(
        "ambiguous: were it one, all recency would go without correction and all correction without"
        " recency"
    ),
    uses="replay.RecencyReplay.probabilities, replay.importance_weights",
)
def test_with_a_single_beta_recency_and_correction_exclude_each_other():
    """β = 0: draws by recency alone, w = 1. β = 1: the weights correct in full, and P has no
    recency in it.
    """
    drawn, in_loss = [], []
    for beta in (0, 0.5, 1):
        replay = RecencyReplay(
            2, 1, mix=beta, recency_rate=np.log(2), priority_offset=0.0, priority_exponent=1.0
        )
        for _ in range(2):
            replay.add(0.0, 0, 0.0, 0.0, False)
        replay.update_priorities(
            np.arange(2), np.array([3.0, 1.0])
        )  # the old one has the larger |δ|
        P = replay.probabilities()
        drawn.append(P[0])
        in_loss.append(normalise(P * importance_weights(P, 2, beta, None))[0])
    assert drawn == pytest.approx([1 / 3, 7 / 11, 3 / 4])
    assert in_loss == pytest.approx([1 / 3, 1 / (1 + np.sqrt(4 / 7)), 1 / 2])
    shows(
        "|δ| = (3, 1), e^{−α age} = (½, 1): with β = 0, ½, 1 P(1) = 1/3, 7/11, 3/4, its part of the"
        " loss 1/3, 0.57, ½"
    )


@control("W4")
def test_control_two_symbols_allow_recency_with_full_correction():
    """Negative control: with a β each, here 0 and 1, draws by recency alone are corrected in
    full.
    """
    drawn, in_loss = stale_data(mix=0, is_exponent=1)
    assert drawn < 0.37 and in_loss == pytest.approx(0.9)


@claim(
    "W5",
    place="section Recency and TD-error, importance weights",
    says=(
        "the weights are bounded: w ≤ (Σp / (N β ε^γ))^b with b the exponent, their mean is 1 with"
        " b = 1, less before"
    ),
    verdict="holds if β > 0 and ε > 0",
    uses="replay.RecencyReplay.probabilities, replay.importance_weights, replay.td_priority",
)
@given(
    st.integers(0, 10**6),
    st.integers(1, 30),
    st.floats(0.01, 1),
    st.floats(0, 100),
    st.floats(0, 1),
)
def test_the_weights_are_bounded(seed, n, mix, rate, exponent):
    """p ≥ β ε^γ bounds them; E_P[w] = Σ P (1/(N P))^b is 1 at b = 1, and at most 1 below it, as x^b
    is concave.
    """
    replay = RecencyReplay(n, 1, mix=mix, recency_rate=rate)
    for _ in range(n):
        replay.add(0.0, 0, 0.0, 0.0, False)
    delta = np.random.default_rng(seed).standard_cauchy(n)
    replay.update_priorities(np.arange(n), delta)
    P = replay.probabilities()
    offset, power = replay.priority_offset, replay.priority_exponent
    total = mixed_priority(
        td_priority(delta, offset, power), time_priority(replay.age(np.arange(n)), rate), mix
    ).sum()
    w = importance_weights(P, n, exponent, None)
    assert (w <= (total / (n * mix * td_priority(0, offset, power))) ** exponent * (1 + 1e-9)).all()
    assert P @ w <= 1 + 1e-9
    assert P @ importance_weights(P, n, 1.0, None) == pytest.approx(1)
    assert importance_weights(P, n, exponent).max() == 1
    assert importance_weights(np.full(n, 1 / n), n, exponent, None) == pytest.approx(np.ones(n))
    shows(
        "random buffers with Cauchy TD errors; a uniform P gives w = 1; divided by the batch's"
        " largest w ≤ 1"
    )


@control("W5")
def test_control_without_an_offset_they_are_not_bounded():
    """Negative control: with ε = 0 a |δ| of 10^−9 beside 1 has w = 5 · 10⁸; and below b = 1 the
    mean is below 1.
    """
    P = normalise(td_priority(np.array([1.0, 1e-9]), 0, 1))
    assert importance_weights(P, 2, 1.0, None)[1] == pytest.approx(5e8)
    biased = np.array([0.8, 0.2])
    assert biased @ importance_weights(biased, 2, 0.5, None) == pytest.approx(0.9487, abs=5e-5)

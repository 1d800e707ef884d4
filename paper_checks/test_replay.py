"""Eqs. 10–11 and the importance weights: what the mixed priorities are, and what they are not."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.replay import RecencyReplay, importance_weights, mixed_priority, td_priority, time_priority


def normalise(p):
    return p / p.sum()


@claim(
    "R10",
    place="Eqs. 10–11",
    says="the sampling rule mixes TD error and recency",
    verdict="holds",
    uses="replay.RecencyReplay.probabilities, replay.mixed_priority, replay.time_priority, replay.td_priority",
)
@given(st.integers(0, 10**6), st.integers(1, 60), st.floats(0, 1), st.floats(0, 2))
def test_eq_10_and_11_are_a_mixture_of_per_and_recency(seed, added, mix, rate):
    """P = λ P_TD + (1 − λ) P_time with λ = β S_TD / (β S_TD + (1 − β) S_time): hence the sampler in two stages."""
    rng = np.random.default_rng(seed)
    replay = RecencyReplay(40, 1, mix=mix, recency_rate=rate)
    for _ in range(added):
        replay.add(0.0, 0, 0.0, 0.0, False)
    n, delta = len(replay), rng.normal(size=len(replay))
    replay.update_priorities(np.arange(n), delta)
    age = (added - 1 - np.arange(n)) % 40
    p_td = td_priority(delta, replay.priority_offset, replay.priority_exponent)
    p_time = time_priority(age, rate)
    np.testing.assert_allclose(replay.probabilities(), normalise(mixed_priority(p_td, p_time, mix)), rtol=1e-9)
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
    """S_time ≤ 1 / (1 − e^{−α}) is bounded and S_TD grows with N: at fixed α and β the rule tends to plain PER."""
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
    """Negative control: with α = 3/N the share keeps to a constant, so it is the fixed rate that makes it fade."""
    shares = []
    for n in (100, 1_000, 10_000):
        replay = RecencyReplay(n, 1, mix=0.5, recency_rate=3 / n)
        for _ in range(n):
            replay.add(0.0, 0, 0.0, 0.0, False)
        shares.append(1 - replay.td_share())
    np.testing.assert_allclose(shares, (1 - np.exp(-3)) / 3 / (1 + (1 - np.exp(-3)) / 3), atol=0.005)


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
    place="section Importance Sampling",
    says="the importance weights correct the bias of prioritized sampling",
    verdict="holds if their exponent is 1 and they are not normalised",
    uses="replay.importance_weights",
)
def test_importance_weights_are_unbiased_with_exponent_1_and_no_normalisation():
    """E_P[w f] = mean f for every f, here f = (0, 1), P = (4/5, 1/5); true mean 1/2."""
    P, f = np.array([0.8, 0.2]), np.array([0.0, 1.0])
    assert weighted_mean(P, f, 1.0, None, 1) == pytest.approx(0.5, abs=1e-12)
    assert weighted_mean(P, f, 1.0, None, 3) == pytest.approx(0.5, abs=1e-12)
    shows("every batch enumerated: E[w f] = mean f with exponent 1; with ½ 0.316 for 0.5, P = (0.8, 0.2), f = (0, 1)")


@control("W1")
@pytest.mark.parametrize(("exponent", "value"), [(0.0, 0.2), (0.5, 0.2 * 2.5**0.5)])
def test_control_a_smaller_exponent_is_biased(exponent, value):
    """Negative control: the claim "to correct for the bias" fails for every exponent below 1."""
    P, f = np.array([0.8, 0.2]), np.array([0.0, 1.0])
    assert weighted_mean(P, f, exponent, None, 1) == pytest.approx(value, abs=1e-12)


@claim(
    "W2",
    place="section Importance Sampling",
    says="dividing the weights by their largest only scales the update",
    verdict="fails: by the batch's largest it brings the bias back",
    uses="replay.importance_weights",
)
def test_dividing_by_the_batch_maximum_is_no_mere_scaling():
    """A batch of 1 always has weight 1: the ratio of the two states stays 4 : 1, where a scaling would leave 1 : 1."""
    P = np.array([0.8, 0.2])
    first, second = (weighted_mean(P, np.eye(2)[i], 1.0, "batch", 1) for i in (0, 1))
    assert first / second == pytest.approx(4)
    first, second = (weighted_mean(P, np.eye(2)[i], 1.0, "batch", 2) for i in (0, 1))
    assert first / second == pytest.approx(3.4)
    shows(
        "P = (0.8, 0.2), exponent 1: a batch of 1 weighs the two 4 : 1, a batch of 2 3.4 : 1, where 1 : 1 is unbiased"
    )


@control("W2")
def test_control_a_fixed_divisor_does_only_scale():
    """Negative control: the largest of the whole buffer divides the unbiased mean by 2.5, for both f."""
    P = np.array([0.8, 0.2])
    largest = importance_weights(P, 2, 1.0, None).max()
    for i in (0, 1):
        assert weighted_mean(P, np.eye(2)[i], 1.0, None, 2) / largest == pytest.approx(0.5 / 2.5)


@claim(
    "W3",
    place="section Importance Sampling",
    says="one may favour recent transitions and then correct the sampling bias by importance weights",
    verdict="ambiguous: full correction takes all of the recency back, half of it half",
    uses="replay.importance_weights, replay.time_priority",
)
def test_full_correction_undoes_recency():
    """900 old transitions and 100 new ones, by recency alone at α = 0.01: what part of the update the old ones get."""
    P = normalise(time_priority(np.arange(1000), 0.01))
    old = np.arange(1000) >= 100
    parts = [normalise(P * importance_weights(P, 1000, exponent, None))[old].sum() for exponent in (0, 0.5, 1)]
    assert parts == pytest.approx([0.3679, 0.6039, 0.9000], abs=1e-4)
    shows("900 old of 1,000, α = 0.01: 0.3679 of the draws are old, of the update 0.6039 at exponent ½, 0.9000 at 1")


@control("W3")
def test_control_without_recency_there_is_nothing_to_undo():
    """Negative control: at α = 0 the old ones get nine tenths, whatever the exponent."""
    P = normalise(time_priority(np.arange(1000), 0.0))
    for exponent in (0, 0.5, 1):
        assert normalise(P * importance_weights(P, 1000, exponent, None))[100:].sum() == pytest.approx(0.9)


@claim(
    "W4",
    place="section Importance Sampling",
    says="β is the exponent of the importance weights and the mixing coefficient of Eq. 10",
    verdict="ambiguous: one letter for two; taken as one number, unbiased weights and recency exclude each other",
    uses="replay.importance_weights, replay.mixed_priority",
)
def test_one_beta_for_both_leaves_no_choice():
    """β = 1 is unbiased and has no recency; β = 0 is recency alone, and its weights correct nothing."""
    p_td, p_time = np.array([1.0, 3.0]), np.array([0.5, 1.0])
    assert (mixed_priority(p_td, p_time, 1.0) == p_td).all()
    assert (mixed_priority(p_td, p_time, 0.0) == p_time).all()
    assert (importance_weights(normalise(p_time), 2, 0.0, None) == 1).all()
    shows("β = 1: p = p^TD and full correction; β = 0: p = p^time and none. The code has mix and is_exponent")


@control("W4")
def test_control_two_numbers_can_have_both():
    """Negative control: half of the recency and full correction, as two parameters allow."""
    p_td, p_time = np.array([1.0, 3.0]), np.array([0.5, 1.0])
    P = normalise(mixed_priority(p_td, p_time, 0.5))
    assert (normalise(p_td) != P).all()
    assert (P * importance_weights(P, 2, 1.0, None)).tolist() == pytest.approx([0.5, 0.5])


@claim(
    "W5",
    place="section Importance Sampling",
    says="the importance weights stay bounded",
    verdict="holds if ε > 0: w ≤ (Σp / (N p_min))^β, and p ≥ mix · ε^γ",
    uses="replay.importance_weights, replay.RecencyReplay.probabilities, replay.td_priority",
)
@given(st.integers(0, 10**6), st.integers(1, 40), st.floats(0.01, 1), st.floats(0, 1))
def test_the_weights_are_bounded(seed, n, mix, exponent):
    """The least priority is that of an old transition without error, β ε^γ; with exponent 1 the weights average 1."""
    rng = np.random.default_rng(seed)
    replay = RecencyReplay(n, 1, mix=mix, recency_rate=0.1)
    for _ in range(n):
        replay.add(0.0, 0, 0.0, 0.0, False)
    replay.update_priorities(np.arange(n), rng.normal(size=n) * rng.integers(2, size=n))
    P = replay.probabilities()
    total = mixed_priority(replay.tree.total(), replay.time_total(), mix)
    least = mix * td_priority(0.0, replay.priority_offset, replay.priority_exponent)
    weights = importance_weights(P, n, exponent, None)
    assert weights.max() <= (total / (n * least)) ** exponent * (1 + 1e-9)
    assert (P * importance_weights(P, n, 1.0, None)).sum() == pytest.approx(1, rel=1e-9)
    shows("w ≤ (Σp / (N β ε^γ))^β on random buffers; E[w] = 1 at exponent 1; all weights 1 where P is uniform")


@control("W5")
def test_control_without_the_offset_a_weight_has_no_bound():
    """Negative control: a priority of 10⁻³⁰⁰ in place of ε^γ gives a weight of about that much above the other."""
    P = normalise(np.array([1e-300, 1.0]))
    assert importance_weights(P, 2, 1.0, None).max() > 1e299

"""What the priorities do to the data: which transitions are drawn as a drift passes, and what that biases."""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.bellman import td_target
from gbdqn_ref.drift import make
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.replay import (
    ProportionalReplay,
    RecencyReplay,
    importance_weights,
    td_priority,
    time_priority,
)
from gbdqn_ref.tabular import MDP
from gbdqn_ref.train import Config

SEEDS = st.integers(0, 10**6)
OFFSET, EXPONENT = 0.01, 0.6


def normalise(p):
    return p / p.sum()


def loops(rewards, gamma):
    """One state whose actions all stay in it, for these rewards."""
    return MDP(np.full((1, len(rewards), 1), F(1)), np.array([[F(r) for r in rewards]]), gamma)


def filled(replay, n):
    for _ in range(n):
        replay.add(0.0, 0, 0.0, 0.0, False)
    return replay


@claim(
    "R1",
    place="section Replay",
    says="one-step Q-learning needs no correction for the behaviour that made the data",
    verdict="holds if Q is fixed and the MDP stands still: E[y | s, a] = 𝒯Q(s, a) whoever chose a",
    uses="bellman.td_target, tabular.MDP.bellman",
)
@given(SEEDS, st.floats(0, 0.99))
def test_the_expected_target_is_the_backup(seed, gamma):
    """y depends on (s, a) and on where the world leads, not on how likely a was: no behaviour occurs in the sum."""
    rng = np.random.default_rng(seed)
    mdp = MDP(rng.dirichlet(np.ones(3), size=(3, 2)), rng.normal(size=(3, 2)), gamma)
    Q = rng.normal(size=(3, 2))
    for s, a in np.ndindex(3, 2):
        y = td_target(np.full(3, mdp.r[s, a]), np.zeros(3, bool), Q, gamma)  # for each next state
        assert mdp.P[s, a] @ y == pytest.approx(mdp.bellman(Q)[s, a], abs=1e-12)
    shows("Σ P(s′|s, a) y = 𝒯Q(s, a) on random MDPs; the behaviour policy does not occur in it")


@claim(
    "R2",
    place="section Replay",
    says="since it is off-policy, learning stays unbiased",
    verdict="fails: data of two worlds, the maximum, and priorities by |δ| each bias it",
    uses="replay.td_priority, replay.importance_weights, tabular.MDP",
)
def test_three_biases():
    """(i) half the buffer is old; (ii) the max over noise; (iii) rare large errors are drawn more often."""
    assert fitted_to_two_worlds(share_of_old=F(1, 2)) == 5
    assert np.mean([max(pair) for pair in ((1, 1), (1, -1), (-1, 1), (-1, -1))]) == 0.5
    assert fitted_by_priority(exponent=0.0) == pytest.approx(2.019, abs=1e-3)
    assert fitted_by_priority(exponent=0.5) == pytest.approx(1.556, abs=1e-3)
    shows("truth 10: 5 with half old data; max of ±1 noise: ½; y = 10 or 0 (1 : 9), truth 1: 2.019 drawn by |δ|")


def fitted_to_two_worlds(share_of_old):
    """One loop, r 0 → 1 at γ = 9/10: the fixed point of Q = Σ share · (r + γQ), which is 10 in the new world."""
    mixed_reward = share_of_old * 0 + (1 - share_of_old) * 1
    Q = mixed_reward / (1 - F(9, 10))
    old, new = (loops((r,), F(9, 10)).residual(np.array([[Q]]))[0, 0] for r in (0, 1))
    assert share_of_old * old + (1 - share_of_old) * new == 0  # where the average residual is 0, learning stands still
    return Q


def fitted_by_priority(exponent):
    """Where a constant c rests that is fitted to y = 10 (one in ten) or 0, drawn by |y − c|, with weights."""
    y, c = np.array([10.0] + [0.0] * 9), 1.0
    for _ in range(2000):
        P = normalise(td_priority(y - c, OFFSET, EXPONENT))
        weight = P * importance_weights(P, 10, exponent, None)
        c += 0.1 * (weight @ (y - c) / weight.sum())
    return c


@control("R1", "R2")
def test_control_one_world_no_noise_and_full_correction_have_no_bias():
    """Negative control: without old data 10, with exponent 1 the true mean 1."""
    assert fitted_to_two_worlds(share_of_old=F(0)) == 10
    assert fitted_by_priority(exponent=1.0) == pytest.approx(1, abs=1e-6)


@claim(
    "R3",
    place="section Replay",
    says="the priorities emphasise transitions on which the ensemble does well",
    verdict="fails: they grow with |δ|, so what it predicts worst is drawn most, as the section says further down",
    uses="replay.td_priority",
)
@given(st.floats(0, 100), st.floats(0.001, 100))
def test_the_priority_grows_with_the_error(delta, more):
    assert td_priority(delta + more, OFFSET, EXPONENT) > td_priority(delta, OFFSET, EXPONENT)
    shows("p^TD increases with |δ|: 0.063 for δ = 0, 1.006 for 1, 3.984 for 10 (ε = 0.01, γ = 0.6)")


@control("R3")
def test_control_the_figures():
    """Negative control: the three figures, and that the sign of δ makes no difference."""
    assert td_priority(np.array([0.0, 1.0, 10.0]), OFFSET, EXPONENT) == pytest.approx([0.0631, 1.006, 3.984], abs=1e-3)
    assert td_priority(-2.0, OFFSET, EXPONENT) == td_priority(2.0, OFFSET, EXPONENT)


def stale_share(old_delta, new_delta, new=1_000, old=10_000):
    """The part of the draws that goes to transitions from before the drift, α = 0.01, β = ½."""
    replay = filled(RecencyReplay(old + new, 1, mix=0.5, recency_rate=0.01, priority_offset=OFFSET), old + new)
    replay.update_priorities(np.arange(old), np.full(old, float(old_delta)))
    replay.update_priorities(np.arange(old, old + new), np.full(new, float(new_delta)))
    return replay.probabilities()[:old].sum()


@claim(
    "R4",
    place="section Replay",
    says="data from before a drift have a large error, those from after it a small one",
    verdict="fails: at the drift it is the other way round; so only once Q has adapted, and then PER draws the old",
    uses="replay.RecencyReplay.probabilities",
)
def test_stale_data_draw_the_sampler_back_once_q_has_adapted():
    """Q = Q*_old has δ = 0 on every old transition; Q = Q*_new on every new one, and the old ones stand out."""
    before, after = stale_share(0, 1), stale_share(1, 0)
    assert (before, after) == (pytest.approx(0.363, abs=1e-3), pytest.approx(0.984, abs=1e-3))
    shows("10,000 old, 1,000 new: 0.363 of the draws are old just after the drift, 0.984 once Q has adapted")


@control("R4")
def test_control_by_recency_alone_old_data_fade_all_the_same():
    """Negative control: without p^TD, a thousand transitions later the old ones have e^{−10} of the draws."""
    replay = filled(RecencyReplay(11_000, 1, mix=0.0, recency_rate=0.01), 11_000)
    assert replay.probabilities()[:10_000].sum() == pytest.approx(np.exp(-10), rel=1e-3)


@claim(
    "R5",
    place="section Recency and TD-error",
    says="δ_i measures what the learner can still improve, and changes as it learns",
    verdict="fails: δ_i = y_i − Q_{m−1} has no h_m in it, so it stands still, also where h_m has learnt all there is",
    uses="replay.td_priority",
)
def test_priority_is_not_what_is_left_to_learn():
    """Residuals (5, 1), h = (5, 0): the first is learnt, and is drawn five times as often as the second."""
    residual, h = np.array([5.0, 1.0]), np.array([5.0, 0.0])
    assert normalise(td_priority(residual, 0, 1)).tolist() == [5 / 6, 1 / 6]
    assert normalise(td_priority(residual - h, 0, 1)).tolist() == [0, 1]
    shows("residuals (5, 1), h = (5, 0): P = (5/6, 1/6) where all that is left is in the second")


@control("R5")
def test_control_before_the_learner_knows_anything_the_two_agree():
    """Negative control: with h = 0 the priority is what is left."""
    residual = np.array([5.0, 1.0])
    assert (td_priority(residual, 0, 1) == td_priority(residual - 0, 0, 1)).all()


@claim(
    "R6",
    place="section Recency and TD-error",
    says="p^TD = (|δ| + ε)^γ is a priority: positive, even in δ, growing with |δ|",
    verdict="holds",
    uses="replay.td_priority",
)
@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1), st.floats(0, 1))
def test_the_td_priority(delta, offset, exponent):
    assert td_priority(delta, offset, exponent) == td_priority(-delta, offset, exponent)
    assert td_priority(delta, offset, exponent) >= offset**exponent > 0
    shows("p^TD(δ) = p^TD(−δ) ≥ ε^γ > 0")


@claim(
    "R7",
    place="section Recency and TD-error",
    says="sampling is proportional to the magnitude of the TD error",
    verdict="holds if γ = 1 and ε = 0; else to a power of it",
    uses="replay.td_priority, replay.ProportionalReplay.probabilities",
)
def test_proportional_only_with_exponent_1():
    assert by_error((1.0, 2.0), offset=0.0, exponent=1.0) == pytest.approx([1 / 3, 2 / 3])
    assert by_error((1.0, 2.0), offset=0.0, exponent=0.6)[1] == pytest.approx(0.6025, abs=1e-4)
    shows("|δ| = (1, 2): P = (1/3, 2/3) with γ = 1, ε = 0; (0.3975, 0.6025) with γ = 0.6")


def by_error(deltas, offset, exponent):
    replay = filled(ProportionalReplay(len(deltas), 1, priority_offset=offset, priority_exponent=exponent), len(deltas))
    replay.update_priorities(np.arange(len(deltas)), np.array(deltas))
    return replay.probabilities().tolist()


@control("R6", "R7")
def test_control_with_the_exponent_0_the_error_makes_no_difference():
    """Negative control: γ = 0 is uniform sampling, and ε = 0 lets a transition without error fall out altogether."""
    assert by_error((1.0, 2.0), offset=0.0, exponent=0.0) == [0.5, 0.5]
    assert by_error((0.0, 2.0), offset=0.0, exponent=0.6) == [0.0, 1.0]


@claim(
    "R8",
    place="section Recency and TD-error, Algorithm 1",
    says="p^time = e^{−α(T − t)} lies in (0, 1] and decays with age",
    verdict="holds if t counts on one clock; Algorithm 1 stores the step of the episode, by which old data look new",
    uses="replay.time_priority, replay.RecencyReplay.age",
)
@given(st.floats(0, 0.1), st.integers(0, 5_000), st.integers(1, 1_000))
def test_recency_decays_on_one_clock(rate, age, more):
    assert 0 < time_priority(age + more, rate) <= time_priority(age, rate) <= 1
    assert float(np.exp(-0.01 * (1 - 500))) == pytest.approx(146.9, abs=0.1)
    shows("step 500 of an earlier episode seen at step 1 of the next: e^{0.01 · 499} = 146.9 > 1")


@control("R8")
def test_control_ages_are_counted_across_episodes():
    """Negative control: in the package age counts transitions, so it is never negative and no priority exceeds 1."""
    replay = filled(RecencyReplay(8, 1), 20)
    ages = replay.age(np.arange(8))
    assert sorted(ages) == list(range(8)) and (time_priority(ages, 0.01) <= 1).all()


@claim(
    "R9",
    place="section Recency and TD-error",
    says="a larger α emphasises recent transitions more",
    verdict="fails: it does so for p^time alone; of the mixture a large α leaves the newest one only, hence less",
    uses="replay.RecencyReplay.probabilities",
)
def test_a_larger_rate_can_mean_less_recency():
    masses = [newest_ten(rate, mix=0.5) for rate in (0.001, 0.1, 10.0)]
    assert masses == pytest.approx([0.01222, 0.01647, 0.01099], abs=1e-5)
    shows("1,000 transitions with p^TD = 1, β = ½: the newest ten have 0.01222, 0.01647, 0.01099 at α = 0.001, 0.1, 10")


def newest_ten(rate, mix):
    return filled(RecencyReplay(1_000, 1, mix=mix, recency_rate=rate), 1_000).probabilities()[-10:].sum()


@control("R9")
def test_control_of_recency_alone_it_is_true():
    """Negative control: without p^TD the mass on the newest ten does grow with α."""
    masses = [newest_ten(rate, mix=0.0) for rate in (0.0, 0.001, 0.1, 10.0)]
    assert masses == sorted(masses) and masses[0] == pytest.approx(0.01)


@claim(
    "R11",
    place="Eq. 11",
    says="P(i) = p_i / Σ p is a distribution",
    verdict="holds if some priority is positive: with ε = 0, β = 1 and no error anywhere it is 0/0",
    uses="replay.RecencyReplay.probabilities, replay.mixed_priority",
)
@given(SEEDS, st.integers(1, 30), st.floats(0, 1))
def test_the_probabilities_sum_to_1(seed, n, mix):
    replay = filled(RecencyReplay(30, 1, mix=mix, recency_rate=0.1), n)
    replay.update_priorities(np.arange(n), np.random.default_rng(seed).normal(size=n))
    P = replay.probabilities()
    assert P.sum() == pytest.approx(1, abs=1e-12) and (P > 0).all()
    shows("Σ P = 1 and P > 0 on random buffers; all |δ| = 0, ε = 0, β = 1: refused, since it is 0/0")


@control("R11")
def test_control_where_all_priorities_are_0_there_is_none():
    replay = filled(RecencyReplay(3, 1, mix=1.0, priority_offset=0.0), 3)
    replay.update_priorities(np.arange(3), np.zeros(3))
    with pytest.raises(ValueError, match="every priority is 0"):
        replay.probabilities()


@claim(
    "R13",
    place="section Replay Buffer, Algorithm 1, line 11",
    says="the priority with which a transition enters",
    verdict="ambiguous: the text says the largest so far, Algorithm 1 that of its own TD error",
    uses="replay.ProportionalReplay.add, replay.td_priority",
)
def test_the_largest_priority_is_not_its_own():
    """A transition with δ = 0 after one with |δ| = 9: drawn as often as that one, or a 59th as often."""
    replay = filled(ProportionalReplay(2, 1, priority_offset=OFFSET, priority_exponent=EXPONENT), 1)
    replay.update_priorities(np.array([0]), np.array([9.0]))
    replay.add(0.0, 0, 0.0, 0.0, False)
    assert replay.probabilities().tolist() == [0.5, 0.5]
    own = normalise(td_priority(np.array([9.0, 0.0]), OFFSET, EXPONENT))
    assert own[0] / own[1] == pytest.approx(59.2, abs=0.1)
    shows("δ = 0 after |δ| = 9: odds 1 : 1 by the text, 59 : 1 by Algorithm 1 (ε = 0.01, γ = 0.6); D4 is the text's")


@control("R13")
def test_control_if_its_error_is_the_largest_both_agree():
    """Negative control: a transition whose |δ| is the largest so far enters with the same priority either way."""
    replay = filled(ProportionalReplay(2, 1, priority_offset=OFFSET, priority_exponent=EXPONENT), 1)
    replay.update_priorities(np.array([0]), np.array([9.0]))
    assert replay.max_priority == td_priority(9.0, OFFSET, EXPONENT)


@claim(
    "R14",
    place="section Algorithm, Algorithm 1, line 18",
    says="when the stored priorities are renewed",
    verdict="ambiguous: before the step in Algorithm 1, after it in the text; the same, since δ_i has no h_m in it",
    uses="gbdqn.GBDQN.learn",
)
def test_before_or_after_the_step_gives_the_same_priorities():
    """An update of a frozen-target learner changes θ_m, and no δ: the priorities of two updates are those of one."""
    before, after = delta_of_two_updates("frozen")
    np.testing.assert_array_equal(before, after)
    shows("target frozen: the same batch has the same δ before and after the step, to the bit")


@control("R14")
def test_control_with_a_live_target_the_order_matters():
    """Negative control: where h_m counts already, the step changes δ."""
    before, after = delta_of_two_updates("live")
    assert (before != after).any()


def delta_of_two_updates(target):
    """δ of one transition, the only one there is, in two updates after a drift."""
    config = Config(hidden=[8], batch_size=2, capacity=4, target=target, replay="uniform", lr=0.1)
    agent = GBDQN(2, 2, config, np.random.default_rng(0))
    agent.on_drift("drift")
    agent.observe(np.ones(2, np.float32), 0, 1.0, np.zeros(2, np.float32), False)
    return agent.learn(), agent.learn()


@claim(
    "R15",
    place="section Replay Buffer",
    says="done says that the goal was reached",
    verdict="fails: in CartPole and Hopper it says that the agent fell, and a time limit is neither",
    uses="drift.make, bellman.td_target",
)
def test_done_is_a_failure_on_cartpole():
    """Pushing one way only ends a CartPole episode early, as a failure; MountainCar's 200th step is a time limit."""
    ends = {name: last_step(name) for name in ("cartpole", "mountaincar")}
    assert ends["cartpole"][0] < 15 and ends["cartpole"][1:] == (True, False)
    assert ends["mountaincar"] == (200, False, True)
    shows("one action only: CartPole is terminated within 15 steps by a fall, MountainCar truncated at 200")


def last_step(name):
    """(steps, terminated, truncated) of an episode in which action 0 is taken throughout."""
    env, steps, terminated, truncated = make(name), 0, False, False
    env.reset(seed=0)
    while not (terminated or truncated):
        *_, terminated, truncated, _ = env.step(0)
        steps += 1
    return steps, bool(terminated), bool(truncated)


@control("R15")
def test_control_a_target_that_took_a_time_limit_for_an_end_would_be_wrong():
    """Negative control: at a truncated step the value of the next state still counts."""
    r, q_next = np.array([-1.0]), np.array([[-50.0]])
    assert td_target(r, np.array([False]), q_next, 0.99) == pytest.approx(-50.5)
    assert td_target(r, np.array([True]), q_next, 0.99) == -1.0

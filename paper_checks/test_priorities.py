"""Replay, claim by claim: what is unbiased, whom the priorities favour, what their clock and their
sum need.

The mixture of Eqs. 10–11, Theorem 3 and the importance weights are in test_replay.py.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.bellman import loss_gradient, td_target
from gbdqn_ref.drift import make
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.replay import (
    ProportionalReplay,
    RecencyReplay,
    importance_weights,
    mixed_priority,
    td_priority,
    time_priority,
)
from gbdqn_ref.tabular import MDP
from gbdqn_ref.train import Config


def exact(*values):
    return np.array([F(value) for value in values])


def normalise(p):
    return p / p.sum()


def filled(replay, rewards):
    """The replay after a loop of one state and one action has paid these rewards."""
    for reward in rewards:
        replay.add(0.0, 0, reward, 0.0, False)
    return replay


def loop(reward):
    """One state, one action that stays in it: Q* = 10 · reward."""
    return MDP(np.array([[[F(1)]]]), np.array([[F(reward)]]), F(9, 10))


# What off-policy learning excuses


@claim(
    "R1",
    place="section Recency and TD-error",
    says="data of any behaviour policy will do for one-step Q-learning",
    verdict="holds if Q stands still and all of the data have the same physics",
    uses="bellman.td_target, tabular.MDP.bellman",
)
@given(st.integers(0, 10**6))
def test_the_mean_target_of_a_pair_is_its_backup_whatever_the_behaviour(seed):
    """E[y | s, a] = (𝒯Q)(s, a): how often a pair is visited cancels, for the next state depends on
    the pair alone.
    """
    rng = np.random.default_rng(seed)
    weights, rewards, Q, visits = (
        rng.integers(1, 10, size) + F(0) for size in ((3, 2, 3), (3, 2), (3, 2), (3, 2))
    )
    mdp = MDP(weights / weights.sum(-1, keepdims=True), rewards, F(9, 10))
    seen = visits[:, :, None] * mdp.P  # how often (s, a, s') is in the data
    y = td_target(
        np.broadcast_to(rewards[:, :, None], seen.shape),
        np.zeros(seen.shape, bool),
        np.broadcast_to(Q, (*seen.shape, 2)),
        mdp.gamma,
    )
    assert ((seen * y).sum(-1) / seen.sum(-1) == mdp.bellman(Q)).all()
    shows("E[y | s, a] = (𝒯Q)(s, a) exactly, random MDPs and visits of 3 states and 2 actions")


@control("R1")
def test_control_two_steps_do_depend_on_the_behaviour():
    """Negative control: rewards (0, 1) on a loop; two steps from a₀ give 0 or ½ as the next action
    is a₀ or a₁.
    """
    gamma, rewards = F(1, 2), exact(0, 1)
    y = td_target(rewards[0] + gamma * rewards, np.zeros(2, bool), np.full((2, 2), F(0)), gamma**2)
    assert y.tolist() == [0, F(1, 2)]


def fitted(replay, y):
    """The least-squares fit of a constant to the targets, as the replay draws and weighs them."""
    P = replay.probabilities()
    weight = P * importance_weights(P, len(P), replay.is_exponent, None)
    return float(weight @ y / weight.sum())


def backup_of_the_buffer(rewards, Q):
    replay = filled(ProportionalReplay(len(rewards), 1), rewards)
    return fitted(
        replay, td_target(replay.r, replay.terminated, np.full((len(rewards), 1), Q), 0.9)
    )


def fitted_to_a_lottery(is_exponent, rewards=(0,) * 9 + (10,)):
    """A step that ends the episode and pays 0 nine times in ten, else 10; Q_{m−1} = 0, so δ is the
    reward.
    """
    replay = filled(ProportionalReplay(10, 1, is_exponent=is_exponent), rewards)
    replay.update_priorities(np.arange(10), replay.r)
    return fitted(replay, replay.r)


def mean_of_the_largest(noise, actions):
    """The mean target where Q̄(s′, ·) is 0 but for noise, independent for each action."""
    q = np.array(np.meshgrid(*[exact(*noise)] * actions)).reshape(actions, -1).T
    return td_target(np.full(len(q), F(0)), np.zeros(len(q), bool), q, F(1, 2)).mean()


@claim(
    "R2",
    place="section Recency and TD-error",
    says="since Q-learning is off-policy, learning from the shared buffer is unbiased",
    verdict=(
        "fails: what is excused is the choice of actions; old physics, draws by |δ| and the max all"
        " bias"
    ),
    uses="replay.ProportionalReplay, bellman.td_target, tabular.MDP.bellman",
)
def test_off_policy_is_not_unbiased():
    """Three biases of different kinds.

    Half of the buffer is from before a drift of the reward from 0 to 1: its fixed point is 5, and
    Q*_new = 10. The δ of Q_{m−1} = 0 draws the lucky outcomes of a lottery. The target's max takes
    the lucky one of two noises ±1.
    """
    assert backup_of_the_buffer([0, 1], 5.0) == pytest.approx(5)
    assert loop(1).bellman(np.array([[F(10)]])) == 10
    lottery = [fitted_to_a_lottery(is_exponent) for is_exponent in (0, 0.5)]
    assert lottery == pytest.approx([8.752, 4.689], abs=5e-4)
    assert mean_of_the_largest((1, -1), 2) == F(1, 2) * F(1, 2)
    shows(
        f"half old: 5 for 10; lottery of mean 1: {lottery[0]:.3f}, with IS ½ {lottery[1]:.3f};"
        " noise ±1: γ/2 for 0"
    )


@control("R2")
def test_control_without_drift_draws_by_outcome_or_choice_it_is_unbiased():
    """Negative control: take each cause away and its bias is gone."""
    assert backup_of_the_buffer([1, 1], 10.0) == pytest.approx(10)
    assert fitted_to_a_lottery(1) == pytest.approx(1)
    assert fitted_to_a_lottery(0, rewards=(1,) * 10) == pytest.approx(1)
    assert mean_of_the_largest((1, -1), 1) == mean_of_the_largest((0,), 2) == 0


# Whom the priorities favour


@claim(
    "R3",
    place="section Recency and TD-error",
    says="weighted sampling emphasises the transitions that the ensemble predicts well",
    verdict="fails: the priority rises with |δ|, so it emphasises those that it predicts badly",
    uses="replay.ProportionalReplay, replay.td_priority",
)
@given(st.floats(0, 100), st.floats(0.01, 100), st.floats(0.1, 2))
def test_the_worse_predicted_is_drawn_more(small, more, exponent):
    """The same section says so a paragraph later, where it favours high TD errors."""
    well, badly = td_priority(np.array([small, -small - more]), 0.01, exponent)
    assert well < badly
    replay = filled(ProportionalReplay(2, 1), [0, 0])
    replay.update_priorities(np.arange(2), [0.0, 1.0])
    P = replay.probabilities()
    assert pytest.approx([0.059, 0.941], abs=5e-4) == P
    shows(f"δ = (0, 1), ε = 0.01, exponent 0.6: drawn with {P[0]:.3f} and {P[1]:.3f}")


@control("R3")
def test_control_a_negative_exponent_would_emphasise_them():
    """Negative control: with the exponent's sign turned round the well-predicted one is drawn more,
    with 0 neither.
    """
    replay = filled(ProportionalReplay(2, 1, priority_exponent=-0.6), [0, 0])
    replay.update_priorities(np.arange(2), [0.0, 1.0])
    assert replay.probabilities() == pytest.approx([0.941, 0.059], abs=5e-4)
    assert td_priority(np.array([0.0, 1.0]), 0.01, 0.0).tolist() == [1, 1]


OLD, NEW, RATE = 10_000, 1_000, 0.01


def stale_mass(Q, mix):
    """(largest |δ| of the old transitions, of the new ones, the old ones' part of the draws)."""
    replay = filled(RecencyReplay(OLD + NEW, 1, mix=mix, recency_rate=RATE), [0] * OLD + [1] * NEW)
    delta = td_target(replay.r, replay.terminated, np.full((OLD + NEW, 1), Q), 0.9) - Q
    replay.update_priorities(np.arange(OLD + NEW), delta)
    return abs(delta[:OLD]).max(), abs(delta[OLD:]).max(), replay.probabilities()[:OLD].sum()


@claim(
    "R4",
    place="section Recency and TD-error",
    says="after a drift the old data have a high prediction error and the new ones a low one",
    verdict=(
        "fails: at the drift it is the reverse; it is true of an adapted Q, and then |δ| draws the"
        " old data"
    ),
    uses="replay.RecencyReplay, bellman.td_target, tabular.MDP",
)
def test_the_old_data_have_no_error_until_q_has_adapted():
    """The loop's reward drifts from 0 to 1, so Q* from 0 to 10; 10,000 old transitions and 1,000
    new ones.

    Q*_old fits the old transitions without error in whatever deterministic MDP. Priorities by |δ|
    then help, and hurt as soon as Q has learnt: with the paper's mixture half-half the old data
    have nearly all of the draws.
    """
    assert loop(0).residual(np.array([[F(0)]])) == loop(1).residual(np.array([[F(10)]])) == 0
    old, new, before = stale_mass(0.0, mix=0.5)
    assert (old, new) == (0, 1)
    old, new, after = stale_mass(10.0, mix=0.5)
    assert (old, new) == pytest.approx((1, 0))
    assert (before, after) == pytest.approx((0.363, 0.984), abs=5e-4)
    shows(
        f"|δ| of 10,000 old, 1,000 new: 0, 1, later 1, 0; β = ½: the old have {before:.3f} of"
        f" draws, later {after:.3f}"
    )


@control("R4")
@pytest.mark.parametrize("Q", [0.0, 10.0])
def test_control_recency_alone_prefers_the_new_data_whatever_q_is(Q):
    """Negative control: without the TD part the old data have e^{−10} of the draws, before as
    after.
    """
    assert stale_mass(Q, mix=0)[2] == pytest.approx(np.exp(-RATE * NEW), rel=1e-6)


# The TD error and its priority


def agent_with_one_transition(target):
    """A GB-DQN at its second learner, whose buffer holds one transition: r = 3 on a loop, Q_{m−1} =
    about 1.
    """
    config = Config(
        agent="gbdqn",
        hidden=(),
        capacity=1,
        batch_size=1,
        gamma=0.0,
        lr=0.05,
        target=target,
        loss_on="h",
        alpha=1.0,
    )
    agent, s = GBDQN(1, 1, config, np.random.default_rng(0)), np.ones(1, np.float32)
    agent.observe(s, 0, 1.0, s, False)
    for _ in range(300):
        agent.learn()
    agent.on_drift("drift")
    agent.observe(s, 0, 3.0, s, False)
    return agent


@claim(
    "R5",
    place="section Recency and TD-error, Algorithm 1 lines 16–18",
    says="δ is time-varying, and says what is left to learn",
    verdict=(
        "fails: within a stage it is a constant, for it has Q_{m−1} and not h_m; only with a live"
        " target it is not"
    ),
    uses="gbdqn.GBDQN, replay.td_priority, bellman.loss_gradient",
)
def test_the_td_error_stands_still_while_the_booster_learns():
    """Once Q̄_{m−1} is Q_{m−1}, nothing in δ moves until the next booster; what is learnt is still
    drawn.

    Residuals (5, 1), h = (5, 0): the first is learnt, and with exponent 1 and ε = 0 has five of six
    draws.
    """
    agent = agent_with_one_transition("frozen")
    delta = [float(agent.learn()[0]) for _ in range(500)]
    assert set(delta) == {delta[0]} and delta[0] == pytest.approx(2, abs=0.01)
    residual, h = exact(5, 1), exact(5, 0)
    gradient = loss_gradient(residual - h, exact(1, 1), np.zeros(2, int), 1)
    assert gradient.ravel().tolist() == [0, F(-1, 2)]
    assert normalise(td_priority(residual, 0, 1)).tolist() == [F(5, 6), F(1, 6)]
    shows(
        "500 updates leave δ the same to the bit; residuals (5, 1), h = (5, 0): P = (5/6, 1/6),"
        " gradients 0 and −½"
    )


@claim(
    "R14",
    place="section Algorithm, Algorithm 1 line 18",
    says="priorities are updated after the gradient step (text) or before it (Algorithm 1)",
    verdict="ambiguous: but it is all one where δ does not have h_m in it",
    uses="gbdqn.GBDQN.learn",
)
def test_before_or_after_the_step_is_all_one():
    """The second δ is what the first would have been after its step."""
    agent = agent_with_one_transition("frozen")
    before, after = agent.learn(), agent.learn()
    assert before == after
    shows("frozen target: δ before the step is δ after it, to the bit")


@control("R5", "R14")
def test_control_with_a_live_target_the_td_error_moves():
    """Negative control: where h_m counts at once, each step changes δ, and learning takes it to
    0.
    """
    agent = agent_with_one_transition("live")
    before, after = agent.learn(), agent.learn()
    assert before > after + 0.01
    for _ in range(500):
        last = agent.learn()
    assert abs(last) < 0.01


magnitudes = st.one_of(st.just(0.0), st.floats(1e-300, 1e300))


@claim(
    "R6",
    place="section Recency and TD-error",
    says="p^TD = (|δ| + ε)^γ grows with |δ|, whatever its sign, and leaves no transition out",
    verdict="holds if ε > 0 and the exponent is positive",
    uses="replay.td_priority, replay.ProportionalReplay.probabilities",
)
@given(magnitudes, magnitudes, st.floats(1e-3, 1), st.floats(0.1, 1))
def test_the_td_priority(one, other, offset, exponent):
    """It is at least ε^γ, even and nondecreasing, from δ = 0 to 10^±300."""
    small, large = sorted((one, other))
    p = td_priority(np.array([0.0, small, large, -large]), offset, exponent)
    assert 0 < offset**exponent == pytest.approx(p[0])
    assert (np.diff(p[:3]) >= -1e-12 * p[:2]).all()
    assert p[2] == p[3] < np.inf
    shows("at least ε^γ, even and nondecreasing in |δ|, from 0 to 10^±300")


@control("R6")
def test_control_without_an_offset_a_transition_is_never_drawn_again():
    """Negative control: ε = 0 and δ = 0 give P = 0, and what is never drawn has its δ never
    computed again.
    """
    replay = filled(ProportionalReplay(2, 1, priority_offset=0.0), [0, 0])
    replay.update_priorities(np.arange(2), [0.0, 1.0])
    assert replay.probabilities().tolist() == [0, 1]


@claim(
    "R7",
    place="section Recency and TD-error",
    says="prioritized replay draws in proportion to |δ|",
    verdict="holds if the exponent is 1 and ε = 0",
    uses="replay.td_priority",
)
@given(st.lists(st.fractions(-100, 100), min_size=1, max_size=6).filter(any))
def test_per_is_proportional_to_the_td_error(delta):
    delta = exact(*delta)
    P = normalise(td_priority(delta, 0, 1))
    assert (P * abs(delta).sum() == abs(delta)).all()
    shows(
        "P = |δ| / Σ |δ| exactly; with ε = 0.01 and exponent 0.6 twice the |δ| has 1.51 times the"
        " draws"
    )


@control("R7")
def test_control_an_offset_or_an_exponent_bends_it():
    """Negative control: |δ| = (2, 1) are not drawn 2 : 1 with the usual offset and exponent, nor
    with either alone.
    """

    def ratio(offset, exponent):
        two, one = td_priority(np.array([2.0, 1.0]), offset, exponent)
        return two / one

    assert ratio(0, 1) == 2
    assert [ratio(0.01, 1), ratio(0, 0.6), ratio(0.01, 0.6)] == pytest.approx(
        [1.990, 1.516, 1.511], abs=5e-4
    )


# The clock and its rate


@claim(
    "R8",
    place="section Recency and TD-error, Algorithm 1 line 12",
    says="p^time = e^{−α(T − t)} lies in (0, 1] and is less for older data",
    verdict=(
        "holds if t counts the steps of the whole run, where Algorithm 1 stores the step within the"
        " episode"
    ),
    uses="replay.time_priority, replay.RecencyReplay.age",
)
@given(st.integers(1, 60), st.integers(1, 20), st.floats(1e-6, 10))
def test_the_time_priority_with_a_clock_of_the_whole_run(added, capacity, rate):
    """The ring's age is T − t in transitions added: 0 for the newest, N − 1 for the oldest."""
    replay = filled(RecencyReplay(capacity, 1), range(added))
    newest_first = np.argsort(-replay.r[: len(replay)])
    age = replay.age(newest_first)
    assert age.tolist() == list(range(len(replay)))
    p = time_priority(age, rate)
    assert p[0] == 1 and (p > 0).all() and (np.diff(p) < 0).all()
    literal = time_priority(1 - 500, 0.01)
    assert literal == pytest.approx(146.94, abs=5e-3)
    shows(
        f"with age = transitions added since; to the letter step 500 has {literal:.1f} at the next"
        " T = 1, α = 0.01"
    )


@control("R8")
def test_control_by_the_step_within_the_episode_the_order_is_wrong():
    """Negative control: an episode of 3 steps and 2 of the next, T = 2: the last episode's step 3
    is above the newest.

    And were p stored when its transition comes, as Algorithm 1 has it, T = t and every p^time is 1:
    no recency at all.
    """
    t = np.array([1, 2, 3, 1, 2])
    p = time_priority(t[-1] - t, 0.01)
    assert p.argmax() == 2 and p[2] > p[-1] == 1
    assert time_priority(t - t, 0.01).tolist() == [1] * 5


def mass_on_the_newest(k, n, mix, rate):
    """P of the newest k of n transitions with equal TD priorities of 1."""
    replay = filled(RecencyReplay(n, 1, mix=mix, recency_rate=rate), [0] * n)
    return replay.probabilities()[-k:].sum()


@claim(
    "R9",
    place="section Recency and TD-error",
    says="a larger α emphasises recent transitions more",
    verdict=(
        "fails: in the mixture too large an α leaves recency few draws; it is true of P^time alone"
    ),
    uses="replay.mixed_priority, replay.RecencyReplay.probabilities",
)
def test_a_larger_rate_can_mean_less_recency():
    """A larger α makes S_time smaller, and with it recency's share of the draws.

    Three transitions of equal |δ|, β = ½, x = e^{−α}: the newest two have (3 + x)/(4 + x + x²),
    most at x = √10 − 3. Two transitions will not do: the newest has (p₁ + 1)/(p₁ + 1 + p₂ + x),
    which falls with x.
    """
    mass = []
    for x in (F(1), F(1, 6), F(1, 10)):
        P = normalise(
            mixed_priority(td_priority(exact(1, 1, 1), 0, 1), np.array([1, x, x * x]), F(1, 2))
        )
        mass.append(P[:2].sum())
    assert mass == [F(2, 3), F(114, 151), F(310, 411)]
    assert mass[2] < mass[1]
    of_1000 = [mass_on_the_newest(10, 1000, 0.5, rate) for rate in (0.001, 0.1, 10)]
    assert of_1000 == pytest.approx([0.01222, 0.01647, 0.01099], abs=5e-6)
    shows(
        "N = 3, β = ½: e^{−α} = 1/6 gives the newest 2 114/151, 1/10 gives 310/411, which is less"
    )


@control("R9")
@given(st.integers(1, 30), st.integers(1, 30), st.floats(0, 5), st.floats(0, 5))
def test_control_pure_recency_does_as_it_says(k, more, rate, faster):
    """Negative control: at β = 0 the newest k have (1 − x^k)/(1 − x^N), x = e^{−α}, which rises
    with α.

    Against the rest they stand as Σ_{i<k} x^{i−k} to Σ_{i≥k} x^{i−k}: as x falls, only the first
    sum rises.
    """
    mass, faster_mass = (mass_on_the_newest(k, k + more, 0, r) for r in (rate, rate + faster))
    assert mass <= faster_mass + 1e-12


# What is stored, and its sum


@claim(
    "R11",
    place="Eq. 11",
    says="P sums to 1",
    verdict=(
        "holds if some p is positive: with β < 1 always, as the newest has p^time = 1, else with ε"
        " > 0 or a δ ≠ 0"
    ),
    uses="replay.RecencyReplay.probabilities",
)
@given(st.integers(1, 40), st.integers(0, 10**6), st.floats(0, 1), st.floats(0, 1e4))
def test_the_probabilities_sum_to_1(n, seed, mix, rate):
    """Also at β = 0 with a rate at which every p^time but the newest underflows to 0."""
    replay = filled(RecencyReplay(20, 1, mix=mix, recency_rate=rate), [0] * n)
    replay.update_priorities(
        np.arange(len(replay)), np.random.default_rng(seed).normal(size=len(replay))
    )
    P = replay.probabilities()
    assert (P >= 0).all() and P.sum() == pytest.approx(1)
    shows("random buffers, mixes and rates; β = 1, ε = 0 and δ = 0 everywhere is 0/0")


@control("R11")
def test_control_all_zero_is_no_distribution():
    """Negative control: with β = 1, ε = 0 and no error anywhere Eq. 11 reads 0/0, and recency does
    away with that.
    """
    replay = filled(RecencyReplay(3, 1, mix=1.0, priority_offset=0.0), [0] * 3)
    replay.update_priorities(np.arange(3), np.zeros(3))
    with pytest.raises(ValueError, match="every priority is 0"):
        replay.probabilities()
    replay.mix = 0.99
    assert replay.probabilities().sum() == pytest.approx(1)


def with_a_new_one(replay, old_deltas):
    """The replay with transitions of these TD errors, and one that is new, in the last slot."""
    n = len(old_deltas)
    filled(replay, [0] * n).update_priorities(np.arange(n), np.array(old_deltas))
    return filled(replay, [0])


def part_of_the_new_one(own_delta=None):
    """P of a new transition beside one of |δ| = 1, as it enters or after its own TD error has been
    noted.
    """
    replay = with_a_new_one(ProportionalReplay(2, 1), [1.0])
    if own_delta is not None:
        replay.update_priorities(np.array([1]), np.array([own_delta]))
    return replay.probabilities()[1]


@claim(
    "R13",
    place="section Recency and TD-error, Algorithm 1 line 11",
    says="a new transition enters with maximal priority",
    verdict=(
        "ambiguous: so the text; Algorithm 1 gives it the priority of its own TD error, which can"
        " be the least"
    ),
    uses="replay.RecencyReplay, replay.ProportionalReplay.add",
)
@given(st.lists(st.floats(-100, 100), min_size=1, max_size=8))
def test_a_new_transition_enters_at_the_top(old_deltas):
    """With the largest TD priority seen so far, as the package does it (D4), none is drawn more."""
    P = with_a_new_one(RecencyReplay(9, 1), old_deltas).probabilities()
    assert P[-1] >= P.max() * (1 - 1e-12)
    parts = [part_of_the_new_one(own_delta) for own_delta in (None, 0.0, 10.0)]
    assert parts == pytest.approx([0.5, 0.059, 0.798], abs=5e-4)
    shows(
        "PER, beside one of |δ| = 1: {:.3f} maximal; by its own δ = 0 {:.3f}, by 10 {:.3f}".format(
            *parts
        )
    )


@control("R13")
def test_control_by_its_own_error_it_may_enter_at_the_bottom():
    """Negative control: by line 11 a new transition without error is below one with |δ| = 1,
    recency or not.
    """
    replay = with_a_new_one(RecencyReplay(2, 1), [1.0])
    assert np.diff(replay.probabilities()) > 0
    replay.update_priorities(np.array([1]), np.array([0.0]))
    assert np.diff(replay.probabilities()) < 0


def ending(name, action):
    """(terminated, truncated, last observation) of an episode whose actions are a function of the
    observation.
    """
    env = make(name)
    s, _ = env.reset(seed=0)
    terminated = truncated = False
    while not (terminated or truncated):
        s, _, terminated, truncated, _ = env.step(action(s))
    return terminated, truncated, s


@claim(
    "R15",
    place="section Recency and TD-error",
    says="done means that the agent has reached the goal",
    verdict=(
        "fails: on CartPole and Hopper it means failure, and a time limit ends an episode without"
        " either"
    ),
    uses="drift.make, bellman.td_target",
)
def test_done_is_not_the_goal():
    """Pushed left the pole falls, left alone the hopper does; the other two run out of time, and
    there y bootstraps.
    """
    ends = {
        name: ending(name, lambda s, action=action: action)[:2]
        for name, action in (("cartpole", 0), ("hopper", 0), ("mountaincar", 1), ("acrobot", 1))
    }
    assert ends["cartpole"] == ends["hopper"] == (True, False)
    assert ends["mountaincar"] == ends["acrobot"] == (False, True)
    y = td_target(np.array([-1.0, -1.0]), np.array([True, False]), np.full((2, 2), -50.0), 0.99)
    assert y.tolist() == [-1, -50.5]
    shows(
        "doing nothing ends Hopper by a fall, MountainCar and Acrobot by the clock, where y = −50.5"
        " must not be −1"
    )


@control("R15")
def test_control_on_mountaincar_a_termination_is_the_goal():
    """Negative control: pushing the way the car moves takes it to the flag at 0.5, and that is what
    terminates.
    """
    terminated, truncated, s = ending("mountaincar", lambda s: 2 if s[1] >= 0 else 0)
    assert (terminated, truncated) == (True, False) and s[0] >= 0.5

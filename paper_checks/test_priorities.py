"""Replay, claim by claim: what is unbiased, whom the priorities favour, what their clock and their sum need.

The mixture of Eqs. 10–11, Theorem 3 and the importance weights are in test_replay.py.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.bellman import td_target
from gbdqn_ref.replay import (
    ProportionalReplay,
    RecencyReplay,
    importance_weights,
    td_priority,
)
from gbdqn_ref.tabular import MDP


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
    """E[y | s, a] = (𝒯Q)(s, a): how often a pair is visited cancels, for the next state depends on the pair alone."""
    rng = np.random.default_rng(seed)
    weights, rewards, Q, visits = (rng.integers(1, 10, size) + F(0) for size in ((3, 2, 3), (3, 2), (3, 2), (3, 2)))
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
    """Negative control: rewards (0, 1) on a loop; two steps from a₀ give 0 or ½ as the next action is a₀ or a₁."""
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
    return fitted(replay, td_target(replay.r, replay.terminated, np.full((len(rewards), 1), Q), 0.9))


def fitted_to_a_lottery(is_exponent, rewards=(0,) * 9 + (10,)):
    """A step that ends the episode and pays 0 nine times in ten, else 10; Q_{m−1} = 0, so δ is the reward."""
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
    verdict="fails: what is excused is the choice of actions; old physics, draws by |δ| and the max all bias",
    uses="replay.ProportionalReplay, bellman.td_target, tabular.MDP.bellman",
)
def test_off_policy_is_not_unbiased():
    """Three biases of different kinds.

    Half of the buffer is from before a drift of the reward from 0 to 1: its fixed point is 5, and Q*_new = 10. The δ
    of Q_{m−1} = 0 draws the lucky outcomes of a lottery. The target's max takes the lucky one of two noises ±1.
    """
    assert backup_of_the_buffer([0, 1], 5.0) == pytest.approx(5)
    assert loop(1).bellman(np.array([[F(10)]])) == 10
    lottery = [fitted_to_a_lottery(is_exponent) for is_exponent in (0, 0.5)]
    assert lottery == pytest.approx([8.752, 4.689], abs=5e-4)
    assert mean_of_the_largest((1, -1), 2) == F(1, 2) * F(1, 2)
    shows(
        f"half old: 5 for 10; 0 or 10, mean 1: fitted {lottery[0]:.3f}, {lottery[1]:.3f} with IS ½; noise ±1: γ/2 for 0"
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
    """Negative control: with the exponent's sign turned round the well-predicted one is drawn more, with 0 neither."""
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
    verdict="fails: at the drift it is the reverse; it is true of an adapted Q, and then |δ| draws the old data",
    uses="replay.RecencyReplay, bellman.td_target, tabular.MDP",
)
def test_the_old_data_have_no_error_until_q_has_adapted():
    """The loop's reward drifts from 0 to 1, so Q* from 0 to 10; 10,000 old transitions and 1,000 new ones.

    Q*_old fits the old transitions without error in whatever deterministic MDP. Priorities by |δ| then help, and hurt
    as soon as Q has learnt: with the paper's mixture half-half the old data have nearly all of the draws.
    """
    assert loop(0).residual(np.array([[F(0)]])) == loop(1).residual(np.array([[F(10)]])) == 0
    old, new, before = stale_mass(0.0, mix=0.5)
    assert (old, new) == (0, 1)
    old, new, after = stale_mass(10.0, mix=0.5)
    assert (old, new) == pytest.approx((1, 0))
    assert (before, after) == pytest.approx((0.363, 0.984), abs=5e-4)
    shows(
        f"|δ| old, new: 0, 1 → 1, 0; 10,000 old, 1,000 new, β = ½: old data have {before:.3f}, then {after:.3f} of draws"
    )


@control("R4")
@pytest.mark.parametrize("Q", [0.0, 10.0])
def test_control_recency_alone_prefers_the_new_data_whatever_q_is(Q):
    """Negative control: without the TD part the old data have e^{−10} of the draws, before as after."""
    assert stale_mass(Q, mix=0)[2] == pytest.approx(np.exp(-RATE * NEW), rel=1e-6)

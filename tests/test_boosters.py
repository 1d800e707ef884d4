"""The experiment on why a new booster loses CartPole: its arms, by hand and in small."""

import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from helpers import agent_of, feed

from gbdqn_ref import bellman, train
from gbdqn_ref.config import Config

sys.path.append(str(Path(__file__).parents[1] / "benchmarks" / "keep"))
import cartpole


@pytest.fixture
def agent():
    """GB-DQN with a frozen part and data."""
    agent = agent_of("gbdqn", alpha=1.0, replay="proportional")
    feed(agent, 40)
    agent.on_drift("drift")
    agent.theta = agent.net.init(np.random.default_rng(1))  # as if it had learnt something
    feed(agent, 10, learn=0)
    return agent


def test_no_clipped_target_exceeds_the_largest_return(agent):
    r, ends, q_next = np.ones(3), np.array([0.0, 0.0, 1.0]), np.array([[500.0, 0], [1, 2], [9, 9]])
    clipped = cartpole.target(agent, "clipped")
    np.testing.assert_allclose(clipped(r, ends, q_next, 0.99), [100.0, 2.98, 1.0])


def test_double_targets_take_the_action_that_the_agent_prefers(agent):
    double = cartpole.target(agent, "double")
    batch = agent.replay.sample(5, agent.rng)
    q_next = np.random.default_rng(0).normal(size=agent.q(batch.s2).shape)
    best = agent.q(batch.s2).argmax(1)
    expected = 1 + 0.9 * q_next[np.arange(5), best]
    np.testing.assert_allclose(double(np.ones(5), np.zeros(5), q_next, 0.9), expected)
    assert (best != q_next.argmax(1)).any(), "else it is the plain target"


def test_every_other_way_has_the_plain_target(agent):
    assert all(cartpole.target(agent, way) is bellman.td_target for way in ("", "alone", "gate"))


def test_forgetting_leaves_the_new_network_alone(agent):
    s = agent.replay.s[agent.replay.slots()]
    alone = agent.net.forward(agent.theta, s)[0]
    assert not np.allclose(agent.q(s), alone)
    cartpole.forget(agent)
    np.testing.assert_allclose(agent.q(s), alone, rtol=1e-5)
    assert not agent.q_frozen.any() and not agent.q_frozen_next.any()


def test_at_a_gate_two_play_in_turn_until_the_new_one_is_as_good(agent, monkeypatch):
    monkeypatch.setattr(type(agent), "epsilon", 0.0)
    gate, s = cartpole.Gate(agent), agent.replay.s[0]
    gate.q = lambda s: np.array([0.0, 1.0, 0.0])
    monkeypatch.setattr(agent.ensemble, "q", lambda s: np.array([1.0, 0.0, 0.0]))
    acted = []
    for total in (10.0, 9.0) * 5 + (10.0, 11.0) * 2 + (10.0,):
        acted.append(agent.act(s))
        assert agent.act(s, greedy=True) == 1
        gate.end(total, 0.0)
    assert acted == [0, 1] * 7 + [0]
    assert not gate.open, "the last five of the new one are 9, 9, 9, 11 and 11"
    gate.end(11.0, 0.0)
    assert gate.open and [agent.act(s)] == [1]


@pytest.mark.parametrize(
    "arm", ["DQN", "booster, lr × 25, gate", "new network alone", "DQN, double"]
)
def test_an_arm_goes_on_from_a_copy(monkeypatch, arm):
    """In small: the fork after three episodes, five more, all of them measured."""
    for name, value in dict(EPISODE=3, AFTER=5, EARLY=2, LATE=2).items():
        monkeypatch.setattr(cartpole, name, value)
    preset = Config.preset

    def small(*args, **values):
        return preset(*args, **values | dict(hidden=[8], learning_starts=20, capacity=400))

    monkeypatch.setattr(cartpole.Config, "preset", small)
    values, way, _ = cartpole.ARMS[arm]
    base = train.make_agent(cartpole.config_of("null", 0))
    assert len(list(islice(train.run(base.config, base), 3))) == 3
    measured = cartpole.run_arm(base, cartpole.config_of("gravity", 0, **values), way)
    of_networks = {f"{when}{name}" for when in ("", "late ") for name in ("q", "dormant", "rank")}
    assert set(measured) == {"first", "last"} | of_networks
    assert 1 <= measured["first"] <= 500 and 0 <= measured["late dormant"] <= 1

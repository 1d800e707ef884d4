"""The baselines and controls: each differs from DQN or GB-DQN only in what its name says."""

import copy

import numpy as np
import pytest
from helpers import (
    SMALL,
    A,
    D,
    agent_of,
    caught,
    drifts_at,
    feed,
    flags,
    replay_bytes,
    state_bytes,
    states,
    train_here,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from gbdqn_ref import checkpoint
from gbdqn_ref.__main__ import main
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import SETTINGS
from gbdqn_ref.dqn import DQN
from gbdqn_ref.optim import Adam
from gbdqn_ref.replay import ProportionalReplay, RecencyReplay
from gbdqn_ref.train import Config, make_agent, run

DRIFTING = SMALL | dict(schedule=drifts_at(4, 7, 10))
every_agent = pytest.mark.parametrize("agent", AGENTS)
drifts = pytest.mark.parametrize("event", ["drift", "reset"])


def trained(config):
    """The records of a run as text, and its trained agent."""
    agent = make_agent(config)
    return [repr(record) for record in run(config, agent)], agent


# --- all of them ----------------------------------------------------------------------------------


def test_every_agent_has_its_own_look_in_the_plots():
    looks = {(agent.colour, agent.line) for agent in AGENTS.values()}
    marks = {agent.mark for agent in AGENTS.values()}
    labels = {agent.label for agent in AGENTS.values()}
    assert len(looks) == len(marks) == len(labels) == len(AGENTS) == 11


@every_agent
def test_every_setting_that_an_agent_reads_or_overrides_exists(agent):
    assert set(AGENTS[agent].reads) | set(AGENTS[agent].own) <= set(SETTINGS)


@pytest.mark.parametrize("agent", sorted(set(AGENTS) - {"random"}))
@pytest.mark.parametrize("event", ["end", "typo", None])
def test_an_unknown_event_is_refused(agent, event):
    with pytest.raises(ValueError, match="an event is 'drift' or 'reset', not"):
        agent_of(agent).on_drift(event)


@every_agent
def test_an_agent_is_told_the_end_of_each_episode(agent):
    """Even if a time limit cuts the episode off, as it does here."""
    config = Config(agent=agent, env="mountaincar", episodes=3, hidden=(4,), learning_starts=300)
    learner, heard = make_agent(config), []
    learner.end_episode = lambda *told: heard.append(told)
    records = list(run(config, learner))
    assert [total for total, _ in heard] == [-200.0] * 3
    assert repr(heard) == repr([(record["return"], record["td_error"]) for record in records])


def test_an_evaluation_does_not_change_a_random_policy():
    agent, watched = (make_agent(Config(agent="random")) for _ in range(2))
    for _ in range(5):
        watched.act(np.zeros(4, np.float32), greedy=True)
    assert [agent.act(None) for _ in range(20)] == [watched.act(None) for _ in range(20)]


@every_agent
def test_the_same_seed_gives_the_same_run_and_another_seed_does_not(agent):
    (records, one), (again, other) = (trained(Config(agent=agent, **DRIFTING)) for _ in range(2))
    assert records == again and state_bytes(one) == state_bytes(other)
    assert records != trained(Config(agent=agent, seed=1, **DRIFTING))[0]


@every_agent
@pytest.mark.parametrize("bootstrap", [1.0, 0.5])
def test_a_restored_agent_continues_identically(tmp_path, agent, bootstrap):
    config = Config(agent=agent, bootstrap=bootstrap, **DRIFTING)
    original, records = make_agent(config), []
    for record in run(config, original):
        records.append(repr(record))
        if record["episode"] in (2, 4, 10):  # before, at and after drifts
            checkpoint.save(tmp_path / str(len(records)), original, len(records))
    for episodes in (3, 5, 11):
        again = make_agent(config)
        assert checkpoint.load(tmp_path / str(episodes), again) == episodes
        assert [repr(record) for record in run(config, again, episodes)] == records[episodes:]
        assert state_bytes(again) == state_bytes(original)


@pytest.mark.parametrize("agent", sorted(set(AGENTS) - {"random"}))
def test_every_agents_greedy_action_is_the_best_and_uses_no_random_number(agent):
    learner = agent_of(agent)
    feed(learner, 30)
    learner.on_drift("drift")
    before, best = state_bytes(learner), learner.q(states()).argmax(-1).tolist()
    assert [learner.act(s, greedy=True) for s in states()] == best
    assert state_bytes(learner) == before


@pytest.mark.parametrize(
    ("control", "agent", "replay", "kind"),
    [
        ("dqn-recency", "dqn", "recency", RecencyReplay),
        ("gbdqn-per", "gbdqn", "proportional", ProportionalReplay),
    ],
)
def test_the_replay_controls_differ_only_in_the_replay(control, agent, replay, kind):
    records, one = trained(Config(agent=control, **DRIFTING))
    same, other = trained(Config(agent=agent, replay=replay, **DRIFTING))
    assert records == same and state_bytes(one) == state_bytes(other)
    assert type(one) is type(other) and type(one.replay) is kind
    assert records != trained(Config(agent=agent, **DRIFTING))[0]


def test_compare_takes_every_agent(tmp_path, capsys, monkeypatch):
    train_here(monkeypatch)
    settings = flags(**SMALL | dict(episodes=4, schedule=[{"episode": 2, "length": 2}]))
    agents, out = ",".join(AGENTS), str(tmp_path)
    assert main(["compare", "--agents", agents, *settings, "--out", out, "--quiet"]) == 0
    printed = capsys.readouterr().out
    assert all(agent.label in printed for agent in AGENTS.values())
    assert all((tmp_path / agent / "summary.json").exists() for agent in AGENTS)


# --- the ensemble ---------------------------------------------------------------------------------


@pytest.mark.parametrize("replay", ["uniform", "proportional", "recency"])
def test_an_ensemble_of_one_is_dqn(replay):
    (records, one), (same, dqn) = (
        trained(Config(agent=agent, members=1, replay=replay, **DRIFTING))
        for agent in ("ensemble", "dqn")
    )
    assert records == same and one.steps > 100
    ours = state_bytes(one)
    assert ours.pop("seen") and ours == state_bytes(dqn)


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 6), st.integers(0, 99))
def test_the_members_start_differently_and_the_first_starts_as_dqn(members, seed):
    ensemble, dqn = (agent_of(agent, members=members, seed=seed) for agent in ("ensemble", "dqn"))
    assert ensemble.theta.shape == (members, dqn.net.size)
    assert np.array_equal(ensemble.theta[0], dqn.theta)
    for k in range(members):
        assert not (ensemble.theta[k] == np.delete(ensemble.theta, k, 0)).any()
    assert np.array_equal(ensemble.theta, ensemble.theta_target)
    assert not np.shares_memory(ensemble.theta, ensemble.theta_target)


def test_an_ensembles_q_function_is_the_mean_of_its_members():
    agent = agent_of("ensemble", members=3)
    feed(agent, 30)
    thetas = agent.theta.astype(np.float64)
    expected = sum(agent.net.forward(theta, states())[0] for theta in thetas) / 3
    np.testing.assert_allclose(agent.q(states()), expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose([agent.q(s) for s in states()], expected, rtol=1e-5, atol=1e-6)
    assert agent.q(states(6).reshape(2, 3, D)).shape == (2, 3, A)


@pytest.mark.parametrize("bootstrap", [1.0, 0.5])
def test_every_member_is_updated_alone_towards_the_common_target(monkeypatch, bootstrap):
    """The expected update is summed by member and by transition, in float64."""
    agent = agent_of("ensemble", members=3, bootstrap=bootstrap, max_grad_norm=0.05)
    feed(agent, 60)
    batch, before = agent.replay.sample(8, copy.deepcopy(agent.rng)), agent.theta.astype(np.float64)
    forward, target = agent.net.forward, agent.theta_target.astype(np.float64)
    q_next = np.mean([forward(theta, batch.s2)[0] for theta in target], 0)
    y = [batch.r[i] + (0 if batch.terminated[i] else 0.99 * max(q_next[i])) for i in range(8)]
    expected, q = [], np.zeros((3, 8))
    for k in range(3):
        q_k, cache = forward(before[k], batch.s)
        dq = np.zeros((8, A))
        for i, a in enumerate(batch.a):
            q[k, i] = q_k[i, a]
            dq[i, a] = agent.seen[batch.index[i], k] * batch.weight[i] * (q_k[i, a] - y[i]) / 8
        grad = agent.net.backward(before[k], cache, dq)
        expected.append(grad * min(1, 0.05 / np.linalg.norm(grad)))
    calls = caught(monkeypatch, Adam, "step")
    noted = caught(monkeypatch, agent.replay, "update_priorities")
    delta = agent.learn()
    np.testing.assert_allclose(calls[0][2], expected, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(delta, y - q.mean(0), rtol=1e-3, atol=1e-5)
    assert delta.shape == (8,)
    assert np.array_equal(noted[0][0], batch.index) and np.array_equal(noted[0][1], delta)
    moved = 0.99 * target + 0.01 * agent.theta
    np.testing.assert_allclose(agent.theta_target, moved, rtol=1e-5, atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.booleans(), min_size=3, max_size=3))
def test_a_member_does_not_learn_from_a_transition_it_does_not_see(sees):
    agent = agent_of("ensemble", members=3, batch_size=4)
    feed(agent, 20, learn=0)
    agent.seen[:] = sees
    before = agent.theta.copy()
    agent.learn()
    assert (agent.theta != before).any(-1).tolist() == sees


def test_what_a_member_sees_is_drawn_once_per_stored_transition():
    agent = agent_of("ensemble", members=4, bootstrap=0.3, capacity=500)
    feed(agent, 500, learn=0)
    first = agent.seen.copy()
    assert agent.seen.shape == (500, 4) and agent.seen.mean(0) == pytest.approx(0.3, abs=0.08)
    assert len({column.tobytes() for column in first.T}) == 4, "each member draws by itself"
    feed(agent, 250, learn=0)
    assert (agent.seen[250:] == first[250:]).all() and not (agent.seen[:250] == first[:250]).all()


def test_with_bootstrap_1_every_member_sees_everything_and_nothing_is_drawn():
    agent = agent_of("ensemble")
    before = agent.rng.bit_generator.state
    feed(agent, 200, learn=0)
    assert agent.seen.all() and agent.rng.bit_generator.state == before


# --- what happens at a drift ----------------------------------------------------------------------


@drifts
def test_a_reset_agent_restarts_learning_and_keeps_the_replay(event):
    agent = agent_of("reset")
    feed(agent, 60)
    theta, replay, epsilon = agent.theta.copy(), replay_bytes(agent), agent.epsilon
    agent.on_drift(event)
    assert replay_bytes(agent) == replay and agent.epsilon == epsilon
    assert not (agent.theta == theta).any()
    assert np.abs(agent.theta).max() <= 1 / 2  # uniform within ±1/√4 or closer
    assert np.array_equal(agent.theta, agent.theta_target)
    assert not np.shares_memory(agent.theta, agent.theta_target)
    assert agent.adam.t == 0 and not agent.adam.m.any() and not agent.adam.v.any()
    feed(agent, 5)
    assert agent.adam.t == 5


def test_a_reset_agent_restarts_at_each_regime_of_a_run():
    config, updates = Config(agent="reset", **DRIFTING), []
    agent = make_agent(config)
    for _ in run(config, agent):
        updates.append(agent.adam.t)
    assert [k for k in range(1, 12) if updates[k] < updates[k - 1]] == [4, 7, 10]


def test_a_frozen_agent_is_dqn_until_the_first_drift_and_never_changes_after_it():
    config, thetas = Config(agent="frozen", **DRIFTING), []
    agent, dqn = make_agent(config), make_agent(Config(agent="dqn", **DRIFTING))
    other = run(dqn.config, dqn)
    for record in run(config, agent):
        thetas.append(agent.theta.tobytes())
        if record["episode"] < 4:
            assert repr(record) == repr(next(other)) and thetas[-1] == dqn.theta.tobytes()
    assert thetas[3] != thetas[0] and len(set(thetas[3:])) == 1
    assert agent.steps == agent.replay.added and not np.isnan(record["td_error"])


def test_a_frozen_agent_stays_frozen_and_keeps_exploring():
    agent = agent_of("frozen", epsilon_start=0.5, epsilon_end=0.5)
    feed(agent, 30)
    agent.on_drift("reset")
    learnt = agent.theta.copy()
    feed(agent, 1)
    assert not np.array_equal(agent.theta, learnt), "a reset does not freeze the agent"
    frozen, s = agent.theta.copy(), states(1)[0]
    for event in ("drift", "drift", "reset"):
        agent.on_drift(event)
        deltas = feed(agent, 40)
        assert np.array_equal(agent.theta, frozen) and np.isfinite(deltas).all()
    assert {agent.act(s) for _ in range(60)} == {0, 1}


# --- the others -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("window", "capacity"), [(1, 90), (25, 90), (90, 25)])
def test_a_sliding_window_holds_only_the_last_transitions(window, capacity):
    agent, dqn = (agent_of(name, window=window, capacity=capacity) for name in ("sliding", "dqn"))
    feed(dqn, 60, learn=0)
    rng, held = np.random.default_rng(0), []
    for _ in range(60):
        s, s2 = rng.normal(size=(2, D)).astype(np.float32)
        agent.observe(s, int(rng.integers(A)), float(rng.normal()), s2, bool(rng.random() < 0.2))
        held.append(len(agent.replay))
        agent.learn()
    assert held == [min(n, window) for n in range(1, 61)] and len(dqn.replay) == min(60, capacity)
    assert type(agent) is DQN and agent.replay.s.shape == (window, D)


def test_a_sliding_window_as_wide_as_the_replay_is_dqn():
    (records, _), (same, _) = (
        trained(Config(agent=a, **DRIFTING | dict(window=90))) for a in ("sliding", "dqn")
    )
    assert records == same != trained(Config(agent="sliding", **DRIFTING))[0]


def test_the_random_policy_is_uniform_and_learns_nothing():
    config = Config(agent="random", **DRIFTING)
    agent = make_agent(config)
    records = list(run(config, agent))
    assert {record["epsilon"] for record in records} == {1.0}
    assert np.isnan([record["td_error"] for record in records]).all()
    assert records[-1]["steps"] == agent.steps == sum(record["length"] for record in records)
    for greedy in (False, True):
        actions = [agent.act(None, greedy) for _ in range(4000)]
        assert np.mean(actions) == pytest.approx(0.5, abs=0.03)

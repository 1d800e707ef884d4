"""DQN and GB-DQN, compared with naive computations."""

import copy
import itertools
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers import (
    A,
    D,
    agent_of,
    caught,
    feed,
    finite_differences,
    replay_bytes,
    state_bytes,
    states,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from gbdqn_ref import drift
from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.optim import Adam
from gbdqn_ref.train import Config, episode_seed, evaluate, make_agent, run

READINGS = [
    dict(target=target, alpha=alpha, loss_on=loss_on)
    for target, alpha, loss_on in itertools.product(
        ("live", "frozen"), (0.1, 1.0, "closed-form"), ("alpha_h", "h")
    )
]
readings = pytest.mark.parametrize(
    "reading", READINGS, ids=lambda reading: "-".join(map(str, reading.values()))
)
# learns much in a few updates, without clipping
quick_agent = partial(agent_of, capacity=40, batch_size=16, lr=0.01, tau=0.1, max_grad_norm=1e6)


def boosted(seed=0, boosters=2, **values):
    """A GB-DQN with so many frozen boosters, and a learner that has learnt for a while."""
    agent = quick_agent(**values)
    for k in range(boosters):
        feed(agent, 20, seed=10 * seed + k)
        agent.on_drift("drift")
    feed(agent, 20, seed=10 * seed + 9)
    return agent


def q_frozen(agent, x):
    """The naive Q_{m−1}: Σ α_j h_j(x) of the frozen boosters, one by one, in float64."""
    q = np.zeros((len(x), A))
    for theta, alpha in zip(agent.ensemble.theta, agent.ensemble.alpha, strict=True):
        q += float(alpha) * agent.net.forward(theta.astype(np.float64), x)[0]
    return q


def q_now(agent, x, theta=None):
    """Q_m(x), or Q_{m−1}(x) if the learner does not count yet, in float64."""
    counts = agent.config.target == "live" or not len(agent.ensemble)
    theta = agent.theta if theta is None else theta
    h = agent.net.forward(theta.astype(np.float64), x)[0]
    return q_frozen(agent, x) + counts * agent.alpha * h


def targets(agent, r, s2, terminated):
    """y = r + γ max Q̄(s'), transition by transition."""
    q_next, gamma = q_now(agent, s2, agent.theta_target), agent.config.gamma
    rows = zip(r, terminated, q_next, strict=True)
    return np.array([r_i + (0 if ends else gamma * max(q)) for r_i, ends, q in rows])


def next_batch(agent):
    """The batch that the next learn() will draw."""
    return agent.replay.sample(agent.config.batch_size, copy.deepcopy(agent.rng))


# --- the first learner ----------------------------------------------------------------------------


@readings
def test_before_the_first_drift_gbdqn_is_dqn_with_its_replay_under_every_reading(reading):
    """After a few hundred steps θ, θ̄, Adam, replay and generator are the same to the byte."""
    values = dict(replay="recency", episodes=12, learning_starts=50, hidden=(16,), capacity=150)
    values |= dict(update_every=2, seed=5) | reading
    dqn, gbdqn = (make_agent(Config(agent=agent, **values)) for agent in ("dqn", "gbdqn"))
    records = [[repr(record) for record in run(agent.config, agent)] for agent in (dqn, gbdqn)]
    assert records[0] == records[1] and dqn.steps > 200
    ours = state_bytes(gbdqn)
    assert state_bytes(dqn).items() <= ours.items()
    assert not gbdqn.q_frozen.any() and not gbdqn.q_frozen_next.any() and gbdqn.alpha == 1.0


# --- drifts ---------------------------------------------------------------------------------------


@readings
def test_a_drift_adds_a_booster_and_a_reset_does_not(reading):
    agent, counts = boosted(boosters=0, **reading), []
    for event in ("drift", "reset", "drift", "drift", "reset"):
        before = state_bytes(agent)
        agent.on_drift(event)
        counts.append(len(agent.ensemble))
        assert event == "drift" or state_bytes(agent) == before
        feed(agent, 3)
    assert counts == [1, 1, 2, 3, 3]


def test_in_a_run_every_drift_of_the_schedule_adds_a_booster():
    schedule = [{"episode": k, "length": 1.0 + k} for k in (2, 3, 6)]
    schedule += [{"episode": 7, "reset": True}]
    config = Config(episodes=9, hidden=(4,), capacity=50, learning_starts=10, schedule=schedule)
    agent = make_agent(config)
    assert [len(agent.ensemble) for _ in run(config, agent)] == [0, 0, 1, 2, 2, 2, 3, 3, 3]


def test_dqn_does_nothing_about_a_drift():
    agent = quick_agent(agent="dqn")
    feed(agent, 20)
    before = state_bytes(agent)
    for event in ("drift", "reset"):
        agent.on_drift(event)
    assert state_bytes(agent) == before


@readings
def test_a_frozen_booster_never_changes_again(reading):
    agent = boosted(boosters=1, **reading)
    theta, alpha = agent.ensemble.theta.tobytes(), agent.ensemble.alpha.tobytes()
    learner = agent.theta.tobytes()
    feed(agent, 10, seed=1, learn=5)
    assert agent.theta.tobytes() != learner
    assert (agent.ensemble.theta.tobytes(), agent.ensemble.alpha.tobytes()) == (theta, alpha)
    agent.on_drift("drift")
    feed(agent, 10, seed=2)
    assert agent.ensemble.theta[:1].tobytes() == theta
    assert agent.ensemble.alpha[:1].tobytes() == alpha


def test_freezing_takes_a_copy():
    agent = boosted(boosters=0)
    agent.fold_in()
    frozen = agent.ensemble.theta.tobytes()
    agent.learn()  # changes θ in place
    assert agent.ensemble.theta.tobytes() == frozen != agent.theta.tobytes()


@readings
def test_a_drift_freezes_the_learner(reading):
    agent = boosted(boosters=1, **reading)
    theta, alpha = agent.theta.copy(), agent.alpha
    agent.on_drift("drift")
    assert np.array_equal(agent.ensemble.theta[-1], theta)
    if reading["alpha"] != "closed-form":
        assert agent.ensemble.alpha[-1] == np.float32(alpha) == np.float32(reading["alpha"])


@pytest.mark.parametrize("alpha", [0.1, 0.7])
def test_adding_a_zero_booster_changes_no_q_value(alpha):
    agent = boosted(boosters=1, alpha=alpha)
    before, action = agent.q(states()), [agent.act(s, greedy=True) for s in states()]
    agent.on_drift("drift")
    np.testing.assert_allclose(agent.q(states()), before, rtol=0, atol=1e-5)
    assert [agent.act(s, greedy=True) for s in states()] == action


def test_adding_a_nonzero_booster_changes_q_values():
    agent = boosted(boosters=1, zero_output=False)
    before = agent.q(states())
    agent.on_drift("drift")
    assert np.abs(agent.q(states()) - before).max() > 1e-3


@readings
def test_a_new_booster_has_fresh_weights_and_a_fresh_adam(reading):
    agent = boosted(boosters=1, **reading)
    old = agent.theta.copy()
    agent.on_drift("drift")
    assert agent.adam.t == 0 and not agent.adam.m.any() and not agent.adam.v.any()
    assert np.array_equal(agent.theta, agent.theta_target) and agent.theta is not agent.theta_target
    assert not np.shares_memory(agent.theta, agent.theta_target)
    assert not (agent.theta == old).any()
    assert agent.alpha == (1.0 if reading["alpha"] == "closed-form" else reading["alpha"])


def test_the_replay_is_kept_when_a_booster_is_added():
    agent = boosted(boosters=1)
    before = replay_bytes(agent)
    agent.on_drift("drift")
    assert replay_bytes(agent) == before


# --- cached predictions ---------------------------------------------------------------------------


def assert_cache_is_fresh(agent):
    replay, n = agent.replay, len(agent.replay)
    fresh, fresh_next = q_frozen(agent, replay.s[:n]), q_frozen(agent, replay.s2[:n])
    np.testing.assert_allclose(
        agent.q_frozen[:n], fresh[np.arange(n), replay.a[:n]], rtol=1e-4, atol=1e-5
    )
    np.testing.assert_allclose(agent.q_frozen_next[:n], fresh_next, rtol=1e-4, atol=1e-5)


@readings
@pytest.mark.parametrize("n", [7, 33, 95], ids=["part", "nearly full", "wrapped"])  # capacity 40
def test_cached_predictions_equal_a_fresh_forward_pass(reading, n):
    agent = quick_agent(**reading)
    for stage in range(4):
        feed(agent, n, seed=stage)
        assert_cache_is_fresh(agent)
        agent.on_drift("drift")
        assert_cache_is_fresh(agent)
    assert len(agent.ensemble) == 4 and np.abs(agent.q_frozen).max() > 0.05


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.one_of(st.integers(1, 60), st.sampled_from(["drift", "reset"])), max_size=8),
    st.booleans(),
)
def test_the_cache_stays_fresh_under_any_sequence_of_events(events, live):
    agent = quick_agent(capacity=30, hidden=(4,), target="live" if live else "frozen")
    for i, event in enumerate(events):
        if isinstance(event, int):
            feed(agent, event, seed=i)
        elif agent.steps:
            agent.on_drift(event)
    assert_cache_is_fresh(agent)


def test_folding_in_covers_the_whole_of_a_large_buffer():
    agent = quick_agent(capacity=3000)
    feed(agent, 2600, learn=0)  # the forward pass takes 1024 rows at a time
    agent.on_drift("drift")
    assert_cache_is_fresh(agent)


def test_a_drift_clears_the_memo_of_the_last_state():
    agent = quick_agent()
    feed(agent, 20)
    s = states(1)[0]
    agent.q(s)
    agent.on_drift("drift")
    np.testing.assert_allclose(agent.q(s), q_now(agent, s[None])[0], rtol=1e-4, atol=1e-5)


def test_the_memo_notices_a_state_overwritten_in_place():
    agent = boosted()
    s = states(1)[0]
    agent.q(s)
    s += 1  # catches remembering the state without a copy
    np.testing.assert_allclose(agent.q(s), q_now(agent, s[None])[0], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("target", ["live", "frozen"])
def test_a_caller_may_overwrite_the_q_values_it_gets(target):
    agent, s = boosted(target=target), states(1)[0]
    expected = agent.q(s).copy()
    agent.q(s)[:] = 99.0  # catches handing out the memo itself
    assert np.array_equal(agent.q(s), expected)


# --- α --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("replay", ["uniform", "proportional", "recency"])
@pytest.mark.parametrize("target", ["live", "frozen"])
@pytest.mark.parametrize("n", [20, 60])  # the buffer holds 40
def test_closed_form_alpha_uses_the_whole_buffer(target, replay, n):
    values = dict(replay=replay, is_exponent=0.7, mix=0.5, recency_rate=0.05)
    agent = quick_agent(alpha="closed-form", target=target, **values)
    feed(agent, 15)
    agent.on_drift("drift")
    feed(agent, n, seed=1)
    buffer, size = agent.replay, len(agent.replay)
    theta = agent.theta.astype(np.float64)
    h, h_next = (agent.net.forward(theta, x[:size])[0] for x in (buffer.s, buffer.s2))
    q, q_next = q_frozen(agent, buffer.s[:size]), q_frozen(agent, buffer.s2[:size])
    P, above, below = buffer.probabilities(), 0.0, 0.0
    for i in range(size):
        bootstrap = max(q_next[i] + h_next[i] * (target == "live"))
        residual = buffer.r[i] + 0.99 * bootstrap * (not buffer.terminated[i]) - q[i, buffer.a[i]]
        drawn_and_weighted = P[i] * (size * P[i]) ** -0.7
        above += drawn_and_weighted * residual * h[i, buffer.a[i]]
        below += drawn_and_weighted * h[i, buffer.a[i]] ** 2
    assert abs(above / below - 1) > 0.01, "α = 1 would pass too"
    agent.on_drift("drift")
    assert agent.ensemble.alpha[0] == 1.0
    assert agent.ensemble.alpha[1] == pytest.approx(above / below, rel=1e-3)


def test_the_first_learner_has_weight_1_with_closed_form_alpha_too():
    agent = quick_agent(alpha="closed-form")
    feed(agent, 20)
    agent.on_drift("drift")
    assert agent.ensemble.alpha.tolist() == [1.0]


def test_a_booster_that_has_learnt_nothing_gets_weight_0():
    agent = boosted(boosters=1, alpha="closed-form")
    agent.on_drift("drift")
    agent.on_drift("drift")
    assert agent.ensemble.alpha[-1] == 0.0 and np.isfinite(agent.q(states())).all()
    assert closed_form_alpha(np.ones(3), np.zeros(3)) == 0.0


# --- the loss -------------------------------------------------------------------------------------


@pytest.mark.parametrize("boosters", [0, 1, 2])
@readings
def test_an_update_follows_the_gradient_of_the_loss(monkeypatch, reading, boosters):
    """∂/∂θ of the mean of ½ w (r − α h)² under loss_on="alpha_h", and of ½ w (r − h)² under "h"."""
    agent = boosted(boosters=boosters, **reading)
    batch = next_batch(agent)
    factor = agent.alpha if reading["loss_on"] == "alpha_h" else 1.0
    taken = np.arange(len(batch.a)), batch.a
    residual = targets(agent, batch.r, batch.s2, batch.terminated) - q_frozen(agent, batch.s)[taken]

    def loss(theta):
        h = agent.net.forward(theta, batch.s)[0][taken]
        return np.mean(0.5 * batch.weight * (residual - factor * h) ** 2)

    expected = finite_differences(loss, agent.theta.astype(np.float64), step=1e-6)
    calls = caught(monkeypatch, Adam, "step")
    agent.learn()
    ((_, _, gradient),) = calls
    assert np.abs(gradient).max() > 1e-3
    np.testing.assert_allclose(gradient, expected, rtol=1e-3, atol=1e-5)


def test_dqn_follows_the_gradient_of_its_loss(monkeypatch):
    agent = quick_agent(agent="dqn")
    feed(agent, 30)
    batch, gamma = next_batch(agent), agent.config.gamma
    taken = np.arange(len(batch.a)), batch.a
    q_next = agent.net.forward(agent.theta_target.astype(np.float64), batch.s2)[0]
    rows = zip(batch.r, batch.terminated, q_next, strict=True)
    y = [r + (0 if ends else gamma * max(q)) for r, ends, q in rows]

    def loss(theta):
        return np.mean(0.5 * batch.weight * (y - agent.net.forward(theta, batch.s)[0][taken]) ** 2)

    expected = finite_differences(loss, agent.theta.astype(np.float64), step=1e-6)
    error = y - agent.net.forward(agent.theta.astype(np.float64), batch.s)[0][taken]
    calls = caught(monkeypatch, Adam, "step")
    noted = caught(monkeypatch, agent.replay, "update_priorities")
    np.testing.assert_allclose(agent.learn(), error, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(calls[0][2], expected, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(noted[0][1], error, rtol=1e-3, atol=1e-5)
    assert np.array_equal(noted[0][0], batch.index)


@pytest.mark.parametrize("agent", ["dqn", "gbdqn"])
def test_a_long_gradient_is_clipped_and_a_short_one_is_not(monkeypatch, agent):
    calls, norms = caught(monkeypatch, Adam, "step"), []
    for limit in (1e6, 1e-3):
        learner = quick_agent(agent=agent, max_grad_norm=limit)
        feed(learner, 20, learn=0)
        learner.learn()
        norms.append(np.linalg.norm(calls[-1][2]))
    assert norms[0] > 0.01 and norms[1] == pytest.approx(1e-3, rel=1e-5)
    np.testing.assert_allclose(calls[1][2] / norms[1], calls[0][2] / norms[0], atol=1e-6)


@pytest.mark.parametrize("agent", ["dqn", "gbdqn"])
def test_each_update_moves_the_target_network_towards_the_network(agent):
    learner = quick_agent(agent=agent, tau=0.25)
    feed(learner, 20)
    before = learner.theta_target.copy()
    learner.learn()
    expected = 0.75 * before + 0.25 * learner.theta
    np.testing.assert_allclose(learner.theta_target, expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("boosters", [0, 1, 2])
@readings
def test_priorities_use_the_td_error_of_the_q_function_in_use(monkeypatch, reading, boosters):
    """δ is y − Q_m(s, a) if live and y − Q_{m−1}(s, a) if frozen, under either loss."""
    agent = boosted(boosters=boosters, **reading)
    batch = next_batch(agent)
    y = targets(agent, batch.r, batch.s2, batch.terminated)
    delta = y - q_now(agent, batch.s)[np.arange(len(y)), batch.a]
    noted = caught(monkeypatch, agent.replay, "update_priorities")
    returned = agent.learn()
    assert np.array_equal(noted[0][0], batch.index)
    np.testing.assert_allclose(noted[0][1], delta, rtol=1e-3, atol=1e-4)
    assert np.array_equal(returned, noted[0][1])


# --- acting ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("boosters", [0, 1, 3])
@readings
def test_the_q_function_is_the_sum_of_its_boosters(reading, boosters):
    agent = boosted(boosters=boosters, **reading)
    np.testing.assert_allclose(agent.q(states()), q_now(agent, states()), rtol=1e-4, atol=1e-5)
    one = states(1)[0]
    assert agent.q(one).shape == (A,) and agent.q(states(6).reshape(2, 3, D)).shape == (2, 3, A)
    np.testing.assert_allclose(agent.q(one), agent.q(one[None])[0], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("boosters", [0, 1, 3])
@readings
def test_the_last_stage_is_the_q_function(reading, boosters):
    agent = boosted(boosters=boosters, **reading)
    stages = agent.staged_q(states())
    assert stages.shape == (max(1, boosters + (reading["target"] == "live")), 30, A)
    np.testing.assert_allclose(stages[-1], agent.q(states()), rtol=1e-4, atol=1e-5)
    if boosters:
        first = agent.ensemble.alpha[0] * agent.net.forward(agent.ensemble.theta[0], states())[0]
        np.testing.assert_allclose(stages[0], first, rtol=1e-4, atol=1e-5)


def test_with_a_frozen_target_the_learner_counts_only_once_frozen():
    agent = boosted(boosters=1, target="frozen")
    before, learner = agent.q(states()), agent.theta.copy()
    feed(agent, 20, seed=7, learn=3)
    assert np.array_equal(agent.q(states()), before) and not np.array_equal(agent.theta, learner)
    training = state_bytes(agent)
    finished = agent.finish()
    assert state_bytes(agent) == training, "finish() does not disturb the training"
    assert len(finished.ensemble) == 2 and np.abs(finished.q(states()) - before).max() > 1e-3
    expected = q_frozen(finished, states())
    np.testing.assert_allclose(finished.q(states()), expected, rtol=1e-4, atol=1e-5)


def test_with_a_live_target_the_learner_counts_at_once():
    agent = boosted(boosters=1, target="live")
    before = agent.q(states())
    feed(agent, 20, seed=7, learn=3)
    after = agent.q(states())
    assert np.abs(after - before).max() > 1e-3
    finished = agent.finish()
    assert len(finished.ensemble) == 1 and np.array_equal(finished.q(states()), after)


def test_without_a_drift_a_run_ends_with_its_first_learner():
    for target in ("live", "frozen"):
        agent = boosted(boosters=0, target=target)
        before = agent.q(states())
        finished = agent.finish()
        assert np.array_equal(finished.q(states()), before) and not len(finished.ensemble)


def test_a_run_folds_in_its_last_booster():
    schedule = [{"episode": 2, "length": 2.0}]
    small = dict(episodes=4, hidden=(4,), learning_starts=10, capacity=60)
    config = Config(target="frozen", schedule=schedule, **small)
    agent = make_agent(config)
    *_, last = run(config, agent)
    assert len(agent.ensemble) == 1 and len(agent.finish().ensemble) == 2
    env = drift.make("cartpole", config.schedule)
    judged = [evaluate(agent.finish(), env, 5, config.seed, start).mean() for start in (0, 2)]
    assert last["evaluation"] == judged


@pytest.mark.parametrize(
    "values", [dict(agent="dqn"), *READINGS[:1], *READINGS[-1:], dict(behaviour="softmax")]
)
def test_the_greedy_action_is_the_best_and_uses_no_random_number(values):
    agent = quick_agent(**values)
    feed(agent, 20)
    before = state_bytes(agent)
    assert [agent.act(s, greedy=True) for s in states()] == agent.q(states()).argmax(-1).tolist()
    assert state_bytes(agent) == before


@pytest.mark.parametrize("agent", ["dqn", "gbdqn"])
def test_softmax_action_probabilities_are_proportional_to_exp_q(agent):
    learner = quick_agent(agent=agent, behaviour="softmax", temperature=0.5)
    feed(learner, 20)
    s = states(1)[0]
    p = np.exp(learner.q(s).astype(np.float64) / 0.5)
    actions = [learner.act(s) for _ in range(2000)]
    assert set(map(type, actions)) == {int}
    assert np.mean(actions) == pytest.approx(p[1] / p.sum(), abs=0.05)
    assert learner.epsilon == 0.0


def test_a_run_can_use_the_softmax_policy():
    small = dict(episodes=4, hidden=(4,), learning_starts=10, capacity=60)
    records = list(run(Config(behaviour="softmax", **small)))
    assert len(records) == 4 and {record["epsilon"] for record in records} == {0.0}


@pytest.mark.parametrize(("steps", "share"), [(0, 0.5), (50, 0.3), (1000, 0.1)])
def test_epsilon_greedy_explores_with_probability_epsilon(steps, share):
    """Of two actions the other one is taken with probability ε/2."""
    agent = quick_agent(agent="dqn", epsilon_start=1.0, epsilon_end=0.2, epsilon_decay_steps=100)
    agent.steps, s = steps, states(1)[0]
    best = agent.act(s, greedy=True)
    assert np.mean([agent.act(s) != best for _ in range(4000)]) == pytest.approx(share, abs=0.03)


# --- the loop -------------------------------------------------------------------------------------


def test_a_time_limit_is_not_a_termination():
    small = dict(episodes=1, learning_starts=10_000, hidden=(4,), capacity=300)
    config = Config(env="mountaincar", **small)
    agent = make_agent(config)
    (record,) = run(config, agent)
    assert record["length"] == len(agent.replay) == 200, "a random policy reaches the time limit"
    assert not agent.replay.terminated.any()  # catches `terminated or truncated`
    assert (agent.replay.s[1:200] == agent.replay.s2[:199]).all()


def test_a_fallen_pole_terminates_only_the_last_transition():
    config = Config(episodes=2, learning_starts=10_000, hidden=(4,), capacity=300)
    agent = make_agent(config)
    lengths = [record["length"] for record in run(config, agent)]
    assert np.flatnonzero(agent.replay.terminated).tolist() == (np.cumsum(lengths) - 1).tolist()


def test_updates_start_and_repeat_as_configured():
    updates = dict(learning_starts=30, update_every=5, gradient_steps=3)
    config = Config(episodes=6, hidden=(4,), capacity=99, tau=0, **updates)
    agent = make_agent(config)
    *_, last = run(config, agent)
    assert agent.adam.t == 3 * sum(step % 5 == 0 for step in range(30, last["steps"] + 1))


def test_agents_with_the_same_seed_get_the_same_starts():
    firsts = {}
    for agent, seed in (("dqn", 0), ("gbdqn", 0), ("gbdqn", 1)):
        small = dict(episodes=3, learning_starts=10, hidden=(4,), capacity=500)
        config = Config(agent=agent, seed=seed, **small)
        learner = make_agent(config)
        ends = [0, *(record["steps"] for record in run(config, learner))][:-1]
        firsts[agent, seed] = learner.replay.s[ends].tobytes()
    assert firsts["dqn", 0] == firsts["gbdqn", 0] != firsts["gbdqn", 1]
    assert len({episode_seed(seed, k) for seed in range(20) for k in range(20)}) == 400


def test_an_evaluation_is_repeatable_and_leaves_the_agent_unchanged():
    agent = boosted()
    before = state_bytes(agent)
    env = drift.make("cartpole", [{"episode": 0, "length": 2.0}])
    returns = evaluate(agent, env, 5, seed=3)
    assert state_bytes(agent) == before
    assert returns.tolist() == evaluate(agent, env, 5, seed=3).tolist() and returns.shape == (5,)
    assert env.unwrapped.length == 1.0, "the physics of episode 0"


def test_the_loop_that_the_docs_show_trains_an_agent():
    """docs/use.md, "In your own environment", stopped after 30 episodes."""
    text = Path(__file__).parents[1].joinpath("docs", "use.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(import gymnasium.*?)```", text, re.DOTALL)
    shown = {}
    code = code.replace("range(100)", "range(30)")
    exec(code.replace("Config(", "Config(learning_starts=100, "), shown)
    agent = shown["agent"]
    assert shown["deltas"] and 100 < agent.steps == len(agent.replay) == agent.episode_start

"""The chart that detects drifts: its sum, run lengths and delays."""

from math import exp, inf, log, nan
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import SMALL, agent_of
from hypothesis import given
from hypothesis import strategies as st
from strategies import reals

from gbdqn_ref.config import Config
from gbdqn_ref.detect import LARGEST, LEAST, REFERENCE, Chart, Detector, TransitionModel, cusum
from gbdqn_ref.replay import UniformReplay
from gbdqn_ref.train import announced, make_agent, run


def definition(z, slack):
    """S_t = max_k Σ_{i > k} (z_i − κ) for every t, including the empty sum."""
    S = [[sum(z[i] - slack for i in range(k, t)) for k in range(t + 1)] for t in range(len(z) + 1)]
    return [max(sums) for sums in S[1:]]


def alarms_of(chart, values):
    """(step, estimated step of the change) of every alarm."""
    named = [(k, chart.update(x, k)) for k, x in enumerate(values)]
    return [(k, since) for k, since in named if since is not None]


def run_length(level, shift, rng):
    """Steps until cusum exceeds the level, on normal numbers with mean `shift`."""
    S, n = 0.0, 0
    while level >= S:
        S, n = cusum(S, rng.normal(shift)), n + 1
    return n


@given(st.lists(reals(), min_size=1, max_size=12), st.sampled_from([0.0, 0.5, 2.0]))
def test_the_sum_is_the_largest_over_all_starts(z, slack):
    S, sums = 0.0, []
    for each in z:
        S = cusum(S, each, slack)
        sums.append(S)
    np.testing.assert_allclose(sums, definition(z, slack), atol=1e-9)


@pytest.mark.parametrize("level", [2.0, 3.0, 4.0])
def test_without_a_shift_alarms_are_as_rare_as_theory_predicts(level):
    """Siegmund (1985): E N = (e^{2Δb} − 2Δb − 1) / (2Δ²), Δ = k = ½ and b = h + 1.166."""
    rng, b = np.random.default_rng(0), level + 1.166
    expected = (exp(b) - b - 1) / 0.5
    lengths = [run_length(level, 0.0, rng) for _ in range(400)]
    assert np.mean(lengths) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize(("shift", "episodes"), [(1.0, 10.4), (2.0, 4.01), (3.0, 2.57)])
def test_a_shift_is_found_as_fast_as_published_tables_say(shift, episodes):
    """Average run lengths at k = 0.5, h = 5 (Montgomery, Statistical Quality Control)."""
    rng = np.random.default_rng(1)
    lengths = [run_length(5.0, shift, rng) for _ in range(2000)]
    assert np.mean(lengths) == pytest.approx(episodes, rel=0.05)


@pytest.mark.parametrize(("shift", "delay"), [(2.0, 5), (4.0, 3)])
def test_the_alarm_names_the_step_of_the_change(shift, delay):
    first = []
    for seed in range(60):
        x = np.random.default_rng(seed).normal(size=140)
        x[100:] += shift
        first += [alarm for alarm in alarms_of(Chart(5.0), x) if alarm[0] >= 100][:1]
    found, named = np.array(first).T
    assert len(found) >= 55, "a false alarm just before clears the reference of a few charts"
    assert abs(np.median(named) - 100) <= 1 and np.median(found) - 100 + 1 <= delay


def test_an_alarm_clears_the_reference():
    chart = Chart(5.0)
    alarms_of(chart, [k % 2 for k in range(71)])
    assert alarms_of(chart, [9.0] * 3) == [(2, 0)]
    assert (chart.n, chart.S) == (-REFERENCE, 0.0)
    assert alarms_of(chart, [50.0] * 50) == [], "a new reference comes first"


def test_a_chart_passes_over_what_is_relearnt_after_an_alarm():
    """x falls in thirty episodes; the spread of what comes then is small, so a rise is found."""
    chart = Chart(5.0)
    relearnt = [*np.linspace(9.0, 0.0, REFERENCE), *[k % 2 for k in range(40)]]
    assert alarms_of(chart, relearnt) == []
    assert np.sqrt(chart.variance) == pytest.approx(0.5, rel=0.05)


def test_a_single_value_never_raises_an_alarm():
    chart = Chart(LARGEST)
    alarms_of(chart, [k % 2 for k in range(91)])
    assert chart.update(1e9, 91) is None and chart.S == LARGEST - 0.5
    assert abs(chart.mean) < 1, "nor does it shift the reference"


def test_the_reference_follows_an_agent_that_learns():
    """x falls as the returns rise without an alarm; then the values from the start raise one."""
    chart = Chart(5.0)
    noise = np.random.default_rng(0).normal(size=200)
    assert alarms_of(chart, np.linspace(500, 0, 200) + noise) == []
    assert alarms_of(chart, [500.0] * 5)


def test_a_chart_that_started_with_constant_returns_still_sees_a_fall():
    """MountainCar's first returns are all −200, so the spread starts at 0."""
    chart = Chart(5.0)
    learning = [200.0] * 35 + [*np.linspace(200, 120, 80)] + [120.0 + k % 2 for k in range(60)]
    assert alarms_of(chart, learning) == []
    assert alarms_of(chart, [200.0] * 6)


def test_there_is_no_alarm_before_the_reference_is_known():
    assert alarms_of(Chart(0.1), [0.0] * (2 * REFERENCE - 5) + [100.0] * 5) == []


def charted(symptom, *episode, model=None):
    """The number that a detector charts for an episode, or None."""
    detector, seen = Detector(symptom, 5.0, model), [None]
    detector.chart.update = lambda x, at: seen.append(x)
    detector.update(*episode)
    return seen[-1]


def test_a_symptom_rises_when_things_get_worse():
    assert charted("return", None, 0, -80.0, nan) == 80.0
    assert charted("return", None, 0, -200.0, nan) == 200.0
    assert charted("td_error", None, 0, 0.0, 2.0) == log(2.0)
    assert charted("td_error", None, 0, 0.0, nan) is charted("td_error", None, 0, 0.0, 0.0) is None


def test_a_model_is_shown_the_transitions_of_the_episode():
    """Also if the ring has wrapped around, and if the episode is longer than the ring."""
    replay, seen = UniformReplay(8, 1), []
    for k in range(11):
        replay.add([float(k)], k % 2, 0.0, [k + 0.5], False)
    model = SimpleNamespace(
        update=lambda replay, index: seen.append(replay.s[index, 0]) or exp(3.0)
    )
    assert charted("model", replay, 7, 0.0, nan, model=model) == pytest.approx(3.0)
    charted("model", replay, 0, 0.0, nan, model=model)
    perfect = SimpleNamespace(update=lambda replay, index: 0.0)
    assert charted("model", replay, 7, 0.0, nan, model=perfect) is None
    assert [s.tolist() for s in seen] == [[7, 8, 9, 10], [3, 4, 5, 6, 7, 8, 9, 10]]


def episode(replay, rng, n, pull):
    """Add n transitions of a linear world, in which action 1 pulls and 0 pushes; their slots."""
    for s in rng.normal(size=(n, 2)) * [1.0, 100.0]:
        a = int(rng.integers(2))
        step = [0.01 * s[1], pull * (2 * a - 1)]
        replay.add(s, a, 0.0, s + step, False)
    return np.arange(replay.added - n, replay.added) % replay.capacity


def test_a_models_error_falls_with_learning_and_rises_when_the_physics_change():
    """Both coordinates count, although their sizes differ a hundredfold."""
    rng, replay = np.random.default_rng(0), UniformReplay(4000, 2)
    model = TransitionModel(2, 2, rng)
    errors = [model.update(replay, episode(replay, rng, 100, 0.5)) for _ in range(200)]
    assert errors[0] > 0.5 and errors[-1] < 0.05
    assert model.update(replay, episode(replay, rng, 100, -0.5)) > 10 * errors[-1]


def test_a_models_error_is_the_median_before_it_learns():
    """By hand, with the zero network: the steps in units of their mean size, 2."""
    model, replay = TransitionModel(1, 2, np.random.default_rng(0)), UniformReplay(8, 1)
    model.theta[...] = 0.0
    for s, step in ((1.0, 0.0), (2.0, 1.0), (3.0, 5.0)):
        replay.add([s], 0, 0.0, [s + step], False)
    assert model.update(replay, np.arange(3)) == pytest.approx(0.5)
    np.testing.assert_allclose(model.sizes[:, 0], [6.0, 6.0])
    assert model.n == 3 and model.adam.t == LEAST and model.update(replay, np.arange(3)) != 0.5


def test_a_model_learns_only_from_what_the_replay_holds():
    """After a drop no draw is of the old physics."""
    replay, rng = UniformReplay(4000, 2), np.random.default_rng(0)
    model, drawn = TransitionModel(2, 2, rng), []
    episode(replay, rng, 100, 0.5)
    replay.keep(0)
    index = episode(replay, rng, 100, -0.5)
    errors = model._errors
    model._errors = lambda replay, slots: drawn.extend(slots) or errors(replay, slots)
    model.update(replay, index)
    assert set(drawn) <= set(range(100, 200)) and len(drawn) == 100 + 64 * 12


@pytest.mark.parametrize("agent", ["dqn", "gbdqn", "gbdqn-reuse", "dqn-reuse", "reset"])
def test_an_agent_that_detects_does_not_see_the_schedule(monkeypatch, agent):
    """Its run is the same without the announced events."""
    schedule = [{"episode": 4, "length": 2}, {"episode": 7, "reset": True}]
    config = Config(agent=agent, drift_signal="detector", **SMALL | dict(schedule=schedule))
    told = [repr(record) for record in run(config)]
    monkeypatch.setattr("gbdqn_ref.train.announced", lambda *_: None)
    assert [repr(record) for record in run(config)] == told


def test_the_drift_signal_decides_which_events_are_announced():
    assert announced("schedule", 4, "reset") == "reset" and announced("schedule", 4, None) is None
    assert announced("detector", 4, "drift") is None
    assert announced([3, 4], 4, None) == "drift" and announced([3], 4, "drift") is None
    assert announced([], 4, "drift") is None


def test_a_list_of_episodes_announces_a_drift_in_each():
    heard = []
    config = Config(agent="dqn", drift_signal=[2, 5], **SMALL | dict(schedule=[], episodes=7))
    agent = make_agent(config)
    agent.on_drift = lambda event: heard.append((event, agent.steps))
    steps = [record["steps"] for record in run(config, agent)]
    assert heard == [("drift", steps[1]), ("drift", steps[4])]


def fall(agent, before, after):
    """Play ten-step episodes with these returns; the steps at which the agent raised alarms."""
    s = np.zeros(4, np.float32)
    for total in [*before, *after]:
        for _ in range(10):
            agent.observe(s, 0, 0.0, s, False)
        agent.end_episode(total, nan)
    return agent.alarms.tolist()


def test_an_alarm_is_a_drift_and_counts_the_data_since_the_change(monkeypatch):
    agent, told = agent_of("dqn", drift_signal="detector", capacity=1000), []
    monkeypatch.setattr(agent, "on_drift", lambda event, fresh: told.append((event, fresh)))
    alarms = fall(agent, [100.0 + k % 2 for k in range(70)], [20.0] * 3)
    assert alarms == [730]
    assert told == [("drift", 30)]


@pytest.mark.parametrize("level", [2.0, inf])
def test_the_chart_uses_the_alarm_level_of_the_config(level):
    agent = agent_of("dqn", drift_signal="detector", alarm_level=min(level, 1e9), capacity=1000)
    alarms = fall(agent, [100.0 + k % 2 for k in range(70)], [20.0] * 30)
    assert alarms == ([710] if level == 2.0 else [])

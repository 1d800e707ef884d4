"""The summary and the records of a run, checked by hand on a few episodes."""

from types import SimpleNamespace

import numpy as np
import pytest

from gbdqn_ref import runs, train
from gbdqn_ref.config import Config
from gbdqn_ref.replay import RecencyReplay

CONFIG = Config(agent="dqn", seed=7, episodes=63, schedule=[{"episode": 3, "length": 2}])


def record(episode, returns, steps, evaluation=()):
    place = {"episode": episode, "regime": int(episode >= 3)}
    event = {"event": "drift" if episode == 3 else ""}
    return place | event | {"return": returns, "steps": steps, "evaluation": list(evaluation)}


def agent(replay=None):
    return SimpleNamespace(replay=replay)


def test_a_summary_has_the_settings_and_results_of_a_run():
    """The random policy has 10, the regime before 110: 60 is level 0.5 and 100 is 0.9."""
    before = [record(0, 109.0, 5), record(1, 110.0, 9), record(2, 111.0, 12, [3.0, 4.0])]
    after = [record(k, 60.0 if k < 23 else 100.0, 10 * k) for k in range(3, 62)]
    last = record(62, 100.0, 999, [5.0, 6.0])
    summary = runs.summarise(CONFIG, agent(), [*before, *after, last], 10.0)
    mean = (20 * 60 + 40 * 100) / 60
    area = (20 * 0.5 + 40 * 0.9) / 60
    first, second = summary.pop("regimes")
    place = dict(regime=0, first_episode=0, episodes=3, event="", mean_return=110.0)
    assert first == place | dict(drop=None, recovery=None, area=None)
    place = dict(regime=1, first_episode=3, episodes=60, event="drift")
    levels = dict(mean_return=pytest.approx(mean), area=pytest.approx(area))
    assert second == place | levels | dict(drop=0.5, recovery=30)
    settings = dict(env="cartpole", agent="dqn", seed=7, episodes=63, steps=999)
    returns = dict(final_return=(10 * 60 + 40 * 100) / 50, random_return=10.0)
    assert summary == settings | returns | dict(evaluation=[[3.0, 4.0], [5.0, 6.0]])


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_the_share_by_recency_is_1_minus_the_td_share(monkeypatch, share):
    replay = object.__new__(RecencyReplay)
    monkeypatch.setattr(RecencyReplay, "td_share", lambda self: share)
    summary = runs.summarise(CONFIG, agent(replay), [record(0, 1.0, 1)], 0.0)
    assert summary["recency_share_of_replay"] == 1 - share


def test_level_0_is_the_random_policy_in_the_stock_physics():
    """20 greedy episodes with seed 0, under any schedule and seed of the run."""
    random = train.make_agent(Config(agent="random"))
    returns = train.evaluate(random, train.drift.make("cartpole"), 20, seed=0)
    config = Config(seed=9, schedule=[{"episode": 0, "gravity": 9}])
    assert runs.random_return(config) == returns.mean()
    assert runs.random_return(config, 3) == returns[:3].mean()


class Stub:
    """Acts at random and learns nothing; its TD errors are −1 and 3, then 2 and −6."""

    epsilon = 0.25

    def __init__(self, config):
        self.config, self.learning_starts = config, config.learning_starts
        self.steps, self.events, self.rng = 0, [], np.random.default_rng(0)
        self.deltas = [np.array([2.0, -6.0]), np.array([-1.0, 3.0])]

    def act(self, s, greedy=False):
        return int(self.rng.integers(2))

    def observe(self, *_):
        self.steps += 1

    def learn(self):
        return self.deltas.pop() if self.deltas else np.array([3.0])

    def on_drift(self, event):
        self.events.append((self.steps, event))

    def end_episode(self, total, td_error):
        self.events.append((self.steps, total, td_error))

    def finish(self):
        return self


def test_a_record_has_the_mean_absolute_td_error():
    """(1 + 3 + 2 + 6 + n · 3) / (4 + n) is 3 for any number of updates."""
    config = Config(episodes=1, learning_starts=1, update_every=2)
    stub = Stub(config)
    (record,) = train.run(config, stub)
    assert record["td_error"] == 3 and not stub.deltas
    assert stub.events == [(record["steps"], record["return"], 3)]
    assert (record["epsilon"], record["length"]) == (0.25, record["steps"])


def test_a_record_without_an_update_has_no_td_error():
    config = Config(episodes=1, learning_starts=1000)
    (record,) = train.run(config, Stub(config))
    assert np.isnan(record["td_error"])

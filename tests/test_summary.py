"""What is stored of a run, worked out by hand from a few episodes."""

from types import SimpleNamespace

import numpy as np
import pytest

from gbdqn_ref import runs, train
from gbdqn_ref.config import Config
from gbdqn_ref.replay import RecencyReplay

CONFIG = Config(agent="dqn", seed=7, episodes=63, schedule=[{"episode": 3, "length": 2}])


def record(episode, returns, steps, evaluation=()):
    regime = int(episode >= 3)
    event = "drift" if episode == 3 else ""
    return {
        "episode": episode, "regime": regime, "event": event, "return": returns, "steps": steps,
        "evaluation": list(evaluation),
    }  # fmt: skip


def agent(replay=None):
    return SimpleNamespace(replay=replay)


def test_a_summary_says_what_was_run_and_how_it_went():
    """Levels: the random policy at 10, 110 before the drift; 60 is half of that, 100 is 0.9."""
    before = [record(0, 109.0, 5), record(1, 110.0, 9), record(2, 111.0, 12, [3.0, 4.0])]
    after = [record(k, 60.0 if k < 23 else 100.0, 10 * k) for k in range(3, 62)]
    last = record(62, 100.0, 999, [5.0, 6.0])
    summary = runs.summarise(CONFIG, agent(), [*before, *after, last], 10.0)
    mean = (20 * 60 + 40 * 100) / 60
    area = (20 * 0.5 + 40 * 0.9) / 60
    assert summary["regimes"].pop(1) == {
        "regime": 1, "first_episode": 3, "episodes": 60, "event": "drift",
        "mean_return": pytest.approx(mean), "drop": 0.5, "recovery": 30,
        "area": pytest.approx(area),
    }  # fmt: skip
    assert summary == {
        "env": "cartpole", "agent": "dqn", "seed": 7, "episodes": 63, "steps": 999,
        "final_return": (10 * 60 + 40 * 100) / 50, "random_return": 10.0,
        "regimes": [
            {"regime": 0, "first_episode": 0, "episodes": 3, "event": "", "mean_return": 110.0,
             "drop": None, "recovery": None, "area": None},
        ],
        "evaluation": [[3.0, 4.0], [5.0, 6.0]],
    }  # fmt: skip


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_the_share_by_recency_is_what_the_td_errors_leave(monkeypatch, share):
    replay = object.__new__(RecencyReplay)
    monkeypatch.setattr(RecencyReplay, "td_share", lambda self: share)
    summary = runs.summarise(CONFIG, agent(replay), [record(0, 1.0, 1)], 0.0)
    assert summary["recency_share_of_replay"] == 1 - share


def test_the_zero_of_the_scale_is_the_random_policy_in_the_stock_physics():
    """20 greedy episodes with the seed 0, whatever the run's schedule and seed say."""
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


def test_a_record_has_the_mean_size_of_the_td_errors():
    """(1 + 3 + 2 + 6 + n · 3) / (4 + n) is 3, however many updates there are."""
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

"""What a drift costs, on policies whose returns are known."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers import SMALL, drifts_at, flags, refused

from gbdqn_ref import effect
from gbdqn_ref.__main__ import main
from gbdqn_ref.config import Config

DRIFTING = SMALL | dict(episodes=3, learning_starts=10, schedule=drifts_at(1, 2, 3))


def policy(returns):
    return SimpleNamespace(returns=np.asarray(returns, float))


@pytest.mark.parametrize(
    ("random", "frozen", "trained", "lost"),
    [
        (0, 50, 100, 0.5),
        (-500, -100, -100, 0.0),
        (-200, -200, -120, 1.0),
        (20, 120, 100, -0.25),  # frozen does better than trained
        (100, 50, 100, None),  # trained is random
        (100, 50, 60, None),
    ],
)
def test_what_is_lost_is_a_part_of_the_span(monkeypatch, random, frozen, trained, lost):
    monkeypatch.setattr(effect, "evaluate", lambda policy, env, episodes, seed: policy.returns)
    policies = [policy([level, level]) for level in (random, frozen, trained)]
    row = effect._levels(None, policies, 2)
    assert (row["random"], row["frozen"], row["trained"], row["lost"]) == (
        random,
        frozen,
        trained,
        lost,
    )


def test_two_standard_errors_decide_whether_a_regime_was_learnt(monkeypatch):
    """(90, 110) has a standard error of 10, so 100 is learnt where random is below 80."""
    monkeypatch.setattr(effect, "evaluate", lambda policy, env, episodes, seed: policy.returns)
    for random, learnt in ((79, True), (81, False)):
        row = effect._levels(None, [policy([random] * 2), policy([0, 0]), policy([90, 110])], 2)
        assert (row["lost"] is not None) == learnt


def test_every_regime_is_trained_once_and_evaluated_in_its_own_physics(tmp_path, monkeypatch):
    config, seen = Config.preset("cartpole", agent="dqn", **DRIFTING), []
    levels = effect._levels

    def looked_at(env, policies, episodes):
        env.reset(seed=0)
        seen.append(
            (float(env.unwrapped.length), float(env.unwrapped.gravity), policies[1] is policies[2])
        )
        return levels(env, policies, episodes)

    monkeypatch.setattr(effect, "_levels", looked_at)
    first = effect.drift_effect(config, tmp_path, episodes=2, quiet=True)
    assert [row["regime"] for row in first] == [
        "stock physics",
        "length × 2",
        "gravity × 2, length × 2",
    ]
    assert seen == [(0.5, 9.8, True), (1.0, 9.8, False), (1.0, 19.6, False)]
    ages = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/*")}
    assert effect.drift_effect(config, tmp_path, episodes=2, quiet=True) == first
    assert ages == {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/*")}
    assert len(list(tmp_path.glob("*/summary.json"))) == 3


def test_the_command_prints_a_row_per_regime(tmp_path, capsys, monkeypatch):
    rows = [
        {"regime": "stock physics", "random": 1.0, "frozen": 9.0, "trained": 9.0, "lost": 0.0},
        {"regime": "length × 2", "random": 1.0, "frozen": 5.0, "trained": 9.0, "lost": 0.5},
        {"regime": "gravity × 2", "random": 1.0, "frozen": 5.0, "trained": 1.0, "lost": None},
    ]
    monkeypatch.setattr(effect, "drift_effect", lambda *args, **options: rows)
    assert main(["drift-effect", "--env", "cartpole", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "length × 2          1.0      5.0      9.0     50%" in printed
    assert "gravity × 2         1.0      5.0      1.0       –" in printed
    assert "1 of 2 drifts cost at least a fifth" in printed


def test_a_run_of_other_settings_in_the_folder_is_refused(tmp_path, capsys):
    arguments = ["drift-effect", "--env", "cartpole", "--out", str(tmp_path), "--quiet"]
    arguments += flags(**DRIFTING | dict(schedule=[]))
    assert main(arguments) == 0
    capsys.readouterr()
    refused(capsys, tmp_path, [*arguments, "--set", "gamma=0.5"], "has other settings")

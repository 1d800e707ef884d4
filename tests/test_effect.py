"""What a drift costs, computed from policies with known returns."""

import numpy as np
import pytest
from helpers import SMALL, Here, drifts_at, flags, refused

from gbdqn_ref import StudyError, UsageError, drift, effect, runs
from gbdqn_ref.__main__ import main
from gbdqn_ref.config import Config
from gbdqn_ref.schedule import describe
from gbdqn_ref.train import evaluate, make_agent

DRIFTING = SMALL | dict(episodes=3, learning_starts=10, schedule=drifts_at(1, 2, 3))


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
def test_lost_is_the_share_of_the_gain_that_frozen_misses(random, frozen, trained, lost):
    returns = [np.array([level - 0.01, level + 0.01]) for level in (random, frozen, trained)]
    row = effect.cost(*returns)
    assert row == {"random": random, "frozen": frozen, "trained": trained, "lost": lost}
    assert {type(value) for value in row.values()} <= {float, type(None)}


def test_two_standard_errors_of_the_trained_policy_decide_whether_a_regime_was_learnt():
    """(90, 110) has a standard error of 10, so 100 shows learning if random is below 80."""
    frozen, trained = np.zeros(2), np.array([90.0, 110.0])
    for random, learnt in ((79, True), (81, False)):
        row = effect.cost(np.array([random - 50.0, random + 50.0]), frozen, trained)
        assert (row["lost"] is not None) == learnt


def test_every_regime_is_trained_once_and_evaluated_in_its_physics(tmp_path):
    """Frozen is always the agent trained in the stock physics; all evaluations use seed 0."""
    learning = dict(episodes=8, update_every=1, gradient_steps=4, lr=0.03)
    config = Config.preset("cartpole", agent="dqn", seed=3, **DRIFTING | learning)
    options = dict(episodes=2, executor=Here(), quiet=True)
    first = effect.drift_effect(config, tmp_path, **options)
    regimes = {
        "stock physics": {},
        "length × 2": {"length": 2},
        "gravity × 2, length × 2": {"gravity": 2, "length": 2},
    }
    assert [row["regime"] for row in first] == list(regimes)
    agents = {}
    for path in tmp_path.glob("*/config.json"):
        trained_in, agent = runs.read_agent(path.parent)
        agents[describe(trained_in.regimes[0].factors)] = agent
        assert (len(trained_in.regimes), trained_in.seed) == (1, 3)
    assert set(agents) == set(regimes)
    random = make_agent(Config(agent="random"))
    for row, (name, factors) in zip(first, regimes.items(), strict=True):
        env = drift.make("cartpole", [{"episode": 0, **factors}] if factors else [])
        policies = {"random": random, "frozen": agents["stock physics"], "trained": agents[name]}
        for key, agent in policies.items():
            assert row[key] == evaluate(agent, env, 2, seed=0).mean(), (name, key)
    assert any(row["frozen"] != row["trained"] for row in first)
    ages = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/*")}
    assert effect.drift_effect(config, tmp_path, **options) == first
    assert ages == {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/*")}
    assert len(list(tmp_path.glob("*/summary.json"))) == 3


def test_regimes_equal_to_six_digits_are_still_distinct(tmp_path):
    """Regimes are told apart by their factors. One that returns is not trained again."""
    schedule = [
        {"episode": 1, "length": 1.0000001},
        {"episode": 2, "length": 1.0000002},
        {"episode": 3, "gravity": 1.0},
        {"episode": 4, "length": 1.0000001},
    ]
    config = Config(agent="random", **SMALL | dict(episodes=5, schedule=schedule))
    rows = effect.drift_effect(config, tmp_path, episodes=2, executor=Here(), quiet=True)
    names = ["stock physics", "length × 1.0000001", "length × 1.0000002"]
    assert [row["regime"] for row in rows] == names
    trained = effect.regimes(config)
    lengths = [each.regimes[0].factors["length"] for each in trained.values()]
    assert lengths == [1, 1.0000001, 1.0000002]
    assert {path.parent.name for path in tmp_path.glob("*/summary.json")} == set(trained)


def test_drift_effect_needs_at_least_two_episodes(tmp_path):
    with pytest.raises(UsageError, match="at least 2 episodes, not 1"):
        effect.drift_effect(Config(agent="random"), tmp_path / "out", episodes=1)
    assert not (tmp_path / "out").exists()


def test_a_failed_run_leaves_no_table(tmp_path):
    config = Config(agent="random", **DRIFTING)
    first, *others = effect.regimes(config)
    (tmp_path / "study.json").write_text('{"settings": {}}')
    (tmp_path / first).touch()
    with pytest.raises(StudyError, match=f"{first}: UsageError: .* is not a folder"):
        effect.drift_effect(config, tmp_path, executor=Here(), quiet=True)
    assert all((tmp_path / name / "summary.json").exists() for name in others)


@pytest.mark.parametrize("jobs", ["0", "-1", "1001"])
def test_a_wrong_number_of_processes_is_refused(tmp_path, capsys, jobs):
    arguments = ["drift-effect", "--jobs", jobs, "--out", str(tmp_path / "out")]
    refused(capsys, tmp_path, arguments, "jobs must be a whole number from 1 to 1,000")


def test_the_command_prints_a_row_per_regime(tmp_path, capsys, monkeypatch):
    rows = [
        {"regime": "stock physics", "random": 1.0, "frozen": 9.0, "trained": 9.0, "lost": 0.0},
        {"regime": "length × 2", "random": 1.0, "frozen": 5.0, "trained": 9.0, "lost": 0.5},
        {"regime": "gravity × 2", "random": 1.0, "frozen": 5.0, "trained": 1.0, "lost": None},
    ]
    monkeypatch.setattr(effect, "drift_effect", lambda *args, **options: rows)
    assert main(["drift-effect", "--env", "cartpole", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "length × 2        1.0     5.0      9.0   50%\n" in printed
    assert "gravity × 2       1.0     5.0      1.0     –\n" in printed
    assert "\n1 of 2 drifts cost at least 20% of the gain\n" in printed


def test_a_folder_with_other_settings_is_refused(tmp_path, capsys):
    arguments = ["drift-effect", "--env", "cartpole", "--out", str(tmp_path), "--quiet"]
    arguments += flags(**DRIFTING | dict(schedule=[]))
    assert main(arguments) == 0
    capsys.readouterr()
    refused(capsys, tmp_path, [*arguments, "--set", "gamma=0.5"], "has other settings")

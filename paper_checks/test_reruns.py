"""Our reruns of the paper's tables: the page says what the stored results say, and the results are
what a run gives.
"""

import re

import numpy as np
import pytest
import reruns
from worlds import mean_return

from gbdqn_ref import files, runs
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import Config
from gbdqn_ref.train import run

PAGE = reruns.FOLDER / "README.md"
SHORT = reruns.FOLDER / "short.json"
TEXT = reruns.FOLDER / "text.md"
OTHERS = [(study, name) for study, readings in reruns.READINGS.items() for name in readings if name]
COMPARED = [agent for agent in AGENTS if not agent.endswith("-reuse")]
CONTROLLED = ["gbdqn", "dqn", "random", "dqn-recency", "gbdqn-per"]
PART = {  # study: its agents and how many seeds, where they are not all and five
    "hopper-long": (CONTROLLED, 3),
    "acrobot-hard": (CONTROLLED, 15),
    "mountaincar-hard": (CONTROLLED, 15),
}


def settings(study, **changes):
    """The settings of a study's preset as results.json has them."""
    values = Config.preset(*reruns.STUDIES[study], **changes).resolved().to_dict()
    return {key: values[key] for key in reruns.stored(study)["settings"]}


def test_the_page_is_what_the_results_give(request):
    """Tables and text; --ledger writes it."""
    made = reruns.page()
    if request.config.getoption("--ledger"):
        files.write_atomically(PAGE, lambda file: file.write(made.encode()))
    assert PAGE.read_text(encoding="utf-8") == made


@pytest.mark.parametrize("study", reruns.STUDIES)
def test_the_results_are_those_of_the_preset(study):
    """All agents that were promised, all seeds, every setting as Config.preset has it today."""
    results = reruns.stored(study)
    agents, seeds = PART.get(study, (COMPARED, 5))
    assert results["settings"] == settings(study)
    assert results["seeds"] == list(range(seeds)) and set(results["agents"]) == set(agents)
    assert sorted((row["agent"], row["seed"]) for row in results["runs"]) == sorted(
        (agent, seed) for agent in agents for seed in range(seeds)
    )


@pytest.mark.parametrize(("study", "name"), OTHERS)
def test_the_readings_differ_from_the_preset_by_what_they_say(study, name):
    """Their settings are the preset\'s with these changes, and their seeds the same."""
    results = reruns.stored(f"{study}-{name}")
    assert results["settings"] == settings(study, **reruns.READINGS[study][name])
    assert (
        [row["seed"] for row in results["runs"]]
        == results["seeds"]
        == reruns.stored(study)["seeds"]
    )


def test_the_longer_hopper_has_something_to_lose_at_its_first_drift():
    """On every seed DQN's greedy policy is by then well above doing nothing, and that above the
    random policy (D17).
    """
    before = {
        agent: [
            row["evaluation"][0][0]
            for row in reruns.stored("hopper-long")["runs"]
            if row["agent"] == agent
        ]
        for agent in ("dqn", "random")
    }
    nothing = mean_return("hopper", lambda: 0, episodes=5)
    assert min(before["dqn"]) > 1.4 * nothing and nothing > 5 * max(before["random"])
    figures = "{:.0f}, {:.0f} and {:.0f}".format(*before["dqn"])
    assert figures in (PAGE.parents[1] / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("env", ["acrobot", "mountaincar", "cartpole"])
def test_the_random_runs_can_be_repeated_here(env):
    """They use no matrix product, so they give the same numbers on every machine."""
    stored = [
        row for row in reruns.stored(env)["runs"] if row["agent"] == "random" and row["seed"] == 0
    ]
    episodes = list(run(Config.preset(env, agent="random", seed=0)))
    assert np.mean([record["return"] for record in episodes[-50:]]) == stored[0]["final_return"]
    assert episodes[-1]["evaluation"] == stored[0]["evaluation"][-1]


def test_a_short_run_of_gb_dqn_can_be_repeated_here(tmp_path, request):
    """To the byte where the machine computes alike; elsewhere in its config, columns and all before
    learning starts.
    """
    config = Config(
        episodes=40,
        learning_starts=200,
        hidden=[16],
        schedule=[{"episode": 20, "length": 2.0}],
        seed=1,
    )
    runs.train(config, tmp_path / "run", quiet=True)
    csv = (tmp_path / "run" / "episodes.csv").read_text()
    made = {
        "fingerprint": reruns.fingerprint(),
        "config": config.to_dict(),
        "episodes.csv": csv.splitlines(),
    }
    if request.config.getoption("--ledger"):
        files.write_json(SHORT, made)
    stored = files.read_json(SHORT, *made)
    assert Config.from_dict(stored["config"]).resolved() == config.resolved()
    untaught = sum(
        int(line.split(",")[5]) < config.learning_starts for line in made["episodes.csv"][1:]
    )
    assert 3 < untaught < 20
    same = None if stored["fingerprint"] == made["fingerprint"] else 1 + untaught
    assert stored["episodes.csv"][:same] == made["episodes.csv"][:same]
    assert len(stored["episodes.csv"]) == 1 + config.episodes


def test_control_the_record_has_more_than_what_precedes_learning():
    """Another seed of the network's generator gives other lines, before and after
    learning starts.
    """
    stored = files.read_json(SHORT, "config", "episodes.csv")
    other = list(run(Config.from_dict(stored["config"] | {"seed": 2})))
    returns = [float(line.split(",")[3]) for line in stored["episodes.csv"][1:]]
    assert [record["return"] for record in other[:5]] != returns[:5]


def test_control_the_table_changes_with_a_result(monkeypatch):
    """One other final return, and the page would have to say something else."""
    before, results = reruns.table("acrobot", {}), reruns.stored("acrobot")
    results["runs"][0]["final_return"] += 10
    monkeypatch.setattr(reruns, "stored", lambda study: results)
    assert reruns.table("acrobot", {}) != before


def test_control_the_text_changes_with_a_result(monkeypatch):
    """With GB-DQN's final returns on MountainCar higher by 30, it would be detectably better."""
    stored = reruns.stored

    def other(name):
        results = stored(name)
        for row in results["runs"]:
            row["final_return"] += 30 * (row["agent"] == "gbdqn" and name == "mountaincar")
        return results

    assert "GB-DQN (above" not in ", ".join(reruns.differing("mountaincar")[0])
    monkeypatch.setattr(reruns, "stored", other)
    assert "GB-DQN (above" in ", ".join(reruns.differing("mountaincar")[0])
    assert "MountainCar (" in reruns.effects("boosting", 1)


def test_no_figure_of_the_text_is_typed():
    """No decimal, sign or number of two digits but those that define: 95 %, 50 episodes, and runs
    of 3, 5 and 15; commands and deviations aside.
    """
    text = re.sub(r"`[^`]*`|{[^{}]*}|\bD\d+|\[X\d+\]\(\S+\)", "", TEXT.read_text(encoding="utf-8"))
    found = re.findall(r"[-+−]?\d+\.\d+|[-+−]\d+|\d[\d,]*\d", text)
    assert set(found) <= {"95", "50", "15"}


def test_what_the_first_lines_say_is_what_the_results_say():
    """That GB-DQN is detectably above DQN in one study, that boosting helps in none, and that the
    literal readings hardly learn MountainCar.
    """
    above = [
        study
        for study in reruns.STUDIES
        if any(text.startswith("GB-DQN (above") for text in reruns.differing(study)[0])
    ]
    assert above == ["mountaincar-hard"]
    assert reruns.effects("boosting", 1) == "none of them"
    assert "MountainCar, hard" in reruns.effects("replay", 1)
    assert "CartPole" in reruns.effects("boosting", -1)
    for study in ("acrobot", "cartpole"):
        assert "Frozen DQN" in reruns.differing(study)[1]
    literal = reruns.stored("mountaincar-frozen-h")["runs"]
    assert {run["final_return"] for run in literal} == {-200.0}
    assert "GB-DQN" in set.intersection(
        *(set(reruns.differing(study)[1]) for study in ("acrobot", "mountaincar", "hopper"))
    )

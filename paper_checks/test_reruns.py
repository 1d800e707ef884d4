"""Our reruns of the paper's tables: the page says what the stored results say, and the results are what a run gives."""

import json
import re

import numpy as np
import pytest
import reruns
from test_experiments import TABLES

from gbdqn_ref.config import Config
from gbdqn_ref.train import run

PAGE = reruns.FOLDER / "README.md"
NAMES = {"dqn": "DQN", "gbdqn": "GB-DQN", "ensemble": "Ensemble", "reset": "Reset", "sliding": "Sliding"}
RERUN = {"acrobot": "Acrobot"}


@pytest.mark.parametrize("env", RERUN)
def test_the_page_has_the_table_that_the_results_give(env, request):
    printed = {agent: TABLES[RERUN[env]][name] for agent, name in NAMES.items()}
    begin, end = f"<!-- {env} -->\n\n", f"\n<!-- end of {env} -->"
    page, text = PAGE.read_text(encoding="utf-8"), reruns.table(reruns.stored(env), printed)
    if request.config.getoption("--ledger"):
        PAGE.write_text(page.split(begin)[0] + begin + text + end + page.split(end)[1], encoding="utf-8")
    else:
        assert page.split(begin)[1].split(end)[0] == text


@pytest.mark.parametrize("env", RERUN)
def test_the_results_are_those_of_the_preset(env):
    """All agents, five seeds, every setting as Config.preset has it today."""
    results = reruns.stored(env)
    settings = Config.preset(env).to_dict()
    assert results["settings"] == {key: settings[key] for key in settings if key not in ("agent", "seed", "replay")}
    assert results["seeds"] == [0, 1, 2, 3, 4]
    assert len(results["runs"]) == 5 * len(results["agents"])


@pytest.mark.parametrize("env", RERUN)
def test_the_random_runs_can_be_repeated_here(env):
    """They use no matrix product, so they give the same numbers on every machine."""
    stored = [row for row in reruns.stored(env)["runs"] if row["agent"] == "random" and row["seed"] == 0]
    episodes = list(run(Config.preset(env, agent="random", seed=0)))
    assert np.mean([record["return"] for record in episodes[-50:]]) == stored[0]["final_return"]
    assert episodes[-1]["evaluation"] == stored[0]["evaluation"][-1]


def test_control_the_table_changes_with_a_result():
    """Negative control: one other final return, and the page would have to say something else."""
    results = json.loads(json.dumps(reruns.stored("acrobot")))
    before = reruns.table(results, {})
    results["runs"][0]["final_return"] += 10
    assert reruns.table(results, {}) != before


@pytest.mark.parametrize("env", RERUN)
def test_the_text_states_no_number_that_the_table_does_not_give(env):
    """Whatever has a decimal or a sign; whole numbers of episodes are in words of the table or of the preset."""
    section = PAGE.read_text(encoding="utf-8").split(f"<!-- {env} -->")[1]
    table, prose = section.split(f"<!-- end of {env} -->")
    numbers = re.findall(r"[-+]?\d+\.\d+", prose.split("\n## ")[0])
    assert len(numbers) > 5
    for number in numbers:
        assert re.search(rf"(?<![\d.]){re.escape(number)}(?![\d.])", table) or f"-{number} [" in table, number

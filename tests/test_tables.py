"""The printed tables, checked by hand on a few summaries."""

import json
import re

import numpy as np
import pytest

from gbdqn_ref import stats, tables
from gbdqn_ref.__main__ import main
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import SETTINGS, Config
from gbdqn_ref.tables import Table

SCHEDULE = [{"episode": 20, "gravity": 1.3}, {"episode": 40, "reset": True}]
CONFIG = Config(env="mountaincar", agent="gbdqn", seed=7, episodes=60, schedule=SCHEDULE)


def regime(mean=0.0, drop=None, recovery=None):
    """One row of stats.regime_table."""
    area = None if drop is None else 1 - drop
    return {"mean_return": mean, "drop": drop, "recovery": recovery, "area": area}


def summary(final=0.0, regimes=((), (), ()), seed=0, **more):
    """The fields of a run's summary.json that the tables read."""
    rows = [regime(*row) for row in regimes]
    return {"final_return": final, "random_return": -199.96, "seed": seed, "regimes": rows} | more


def finals(*values, seeds=None):
    """The summaries of an agent's runs with these final returns."""
    seeds = range(len(values)) if seeds is None else seeds
    return [summary(final, seed=seed) for final, seed in zip(values, seeds, strict=True)]


# --- printing -------------------------------------------------------------------------------------


def test_names_are_printed_left_aligned_and_numbers_right_aligned(capsys):
    rows = [["a", "1.0", ""], ["long name", "-22.5", "9"]]
    tables.show(Table("a title", ["what", "x", "wide column"], rows, ["one note", "another"]))
    assert capsys.readouterr().out.splitlines() == [
        "",
        "a title",
        "",
        "what           x  wide column",
        "a            1.0",
        "long name  -22.5            9",
        "",
        "one note",
        "another",
    ]


def test_a_row_with_a_missing_cell_is_an_error():
    with pytest.raises(ValueError, match="zip"):
        tables.show(Table("", ["a", "b"], [["1"]], []))


# --- the regimes of one run -----------------------------------------------------------------------


def test_the_table_of_regimes():
    gbdqn = summary(-131.25, [(-150.04,), (-199.0, 0.914, None), (-130, -0.5, 12)])
    dqn = summary(-121.0, [(-160.0,), (-140, 0.0, 10), (-200, None, None)])
    gbdqn["recency_share_of_replay"] = 0.306
    shown = tables.regimes({"gbdqn": gbdqn, "dqn": dqn}, CONFIG)
    assert shown.title == "MountainCar, seed 7: mean return, drop and recovery per regime"
    assert shown.columns == ["regime", "GB-DQN", "drop", "recovery", "DQN", "drop", "recovery"]
    assert shown.rows == [
        ["0  stock physics", "-150.0", "–", "–", "-160.0", "–", "–"],
        ["1  gravity × 1.3", "-199.0", "91%", "never", "-140.0", "0%", "10"],
        ["2  stock physics", "-130.0", "-50%", "12", "-200.0", "–", "–"],
        ["final (last 50 episodes)", "-131.2", "", "", "-121.0", "", ""],
        ["random policy, stock physics", "-200.0", "", "", "", "", ""],
    ]
    assert shown.notes == [
        "GB-DQN ended with 31% of its samples drawn by recency",
        "drop: share of the earlier level lost in the first 20 episodes after the drift (0 ="
        " random policy)",
        "recovery: episodes until the mean of 10 is back at 90% of that level; never: not within"
        " the regime",
        "–: there is no earlier level, or it was no better than the random policy's",
    ]


def test_every_agent_has_three_columns_in_the_order_of_the_runs():
    runs = {agent: summary(k, [(k,)] * 3) for k, agent in enumerate(AGENTS)}
    shown = tables.regimes(runs, CONFIG)
    assert shown.columns[1::3] == [AGENTS[agent].label for agent in AGENTS]
    assert shown.rows[0][1::3] == shown.rows[3][1::3] == [f"{k}.0" for k in range(len(AGENTS))]
    assert len(shown.notes) == 3, "nobody drew by recency"


def test_nothing_is_printed_as_minus_zero():
    runs = {"dqn": finals(0.01), "gbdqn": finals(-0.03)}
    assert tables.study(runs, CONFIG).rows[1][4:] == ["0.0 ±     –", "0.0", "+0.0"]
    shown = tables.regimes({"dqn": summary(-0.01, [(-0.04,), (0, -0.001, 9), ()])}, CONFIG)
    assert (shown.rows[0][1], shown.rows[1][2], shown.rows[3][1]) == ("0.0", "0%", "0.0")


# --- a study --------------------------------------------------------------------------------------


def test_the_table_of_a_study():
    """0, 1, 2, 3, 100 have the mean 21.2, the IQM 2 and the standard deviation 44.1.

    The returns in the regimes are 0, 1, 4, 9, 16 (mean 6), ten times these, and their negatives.
    """
    regimes = [[(k**2,), (10 * k**2,), (-(k**2),)] for k in range(5)]
    final = [0, 1, 2, 3, 100]
    runs = [summary(final[seed], regimes[seed], seed) for seed in range(5)]
    dqn = finals(10, 11, 12, 13, 110)
    assert tables.study({"gbdqn": runs, "dqn": dqn}, CONFIG) == Table(
        "MountainCar, 5 seeds: mean return per regime, and final return",
        ["agent", "0", "1", "2", "mean ± std", "IQM", "minus DQN's [95 %]"],
        [
            ["GB-DQN", "6.0", "60.0", "-6.0", "21.2 ±  44.1", "2.0", "-10.0 [-10.0, -10.0]"],
            ["DQN", "0.0", "0.0", "0.0", "31.2 ±  44.1", "12.0", ""],
        ],
        [
            "0: stock physics",
            "1: gravity × 1.3",
            "2: stock physics",
            "mean ± std, IQM (interquartile mean): of the final returns",
            "minus DQN's: IQM of the differences on the same seeds, and its bootstrap interval"
            " (too narrow with few seeds)",
        ],
    )


def test_the_difference_is_ours_minus_dqns_with_its_interval():
    """The differences 1, 2, 3, 4, 5 have the IQM 3."""
    ours, dqn = [11, 22, 33, 44, 55], [10, 20, 30, 40, 50]
    low, high = stats.bootstrap_interval([1, 2, 3, 4, 5], np.random.default_rng(0))
    shown = tables.study({"dqn": finals(*dqn), "reset": finals(*ours)}, CONFIG)
    assert 1 < low < 3 < high < 5
    assert [row[-1] for row in shown.rows] == ["", f"+3.0 [+{low:.1f}, +{high:.1f}]"]


def test_runs_are_paired_by_seed_in_any_order():
    ours, dqn = finals(3, 13, 23, seeds=[5, 2, 9]), finals(10, 20, 99, 0, seeds=[2, 9, 1, 5])
    shown = tables.study({"ensemble": ours, "dqn": dqn}, CONFIG)
    assert shown.rows[0][-1] == "+3.0 [+3.0, +3.0]"
    assert shown.title.startswith("MountainCar, 4 seeds:")


def test_two_seeds_have_an_interval():
    shown = tables.study({"dqn": finals(1, 2), "reset": finals(4, 7)}, CONFIG)
    assert shown.rows[1][-1] == "+4.0 [+3.0, +5.0]"


def test_a_single_seed_has_no_spread_and_no_interval():
    shown = tables.study({"gbdqn": finals(5, seeds=[3]), "dqn": finals(8, seeds=[3])}, CONFIG)
    assert shown.title.startswith("MountainCar, seed 3:")
    assert [row[4:] for row in shown.rows] == [
        ["5.0 ±     –", "5.0", "-3.0"],
        ["8.0 ±     –", "8.0", ""],
    ]


@pytest.mark.parametrize(("seeds", "count"), [([4], "seed 4"), ([4, 0], "2 seeds")])
def test_the_title_gives_the_number_of_seeds(seeds, count):
    shown = tables.study({"dqn": finals(*seeds, seeds=seeds)}, CONFIG)
    assert shown.title == f"MountainCar, {count}: mean return per regime, and final return"


@pytest.mark.parametrize("agents", [["gbdqn", "reset"], ["dqn"]])
def test_without_a_pair_the_differences_are_left_out(agents):
    shown = tables.study({agent: finals(1, 2) for agent in agents}, CONFIG)
    assert shown.columns[-1] == "IQM" and not any("minus" in note for note in shown.notes)
    assert all(len(row) == len(shown.columns) for row in shown.rows)


# --- what a drift costs ---------------------------------------------------------------------------


def effect(lost, name="a drift"):
    return {"regime": name, "random": -200.0, "frozen": -150.04, "trained": -100.0, "lost": lost}


def test_the_table_of_drift_effect():
    assert tables.drift_effect([effect(0.0, "stock physics"), effect(0.5004)], CONFIG) == Table(
        "MountainCar, GB-DQN, seed 7: mean greedy return in each regime",
        ["regime", "random", "frozen", "trained", "lost"],
        [
            ["stock physics", "-200.0", "-150.0", "-100.0", "0%"],
            ["a drift", "-200.0", "-150.0", "-100.0", "50%"],
        ],
        [
            "frozen: trained in the stock physics, then fixed; trained: trained in this regime"
            " from the start",
            "lost: share of the gain from random to trained that frozen misses; –: trained is no"
            " better than random",
            "1 of 1 drifts cost at least 20% of the gain",
        ],
    )


def test_a_drift_counts_from_20_percent_and_only_if_its_regime_was_learnt():
    """The first row is the stock physics and does not count as a drift."""
    rows = [effect(lost) for lost in (1.0, 0.2, 0.199, -0.5, None, 1.0)]
    shown = tables.drift_effect(rows, CONFIG)
    assert shown.notes[-1] == "2 of 5 drifts cost at least 20% of the gain"
    assert [row[-1] for row in shown.rows] == ["100%", "20%", "20%", "-50%", "–", "100%"]


# --- settings -------------------------------------------------------------------------------------


def listed(capsys, *arguments):
    """{setting: the cells of its line}, and the notes below the table."""
    assert main(["settings", *arguments]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line]
    assert lines[1].split() == ["setting", "value", "source", "range", "meaning"]
    rows = [re.split("  +", line) for line in lines[2 : 2 + len(SETTINGS)]]
    return {name: cells for name, *cells in rows}, lines[2 + len(SETTINGS) :]


def test_every_setting_is_listed_with_its_default_and_range(capsys):
    rows, _ = listed(capsys)
    assert list(rows) == list(SETTINGS)
    for name, (value, _, words, meaning) in rows.items():
        assert json.loads(value) == Config().to_dict()[name]
        assert words == SETTINGS[name][1].words
        assert meaning.endswith(".")
    assert rows["gamma"] == ["0.99", "paper", "a number in [0, 1)", "Discount γ."]
    assert rows["window"][3].endswith(" Only for sliding.")
    assert rows["members"][1] == "ours (D19)"
    assert rows["mix"][1] == "ours (D13)"
    assert [rows[name][1] for name in ("env", "agent", "seed")] == ["free"] * 3
    assert rows["replay"][:2] == ["null", "the agent"]


def test_the_settings_of_a_preset_are_listed_with_their_sources(capsys):
    rows, notes = listed(capsys, "--env", "acrobot", "--preset", "fast")
    config = Config.preset("acrobot", "fast").to_dict()
    for name, (value, *_) in rows.items():
        assert name == "schedule" or json.loads(value) == config[name]
    assert rows["schedule"][:2] == ["below", "ours (D14)"]
    assert f"schedule: {json.dumps(config['schedule'])}" in notes
    assert rows["lr"][:2] == ["0.001", "paper"]
    assert rows["episodes"][:2] == ["250", "ours (D14)"]
    assert rows["recency_rate"][1] == "ours (D5)"


def test_a_preset_without_an_environment_is_cartpoles_as_in_training(capsys):
    assert listed(capsys, "--preset", "fast") == listed(capsys, "--env", "cartpole-fast")

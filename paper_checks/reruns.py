"""The paper's tables beside ours, from the stored results of a study. `--ledger` writes them into results/README.md."""

import json
from pathlib import Path

import numpy as np

from gbdqn_ref import plots
from gbdqn_ref.stats import bootstrap_interval, forgetting, iqm, mean_std, median_recovery, paired_difference

FOLDER = Path(__file__).with_name("results")
COLUMNS = (
    "",
    "paper",
    "ours: mean ± std",
    "IQM [95 %]",
    "minus DQN's, paired [95 %]",
    "area per drift",
    "recovered after",
    "forgotten",
)
HEADER = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}\n"


def stored(env):
    """What the study of this environment left in results.json."""
    return json.loads((FOLDER / f"{env}.json").read_text(encoding="utf-8"))


def table(results, printed):
    """A row per method: final return, and what its runs say of each drift; the paper printed {agent: (mean, std)}."""
    runs = {agent: [run for run in results["runs"] if run["agent"] == agent] for agent in results["agents"]}
    final = {agent: np.array([run["final_return"] for run in rows]) for agent, rows in runs.items()}
    lines = []
    for agent, rows in runs.items():
        paper = "{:.2f} ± {:.2f}".format(*printed[agent]) if agent in printed else "–"
        low, high = bootstrap_interval(final[agent], np.random.default_rng(0))
        cells = [plots.NAMES[agent], paper, "{:.1f} ± {:.1f}".format(*mean_std(final[agent]))]
        cells += [f"{iqm(final[agent]):.1f} [{low:.1f}, {high:.1f}]", _difference(final, agent)]
        lines.append("| " + " | ".join(cells + _drifts(rows)) + " |\n")
    return HEADER + "".join(lines)


def _difference(final, agent):
    if agent == "dqn":
        return "0"
    return "{:+.1f} [{:+.1f}, {:+.1f}]".format(*paired_difference(final[agent], final["dqn"], np.random.default_rng(0)))


def _drifts(rows):
    """Area and recovery per drift, the median run's; what is lost of each earlier regime at the end, the mean run's."""
    regimes = list(zip(*(run["regimes"][1:] for run in rows), strict=True))
    areas = [[row["area"] for row in regime if row["area"] is not None] for regime in regimes]
    times = [median_recovery([row["recovery"] for row in regime]) for regime in regimes]
    lost = np.mean([forgetting(run["evaluation"]) for run in rows], axis=0)
    return [
        ", ".join(f"{np.median(area):.2f}" if area else "–" for area in areas),
        ", ".join("never" if time is None else f"{time:g}" for time in times),
        ", ".join(f"{x:.0f}" for x in lost),
    ]

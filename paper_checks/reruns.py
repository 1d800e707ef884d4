"""Our reruns of the paper's tables, from the stored results of studies. `--ledger` writes them into
results/README.md.

python paper_checks/reruns.py acrobot results/acrobot    stores what a study left, compactly
"""

import hashlib
import json
import sys
from pathlib import Path

import gymnasium
import numpy as np

from gbdqn_ref.agents import AGENTS
from gbdqn_ref.schedule import LABELS
from gbdqn_ref.stats import (
    bootstrap_interval,
    forgetting,
    iqm,
    mean_std,
    paired_difference,
    regime_medians,
)

FOLDER = Path(__file__).with_name("results")
STUDIES = {  # file: what Config.preset is asked for
    "acrobot": ("acrobot", "paper"),
    "mountaincar": ("mountaincar", "paper"),
    "hopper": ("hopper", "paper"),
    "cartpole": ("cartpole", "paper"),
    "hopper-long": ("hopper", "long"),
    "acrobot-hard": ("acrobot", "hard"),
    "mountaincar-hard": ("mountaincar", "hard"),
}
SIX = {  # readings of GB-DQN: what replaces the preset's setting
    "": {},
    "live-h": {"loss_on": "h"},
    "live-closed": {"loss_on": "h", "alpha": "closed-form"},
    "frozen-alpha_h": {"target": "frozen"},
    "frozen-h": {"target": "frozen", "loss_on": "h"},
    "frozen-closed": {"target": "frozen", "loss_on": "h", "alpha": "closed-form"},
}
UNDRIFTED = {  # what a drift costs GB-DQN that is none
    "none": {"schedule": []},
    "empty": {"schedule": [{"episode": 300, "gravity": 1.0}]},
    "": {},
    "alpha1": {"alpha": 1.0},
}
READINGS = {
    "acrobot": SIX,
    "mountaincar": SIX,
    "cartpole": UNDRIFTED,
    "hopper-long": {"": {}, "alpha1": {"alpha": 1.0}},
}
INGREDIENTS = {  # what GB-DQN adds to DQN, each alone and beside the other: (with, without)
    "replay, in DQN": ("dqn-recency", "dqn"),
    "replay, in GB-DQN": ("gbdqn", "gbdqn-per"),
    "boosting, with DQN's replay": ("gbdqn-per", "dqn"),
    "boosting, with its own": ("gbdqn", "dqn-recency"),
}
MEASURED = ("ours: mean ± std", "IQM [95 %]")
LATER = ("area per drift", "recovered after", "forgotten")


def stored(name):
    """What a study left in results.json."""
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def table(results, printed):
    """A row per method: final return, and what its runs say of each drift; the paper printed
    {agent: (mean, std)}.
    """
    runs, final = _by_agent(results)
    rows = []
    for agent in runs:
        paper = "{:.2f} ± {:.2f}".format(*printed[agent]) if agent in printed else "–"
        difference = _difference(final[agent], final["dqn"]) if agent != "dqn" else "0"
        rows.append(
            [AGENTS[agent].label, paper, *_final(final[agent]), difference, *_drifts(runs[agent])]
        )
    return _markdown(["", "paper", *MEASURED, "minus DQN's, paired [95 %]", *LATER], rows)


def ingredients():
    """A row per study: the final return that GB-DQN's replay and its boosting bring, paired."""
    rows = []
    for study, (env, preset) in STUDIES.items():
        results = stored(study)
        _, final = _by_agent(results)
        name = LABELS[env] + (f", {preset}" if preset != "paper" else "")
        pairs = [
            _difference(final[added], final[without]) for added, without in INGREDIENTS.values()
        ]
        rows.append([name, str(len(results["seeds"])), *pairs])
    return _markdown(["", "seeds", *INGREDIENTS], rows)


def readings(study):
    """A row per reading of GB-DQN, against the first one on the same seeds."""
    rows, own = [], None
    for name, changes in READINGS[study].items():
        results = stored(f"{study}-{name}" if name else study)
        runs, final = (each["gbdqn"] for each in _by_agent(results))
        own = final if own is None else own
        setting = results["settings"] | changes
        alpha = "the α of Eq. 8" if setting["alpha"] == "closed-form" else f"α = {setting['alpha']}"
        label = (
            f"{setting['target']} target, {'h' if setting['loss_on'] == 'h' else 'α h'} fitted,"
            f" {alpha}"
        )
        if "schedule" in changes:
            label += "; a drift that changes nothing" if changes["schedule"] else "; no drift"
        rows.append(
            [label, *_final(final), _difference(final, own) if rows else "0", *_drifts(runs)]
        )
    return _markdown(["", *MEASURED, "minus the first row's, paired [95 %]", *LATER], rows)


def fingerprint():
    """What decides the last bits of a run: NumPy's and Gymnasium's version, and what this machine's
    kernels compute.
    """
    x = np.random.default_rng(0).normal(size=(64, 129)).astype(np.float32)
    kernels = [
        x.T @ x,
        x[:, :7] @ x[:7, :3],
        x[:1] @ x.T,
        np.exp(x),
        np.log1p(np.abs(x)),
        np.sqrt(np.abs(x)),
    ]
    digest = hashlib.sha256(b"".join(result.tobytes() for result in kernels)).hexdigest()[:16]
    return {"numpy": np.__version__, "gymnasium": gymnasium.__version__, "kernels": digest}


def _markdown(columns, rows):
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _by_agent(results):
    """{agent: its runs}, {agent: their final returns (seeds,)}."""
    runs = {
        agent: [run for run in results["runs"] if run["agent"] == agent]
        for agent in results["agents"]
    }
    return runs, {
        agent: np.array([run["final_return"] for run in rows]) for agent, rows in runs.items()
    }


def _final(final):
    low, high = bootstrap_interval(final, np.random.default_rng(0))
    return ["{:.1f} ± {:.1f}".format(*mean_std(final)), f"{iqm(final):.1f} [{low:.1f}, {high:.1f}]"]


def _difference(final, other):
    return "{:+.1f} [{:+.1f}, {:+.1f}]".format(
        *paired_difference(final, other, np.random.default_rng(0))
    )


def _drifts(rows):
    """Area and recovery per drift, the median run's; what is lost of each earlier regime at the
    end, the mean run's.
    """
    regimes = zip(*(run["regimes"][1:] for run in rows), strict=True)
    medians = [regime_medians(regime) for regime in regimes]
    areas = ["–" if each["area"] is None else f"{each['area']:.2f}" for each in medians]
    times = ["–" if each["area"] is None else _time(each["recovery"]) for each in medians]
    lost = np.mean([forgetting(run["evaluation"]) for run in rows], axis=0)
    return [", ".join(areas), ", ".join(times), ", ".join(f"{x:.0f}" for x in lost)]


def _time(episodes):
    return "never" if episodes is None else f"{episodes:g}"


if __name__ == "__main__":
    name, folder = sys.argv[1:]
    content = json.loads((Path(folder) / "results.json").read_text(encoding="utf-8"))
    (FOLDER / f"{name}.json").write_text(
        json.dumps(content, separators=(",", ":")) + "\n", encoding="utf-8"
    )

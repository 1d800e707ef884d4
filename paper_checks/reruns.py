"""Our reruns of the paper's tables, from the stored results of studies: results/README.md is
results/text.md with each {name of a figure} filled in. `--ledger` writes it.

python paper_checks/reruns.py acrobot results/acrobot    stores what a study left, compactly
"""

import json
import re
from itertools import combinations
from pathlib import Path

import numpy as np
from paper import TABLES

from gbdqn_ref import UsageError, provenance
from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import Config
from gbdqn_ref.files import read_json, write_atomically
from gbdqn_ref.runs import SUMMARY
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
STORED = {study: (study, {}) for study in STUDIES} | {  # file: (study, what replaces its settings)
    f"{study}-{name}": (study, changes)
    for study, readings in READINGS.items()
    for name, changes in readings.items()
    if name
}
PRINTED = {"acrobot": "Acrobot", "mountaincar": "MountainCar", "hopper": "Hopper"}  # its table
NAMES = {  # agent: the paper's method
    "dqn": "DQN",
    "gbdqn": "GB-DQN",
    "ensemble": "Ensemble",
    "reset": "Reset",
    "sliding": "Sliding",
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


def page():
    """The page: text.md with its figures."""
    text = (FOLDER / "text.md").read_text(encoding="utf-8")
    return re.sub(
        r"{(\w+)((?:\s[\w-]+)*)}", lambda found: FIGURES[found[1]](*found[2].split()), text
    )


# What is stored


def runs_of(study, agent):
    """The summaries of an agent's runs, in the order of their seeds."""
    return [run for run in stored(study)["runs"] if run["agent"] == agent]


def final(study):
    """{agent: final returns (seeds,)}, each the mean of 50 episodes (D12)."""
    results = stored(study)
    return {
        agent: np.array([run["final_return"] for run in results["runs"] if run["agent"] == agent])
        for agent in results["agents"]
    }


def paired(study, added, without):
    """(IQM, low, high) of an agent's final returns minus another's on the same seeds."""
    ends = final(study)
    return paired_difference(ends[added], ends[without], np.random.default_rng(0))


def label(study):
    """The name of a study: its environment, and its preset if it is ours."""
    env, preset = STUDIES[study]
    return LABELS[env] + (f", {preset}" if preset != "paper" else "")


# The tables


def section(name):
    """The table of a section."""
    if name == "ingredients":
        return ingredients()
    if name.endswith("-readings"):
        return readings(name.removesuffix("-readings"))
    paper = TABLES[PRINTED[name]] if name in PRINTED else {}
    return table(name, {agent: paper[NAMES[agent]] for agent in NAMES if paper})


def table(study, printed):
    """A row per method: final return, and what its runs say of each drift; the paper printed
    {agent: (mean, std)}.
    """
    rows = []
    for agent, ends in final(study).items():
        paper = "{:.2f} ± {:.2f}".format(*printed[agent]) if agent in printed else "–"
        difference = gain(study, agent, "dqn") if agent != "dqn" else "0"
        drifts = _drifts(runs_of(study, agent))
        rows.append([AGENTS[agent].label, paper, *_final(ends), difference, *drifts])
    return _markdown(["", "paper", *MEASURED, "minus DQN's, paired [95 %]", *LATER], rows)


def ingredients():
    """A row per study: the final return that GB-DQN's replay and its boosting bring, paired."""
    rows = []
    for study in STUDIES:
        pairs = [gain(study, *pair) for pair in INGREDIENTS.values()]
        rows.append([label(study), str(len(stored(study)["seeds"])), *pairs])
    return _markdown(["", "seeds", *INGREDIENTS], rows)


def readings(study):
    """A row per reading of GB-DQN, against the first one on the same seeds."""
    rows, own = [], None
    for name, changes in READINGS[study].items():
        variant = f"{study}-{name}" if name else study
        ends = final(variant)["gbdqn"]
        own = ends if own is None else own
        setting = stored(variant)["settings"] | changes
        alpha = "the α of Eq. 8" if setting["alpha"] == "closed-form" else f"α = {setting['alpha']}"
        fitted = "h" if setting["loss_on"] == "h" else "α h"
        words = f"{setting['target']} target, {fitted} fitted, {alpha}"
        if "schedule" in changes:
            words += "; a drift that changes nothing" if changes["schedule"] else "; no drift"
        difference = _difference(ends, own) if rows else "0"
        drifts = _drifts(runs_of(variant, "gbdqn"))
        rows.append([words, *_final(ends), difference, *drifts])
    return _markdown(["", *MEASURED, "minus the first row's, paired [95 %]", *LATER], rows)


# The figures of the text


def gain(study, added, without):
    """What one agent ends above another by: the IQM of paired differences, and its interval."""
    return "{:+.1f} [{:+.1f}, {:+.1f}]".format(*paired(study, added, without))


def differing(study):
    """(texts of the agents whose interval of differences to DQN leaves 0 out, the others)."""
    differ, others = [], []
    for agent in final(study).keys() - {"dqn"}:
        _, low, high = paired(study, agent, "dqn")
        side = "above" if low > 0 else "below"
        found = f"{AGENTS[agent].label} ({side}, {gain(study, agent, 'dqn')})"
        (others if low <= 0 <= high else differ).append((list(AGENTS).index(agent), found, agent))
    return [found for _, found, _ in sorted(differ)], [
        AGENTS[agent].label for _, _, agent in sorted(others)
    ]


def effects(ingredient, sign):
    """Where adding an ingredient changes the final return detectably in this direction; the studies
    of three seeds are left out.
    """
    found = []
    for study in STUDIES:
        for name, pair in INGREDIENTS.items():
            _, low, high = paired(study, *pair)
            outside = low > 0 if sign > 0 else high < 0
            if name.startswith(ingredient) and outside and len(stored(study)["seeds"]) > 3:
                company = name.split(", ")[1]
                found.append(f"{label(study)} ({company}, {gain(study, *pair)})")
    return "; ".join(found) or "none of them"


def correlation():
    """Mean correlation, over the seeds, of the final returns of two learning agents of a study."""
    found = []
    for study in STUDIES:
        learners = [x for agent, x in final(study).items() if agent != "random" and np.ptp(x)]
        pairs = [(x, y) for x, y in combinations(learners, 2) if (x != y).any()]
        found += [np.corrcoef(x, y)[0, 1] for x, y in pairs]
    return f"{np.mean(found):.2f} ({len(found)} pairs of methods)"


def covered():
    """{runs: how often, in percent, an interval of so many covers the truth}, as measured."""
    found = re.findall(r"([\d.]+) % with\s+(\d+)", bootstrap_interval.__doc__)
    return {int(runs): percent for percent, runs in found[:3]}


def missed():
    """How many of the intervals of the first table can be expected to miss the truth."""
    each = [1 - float(covered()[len(stored(study)["seeds"])]) / 100 for study in STUDIES]
    return f"{len(INGREDIENTS) * sum(each):.0f}"


def recoveries(study, agent):
    """Median recoveries, as in its table."""
    return _drifts(runs_of(study, agent))[1]


def transitions(study, agent):
    """The transitions of an agent's runs, (seeds,)."""
    return np.array([run["steps"] for run in runs_of(study, agent)])


def reading(study, name=""):
    """A reading's difference to the first one of its table."""
    names = [f"{study}-{each}" if each else study for each in (name, next(iter(READINGS[study])))]
    return _difference(*(final(each)["gbdqn"] for each in names))


def scheduled(study):
    """The drifts of a study in words."""
    found = []
    for entry in stored(study)["settings"]["schedule"]:
        factors = [f"{key} × {x:g}" for key, x in entry.items() if key not in ("episode", "reset")]
        found.append(
            f"{' and '.join(factors) or 'the stock physics'} from episode {entry['episode']}"
        )
    return ", ".join(found)


def worse(study, agent, other):
    """On how many of the seeds an agent ends below another."""
    ends = final(study)
    return f"{(ends[agent] < ends[other]).sum()} of {len(ends[agent])}"


def wider(study, agent):
    """How many times our std the paper's is."""
    return f"{TABLES[PRINTED[study]][NAMES[agent]][1] / mean_std(final(study)[agent])[1]:.0f}"


def answer():
    """What the study of ours says first, and its first table, from the page that it wrote."""
    page = (FOLDER.parents[1] / "docs" / "what_to_keep.md").read_text(encoding="utf-8")
    first = re.search(r"(.*) \(Arms are compared", page)[1]
    table = re.search(r"(?:^[|].*\n)+", page, re.M)[0]
    return f"{first}\n\n{table}".strip()


FIGURES = {  # name in text.md: what gives it
    "table": lambda name: f"<!-- {name} -->\n\n{section(name)}\n<!-- end of {name} -->",
    "iqm": lambda study, agent: f"{iqm(final(study)[agent]):.1f}",
    "gain": gain,
    "differs": lambda study: ", ".join(differing(study)[0]),
    "alike": lambda study: ", ".join(differing(study)[1]),
    "helps": lambda ingredient: effects(ingredient, 1),
    "costs": lambda ingredient: effects(ingredient, -1),
    "correlation": correlation,
    "covers": lambda runs: covered()[int(runs)],
    "intervals": lambda: str(len(INGREDIENTS) * len(STUDIES)),
    "misses": missed,
    "least_p": lambda: f"{2 / 2 ** len(stored('hopper-long')['seeds']):.2f}",
    "recoveries": recoveries,
    "steps": lambda study, agent: f"{transitions(study, agent).mean():,.0f}",
    "range": lambda study, agent: "{:,} to {:,}".format(
        *(pick(transitions(study, agent)) for pick in (min, max))
    ),
    "reading": reading,
    "schedule": scheduled,
    "setting": lambda study, key: f"{stored(study)['settings'][key]:,}",
    "slower": lambda: f"{1 / stored('acrobot')['settings']['alpha']:.0f}",
    "halflife": lambda study: f"{np.log(2) / stored(study)['settings']['recency_rate']:,.0f}",
    "printed": lambda env, name: f"{TABLES[env][name][0]:.2f}",
    "study": answer,
    "worse": worse,
    "wider": wider,
}


def fingerprint():
    """What decides the last bits of a run: the versions of NumPy and Gymnasium, and the kernels."""
    known = provenance.versions()
    return {key: known[key] for key in ("numpy", "gymnasium", "kernels")}


def _markdown(columns, rows):
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _final(ends):
    low, high = bootstrap_interval(ends, np.random.default_rng(0))
    return ["{:.1f} ± {:.1f}".format(*mean_std(ends)), f"{iqm(ends):.1f} [{low:.1f}, {high:.1f}]"]


def _difference(ends, other):
    found = paired_difference(ends, other, np.random.default_rng(0))
    return "{:+.1f} [{:+.1f}, {:+.1f}]".format(*found)


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


# Storing


def store(name, folder):
    """Keep what a study left in its folder; its settings must be those of this name."""
    path, (study, changes) = folder / "results.json", STORED[name]
    shapes = dict(settings={"env": (str,)}, agents=[(str,)], seeds=[(int,)], runs=[SUMMARY])
    results = read_json(path, **shapes)
    wanted = Config.preset(*STUDIES[study], **changes).resolved().to_dict()
    others = [key for key, value in results["settings"].items() if value != wanted.get(key)]
    if others:
        raise UsageError(f"{path} has other settings than {name} ({', '.join(others)})")
    text = json.dumps(results, separators=(",", ":")) + "\n"
    write_atomically(FOLDER / f"{name}.json", lambda file: file.write(text.encode()))


def main(arguments=None):
    """Store the results of a study."""
    parser = Parser(description="Store what a study left, compactly.")
    parser.add_argument("name", choices=STORED, metavar="NAME", help="like acrobot")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where results.json is")
    args = parser.parse_args(arguments)
    store(args.name, args.folder)


if __name__ == "__main__":
    program(main)

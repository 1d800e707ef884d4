"""What the command line prints, as tables of text. Nothing here computes more than it shows."""

import ast
import inspect
import json
import re
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from . import presets, stats
from .agents import AGENTS, OWN
from .config import SETTINGS, Config, preset_of
from .schedule import LABELS, describe
from .stats import Rows

HURTS = 0.2  # a drift matters if it costs this share of the gain from random to trained
RANDOM = "random policy, stock physics"


class Table(NamedTuple):
    """A title, the names of the columns, rows of as many cells, and the notes below them.

    The first `text` columns are words, the others numbers.
    """

    title: str
    columns: list[str]
    rows: list[list[str]]
    notes: list[str]
    text: int = 1


def show(table: Table) -> None:
    """Print a table, its words to the left and its numbers to the right."""
    widths = [max(map(len, cells)) for cells in zip(table.columns, *table.rows, strict=True)]
    print(f"\n{table.title}\n")
    for cells in (table.columns, *table.rows):
        words = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        numbers = [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
        print("  ".join(words[: table.text] + numbers[table.text :]).rstrip())
    print("", *table.notes, sep="\n")


def regimes(summaries: Mapping[str, Mapping[str, Any]], config: Config) -> Table:
    """Mean return, drop and recovery per regime, of one run of each agent, {agent: summary}."""
    columns, runs = ["regime"], list(summaries.values())
    for agent in summaries:
        columns += [AGENTS[agent].label, "drop", "recovery"]
    rows = []
    for k, regime in enumerate(config.regimes):
        cells = [cell for run in runs for cell in _adaptation(run["regimes"][k])]
        rows.append([f"{k}  {describe(regime.factors)}", *cells])
    final = [cell for run in runs for cell in (_number(run["final_return"]), "", "")]
    rows.append(["final (last 50 episodes)", *final])
    rows.append([RANDOM, _number(runs[0]["random_return"]), *[""] * (len(final) - 1)])
    shares = [
        f"{AGENTS[agent].label} ended with {run['recency_share_of_replay']:.0%} of its samples"
        " drawn by recency"
        for agent, run in summaries.items()
        if "recency_share_of_replay" in run
    ]
    title = f"{LABELS[config.env]}, seed {config.seed}: mean return, drop and recovery per regime"
    notes = [
        f"drop: share of the earlier level lost in the first {stats.EDGE} episodes after the drift"
        " (0 = random policy)",
        f"recovery: episodes until the mean of {stats.WINDOW} is back at {stats.RECOVERED:.0%} of"
        " that level; never: not within the regime",
        "–: there is no earlier level, or it was no better than the random policy's",
    ]
    return Table(title, columns, rows, [*shares, *notes])


def study(summaries: Mapping[str, Rows], config: Config) -> Table:
    """Mean return per regime, final return, and its difference from DQN's, {agent: [summary]}."""
    columns = ["agent", *(str(k) for k in range(len(config.regimes))), "mean ± std", "IQM"]
    rows = [[AGENTS[agent].label, *_returns(runs)] for agent, runs in summaries.items()]
    notes = [f"{k}: {describe(regime.factors)}" for k, regime in enumerate(config.regimes)]
    notes.append("mean ± std, IQM (interquartile mean): of the final returns")
    if "dqn" in summaries and len(summaries) > 1:
        columns.append("minus DQN's [95 %]")
        for row, (agent, runs) in zip(rows, summaries.items(), strict=True):
            row.append("" if agent == "dqn" else _difference(runs, summaries["dqn"]))
        notes.append(
            "minus DQN's: IQM of the differences on the same seeds, and its bootstrap interval"
            " (too narrow with few seeds)"
        )
    seeds = sorted({run["seed"] for runs in summaries.values() for run in runs})
    count = f"{len(seeds)} seeds" if len(seeds) > 1 else f"seed {seeds[0]}"
    title = f"{LABELS[config.env]}, {count}: mean return per regime, and final return"
    return Table(title, columns, rows, notes)


def drift_effect(rows: Rows, config: Config) -> Table:
    """What effect.drift_effect() found, one row per regime."""
    columns = ["regime", "random", "frozen", "trained", "lost"]
    cells = [
        [row["regime"], *(_number(row[key]) for key in columns[1:4]), _share(row["lost"])]
        for row in rows
    ]
    hurt = sum(row["lost"] is not None and row["lost"] >= HURTS for row in rows[1:])
    notes = [
        "frozen: trained in the stock physics, then fixed; trained: trained in this regime from"
        " the start",
        "lost: share of the gain from random to trained that frozen misses; –: trained is no"
        " better than random",
        f"{hurt} of {len(rows) - 1} drifts cost at least {HURTS:.0%} of the gain",
    ]
    learner = f"{AGENTS[config.agent].label}, seed {config.seed}"
    title = f"{LABELS[config.env]}, {learner}: mean greedy return in each regime"
    return Table(title, columns, cells, notes)


def settings(env: str | None = None, preset: str | None = None) -> Table:
    """Every setting: its value (the default, or a preset's), source, range and meaning."""
    config, title = Config(), "The settings and their defaults"
    if env or preset:
        env, preset = preset_of(env or "cartpole", preset)
        config, title = Config.preset(env, preset), f"{LABELS[env]}, preset {preset}: the settings"
    values, meanings, rows, notes = config.to_dict(), _meanings(), [], []
    for name, (_, rule) in SETTINGS.items():
        value, source = json.dumps(values[name]), _source(config, preset, name, meanings[name])
        if name == "schedule" and values[name]:
            notes.append(f"schedule: {value}")
            value = "below"
        readers = [agent for agent in AGENTS if name in AGENTS[agent].reads]
        alone = f" Only for {', '.join(readers)}." if readers else ""
        rows.append([name, value, source, rule.words, meanings[name] + alone])
    notes.append("--set NAME=VALUE changes a setting; D13 and the like: paper_checks/README.md")
    return Table(title, ["setting", "value", "source", "range", "meaning"], rows, notes, text=5)


def _source(config: Config, preset: str | None, name: str, meaning: str) -> str:
    """The source of a value; without a preset it is "paper" if any experiment there has it."""
    value = getattr(config, name)
    if name in ("env", "agent", "seed"):
        return "free"
    if name in OWN and value is None:
        return "the agent"
    if preset and name in presets.PRESETS[preset][config.env]:
        return presets.source(config.env, preset, name, value)
    if not preset and any((name, value) in given.items() for given in presets.GIVEN.values()):
        return "paper"
    number = re.search(r"D\d+", meaning)
    return f"ours ({number[0] if number else 'D13'})"


def _meanings() -> dict[str, str]:
    """The sentence below each setting in the source of Config."""
    (config,) = ast.parse(inspect.getsource(Config)).body
    fields = pairwise(config.body)  # type: ignore[attr-defined]
    return {
        ast.unparse(field.target): text.value.value
        for field, text in fields
        if isinstance(field, ast.AnnAssign)
    }


def _adaptation(row: Mapping[str, Any]) -> list[str]:
    """The mean return, drop and recovery of one regime."""
    undefined = row["drop"] is None
    recovery = "–" if undefined else str(row["recovery"] or "never")
    return [_number(row["mean_return"]), _share(row["drop"]), recovery]


def _returns(runs: Rows) -> list[str]:
    """The mean return in each regime, then mean ± std and IQM of the final returns."""
    final = [run["final_return"] for run in runs]
    returns = [[row["mean_return"] for row in run["regimes"]] for run in runs]
    mean, std = stats.mean_std(final)
    spread = "–" if std is None else _number(std)
    means = [_number(mean) for mean in np.mean(returns, axis=0)]
    return [*means, f"{_number(mean)} ± {spread:>5}", _number(stats.iqm(final))]


def _difference(runs: Rows, others: Rows) -> str:
    """IQM of the paired differences in final return, with its interval if there are several."""
    pairs = stats.same_seeds(runs, others)
    middle, low, high = stats.paired_difference(*pairs, np.random.default_rng(0))
    return f"{middle:+z.1f}" + (f" [{low:+z.1f}, {high:+z.1f}]" if len(pairs[0]) > 1 else "")


def _number(value: float) -> str:
    return f"{value:z.1f}"


def _share(value: float | None) -> str:
    return "–" if value is None else f"{value:z.0%}"

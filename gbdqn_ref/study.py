"""Many runs, {name: config}, each in a folder. A run that is complete is not repeated.

    study.json       the settings that all runs share, and those in which each differs
    NAME/            one run each, as runs.train() leaves it
    results.json     the same with the summaries of all runs, when all are complete

Killed at any moment and started again, a study ends with the same bytes as one that was left alone.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from reprlib import repr as short
from typing import Any

from tqdm import tqdm

from . import StudyError, UsageError, files, plots, runs, workers
from .agents import OWN
from .config import Config
from .schedule import is_count
from .stats import Rows

MOST_RUNS, MOST_JOBS = 10_000, 1_000
NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]{0,198}[A-Za-z0-9])?")
EACH = ("agent", "seed", "replay")  # stated for each run, even if all agree


def grid(configs: Mapping[str, Config], seeds: Sequence[int]) -> dict[str, Config]:
    """Some agents, or some settings, on the same seeds: {"NAME-SEED": config}.

    >>> base = Config(env="acrobot", agent="dqn")
    >>> list(grid({"dqn": base, "linear": replace(base, hidden=())}, [3, 7]))
    ['dqn-3', 'linear-3', 'dqn-7', 'linear-7']
    """
    _check_size(len(configs) * len(seeds))
    if len(set(seeds)) < len(seeds):
        raise UsageError(f"the seeds {short(list(seeds))} name one twice")
    return {
        f"{name}-{seed}": replace(config, seed=seed)
        for seed in seeds
        for name, config in configs.items()
    }


def run_study(
    configs: Mapping[str, Config],
    out: Path | str,
    executor: Executor | None = None,
    jobs: int = 2,
    quiet: bool = False,
) -> dict[str, str]:
    """Train every {name: config} into out/NAME; {name: error} of the runs that failed.

    Runs with the same seed meet the same starts. By default they work in `jobs` processes, which
    stop with this one; an executor, like Dask's, takes their place.
    """
    out = Path(out)
    _check_size(len(configs))
    _check_names(configs)
    if not is_count(jobs) or not 1 <= jobs <= MOST_JOBS:
        raise UsageError(f"jobs must be a whole number from 1 to {MOST_JOBS:,}, not {short(jobs)}")
    _check_folder(configs, out)
    out.mkdir(parents=True, exist_ok=True)
    with files.locked(out):
        files.write_json(out / "study.json", _description(configs))
        failed = _train(configs, out, executor, jobs, quiet)
        if not failed:
            files.write_json(out / "results.json", _results(configs, out))
    return failed


def complete(*arguments: Any, **options: Any) -> None:
    """run_study(), or StudyError if not every run is complete then."""
    errors = run_study(*arguments, **options)
    if errors:
        raise StudyError(errors)


def _check_size(count: int) -> None:
    if not 1 <= count <= MOST_RUNS:
        raise UsageError(f"a study has from 1 to {MOST_RUNS:,} runs, not {count:,}")


def _check_names(configs: Mapping[str, Config]) -> None:
    """UsageError unless each name can be a folder of its own on every system."""
    for name in configs:
        if not isinstance(name, str) or not NAME.fullmatch(name) or name.endswith(".json"):
            raise UsageError(
                f"a run needs a name of letters, digits, '.', '_' and '-', not {short(name)}"
            )
    if len({name.lower() for name in configs}) < len(configs):
        raise UsageError("two runs have names that only differ in upper and lower case")


def _check_folder(configs: Mapping[str, Config], out: Path) -> None:
    """UsageError if the folder holds something else, other settings, or a run that is damaged."""
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is not a folder; choose another --out")
    begun = [name for name in configs if (out / name / "config.json").exists()]
    if (out / "study.json").exists():
        known = files.read_json(out / "study.json", "settings")["settings"]
        if not isinstance(known, dict):
            raise UsageError(f"{out / 'study.json'} is damaged (no settings); delete or restore it")
        wanted = _description(configs)["settings"]
        _refuse_others(out, known, {key: wanted[key] for key in wanted if key not in OWN})
    elif out.exists() and not begun and any(path.suffix != ".part" for path in out.iterdir()):
        raise UsageError(f"{out} is not empty and holds no study; choose another --out")
    for name in begun:
        known = runs.read_config(out / name).resolved().to_dict()
        _refuse_others(out / name, known, configs[name].resolved().to_dict())
        if (out / name / "summary.json").exists():
            runs.read_summary(out / name)
            runs.read_episodes(out / name)


def _refuse_others(out: Path, known: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """UsageError if two sets of settings differ in one that both of them state."""
    others = [key for key in wanted if key in known and known[key] != wanted[key]]
    if others:
        raise UsageError(
            f"{out} has other settings ({', '.join(others)}); repeat them or choose another --out"
        )


def _description(configs: Mapping[str, Config]) -> dict[str, Any]:
    """What study.json says, with every default filled in."""
    settings = {name: config.resolved().to_dict() for name, config in configs.items()}
    first, *others = settings.values()
    shared = {
        key: value
        for key, value in first.items()
        if key not in EACH and all(other[key] == value for other in others)
    }
    return {
        "settings": shared,
        "agents": list(dict.fromkeys(config.agent for config in configs.values())),
        "seeds": sorted({config.seed for config in configs.values()}),
        "runs": {
            name: {key: value for key, value in values.items() if key not in shared}
            for name, values in settings.items()
        },
    }


def _train(
    configs: Mapping[str, Config], out: Path, executor: Executor | None, jobs: int, quiet: bool
) -> dict[str, str]:
    """Train what is not complete, below a bar of all episodes; {name: error} of what failed."""
    folders = {out / name: config for name, config in configs.items()}
    left = {
        folder: config
        for folder, config in folders.items()
        if not (folder / "summary.json").exists()
    }
    total = sum(config.episodes for config in configs.values())
    seen, title = _episodes(folders), f"{len(configs)} runs"
    with tqdm(
        total=total, initial=seen, unit="ep", desc=title, disable=quiet or None, mininterval=0
    ) as bar:
        show = partial(_show, bar, folders)
        if executor:
            failed = _train_over(executor, left, show)
        else:
            failed = workers.train_all(left, jobs, show)
    return {folder.name: error for folder, error in failed.items()}


def _show(bar: tqdm, folders: Mapping[Path, Config]) -> None:
    bar.n = _episodes(folders)
    bar.refresh()


def _episodes(folders: Mapping[Path, Config]) -> int:
    """How many episodes the runs in some folders have seen."""
    tables = [folder / "episodes.csv" for folder in folders]
    return sum(
        max(0, table.read_bytes().count(b"\n") - 1) if table.exists() else 0 for table in tables
    )


def _train_over(
    executor: Executor, left: Mapping[Path, Config], show: Callable[[], object]
) -> dict[Path, str]:
    """What workers.train_all() does, by an executor: if stopped, it only ends what it has begun."""
    futures = {
        executor.submit(workers.train_one, config.to_dict(), str(folder.resolve())): folder
        for folder, config in left.items()
    }
    pending = set(futures)
    try:
        while pending:
            _, pending = wait(pending, timeout=0.5)
            show()
    finally:
        for future in pending:
            future.cancel()
    errors = {folder: future.exception() for future, folder in futures.items()}
    return {folder: workers.in_a_line(error) for folder, error in errors.items() if error}


def _results(configs: Mapping[str, Config], out: Path) -> dict[str, Any]:
    """What results.json says: for each run its settings, what made it, and its summary."""
    description = _description(configs)
    rows = []
    for name, differs in description["runs"].items():
        made_by = files.read_json(out / name / "config.json", "config")
        del made_by["config"]
        rows.append({"name": name, "settings": differs} | made_by | runs.read_summary(out / name))
    return description | {"runs": rows}


def report(out: Path | str) -> tuple[dict[str, Rows], dict[str, list[Rows]]]:
    """({label: [summary per seed]}, {label: [records per seed]}) of a complete study.

    A label is a run's name without its seed: an agent, or some settings. The seeds are sorted.
    """
    out = Path(out)
    summaries: dict[str, Any] = {}
    records: dict[str, Any] = {}
    rows = files.read_json(out / "results.json", "runs")["runs"]
    for row in sorted(rows, key=lambda row: row["seed"]):
        name = row.get("name", f"{row['agent']}-{row['seed']}")
        label = name.removesuffix(f"-{row['seed']}")
        summaries.setdefault(label, []).append(row)
        records.setdefault(label, []).append(runs.read_episodes(out / name))
    return summaries, records


def draw(
    out: Path | str,
    config: Config,
    summaries: Mapping[str, Rows],
    records: Mapping[str, Sequence[Rows]],
) -> None:
    """The pictures of a study of agents: curves; adaptation to drifts; differences to DQN."""
    level = next(iter(summaries.values()))[0]["random_return"]
    figures = {"curves": plots.study_curves(records, config, level)}
    if len(config.regimes) > 1 and set(summaries) - {"random"}:
        figures["adaptation"] = plots.adaptation(summaries, config)
    if len(summaries) > 1 and "dqn" in summaries:
        figures["forest"] = plots.forest(summaries, config)
    for name, figure in figures.items():
        plots.save(figure, Path(out) / f"{name}.png")


def comparison(out: Path | str, configs: Mapping[str, Config]) -> dict[str, dict[str, Any]]:
    """{agent: summary} of a complete study of one seed, whose curves are drawn in one picture."""
    out, config = Path(out), next(iter(configs.values()))
    summaries = {agent: runs.read_summary(out / agent) for agent in configs}
    records = {agent: runs.read_episodes(out / agent) for agent in configs}
    level = summaries[config.agent]["random_return"]
    plots.save(plots.learning_curves(records, config, level), out / "comparison.png")
    return summaries

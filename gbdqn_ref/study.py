"""Many runs, agents × seeds, over any concurrent.futures.Executor. What is finished is not
repeated.

    study.json       what is compared: environment and settings, agents, seeds
    AGENT-SEED/      one run each, as runs.train() leaves it
    results.json     the summaries of all runs, when all are complete

Killed at any moment and started again, a study ends with the same bytes as one that was left alone.
"""

import os
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor, wait
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread

from tqdm import tqdm

from . import UsageError, files, runs
from .config import Config


def run_study(configs, out, executor=None, jobs=1, quiet=False):
    """Train every config, at most `jobs` at a time, and return {"AGENT-SEED": error} of the runs
    that failed.

    The configs differ in agent and seed alone, so that runs with one seed meet the same starts and
    the same drifts. Without an executor of yours the runs are spread over processes; what a process
    that was killed leaves behind is taken up once more.
    """
    out = Path(out)
    _check_folder(configs, out)
    with files.locked(out):
        files.write_json(out / "study.json", _description(configs))
        left = {out / f"{config.agent}-{config.seed}": config for config in configs}
        total = sum(config.episodes for config in configs)
        with tqdm(total=total, unit="ep", desc=f"{len(configs)} runs", disable=quiet) as bar:
            if executor:
                failed = _train_all(executor, left, left, bar)
            else:
                failed = _train_in_processes(jobs, left, left, bar)
                broken = {
                    folder: left[folder]
                    for folder, e in failed.items()
                    if isinstance(e, BrokenExecutor)
                }
                failed = {folder: failed[folder] for folder in failed if folder not in broken}
                failed |= _train_in_processes(jobs, broken, left, bar) if broken else {}
        if not failed:
            summaries = [runs.read_summary(folder) for folder in left]
            files.write_json(out / "results.json", _description(configs) | {"runs": summaries})
    return {folder.name: f"{type(e).__name__}: {e}" for folder, e in failed.items()}


def report(out):
    """({agent: [summary per seed]}, {agent: [records per seed]}) of a complete study."""
    out, summaries, records = Path(out), {}, {}
    for summary in files.read_json(out / "results.json", "runs")["runs"]:
        agent = summary["agent"]
        summaries.setdefault(agent, []).append(summary)
        records.setdefault(agent, []).append(runs.read_episodes(out / f"{agent}-{summary['seed']}"))
    return summaries, records


def train_one(values, folder):
    """One run, in whatever process: {name: value} of its Config, and its folder, begun or not."""
    runs.train(
        Config.from_dict(values), folder, resume=(Path(folder) / "config.json").exists(), quiet=True
    )


def _description(configs):
    """What study.json says; agent, seed and the agent's own replay are what may differ between
    runs.
    """
    settings = {
        key: value
        for key, value in configs[0].to_dict().items()
        if key not in ("agent", "seed", "replay")
    }
    agents = list(dict.fromkeys(config.agent for config in configs))
    return {
        "settings": settings,
        "agents": agents,
        "seeds": sorted({config.seed for config in configs}),
    }


def _check_folder(configs, out):
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is not a folder; choose another --out")
    out.mkdir(parents=True, exist_ok=True)
    known = out / "study.json"
    if known.exists():
        if files.read_json(known, "settings")["settings"] != _description(configs)["settings"]:
            raise UsageError(
                f"the study in {out} has other settings; repeat them, or choose another --out"
            )
    elif any(path.suffix != ".part" for path in out.iterdir()):
        raise UsageError(f"{out} is not empty and holds no study; choose another --out")


def _train_in_processes(jobs, left, runs_of_bar, bar):
    with ProcessPoolExecutor(jobs, get_context("spawn"), die_with_parent) as executor:
        return _train_all(executor, left, runs_of_bar, bar)


def die_with_parent():
    """In a worker: where the study is killed, leave its run to the next one that is started."""

    def watch():
        parent_process().join()
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _train_all(executor, left, runs_of_bar, bar):
    """{folder: exception} of the runs that failed; the bar counts the episodes of all runs of the
    study.
    """
    submit = executor.submit
    folders = {
        submit(train_one, config.to_dict(), str(folder.resolve())): folder
        for folder, config in left.items()
    }
    pending = set(folders)
    try:
        while pending:
            _, pending = wait(pending, timeout=0.5)
            bar.n = sum(_episodes(folder / "episodes.csv") for folder in runs_of_bar)
            bar.refresh()
    except KeyboardInterrupt:
        for future in pending:
            future.cancel()
        raise
    return {folder: future.exception() for future, folder in folders.items() if future.exception()}


def _episodes(path):
    return max(0, path.read_bytes().count(b"\n") - 1) if path.exists() else 0

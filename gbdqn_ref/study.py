"""Many runs, {name: config}, each in a folder. Complete runs are not repeated.

    study.json       the settings that all runs share, and those that differ
    NAME/            one run each, as runs.train() leaves it
    results.json     the same with the summaries of all runs, when all are complete

A study that was killed and started again ends with the same bytes as one that was not.

A worker is a new Python process. It reads one line from stdin, which describes its run. Nothing
more is sent. Its stdin closes when the study's process is gone, and then the worker exits.
"""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, wait
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from reprlib import repr as short
from threading import Thread
from typing import Any

from tqdm import tqdm

from . import StudyError, UsageError, files, plots, runs
from .agents import OWN
from .config import Config
from .schedule import is_count
from .stats import Rows

MOST_RUNS, MOST_JOBS = 10_000, 1_000
NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._-]{0,198}[A-Za-z0-9])?")
EACH = ("agent", "seed", "replay")  # stated for each run, even if all agree
PAUSE, GRACE = 0.1, 0.5  # seconds between two polls of the workers, and for them to stop
STOPPED = 130  # the exit status of a process that was asked to stop
ASKED_TO_STOP = {STOPPED, -signal.SIGINT, -signal.SIGTERM}
PROGRAM = "from gbdqn_ref import study; study.work()"


def grid(configs: Mapping[str, Config], seeds: Sequence[int]) -> dict[str, Config]:
    """Each agent, or each variant of the settings, on each seed: {"NAME-SEED": config}.

    >>> base = Config(env="acrobot", agent="dqn")
    >>> list(grid({"dqn": base, "linear": replace(base, hidden=())}, [3, 7]))
    ['dqn-3', 'linear-3', 'dqn-7', 'linear-7']
    """
    _check_size(len(configs) * len(seeds))
    if len(set(seeds)) < len(seeds):
        raise UsageError(f"a seed is named twice: {short(list(seeds))}")
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
    accept: bool = False,
) -> dict[str, str]:
    """Train every {name: config} into out/NAME; {name: error} of the runs that failed.

    Runs with the same seed meet the same starts. By default `jobs` processes train them and stop
    with this one; an executor, like Dask's, takes their place. Runs of other versions are not mixed
    with new ones unless `accept` is true.
    """
    out = Path(out)
    _check_size(len(configs))
    _check_names(configs)
    if not is_count(jobs) or not 1 <= jobs <= MOST_JOBS:
        raise UsageError(f"jobs must be a whole number from 1 to {MOST_JOBS:,}, not {short(jobs)}")
    _check_folder(configs, out)
    left = [name for name in configs if not (out / name / "summary.json").exists()]
    if left and not accept:
        _check_versions(configs, out)
    with files.locked(out):
        files.write_json(out / "study.json", _description(configs))
        with _bar(configs, out, quiet) as show:
            tasks = {
                name: (configs[name].to_dict(), str((out / name).resolve()), accept)
                for name in left
            }
            failed = (
                _train_over(executor, tasks, show) if executor else train_all(tasks, jobs, show)
            )
        if not failed:
            files.write_json(out / "results.json", _results(configs, out))
    return failed


def complete(*arguments: Any, **options: Any) -> None:
    """run_study() that raises StudyError unless every run is then complete."""
    errors = run_study(*arguments, **options)
    if errors:
        raise StudyError(errors)


def _check_size(count: int) -> None:
    if not 1 <= count <= MOST_RUNS:
        raise UsageError(f"a study has from 1 to {MOST_RUNS:,} runs, not {count:,}")


def _check_names(configs: Mapping[str, Config]) -> None:
    """UsageError unless the names can be distinct folders on every system."""
    for name in configs:
        if not isinstance(name, str) or not NAME.fullmatch(name) or name.endswith(".json"):
            raise UsageError(
                f"a run needs a name of letters, digits, '.', '_' and '-', not {short(name)}"
            )
    if len({name.lower() for name in configs}) < len(configs):
        raise UsageError("two runs have names that differ only in case")


def _check_folder(configs: Mapping[str, Config], out: Path) -> None:
    """UsageError if the folder holds something else, other settings, or a damaged run."""
    begun = [name for name in configs if (out / name / "config.json").exists()]
    if (out / "study.json").exists():
        known = files.read_json(out / "study.json", settings=(dict,))["settings"]
        wanted = _description(configs)["settings"]
        _refuse_others(out, known, {key: wanted[key] for key in wanted if key not in OWN})
    elif out.is_dir() and not begun and any(path.suffix != ".part" for path in out.iterdir()):
        raise UsageError(f"{out} is not empty and holds no study; choose another --out")
    for name in begun:
        known = runs.read_config(out / name).resolved().to_dict()
        _refuse_others(out / name, known, configs[name].resolved().to_dict())
        if (out / name / "summary.json").exists():
            runs.read_run(configs[name], out / name)


def _check_versions(configs: Mapping[str, Config], out: Path) -> None:
    """UsageError if the folder holds runs of other versions."""
    for name in configs:
        changed = runs.changes(out / name) if (out / name / "config.json").exists() else []
        if changed:
            raise runs.other_versions(out / name, changed)


def _refuse_others(out: Path, known: Mapping[str, Any], wanted: Mapping[str, Any]) -> None:
    """UsageError if two sets of settings differ in one that both of them state."""
    others = [key for key in wanted if key in known and known[key] != wanted[key]]
    if others:
        raise UsageError(
            f"{out} has other settings ({', '.join(others)}); repeat them or choose another --out"
        )


def _description(configs: Mapping[str, Config]) -> dict[str, Any]:
    """The contents of study.json, with every default filled in."""
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


def _results(configs: Mapping[str, Config], out: Path) -> dict[str, Any]:
    """The contents of results.json: for each run its settings, its versions and its summary."""
    description = _description(configs)
    rows = []
    for name, differs in description["runs"].items():
        recorded = files.read_json(out / name / "config.json", "config")
        made_by = {key: recorded[key] for key in recorded if key not in ("config", "own")}
        rows.append({"name": name, "settings": differs} | made_by | runs.read_summary(out / name))
    return description | {"runs": rows}


def report(folder: Path | str) -> tuple[dict[str, Rows], dict[str, list[Rows]]]:
    """({label: [summary per seed]}, {label: [records per seed]}) of a complete study.

    A label is a run's name without its seed: an agent, or a variant of the settings. The seeds are
    sorted.
    """
    folder = Path(folder)
    summaries: dict[str, Any] = {}
    records: dict[str, Any] = {}
    rows = files.read_json(folder / "results.json", runs=[runs.SUMMARY])["runs"]
    for row in sorted(rows, key=lambda row: row["seed"]):
        name = row.get("name", f"{row['agent']}-{row['seed']}")
        label = name.removesuffix(f"-{row['seed']}")
        summaries.setdefault(label, []).append(row)
        records.setdefault(label, []).append(runs.read_episodes(folder / name))
    return summaries, records


def draw(
    out: Path | str,
    config: Config,
    summaries: Mapping[str, Rows],
    records: Mapping[str, Sequence[Rows]],
) -> None:
    """Draw a study of agents: curves, adaptation to drifts, differences from DQN."""
    random = next(iter(summaries.values()))[0]["random_return"]
    figures = {"curves": plots.study_curves(records, config, random)}
    if len(config.regimes) > 1 and set(summaries) - {"random"}:
        figures["adaptation"] = plots.adaptation(summaries, config)
    if len(summaries) > 1 and "dqn" in summaries:
        figures["forest"] = plots.forest(summaries, config)
    for name, figure in figures.items():
        plots.save(figure, Path(out) / f"{name}.png")


def comparison(out: Path | str, configs: Mapping[str, Config]) -> dict[str, dict[str, Any]]:
    """{agent: summary} of a complete study of one seed; draws their curves in one picture."""
    out, config = Path(out), next(iter(configs.values()))
    summaries = {agent: runs.read_summary(out / agent) for agent in configs}
    records = {agent: runs.read_episodes(out / agent) for agent in configs}
    random = summaries[config.agent]["random_return"]
    plots.save(plots.learning_curves(records, config, random), out / "comparison.png")
    return summaries


# --- training -------------------------------------------------------------------------------------


Task = tuple[dict[str, Any], str, bool]  # the arguments of train_one()


def train_one(values: Mapping[str, Any], folder: str, accept: bool = False) -> None:
    """Train or resume one run, in any process, from its settings {name: value} and its folder."""
    begun = (Path(folder) / "config.json").exists()
    runs.train(Config.from_dict(values), folder, resume=begun, quiet=True, accept=accept)


@contextmanager
def _bar(configs: Mapping[str, Config], out: Path, quiet: bool) -> Iterator[Callable[[], None]]:
    """A progress bar over the episodes of all runs; yields the function that updates it."""
    tables = [out / name / "episodes.csv" for name in configs]
    total, title = sum(config.episodes for config in configs.values()), f"{len(configs)} runs"
    with tqdm(
        total=total, initial=_episodes(tables), unit="ep", desc=title, disable=quiet or None
    ) as bar:

        def show() -> None:
            if not bar.disable:
                bar.n = _episodes(tables)
                bar.refresh()

        yield show


def _episodes(tables: Sequence[Path]) -> int:
    """The number of episodes in some episodes.csv, which may not exist yet."""
    lines = [path.read_bytes().count(b"\n") for path in tables if path.exists()]
    return sum(max(0, count - 1) for count in lines)


def _train_over(
    executor: Executor, tasks: Mapping[str, Task], show: Callable[[], object]
) -> dict[str, str]:
    """train_all() by an executor; if stopped, it finishes only the runs it has begun."""
    futures = {executor.submit(train_one, *task): name for name, task in tasks.items()}
    pending = set(futures)
    try:
        while pending:
            _, pending = wait(pending, timeout=0.5)
            show()
    finally:
        for future in pending:
            future.cancel()
    errors = {
        name: CancelledError("by the cluster") if future.cancelled() else future.exception()
        for future, name in futures.items()
    }
    return {name: in_a_line(error) for name, error in errors.items() if error}


class Worker(subprocess.Popen):
    """A process that trains one run."""

    def __init__(self, task: Task) -> None:
        self.log = tempfile.TemporaryFile()  # noqa: SIM115
        imports = {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONIOENCODING": "utf-8"}
        super().__init__(
            [sys.executable, "-P", "-c", PROGRAM],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self.log,
            env=os.environ | imports,
        )
        with suppress(BrokenPipeError):  # it has been killed already
            self.stdin.write(f"{json.dumps(task)}\n".encode())  # type: ignore[union-attr]

    def last_words(self) -> str:
        """The last line of stderr of a worker that has ended; closes its files."""
        with self, self.log as log:
            log.seek(0)
            lines = log.read().decode(errors="replace").splitlines()
        return lines[-1] if lines else f"its process ended with status {self.returncode}"


def train_all(tasks: Mapping[str, Task], jobs: int, show: Callable[[], object]) -> dict[str, str]:
    """Give every {name: task} to a worker, `jobs` at a time; {name: error} of those that failed.

    show() is called about ten times a second. A run whose worker is killed is retried once.
    KeyboardInterrupt if this process or a worker is asked to stop; no worker outlives the call.
    """
    waiting, killed, failed = list(tasks), set(), {}
    working: dict[str, Worker] = {}
    try:
        while waiting or working:
            for name in waiting[: jobs - len(working)]:
                waiting.remove(name)
                working[name] = Worker(tasks[name])
            time.sleep(PAUSE)
            show()
            for name in [each for each, worker in working.items() if worker.poll() is not None]:
                status, error = working[name].returncode, working.pop(name).last_words()
                if status in ASKED_TO_STOP:
                    raise KeyboardInterrupt
                if status < 0 and name not in killed:
                    killed.add(name)
                    waiting.append(name)
                elif status:
                    failed[name] = error
    finally:
        _stop(working.values())
    return failed


def _stop(workers: Collection[Worker]) -> None:
    """Ask workers to stop, and kill those that take too long."""
    latest = time.monotonic() + GRACE
    for worker in workers:
        worker.terminate()
    for worker in workers:
        with suppress(subprocess.TimeoutExpired):
            worker.wait(max(0.0, latest - time.monotonic()))
        worker.kill()
        worker.last_words()


def stop_on_signals() -> None:
    """From now on SIGINT and SIGTERM raise KeyboardInterrupt in this process."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)


def work() -> None:
    """A worker's main function: train the run that stdin describes, and exit if stdin closes."""
    stop_on_signals()
    task = json.loads(sys.stdin.readline())
    Thread(target=_end_with_stdin, daemon=True).start()
    try:
        train_one(*task)
    except KeyboardInterrupt:
        os._exit(STOPPED)  # at once, because Python is slow to exit
    except Exception as e:
        sys.exit(in_a_line(e))


def _end_with_stdin() -> None:
    os.read(0, 1)  # sys.stdin.read would hold a lock that Python needs at exit
    os._exit(STOPPED)


def in_a_line(error: BaseException) -> str:
    """An error on one line, even if a path in it has line breaks."""
    return " ".join(f"{type(error).__name__}: {error}".split())

"""A run's folder: what is in it, how it is written, and how a killed run continues.

    config.json      the settings, and the versions of the libraries and of the code
    episodes.csv     one line per episode, written as it ends
    checkpoint.npz   the whole agent, at most ten seconds old
    summary.json     the table per regime, when the run is complete
    curve.png        the learning curve and the drifts, when the run is complete

No file depends on the clock: a run that was killed and resumed ends with the same bytes as one that
was not. docs/promises.md lists all promises.
"""

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from reprlib import repr as short
from typing import Any

from tqdm import tqdm

from . import DivergenceError, UsageError, checkpoint, drift, plots, provenance, stats
from .agents import AGENTS, OWN
from .config import Config
from .files import (
    NUMBER,
    append,
    check_shape,
    locked,
    read_json,
    sync,
    undamaged,
    write_atomically,
    write_json,
)
from .replay import RecencyReplay
from .train import evaluate, make_agent, run

Record = dict[str, Any]

COLUMNS: dict[str, Callable[[str], Any]] = {
    "episode": int,
    "regime": int,
    "event": str,
    "return": float,
    "length": int,
    "steps": int,
    "epsilon": float,
    "td_error": float,
    "evaluation": lambda text: [float(mean) for mean in text.split()],
}
HEADER = ",".join(COLUMNS).encode()
CHECKPOINT_SECONDS = 10
FILES = "config.json", "episodes.csv", "summary.json", "checkpoint.npz", "curve.png"

RUN = {"env": (str,), "agent": (str,), "seed": (int,), "episodes": (int,)}
MADE_WITH = {"versions": (dict,), "code": (dict,)}
CONFIG_FILE = MADE_WITH | {"config": RUN, "own": (dict,), "continued": [MADE_WITH]}
UNRECORDED: dict = {"own": {}, "versions": {}, "code": {}, "continued": []}  # in older runs
MAYBE = (*NUMBER, type(None))
REGIME = {
    "regime": (int,),
    "first_episode": (int,),
    "episodes": (int,),
    "event": (str,),
    "mean_return": NUMBER,
    "drop": MAYBE,
    "recovery": MAYBE,
    "area": MAYBE,
}
SUMMARY = RUN | {
    "steps": (int,),
    "final_return": NUMBER,
    "random_return": NUMBER,
    "regimes": [REGIME],
    "evaluation": [[NUMBER]],
}


def train(
    config: Config, out: Path | str, resume: bool = False, quiet: bool = False, accept: bool = False
) -> dict[str, Any]:
    """Train into the folder `out`, showing progress; returns its summary.

    Without resume the folder must be new or empty. With it, a killed run continues from its
    checkpoint, and a complete run is only read. With other libraries or other code a run continues
    only if `accept` is true, and config.json then records the change.
    """
    out = Path(out)
    if resume:
        _check_settings(config, out)
    with locked(out):
        if not resume:
            _check_empty(out)
        if not (out / "summary.json").exists():
            _complete(config, out, resume, quiet, accept)
        summary, _ = read_run(config, out)
        if not (out / "curve.png").exists():
            _draw(config, summary["random_return"], out)
    return summary


def _complete(config: Config, out: Path, resume: bool, quiet: bool, accept: bool) -> None:
    """Train a run to its end, from its checkpoint or from the start."""
    agent, first = _new_agent(config), 0  # first, because it may not fit into memory
    if (out / "checkpoint.npz").exists():
        first = checkpoint.load(out / "checkpoint.npz", agent)
    changed = changes(out) if resume else []
    if changed and not accept:
        raise other_versions(out, changed)
    if not resume:
        _write_config(config, out)
    _cut(out / "episodes.csv", first)
    if changed:
        _record_change(config, first, out)
    if first < config.episodes:
        try:
            _write_episodes(config, agent, first, out, quiet)
            agent = agent.finish()
        except FloatingPointError as e:
            raise DivergenceError(f"training diverged at its end: {e}") from e
        checkpoint.save(out / "checkpoint.npz", agent, config.episodes)
    summary = summarise(config, agent, read_episodes(out), random_return(config))
    write_json(out / "summary.json", summary)


def _write_episodes(config: Config, agent: Any, first: int, out: Path, quiet: bool) -> None:
    """Append a line per episode, and save a checkpoint every few seconds.

    The lines are on disk before the checkpoint that counts them.
    """
    path, saved = out / "episodes.csv", time.monotonic()
    with tqdm(
        total=config.episodes, initial=first, unit="ep", desc=config.agent, disable=quiet or None
    ) as bar:
        for record in run(config, agent, first):
            append(path, _line(record))
            bar.set_postfix(_progress(record), refresh=False)
            bar.update()
            episodes = record["episode"] + 1
            if time.monotonic() - saved > CHECKPOINT_SECONDS and episodes < config.episodes:
                sync(path)
                checkpoint.save(out / "checkpoint.npz", agent, episodes)
                saved = time.monotonic()
    sync(path)


def _line(record: Record) -> bytes:
    """A line of episodes.csv."""
    values = record | {"evaluation": " ".join(map(repr, record["evaluation"]))}
    return (",".join(str(values[name]) for name in COLUMNS) + "\n").encode()


def _progress(record: Record) -> dict[str, Any]:
    """What the progress bar shows of the last episode."""
    return {
        "return": f"{record['return']:.0f}",
        "ε": f"{record['epsilon']:.2f}",
        "regime": record["regime"],
    }


def summarise(
    config: Config, agent: Any, records: Sequence[Record], random: float
) -> dict[str, Any]:
    """The contents of summary.json.

    `evaluation` has a row per regime, at whose end it was made, and a column per regime evaluated.
    """
    summary = {
        "env": config.env,
        "agent": config.agent,
        "seed": config.seed,
        "episodes": len(records),
        "steps": records[-1]["steps"],
        "final_return": stats.final_return([record["return"] for record in records]),
        "random_return": random,
        "regimes": stats.regime_table(records, random),
        "evaluation": [record["evaluation"] for record in records if record["evaluation"]],
    }
    if isinstance(agent.replay, RecencyReplay):
        summary["recency_share_of_replay"] = 1 - agent.replay.td_share()
    return summary


def random_return(config: Config, episodes: int = 20) -> float:
    """Mean return of the random policy in the stock physics: the zero of the level scale."""
    agent = make_agent(Config(env=config.env, agent="random"))
    return float(evaluate(agent, drift.make(config.env), episodes, seed=0).mean())


def _draw(config: Config, random: float, out: Path) -> None:
    """Draw curve.png; a failure is reported in one line and has no other effect."""
    records, path = read_episodes(out), out / "curve.png"
    try:
        plots.save(plots.learning_curves({config.agent: records}, config, random), path)
    except Exception as e:  # LaTeX, fonts, a full disk: each fails in its own way
        reason = f"{type(e).__name__}: {e}".splitlines()[0]
        print(
            f"gbdqn_ref: {path} could not be drawn ({reason}); the run is complete without it, and"
            " train --resume tries again",
            file=sys.stderr,
        )


# --- starting and continuing ----------------------------------------------------------------------


def changes(folder: Path | str) -> list[str]:
    """How today's versions differ from those that last worked on the run in a folder."""
    content = _read_config_file(folder)
    before = [content, *content["continued"]][-1]
    return provenance.changes(before, provenance.of(read_config(folder)))


def other_versions(folder: Path, changed: Sequence[str]) -> UsageError:
    """The error for a run that these versions did not make."""
    return UsageError(
        f"the run in {folder} was made with other versions ({', '.join(changed)}); go back to"
        " them, or continue with --accept-versions"
    )


def _new_agent(config: Config) -> Any:
    try:
        return make_agent(config)
    except MemoryError as e:
        raise UsageError(
            f"the agent does not fit into memory ({e}); choose a smaller capacity or hidden"
        ) from e


def _check_settings(config: Config, out: Path) -> None:
    """UsageError if the run in the folder has other settings; missing ones are the defaults."""
    before, now = (each.resolved().to_dict() for each in (read_config(out), config))
    other = [f"{name}={short(before[name])}" for name in now if before[name] != now[name]]
    if other:
        raise UsageError(
            f"the run in {out} has other settings ({', '.join(other)}); give none to resume"
            " it, or choose another --out"
        )


def _check_empty(out: Path) -> None:
    """UsageError if the folder has files, other than those half-written in a crash."""
    if any(path.suffix != ".part" for path in out.iterdir()):
        raise UsageError(
            f"{out} is not empty; choose another --out, or continue the run in it with --resume"
        )


def _write_config(config: Config, out: Path) -> None:
    own = {key: getattr(config.resolved(), key) for key in OWN | AGENTS[config.agent].own}
    content = {"config": config.to_dict(), "own": own} | provenance.of(config)
    write_json(out / "config.json", content)


def _record_change(config: Config, first: int, out: Path) -> None:
    """Record in config.json the versions that make the run from this episode on."""
    content = _read_config_file(out)
    entry = {"episode": first} | provenance.of(config)
    write_json(out / "config.json", content | {"continued": [*content["continued"], entry]})


def _cut(path: Path, episodes: int) -> None:
    """Cut episodes.csv to the first so many episodes, after which the run continues."""
    lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []  # complete lines
    kept = lines[: episodes + 1] if episodes else [HEADER]
    if len(_parse(path, kept)) < episodes:
        raise UsageError(
            f"{path} has fewer than the {episodes} episodes of the checkpoint beside it; restore"
            " it, or delete checkpoint.npz to start again"
        )
    write_atomically(path, lambda file: file.write(b"\n".join(kept) + b"\n"))


# --- reading --------------------------------------------------------------------------------------


def _read_config_file(folder: Path | str) -> dict[str, Any]:
    """config.json as a dict; what an older run did not record is empty."""
    path = Path(folder) / "config.json"
    if not path.exists():
        raise UsageError(
            f"there is no run in {folder} (no config.json); train --out {folder} starts one"
        )
    content = UNRECORDED | read_json(path, config=RUN)
    with undamaged(path):
        check_shape(content, CONFIG_FILE, "it")
    return content


def read_config(folder: Path | str) -> Config:
    """The Config of the run in a folder.

    The agent's own settings are None, unless the agent's values have changed since.
    """
    content = _read_config_file(folder)
    with undamaged(Path(folder) / "config.json"):
        given = Config.from_dict(content["config"])
        made = Config.from_dict(content["config"] | content["own"])
    return given if given.resolved() == made.resolved() else made


def read_agent(folder: Path | str) -> tuple[Config, Any]:
    """(Config, agent) of the run in a folder, from its last checkpoint."""
    config, path = read_config(folder), Path(folder) / "checkpoint.npz"
    agent = _new_agent(config)
    if not path.exists():
        complete = (Path(folder) / "summary.json").exists()
        remedy = "train it anew in another folder" if complete else "continue it: train --resume"
        raise UsageError(f"the run in {folder} has no checkpoint.npz; {remedy}")
    checkpoint.load(path, agent)
    return config, agent


def read_run(config: Config, folder: Path | str) -> tuple[dict[str, Any], list[Record]]:
    """(summary, records) of a complete run; UsageError unless its files are of one run."""
    summary, records = read_summary(folder), read_episodes(folder)
    expected: dict[str, Any] = {key: getattr(config, key) for key in RUN}
    expected["regimes"] = list(range(len(config.regimes)))
    found = {key: summary[key] for key in RUN}
    found["regimes"] = [row["regime"] for row in summary["regimes"]]
    _refuse_two_runs(folder, "config.json", expected, found)
    _refuse_two_runs(folder, "episodes.csv", {"episodes": len(records)}, found)
    last = {
        "steps": records[-1]["steps"],
        "final_return": stats.final_return([record["return"] for record in records]),
    }
    _refuse_two_runs(folder, "episodes.csv", last, summary)
    return summary, records


def _refuse_two_runs(
    folder: Path | str, file: str, expected: dict[str, Any], summary: dict[str, Any]
) -> None:
    found = {key: summary[key] for key in expected}
    if found != expected:
        raise UsageError(
            f"{folder} is damaged: {file} has {expected}, summary.json {found}; restore them"
        )


def read_summary(folder: Path | str) -> dict[str, Any]:
    """summary.json as a dict."""
    path = Path(folder) / "summary.json"
    summary = read_json(path, **SUMMARY)
    with undamaged(path):  # only a replay with recency has this share
        check_shape(summary.get("recency_share_of_replay", 0), NUMBER, "its recency share")
    return summary


def read_episodes(folder: Path | str) -> list[Record]:
    """The records of episodes.csv, as train.run() yields them."""
    path = Path(folder) / "episodes.csv"
    return _parse(path, path.read_bytes().splitlines())


def _parse(path: Path, lines: Sequence[bytes]) -> list[Record]:
    """The records in the lines of an episodes.csv; UsageError names a damaged line."""
    if not lines or lines[0] != HEADER:
        raise UsageError(f"{path} is damaged: its first line should read {HEADER.decode()}")
    records: list[Record] = []
    for k, line in enumerate(lines[1:]):
        try:
            cells = zip(COLUMNS.items(), line.decode().split(","), strict=True)
            records.append({name: kind(text) for (name, kind), text in cells})
            if records[k]["episode"] != k:
                raise ValueError(f"episode {k} is missing")
        except ValueError as e:
            raise UsageError(
                f"{path} is damaged in line {k + 2} ({e}); restore it or start a new run"
            ) from e
    return records

"""A run's folder: what is in it, how it is written, and how a run goes on after it was killed.

    config.json      the resolved settings, and the versions of what made them
    episodes.csv     one line per episode, written as it ends
    checkpoint.npz   the whole agent, at most ten seconds old
    summary.json     the table per regime, when the run is complete
    curve.png        the learning curve with its drifts, likewise

No file depends on the clock: killed and resumed, a run ends with the same bytes as one that was
left alone.
"""

import csv
import platform
import time
from importlib.metadata import version
from pathlib import Path

import gymnasium
import numpy as np
from tqdm import tqdm

from . import UsageError, __version__, checkpoint, drift, plots, stats
from .config import Config
from .files import locked, read_json, write_atomically, write_json
from .replay import RecencyReplay
from .train import evaluate, make_agent, run

COLUMNS = {
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


def train(config, out, resume=False, quiet=False):
    """Train into the folder `out`, showing progress; returns its summary. A complete run is only
    read.

    Without resume the folder must be new or empty. With it, a run that was killed goes on from its
    checkpoint.
    """
    out = Path(out)
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is not a folder; choose another --out")
    if resume and read_config(out).resolved() != config.resolved():
        raise UsageError(
            f"the run in {out} has other settings; leave them out to resume it, or choose another"
            " --out"
        )
    out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        if not resume:
            _start(config, out)
        if not (out / "summary.json").exists():
            _train(config, out, quiet)
    return read_summary(out)


def _train(config, out, quiet):
    agent, first = make_agent(config), 0
    if (out / "checkpoint.npz").exists():
        first = checkpoint.load(out / "checkpoint.npz", agent)
    _cut(out / "episodes.csv", first)
    if first < config.episodes:
        _train_on(config, agent, first, out, quiet)
        agent = agent.finish()
        checkpoint.save(out / "checkpoint.npz", agent, config.episodes)
    records, level = read_episodes(out), random_return(config)
    plots.save(plots.learning_curves({config.agent: records}, config, level), out / "curve.png")
    write_json(out / "summary.json", summarise(config, agent, records, level))


def _train_on(config, agent, first, out, quiet):
    """Append a line per episode, with a checkpoint now and then."""
    saved = time.monotonic()
    with (
        open(out / "episodes.csv", "a", newline="", encoding="utf-8") as file,
        tqdm(
            total=config.episodes,
            initial=first,
            unit="ep",
            desc=config.agent,
            disable=quiet or None,
        ) as bar,
    ):
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        for record in run(config, agent, first):
            writer.writerow(record | {"evaluation": " ".join(map(repr, record["evaluation"]))})
            file.flush()
            bar.set_postfix(_progress(record), refresh=False)
            bar.update()
            episodes = record["episode"] + 1
            if time.monotonic() - saved > CHECKPOINT_SECONDS and episodes < config.episodes:
                checkpoint.save(out / "checkpoint.npz", agent, episodes)
                saved = time.monotonic()


def _progress(record):
    """What the bar shows of the last episode."""
    return {
        "return": f"{record['return']:.0f}",
        "ε": f"{record['epsilon']:.2f}",
        "regime": record["regime"],
    }


def summarise(config, agent, records, level):
    """The contents of summary.json; `evaluation` has a row after each regime, a column for each it
    is evaluated in.
    """
    summary = {
        "env": config.env,
        "agent": config.agent,
        "seed": config.seed,
        "episodes": len(records),
        "steps": records[-1]["steps"],
        "final_return": stats.final_return([record["return"] for record in records]),
        "random_return": level,
        "regimes": stats.regime_table(records, level),
        "evaluation": [record["evaluation"] for record in records if record["evaluation"]],
    }
    if isinstance(agent.replay, RecencyReplay):
        summary["recency_share_of_replay"] = 1 - agent.replay.td_share()
    return summary


def random_return(config, episodes=20):
    """Mean return of the random policy in the stock physics: the zero of the level scale."""
    agent = make_agent(Config(env=config.env, agent="random"))
    return float(evaluate(agent, drift.make(config.env), episodes, seed=0).mean())


def _start(config, out):
    """Put config.json into an empty folder; what a crash left half-written does not count."""
    if any(path.suffix != ".part" for path in out.iterdir()):
        raise UsageError(
            f"{out} is not empty; choose another --out, or continue the run in it with --resume"
        )
    versions = {
        "gbdqn_ref": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "gymnasium": gymnasium.__version__,
        "mujoco": version(
            "mujoco"
        ),  # not imported for its version: it takes as long as all else together
    }
    write_json(out / "config.json", {"config": config.to_dict(), "versions": versions})


def read_config(out):
    """The Config of the run in a folder."""
    path = Path(out) / "config.json"
    if not path.exists():
        raise UsageError(f"there is no run in {out} (no config.json); start one without --resume")
    values = read_json(path, "config")["config"]
    try:
        return Config.from_dict(values)
    except (UsageError, TypeError) as e:
        raise UsageError(
            f"{path} is damaged ({e}); restore it or start a new run in another folder"
        ) from e


def read_agent(out):
    """(Config, agent) of the run in a folder, as its last checkpoint has it."""
    config = read_config(out)
    agent = make_agent(config)
    if not (Path(out) / "checkpoint.npz").exists():
        raise UsageError(
            f"the run in {out} has no checkpoint.npz yet; let it go on with train --resume"
        )
    checkpoint.load(Path(out) / "checkpoint.npz", agent)
    return config, agent


def read_summary(out):
    """summary.json as a dict."""
    return read_json(Path(out) / "summary.json", "regimes", "final_return", "random_return")


def read_episodes(out):
    """The records of episodes.csv, as train.run() yields them."""
    path = Path(out) / "episodes.csv"
    return _parse(path, path.read_bytes().splitlines())


def _parse(path, lines):
    """Records from the lines of an episodes.csv; UsageError names the line that is not as it should
    be.
    """
    if not lines or lines[0] != HEADER:
        raise UsageError(f"{path} is damaged: its first line should read {HEADER.decode()}")
    records = []
    for k, line in enumerate(lines[1:]):
        try:
            values = line.decode().split(",")
            records.append(
                {
                    name: kind(text)
                    for (name, kind), text in zip(COLUMNS.items(), values, strict=True)
                }
            )
            if records[k]["episode"] != k:
                raise ValueError(f"episode {k} is missing")
        except ValueError as e:
            raise UsageError(
                f"{path} is damaged in line {k + 2} ({e}); restore it or start a new run"
            ) from e
    return records


def _cut(path, episodes):
    """Bring episodes.csv back to the first so many episodes, since the run goes on from there."""
    lines = (
        path.read_bytes().split(b"\n")[:-1] if path.exists() else []
    )  # but for what follows the last line's end
    kept = lines[: episodes + 1] if episodes else [HEADER]
    if len(_parse(path, kept)) < episodes:
        raise UsageError(
            f"{path} does not hold the {episodes} episodes that the checkpoint beside it has seen"
        )
    write_atomically(path, lambda file: file.write(b"\n".join(kept) + b"\n"))

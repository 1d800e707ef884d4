"""Calibrate the detectors on runs without a drift, and count what they find on runs with drifts.

    python benchmarks/keep/calibrate.py record --env acrobot --seeds 20 --out runs/calibration
    python benchmarks/keep/calibrate.py levels --env acrobot --out runs/calibration
    python benchmarks/keep/calibrate.py found runs/detected-acrobot

`record` trains DQN, which hears of no event, under the preset `null` and keeps what each detector
would chart. `levels` bootstraps runs without a drift from blocks of these: false alarms per run at
each level, and how soon a fall of the return is found, by its size. `found` reads the folders of a
study with detecting agents. A drift counts if it costs a run half of its own span, by its stored
greedy evaluation.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path

import numpy as np

from gbdqn_ref import detect, files, runs, stats, train
from gbdqn_ref.config import Config

LEVELS = (4, 4.5, 5, 6, 8, 10, 12, 15, 20, 25, 30)
BLOCK, RUNS = 100, 400  # episodes in a block, bootstrapped runs
WITHIN, FAR = 10, 50  # episodes in which a drift must be found, and after which an alarm is false
TARGET = 0.05  # false alarms per run


class Recorder:
    """In place of a detector's chart: keeps the charted numbers and raises no alarm."""

    def __init__(self):
        self.values = []

    def update(self, x, at):
        self.values.append(x)


class Detectors:
    """In place of an agent's detector: every detector at once, on recorders."""

    def __init__(self, parts):
        self.parts = parts

    def update(self, *episode):
        for part in self.parts:
            part.update(*episode)


def record(env, out, seed):
    """Train one run without a drift and write {symptom: charted numbers} of its episodes."""
    config = Config.preset(env, "null", agent="dqn", seed=seed, drift_signal=[])
    agent = train.make_agent(config)
    shape = agent.replay.s.shape[1], agent.n_actions
    model = detect.TransitionModel(*shape, np.random.default_rng(seed))
    parts = {symptom: detect.Detector(symptom, np.inf, model) for symptom in detect.SLACK}
    for part in parts.values():
        part.chart = Recorder()
    agent.detector = Detectors(parts.values())
    for _ in train.run(config, agent):
        pass
    files.write_json(out / f"{env}-{seed}.json", {s: p.chart.values for s, p in parts.items()})


def bootstrapped(series, first, rng):
    """A run without a drift: the series up to `first`, then blocks of the rest of it.

    Episodes without an update have no TD error, so its series is shorter.
    """
    values = series[:first]
    while len(values) < len(series):
        start = rng.integers(first, len(series) - BLOCK + 1)
        values = values + series[start : start + BLOCK]
    return values[: len(series)]


def alarms(symptom, series, level):
    """The episodes at which a chart of the series raises an alarm."""
    chart = detect.Chart(level, detect.SLACK[symptom])
    return [k for k, x in enumerate(series) if chart.update(x, k) is not None]


def delay(series, level, at, size, floor):
    """Episodes until a fall of the return is found that costs `size` of what is above the floor."""
    fallen = [x if k < at else x + size * (-floor - x) for k, x in enumerate(series)]
    return next((k - at + 1 for k in alarms("return", fallen, level) if k >= at), np.inf)


def levels(env, out):
    """Print the table of an environment, and the lowest level that meets the target."""
    config = Config.preset(env, "null")
    first, floor = config.regimes[1].start, random_return(env)
    recorded = [json.loads(path.read_text()) for path in sorted(out.glob(f"{env}-[0-9]*.json"))]
    print(f"\n{env}, {len(recorded)} runs; false alarms per run, bootstrapped and as recorded")
    events, episodes = len(config.regimes) - 1, config.episodes - first
    print(f"always fires: {config.episodes} false alarms per run, every drift found in 1")
    by_chance = 1 - (1 - events / episodes) ** WITHIN
    print(
        f"at random, {events} times: {events} false alarms per run, {by_chance:.2f} found in time"
    )
    for symptom in detect.SLACK:
        rng = np.random.default_rng(0)
        known = [each[symptom] for each in recorded]
        series = [bootstrapped(known[i % len(known)], first, rng) for i in range(RUNS)]
        rates = [np.mean([len(alarms(symptom, x, level)) for x in series]) for level in LEVELS]
        for level, rate in zip(LEVELS, rates, strict=True):
            own = np.mean([len(alarms(symptom, x, level)) for x in known])
            found = by_size(series, level, first, floor) if symptom == "return" else ""
            print(f"{symptom:9} {level:4}  {rate:6.2f} {own:6.2f}  {found}")
        good = [level for level, rate in zip(LEVELS, rates, strict=True) if rate <= TARGET]
        print(f"{symptom}: {good[0] if good else 'no level'} meets {TARGET} per run")


def by_size(series, level, first, floor):
    """Shares of falls of 25, 50 and 100 % that are found in time, and the median delays."""
    rng, cells = np.random.default_rng(1), []
    for size in (0.25, 0.5, 1.0):
        at = rng.integers(first, len(series[0]) - 2 * WITHIN, len(series))
        delays = [delay(x, level, k, size, floor) for x, k in zip(series, at, strict=True)]
        cells.append(
            f"{size:.0%}: {np.mean(np.array(delays) <= WITHIN):.2f} in {np.median(delays)}"
        )
    return ", ".join(cells)


def found(folder):
    """Print per agent how many costly drifts its alarms found, and how many alarms were false."""
    counts = {}
    for path in sorted(folder.glob("*/summary.json")):
        config, records = runs.read_config(path.parent), runs.read_episodes(path.parent)
        _, agent = runs.read_agent(path.parent)
        ends = [each["steps"] for each in records]
        raised = np.searchsorted(ends, agent.alarms).tolist()
        evaluations = [each["evaluation"] for each in records if each["evaluation"]]
        costly = costly_drifts(config, evaluations)
        delays, _, _ = stats.match_alarms(raised, costly, WITHIN)
        starts = [regime.start for regime in config.regimes[1:]]
        _, _, false = stats.match_alarms(raised, starts, FAR)
        counts.setdefault(config.agent, []).append((len(costly), len(delays), false, delays))
    for agent, rows in counts.items():
        costly, hits, false = (sum(row[i] for row in rows) for i in range(3))
        delays = [delay for row in rows for delay in row[3]]
        median = np.median(delays) if delays else np.nan
        print(
            f"{folder.name}, {agent}: {len(rows)} runs, {hits} of {costly} costly drifts found "
            f"within {WITHIN} episodes, median delay {median}, {false} false alarms"
        )


def costly_drifts(config, evaluations):
    """The episodes of the drifts that cost at least half of what the agent had learnt by then.

    Its greedy evaluation before the drift says so: of the current regime, and of the coming one.
    A run has an evaluation in every regime at the end of each; one that diverged has none.
    """
    floor, found = random_return(config.env), []
    span = max(map(max, evaluations), default=floor) - floor
    for k, (regime, before) in enumerate(zip(config.regimes[1:], evaluations, strict=False)):
        now, coming = before[k : k + 2]
        if now - floor > span / 2 and coming - floor <= (now - floor) / 2:
            found.append(regime.start)
    return found


@cache
def random_return(env):
    """The random policy's return: nothing is learnt."""
    return runs.random_return(Config(env=env))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["record", "levels", "found"])
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--env", default="acrobot")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/calibration"))
    args = parser.parse_args()
    if args.what == "record":
        args.out.mkdir(parents=True, exist_ok=True)
        with ProcessPoolExecutor(args.jobs) as pool:
            list(pool.map(partial(record, args.env, args.out), range(args.seeds)))
    elif args.what == "levels":
        levels(args.env, args.out)
    for folder in args.folders:
        found(folder)


if __name__ == "__main__":
    main()

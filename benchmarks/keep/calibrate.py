"""Calibrate the detectors on runs without a drift, and count what they find on runs with drifts.

    python benchmarks/keep/calibrate.py levels
    python benchmarks/keep/calibrate.py record --envs acrobot --results runs/again
    python benchmarks/keep/calibrate.py drift --envs acrobot --results runs/again
    python benchmarks/keep/calibrate.py quiet --envs acrobot,mountaincar,cartpole
    python benchmarks/keep/calibrate.py found runs/detected-acrobot

`record` trains DQN, which hears of no event, under the preset `null` on seeds 0 to 19, and keeps
what each detector would chart in ENV-charted.npz. `drift` does so in the same runs under the preset
`recurring`, until 20 episodes after the first drift, for ENV-drifted.npz. `quiet` prints, of all
charts with at most one alarm in twenty runs without a drift, the one that finds most first drifts
within ten episodes, for each environment and symptom, over slacks and levels.

Written before `drift` was run: no quiet chart of the TD error finds nine tenths of the first drifts
on Acrobot, MountainCar or CartPole; one of the model's error does on each of them. It came out
so but for Acrobot, where one of the return does, and none of the model's error.

`levels` bootstraps runs without a drift from blocks of what `record` keeps: it prints a table of
the false alarms per run, for each environment the lowest level with at most one in twenty runs, and
how soon a fall of the return is found, by its size.
`found` reads the folders of a study with detecting agents. A drift counts if it costs a run half of
what it had learnt by then, and if that was more than half of its best, by its stored greedy
evaluation.
"""

import argparse
from collections import ChainMap
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from protocol import count
from study import RESULTS, read_arrays
from workers import workers

from gbdqn_ref import UsageError, detect, files, runs, stats, train
from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.config import Config
from gbdqn_ref.presets import DETECTOR
from gbdqn_ref.schedule import LABELS, check_environment

LEVELS = (4, 4.5, 5, 6, 8, 10, 12, 15, 20, 25, 30)
SHOWN = {  # what is charted, in words, and the levels in the table
    "return": ("falling returns", (5, 10, 15)),
    "td_error": ("rising TD error", (10, 30)),
    "model": ("a model's rising error", (4, 4.5, 5)),
}
WIDE = *LEVELS, 40, 60, 80, 100  # and slacks: the charts among which the quiet ones are sought
SLACKS = 0.5, 1.0, 2.0
AFTER = 20  # episodes after the drift that are recorded
PRESETS = {"record": "null", "drift": "recurring"}
FILES = {"null": "{}-charted.npz", "recurring": "{}-drifted.npz"}  # preset: environment's file
SEEDS, BLOCK, RUNS = 20, 100, 400  # recorded runs, episodes in a block, bootstrapped runs
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


def record(env, preset, seed):
    """Train one run; {"SYMPTOM-SEED": the charted numbers of its episodes}.

    Under the preset `null` it has no drift; any other ends 20 episodes after its first one.
    """
    config = Config.preset(env, preset, agent="dqn", seed=seed, drift_signal=[])
    if preset != "null":
        first = config.schedule[0]
        config = replace(config, schedule=[first], episodes=first["episode"] + AFTER)
    agent = train.make_agent(config)
    shape = agent.replay.s.shape[1], agent.n_actions
    model = detect.TransitionModel(*shape, np.random.default_rng(seed))
    parts = {symptom: detect.Detector(symptom, np.inf, model) for symptom in SHOWN}
    for part in parts.values():
        part.chart = Recorder()
    agent.detector = Detectors(parts.values())
    for _ in train.run(config, agent):
        pass
    return {f"{symptom}-{seed}": np.float32(p.chart.values) for symptom, p in parts.items()}


def recorded(env, results, preset="null"):
    """What was charted in an environment, {symptom: one list per seed}."""
    path = results / FILES[preset].format(env)
    if not path.exists():
        raise UsageError(f"there is no {path}; `record` and `drift` write such files")
    arrays = read_arrays(path)
    seeds = range(len(arrays) // len(SHOWN))
    with files.undamaged(path):
        if not seeds:
            raise ValueError("it has no run")
        return {s: [arrays[f"{s}-{seed}"].tolist() for seed in seeds] for s in SHOWN}


def bootstrapped(series, first, rng):
    """A run without a drift: the series up to `first`, then blocks of the rest of it.

    Episodes without an update have no TD error, so its series is shorter.
    """
    values = series[:first]
    while len(values) < len(series):
        start = rng.integers(first, len(series) - BLOCK + 1)
        values = values + series[start : start + BLOCK]
    return values[: len(series)]


def alarms(symptom, series, level, slack=None):
    """The episodes at which a chart of the series raises an alarm; its slack is the symptom's."""
    chart = detect.Chart(level, detect.SLACK[symptom] if slack is None else slack)
    return [k for k, x in enumerate(series) if chart.update(x, k) is not None]


def delay(series, level, at, size, floor):
    """Episodes until a fall of the return is found that costs `size` of what is above the floor."""
    fallen = [x if k < at else x + size * (-floor - x) for k, x in enumerate(series)]
    return next((k - at + 1 for k in alarms("return", fallen, level) if k >= at), np.inf)


def false_alarms(symptom, series, level, slack=None):
    """Alarms per run in series without a drift."""
    return float(np.mean([len(alarms(symptom, x, level, slack)) for x in series]))


def found_in_time(symptom, series, level, slack=None):
    """The share of series with an alarm within ten episodes of the drift, 20 before their end."""
    ends = [(len(x) - AFTER, alarms(symptom, x, level, slack)) for x in series]
    return float(np.mean([any(0 <= k - at < WITHIN for k in raised) for at, raised in ends]))


def best_quiet(symptom, calm, drifted):
    """(share of first drifts found in time, slack, level): the best of the charts that are quiet
    in the calm series; (0, None, None) if none is.
    """
    quiet = [
        (slack, level)
        for slack, level in product(SLACKS, WIDE)
        if false_alarms(symptom, calm, level, slack) <= TARGET
    ]
    found = [(found_in_time(symptom, drifted, b, k), k, b) for k, b in quiet]
    return max(found, default=(0.0, None, None), key=lambda each: each[0])


def many(env, series):
    """So many bootstrapped runs from the recorded ones, each in its turn."""
    first, rng = Config.preset(env, "null").regimes[1].start, np.random.default_rng(0)
    if min(map(len, series)) < first + BLOCK:
        raise UsageError(f"a run that is recorded of {env} has fewer than {first + BLOCK} episodes")
    return [bootstrapped(series[i % len(series)], first, rng) for i in range(RUNS)]


def table(results, envs):
    """The table of false alarms per run: bootstrapped, and in brackets as recorded."""
    charted = {env: recorded(env, results) for env in envs}
    header = ["what is charted", *(LABELS[env] for env in envs)]
    rows = [header, ["---"] * len(header)]
    for symptom, (name, shown) in SHOWN.items():
        known = {env: charted[env][symptom] for env in envs}
        drawn = {env: many(env, series) for env, series in known.items()}
        for level in shown:
            cells = [f"{name}, level {level:g}" if level == shown[0] else f"level {level:g}"]
            for env in envs:
                rates = [false_alarms(symptom, x[env], level) for x in (drawn, known)]
                preset = Config.preset(env, "null")
                bold = "**" if (preset.symptom, preset.alarm_level) == (symptom, level) else ""
                cells.append(bold + "{:.2f} ({:.2f})".format(*rates) + bold)
            rows.append(cells)
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def levels(env, results):
    """Print the lowest level that meets the target, and what chance would do."""
    config = Config.preset(env, "null")
    first, floor = config.regimes[1].start, random_return(env)
    events, episodes = len(config.regimes) - 1, config.episodes - first
    by_chance = 1 - (1 - events / episodes) ** WITHIN
    print(f"\n{env}: always firing, {config.episodes} false alarms per run, all found in 1")
    print(f"at random {events} times, {events} false alarms per run, {by_chance:.2f} found in time")
    for symptom, series in recorded(env, results).items():
        drawn = many(env, series)
        rates = {level: false_alarms(symptom, drawn, level) for level in LEVELS}
        good = next((level for level, rate in rates.items() if rate <= TARGET), None)
        found = f": {by_size(drawn, good, first, floor)}" if good and symptom == "return" else ""
        print(f"{symptom}: {good or 'no level'} meets {TARGET} per run{found}")


def best_stored(env, symptom, results):
    """best_quiet of what is stored of an environment."""
    return best_quiet(symptom, *(recorded(env, results, preset)[symptom] for preset in FILES))


def quiet(env, results):
    """Print the best of the quiet charts of each symptom."""
    for symptom in SHOWN:
        share, slack, level = best_stored(env, symptom, results)
        chart = f"slack {slack}, level {level}" if slack else "no chart is quiet"
        print(f"{env}, {symptom}: {share:.0%} of the first drifts found in time ({chart})")


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
    counts, complete = {}, sorted(folder.glob("*/summary.json"))
    if not complete:
        raise UsageError(f"there is no complete run in {folder}; it needs the folder of a study")
    for path in complete:
        config, agent = runs.read_agent(path.parent)
        if config.agent == "random":
            continue  # it hears of nothing
        _, records = runs.read_run(config, path.parent)
        ends = [each["steps"] for each in records]
        raised = np.searchsorted(ends, agent.alarms).tolist()
        evaluations = [each["evaluation"] for each in records if each["evaluation"]]
        with files.undamaged(path.with_name("episodes.csv")):
            rows = counts.setdefault(config.agent, [])
            rows.append(judged(config, evaluations, raised))
    for agent, rows in counts.items():
        costly, false = (sum(row[i] for row in rows) for i in (0, 2))
        delays = [delay for _, each, _ in rows for delay in each]
        median = np.median(delays) if delays else np.nan
        print(
            f"{folder.name}, {agent}: {len(rows)} runs, {len(delays)} of {costly} costly drifts "
            f"found within {WITHIN} episodes, median delay {median}, {false} false alarms"
        )


def judged(config, evaluations, alarms):
    """(how many drifts were costly, delays of those that were found, false alarms) of a run."""
    changes = drifts(config)
    costly = [k for k in costly_drifts(config, evaluations) if k in changes]
    delays, _, _ = stats.match_alarms(alarms, costly, WITHIN)
    _, _, false = stats.match_alarms(alarms, changes, FAR)
    return len(costly), delays, false


def drifts(config):
    """The episodes at which the physics change; a regime may begin without a change."""
    return [b.start for a, b in pairwise(config.regimes) if a.factors != b.factors]


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


def keep(preset, envs, results, jobs):
    """Record twenty runs of each environment under a preset, and write its file."""
    with files.locked(results), workers(jobs) as pool:
        for env in envs:
            arrays = dict(ChainMap(*pool.map(partial(record, env, preset), range(SEEDS))))
            save = partial(np.savez_compressed, **arrays)
            files.write_atomically(results / FILES[preset].format(env), save)


def environments(text):
    """The value of --envs, every one of which exists."""
    envs = text.split(",")
    try:
        for env in envs:
            check_environment(env)
    except UsageError as e:
        raise argparse.ArgumentTypeError(e) from e
    return envs


def main(arguments=None):
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=[*PRESETS, "levels", "quiet", "found"])
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--envs", type=environments, default=",".join(DETECTOR))
    parser.add_argument("--jobs", type=count, default=2)
    parser.add_argument("--results", type=Path, default=RESULTS)
    args = parser.parse_args(arguments)
    if bool(args.folders) != (args.what == "found"):
        parser.error("`found` takes the folders of studies, the others take none")
    if args.what in PRESETS:
        keep(PRESETS[args.what], args.envs, args.results, args.jobs)
        return
    if args.what == "levels":
        print(table(args.results, args.envs))
    for env in args.envs if args.what != "found" else ():
        {"levels": levels, "quiet": quiet}[args.what](env, args.results)
    for folder in args.folders:
        found(folder)


if __name__ == "__main__":
    program(main)

"""Run the study of the protocol, part by part. What is complete is not repeated.

    python benchmarks/keep/study.py tune --tasks acrobot
    python benchmarks/keep/study.py report --tasks acrobot,acrobot-null --seeds 20 --jobs 2
    python benchmarks/keep/study.py report --tasks acrobot --arms dqn,reuse --results runs/again
    python benchmarks/keep/study.py collect

`tune` writes the settings it chooses, and all it tried, to TASK-tuned.json in --results. `report`
trains the arms of its tasks with them. `collect` reads the complete runs in --out into --results:
one row per run in rows.jsonl, and the returns of the decisive arms in TASK.npz. `report` does so
after each arm, and a run whose row is stored is not trained again, on whatever machine. With other
--results everything is run again, with the settings that are stored here.
"""

import io
import json
from functools import partial
from pathlib import Path

import numpy as np
from protocol import FILE, Protocol, code_hash, count, primary, settings_hash

from gbdqn_ref import UsageError, files, runs, stats, study
from gbdqn_ref.__main__ import Parser, cluster, nonempty, program
from gbdqn_ref.files import NUMBER
from gbdqn_ref.stats import EDGE, WINDOW

RESULTS = Path(__file__).parents[2] / "paper_checks" / "results" / "keep"
MAYBE = (int, type(None))
ROW = dict.fromkeys(("task", "arm", "code", "settings"), (str,)) | {
    "seed": (int,),
    "value": NUMBER,
    "regimes": [NUMBER],
    "first": [NUMBER],
    "final": NUMBER,
    "steps": (int,),
    "recovery": [MAYBE],
    "calm": [MAYBE],
    "evaluation": [[NUMBER]],
    "alarms": [(int,)],
}
TUNED = {"chosen": (dict,), "first": [(list,)], "best": [[NUMBER]]}
FINAL = 50  # episodes at a run's end


def settings(protocol, method, seed, count):
    """So many random settings of a method, {name: value or factor on the preset's own value}."""
    tuning = protocol.content["tuning"]
    own = {
        key: value for key, value in tuning["methods"][method].items() if key not in ("on", "arms")
    }
    rng = np.random.default_rng([seed, *method.encode()])
    return [
        {name: float(f ** rng.uniform(-1, 1)) for name, f in (tuning["shared"] | own).items()}
        | {"epsilon_restart": float(rng.choice(tuning["epsilon_restart"]))}
        for _ in range(count)
    ]


def tuned(config, factors):
    """The settings that factors on a config's own values come to; a window is a whole number."""
    values = {"epsilon_restart": factors["epsilon_restart"]}
    for name, factor in factors.items():
        if name != "epsilon_restart":
            own = getattr(config.resolved(), name)
            values[name] = type(own)(own * factor)
    return values


def tune(protocol, task, out, results, pool):
    """Choose the settings of each method on a task; write them with all that was tried."""
    plan, path = protocol.content["tuning"], results / f"{task}-tuned.json"
    tried = files.read_json(path) if path.exists() else {}
    if not plan["methods"]:
        raise UsageError("the protocol has no method to tune")
    for method, content in plan["methods"].items():
        if method in tried:
            continue
        arm, seeds = content["on"], plan["first_seeds"]
        first = settings(protocol, method, seeds[0], plan["settings"])
        means = measure(protocol, task, arm, first, seeds, out / f"{arm}-first", pool)
        order = np.argsort(means)[::-1][: plan["best"]]
        best, seeds = [first[k] for k in order], plan["further_seeds"]
        further = measure(protocol, task, arm, best, seeds, out / f"{arm}-best", pool)
        base = protocol.config(task, arm, seeds[0], "tune")
        tried[method] = {
            "chosen": tuned(base, best[int(np.argmax(further))]),
            "first": [[factors, mean] for factors, mean in zip(first, means, strict=True)],
            "best": [[int(k), mean] for k, mean in zip(order, further, strict=True)],
        }
        files.write_json(path, tried)


def measure(protocol, task, arm, tried, seeds, folder, pool):
    """The mean primary metric of each of the settings; a run that diverges counts as random."""
    base = protocol.config(task, arm, seeds[0], "tune")
    configs = {
        f"{k}-{seed}": protocol.config(task, arm, seed, "tune", **tuned(base, factors))
        for k, factors in enumerate(tried)
        for seed in seeds
    }
    failed = study.run_study(configs, folder, **pool)
    values = [
        diverged(config, failed[name])
        if name in failed
        else primary(runs.read_episodes(folder / name), config)
        for name, config in configs.items()
    ]
    return np.reshape(values, (len(tried), len(seeds))).mean(1).tolist()


def diverged(config, error):
    """What a run that diverged counts as; any other error is raised."""
    if "DivergenceError" not in error:
        raise UsageError(f"{config.agent}, seed {config.seed}: {error}")
    return runs.random_return(config)


def report(protocol, store, task, arms, seeds, out, pool):
    """Train arms of a task on the first so many seeds to report, and store the rows."""
    low, _ = protocol.seeds["report"]
    for arm in arms or protocol.arms_of(task):
        missing = [k for k in range(low, low + seeds) if (task, arm, k) not in store.rows]
        configs = {f"{arm}-{k}": protocol.reported(task, arm, k) for k in missing}
        if configs:
            failed = study.run_study(configs, out / task / arm, **pool)
            for name, error in failed.items():
                config = configs[name]
                store.add(task, arm, config, diverged_row(config, error), None)
        store.collect(out)


class Store:
    """The rows of the study and the returns of its decisive arms, on disk."""

    def __init__(self, protocol, folder):
        self.protocol, self.folder = protocol, Path(folder)
        path = self.folder / "rows.jsonl"
        with files.undamaged(path):
            lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
            rows = [files.parse_json(line) for line in lines]
            for row in rows:
                files.check_shape(row, ROW, "a row")
            self.rows = {(row["task"], row["arm"], row["seed"]): row for row in rows}
        protocol.check_rows(rows)
        self.returns = {}  # {task: {"ARM-SEED": returns}}
        for task in protocol.tasks:
            if (path := self.folder / f"{task}.npz").exists():
                self.returns[task] = read_arrays(path)
                with files.undamaged(path):
                    self.check_returns(task)

    def check_returns(self, task):
        """ValueError unless a task's returns are of runs that have rows, one per episode."""
        for name, returns in self.returns[task].items():
            arm, _, seed = name.rpartition("-")
            if (task, arm, int(seed)) not in self.rows:
                raise ValueError(f"there is no row of its run {name}")
            episodes = self.protocol.reported(task, arm, int(seed)).episodes
            if returns.shape != (episodes,) or not np.isfinite(returns).all():
                raise ValueError(f"{name} is not the return of {episodes} episodes")

    def collect(self, out):
        """Add the runs in a folder that are complete, write everything, and drop the checkpoints.

        A checkpoint is only needed to know when an agent raised alarms.
        """
        complete = sorted(Path(out).glob("*/*/*/summary.json"))
        for path in complete:
            task, arm = path.parts[-4:-2]
            config = runs.read_config(path.parent)
            if not self.has(task, arm, config.seed):
                wanted = self.protocol.reported(task, arm, config.seed)
                if settings_hash(config) != settings_hash(wanted):
                    raise UsageError(f"the run in {path.parent} was made with other settings")
                _, records = runs.read_run(config, path.parent)
                returns = np.array([record["return"] for record in records])
                _, agent = runs.read_agent(path.parent)
                self.add(task, arm, config, row(config, records, returns, agent), returns)
        self.write()
        for path in complete:
            (path.parent / "checkpoint.npz").unlink(missing_ok=True)

    def has(self, task, arm, seed):
        """Whether the row of a run is stored, and its returns, if its arm is a decisive one."""
        decisive = arm in self.protocol.content["decisive"]
        stored = not decisive or f"{arm}-{seed}" in self.returns.get(task, {})
        return (task, arm, seed) in self.rows and stored

    def add(self, task, arm, config, measured, returns):
        """Add one run."""
        named = {"task": task, "arm": arm, "seed": config.seed}
        made = {"code": code_hash(config), "settings": settings_hash(config)}
        self.rows[task, arm, config.seed] = named | made | measured
        if returns is not None and arm in self.protocol.content["decisive"]:
            self.returns.setdefault(task, {})[f"{arm}-{config.seed}"] = returns.astype(np.float32)

    def write(self):
        """Write the rows in the protocol's order, and the returns; UsageError for a row that the
        protocol does not have.
        """
        self.protocol.check_rows(self.rows.values())
        tasks, arms = list(self.protocol.tasks), list(self.protocol.arms)
        order = sorted(self.rows, key=lambda run: (tasks.index(run[0]), arms.index(run[1]), run[2]))
        lines = [json.dumps(self.rows[run], separators=(",", ":")) for run in order]
        text = "".join(f"{line}\n" for line in lines)
        self.folder.mkdir(parents=True, exist_ok=True)
        files.write_atomically(self.folder / "rows.jsonl", lambda file: file.write(text.encode()))
        for task, returns in self.returns.items():
            save = partial(np.savez_compressed, **dict(sorted(returns.items())))
            files.write_atomically(self.folder / f"{task}.npz", save)


def read_arrays(path):
    """{name: array} of an npz file; UsageError names one that is damaged."""
    content = io.BytesIO(path.read_bytes())  # of a path NumPy leaves a damaged file open
    with files.undamaged(path), np.load(content, allow_pickle=False) as arrays:
        return dict(arrays)


def row(config, records, returns, agent):
    """What is kept of one complete run, apart from its name."""
    regimes = config.regimes[1:]
    ends = [record["steps"] for record in records]
    return {
        "value": round(primary(records, config), 4),
        "regimes": [round(float(returns[r.start : r.end].mean()), 4) for r in config.regimes],
        "first": [round(float(returns[r.start : r.start + EDGE].mean()), 4) for r in regimes],
        "final": round(stats.final_return(returns, FINAL), 4),
        "steps": ends[-1],
        "recovery": recoveries(returns, regimes),
        "calm": recoveries(-np.array([record["td_error"] for record in records]), regimes),
        "evaluation": [record["evaluation"] for record in records if record["evaluation"]],
        "alarms": np.searchsorted(ends, agent.alarms).tolist(),
    }


def recoveries(x, regimes):
    """For each regime the episodes until x is back, or None; an x that does not fall needs 0.

    x is back when its mean over ten episodes has made up nine tenths of its largest fall below the
    last mean before the regime. Episodes without a value are interpolated.
    """
    known = np.isfinite(x)
    if not known.any():
        return [None] * len(regimes)
    x = np.interp(np.arange(len(x)), np.flatnonzero(known), x[known])
    episodes = []
    for regime in regimes:
        before = x[max(0, regime.start - WINDOW) : regime.start].mean()
        fall = before - stats.trailing_mean(x[regime.start : regime.end], WINDOW)
        worst = int(fall.argmax()) if len(fall) else 0
        back = np.flatnonzero(fall[worst:] <= 0.1 * fall.max(initial=0.0))
        fell = fall.max(initial=0.0) > 0
        episodes.append((int(back[0]) + worst + WINDOW if len(back) else None) if fell else 0)
    return episodes


def diverged_row(config, error):
    """The row of a run that diverged: it counts as the random policy and is never run again."""
    value = round(diverged(config, error), 4)
    count = len(config.regimes)
    return {
        "value": value,
        "regimes": [value] * count,
        "first": [value] * (count - 1),
        "final": value,
        "steps": 0,
        "recovery": [None] * (count - 1),
        "calm": [None] * (count - 1),
        "evaluation": [],
        "alarms": [],
        "diverged": error,
    }


def chosen(results):
    """{task: {method: settings}} of every task that is tuned."""
    paths = sorted(Path(results).glob("*-tuned.json"))
    contents = {path: files.read_json(path) for path in paths}
    for path, content in contents.items():
        with files.undamaged(path):
            files.check_shape(content, dict.fromkeys(content, TUNED), "it")
    return {
        path.name.removesuffix("-tuned.json"): {
            method: each["chosen"] for method, each in content.items()
        }
        for path, content in contents.items()
    }


def options(arguments):
    """The command line, read."""
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["tune", "report", "collect"])
    parser.add_argument("--tasks", type=nonempty, help="default: acrobot,mountaincar,cartpole")
    parser.add_argument("--arms", type=lambda text: text.split(","), help="default: all")
    parser.add_argument("--seeds", type=count, help="default: 20")
    parser.add_argument("--jobs", type=count, default=2)
    parser.add_argument("--dask", type=nonempty, metavar="ADDRESS")
    parser.add_argument("--protocol", type=Path, default=FILE)
    parser.add_argument("--out", type=Path, default=Path("runs/keep"))
    parser.add_argument("--results", type=Path, default=RESULTS)
    args = parser.parse_args(arguments)
    if args.what != "report" and (args.arms or args.seeds):
        parser.error("--arms and --seeds are options of `report`")
    if args.what == "collect" and args.tasks:
        parser.error("`collect` takes all tasks")
    args.tasks = (args.tasks or "acrobot,mountaincar,cartpole").split(",")
    args.seeds = args.seeds or 20
    return args


def main(arguments=None):
    args = options(arguments)
    with files.locked(args.results), cluster(args.dask) as executor:
        protocol = Protocol(args.protocol, chosen(RESULTS) | chosen(args.results))
        store = Store(protocol, args.results)
        if args.what == "collect":
            if not (args.out / "reported").is_dir():
                raise UsageError(f"{args.out} has no folder 'reported', as `report` makes one")
            store.collect(args.out / "reported")
            return
        pool = {"jobs": args.jobs, "executor": executor}
        for task in args.tasks:
            for arm in args.arms or protocol.arms_of(task):
                protocol.check(task, arm)
        for task in args.tasks:
            if args.what == "tune":
                tune(protocol, task, args.out / "tuning" / task, args.results, pool)
            else:
                out = args.out / "reported"
                report(protocol, store, task, args.arms, args.seeds, out, pool)


if __name__ == "__main__":
    program(main)

"""Run the study of the protocol, part by part. What is complete is not repeated.

    python benchmarks/keep/study.py report --tasks acrobot,mountaincar --seeds 20 --jobs 2
    python benchmarks/keep/study.py tune --tasks acrobot
    python benchmarks/keep/study.py rows --out results/keep

`report` and `tune` leave a study per task in the folder; `rows` reads those that are complete and
writes one row per run: task, arm, seed, code, the primary metric and the secondary ones.
"""

import argparse
import hashlib
import json
from pathlib import Path

import numpy as np
from protocol import Protocol, primary

from gbdqn_ref import files, provenance, runs, study

EDGE = 20  # episodes at a regime's start


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


def row(protocol, folder, task, arm):
    """What is kept of one complete run."""
    config, records = runs.read_config(folder), runs.read_episodes(folder)
    returns = np.array([record["return"] for record in records])
    _, agent = runs.read_agent(folder)
    ends = np.array([record["steps"] for record in records])
    return {
        "task": task,
        "arm": arm,
        "seed": config.seed,
        "code": code(config),
        "value": primary(records, config),
        "first": [float(returns[r.start : r.start + EDGE].mean()) for r in config.regimes[1:]],
        "final": float(returns[-50:].mean()),
        "alarms": np.searchsorted(ends, getattr(agent, "alarms", [])).tolist(),
    }


def code(config):
    """A hash of the code that decides a run."""
    text = json.dumps(provenance.code(config) | {"schedule": ""}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def report(protocol, tasks, seeds, out, jobs):
    """Train every arm of some tasks on the first so many seeds to report."""
    first, _ = protocol.seeds["report"]
    for task in tasks:
        configs = protocol.runs(task, "report", range(first, first + seeds))
        for name, error in study.run_study(configs, out / task, jobs=jobs).items():
            print(f"{task}, {name}: {error}")


def tune(protocol, tasks, out, jobs):
    """The best settings of each method on each task, written to tuned.json."""
    plan = protocol.content["tuning"]
    for task in tasks:
        chosen = {}
        for method, content in plan["methods"].items():
            arm = content["on"]
            tried = settings(protocol, method, plan["first_seeds"][0], plan["settings"])
            means = measure(protocol, task, arm, tried, plan["first_seeds"], out, jobs)
            best = [tried[k] for k in np.argsort(means)[::-1][: plan["best"]]]
            means = measure(protocol, task, arm, best, plan["further_seeds"], out, jobs)
            chosen[method] = best[int(np.argmax(means))]
        files.write_json(out / f"{task}-tuned.json", chosen)


def measure(protocol, task, arm, tried, seeds, out, jobs):
    """The mean primary metric of each of the settings; a run that fails counts as −∞."""
    base = protocol.config(task, arm, seeds[0], "tune")
    configs = {
        f"{arm}-{k}-{seed}": protocol.config(task, arm, seed, "tune", **tuned(base, factors))
        for k, factors in enumerate(tried)
        for seed in seeds
    }
    folder = out / f"{task}-tuning" / f"{arm}-{len(tried)}"
    failed = study.run_study(configs, folder, jobs=jobs)
    values = [
        -np.inf if name in failed else primary(runs.read_episodes(folder / name), config)
        for name, config in configs.items()
    ]
    return np.reshape(values, (len(tried), len(seeds))).mean(1)


def rows(protocol, out):
    """Every complete run of the reported tasks, checked against the protocol."""
    found = [
        row(protocol, path.parent, path.parent.parent.name, path.parent.name.rpartition("-")[0])
        for task in protocol.tasks
        for path in sorted((out / task).glob("*/summary.json"))
    ]
    protocol.check_rows(found)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["report", "tune", "rows"])
    parser.add_argument("--tasks", default="acrobot,mountaincar,cartpole")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("results/keep"))
    args = parser.parse_args()
    protocol = Protocol()
    if args.what == "report":
        report(protocol, args.tasks.split(","), args.seeds, args.out, args.jobs)
    elif args.what == "tune":
        tune(protocol, args.tasks.split(","), args.out, args.jobs)
    else:
        files.write_json(args.out / "rows.json", rows(protocol, args.out))


if __name__ == "__main__":
    main()

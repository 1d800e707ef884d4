"""The tables for which several processes run at a time: import order, jobs, a cluster."""

import os
import subprocess
import sys
from contextlib import nullcontext
from functools import partial
from importlib.util import find_spec
from math import ceil, nan
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from measure import Section, compare, measure

RUNS = 8
JOBS = f"a study of {RUNS} runs"
LIMITED = "OPENBLAS_NUM_THREADS=1"
TRAINING = """
from time import perf_counter
from gbdqn_ref.train import Config, run
records = run(Config(agent="dqn", learning_starts=64, episodes=10_000_000))
for goal in (100, {steps}):
    start, steps = perf_counter(), 0
    while steps < goal:
        steps += next(records)["length"]
print((perf_counter() - start) / steps * 1e6)
"""


def import_order(scale):
    """Training with both cores busy, NumPy imported before gbdqn_ref and after."""
    code, one = TRAINING.format(steps=10 * scale.steps), {"OPENBLAS_NUM_THREADS": "1"}
    timers = {
        LIMITED: partial(two_at_once, code, one),
        "gbdqn_ref before numpy": partial(two_at_once, "import gbdqn_ref, numpy" + code, {}),
        "numpy before gbdqn_ref": partial(two_at_once, "import numpy, gbdqn_ref" + code, {}),
    }
    times = measure(scale._replace(turns=scale.starts), timers)
    title = "training in two processes at a time, per environment step"
    return Section(title, ("ratio", "µs"), compare(times, LIMITED))


def two_at_once(code, limit):
    """The mean of what two Python processes print, which run the code side by side."""
    env = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    command = [sys.executable, "-c", code]
    processes = [
        subprocess.Popen(command, env=env | limit, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    return sum(float(process.communicate()[0]) for process in processes) / 2


def jobs(scale, seconds):
    """A study of equally long runs, some of them at a time, and what n free cores would take.

    Computed: a study's start and end, and ⌈8/n⌉ runs. `seconds` is study_seconds, or stands for it.
    """
    measured = {n: seconds(scale.episodes, RUNS, n) for n in scale.jobs}
    alone = seconds(scale.episodes, 1, 1)
    one_run = (measured[1] - alone) / (RUNS - 1)

    def computed(n):
        return alone + (ceil(RUNS / n) - 1) * one_run

    rows = {f"{n} at a time": (measured[n], computed(n)) for n in scale.jobs}
    if find_spec("distributed"):
        rows["2 workers of a Dask cluster"] = seconds(scale.episodes, RUNS, 2, True), computed(2)
    rows |= {f"{n} workers, a core each": (nan, computed(n)) for n in (4, 8)}
    return Section(JOBS, ("s", "computed s"), rows)


def study_seconds(episodes, runs, jobs, dask=False):
    """Wall clock of a study of DQN on MountainCar, whose early episodes are all equally long."""
    with TemporaryDirectory() as folder, cluster(jobs) if dask else nullcontext() as workers:
        command = [sys.executable, "-m", "gbdqn_ref", "study", "--quiet", "--env", "mountaincar"]
        command += ["--agents", "dqn", "--seeds", str(runs), "--jobs", str(jobs)]
        command += ["--set", f"episodes={episodes}", "--set", "schedule=[]"]
        command += ["--out", str(Path(folder) / "study")]
        command += ["--dask", workers.scheduler_address] if dask else []
        start = perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return perf_counter() - start


def cluster(workers):
    """A Dask cluster on this machine."""
    from distributed import LocalCluster

    return LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)

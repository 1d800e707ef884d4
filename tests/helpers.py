"""Shared by the tests: small runs and agents, their state, folders, the command line."""

import copy
import itertools
import json
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import Executor, Future
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import gbdqn_ref
from gbdqn_ref import checkpoint, runs, study, train
from gbdqn_ref.__main__ import main
from gbdqn_ref.train import Config, make_agent

D, A = 4, 2  # CartPole's
SMALL = dict(episodes=12, learning_starts=20, hidden=[8], capacity=90, window=30, batch_size=8)
BROWSERS = map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))
CHROMIUM = next(filter(None, BROWSERS), None)
PATIENCE = 120  # seconds to wait for a process; a loaded machine is slow, not broken


class Crash(BaseException):
    """A crash; it is no Exception, so no handler of errors can catch it."""


def crashing_after(episode):
    """train.run(), but it crashes after this episode."""

    def run(*arguments):
        for record in train.run(*arguments):
            yield record
            if record["episode"] == episode:
                raise Crash

    return run


def own_signals(monkeypatch):
    """Let a program that is run in this process leave its signals and Matplotlib alone."""
    for name in ("_own_process", "_handle_signals"):
        monkeypatch.setattr(gbdqn_ref.__main__, name, lambda *_: None)


# --- agents ---------------------------------------------------------------------------------------


def drifts_at(first, second, third):
    """A schedule for CartPole: a longer pole, then more gravity too, then the stock physics."""
    return [
        {"episode": first, "length": 2},
        {"episode": second, "gravity": 2, "length": 2},
        {"episode": third, "reset": True},
    ]


def agent_of(agent="gbdqn", **values):
    """A small untrained agent."""
    return make_agent(Config(agent=agent, **SMALL | values))


def feed(agent, n, seed=0, learn=1):
    """Show the agent n random transitions, each followed by `learn` updates; the TD errors."""
    rng, deltas = np.random.default_rng(seed), []
    for _ in range(n):
        s, s2 = rng.normal(size=(2, D)).astype(np.float32)
        agent.observe(s, int(rng.integers(A)), float(rng.normal()), s2, bool(rng.random() < 0.2))
        deltas += [agent.learn() for _ in range(learn)]
    return np.array(deltas)


def states(n=30):
    return np.random.default_rng(99).normal(size=(n, D)).astype(np.float32)


def state_bytes(agent):
    """{name: the bytes of the array}; a stack of one network equals that network."""
    return {name: array.tobytes() for name, array in checkpoint.state(agent).items()}


def replay_bytes(agent):
    """state_bytes, of the replay buffer only."""
    return {name: held for name, held in state_bytes(agent).items() if name.startswith("replay.")}


def exact_state(agent):
    """{name: (dtype, shape, bytes)}: what a checkpoint must restore."""
    return {
        name: (array.dtype, array.shape, array.tobytes())
        for name, array in checkpoint.state(agent).items()
    }


def caught(monkeypatch, owner, name):
    """Copies of the arguments of every later call of owner.name, which still takes place."""
    calls, original = [], getattr(owner, name)

    def spy(*args):
        calls.append(copy.deepcopy(args))
        return original(*args)

    monkeypatch.setattr(owner, name, spy)
    return calls


def finite_differences(f, x, step):
    """∂f/∂x by central differences."""
    gradient = np.empty_like(x)
    for i in np.ndindex(x.shape):
        up, down = x.copy(), x.copy()
        up[i] += step
        down[i] -= step
        gradient[i] = (f(up) - f(down)) / (2 * step)
    return gradient


# --- folders --------------------------------------------------------------------------------------


def checkpoints_every(episodes, monkeypatch):
    """Make a checkpoint due every so many episodes, with a clock that ticks when it is read."""
    clock = itertools.count()
    monkeypatch.setattr(runs, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    monkeypatch.setattr(runs, "CHECKPOINT_SECONDS", episodes - 1)


def contents(folder):
    """{path: the bytes of the file, or None for a folder} of everything below the folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


# --- processes ------------------------------------------------------------------------------------


class Here(Executor):
    """Runs each call at once and in this process."""

    def submit(self, call, /, *args):
        future = Future()
        try:
            future.set_result(call(*args))
        except Exception as e:
            future.set_exception(e)
        return future


def train_here(monkeypatch):
    """Let commands train their runs in this process, since a worker takes a second to start."""

    def train_all(tasks, jobs, show):
        return study._train_over(Here(), tasks, show)

    monkeypatch.setattr(study, "train_all", train_all)


def wait_for(condition):
    """Return once the condition holds."""
    latest = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < latest, "it takes too long"
        time.sleep(0.01)


# --- the command line -----------------------------------------------------------------------------


def flags(**settings):
    """--set KEY=VALUE for each setting."""
    return [part for key in settings for part in ("--set", f"{key}={json.dumps(settings[key])}")]


def command(*arguments, start=("-m", "gbdqn_ref")):
    return [sys.executable, "-W", "error", *start, *map(str, arguments)]


def environ(**variables):
    return os.environ | {"PYTHONPATH": str(Path(gbdqn_ref.__file__).parents[1]), **variables}


def cli(*arguments, cwd=None, **variables):
    """Run python -m gbdqn_ref … in a new process: (exit status, stdout, stderr)."""
    result = subprocess.run(
        command(*arguments),
        cwd=cwd,
        env=environ(**{"PYTHONIOENCODING": "utf-8"} | variables),
        capture_output=True,
        encoding="utf-8",
        timeout=PATIENCE,
    )
    return result.returncode, result.stdout, result.stderr


def refused(capsys, folder, arguments, keyword):
    """Assert exit status 2, one line with the keyword, and no change to any file."""
    before = contents(folder)
    status, (stdout, stderr) = main(arguments), capsys.readouterr()
    assert status == 2
    assert stderr.startswith("gbdqn_ref: ")
    assert stderr.endswith("\n") and stderr.count("\n") == 1
    assert "Traceback" not in stderr and len(stderr) < 800
    assert any(word in stderr for word in keyword.split("|"))
    assert stdout == ""
    assert contents(folder) == before

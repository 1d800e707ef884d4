"""The vocabulary of the tests: small runs and agents, their state, folders, the command line."""

import copy
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import gbdqn_ref
from gbdqn_ref import checkpoint, runs
from gbdqn_ref.__main__ import main
from gbdqn_ref.train import Config, make_agent

D, A = 4, 2  # CartPole's
SMALL = dict(episodes=12, learning_starts=20, hidden=[8], capacity=90, window=30, batch_size=8)


class Crash(BaseException):
    """Not an Exception, so that nothing can take it for an error and go on."""


# --- agents ---------------------------------------------------------------------------------------


def drifts_at(first, second, third):
    """CartPole's schedule of a longer pole, then more gravity as well, then stock physics again."""
    return [
        {"episode": first, "length": 2},
        {"episode": second, "gravity": 2, "length": 2},
        {"episode": third, "reset": True},
    ]


def agent_of(agent="gbdqn", **values):
    """A small agent that has seen nothing yet."""
    return make_agent(Config(agent=agent, **SMALL | values))


def feed(agent, n, seed=0, learn=1):
    """n random transitions, each followed by so many updates; their TD errors."""
    rng, deltas = np.random.default_rng(seed), []
    for _ in range(n):
        s, s2 = rng.normal(size=(2, D)).astype(np.float32)
        agent.observe(s, int(rng.integers(A)), float(rng.normal()), s2, bool(rng.random() < 0.2))
        deltas += [agent.learn() for _ in range(learn)]
    return np.array(deltas)


def states(n=30):
    return np.random.default_rng(99).normal(size=(n, D)).astype(np.float32)


def state_bytes(agent):
    """{name: the bytes of the array}, equal also where one agent has a stack of one network."""
    return {name: array.tobytes() for name, array in checkpoint.state(agent).items()}


def replay_bytes(agent):
    """The part of it that is the replay buffer."""
    return {
        name: content for name, content in state_bytes(agent).items() if name.startswith("replay.")
    }


def exact_state(agent):
    """{name: (dtype, shape, bytes)}: what a checkpoint has to bring back."""
    return {
        name: (array.dtype, array.shape, array.tobytes())
        for name, array in checkpoint.state(agent).items()
    }


def caught(monkeypatch, owner, name):
    """The arguments of every call of owner.name from now on, copied; the call itself is made as
    well.
    """
    calls, original = [], getattr(owner, name)

    def spy(*args):
        calls.append(copy.deepcopy(args))
        return original(*args)

    monkeypatch.setattr(owner, name, spy)
    return calls


def finite_differences(f, x, step):
    """∂f/∂x, central."""
    gradient = np.empty_like(x)
    for i in np.ndindex(x.shape):
        up, down = x.copy(), x.copy()
        up[i] += step
        down[i] -= step
        gradient[i] = (f(up) - f(down)) / (2 * step)
    return gradient


# --- folders --------------------------------------------------------------------------------------


def checkpoints_every(episodes, monkeypatch):
    """Let a checkpoint be due every so many episodes, by a clock that ticks when it is read."""
    clock = itertools.count()
    monkeypatch.setattr(runs, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    monkeypatch.setattr(runs, "CHECKPOINT_SECONDS", episodes - 1)


def contents(folder):
    """{path: the bytes of the file, or None for a folder} of all that is below."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


# --- the command line -----------------------------------------------------------------------------


def flags(**settings):
    """--set KEY=VALUE of each."""
    return [part for key in settings for part in ("--set", f"{key}={json.dumps(settings[key])}")]


def command(*arguments, start=("-m", "gbdqn_ref")):
    return [sys.executable, "-W", "error", *start, *map(str, arguments)]


def environ(**variables):
    return os.environ | {"PYTHONPATH": str(Path(gbdqn_ref.__file__).parents[1]), **variables}


def cli(*arguments, cwd=None, **variables):
    """python -m gbdqn_ref … in a process of its own: (exit status, stdout, stderr)."""
    result = subprocess.run(
        command(*arguments),
        cwd=cwd,
        env=environ(**{"PYTHONIOENCODING": "utf-8"} | variables),
        capture_output=True,
        encoding="utf-8",
        timeout=60,
    )
    return result.returncode, result.stdout, result.stderr


def refused(capsys, folder, arguments, keyword):
    """The command is answered with exit status 2 and one line with the keyword; no file changes,
    appears or goes.
    """
    before = contents(folder)
    status, (stdout, stderr) = main(arguments), capsys.readouterr()
    assert status == 2
    assert stderr.startswith("gbdqn_ref: ") and stderr.endswith("\n") and stderr.count("\n") == 1, (
        stderr
    )
    assert "Traceback" not in stderr and len(stderr) < 800
    assert any(word in stderr for word in keyword.split("|")), stderr
    assert stdout == ""
    assert contents(folder) == before

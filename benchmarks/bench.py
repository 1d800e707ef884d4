"""What everything costs, in one thread and one run: ratios, and microseconds on this machine.

The timers of a section take turns, and a ratio is the median of the ratios within a turn, so that a
slow moment of the machine hits both of its sides. Microseconds of two runs are not to be compared.
"""

import argparse
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from types import SimpleNamespace
from typing import NamedTuple

import gymnasium
import numpy as np
import peers
import report

from gbdqn_ref import drift
from gbdqn_ref.checkpoint import state
from gbdqn_ref.config import Config
from gbdqn_ref.dqn import DQN, make_replay
from gbdqn_ref.replay import Batch
from gbdqn_ref.train import AGENTS, make_agent, run

UPDATES = ((64, (6, 128, 128, 3)), (128, (11, 256, 256, 7)))
STOCK = {"cartpole": "CartPole-v1", "mountaincar": "MountainCar-v0", "acrobot": "Acrobot-v1"}
REPLAYS = ("uniform", "proportional", "recency")
BASE = "dqn, uniform replay"
FLOOR = "its matrix products alone"
REPLAY = "replay: draw 64 and update their priorities (the sum of both), add one"
BOOSTERS = "GB-DQN on Acrobot with m frozen boosters"


class Section(NamedTuple):
    """One table: a number per column in each row, {label: numbers}."""

    title: str
    columns: tuple
    rows: dict


class Scale(NamedTuple):
    """How long and how far the benchmark measures."""

    turns: int = 25
    seconds: float = 0.02  # of a call in each turn
    steps: int = 500  # of the environment in each turn
    sizes: tuple = (1_000, 10_000, 100_000, 1_000_000)  # of the replay buffer
    boosters: tuple = (0, 1, 2, 4, 8, 16, 32)
    rows: int = 50_000  # transitions in the buffer when a booster is folded in


TINY = Scale(turns=2, seconds=0.0, steps=20, sizes=(1_000,), boosters=(0, 1), rows=100)


def main(arguments=None):
    """Measure all there is, print the tables and draw the picture; exit status 2 where it cannot be
    drawn.
    """
    parser = argparse.ArgumentParser(description="What everything costs, in one thread.")
    parser.add_argument("--out", default="runs/bench.png", help="the picture; default %(default)s")
    parser.add_argument(
        "--tiny", action="store_true", help="a few seconds, only to see that it runs"
    )
    args = parser.parse_args(arguments)
    path, scale, measured = Path(args.out), TINY if args.tiny else Scale(), {}
    if path.is_dir():
        parser.error(f"{path} is a folder; --out is the file that takes the picture")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(str(error))
    if not peers.installed():
        print(
            "no PyTorch or no Stable-Baselines3 here, so without them: pip install -e '.[peers]'"
            " adds both"
        )
    for section in sections(scale):
        measured[section.title] = section.rows
        report.table(*section)
    report.picture(*curves(scale, measured), path)
    print(f"\nthe picture: {path}")


def sections(scale):
    """Every Section, measured when it is asked for."""
    for batch_size, widths in UPDATES:
        yield update(scale, batch_size, widths)
    yield acting(scale)
    yield replay(scale)
    yield environments(scale)
    for env in STOCK:
        yield training(scale, env)
    yield boosters(scale)
    yield fold_in(scale)
    yield memory(scale)


def curves(scale, tables):
    """The lines (x, y) that report.picture draws, by sampler and by part of the work, from {title:
    rows}.
    """
    by_size = {
        kind: [tables[REPLAY][f"{kind}, N = {size:,}"][1] for size in scale.sizes]
        for kind in REPLAYS
    }
    update, _, step, _ = zip(*(tables[BOOSTERS][f"m = {m}"] for m in scale.boosters), strict=True)
    replay = {kind: (scale.sizes, times) for kind, times in by_size.items()}
    return replay, {
        "training per environment step": (scale.boosters, step),
        "update": (scale.boosters, update),
    }


def measure(scale, timers):
    """{name: the µs that the timer gave in each turn (turns,)}, after one turn to warm up."""
    times = {name: np.zeros(1 + scale.turns) for name in timers}
    for turn in range(1 + scale.turns):
        for name, timer in timers.items():
            times[name][turn] = timer()
    return {name: values[1:] for name, values in times.items()}


def repeat(scale, call):
    """A timer of µs per call."""

    def timer():
        start, calls = perf_counter(), 0
        while calls == 0 or perf_counter() - start < scale.seconds:
            for _ in range(10):  # lest the clock be what is measured
                call()
            calls += 10
        return (perf_counter() - start) / calls * 1e6

    return timer


def train_on(scale, records):
    """A timer of µs per environment step, from a generator of records like train.run()'s."""

    def timer():
        start, steps = perf_counter(), 0
        while steps < scale.steps:
            steps += next(records)["length"]
        return (perf_counter() - start) / steps * 1e6

    return timer


def compare(times, base):
    """{name: (ratio to the base, µs)}, medians over the turns."""
    return {
        name: (np.median(values / times[base]), np.median(values)) for name, values in times.items()
    }


def settled(**values):
    """A config under which learning begins at once and ε stays where it is in the end."""
    return Config(**dict(episodes=10_000_000, epsilon_start=0.05, learning_starts=64) | values)


def noise(batch_size, state_dim, n_actions):
    """A Batch of nothing in particular."""
    rng = np.random.default_rng(0)
    s, s2 = rng.normal(size=(2, batch_size, state_dim)).astype(np.float32)
    a, r = rng.integers(n_actions, size=batch_size), rng.normal(size=batch_size).astype(np.float32)
    return Batch(
        np.arange(batch_size),
        s,
        a,
        r,
        s2,
        rng.random(batch_size) < 0.1,
        np.ones(batch_size, np.float32),
    )


def products(batch_size, widths, backward):
    """The matrix products of a forward pass, or of an update (11 for two hidden layers), into
    arrays that exist.
    """
    rng = np.random.default_rng(0)
    h = [rng.normal(size=(batch_size, width)).astype(np.float32) for width in widths]
    W = [rng.normal(size=shape).astype(np.float32) for shape in pairwise(widths)]
    pairs = list(zip(h, W, strict=False))  # h W
    if backward:
        pairs += pairs  # of the network and of the target network
        pairs += [(x.T, dz) for x, dz in pairwise(h)]  # dW = hᵀ dz
        pairs += [(dz, w.T) for dz, w in zip(h[2:], W[1:], strict=True)]  # dh = dz Wᵀ
    calls = [(x, y, np.empty((len(x), y.shape[1]), np.float32)) for x, y in pairs]

    def multiply():
        for x, y, out in calls:
            np.matmul(x, y, out=out)

    return multiply


def update(scale, batch_size, widths):
    """One update of DQN without its sampling."""
    state_dim, *hidden, n_actions = widths
    config, batch = (
        Config(agent="dqn", hidden=hidden, batch_size=batch_size),
        noise(batch_size, state_dim, n_actions),
    )
    agent = DQN(state_dim, n_actions, config, np.random.default_rng(0))
    agent.replay = SimpleNamespace(sample=lambda *_: batch, update_priorities=lambda *_: None)
    calls = {FLOOR: products(batch_size, widths, backward=True), "gbdqn_ref": agent.learn}
    if peers.installed():
        calls["PyTorch, eager"], _ = peers.torch_update(agent, batch)
    times = measure(scale, {name: repeat(scale, call) for name, call in calls.items()})
    title = f"update without sampling: batch {batch_size}, network {'-'.join(map(str, widths))}"
    return Section(title, ("ratio", "µs"), compare(times, FLOOR))


def acting(scale):
    """One action."""
    _, widths = UPDATES[0]
    agent = DQN(widths[0], widths[-1], settled(agent="dqn"), np.random.default_rng(0))
    s = noise(1, widths[0], widths[-1]).s[0]
    calls = {FLOOR: products(1, widths, backward=False)}
    calls |= {
        "greedy": lambda: agent.act(s, greedy=True),
        "ε-greedy, ε = 0.05": lambda: agent.act(s),
    }
    times = measure(scale, {name: repeat(scale, call) for name, call in calls.items()})
    return Section(
        f"acting: network {'-'.join(map(str, widths))}", ("ratio", "µs"), compare(times, FLOOR)
    )


def replay(scale):
    """What is asked of a buffer of N transitions, for N that grow."""
    timers = {}
    for kind in REPLAYS:
        for size in scale.sizes:
            for what, call in replay_calls(kind, size).items():
                timers[kind, size, what] = repeat(scale, call)
    times, rows, base = measure(scale, timers), {}, scale.sizes[:2][-1]
    for kind in REPLAYS:
        both = {
            size: times[kind, size, "sample"] + times[kind, size, "update"] for size in scale.sizes
        }
        for size in scale.sizes:
            parts = [np.median(times[kind, size, what]) for what in ("add", "sample", "update")]
            rows[f"{kind}, N = {size:,}"] = (
                np.median(both[size] / both[base]),
                np.median(both[size]),
                *parts,
            )
    columns = (f"÷ N = {base:,}", "sum µs", "add µs", "draw µs", "update µs")
    return Section(REPLAY, columns, rows)


def replay_calls(kind, size):
    """{"add", "sample", "update": function} on a full buffer, priorities spread."""
    rng, one = np.random.default_rng(0), noise(1, 6, 3)
    buffer = make_replay(Config(replay=kind, capacity=size), 6)
    transition = one.s[0], 0, 0.0, one.s2[0], False
    for _ in range(size):
        buffer.add(*transition)
    buffer.update_priorities(np.arange(size), rng.exponential(size=size))
    slots, delta = rng.integers(size, size=64), rng.exponential(size=64)
    calls = {"add": lambda: buffer.add(*transition), "sample": lambda: buffer.sample(64, rng)}
    return calls | {"update": lambda: buffer.update_priorities(slots, delta)}


def environments(scale):
    """One step of random actions: Gymnasium's environment, and ours with the drift wrapper."""
    rows = {}
    for name, id in STOCK.items():
        calls = {
            "stock": step(gymnasium.make(id, disable_env_checker=True)),
            "ours": step(drift.make(name)),
        }
        times = measure(scale, {which: repeat(scale, call) for which, call in calls.items()})
        rows |= {f"{name}, {which}": numbers for which, numbers in compare(times, "stock").items()}
    return Section(
        "environment step: Gymnasium's, and ours, which can drift", ("ratio", "µs"), rows
    )


def step(env):
    """A function that makes one random step, and begins anew where an episode ends."""
    env.reset(seed=0)
    rng = np.random.default_rng(0)

    def random_step():
        _, _, terminated, truncated, _ = env.step(int(rng.integers(env.action_space.n)))
        if terminated or truncated:
            env.reset()

    return random_step


def training(scale, env):
    """The whole of training, per environment step, with the paper's settings for Acrobot: an update
    every 4 steps.

    DQN and GB-DQN with every replay, the other agents with their own.
    """
    timers = {}
    for agent in AGENTS:
        for kind in REPLAYS if agent in ("dqn", "gbdqn") else (None,):
            config = settled(env=env, agent=agent, replay=kind)
            timers[f"{agent}, {kind} replay" if kind else agent] = train_on(scale, run(config))
    if peers.installed():
        records = peers.sb3(settled(env=env), gymnasium.make(STOCK[env]), scale.steps)
        timers["Stable-Baselines3's DQN, uniform replay"] = train_on(scale, records)
    rows = {
        name: (ratio, time, 1e6 / time)
        for name, (ratio, time) in compare(measure(scale, timers), BASE).items()
    }
    return Section(f"training on {env}, per environment step", ("ratio", "µs", "steps/s"), rows)


def boosters(scale):
    """One update with its sampling, and the whole of training per environment step."""
    steps, updates = {}, {}
    for m in scale.boosters:
        config = settled(env="acrobot", agent="gbdqn")
        agent = make_agent(config)
        steps[m] = train_on(scale, run(config, agent))
        steps[m]()  # something to learn from
        for _ in range(m):
            agent.on_drift("drift")
        updates[m] = repeat(scale, agent.learn)
    steps, updates = (compare(measure(scale, timers), 0) for timers in (steps, updates))
    rows = {f"m = {m}": (*updates[m], *steps[m]) for m in scale.boosters}
    return Section(BOOSTERS, ("update", "µs", "environment step", "µs"), rows)


def fold_in(scale):
    """Freezing a booster: one pass over the whole buffer, which adds its predictions to the cached
    ones.
    """
    timers = {}
    for alpha in (0.1, "closed-form"):
        config = Config(env="acrobot", alpha=alpha, capacity=scale.rows)
        agent, s = make_agent(config), noise(1, 6, 3).s[0]
        for _ in range(scale.rows):
            agent.replay.add(s, 0, 0.0, s, False)
        agent.on_drift("drift")  # the closed form is for the second booster on
        timers[f"α = {alpha}"] = repeat(scale, agent.fold_in)
    rows = {
        name: (time / 1e3,)
        for name, (_, time) in compare(measure(scale, timers), "α = 0.1").items()
    }
    return Section(f"folding in a booster, {scale.rows:,} transitions in the buffer", ("ms",), rows)


def memory(scale):
    """What is kept for Acrobot (6 numbers per state, 3 actions)."""
    rows = {}
    for kind in REPLAYS:
        rows[f"{kind} replay"] = size_of(make_replay(Config(replay=kind, capacity=scale.rows), 6))
    for m in (0, scale.boosters[-1]):
        agent = make_agent(Config(env="acrobot", capacity=scale.rows))
        for _ in range(m):
            agent.on_drift("drift")
        rows[f"gbdqn, all of it, m = {m}"] = size_of(agent)
    rows = {name: (total / scale.rows, total / 1e6) for name, total in rows.items()}
    return Section(f"memory, {scale.rows:,} transitions", ("bytes each", "MB"), rows)


def size_of(thing):
    """Bytes of all arrays in an object of ours."""
    return sum(array.nbytes for array in state(thing).values())


if __name__ == "__main__":
    main()

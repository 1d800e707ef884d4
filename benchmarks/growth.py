"""How cost grows: with the replay buffer and with boosters; and what memory is kept."""

import numpy as np
from measure import REPLAYS, Section, compare, measure, noise, repeat, settled, train_on

from gbdqn_ref.checkpoint import state
from gbdqn_ref.config import Config
from gbdqn_ref.dqn import make_replay
from gbdqn_ref.train import make_agent, run

REPLAY = "replay: draw 64 and update their priorities (the sum of both), add one"
BOOSTERS = "GB-DQN on Acrobot with m frozen boosters"


def replay(scale):
    """What is asked of a buffer of N transitions, for N that grow."""
    timers = {}
    for kind in REPLAYS:
        for size in scale.sizes:
            for what, call in replay_calls(kind, size).items():
                timers[kind, size, what] = repeat(scale, call)
    times, rows, base = measure(scale, timers), {}, scale.sizes[0]
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

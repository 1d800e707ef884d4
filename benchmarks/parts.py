"""Where an environment step's time goes, and the least that each part could take."""

from functools import partial
from itertools import cycle, pairwise
from time import process_time

import gymnasium
import numpy as np
from measure import STOCK, Section, compare, measure, noise, repeat, settled, train_on

from gbdqn_ref import drift
from gbdqn_ref.train import make_agent, run

PARTS = ("environment", "acting", "storing", "sampling", "update", "the rest")


def parts(scale, agent, kind):
    """Where an environment step's time goes, and the least that each part could take."""
    config = settled(agent=agent, replay=kind)
    agent = make_agent(config)
    times = measure(scale, part_timers(scale, config, agent) | floor_timers(scale, agent))
    times["all", "floor"] = sum(times[part, "floor"] for part in PARTS[:-1])
    rows = {}
    for part in ("all", *PARTS):
        share = np.median(times[part] / times["all"])
        rows[part] = (share, np.median(times[part]), np.nan, np.nan)
        if (part, "floor") in times:
            floor = times[part, "floor"]
            rows[part] = (*rows[part][:2], np.median(floor), np.median(times[part] / floor))
    title = f"where a step of {config.agent} on CartPole goes, {kind} replay"
    return Section(title, ("share", "µs", "floor µs", "÷ floor"), rows)


def part_timers(scale, config, agent):
    """Timers of µs per environment step: of all, which trains, and of each part of that."""
    (spent, switch), train = stopwatch(agent), train_on(scale, run(config, agent))

    def everything():
        switch("the rest")
        spent.update(dict.fromkeys(PARTS, 0.0))
        before, µs = agent.steps, train()
        switch("the rest")
        for part in PARTS:
            spent[part] *= 1e6 / (agent.steps - before)
        return µs

    return {"all": everything} | {part: partial(spent.get, part) for part in PARTS}


def stopwatch(agent, clock=process_time):
    """({part: seconds}, switch) while an agent trains: at any time one part is on, until a switch.

    Acting is followed by the environment, and that by storing.
    """
    spent, on, since = dict.fromkeys(PARTS, 0.0), "the rest", clock()

    def switch(part):
        nonlocal on, since
        now = clock()
        spent[on] += now - since
        on, since = part, now

    def watch(owner, name, part, then):
        call = getattr(owner, name)

        def watched(*args):
            switch(part)
            result = call(*args)
            switch(then)
            return result

        setattr(owner, name, watched)

    watch(agent, "act", "acting", "environment")
    watch(agent, "observe", "storing", "the rest")
    watch(agent, "learn", "update", "the rest")
    for name in ("sample", "update_priorities"):
        watch(agent.replay, name, "sampling", "update")
    return spent, switch


def floor_timers(scale, agent):
    """Timers of µs per environment step: the environment, the products and the memory alone."""
    c, widths = agent.config, agent.net.widths
    transition = noise(1, widths[0], widths[-1])[1:-1]
    row = np.concatenate([np.atleast_1d(x[0]).view(np.uint8) for x in transition])
    ring = np.zeros((c.capacity, len(row)), np.uint8)
    index = np.random.default_rng(0).integers(c.capacity, size=c.batch_size)
    multiply, move = products(c.batch_size, widths, backward=True), traffic(agent.net.size)
    calls = {
        "environment": (step(gymnasium.make(STOCK[c.env]).unwrapped), 1),
        "acting": (products(1, widths, backward=False), 1),
        "storing": (lambda: np.copyto(ring[7], row), 1),
        "sampling": (lambda: ring.take(index, 0), c.update_every),
        "update": (lambda: (multiply(), move()), c.update_every),
    }
    return {
        (part, "floor"): every(steps, repeat(scale, call)) for part, (call, steps) in calls.items()
    }


def every(steps, timer):
    """A timer's µs shared out over so many steps."""
    return lambda: timer() / steps


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


def traffic(size):
    """What an update has to read and to write: θ, θ̄, two moments and the gradient, moved once."""
    source, target = np.ones((2, 5, size), np.float32)
    return lambda: np.copyto(target, source)


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
    actions = cycle(np.random.default_rng(0).integers(env.action_space.n, size=1000).tolist())

    def random_step():
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    return random_step

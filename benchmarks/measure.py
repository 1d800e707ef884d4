"""How time is taken: the timers of a section take turns, so that a slow moment hits all of them.

Time is the processor's, of all threads of this process, so that other processes count for little.
A ratio is the median of the ratios within a turn. Microseconds of two runs are not to be compared.
"""

from time import process_time
from typing import NamedTuple

import numpy as np

from gbdqn_ref.config import Config
from gbdqn_ref.replay import Batch

STOCK = {"cartpole": "CartPole-v1", "mountaincar": "MountainCar-v0", "acrobot": "Acrobot-v1"}
REPLAYS = ("uniform", "proportional", "recency")


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
    sizes: tuple = (10_000, 100_000, 1_000_000)  # of the replay buffer
    boosters: tuple = (0, 1, 2, 4, 8, 16, 32)
    rows: int = 50_000  # transitions in the buffer when a booster is folded in
    jobs: tuple = (1, 2, 4, 8)
    episodes: int = 100  # of each run of a study
    starts: int = 5  # of processes, two at a time


TINY = Scale(
    turns=2,
    seconds=0.0,
    steps=20,
    sizes=(1_000,),
    boosters=(0, 1),
    rows=100,
    jobs=(1,),
    episodes=1,
    starts=1,
)


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
        start, calls = process_time(), 0
        while calls == 0 or process_time() - start < scale.seconds:
            for _ in range(10):  # lest the clock be what is measured
                call()
            calls += 10
        return (process_time() - start) / calls * 1e6

    return timer


def train_on(scale, records):
    """A timer of µs per environment step, from a generator of records like train.run()'s."""

    def timer():
        start, steps = process_time(), 0
        while steps < scale.steps:
            steps += next(records)["length"]
        return (process_time() - start) / steps * 1e6

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
    terminated, weight = rng.random(batch_size) < 0.1, rng.random(batch_size).astype(np.float32)
    return Batch(np.arange(batch_size), s, a, r, s2, terminated, weight)

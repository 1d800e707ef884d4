"""Local forgetting: stale data are dropped without a drift signal. Exploratory.

    python benchmarks/keep/forgetting.py run --seeds 10 --jobs 2
    python benchmarks/keep/forgetting.py table

Of each neighbourhood of states, and of each action in it, only the newest transitions are drawn:
where the agent goes, old physics are forgotten (the nearest form that fits here of Rahimi-
Kalahroudi et al. 2023, who learn what is near; here it is a cell of a grid). The agent is DQN with
uniform draws; nothing tells it of a drift.

Written before the run: this gains over DQN that keeps all of its data, drawn uniformly. It gains
less than DQN that is told of the drifts and drops its data, since what is no longer visited stays,
and no size of the neighbourhoods does well on both tasks.
"""

from collections import deque
from itertools import product
from pathlib import Path

import numpy as np
from protocol import count, primary
from workers import workers

from gbdqn_ref import UsageError, drift, files, stats, train
from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.config import Config
from gbdqn_ref.files import NUMBER
from gbdqn_ref.replay import UniformReplay

RESULTS = Path(__file__).parents[2] / "paper_checks" / "results" / "keep" / "forgetting"
FIRST = 20  # the first seed
BINS = {"acrobot": 4, "mountaincar": 16}  # cells along each coordinate of the state
ARMS = {  # settings of DQN, and the transitions that are drawn of each cell and action
    "dqn": ({}, None),
    "uniform": (dict(replay="uniform"), None),
    "local-5": (dict(replay="uniform"), 5),
    "local-20": (dict(replay="uniform"), 20),
    "local-80": (dict(replay="uniform"), 80),
    "told": (dict(replay="uniform", keep_data=0.0), None),
}


class LocalReplay(UniformReplay):
    """Draws uniformly among the newest `local` transitions of each cell and action."""

    def __init__(self, capacity, space, bins, local):
        super().__init__(capacity, len(space.low))
        self.space, self.bins, self.local = space, bins, local
        self.drawn = np.zeros(self.capacity, bool)
        self.cells = {}  # (cell, action): its drawn slots, the oldest first

    def cell(self, slot):
        place = (self.s[slot] - self.space.low) / (self.space.high - self.space.low)
        return *np.floor(self.bins * place).astype(int).tolist(), int(self.a[slot])

    def add(self, s, a, r, s2, terminated):
        slot = self.added % self.capacity
        if self.drawn[slot]:  # the ring is full, and its oldest is the oldest of its cell
            self.cells[self.cell(slot)].popleft()
        super().add(s, a, r, s2, terminated)
        slots = self.cells.setdefault(self.cell(slot), deque())
        slots.append(slot)
        self.drawn[slot] = True
        if len(slots) > self.local:
            self.drawn[slots.popleft()] = False
        return slot

    def sample(self, batch_size, rng):
        index = rng.choice(np.flatnonzero(self.drawn), batch_size)
        return self._batch(index, np.ones(batch_size, np.float32))


def measure(env, arm, seed, **values):
    """The mean return after the first event, and how many transitions are drawn in the end."""
    settings, local = ARMS[arm]
    config = Config.preset(env, "recurring", agent="dqn", seed=seed, **settings | values)
    agent = train.make_agent(config)
    if local is not None:
        space = drift.make(env).observation_space
        agent.replay = LocalReplay(agent.replay.capacity, space, BINS[env], local)
    value = primary(list(train.run(config, agent)), config)
    drawn = agent.replay.drawn.sum() if local is not None else len(agent.replay)
    return {"value": round(value, 3), "drawn": int(drawn)}


def run_one(job):
    """Run an environment's arm with a seed, and write what is measured."""
    out, env, arm, seed = job
    path = out / f"{env}-{arm}-{seed}.json"
    if not path.exists():
        files.write_json(path, measure(env, arm, seed))


def table(out):
    """The lines of a Markdown table, on each task: the IQM of an arm's return, what it gains over
    uniform draws and what an agent that is told gains over it, paired and with 95 % intervals, and
    how many transitions are drawn in the end.
    """
    lines = []
    for arm in ARMS:
        cells = []
        for env in BINS:
            runs = {each: stored(out, env, each) for each in (arm, "uniform", "told")}
            seeds = sorted(set.intersection(*map(set, runs.values())))
            if not seeds:
                missing = next((each for each in runs if not runs[each]), arm)
                raise UsageError(f"there is no run of {env}-{missing} in {out}; `run` writes some")
            values = {each: [runs[each][k]["value"] for k in seeds] for each in runs}
            drawn = np.mean([runs[arm][k]["drawn"] for k in seeds])
            cells += [f"{stats.iqm(values[arm]):.1f}"]
            cells += [lead(values, arm, "uniform"), lead(values, "told", arm), f"{drawn:,.0f}"]
        lines.append(f"| {arm} | {' | '.join(cells)} |")
    return lines


def lead(values, arm, other):
    """Arm minus other in words; nothing of an arm minus itself."""
    if arm == other:
        return ""
    apart, low, high = stats.paired_difference(values[arm], values[other], np.random.default_rng(0))
    return f"{apart:+.1f} [{low:+.1f}, {high:+.1f}]"


def stored(out, env, arm):
    """{seed: measures} of the runs that are stored."""
    shape, seeds = dict(value=NUMBER, drawn=(int,)), {}
    for path in out.glob(f"{env}-{arm}-*.json"):
        seed = path.stem.removeprefix(f"{env}-{arm}-")
        if seed.isdecimal():  # not of another arm, nor a copy
            seeds[int(seed)] = files.read_json(path, **shape)
    return seeds


def main(arguments=None):
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["run", "table"])
    parser.add_argument("--seeds", type=count, default=10)
    parser.add_argument("--jobs", type=count, default=2)
    parser.add_argument("--out", type=Path, default=RESULTS)
    args = parser.parse_args(arguments)
    if args.what == "run":
        jobs = product([args.out], BINS, ARMS, range(FIRST, FIRST + args.seeds))
        with files.locked(args.out), workers(args.jobs) as pool:
            list(pool.map(run_one, jobs))
    print("\n".join(table(args.out)))


if __name__ == "__main__":
    program(main)

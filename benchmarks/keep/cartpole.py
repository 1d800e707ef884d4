"""Why does a new booster lose CartPole? One agent per seed, forked at an event into many arms.

    python benchmarks/keep/cartpole.py run --seeds 20 --jobs 2
    python benchmarks/keep/cartpole.py table

An agent learns for 300 episodes. Then either nothing changes, and the data are kept, or gravity is
three times as large, and the data are dropped. Each arm goes on for 100 episodes from a copy and
changes one thing.

Two causes are suspected. Written before the run: (1) the learning rate, which suits a trained
network and not a new one. If so, a booster at 25 times the rate ends level with DQN, a new network
alone at the old rate ends as low as the booster, and a higher rate does not help DQN. (2)
Overestimation. If so, clipped or double targets close at least half of the booster's gap at the old
rate. Neither explains a loss in the first 20 episodes that remains at the higher rate; the gate,
which lets returns decide between the old Q and the new, asks whether that loss can be avoided.
"""

import copy
from functools import partial
from itertools import islice
from pathlib import Path
from unittest import mock

import numpy as np
from protocol import count
from workers import workers

from gbdqn_ref import UsageError, bellman, files, stats, train
from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.config import Config

RESULTS = Path(__file__).parents[2] / "paper_checks" / "results" / "keep" / "cartpole"
FIRST, EPISODE, AFTER, EARLY, LATE = 20, 300, 100, 20, 50  # the first seed, then episodes
SHOWN = dict.fromkeys(("first", "last", "late dormant"), files.NUMBER)
LARGEST = 100.0  # 1 / (1 − γ): no return is above it
EVENTS = {
    "null": dict(gravity=1.0, keep_data=1.0),
    "gravity": dict(gravity=3.0, keep_data=0.0),
}
GO_ON = dict(warm_start=True, zero_output=False, keep_adam=True)  # with α = 1 that is DQN
TRAINED = dict(warm_start=True, zero_output=True, keep_adam=False)
ARMS = {  # name: settings, the target or the control, and whether the null has it too
    "DQN": (GO_ON, "", True),
    "DQN, lr × 5": (GO_ON | dict(lr_factor=5.0), "", False),
    "DQN, lr × 25": (GO_ON | dict(lr_factor=25.0), "", True),
    "DQN, clipped": (GO_ON, "clipped", False),
    "DQN, double": (GO_ON, "double", False),
    "booster": ({}, "", True),
    "booster, lr × 5": (dict(lr_factor=5.0), "", True),
    "booster, lr × 25": (dict(lr_factor=25.0), "", True),
    "booster, lr × 50": (dict(lr_factor=50.0), "", False),
    "booster, clipped": ({}, "clipped", False),
    "booster, lr × 25, clipped": (dict(lr_factor=25.0), "clipped", True),
    "booster, lr × 25, double": (dict(lr_factor=25.0), "double", False),
    "booster, lr × 25, gate": (dict(lr_factor=25.0), "gate", True),
    "trained layers, zero output": (TRAINED, "", False),
    "new network alone": ({}, "alone", False),
    "new network alone, lr × 25": (dict(lr_factor=25.0), "alone", False),
}


def config_of(event, seed, **values):
    """GB-DQN with α = 1 and plain PER; until the event it is DQN."""
    schedule = [{"episode": EPISODE, "gravity": EVENTS[event]["gravity"]}]
    fixed = dict(alpha=1.0, replay="proportional", drift_signal=[], episodes=EPISODE + AFTER)
    fixed |= dict(schedule=schedule, keep_data=EVENTS[event]["keep_data"])
    return Config.preset("cartpole", agent="gbdqn", seed=seed, **fixed | values)


def run_seed(out, seed):
    """Train one agent, and every arm from a copy of it; write {"EVENT: ARM": measures}."""
    config = config_of("null", seed)
    base = train.make_agent(config)
    returns = [record["return"] for record in islice(train.run(config, base), EPISODE)]
    result = {"before": measures(base) | {"return": float(np.mean(returns[-LATE:]))}}
    for event, arm in forks():
        values, way, _ = ARMS[arm]
        config = config_of(event, seed, **values)
        result[f"{event}: {arm}"] = run_arm(copy.deepcopy(base), config, way)
    rounded = {arm: {key: round(x, 3) for key, x in each.items()} for arm, each in result.items()}
    files.write_json(out / f"{seed}.json", rounded)


def forks():
    """(event, arm) of every run that goes on from the fork."""
    return [
        (event, arm)
        for event in EVENTS
        for arm, (*_, on_null) in ARMS.items()
        if event == "gravity" or on_null
    ]


def run_arm(agent, config, way):
    """The event, and what comes after it."""
    agent.config = config.resolved()
    agent.on_drift("drift")
    if way == "alone":
        forget(agent)
    elif way == "gate":
        Gate(agent)
    records = []
    with mock.patch.object(bellman, "td_target", target(agent, way)):
        for record in train.run(config, agent, EPISODE):
            records.append(record["return"])
            if len(records) == EARLY:
                early = measures(agent)
    late = {f"late {name}": value for name, value in measures(agent).items()}
    ends = {"first": float(np.mean(records[:EARLY])), "last": float(np.mean(records[-LATE:]))}
    return ends | early | late


def target(agent, way):
    """The target of Eq. 4, clipped at the largest possible value, or with double Q-learning."""
    plain, last = bellman.td_target, {}

    def clipped(r, terminated, q_next, gamma):
        return np.minimum(plain(r, terminated, q_next, gamma), LARGEST)

    def double(r, terminated, q_next, gamma):
        best = agent.q(last["s2"]).argmax(1)
        return plain(r, terminated, q_next[np.arange(len(best)), best, None], gamma)

    def remember(batch_size, rng, sample=agent.replay.sample):
        batch = sample(batch_size, rng)
        last["s2"] = batch.s2
        return batch

    if way == "double":
        agent.replay.sample = remember
    return {"clipped": clipped, "double": double}.get(way, plain)


def forget(agent):
    """Take the frozen part away: what is left is a new network, as after a reset."""
    agent.ensemble.weight[:] = 0
    agent.q_frozen[:], agent.q_frozen_next[:] = 0, 0
    agent.memo = np.empty(0), np.empty(0)


class Gate:
    """Q_{m−1} and Q_m act in turn, until the last five returns of Q_m are as good.

    ReuseGBDQN's probation came of this; it asks besides whether Q_{m−1} still does well.
    """

    def __init__(self, agent):
        self.agent, self.returns, self.open = agent, ([], []), False
        self.q, self.end_episode = agent.q, agent.end_episode
        agent.act, agent.end_episode = self.act, self.end

    def act(self, s, greedy=False):
        turn = len(self.returns[0]) + len(self.returns[1])
        q = self.q(s) if self.open or turn % 2 or greedy else self.agent.ensemble.q(s)
        epsilon = 0.0 if greedy else self.agent.epsilon
        return bellman.epsilon_greedy(q, epsilon, self.agent.rng)

    def end(self, total, td_error):
        turn = len(self.returns[0]) + len(self.returns[1])
        self.returns[turn % 2].append(total)
        frozen, learner = (each[-5:] for each in self.returns)
        self.open = self.open or len(learner) == 5 and np.mean(learner) >= np.mean(frozen)
        self.end_episode(total, td_error)


def measures(agent):
    """The mean of max Q on 512 stored states, the learner's dormant units and effective rank.

    A unit is dormant if its mean activation is below 2.5 % of its layer's (Sokar et al. 2023); the
    rank is the number of singular values of the last hidden layer that hold 99 % of their sum
    (Kumar et al. 2021).
    """
    slots = agent.replay.slots()[-512:]
    s = agent.replay.s[slots]
    _, cache = agent.net.forward(agent.theta, s)
    hidden = [h[:, :-1] for h in cache[1:]]
    active = np.concatenate([h.mean(0) / (h.mean() + 1e-12) for h in hidden])
    values = np.linalg.svd(hidden[-1], compute_uv=False)
    rank = int(np.searchsorted(np.cumsum(values), 0.99 * values.sum()) + 1)
    dormant = float(np.mean(active <= 0.025))
    return {"q": float(agent.q(s).max(1).mean()), "dormant": dormant, "rank": rank}


def table(out):
    """The lines of a Markdown table, one per arm; for each event the IQM over seeds of four things.

    The mean returns of the first and of the last episodes, the difference of the latter to DQN's
    with its 95 % interval, and the share of dormant units at the end.
    """
    shape = {f"{event}: {arm}": SHOWN for event, arm in forks()}
    paths = [path for path in sorted(out.glob("*.json")) if path.stem.isdecimal()]
    seeds = [files.read_json(path, **shape) for path in paths]
    if not seeds:
        raise UsageError(f"there is no run in {out}; `run` writes some")
    return [
        f"| {arm} | {cells(seeds, 'null', arm)} | {cells(seeds, 'gravity', arm)} |" for arm in ARMS
    ]


def cells(seeds, event, arm):
    """An arm's four cells for one event, empty if the event does not have it."""
    if (event, arm) not in forks():
        return " | | | "
    rows = [seed[f"{event}: {arm}"] for seed in seeds]
    first, last, dormant = (stats.iqm([row[name] for row in rows]) for name in SHOWN)
    ends = [[seed[f"{event}: {each}"]["last"] for seed in seeds] for each in (arm, "DQN")]
    apart, low, high = stats.paired_difference(*ends, np.random.default_rng(0))
    difference = "" if arm == "DQN" else f"{apart:+.0f} [{low:+.0f}, {high:+.0f}]"
    return f"{first:.0f} | {last:.0f} | {difference} | {dormant:.2f}"


def main(arguments=None):
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["run", "table"])
    parser.add_argument("--seeds", type=count, default=20)
    parser.add_argument("--jobs", type=count, default=2)
    parser.add_argument("--out", type=Path, default=RESULTS)
    args = parser.parse_args(arguments)
    if args.what == "run":
        seeds = [
            k for k in range(FIRST, FIRST + args.seeds) if not (args.out / f"{k}.json").exists()
        ]
        with files.locked(args.out), workers(args.jobs) as pool:
            list(pool.map(partial(run_seed, args.out), seeds))
    print("\n".join(table(args.out)))


if __name__ == "__main__":
    program(main)

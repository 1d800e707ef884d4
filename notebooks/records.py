"""The stored runs that notebook 12 reads, and what it measures in them."""

import sys

import numpy as np
from lesson import FAST, ROOT

sys.path.insert(0, str(ROOT / "paper_checks"))  # the paper's tables, our stored runs
import curves
from paper import TABLES
from reruns import INGREDIENTS, READINGS, STUDIES, final, label, paired, runs_of

from gbdqn_ref import drift, stats, watch
from gbdqn_ref.nn import MLP

__all__ = ["INGREDIENTS", "READINGS", "STUDIES", "TABLES", "curves", "label"]

NET = MLP((2, 128, 128, 3))
KEPT = dict(np.load(curves.PLANE, allow_pickle=False))


# MountainCar's plane


def predict(name, s):
    """What a stored network puts out, (…, 2) → (…, 3)."""
    return NET.forward(KEPT[name], s)[0]


def drive(q, seed, gravity=1.5):
    """The states (steps, 2) of a greedy episode on MountainCar."""
    env = drift.make("mountaincar", [{"episode": 0, "gravity": gravity}])
    s, _ = env.reset(seed=seed, options={"episode": 0})
    states, ends = [s], False
    while not ends:
        s, _, terminated, truncated, _ = env.step(int(q(s[None])[0].argmax()))
        states, ends = [*states, s], terminated or truncated
    return np.array(states)


MAPS = {  # what is shown: (its Q, where its cars have been)
    "GB-DQN at the drift: $Q_1$": (
        lambda s: predict("gbdqn_before", s),
        "gbdqn_visited_before",
    ),
    "GB-DQN at the end: $Q_2$": (
        lambda s: predict("gbdqn_before", s) + 0.1 * predict("gbdqn_after", s),
        "gbdqn_visited_after",
    ),
    "DQN at the end": (lambda s: predict("dqn_after", s), "dqn_visited_after"),
}


def maps():
    """(titles, Q (61, 61, 3) over the plane, where cars have been (61, 61)) of all."""
    values = [q(watch.plane(curves.CELLS)) for q, _ in MAPS.values()]
    return list(MAPS), values, [KEPT[visited] for _, visited in MAPS.values()]


def rides():
    """(how many arrive, the ride of median length) in the heavier world, for each."""
    return [ride(q) for q, _ in MAPS.values()]


def ride(q, count=3 if FAST else 21):
    """(how many of some greedy episodes arrive, the one of median length)."""
    paths = sorted((drive(q, seed) for seed in range(count)), key=len)
    arrived = sum(path[-1, 0] >= 0.5 for path in paths)
    steps = np.mean([len(path) - 1 for path in paths])
    title = f"{arrived} of {count} arrive, {steps:.0f} steps"
    return title, paths[count // 2]


# CartPole


def balance(controller, change, episodes=3 if FAST else 20):
    """Mean steps for which a controller keeps the pole up, with "length × 2" or so."""
    name, _, factor = change.partition(" × ")
    schedule = [{"episode": 0, name: float(factor)}] if factor else []
    env, steps = drift.make("cartpole", schedule), 0
    for seed in range(episodes):
        s, _ = env.reset(seed=seed, options={"episode": 0})
        ends = False
        while not ends:
            s, _, terminated, truncated, _ = env.step(controller(*s))
            steps, ends = steps + 1, terminated or truncated
    return steps / episodes


# Studies


def against_dqn(study):
    """{agent: (differences per seed, their IQM, low, high)} of final returns."""
    ours = final(study)
    return {
        agent: (ours[agent] - ours["dqn"], *paired(study, agent, "dqn"))
        for agent in ours
        if agent not in ("dqn", "random")
    }


def measures(adaptation, returns, agent, k):
    """Medians of drop, recovery and area at drift k, over the runs that could lose."""
    found = []
    for run, row in zip(runs_of("cartpole", agent), returns[agent], strict=True):
        regime, chance = run["regimes"][k], run["random_return"]
        if regime["area"] is not None:
            start, length = regime["first_episode"], regime["episodes"]
            before = row[start - stats.EDGE : start].mean()
            found.append(adaptation(row[start : start + length], before, chance))
    drops, times, areas = zip(*found, strict=True)
    time = stats.median_recovery(times)
    recovery = "never" if time is None else f"{time:g}"
    text = f"drop {np.median(drops):+6.2f}, recovery {recovery:>5}"
    text += f", area {np.median(areas):5.2f}"
    return f"{text} ({len(found)} seeds)"


def p_value(a, b, count=5, draws=200_000):
    """Welch's two-sided p of two (mean, std) over so many runs, by drawing t."""
    va, vb = a[1] ** 2 / count, b[1] ** 2 / count
    freedom = (va + vb) ** 2 / ((va**2 + vb**2) / (count - 1))
    drawn = np.abs(np.random.default_rng(0).standard_t(freedom, draws))
    return (drawn >= abs(a[0] - b[0]) / np.sqrt(va + vb)).mean()

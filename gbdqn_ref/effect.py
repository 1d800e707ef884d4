"""Does a drift matter? What a policy of the stock physics loses in each regime, and whether the
regime can be learnt.

Only a drift that costs something, and can be made good, lets an experiment tell methods apart.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

from . import drift, runs, stats, study
from .config import Config
from .schedule import describe, stock
from .train import evaluate, make_agent


def drift_effect(config, out, jobs=2, episodes=50, quiet=False):
    """One dict per different regime of the schedule, the stock physics first: what three policies
    reach in it.

    random; frozen, trained in the stock physics and learning no more; trained, in this regime from
    the start. Mean greedy returns over the same starts, and what the drift costs. The runs are kept
    in `out`, and those it has are not repeated.
    """
    regimes = {}
    for factors in [stock(config.env), *(regime.factors for regime in config.regimes)]:
        regimes[describe(factors)] = factors
    _, *drifted = regimes.values()
    schedules = [[], *([{"episode": 0, **factors}] for factors in drifted)]
    configs = [replace(config, schedule=schedule) for schedule in schedules]
    folders = [Path(out) / f"{name}, {config.agent}-{config.seed}" for name in regimes]
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(jobs, get_context("spawn"), study.die_with_parent) as executor:
        paths = [str(folder.resolve()) for folder in folders]
        trainings = executor.map(study.train_one, [each.to_dict() for each in configs], paths)
        list(tqdm(trainings, total=len(folders), unit="run", disable=quiet))
    chance = make_agent(Config(env=config.env, agent="random"))
    trained = [runs.read_agent(folder)[1] for folder in folders]
    rows = []
    for name, schedule, policy in zip(regimes, schedules, trained, strict=True):
        env = drift.make(config.env, schedule)
        returns = [evaluate(each, env, episodes, seed=0) for each in (chance, trained[0], policy)]
        rows.append({"regime": name} | cost(*returns))
    return rows


def cost(random: np.ndarray, frozen: np.ndarray, trained: np.ndarray) -> dict[str, float | None]:
    """What a drift costs, from the returns (episodes,) of three policies in its physics.

    lost = (trained − frozen) / (trained − random) of the means; None where trained shows no gain.
    """
    means = [float(returns.mean()) for returns in (random, frozen, trained)]
    gain = stats.gain(trained, means[0])
    lost = None if gain is None else (means[2] - means[1]) / gain
    return dict(zip(("random", "frozen", "trained"), means, strict=True)) | {"lost": lost}

"""Does a drift matter? What a policy of the stock physics loses in each regime, and whether the
regime can be learnt.

Only a drift that costs something, and can be made good, lets an experiment tell methods apart.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from tqdm import tqdm

from . import drift, runs, stats, study
from .config import Config
from .schedule import describe, stock
from .train import evaluate, make_agent

HURTS = 0.2  # of the span between random and trained


def drift_effect(config, out, jobs=2, episodes=50, quiet=False):
    """One dict per different regime of the schedule, the stock physics first: what three policies
    reach in it.

    random; frozen, trained in the stock physics and learning no more; trained, in this regime from
    the start. Mean greedy returns over the same starts. lost = (trained − frozen) / (trained −
    random), None where the trained one is not better than random by two standard errors. The runs
    are kept in `out`, and those it has are not repeated.
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
    return [
        {"regime": name}
        | _levels(drift.make(config.env, schedule), (chance, trained[0], policy), episodes)
        for name, schedule, policy in zip(regimes, schedules, trained, strict=True)
    ]


def _levels(env, policies, episodes):
    returns = [evaluate(policy, env, episodes, seed=0) for policy in policies]
    random, frozen, trained = (float(x.mean()) for x in returns)
    gain = stats.gain(returns[2], random)
    lost = None if gain is None else (trained - frozen) / gain
    return {"random": random, "frozen": frozen, "trained": trained, "lost": lost}

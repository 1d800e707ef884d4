"""Whether a drift matters: what it costs a fixed policy, and whether it can be learnt.

An experiment can tell methods apart only if its drifts cost something and can be learnt.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from . import UsageError, drift, runs, stats, study
from .config import Config
from .schedule import describe, stock
from .stats import Rows
from .train import evaluate, make_agent


def drift_effect(config: Config, out: Path | str, episodes: int = 50, **options: Any) -> Rows:
    """The returns of three policies in each regime, stock physics first: one dict per regime.

    random: uniformly random actions. frozen: trained in the stock physics, then fixed. trained: in
    this regime from the start. Each return is a mean over greedy episodes with the same starts. A
    study in `out` trains the policies; the options are those of study.run_study().
    """
    if episodes < 2:
        raise UsageError(f"a standard error needs at least 2 episodes, not {episodes}")
    configs = regimes(config)
    study.complete(configs, out, **options)
    trained = [runs.read_agent(Path(out) / name)[1] for name in configs]
    random, rows = make_agent(Config(env=config.env, agent="random")), []
    for each, policy in zip(configs.values(), trained, strict=True):
        env = drift.make(each.env, each.schedule)
        returns = [evaluate(who, env, episodes, seed=0) for who in (random, trained[0], policy)]
        rows.append({"regime": describe(each.regimes[0].factors)} | cost(*returns))
    return rows


def regimes(config: Config) -> dict[str, Config]:
    """The runs, {name: config}, that train in each regime by itself, stock physics first.

    >>> schedule = [{"episode": 9, "length": 2.0}, {"episode": 12, "reset": True}]
    >>> list(regimes(Config(agent="dqn", seed=3, schedule=schedule)))
    ['stock-dqn-3', 'length-2.0-dqn-3']
    """
    found = {}
    for factors in [stock(config.env), *(regime.factors for regime in config.regimes)]:
        changed: dict[str, Any] = {key: x for key, x in factors.items() if x != 1}
        name = "-".join(f"{key}-{factor!r}" for key, factor in changed.items()) or "stock"
        schedule = [{"episode": 0} | changed] if changed else []
        found[f"{name}-{config.agent}-{config.seed}"] = replace(config, schedule=schedule)
    return found


def cost(random: np.ndarray, frozen: np.ndarray, trained: np.ndarray) -> dict[str, Any]:
    """What a drift costs, from the returns (episodes,) of three policies in its physics.

    lost = (trained − frozen) / (trained − random) of the means; None if trained shows no gain.
    """
    means = [float(returns.mean()) for returns in (random, frozen, trained)]
    gain = stats.gain(trained, means[0])
    lost = None if gain is None else (means[2] - means[1]) / gain
    return dict(zip(("random", "frozen", "trained"), means, strict=True)) | {"lost": lost}

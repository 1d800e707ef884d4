"""Does a drift matter? What it costs a policy of the stock physics, and whether it can be learnt.

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
    """One dict per regime of the schedule, stock physics first: what three policies reach in it.

    random; frozen, trained in the stock physics and no longer learning; trained, in this regime
    from the start. Each is the mean greedy return of some episodes with the same starts. The two
    are trained as a study in `out`, which keeps them; the options are those of study.run_study().
    """
    if episodes < 2:
        raise UsageError(f"a standard error needs 2 episodes or more, not {episodes}")
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
    """The study of every regime of a config's schedule by itself, stock physics first.

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

    lost = (trained − frozen) / (trained − random) of the means; None where trained shows no gain.
    """
    means = [float(returns.mean()) for returns in (random, frozen, trained)]
    gain = stats.gain(trained, means[0])
    lost = None if gain is None else (means[2] - means[1]) / gain
    return dict(zip(("random", "frozen", "trained"), means, strict=True)) | {"lost": lost}

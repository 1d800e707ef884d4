"""Environments whose physics drift: a wrapper that applies a schedule between episodes."""

from collections.abc import Callable
from reprlib import repr as short
from typing import Any

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from . import UsageError, physics
from .schedule import check_environment, is_count, regimes

# {name: (Gymnasium's id, the setter of its physics)}
ENVIRONMENTS: dict[str, tuple[str, Callable[..., None]]] = {
    "cartpole": ("CartPole-v1", physics.set_cartpole),
    "mountaincar": ("MountainCar-v0", physics.set_mountaincar),
    "acrobot": ("gbdqn_ref/Acrobot-v1", physics.set_acrobot),
    "hopper": ("gbdqn_ref/Hopper-v5", physics.set_hopper),
}


class DriftWrapper(gymnasium.Wrapper, RecordConstructorArgs):
    """Changes the physics of an environment between episodes, by a schedule.

    reset() counts episodes; reset(options={"episode": k}) starts episode k instead. `info` of every
    reset and step carries `regime` (0, 1, …), `factors` (all of them) and `event`: "drift" or
    "reset" in the first episode of a regime, else None. Observations, rewards and the time limit
    are unchanged.
    """

    def __init__(self, env: gymnasium.Env, schedule: list | tuple | None = None) -> None:
        id = env.spec.id if env.spec else type(env).__name__
        name = next((name for name, (known, _) in ENVIRONMENTS.items() if known == id), id)
        check_environment(name)
        self.regimes = regimes(name, [] if schedule is None else schedule)
        self._set = ENVIRONMENTS[name][1]
        RecordConstructorArgs.__init__(self, schedule=list(schedule or []))
        super().__init__(env)
        self.episode, self.regime = -1, 0

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Set a copy's physics, since Gymnasium rebuilds MuJoCo's model with the stock ones."""
        self.__dict__.update(state)
        self._set(self.env.unwrapped, **self.regimes[self.regime].factors)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        options = dict(options or {})
        episode = options.pop("episode", self.episode + 1)
        if not is_count(episode):
            raise UsageError(f"episode must be a non-negative whole number, not {short(episode)}")
        self.episode = int(episode)
        self.regime = sum(regime.start <= self.episode for regime in self.regimes) - 1
        self._set(self.env.unwrapped, **self.regimes[self.regime].factors)
        s, info = self.env.reset(seed=seed, options=options)
        return s, info | self._info()

    def step(self, action: int) -> tuple:
        s2, r, terminated, truncated, info = self.env.step(action)
        return s2, r, terminated, truncated, info | self._info()

    def _info(self) -> dict:
        regime = self.regimes[self.regime]
        begins = regime.start == self.episode > 0
        return {
            "regime": self.regime,
            "factors": dict(regime.factors),
            "event": regime.event if begins else None,
        }


def make(name: str, schedule: list | tuple | None = None, **kwargs: Any) -> DriftWrapper:
    """The named environment with its time limit, which drifts by the schedule.

    Further arguments go to gymnasium.make.

    >>> env = make("cartpole", [{"episode": 1, "length": 4.0}])
    >>> [env.reset(seed=seed)[1]["factors"]["length"] for seed in (0, 1)]
    [1.0, 4.0]
    """
    check_environment(name)
    id, _ = ENVIRONMENTS[name]
    return DriftWrapper(gymnasium.make(id, disable_env_checker=True, **kwargs), schedule)

"""When the physics drift: a schedule, resolved once into regimes. Nothing here needs Gymnasium.

    schedule = [{"episode": 150, "gravity": 1.5}, {"episode": 350, "gravity": 1.5, "mass": 1.5},
                {"episode": 450, "reset": True}]

Episodes count from 0. An entry sets every factor of its regime; a factor it does not name is 1.
{"reset": True} sets all of them to 1. Before the first entry the physics are the stock ones.
"""

from itertools import pairwise
from math import inf
from numbers import Integral, Real
from reprlib import repr as short
from typing import Any, NamedTuple

from . import UsageError

FACTORS = {  # what may drift in each environment: factors on the stock constants
    "cartpole": ("gravity", "cart_mass", "pole_mass", "length", "force"),
    "mountaincar": ("gravity", "force"),
    "acrobot": ("gravity", "mass", "length", "torque"),
    "hopper": ("gravity", "mass", "friction"),
}
LABELS = {  # an environment's name in titles
    "cartpole": "CartPole",
    "mountaincar": "MountainCar",
    "acrobot": "Acrobot",
    "hopper": "Hopper",
}
SIGNED = {"force", "torque"}  # a reversed actuator is a drift, a negative mass is a mistake
LEAST, MOST = 0.01, 100.0  # bounds on a factor's size; far beyond them integrators overflow


class Regime(NamedTuple):
    """The episodes from `start` to `end` − 1, with the same physics; `event` began them."""

    start: int
    end: int | float
    factors: dict[str, float]
    event: str | None

    @property
    def drifted(self) -> bool:
        """Whether the physics are not the stock ones."""
        return any(factor != 1 for factor in self.factors.values())


def regimes(env: str, schedule: list | tuple, episodes: int | float = inf) -> tuple[Regime, ...]:
    """The regimes of a run of so many episodes; the first begins with episode 0.

    UsageError if the schedule is invalid.

    >>> for regime in regimes("mountaincar", [{"episode": 5, "force": -1.0}], 8):
    ...     print(regime.start, regime.end, regime.factors, regime.event)
    0 5 {'gravity': 1.0, 'force': 1.0} None
    5 8 {'gravity': 1.0, 'force': -1.0} drift
    """
    if not isinstance(schedule, (list, tuple)):
        raise UsageError(
            'schedule must be a list of entries like {"episode": 9, "gravity": 1.5}, '
            f"not {short(schedule)}"
        )
    found = [_regime(env, entry) for entry in schedule]
    for before, after in pairwise(found):
        if after.start <= before.start:
            raise UsageError(
                f"schedule episodes must increase, but {after.start} follows {before.start}"
            )
    if not found or found[0].start > 0:
        found.insert(0, Regime(0, inf, stock(env), None))
    met = [regime for regime in found if regime.start < episodes]
    ends = [*(regime.start for regime in met[1:]), episodes]
    return tuple(regime._replace(end=end) for regime, end in zip(met, ends, strict=True))


def _regime(env: str, entry: dict) -> Regime:
    """The regime that one entry describes, with an open end."""
    if not isinstance(entry, dict):
        raise UsageError(
            f'a schedule entry must be like {{"episode": 9, "gravity": 1.5}}, not {short(entry)}'
        )
    factors = {key: value for key, value in entry.items() if key not in ("episode", "reset")}
    episode: Any = entry.get("episode")
    reset = entry.get("reset", False)
    if not is_count(episode):
        raise UsageError(
            f"schedule entry {short(entry)} needs an 'episode', a non-negative whole number"
        )
    if type(reset) is not bool or bool(factors) == reset:
        raise UsageError(
            f"schedule entry {short(entry)} must name factors ({', '.join(FACTORS[env])}) "
            "or say 'reset': True"
        )
    for key, value in factors.items():
        _check_factor(env, key, value)
    drifted = {key: float(value) for key, value in factors.items()}
    return Regime(int(episode), inf, stock(env) | drifted, "reset" if reset else "drift")


def _check_factor(env: str, key: str, value: float) -> None:
    if key not in FACTORS[env]:
        raise UsageError(f"{env} has no factor {short(key)}; it has {', '.join(FACTORS[env])}")
    size = abs(value) if key in SIGNED and is_number(value) else value
    if not is_number(value) or not LEAST <= size <= MOST:
        sign = ", of either sign" if key in SIGNED else ""
        raise UsageError(
            f"schedule factor {key!r} must be a number from {LEAST:g} to {MOST:g}{sign}, "
            f"not {short(value)}"
        )


def is_number(value: object) -> bool:
    """Whether a value is a real number, NumPy's included, and not a bool."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_count(value: object) -> bool:
    """Whether a value is a non-negative whole number, NumPy's included, and not a bool."""
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 0


def check_environment(env: object) -> None:
    """UsageError if there is no environment of this name."""
    if not isinstance(env, str) or env not in FACTORS:
        raise UsageError(f"unknown environment {short(env)}; choose one of {', '.join(FACTORS)}")


def stock(env: str) -> dict[str, float]:
    """Every factor of an environment at 1.

    >>> stock("mountaincar")
    {'gravity': 1.0, 'force': 1.0}
    """
    check_environment(env)
    return dict.fromkeys(FACTORS[env], 1.0)


def describe(factors: dict[str, float], separator: str = ", ") -> str:
    """The factors that differ from 1, in words.

    >>> describe({"gravity": 1.5, "pole_mass": 1.0, "cart_mass": 2.0})
    'gravity × 1.5, cart mass × 2'
    >>> describe({"gravity": 1.0})
    'stock physics'
    """
    changed = [
        f"{name.replace('_', ' ')} × {repr(factor).removesuffix('.0')}"
        for name, factor in factors.items()
        if factor != 1
    ]
    return separator.join(changed) or "stock physics"

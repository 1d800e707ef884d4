"""One dataclass that says everything about a run. Nothing here learns."""

import difflib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from math import inf, isfinite
from reprlib import repr as short
from typing import Annotated, Any, NamedTuple, Self, get_args, get_origin, get_type_hints

import numpy as np

from . import UsageError
from .agents import AGENTS, OWN
from .detect import SIGNALS as DETECTED
from .presets import PRESETS
from .schedule import FACTORS, Regime, check_environment, is_count, regimes


class Rule(NamedTuple):
    """What a setting may be: in words, as a test, and values just beyond what it allows."""

    words: str
    holds: Callable[[Any], bool]
    breaks: tuple = ()


def whole(low: int, high: int) -> Rule:
    """The rule of whole numbers from low to high."""
    words = f"a whole number from {low:,} to {high:,}"
    return Rule(words, lambda n: low <= n <= high, (low - 1, high + 1))


def one_of(*choices: str | None) -> Rule:
    """The rule of words, of which None is written null."""
    words = ", ".join(choice or "null" for choice in choices)
    return Rule(f"one of {words}", lambda word: word in choices, ("xyzzy", ""))


def own_or(rule: Rule) -> Rule:
    """The same rule, for a setting that is the agent's own while it is None."""
    words = f"{rule.words}, or null for the agent's own"
    return Rule(words, lambda value: value is None or rule.holds(value), rule.breaks)


SIGNALS = ("schedule", *DETECTED)
COUNT = whole(1, 10_000_000)
FRACTION = Rule("a number from 0 to 1", lambda x: 0 <= x <= 1, (-0.01, 1.01, inf))
POSITIVE = Rule("a positive finite number", lambda x: isfinite(x) and x > 0, (0.0, -1e-9, inf))
NORM = Rule("a positive number up to 1e6", lambda x: 0 < x <= 1e6, (0.0, -1e-9, 1.1e6, inf))
NOT_NEGATIVE = Rule("a finite number from 0 on", lambda x: isfinite(x) and x >= 0, (-1e-9, inf))
DISCOUNT = Rule("a number in [0, 1)", lambda x: 0 <= x < 1, (1.0, -0.1, inf))
PROBABILITY = Rule("a number above 0 and at most 1", lambda x: 0 < x <= 1, (0.0, 1.01))
YES_OR_NO = Rule("true or false", lambda _: True)
WIDTHS = Rule(
    "a list of widths from 1 to 4096, like [128, 128]",
    lambda widths: all(type(width) is int and 1 <= width <= 4096 for width in widths),
    ([0], [-3], [1.5], ["8"], [True], [8, None], [4097], [[8]]),
)
STEP_SIZE = Rule(
    'a positive number up to 1e6 or "closed-form"',
    lambda a: a == "closed-form" if isinstance(a, str) else 0 < a <= 1e6,
    (0.0, -1e-9, 1.1e6, inf, "closed"),
)
SIGNAL = Rule(
    '"schedule", "return", "td_error" or a list of increasing episodes',
    lambda signal: _increasing(signal) if isinstance(signal, list) else signal in SIGNALS,
    ("drift", [3, 3], [-1], [1.5], [True]),
)
SCHEDULE = Rule(
    'a list of entries like {"episode": 9, "gravity": 1.5}',
    lambda _: True,  # regimes() looks at the entries
    ([5], [{"episode": 1}], [{"episode": 1, "gravity": 0}]),
)


def _increasing(episodes: list) -> bool:
    return all(is_count(each) for each in episodes) and episodes == sorted(set(episodes))


@dataclass(frozen=True)
class Config:
    """The settings of one run; the same config gives the same bytes on one machine.

    A setting that is None is the agent's own, and follows a change of agent; resolved() fills it
    in.

    >>> config = Config(env="acrobot", agent="gbdqn")
    >>> config.replay, config.resolved().replay
    (None, 'recency')
    >>> Config(gamma=1.5)
    Traceback (most recent call last):
    gbdqn_ref.UsageError: gamma must be a number in [0, 1), not 1.5
    """

    env: Annotated[str, one_of(*FACTORS)] = "cartpole"
    """What is learnt."""
    agent: Annotated[str, one_of(*AGENTS)] = "gbdqn"
    """Who learns: GB-DQN, a baseline or a control."""
    seed: Annotated[int, whole(0, 2**32 - 1)] = 0
    """Seed of the agent; with the episode's number it seeds each reset, so agents are paired."""
    episodes: Annotated[int, COUNT] = 600
    """How many episodes a run has."""
    schedule: Annotated[list, SCHEDULE] = field(default_factory=list)
    """When the physics drift, and to what: a list like [{"episode": 150, "gravity": 1.5}]."""

    gamma: Annotated[float, DISCOUNT] = 0.99
    """Discount γ."""
    hidden: Annotated[tuple, WIDTHS] = (128, 128)
    """Widths of the hidden layers; [] is a linear network, hence a table on one-hot states."""
    lr: Annotated[float, POSITIVE] = 1e-3
    """Adam's step size."""
    max_grad_norm: Annotated[float, NORM] = 10.0
    """Longer gradients are scaled down to this norm."""
    batch_size: Annotated[int, COUNT] = 64
    """Transitions per update."""
    learning_starts: Annotated[int, COUNT] = 1_000
    """Environment steps before the first update."""
    update_every: Annotated[int, COUNT] = 4
    """Environment steps between two rounds of updates."""
    gradient_steps: Annotated[int, COUNT] = 1
    """Updates in a round."""
    tau: Annotated[float, FRACTION] = 0.01
    """Polyak coefficient τ of the target network, applied at each update (D9)."""

    behaviour: Annotated[str, one_of("epsilon-greedy", "softmax")] = "epsilon-greedy"
    """How the agent explores: as in the experiments, or with Algorithm 1's softmax (D10)."""
    epsilon_start: Annotated[float, FRACTION] = 1.0
    """ε at the first step."""
    epsilon_end: Annotated[float, FRACTION] = 0.05
    """ε from epsilon_decay_steps on."""
    epsilon_decay_steps: Annotated[int, COUNT] = 20_000
    """Environment steps over which ε falls, linearly."""
    temperature: Annotated[float, POSITIVE] = 1.0
    """Temperature τ of the softmax policy."""

    capacity: Annotated[int, COUNT] = 50_000
    """Transitions that the replay buffer holds."""
    replay: Annotated[str | None, own_or(one_of("uniform", "proportional", "recency"))] = None
    """How a batch is drawn: evenly, by TD error, or by TD error and recency."""
    priority_offset: Annotated[float, POSITIVE] = 0.01
    """ε in p^TD = (|δ| + ε)^γ."""
    priority_exponent: Annotated[float, NOT_NEGATIVE] = 0.6
    """γ in p^TD = (|δ| + ε)^γ."""
    is_exponent: Annotated[float, FRACTION] = 0.4
    """β in the importance weights w = (1 / (N P))^β."""
    normalise: Annotated[str | None, one_of("batch", None)] = "batch"
    """Importance weights are divided by the batch's largest ("batch") or left alone (null)."""
    mix: Annotated[float, FRACTION] = 0.3
    """β in p = β p^TD + (1 − β) p^time (Eq. 10)."""
    recency_rate: Annotated[float, NOT_NEGATIVE] = 1e-4
    """α in p^time = exp(−α age), per transition (D5)."""

    target: Annotated[str, one_of("live", "frozen")] = "live"
    """GB-DQN acts and bootstraps with the learner in training, or without it (D6)."""
    alpha: Annotated[float | str | None, own_or(STEP_SIZE)] = None
    """GB-DQN's α_m of boosters 2, 3, …: η_boost of the experiments (D15), or by Eq. 8."""
    loss_on: Annotated[str, one_of("alpha_h", "h")] = "alpha_h"
    """GB-DQN fits α h to the residual (Eq. 5), or h (Algorithm 1, line 19) (D6)."""
    zero_output: Annotated[bool | None, own_or(YES_OR_NO)] = None
    """GB-DQN's new boosters start as the zero function, so adding one changes no action (D11)."""
    warm_start: Annotated[bool | None, own_or(YES_OR_NO)] = None
    """GB-DQN's new boosters start from the last learner's parameters (D22)."""

    keep_data: Annotated[float | None, own_or(FRACTION)] = None
    """Part of the older data that is kept at an event, its newest (D22)."""
    keep_adam: Annotated[bool | None, own_or(YES_OR_NO)] = None
    """Adam's moments are kept at an event; a fresh network has fresh ones (D22)."""
    lr_factor: Annotated[float, POSITIVE] = 1.0
    """From the first event on Adam's step size is lr times this (D22)."""
    epsilon_restart: Annotated[float, FRACTION] = 0.0
    """ε is raised to this at an event and falls as at the start; 0 leaves it alone (D22)."""
    drift_signal: Annotated[str | list | None, own_or(SIGNAL)] = None
    """What tells of a drift: the schedule, falling returns, rising |δ|, or some episodes (D22)."""
    alarm_level: Annotated[float, POSITIVE] = 5.0
    """S of the CUSUM chart at which an agent that looks for drifts raises an alarm (D22)."""

    members: Annotated[int, whole(1, 100)] = 5
    """Networks of Ensemble-DQN (D19)."""
    bootstrap: Annotated[float, PROBABILITY] = 1.0
    """Probability that a member of the ensemble sees a transition; with 1 all see all (D18)."""
    window: Annotated[int, COUNT] = 5_000
    """Transitions that Sliding-window DQN remembers, in place of capacity."""

    def __post_init__(self) -> None:
        for name, (kinds, rule) in SETTINGS.items():
            value = _plain(getattr(self, name), kinds)
            if type(value) not in kinds or not rule.holds(value):
                raise UsageError(f"{name} must be {rule.words}, not {short(value)}")
            object.__setattr__(self, name, value)
        _ = self.regimes  # refuses a broken schedule

    def __hash__(self) -> int:
        return hash(json.dumps(self.to_dict(), sort_keys=True))

    @cached_property
    def regimes(self) -> tuple[Regime, ...]:
        """The schedule, resolved when the config is made and cut off at the run's end."""
        return regimes(self.env, self.schedule, self.episodes)

    def resolved(self) -> Self:
        """The same config with the agent's own settings in place of None."""
        own = OWN | AGENTS[self.agent].own
        return replace(self, **{key: own[key] for key in own if getattr(self, key) is None})

    @classmethod
    def preset(cls, env: str, name: str | None = None, /, **values: Any) -> Self:
        """The settings of a preset for an environment, "paper" by default; `values` replace some.

        "hopper-long" is short for the preset "long" of hopper, "acrobot-hard" for "hard" of
        acrobot.

        >>> Config.preset("acrobot", agent="dqn").capacity
        50000
        """
        env, name = preset_of(env, name)
        if "env" in values:
            raise UsageError(f"the preset is for {env}, so env cannot be {short(values['env'])}")
        return cls.from_dict({"env": env} | PRESETS[name][env] | values)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """A config from a mapping such as the one in config.json.

        UsageError names a setting that does not exist.
        """
        if not isinstance(values, Mapping):
            raise UsageError(f"settings must be a mapping of names to values, not {short(values)}")
        for name in values:
            if name not in SETTINGS:
                near = difflib.get_close_matches(str(name), SETTINGS, 1)
                guess = f"; did you mean {near[0]!r}?" if near else ""
                raise UsageError(f"there is no setting {short(name)}{guess}")
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; from_dict(to_dict()) is the same config."""
        return json.loads(json.dumps(asdict(self)))


def preset_of(env: Any, name: Any = None) -> tuple[str, str]:
    """(environment, preset) from an environment, perhaps with its preset as a suffix, and a preset.

    >>> preset_of("hopper-long"), preset_of("acrobot")
    (('hopper', 'long'), ('acrobot', 'paper'))
    """
    known, _, suffix = env.partition("-") if isinstance(env, str) else (env, "", "")
    check_environment(known)
    if suffix and name is not None and name != suffix:
        raise UsageError(f"{short(env)} names the preset {suffix}, so it cannot be {short(name)}")
    name = suffix or ("paper" if name is None else name)
    names = [preset for preset, environments in PRESETS.items() if known in environments]
    if name not in names:
        raise UsageError(f"{known} has no preset {short(name)}; choose one of {', '.join(names)}")
    return known, name


def _plain(value: Any, kinds: tuple[type, ...]) -> Any:
    """The value in Python's own types, and in the kind of its setting where no meaning changes."""
    if isinstance(value, (list, tuple)):
        value = [_plain(each, ()) for each in value]
        return tuple(value) if tuple in kinds else value
    if isinstance(value, dict):
        return {key: _plain(each, ()) for key, each in value.items()}
    if isinstance(value, np.generic):
        value = value.item()
    if float in kinds and type(value) is int:
        return float(value) if abs(value) < 1e300 else inf
    return value


def _setting(hint: Any) -> tuple[tuple[type, ...], Rule]:
    """(types, rule) of an annotation like Annotated[str | None, rule]."""
    kind, rule = hint.__origin__, hint.__metadata__[0]
    return get_args(kind) or (kind,), rule


SETTINGS = {
    name: _setting(hint)
    for name, hint in get_type_hints(Config, include_extras=True).items()
    if get_origin(hint) is Annotated
}

"""One dataclass with all settings of a run. Nothing here learns."""

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
from .detect import SLACK
from .presets import PRESETS
from .schedule import FACTORS, Regime, check_environment, is_count, regimes


class Rule(NamedTuple):
    """The values a setting may have: in words, as a test, and examples that it refuses."""

    words: str
    holds: Callable[[Any], bool]
    breaks: tuple = ()


def whole(low: int, high: int) -> Rule:
    """The rule for whole numbers from low to high."""
    words = f"a whole number from {low:,} to {high:,}"
    return Rule(words, lambda n: low <= n <= high, (low - 1, high + 1))


def one_of(*choices: str | None) -> Rule:
    """The rule for a choice of words; None is written null."""
    words = ", ".join(choice or "null" for choice in choices)
    return Rule(f"one of {words}", lambda word: word in choices, ("xyzzy", ""))


def own_or(rule: Rule) -> Rule:
    """The same rule, which also allows None for the agent's own value."""
    words = f"{rule.words}, or null for the agent's own"
    return Rule(words, lambda value: value is None or rule.holds(value), rule.breaks)


SIGNALS = ("schedule", "detector")
COUNT = whole(1, 10_000_000)
FRACTION = Rule("a number from 0 to 1", lambda x: 0 <= x <= 1, (-0.01, 1.01, inf))
POSITIVE = Rule("a positive finite number", lambda x: isfinite(x) and x > 0, (0.0, -1e-9, inf))
NORM = Rule("a positive number up to 1e6", lambda x: 0 < x <= 1e6, (0.0, -1e-9, 1.1e6, inf))
NOT_NEGATIVE = Rule("a non-negative finite number", lambda x: isfinite(x) and x >= 0, (-1e-9, inf))
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
    '"schedule", "detector" or a list of increasing episodes',
    lambda signal: _increasing(signal) if isinstance(signal, list) else signal in SIGNALS,
    ("drift", [3, 3], [-1], [1.5], [True]),
)
SCHEDULE = Rule(
    'a list of entries like {"episode": 9, "gravity": 1.5}',
    lambda _: True,  # regimes() checks the entries
    ([5], [{"episode": 1}], [{"episode": 1, "gravity": 0}]),
)


def _increasing(episodes: list) -> bool:
    return all(is_count(each) for each in episodes) and episodes == sorted(set(episodes))


@dataclass(frozen=True)
class Config:
    """The settings of one run; the same config gives the same bytes on one machine.

    None stands for the agent's own value, so it changes with the agent; resolved() fills it in.

    >>> config = Config(env="acrobot", agent="gbdqn")
    >>> config.replay, config.resolved().replay
    (None, 'recency')
    >>> Config(gamma=1.5)
    Traceback (most recent call last):
    gbdqn_ref.UsageError: gamma must be a number in [0, 1), not 1.5
    """

    env: Annotated[str, one_of(*FACTORS)] = "cartpole"
    """The environment."""
    agent: Annotated[str, one_of(*AGENTS)] = "gbdqn"
    """The agent: GB-DQN, a baseline or a control."""
    seed: Annotated[int, whole(0, 2**32 - 1)] = 0
    """Seed of the agent; with the episode number it seeds each reset, which pairs the agents."""
    episodes: Annotated[int, COUNT] = 600
    """Number of episodes in a run."""
    schedule: Annotated[list, SCHEDULE] = field(default_factory=list)
    """When and how the physics drift: a list like [{"episode": 150, "gravity": 1.5}]."""

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
    """Exploration: ε-greedy as in the experiments, or softmax as in Algorithm 1 (D10)."""
    epsilon_start: Annotated[float, FRACTION] = 1.0
    """ε at the first step."""
    epsilon_end: Annotated[float, FRACTION] = 0.05
    """ε after epsilon_decay_steps."""
    epsilon_decay_steps: Annotated[int, COUNT] = 20_000
    """Environment steps over which ε falls linearly."""
    temperature: Annotated[float, POSITIVE] = 1.0
    """Temperature τ of the softmax policy."""

    capacity: Annotated[int, COUNT] = 50_000
    """Size of the replay buffer, in transitions."""
    replay: Annotated[str | None, own_or(one_of("uniform", "proportional", "recency"))] = None
    """How a batch is drawn: uniformly, by TD error, or by TD error and recency."""
    priority_offset: Annotated[float, POSITIVE] = 0.01
    """ε in p^TD = (|δ| + ε)^γ."""
    priority_exponent: Annotated[float, NOT_NEGATIVE] = 0.6
    """γ in p^TD = (|δ| + ε)^γ."""
    is_exponent: Annotated[float, FRACTION] = 0.4
    """β in the importance weights w = (1 / (N P))^β."""
    normalise: Annotated[str | None, one_of("batch", None)] = "batch"
    """Divide importance weights by the batch's largest ("batch"), or do not (null)."""
    mix: Annotated[float, FRACTION] = 0.3
    """β in p = β p^TD + (1 − β) p^time (Eq. 10)."""
    recency_rate: Annotated[float, NOT_NEGATIVE] = 1e-4
    """α in p^time = exp(−α age), per transition (D5)."""

    target: Annotated[str, one_of("live", "frozen")] = "live"
    """GB-DQN acts and bootstraps with the new learner (live) or without it (frozen) (D6)."""
    alpha: Annotated[float | str | None, own_or(STEP_SIZE)] = None
    """GB-DQN's α_m from booster 2 on: η_boost as in the experiments (D15), or by Eq. 8."""
    loss_on: Annotated[str, one_of("alpha_h", "h")] = "alpha_h"
    """GB-DQN fits α h to the residual (Eq. 5), or h (Algorithm 1, line 19) (D6)."""
    zero_output: Annotated[bool | None, own_or(YES_OR_NO)] = None
    """GB-DQN's new boosters start as the zero function, so adding one changes no action (D11)."""
    warm_start: Annotated[bool | None, own_or(YES_OR_NO)] = None
    """GB-DQN's new boosters start from the last learner's parameters (D22)."""

    keep_data: Annotated[float | None, own_or(FRACTION)] = None
    """Share of the older data, its newest part, that is kept at a drift or reset (D22)."""
    keep_adam: Annotated[bool | None, own_or(YES_OR_NO)] = None
    """Keep Adam's moments at a drift or reset; a new booster has new ones (D22)."""
    lr_factor: Annotated[float, POSITIVE] = 1.0
    """Factor on lr from the first drift or reset on (D22)."""
    epsilon_restart: Annotated[float, FRACTION] = 0.0
    """ε is raised to this at a drift or reset and falls as at the start; 0: it is not (D22)."""
    drift_signal: Annotated[str | list | None, own_or(SIGNAL)] = None
    """What signals a drift: the schedule, the agent's own detector, or given episodes (D22)."""
    symptom: Annotated[str, one_of(*SLACK)] = "return"
    """What the detector charts: falling returns, rising |δ|, or a model's rising error (D22)."""
    alarm_level: Annotated[float, POSITIVE] = 5.0
    """Threshold on the CUSUM statistic S above which an agent detects a drift (D22)."""

    members: Annotated[int, whole(1, 100)] = 5
    """Number of networks in Ensemble-DQN (D19)."""
    bootstrap: Annotated[float, PROBABILITY] = 1.0
    """Probability that a member sees a transition; with 1, as in the paper, always (D18)."""
    window: Annotated[int, COUNT] = 5_000
    """Replay size of Sliding-window DQN, in place of capacity."""

    def __post_init__(self) -> None:
        for name, (kinds, rule) in SETTINGS.items():
            try:
                value = _plain(getattr(self, name), kinds)
            except RecursionError as e:
                raise UsageError(f"{name} must be {rule.words}, not lists in lists in lists") from e
            if type(value) not in kinds or not rule.holds(value):
                raise UsageError(f"{name} must be {rule.words}, not {short(value)}")
            object.__setattr__(self, name, value)
        _ = self.regimes  # checks the schedule

    def __hash__(self) -> int:
        return hash(json.dumps(self.to_dict(), sort_keys=True))

    @cached_property
    def regimes(self) -> tuple[Regime, ...]:
        """The schedule, resolved once and cut off at the end of the run."""
        return regimes(self.env, self.schedule, self.episodes)

    def resolved(self) -> Self:
        """The same config with the agent's own values in place of None."""
        own = OWN | AGENTS[self.agent].own
        return replace(self, **{key: own[key] for key in own if getattr(self, key) is None})

    @classmethod
    def preset(cls, env: str, name: str | None = None, /, **values: Any) -> Self:
        """The settings of a preset for an environment; `values` replace some of them.

        The default preset is "paper". "hopper-long" is short for hopper with the preset "long".

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

        UsageError names an unknown setting.
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
    """(environment, preset); the preset may also be a suffix of the environment.

    >>> preset_of("hopper-long"), preset_of("acrobot")
    (('hopper', 'long'), ('acrobot', 'paper'))
    """
    known, dash, suffix = env.partition("-") if isinstance(env, str) else (env, "", "")
    check_environment(known)
    if dash and name not in (None, suffix):
        raise UsageError(f"{short(env)} names the preset {suffix}, so it cannot be {short(name)}")
    if dash or name is None:
        name = suffix if dash else "paper"
    names = [preset for preset, environments in PRESETS.items() if known in environments]
    if name not in names:
        raise UsageError(f"{known} has no preset {short(name)}; choose one of {', '.join(names)}")
    return known, name


def _plain(value: Any, kinds: tuple[type, ...]) -> Any:
    """The value in plain Python types, converted to the setting's type where nothing is lost."""
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

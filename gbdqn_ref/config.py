"""One dataclass that says everything about a run. Nothing here learns."""

import difflib
import json
from dataclasses import asdict, dataclass, fields
from math import inf, isfinite
from reprlib import repr as short
from typing import get_args

from . import UsageError
from .drift import ENVIRONMENTS, check_schedule, environment, is_number
from .presets import PRESETS


@dataclass(frozen=True)
class Config:
    """The resolved settings of one run; the same config gives the same bytes on one machine.

    >>> Config(env="acrobot", agent="gbdqn").replay
    'recency'
    >>> Config(gamma=1.5)
    Traceback (most recent call last):
    gbdqn_ref.UsageError: gamma must be in [0, 1), not 1.5
    """

    env: str = "cartpole"
    """What is learnt: cartpole, mountaincar, acrobot or hopper."""
    agent: str = "gbdqn"
    """gbdqn, a baseline (dqn, ensemble, reset, sliding) or a control (frozen, random, dqn-recency,
    gbdqn-per).
    """
    seed: int = 0
    """Seed of the agent's generator; with the episode's number it also seeds each reset, so agents
    are paired.
    """
    episodes: int = 600
    """How many episodes a run has."""
    schedule: list | tuple = ()
    """When the physics drift, and to what: a list like [{"episode": 150, "gravity": 1.5}] (see
    drift).
    """

    gamma: float = 0.99
    """Discount γ."""
    hidden: tuple = (128, 128)
    """Widths of the hidden layers; () makes the network linear, hence a table on one-hot states."""
    lr: float = 1e-3
    """Adam's step size."""
    max_grad_norm: float = 10.0
    """The gradient is scaled down to this norm where it is longer."""
    batch_size: int = 64
    """Transitions per update."""
    learning_starts: int = 1_000
    """Environment steps before the first update."""
    update_every: int = 4
    """Environment steps between two rounds of updates."""
    gradient_steps: int = 1
    """Updates in a round."""
    tau: float = 0.01
    """Polyak coefficient τ of the target network, applied at each update."""

    behaviour: str = "epsilon-greedy"
    """How the agent explores: epsilon-greedy as in the experiments (D10), or softmax as in
    Algorithm 1.
    """
    epsilon_start: float = 1.0
    """ε at the first step."""
    epsilon_end: float = 0.05
    """ε from epsilon_decay_steps on."""
    epsilon_decay_steps: int = 20_000
    """Environment steps over which ε falls, linearly."""
    temperature: float = 1.0
    """Temperature τ of the softmax policy."""

    capacity: int = 50_000
    """Transitions that the replay buffer holds."""
    replay: str | None = None
    """uniform, proportional or recency; None is the agent's own: recency for gbdqn, dqn-recency,
    proportional else.
    """
    priority_offset: float = 0.01
    """ε in p^TD = (|δ| + ε)^γ."""
    priority_exponent: float = 0.6
    """γ in p^TD = (|δ| + ε)^γ."""
    is_exponent: float = 0.4
    """β in the importance weights w = (1 / (N P))^β."""
    normalise: str | None = "batch"
    """Importance weights are divided by the batch's largest ("batch") or left as they are (None).
    """
    mix: float = 0.3
    """β in p = β p^TD + (1 − β) p^time (Eq. 10)."""
    recency_rate: float = 1e-4
    """α in p^time = exp(−α age), per transition."""

    target: str = "live"
    """gbdqn bootstraps and acts with the sum including the learner in training (live), or without
    it (frozen).
    """
    alpha: float | str = 0.1
    """gbdqn's α_m of boosters 2, 3, …: a number, as η_boost in the experiments (D15), or
    "closed-form" (Eq. 8).
    """
    loss_on: str = "alpha_h"
    """gbdqn fits α h to the residual (alpha_h, Eq. 5), or h (h, Algorithm 1 line 19)."""
    zero_output: bool = True
    """gbdqn's new boosters start as the zero function, so that adding one changes no action (D11).
    """

    members: int = 5
    """ensemble's networks (D19)."""
    bootstrap: float = 1.0
    """Probability that one of ensemble's networks sees a transition; 1, as in the paper: all see
    all (D18).
    """
    window: int = 5_000
    """Transitions that sliding's replay buffer holds, in place of capacity."""

    def __post_init__(self):
        for field in fields(self):
            name, value, kinds = (
                field.name,
                getattr(self, field.name),
                get_args(field.type) or (field.type,),
            )
            if float in kinds and type(value) is int:
                value = float(value) if is_number(value) else inf
            if kinds == (tuple,) and type(value) is list:
                value = tuple(value)
            if len(kinds) == 1 and type(value) not in kinds:
                raise UsageError(f"{name} must be {KINDS[field.type]}, not {short(value)}")
            if value not in CHOICES.get(name, [value]):
                options = ", ".join(choice or "null" for choice in CHOICES[name])
                raise UsageError(f"unknown {name} {short(value)}; choose one of {options}")
            what, holds = RULES.get(name, ("", lambda value: True))
            if not holds(value):
                raise UsageError(f"{name} must be {what}, not {short(value)}")
            object.__setattr__(self, name, value)
        if self.replay is None:
            object.__setattr__(
                self, "replay", "recency" if self.agent in RECENCY else "proportional"
            )
        check_schedule(self.env, self.schedule)
        object.__setattr__(self, "schedule", [dict(entry) for entry in self.schedule])

    @classmethod
    def preset(cls, env, name="paper", /, **values):
        """The settings of the paper for this environment, or others of its presets; `values` take
        precedence.

        "hopper-long" is short for the preset "long" of hopper, "acrobot-hard" for "hard" of
        acrobot.

        >>> Config.preset("acrobot", agent="dqn").capacity
        50000
        """
        env, _, suffix = env.partition("-") if isinstance(env, str) else (env, "", "")
        name = suffix or name
        environment(env)  # refuses what there is not
        names = [known for known, presets in PRESETS.items() if env in presets]
        if name not in names:
            raise UsageError(f"{env} has no preset {short(name)}; choose one of {', '.join(names)}")
        return cls.from_dict({"env": env} | PRESETS[name][env] | values)

    @classmethod
    def from_dict(cls, values):
        """A config from a mapping such as the one in config.json; UsageError names a field that
        there is not.
        """
        names = [field.name for field in fields(cls)]
        for name in values:
            if name not in names:
                near = difflib.get_close_matches(name, names, 1)
                raise UsageError(
                    f"there is no setting {short(name)}"
                    + (f"; did you mean {near[0]!r}?" if near else "")
                )
        return cls(**values)

    def to_dict(self):
        """Plain JSON types; from_dict(to_dict()) is the same config."""
        return json.loads(json.dumps(asdict(self)))


RECENCY = ("gbdqn", "dqn-recency")  # the agents whose own replay is GB-DQN's
KINDS = {
    int: "a whole number",
    float: "a number",
    str: "a word",
    bool: "true or false",
    tuple: "a list",
}
CHOICES = {
    "env": tuple(ENVIRONMENTS),
    "agent": (
        "gbdqn",
        "dqn",
        "ensemble",
        "reset",
        "sliding",
        "frozen",
        "random",
        "dqn-recency",
        "gbdqn-per",
    ),
    "behaviour": ("epsilon-greedy", "softmax"),
    "replay": (None, "uniform", "proportional", "recency"),
    "normalise": ("batch", None),
    "target": ("live", "frozen"),
    "loss_on": ("alpha_h", "h"),
}
COUNT = ("a whole number from 1 to 10,000,000", lambda n: 1 <= n <= 10_000_000)
FRACTION = ("between 0 and 1", lambda x: 0 <= x <= 1)
POSITIVE = ("a positive finite number", lambda x: isfinite(x) and x > 0)
NOT_NEGATIVE = ("a finite number from 0 on", lambda x: isfinite(x) and x >= 0)
RULES = {
    "seed": ("a whole number from 0 on", lambda n: n >= 0),
    "gamma": ("in [0, 1)", lambda x: 0 <= x < 1),
    "hidden": (
        "a list of widths from 1 to 4096, like [128, 128]",
        lambda widths: all(type(width) is int and 1 <= width <= 4096 for width in widths),
    ),
    "alpha": (
        'a positive number or "closed-form"',
        lambda a: a == "closed-form" or (is_number(a) and a > 0),
    ),
    "members": ("a whole number from 1 to 100", lambda k: 1 <= k <= 100),
    "bootstrap": ("above 0 and at most 1", lambda p: 0 < p <= 1),
    "recency_rate": NOT_NEGATIVE,
    "priority_exponent": NOT_NEGATIVE,
    **dict.fromkeys(
        ("episodes", "batch_size", "learning_starts", "update_every", "gradient_steps"), COUNT
    ),
    **dict.fromkeys(("epsilon_decay_steps", "capacity", "window"), COUNT),
    **dict.fromkeys(("tau", "epsilon_start", "epsilon_end", "is_exponent", "mix"), FRACTION),
    **dict.fromkeys(("lr", "max_grad_norm", "temperature", "priority_offset"), POSITIVE),
}

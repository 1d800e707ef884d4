"""When it drifts: a schedule of regimes by episode, and the wrapper that applies it between
episodes.

    schedule = [{"episode": 150, "gravity": 1.5}, {"episode": 350, "gravity": 1.5, "mass": 1.5},
                {"episode": 450, "reset": True}]

Episodes count from 0. An entry describes its whole regime as factors on the stock constants: what
it does not name is 1. {"reset": True} restores everything. Before the first entry the physics are
the stock ones.
"""

import inspect
from reprlib import repr as short

import gymnasium
from gymnasium.utils import RecordConstructorArgs

from . import UsageError, physics

ENVIRONMENTS = {  # name: (Gymnasium's id, the setter of its physics)
    "cartpole": ("CartPole-v1", physics.set_cartpole),
    "mountaincar": ("MountainCar-v0", physics.set_mountaincar),
    "acrobot": ("gbdqn_ref/Acrobot-v1", physics.set_acrobot),
    "hopper": ("gbdqn_ref/Hopper-v5", physics.set_hopper),
}
MAY_BE_NEGATIVE = {
    "force",
    "torque",
}  # a reversed actuator is a drift, a negative mass is a mistake


def factors_of(name):
    """The names of what can drift in an environment, with 1.0 for each.

    >>> factors_of("mountaincar")
    {'gravity': 1.0, 'force': 1.0}
    """
    _, setter = environment(name)
    return {
        key: 1.0 for key, parameter in inspect.signature(setter).parameters.items() if key != "env"
    }


def describe(factors, separator=", "):
    """What of the physics is not as in the stock ones.

    >>> describe({"gravity": 1.5, "pole_mass": 1.0, "cart_mass": 2.0})
    'gravity × 1.5, cart mass × 2'
    >>> describe({"gravity": 1.0})
    'stock physics'
    """
    changed = [
        f"{name.replace('_', ' ')} × {factor:g}" for name, factor in factors.items() if factor != 1
    ]
    return separator.join(changed) or "stock physics"


def is_number(value):
    """Whether it is an int or a float that a float can hold: not nan, infinite, a bool or 10⁴⁰⁰."""
    return type(value) in (int, float) and -1e300 < value < 1e300


def environment(name):
    """(Gymnasium's id, setter) of a named environment; UsageError if there is none."""
    if name not in ENVIRONMENTS:
        raise UsageError(
            f"unknown environment {short(name)}; choose one of {', '.join(ENVIRONMENTS)}"
        )
    return ENVIRONMENTS[name]


def check_schedule(name, schedule):
    """The schedule as [(episode, factors, event)], the stock regime first; UsageError where it
    makes no sense.
    """
    stock, regimes = factors_of(name), []
    if not isinstance(schedule, (list, tuple)) or not all(
        isinstance(entry, dict) for entry in schedule
    ):
        raise UsageError(
            'schedule must be a list of entries like {"episode": 9, "gravity": 1.5}, not'
            f" {short(schedule)}"
        )
    for entry in schedule:
        factors = {key: value for key, value in entry.items() if key not in ("episode", "reset")}
        episode, reset = entry.get("episode"), entry.get("reset", False)
        if type(episode) is not int or episode < 0:
            raise UsageError(
                f"schedule entry {short(entry)} needs an 'episode', an integer from 0 on"
            )
        if regimes and episode <= regimes[-1][0]:
            raise UsageError(
                f"schedule episodes must increase, but {episode} follows {regimes[-1][0]}"
            )
        if type(reset) is not bool or bool(factors) == reset:
            raise UsageError(
                f"schedule entry {short(entry)} must name factors ({', '.join(stock)}) or say"
                " 'reset': True"
            )
        for key, value in factors.items():
            if key not in stock:
                raise UsageError(
                    f"{name} has no {short(key)} that could drift; it has {', '.join(stock)}"
                )
            if not is_number(value) or value == 0 or value < 0 and key not in MAY_BE_NEGATIVE:
                kind = (
                    "finite number other than 0"
                    if key in MAY_BE_NEGATIVE
                    else "positive finite number"
                )
                raise UsageError(f"schedule factor {key!r} must be a {kind}, not {short(value)}")
        regimes.append((episode, stock | factors, "reset" if reset else "drift"))
    return regimes if regimes and regimes[0][0] == 0 else [(0, stock, None), *regimes]


class DriftWrapper(gymnasium.Wrapper, RecordConstructorArgs):
    """Changes the physics of a named environment between episodes, as its schedule says.

    reset() counts episodes; reset(options={"episode": k}) starts episode k instead. `info` of every
    reset and step carries `regime` (0, 1, …), `factors` (all of them) and `event`: "drift" or
    "reset" in the first episode of a regime, else None. Observations, rewards and time limit stay
    as they are.
    """

    def __init__(self, env, schedule=None):
        schedule = [] if schedule is None else schedule
        id = env.spec.id if env.spec else type(env).__name__
        name = next((name for name, (known, _) in ENVIRONMENTS.items() if known == id), id)
        self.regimes, self._set = check_schedule(name, schedule), environment(name)[1]
        RecordConstructorArgs.__init__(self, schedule=list(schedule))
        super().__init__(env)
        self.episode, self.regime = -1, 0

    def __setstate__(self, state):
        """A copy has its regime's physics: Gymnasium builds MuJoCo's part of it anew, as stock."""
        self.__dict__.update(state)
        self._set(self.env.unwrapped, **self.regimes[self.regime][1])

    def reset(self, *, seed=None, options=None):
        options = dict(options or {})
        self.episode = options.pop("episode", self.episode + 1)
        if type(self.episode) is not int or self.episode < 0:
            raise UsageError(f"episode must be a whole number from 0 on, not {short(self.episode)}")
        self.regime = max(
            i for i, (start, _, _) in enumerate(self.regimes) if start <= self.episode
        )
        self._set(self.env.unwrapped, **self.regimes[self.regime][1])
        s, info = self.env.reset(seed=seed, options=options)
        return s, info | self._info()

    def step(self, action):
        s2, r, terminated, truncated, info = self.env.step(action)
        return s2, r, terminated, truncated, info | self._info()

    def _info(self):
        start, factors, event = self.regimes[self.regime]
        begins = start == self.episode > 0
        return {"regime": self.regime, "factors": dict(factors), "event": event if begins else None}


def make(name, schedule=None, **kwargs):
    """The named environment with its time limit, drifting by the schedule; kwargs go to
    gymnasium.make.

    >>> env = make("cartpole", [{"episode": 1, "length": 4.0}])
    >>> [env.reset(seed=seed)[1]["factors"]["length"] for seed in (0, 1)]
    [1.0, 4.0]
    """
    return DriftWrapper(
        gymnasium.make(environment(name)[0], disable_env_checker=True, **kwargs), schedule
    )

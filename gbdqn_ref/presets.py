"""The settings of the experiments, {preset: {environment: settings}}, on the defaults of Config.

GIVEN has the paper's values. The others are ours: values that the paper leaves open (D13), runs
that suit a laptop (D14), runs long enough to learn (D17), drifts that cost something (D21), and
drifts that recur (D22).
"""

from typing import Any

from .schedule import FACTORS

GIVEN: dict[str, dict[str, Any]] = {
    "acrobot": dict(
        episodes=600,
        gamma=0.99,
        hidden=(128, 128),
        lr=1e-3,
        max_grad_norm=10.0,
        capacity=50_000,
        window=5_000,
        batch_size=64,
        learning_starts=1_000,
        update_every=4,
        tau=0.01,
        epsilon_start=1.0,
        epsilon_end=0.05,
        epsilon_decay_steps=20_000,
    ),
    "mountaincar": dict(episodes=600, gamma=0.99),
    "cartpole": {},  # named in the conclusion, without settings or results
    "hopper": dict(
        episodes=500,
        gamma=0.99,
        hidden=(256, 256),
        lr=3e-4,
        max_grad_norm=10.0,
        capacity=200_000,
        window=50_000,
        batch_size=128,
        learning_starts=5_000,
        update_every=4,
        tau=0.01,
        epsilon_start=1.0,
        epsilon_end=0.05,
        epsilon_decay_steps=100_000,
    ),
}
# In the schedules of `paper`, what drifts and when is the paper's; the factors are ours (D13).
ACROBOT: dict[str, Any] = GIVEN["acrobot"] | dict(
    schedule=[
        {"episode": 150, "gravity": 1.5},
        {"episode": 250, "mass": 1.5},
        {"episode": 350, "gravity": 1.5, "mass": 1.5},
        {"episode": 450, "reset": True},
    ],
)
MOUNTAINCAR: dict[str, Any] = GIVEN["mountaincar"] | dict(
    lr=4e-3,  # with Acrobot's settings nothing is learnt
    update_every=16,
    gradient_steps=8,
    tau=0.02,
    schedule=[
        {"episode": 150, "gravity": 1.3},
        {"episode": 250, "force": 0.8},
        {"episode": 350, "gravity": 1.3, "force": 0.9},
        {"episode": 450, "reset": True},
    ],
)
CARTPOLE: dict[str, Any] = GIVEN["cartpole"] | dict(
    episodes=600,
    lr=2e-4,  # DQN learns CartPole and forgets it; small steps and a long memory help
    update_every=16,
    gradient_steps=16,
    max_grad_norm=1.0,
    capacity=200_000,
    priority_exponent=0.3,
    mix=0.6,
    recency_rate=5e-6,
    epsilon_end=0.02,
    epsilon_decay_steps=5_000,
    schedule=[
        {"episode": 300, "gravity": 3.0},
        {"episode": 375, "length": 2.0},
        {"episode": 450, "gravity": 3.0, "length": 2.0},
        {"episode": 525, "reset": True},
    ],
)
HOPPER: dict[str, Any] = GIVEN["hopper"] | dict(
    mix=0.3,
    recency_rate=1e-4,  # recency draws half at a run's end, at 14,000 transitions
    schedule=[  # the paper's results leave out the friction
        {"episode": 100, "gravity": 1.3},
        {"episode": 200, "mass": 1.3},
        {"episode": 300, "gravity": 1.3, "mass": 1.3, "friction": 0.7},
        {"episode": 400, "reset": True},
    ],
)
PAPER = {"cartpole": CARTPOLE, "mountaincar": MOUNTAINCAR, "acrobot": ACROBOT, "hopper": HOPPER}

# Fewer episodes, with drifts as soon as there is something to forget (D14).
FAST_CARTPOLE: dict[str, Any] = dict(
    episodes=400,
    lr=1e-3,
    update_every=64,
    gradient_steps=32,
    tau=0.02,
    capacity=50_000,
    recency_rate=3e-5,
    schedule=[{"episode": 220, "gravity": 4.0}, {"episode": 320, "reset": True}],
)
FAST_MOUNTAINCAR: dict[str, Any] = dict(
    episodes=400,
    schedule=[{"episode": 250, "gravity": 1.3}, {"episode": 325, "reset": True}],
)
FAST_ACROBOT: dict[str, Any] = dict(
    episodes=250,
    epsilon_decay_steps=10_000,
    schedule=[{"episode": 120, "gravity": 1.5, "mass": 1.5}, {"episode": 190, "reset": True}],
)
FAST_HOPPER: dict[str, Any] = dict(
    episodes=400,
    learning_starts=1_000,
    epsilon_decay_steps=5_000,
    recency_rate=5e-5,
    schedule=[
        {"episode": 250, "gravity": 1.3, "mass": 1.3, "friction": 0.7},
        {"episode": 325, "reset": True},
    ],
)
FAST = {
    "cartpole": CARTPOLE | FAST_CARTPOLE,
    "mountaincar": MOUNTAINCAR | FAST_MOUNTAINCAR,
    "acrobot": ACROBOT | FAST_ACROBOT,
    "hopper": HOPPER | FAST_HOPPER,
}

# The paper's Hopper ends before much is learnt; this one is three times as long (D17).
LONG_HOPPER: dict[str, Any] = dict(
    episodes=1_500,
    learning_starts=1_000,
    epsilon_decay_steps=10_000,
    mix=0.1,
    recency_rate=2e-5,  # spans about a regime; draws half at a run's end, at 180,000
    schedule=[entry | {"episode": 3 * entry["episode"]} for entry in HOPPER["schedule"]],
)
LONG = {"hopper": HOPPER | LONG_HOPPER}

# Drifts that break a fixed policy and can be learnt (D21).
HARD_ACROBOT: dict[str, Any] = dict(
    schedule=[  # cost a fixed policy 100 %, −40 % and 100 % of the gain from random to trained
        {"episode": 150, "torque": -1.0},
        {"episode": 250, "torque": 0.5},
        {"episode": 350, "gravity": 1.5, "torque": -1.0},
        {"episode": 450, "reset": True},
    ],
)
HARD_MOUNTAINCAR: dict[str, Any] = dict(
    schedule=[  # cost 100 %, 22 % and 100 % (seed 0)
        {"episode": 150, "force": -1.0},
        {"episode": 250, "gravity": 0.7},
        {"episode": 350, "gravity": 1.3, "force": -1.3},
        {"episode": 450, "reset": True},
    ],
)
HARD = {"acrobot": ACROBOT | HARD_ACROBOT, "mountaincar": MOUNTAINCAR | HARD_MOUNTAINCAR}


# What a detecting agent charts, and the level that gives at most one false alarm in twenty runs.
DETECTOR: dict[str, dict[str, Any]] = {
    "cartpole": dict(symptom="model", alarm_level=4.5),  # DQN forgets, so its return falls anyway
    "mountaincar": dict(symptom="model", alarm_level=4.5),
    "acrobot": dict(symptom="return", alarm_level=10.0),
    "hopper": dict(symptom="model", alarm_level=5.0),
}


# Physics that recur: each drift costs at least half of the gain and can be learnt (D22).
def _recurring(factors: dict[str, float], *episodes: int) -> list[dict[str, Any]]:
    """A schedule that alternates between these factors and the stock physics."""
    return [
        {"episode": k} | ({"reset": True} if i % 2 else factors) for i, k in enumerate(episodes)
    ]


RECURRING_CARTPOLE: dict[str, Any] = dict(
    episodes=600,
    lr_factor=5.0,  # the small steps are too small for a network that starts anew
    schedule=_recurring({"force": -1.0}, 300, 375, 450, 525),
)
RECURRING_MOUNTAINCAR: dict[str, Any] = dict(
    episodes=650,
    schedule=_recurring({"force": -1.0}, 250, 350, 450, 550),
)
RECURRING_ACROBOT: dict[str, Any] = dict(
    episodes=650,
    schedule=_recurring({"torque": -1.0}, 150, 250, 350, 450, 550),
)
RECURRING_HOPPER: dict[str, Any] = LONG_HOPPER | dict(
    schedule=_recurring({"gravity": 1.3, "mass": 1.3, "friction": 0.7}, 500, 750, 1000, 1250),
)
RECURRING = {
    "cartpole": CARTPOLE | RECURRING_CARTPOLE | DETECTOR["cartpole"],
    "mountaincar": MOUNTAINCAR | RECURRING_MOUNTAINCAR | DETECTOR["mountaincar"],
    "acrobot": ACROBOT | RECURRING_ACROBOT | DETECTOR["acrobot"],
    "hopper": HOPPER | RECURRING_HOPPER | DETECTOR["hopper"],
}


# A control: entries in the same episodes that change nothing.
def _null(env: str, schedule: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{"episode": entry["episode"], FACTORS[env][0]: 1.0} for entry in schedule]


NULL = {
    env: preset | dict(schedule=_null(env, preset["schedule"])) for env, preset in RECURRING.items()
}


# Other factors, regimes of uneven length, and one gradual drift.
def _gradual(factor: str, first: int, values: tuple[float, ...]) -> list[dict[str, Any]]:
    return [{"episode": first + 10 * i, factor: value} for i, value in enumerate(values)]


HELD_OUT_CARTPOLE: dict[str, Any] = dict(
    episodes=620,
    lr_factor=5.0,
    schedule=[
        {"episode": 320, "force": -0.8},
        {"episode": 390, "reset": True},
        *_gradual("length", 440, (1.2, 1.4, 1.6, 1.8, 2.0)),
        {"episode": 530, "force": -0.8, "length": 2.0},
        {"episode": 570, "reset": True},
    ],
)
HELD_OUT_MOUNTAINCAR: dict[str, Any] = dict(
    episodes=650,
    schedule=[
        {"episode": 270, "force": -1.2},
        {"episode": 340, "reset": True},
        *_gradual("gravity", 420, (0.95, 0.9, 0.85, 0.8, 0.75)),
        {"episode": 510, "force": -1.2, "gravity": 0.75},
        {"episode": 590, "reset": True},
    ],
)
HELD_OUT_ACROBOT: dict[str, Any] = dict(
    episodes=650,
    schedule=[
        {"episode": 170, "torque": -0.8},
        {"episode": 230, "reset": True},
        *_gradual("torque", 320, (0.7, 0.4, -0.4, -0.7, -0.9)),
        {"episode": 440, "torque": -0.8, "gravity": 1.5},
        {"episode": 520, "reset": True},
        {"episode": 560, "torque": -0.8},
    ],
)
HELD_OUT = {
    "cartpole": CARTPOLE | HELD_OUT_CARTPOLE | DETECTOR["cartpole"],
    "mountaincar": MOUNTAINCAR | HELD_OUT_MOUNTAINCAR | DETECTOR["mountaincar"],
    "acrobot": ACROBOT | HELD_OUT_ACROBOT | DETECTOR["acrobot"],
}

PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "paper": PAPER,
    "fast": FAST,
    "long": LONG,
    "hard": HARD,
    "recurring": RECURRING,
    "null": NULL,
    "held-out": HELD_OUT,
}
DEVIATION = {"paper": "D13", "fast": "D14", "long": "D17", "hard": "D21"} | dict.fromkeys(
    ("recurring", "null", "held-out"), "D22"
)


def source(env: str, preset: str, name: str, value: object) -> str:
    """Where a preset's value of a setting comes from: "paper", or "ours" with its deviation.

    >>> source("acrobot", "fast", "lr", 1e-3), source("acrobot", "fast", "episodes", 250)
    ('paper', 'ours (D14)')
    """
    given = GIVEN[env]
    if name in given and given[name] == value:
        return "paper"
    changed = PRESETS[preset][env].get(name) != PAPER[env].get(name)
    return f"ours ({DEVIATION[preset if changed else 'paper']})"

"""One dataclass that says everything about a run: what it accepts, what it refuses, and in which
words.
"""

import ast
import inspect
import json
import re
from dataclasses import FrozenInstanceError, fields
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gbdqn_ref import UsageError, config
from gbdqn_ref.config import Config
from gbdqn_ref.dqn import make_replay
from gbdqn_ref.drift import ENVIRONMENTS
from gbdqn_ref.presets import PRESETS
from gbdqn_ref.train import AGENTS

FLOATS = [field.name for field in fields(Config) if field.type is float]
ALL_PRESETS = [(name, env) for name in PRESETS for env in PRESETS[name]]
configs = st.builds(
    Config,
    env=st.sampled_from(sorted(ENVIRONMENTS)),
    agent=st.sampled_from(sorted(AGENTS)),
    seed=st.integers(0, 2**40),
    episodes=st.integers(1, 1000),
    schedule=st.just([{"episode": 3, "gravity": 1.5}, {"episode": 9, "reset": True}]),
    gamma=st.floats(0, 1, exclude_max=True),
    hidden=st.lists(st.integers(1, 64), max_size=3),
    lr=st.floats(1e-9, 1e9),
    mix=st.floats(0, 1),
    replay=st.sampled_from([None, "uniform", "proportional", "recency"]),
    normalise=st.sampled_from(["batch", None]),
    target=st.sampled_from(["live", "frozen"]),
    alpha=st.one_of(st.just("closed-form"), st.floats(1e-9, 1e9), st.integers(1, 9)),
    zero_output=st.booleans(),
)


@settings(max_examples=100, deadline=None)
@given(configs)
def test_a_config_survives_json(a_config):
    values = a_config.to_dict()
    assert Config.from_dict(json.loads(json.dumps(values))) == a_config
    assert Config.from_dict(values).to_dict() == values
    assert set(values) == {field.name for field in fields(Config)}


@pytest.mark.parametrize(("name", "env"), ALL_PRESETS)
@pytest.mark.parametrize("agent", AGENTS)
def test_every_preset_is_a_config_with_a_drift(name, env, agent):
    preset = Config.preset(env, name, agent=agent, seed=3)
    assert (preset.env, preset.agent, preset.seed) == (env, agent, 3)
    assert Config.from_dict(preset.to_dict()) == preset
    assert [entry["episode"] for entry in preset.schedule if entry["episode"] < preset.episodes], (
        "nothing would drift"
    )


def test_every_environment_has_the_presets_paper_and_fast_and_some_have_another():
    presets = {env: [name for name in PRESETS if env in PRESETS[name]] for env in ENVIRONMENTS}
    assert presets == {
        "cartpole": ["paper", "fast"],
        "mountaincar": ["paper", "fast", "hard"],
        "acrobot": ["paper", "fast", "hard"],
        "hopper": ["paper", "fast", "long"],
    }


def test_a_preset_can_be_named_with_its_environment():
    assert (
        Config.preset("hopper-long") == Config.preset("hopper", "long") != Config.preset("hopper")
    )
    assert (
        Config.preset("acrobot-hard", agent="dqn").schedule
        == PRESETS["hard"]["acrobot"]["schedule"]
    )


def test_the_acrobot_preset_has_the_papers_values():
    preset = Config.preset("acrobot")
    paper = dict(
        episodes=600,
        hidden=(128, 128),
        lr=1e-3,
        max_grad_norm=10.0,
        capacity=50_000,
        window=5_000,
        batch_size=64,
        learning_starts=1000,
        update_every=4,
        tau=0.01,
        epsilon_start=1.0,
        epsilon_end=0.05,
        epsilon_decay_steps=20_000,
        gamma=0.99,
        alpha=0.1,
    )
    assert {key: getattr(preset, key) for key in paper} == paper


def test_the_hopper_preset_has_the_papers_values():
    preset = Config.preset("hopper")
    paper = dict(
        episodes=500,
        hidden=(256, 256),
        lr=3e-4,
        max_grad_norm=10.0,
        capacity=200_000,
        batch_size=128,
        learning_starts=5000,
        update_every=4,
        tau=0.01,
        epsilon_start=1.0,
        epsilon_end=0.05,
        epsilon_decay_steps=100_000,
        gamma=0.99,
        alpha=0.1,
        gradient_steps=1,
        behaviour="epsilon-greedy",
    )
    assert {key: getattr(preset, key) for key in paper} == paper
    names = [(entry["episode"], set(entry) - {"episode"}) for entry in preset.schedule]
    assert names == [
        (100, {"gravity"}),
        (200, {"mass"}),
        (300, {"mass", "gravity", "friction"}),
        (400, {"reset"}),
    ]


def test_the_long_hopper_is_the_papers_but_for_its_length_and_what_leaves_time_to_learn():
    paper, long = Config.preset("hopper").to_dict(), Config.preset("hopper", "long").to_dict()
    changed = {key for key in paper if paper[key] != long[key]}
    assert changed == {
        "episodes",
        "schedule",
        "learning_starts",
        "epsilon_decay_steps",
        "mix",
        "recency_rate",
    }
    assert long["episodes"] == 3 * paper["episodes"]
    assert long["schedule"] == [
        entry | {"episode": 3 * entry["episode"]} for entry in paper["schedule"]
    ]


@pytest.mark.parametrize(
    ("name", "n", "priority"),
    [("paper", 14_000, 1.2), ("fast", 30_000, 1.3), ("long", 180_000, 2.5)],
)
def test_recency_has_at_least_a_third_of_the_draws_where_a_run_ends(name, n, priority):
    # transitions and mean p^TD at the end of the runs, as measured
    preset = Config.preset("hopper", name, capacity=n)
    replay = make_replay(preset, 1)
    replay.added = n
    replay.tree.set(np.arange(n), np.full(n, priority))
    assert 1 / 3 < 1 - replay.td_share() < 2 / 3


@pytest.mark.parametrize("env", ["acrobot", "mountaincar"])
def test_the_papers_drifts_come_at_the_papers_episodes(env):
    schedule = Config.preset(env).schedule
    assert [entry["episode"] for entry in schedule] == [150, 250, 350, 450]
    assert schedule[-1] == {"episode": 450, "reset": True}
    assert not any("reset" in entry for entry in schedule[:-1])
    first, second, third = (set(entry) - {"episode"} for entry in schedule[:-1])
    assert third == first | second, "the third drift is the first and the second together"


def test_given_values_take_precedence_over_a_preset():
    assert Config.preset("acrobot", lr=0.5, schedule=[]).to_dict() == Config.preset(
        "acrobot"
    ).to_dict() | {"lr": 0.5, "schedule": []}


@pytest.mark.parametrize("agent", AGENTS)
def test_each_agent_has_its_replay_by_default_and_any_other_on_request(agent):
    assert Config(agent=agent).replay == (
        "recency" if agent in ("gbdqn", "dqn-recency") else "proportional"
    )
    assert Config(agent=agent, replay="uniform").replay == "uniform"


@pytest.mark.parametrize("name", [*FLOATS, "alpha"])
def test_a_whole_number_will_do_for_a_float(name):
    whole = 0 if name == "gamma" else 1
    # also to the byte of config.json, and so that α is a float before and after a drift
    assert json.dumps(Config(**{name: whole}).to_dict()) == json.dumps(
        Config(**{name: float(whole)}).to_dict()
    )


def test_a_list_will_do_for_the_widths():
    assert Config(hidden=[8, 4]) == Config(hidden=(8, 4))
    assert Config(hidden=[]).hidden == ()


@pytest.mark.parametrize("name", [field.name for field in fields(Config)])
def test_a_config_cannot_be_changed(name):
    with pytest.raises(FrozenInstanceError):
        setattr(Config(), name, 1)


def test_the_schedule_of_a_config_is_its_own():
    schedule = [{"episode": 1, "gravity": 2.0}]
    a_config = Config(schedule=schedule)
    schedule[0]["gravity"] = 3.0
    assert a_config.schedule == [{"episode": 1, "gravity": 2.0}]
    before = json.dumps(PRESETS)
    Config.preset("acrobot").schedule[0]["gravity"] = 9.0
    Config.preset("acrobot").to_dict()["schedule"].clear()
    assert json.dumps(PRESETS) == before


def test_every_field_is_followed_by_a_sentence_about_it():
    tree = ast.parse(inspect.getsource(config))
    (body,) = (
        node.body for node in tree.body if isinstance(node, ast.ClassDef) and node.name == "Config"
    )
    named = [i for i, node in enumerate(body) if isinstance(node, ast.AnnAssign)]
    assert [body[i].target.id for i in named] == [field.name for field in fields(Config)]
    for i in named:
        sentence = ast.literal_eval(body[i + 1].value)
        assert isinstance(sentence, str) and len(sentence) > 10 and sentence.endswith("."), body[
            i
        ].target.id


BAD = [
    *(("env", value) for value in ("cart", "", None, 3, "CartPole-v1")),
    *(("agent", value) for value in ("ppo", "", None, 3, "DQN")),
    *(("seed", value) for value in (-1, 1.0, "0", None, True, nan)),
    *(("schedule", value) for value in (None, 5, "x", {"episode": 1}, [5], [{"episode": 1}])),
    *(
        ("schedule", [{"episode": 1, key: value}])
        for key, value in (("wind", 2.0), ("gravity", 0), ("gravity", nan))
    ),
    *(("gamma", value) for value in (1, 1.5, -0.1, nan, inf, "0.9", None, False)),
    *(
        ("hidden", value)
        for value in (128, "128", None, [0], [-3], [1.5], ["8"], [True], [8, None], [4097], [[8]])
    ),
    *(("behaviour", value) for value in ("greedy", "", None, 1)),
    *(("replay", value) for value in ("none", "", 1, False, ["recency"])),
    *(("normalise", value) for value in ("max", "", 1, True)),
    *(("target", value) for value in ("half", None, True)),
    *(("alpha", value) for value in (0, -1, nan, inf, "closed", "0.1", None, True, [0.1], 10**400)),
    *(("loss_on", value) for value in ("alpha", None, 1)),
    *(("members", value) for value in (0, -1, 101, 2.0, nan, "5", None, True)),
    *(("bootstrap", value) for value in (0, 0.0, -0.5, 1.01, nan, inf, "1", None, True)),
    *(("zero_output", value) for value in (1, 0, "yes", None)),
    *(
        (name, value)
        for name in (
            "episodes",
            "batch_size",
            "learning_starts",
            "update_every",
            "gradient_steps",
        )
        + ("epsilon_decay_steps", "capacity", "window")
        for value in (0, -1, 1.5, 2.0, nan, inf, "9", None, True, 10**20)
    ),
    *(
        (name, value)
        for name in ("tau", "epsilon_start", "epsilon_end", "is_exponent", "mix")
        for value in (-0.01, 1.01, nan, inf, "0.5", None, True)
    ),
    *(
        (name, value)
        for name in ("lr", "max_grad_norm", "temperature", "priority_offset")
        for value in (0, 0.0, -1e-9, nan, inf, "1", None, True, [1.0], 10**400)
    ),
    *(
        (name, value)
        for name in ("recency_rate", "priority_exponent")
        for value in (-1e-9, nan, inf, -inf, "1", None, True)
    ),
]


@pytest.mark.parametrize(("name", "value"), BAD, ids=lambda part: repr(part)[:30])
def test_a_bad_value_is_refused_in_one_line_that_names_the_field(name, value):
    with pytest.raises(UsageError) as caught:
        Config(**{name: value})
    message = str(caught.value)
    assert "\n" not in message
    assert re.search({"schedule": "schedule|could drift"}.get(name, name), message)
    if name not in ("schedule", "hidden") and value != 10**400:
        assert repr(value) in message, "the message shows what was given"


def test_every_field_has_bad_values_in_this_file():
    assert {name for name, _ in BAD} == {field.name for field in fields(Config)}


@pytest.mark.parametrize(
    ("name", "meant"),
    [("epsiodes", "episodes"), ("batchsize", "batch_size"), ("Gamma", "gamma"), ("seeds", "seed")],
)
def test_an_unknown_setting_is_refused_with_the_one_that_was_meant(name, meant):
    with pytest.raises(UsageError, match=f"no setting '{name}'; did you mean '{meant}'"):
        Config.from_dict({name: 1})


def test_an_unknown_setting_like_no_other_is_refused_without_a_guess():
    with pytest.raises(UsageError, match=r"^there is no setting 'xyzzy'$"):
        Config.from_dict({"xyzzy": 1})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("cart",),
            "unknown environment 'cart'; choose one of cartpole, mountaincar, acrobot, hopper$",
        ),
        (("acrobot", "slow"), "acrobot has no preset 'slow'; choose one of paper, fast, hard$"),
        (("acrobot", "long"), "acrobot has no preset 'long'; choose one of paper, fast, hard$"),
        (("hopper", "slow"), "hopper has no preset 'slow'; choose one of paper, fast, long$"),
        (
            ("hopper", ["long"]),
            r"hopper has no preset \['long'\]; choose one of paper, fast, long$",
        ),
    ],
)
def test_an_unknown_preset_is_refused_with_the_known_ones(arguments, message):
    with pytest.raises(UsageError, match=message):
        Config.preset(*arguments)


def test_a_choice_is_refused_with_all_that_there_are():
    with pytest.raises(UsageError, match="unknown target 'half'; choose one of live, frozen"):
        Config(target="half")

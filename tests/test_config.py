"""Config, the dataclass of all settings of a run: what it accepts and what it refuses."""

import ast
import inspect
import json
from dataclasses import FrozenInstanceError, fields, replace
from math import nan
from types import NoneType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gbdqn_ref import UsageError, config
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import SETTINGS, Config
from gbdqn_ref.dqn import make_replay
from gbdqn_ref.presets import PRESETS, source
from gbdqn_ref.schedule import FACTORS, stock

FLOATS = [name for name, (kinds, _) in SETTINGS.items() if kinds == (float,)]
ALL_PRESETS = [(name, env) for name in PRESETS for env in PRESETS[name]]
configs = st.builds(
    Config,
    env=st.sampled_from(sorted(FACTORS)),
    agent=st.sampled_from(sorted(AGENTS)),
    seed=st.integers(0, 2**32 - 1),
    episodes=st.integers(1, 1000),
    schedule=st.just([{"episode": 3, "gravity": 1.5}, {"episode": 9, "reset": True}]),
    gamma=st.floats(0, 1, exclude_max=True),
    hidden=st.lists(st.integers(1, 64), max_size=3),
    lr=st.floats(1e-9, 1e9),
    mix=st.floats(0, 1),
    replay=st.sampled_from([None, "uniform", "proportional", "recency"]),
    normalise=st.sampled_from(["batch", None]),
    target=st.sampled_from(["live", "frozen"]),
    alpha=st.one_of(st.just("closed-form"), st.floats(1e-9, 1e6), st.integers(1, 9)),
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
def test_every_preset_is_a_valid_config_with_a_drift(name, env, agent):
    preset = Config.preset(env, name, agent=agent, seed=3)
    assert (preset.env, preset.agent, preset.seed) == (env, agent, 3)
    assert Config.from_dict(preset.to_dict()) == preset
    assert any(entry["episode"] < preset.episodes for entry in preset.schedule)


def test_every_environment_has_exactly_these_presets():
    presets = {env: [name for name in PRESETS if env in PRESETS[name]] for env in FACTORS}
    assert presets == {
        "cartpole": ["paper", "fast", "recurring", "null", "held-out"],
        "mountaincar": ["paper", "fast", "hard", "recurring", "null", "held-out"],
        "acrobot": ["paper", "fast", "hard", "recurring", "null", "held-out"],
        "hopper": ["paper", "fast", "long", "recurring", "null"],
    }


@pytest.mark.parametrize("env", FACTORS)
def test_recurring_returns_to_the_same_physics_and_null_never_changes_them(env):
    recurring, null = Config.preset(env, "recurring"), Config.preset(env, "null")
    starts = [[regime.start for regime in each.regimes] for each in (recurring, null)]
    assert starts[0] == starts[1] and len(starts[0]) >= 5
    drifted = [regime.factors for regime in recurring.regimes if regime.event == "drift"]
    assert all(factors == drifted[0] != stock(env) for factors in drifted)
    events = [regime.event for regime in recurring.regimes[1:]]
    assert events == [("drift", "reset")[k % 2] for k in range(len(events))]
    assert [regime.event for regime in null.regimes[1:]] == ["drift"] * (len(starts[1]) - 1)
    assert not any(regime.drifted for regime in null.regimes)
    assert recurring == replace(null, schedule=recurring.schedule)


@pytest.mark.parametrize("env", sorted(PRESETS["held-out"]))
def test_the_held_out_schedule_has_new_factors_and_a_gradual_drift(env):
    recurring, held = Config.preset(env, "recurring"), Config.preset(env, "held-out")
    known = {entry["episode"] for entry in recurring.schedule}
    assert known.isdisjoint(r.start for r in held.regimes if r.end - r.start != 10 and r.start)
    (drifted,) = {tuple(r.factors.items()) for r in recurring.regimes if r.event == "drift"}
    assert dict(drifted) not in [regime.factors for regime in held.regimes]
    lengths = [regime.end - regime.start for regime in held.regimes]
    assert lengths.count(10) == 4 and len(set(lengths)) > 4


def test_an_environments_name_can_include_its_preset():
    long = Config.preset("hopper", "long")
    assert Config.preset("hopper-long") == long != Config.preset("hopper")
    hard = Config.preset("acrobot", "hard", agent="dqn")
    assert Config.preset("acrobot-hard", agent="dqn") == hard


BOTH = dict(max_grad_norm=10.0, update_every=4, tau=0.01, gamma=0.99, alpha=0.1)
BOTH |= dict(epsilon_start=1.0, epsilon_end=0.05, gradient_steps=1, behaviour="epsilon-greedy")
PAPER = {
    "acrobot": BOTH
    | dict(episodes=600, hidden=(128, 128), lr=1e-3, batch_size=64, learning_starts=1000)
    | dict(capacity=50_000, window=5_000, epsilon_decay_steps=20_000),
    "hopper": BOTH
    | dict(episodes=500, hidden=(256, 256), lr=3e-4, batch_size=128, learning_starts=5000)
    | dict(capacity=200_000, epsilon_decay_steps=100_000),
}


@pytest.mark.parametrize("env", PAPER)
def test_the_preset_has_the_papers_values(env):
    resolved = Config.preset(env).resolved()
    assert {key: getattr(resolved, key) for key in PAPER[env]} == PAPER[env]


def test_the_hoppers_drifts_change_the_papers_constants():
    schedule = Config.preset("hopper").schedule
    assert [entry["episode"] for entry in schedule] == [100, 200, 300, 400]
    changed = [set(entry) - {"episode"} for entry in schedule]
    assert changed == [{"gravity"}, {"mass"}, {"mass", "gravity", "friction"}, {"reset"}]


def test_the_long_hopper_differs_from_the_papers_only_in_length_and_warm_up():
    paper, long = Config.preset("hopper").to_dict(), Config.preset("hopper", "long").to_dict()
    changed = {key for key in paper if paper[key] != long[key]}
    warm_up = {"learning_starts", "epsilon_decay_steps", "mix", "recency_rate"}
    assert changed == {"episodes", "schedule"} | warm_up
    assert long["episodes"] == 3 * paper["episodes"]
    tripled = [entry | {"episode": 3 * entry["episode"]} for entry in paper["schedule"]]
    assert long["schedule"] == tripled


@pytest.mark.parametrize(
    ("name", "n", "priority"),
    [("paper", 14_000, 1.2), ("fast", 30_000, 1.3), ("long", 180_000, 2.5)],
)
def test_recency_has_over_a_third_of_the_draws_at_the_end_of_a_run(name, n, priority):
    """n and priority: transitions and mean p^TD measured at the end of such runs."""
    preset = Config.preset("hopper", name, capacity=n)
    replay = make_replay(preset.resolved(), 1)
    replay.added = n
    replay.tree.set(np.arange(n), np.full(n, priority))
    assert 1 / 3 < 1 - replay.td_share() < 2 / 3


@pytest.mark.parametrize("env", ["acrobot", "mountaincar"])
def test_drifts_come_at_the_papers_episodes(env):
    schedule = Config.preset(env).schedule
    assert [entry["episode"] for entry in schedule] == [150, 250, 350, 450]
    assert schedule[-1] == {"episode": 450, "reset": True}
    assert not any("reset" in entry for entry in schedule[:-1])
    first, second, third = (set(entry) - {"episode"} for entry in schedule[:-1])
    assert third == first | second, "the third drift is the first and the second together"


def test_given_values_override_a_preset():
    given = {"lr": 0.5, "schedule": []}
    preset = Config.preset("acrobot").to_dict()
    assert Config.preset("acrobot", **given).to_dict() == preset | given


@pytest.mark.parametrize("agent", AGENTS)
def test_each_agent_has_a_default_replay_that_can_be_overridden(agent):
    own = "recency" if agent in ("gbdqn", "dqn-recency") else "proportional"
    assert Config(agent=agent).resolved().replay == own
    assert Config(agent=agent, replay="uniform").resolved().replay == "uniform"


@pytest.mark.parametrize("name", [*FLOATS, "alpha"])
def test_a_whole_number_is_accepted_as_a_float(name):
    """config.json has the same bytes, and α is a float before and after a drift."""
    whole = 0 if name == "gamma" else 1
    configs = [Config(**{name: value}) for value in (whole, float(whole))]
    assert len({json.dumps(each.to_dict()) for each in configs}) == 1


def test_a_list_is_accepted_for_the_widths():
    assert Config(hidden=[8, 4]) == Config(hidden=(8, 4))
    assert Config(hidden=[]).hidden == ()


@pytest.mark.parametrize("name", [field.name for field in fields(Config)])
def test_a_config_cannot_be_changed(name):
    with pytest.raises(FrozenInstanceError):
        setattr(Config(), name, 1)


def test_a_config_copies_its_schedule():
    schedule = [{"episode": 1, "gravity": 2.0}]
    a_config = Config(schedule=schedule)
    schedule[0]["gravity"] = 3.0
    assert a_config.schedule == [{"episode": 1, "gravity": 2.0}]
    before = json.dumps(PRESETS)
    Config.preset("acrobot").schedule[0]["gravity"] = 9.0
    Config.preset("acrobot").to_dict()["schedule"].clear()
    assert json.dumps(PRESETS) == before


def test_every_field_is_followed_by_its_description():
    tree = ast.parse(inspect.getsource(config))
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    body = classes["Config"].body
    named = [i for i, node in enumerate(body) if isinstance(node, ast.AnnAssign)]
    assert [body[i].target.id for i in named] == [field.name for field in fields(Config)]
    for i in named:
        sentence, field = ast.literal_eval(body[i + 1].value), body[i].target.id
        assert isinstance(sentence, str) and len(sentence) > 10 and sentence.endswith("."), field


WRONG = {  # values of a wrong type, by the right types
    (str,): (None, 3, True, ["dqn"]),
    (str, NoneType): (1, False, ["recency"]),
    (int,): (1.5, 2.0, nan, "9", None, True, [1]),
    (float,): ("0.5", None, True, [1.0], 10**400, nan),
    (float, NoneType): ("0.5", True, [1.0], nan),
    (float, str, NoneType): (True, [0.1], 10**400, nan),
    (bool, NoneType): (1, 0, "yes"),
    (str, list, NoneType): (5, True, {"episode": 1}),
    (tuple,): (128, "128", None),
    (list,): (None, 5, "x", {"episode": 1}),
}
BAD = [
    (name, value)
    for name, (kinds, rule) in SETTINGS.items()
    for value in (*WRONG[kinds], *rule.breaks)
]


@pytest.mark.parametrize(("name", "value"), BAD, ids=lambda part: repr(part)[:30])
def test_a_bad_value_is_refused_in_one_line_that_names_the_field(name, value):
    with pytest.raises(UsageError) as caught:
        Config(**{name: value})
    message = str(caught.value)
    assert "\n" not in message
    assert name in message
    if name not in ("schedule", "hidden") and value != 10**400:
        assert repr(value) in message, "the message shows the given value"


EDGES = {  # the values at the limits
    "seed": (0, 2**32 - 1),
    "gamma": (0.0, 0.999),
    "hidden": ((1, 4096), ()),
    "replay": (None, "uniform", "proportional", "recency"),
    "normalise": ("batch", None),
    "alpha": (1e-9, 1e6, "closed-form", None),
    "keep_data": (0.0, 1.0, None),
    "drift_signal": ("schedule", "detector", [], [0, 3], None),
    "symptom": ("return", "td_error", "model"),
    "members": (1, 100),
    "max_grad_norm": (1e-9, 1e6),
    "bootstrap": (1e-9, 1.0),
    **dict.fromkeys(("episodes", "batch_size", "capacity", "window"), (1, 10_000_000)),
    **dict.fromkeys(("tau", "epsilon_start", "epsilon_end", "is_exponent", "mix"), (0.0, 1.0)),
    **dict.fromkeys(("lr", "temperature", "priority_offset"), (1e-9, 1e9)),
    **dict.fromkeys(("recency_rate", "priority_exponent"), (0.0, 1e9)),
}


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in EDGES.items() for value in values]
)
def test_values_at_the_limits_are_accepted(name, value):
    assert getattr(Config(**{name: value}), name) == value


@pytest.mark.parametrize("name", SETTINGS)
def test_every_field_has_a_rule_and_a_value_that_breaks_it(name):
    kinds, rule = SETTINGS[name]
    assert rule.words and (rule.breaks or kinds == (bool, NoneType))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lr", np.float64(0.5)),
        ("lr", np.float32(0.5)),
        ("lr", np.int64(2)),
        ("seed", np.int64(7)),
        ("keep_adam", np.bool_(False)),
        ("hidden", (np.int64(8), np.int32(4))),
        ("schedule", [{"episode": np.int64(3), "gravity": np.float64(2.0)}]),
    ],
)
def test_numpy_numbers_are_accepted(name, value):
    a_config = Config(**{name: value})
    assert getattr(a_config, name) == value
    assert Config.from_dict(json.loads(json.dumps(a_config.to_dict()))) == a_config


def test_an_agents_default_follows_a_change_of_agent():
    """Otherwise "dqn" would train on GB-DQN's replay."""
    gbdqn = Config.preset("acrobot", agent="gbdqn")
    assert (gbdqn.replay, gbdqn.resolved().replay) == (None, "recency")
    for dqn in (replace(gbdqn, agent="dqn"), Config.from_dict(gbdqn.to_dict() | {"agent": "dqn"})):
        assert dqn.resolved().replay == "proportional"
    chosen = replace(gbdqn, replay="uniform", agent="dqn")
    assert chosen.resolved().replay == "uniform"


def test_a_resolved_config_has_nothing_left_to_resolve():
    resolved = Config(agent="gbdqn").resolved()
    assert resolved.resolved() == resolved != Config(agent="gbdqn")


def test_equal_configs_have_equal_hashes():
    one, same, other = Config(hidden=[8]), Config(hidden=(8,)), Config(hidden=[9])
    assert len({one, same, other}) == 2


def test_the_environment_of_a_preset_is_not_replaced_by_another():
    with pytest.raises(UsageError, match="for mountaincar, so env cannot be 'cartpole'"):
        Config.preset("mountaincar", env="cartpole")


@pytest.mark.parametrize("name", ["fast", "paper"])
def test_an_environment_named_with_its_preset_takes_no_other_preset(name):
    with pytest.raises(UsageError, match=f"names the preset hard, so it cannot be '{name}'"):
        Config.preset("acrobot-hard", name)
    assert Config.preset("acrobot-hard", "hard") == Config.preset("acrobot-hard")


@pytest.mark.parametrize("values", [None, [], "dqn", 5, [["lr", 0.1]]])
def test_settings_that_are_not_a_mapping_are_refused(values):
    with pytest.raises(UsageError, match="settings must be a mapping"):
        Config.from_dict(values)


def test_the_source_of_a_value_is_the_paper_or_a_deviation():
    assert source("acrobot", "paper", "lr", 1e-3) == "paper"
    assert source("acrobot", "paper", "lr", 2e-3) == "ours (D13)"
    assert source("mountaincar", "paper", "lr", 4e-3) == "ours (D13)"
    assert source("acrobot", "fast", "episodes", 250) == "ours (D14)"
    assert source("hopper", "long", "mix", 0.1) == "ours (D17)"
    assert source("acrobot", "hard", "schedule", []) == "ours (D21)"
    assert source("acrobot", "hard", "gamma", 0.99) == "paper"


@pytest.mark.parametrize(
    ("name", "meant"),
    [("epsiodes", "episodes"), ("batchsize", "batch_size"), ("Gamma", "gamma"), ("seeds", "seed")],
)
def test_an_unknown_setting_is_refused_with_a_suggestion(name, meant):
    with pytest.raises(UsageError, match=f"no setting '{name}'; did you mean '{meant}'"):
        Config.from_dict({name: 1})


def test_an_unknown_setting_unlike_all_others_gets_no_suggestion():
    with pytest.raises(UsageError, match=r"^there is no setting 'xyzzy'$"):
        Config.from_dict({"xyzzy": 1})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("cart",),
            "unknown environment 'cart'; choose one of cartpole, mountaincar, acrobot, hopper$",
        ),
        (
            ("acrobot", "slow"),
            "acrobot has no preset 'slow'; choose one of paper, fast, hard, recurring, ",
        ),
        (
            ("acrobot-",),
            "acrobot has no preset ''; choose one of paper, fast, hard, recurring, ",
        ),
        (
            ("acrobot", "long"),
            "acrobot has no preset 'long'; choose one of paper, fast, hard, recurring, ",
        ),
        (
            ("hopper", "slow"),
            "hopper has no preset 'slow'; choose one of paper, fast, long, recurring, null$",
        ),
        (
            ("hopper", ["long"]),
            r"hopper has no preset \['long'\]; choose one of paper, fast, long, recurring, null$",
        ),
    ],
)
def test_an_unknown_preset_is_refused_with_the_known_ones(arguments, message):
    with pytest.raises(UsageError, match=message):
        Config.preset(*arguments)


def test_a_wrong_choice_is_refused_with_the_valid_ones():
    with pytest.raises(UsageError, match=r"^target must be one of live, frozen, not 'half'$"):
        Config(target="half")

"""The protocol of the study: what it refuses, and its error rate and power by simulation."""

import sys
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gbdqn_ref import UsageError, stats
from gbdqn_ref.config import Config

sys.path.append(str(Path(__file__).parents[1] / "benchmarks" / "keep"))
from protocol import FILE, Protocol, primary, random_alarms, settings_hash
from study import settings, tuned

BASES = "acrobot", "mountaincar", "cartpole"
METHODS = Protocol().content["tuning"]["methods"]


@pytest.fixture(scope="module")
def protocol():
    return Protocol()


TUNED = {task: {method: {} for method in METHODS} for task in BASES}


@pytest.fixture(scope="module")
def reporting():
    """The protocol after a tuning that chose every preset's own values."""
    return Protocol(tuned=TUNED)


LENGTHS = {"regimes": 6, "first": 5, "recovery": 5, "calm": 5}  # of Acrobot's five events


def row(protocol, **values):
    named = {"task": "acrobot", "arm": "dqn", "seed": 2000, "code": "a"} | values
    try:
        settings = settings_hash(protocol.reported(named["task"], named["arm"], named["seed"]))
    except UsageError:
        settings = ""
    figures = {name: [0.0] * n for name, n in LENGTHS.items()}
    return {"settings": settings, "evaluation": [[0.0] * 6] * 6} | figures | named


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (dict(task="pong"), "no task 'pong'"),
        (dict(arm="sarsa"), "no arm 'sarsa'"),
        (dict(task="cartpole", arm="dqn-random"), "in no part of the study that cartpole is in"),
        (dict(seed=1999), "seeds to report are 2000 to 2099, not 1999"),
        (dict(seed=2100), "not 2100"),
    ],
)
def test_a_row_that_is_not_in_the_protocol_is_refused(reporting, values, message):
    rows = [row(reporting), row(reporting, seed=2001), row(reporting, **values)]
    with pytest.raises(UsageError, match=message):
        reporting.check_rows(rows)


def test_a_run_counts_once_and_an_arm_has_one_version_of_the_code(reporting):
    first, second = row(reporting), row(reporting, seed=2001)
    with pytest.raises(UsageError, match="counted twice"):
        reporting.check_rows([first, second, first])
    with pytest.raises(UsageError, match="made by code b, not a"):
        reporting.check_rows([first, second | {"code": "b"}])
    last = row(reporting, seed=2099)
    reporting.check_rows([first, last, row(reporting, arm="sliding", code="b")])


@pytest.mark.parametrize("name", [*LENGTHS, "evaluation"])
def test_a_row_has_a_figure_for_each_regime(reporting, name):
    whole = row(reporting)
    with pytest.raises(UsageError, match="has not one figure for each of its 6 regimes"):
        reporting.check_rows([whole | {name: whole[name][:-1]}])
    reporting.check_rows([whole, row(reporting, seed=2001) | {"evaluation": []}])


def test_a_run_is_reported_with_the_settings_that_tuning_chose(reporting):
    """Without a drift and on the held-out schedule too, where nothing is tuned."""
    with pytest.raises(UsageError, match="acrobot-null is reported after acrobot is tuned"):
        Protocol().reported("acrobot-null", "dqn-drop", 2000)
    tuned = Protocol(tuned=TUNED | {"acrobot": TUNED["acrobot"] | {"dqn-drop": {"lr": 0.25}}})
    for task in ("acrobot", "acrobot-null", "acrobot-held-out"):
        assert tuned.reported(task, "dqn-drop", 2000).lr == 0.25
        assert tuned.reported(task, "reuse", 2000).lr == 0.001
    assert tuned.reported("mountaincar", "dqn-drop", 2000).lr == 0.004
    with pytest.raises(UsageError, match="made with other settings"):
        tuned.check_rows([row(reporting)])


def test_an_arm_of_no_method_that_is_tuned_has_the_presets_settings():
    """As all arms of the exploratory protocol on Hopper do, in which nothing is tested."""
    hopper = Protocol(FILE.with_name("hopper.toml"))
    assert not hopper.hypotheses and hopper.method == {}
    for arm in hopper.arms:
        config = hopper.reported("hopper", arm, 100)
        assert config.lr == Config.preset("hopper", "recurring").lr
    with pytest.raises(UsageError, match="100 to 109, not 2000"):
        hopper.reported("hopper", "dqn", 2000)


@pytest.mark.parametrize(("purpose", "seed"), [("tune", 999), ("tune", 1020), ("explore", 200)])
def test_each_seed_serves_one_purpose(protocol, purpose, seed):
    with pytest.raises(UsageError, match=f"seeds to {purpose} are"):
        protocol.config("acrobot", "dqn", seed, purpose)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('arm = "reuse-told"', 'arm = "reuse-tld"', "no arm 'reuse-tld'"),
        ('tasks = ["mountaincar"]', 'tasks = ["hopper"]', "no task 'hopper'"),
        ('    "dqn", "sliding"', '    "dqn", "slidng"', "no arm 'slidng'"),
        ('on = "sliding"', 'on = "slidng"', "no arm 'slidng'"),
        ('tuned_on = "acrobot"', 'tuned_on = "acrobat"', "no task 'acrobat'"),
        ('id = "H2"', 'id = "H1"', "each once"),
        ("report = [2000, 2099]", "", "has no 'report'"),
        ("report = [2000, 2099]", "report = [2000]", "a first and a last one"),
        ("seeds = [20, 30, 40]", "seeds = [20, 10]", "looks at more and more seeds"),
        ("seeds = [20, 30, 40]", "seeds = [0, 20]", "looks at more and more seeds"),
        ("seeds = [20, 30, 40]", "seeds = []", "looks at more and more seeds"),
        ("margin = 10.0", "margin = nan", "not a finite number"),
        ('against = ["dqn-drop", "dqn-drop-adam"]', "against = []", "an arm to be ahead of"),
    ],
)
def test_a_protocol_that_names_or_decides_nothing_is_refused(tmp_path, old, new, message):
    text = FILE.read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "protocol.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(UsageError, match=message):
        Protocol(tmp_path / "protocol.toml")


def test_the_reported_seeds_suffice_for_the_looks_and_seed_ranges_are_disjoint(protocol):
    low, high = protocol.seeds["report"]
    assert max(protocol.looks["seeds"]) <= high - low + 1
    ranges = sorted(map(tuple, protocol.seeds.values()))
    assert all(before[1] < after[0] for before, after in pairwise(ranges))


def test_each_arm_has_its_settings(protocol):
    told = protocol.config("acrobot", "reuse-told", 2000).resolved()
    assert (told.agent, told.drift_signal) == ("gbdqn-reuse", "schedule")
    assert (told.keep_data, told.alpha) == (0.0, 1.0)
    twin = protocol.config("acrobot", "twin", 2000).resolved()
    assert (twin.warm_start, twin.zero_output, twin.keep_adam) == (True, False, True)
    dqn = protocol.config("mountaincar", "dqn", 2000, lr=0.5).resolved()
    assert (dqn.lr, dqn.keep_data, dqn.replay) == (0.5, 1.0, "proportional")
    plain = protocol.config("mountaincar", "plasticity", 2000, alpha=0.5).resolved()
    assert plain.alpha == 1.0, "tuning does not change a setting that defines an arm"


def test_there_are_as_many_random_alarms_as_drifts_and_none_before_the_first(protocol):
    config = protocol.config("acrobot", "dqn", 2003)
    alarms = random_alarms(config)
    assert len(alarms) == len(set(alarms)) == 5
    assert alarms == sorted(alarms) == random_alarms(config)
    assert min(alarms) >= 150 and max(alarms) < 650
    other = random_alarms(protocol.config("acrobot", "dqn", 2004))
    assert other != alarms
    assert protocol.config("acrobot", "dqn-random", 2003).drift_signal == alarms


def test_the_primary_metric_starts_at_the_first_event(protocol):
    config = protocol.config("acrobot", "dqn", 2000)
    records = [{"return": -500.0 if k < 150 else -100.0} for k in range(650)]
    assert primary(records, config) == -100.0


def test_every_method_gets_the_same_tuning_budget(protocol):
    """Equally many settings, with the preset's value in the middle of each range."""
    methods = protocol.content["tuning"]["methods"]
    arms = [arm for method in methods.values() for arm in method["arms"]]
    assert sorted(arms) == sorted(protocol.arms), "each arm is tuned by one method"
    for method in methods:
        tried = settings(protocol, method, 1000, 400)
        assert len(tried) == 400 and tried == settings(protocol, method, 1000, 400)
        for name in set(tried[0]) - {"epsilon_restart"}:
            logs = np.log([each[name] for each in tried])
            assert abs(np.median(logs)) < 0.25 * logs.max() and abs(logs.min() + logs.max()) < 0.1


def test_factors_become_settings(protocol):
    config = protocol.config("acrobot", "sliding", 1000, "tune")
    values = tuned(config, dict(lr=2.0, window=0.5, epsilon_restart=0.1))
    assert values == dict(lr=0.002, window=2500, epsilon_restart=0.1)


# --- its level and power in simulated studies -----------------------------------------------------


def simulated(protocol, effect, rng):
    """{(task, arm): returns of 40 seeds}; the reuse agents are better by the effect."""
    arms = {
        (task, arm)
        for each in protocol.hypotheses
        for task in each["tasks"]
        for arm in [each["arm"], *each["against"]]
    }
    return {
        (task, arm): rng.normal(effect if arm.startswith("reuse") else 0.0, 7.0, size=40)
        for task, arm in sorted(arms)
    }


def test_a_study_without_effects_rarely_finds_one(monkeypatch):
    """With equal arms and margin 0 at most 5 % of the studies decide a hypothesis."""
    quick(monkeypatch)
    null, rng, studies = Protocol(), np.random.default_rng(0), 120
    null.hypotheses = [each | {"margin": 0.0} for each in null.hypotheses]
    wrong = sum(
        any(null.decisions(simulated(null, 0.0, rng), rng).values()) for _ in range(studies)
    )
    assert wrong <= 0.05 * studies + 2 * np.sqrt(0.05 * 0.95 * studies)


def test_a_large_effect_is_found_at_the_first_look(protocol, monkeypatch):
    """30 exceeds the largest margin by 20, twice the spread of a paired difference."""
    quick(monkeypatch)
    rng = np.random.default_rng(1)
    looks = [protocol.decisions(simulated(protocol, 30.0, rng), rng) for _ in range(5)]
    assert all(set(each.values()) == {20} for each in looks)


def quick(monkeypatch):
    """Make fewer sign flips, enough for the smallest p that a look needs."""
    monkeypatch.setattr(stats, "sign_flip_test", partial(stats.sign_flip_test, flips=1500))

"""The protocol of the study: what it refuses, and how often it is wrong where nothing is there."""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gbdqn_ref import UsageError, stats

sys.path.append(str(Path(__file__).parents[1] / "benchmarks" / "keep"))
from protocol import FILE, Protocol, primary, random_alarms
from study import settings, tuned


@pytest.fixture(scope="module")
def protocol():
    return Protocol()


def row(**values):
    return {"task": "acrobot", "arm": "dqn", "seed": 2000, "code": "a"} | values


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
def test_a_row_that_is_not_in_the_protocol_is_refused(protocol, values, message):
    with pytest.raises(UsageError, match=message):
        protocol.check_rows([row(), row(seed=2001), row(**values)])


def test_a_run_counts_once_and_an_arm_is_one_code(protocol):
    with pytest.raises(UsageError, match="counted twice"):
        protocol.check_rows([row(), row(seed=2001), row()])
    with pytest.raises(UsageError, match="made by code b, not a"):
        protocol.check_rows([row(), row(seed=2001, code="b")])
    protocol.check_rows([row(), row(seed=2099), row(arm="sliding", code="b")])


@pytest.mark.parametrize(("purpose", "seed"), [("tune", 999), ("tune", 1020), ("explore", 200)])
def test_seeds_are_for_one_purpose(protocol, purpose, seed):
    with pytest.raises(UsageError, match=f"seeds to {purpose} are"):
        protocol.config("acrobot", "dqn", seed, purpose)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('arm = "reuse-told"', 'arm = "reuse-tld"', "no arm 'reuse-tld'"),
        ('tasks = ["mountaincar"]', 'tasks = ["hopper"]', "no task 'hopper'"),
        ('id = "H2"', 'id = "H1"', "each once"),
    ],
)
def test_a_protocol_that_names_what_it_has_not_is_refused(tmp_path, old, new, message):
    text = FILE.read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "protocol.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(UsageError, match=message):
        Protocol(tmp_path / "protocol.toml")


def test_the_looks_add_up_to_the_reported_seeds(protocol):
    low, high = protocol.seeds["report"]
    assert max(protocol.looks["seeds"]) <= high - low + 1
    ranges = sorted(map(tuple, protocol.seeds.values()))
    assert all(before[1] < after[0] for before, after in pairwise(ranges))


def test_each_arm_is_what_its_settings_say(protocol):
    told = protocol.config("acrobot", "reuse-told", 2000).resolved()
    assert (told.agent, told.drift_signal, told.keep_data, told.alpha) == (
        "gbdqn-reuse", "schedule", 0.0, 1.0,
    )  # fmt: skip
    twin = protocol.config("acrobot", "twin", 2000).resolved()
    assert (twin.warm_start, twin.zero_output, twin.keep_adam) == (True, False, True)
    dqn = protocol.config("mountaincar", "dqn", 2000, lr=0.5).resolved()
    assert (dqn.lr, dqn.keep_data, dqn.replay) == (0.5, 1.0, "proportional")
    plain = protocol.config("mountaincar", "plasticity", 2000, alpha=0.5).resolved()
    assert plain.alpha == 1.0, "what defines an arm is not tuned away"


def test_random_alarms_are_as_many_as_the_drifts_and_come_after_the_first(protocol):
    config = protocol.config("acrobot", "dqn", 2003)
    alarms = random_alarms(config)
    assert len(alarms) == 5 == len(set(alarms)) and alarms == sorted(alarms) == random_alarms(
        config
    )
    assert min(alarms) >= 150 and max(alarms) < 650
    other = random_alarms(protocol.config("acrobot", "dqn", 2004))
    assert other != alarms
    assert protocol.config("acrobot", "dqn-random", 2003).drift_signal == alarms


def test_the_primary_metric_begins_with_the_first_event(protocol):
    config = protocol.config("acrobot", "dqn", 2000)
    records = [{"return": -500.0 if k < 150 else -100.0} for k in range(650)]
    assert primary(records, config) == -100.0


def test_every_method_is_tuned_alike(protocol):
    """As many settings, the preset's own value in the middle of each range."""
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


# --- its level and its power, on simulated studies ------------------------------------------------


def simulated(protocol, effect, rng):
    """{(task, arm): returns of 40 seeds}: the boosting agents are ahead by the effect."""
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


def test_a_study_in_which_nothing_is_true_rarely_says_that_something_is(monkeypatch):
    """Every arm alike and every margin 0: at most 5 % of the studies decide a hypothesis."""
    quick(monkeypatch)
    null, rng, studies = Protocol(), np.random.default_rng(0), 120
    null.hypotheses = [each | {"margin": 0.0} for each in null.hypotheses]
    wrong = sum(
        any(null.decisions(simulated(null, 0.0, rng), rng).values()) for _ in range(studies)
    )
    assert wrong <= 0.05 * studies + 2 * np.sqrt(0.05 * 0.95 * studies)


def test_a_large_effect_is_found_at_the_first_look(protocol, monkeypatch):
    """A lead of 30 is 20 beyond the largest margin, twice the spread of a paired difference."""
    quick(monkeypatch)
    rng = np.random.default_rng(1)
    looks = [protocol.decisions(simulated(protocol, 30.0, rng), rng) for _ in range(5)]
    assert all(set(each.values()) == {20} for each in looks)


def quick(monkeypatch):
    """Fewer sign flips, enough for the smallest p that a look can ask for."""
    flips = stats.sign_flip_test
    monkeypatch.setattr(
        stats, "sign_flip_test", lambda x, rng, margin: flips(x, rng, margin, flips=1500)
    )

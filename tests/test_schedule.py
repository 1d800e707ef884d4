"""The schedule of regimes: resolved once, and refused in one line if malformed."""

import inspect

import numpy as np
import pytest

from gbdqn_ref import UsageError, drift
from gbdqn_ref.config import Config
from gbdqn_ref.schedule import FACTORS, LABELS, Regime, describe, regimes, stock

STOCK = {"gravity": 1.0, "force": 1.0}
REVERSED, HEAVY = STOCK | {"force": -1.0}, STOCK | {"gravity": 2.0}
THREE = [{"episode": 5, "force": -1.0}, {"episode": 8, "gravity": 2}, {"episode": 9, "reset": True}]


def test_regimes_follow_one_another_without_gaps():
    assert regimes("mountaincar", THREE, 12) == (
        Regime(0, 5, STOCK, None),
        Regime(5, 8, REVERSED, "drift"),
        Regime(8, 9, HEAVY, "drift"),
        Regime(9, 12, STOCK, "reset"),
    )


@pytest.mark.parametrize(
    ("episodes", "ends"), [(5, [5]), (6, [5, 6]), (8, [5, 8]), (9, [5, 8, 9]), (99, [5, 8, 9, 99])]
)
def test_regimes_are_cut_off_at_the_end_of_the_run(episodes, ends):
    assert [regime.end for regime in regimes("mountaincar", THREE, episodes)] == ends


def test_an_entry_at_0_replaces_the_stock_regime():
    found = regimes("mountaincar", [{"episode": 0, "force": -1.0}], 3)
    assert found == (Regime(0, 3, REVERSED, "drift"),)
    assert regimes("mountaincar", [], 3) == (Regime(0, 3, STOCK, None),)


def test_drifted_says_whether_a_regimes_physics_differ_from_stock():
    drifted = [regime.drifted for regime in regimes("mountaincar", THREE, 12)]
    assert drifted == [False, True, True, False]


def test_numpy_numbers_are_accepted():
    entry = {"episode": np.int64(5), "force": np.float32(-0.5), "gravity": np.float64(2.0)}
    (_, drifted) = regimes("mountaincar", [entry], 9)
    assert drifted == Regime(5, 9, {"gravity": 2.0, "force": -0.5}, "drift")
    assert type(drifted.start) is int and type(drifted.factors["force"]) is float


@pytest.mark.parametrize("env", FACTORS)
def test_each_factor_is_an_argument_of_its_environments_setter(env):
    _, setter = drift.ENVIRONMENTS[env]
    assert [*inspect.signature(setter).parameters][1:] == [*FACTORS[env]] == [*stock(env)]
    assert set(FACTORS) == set(drift.ENVIRONMENTS) == set(LABELS)


def test_the_config_resolves_its_schedule_once(monkeypatch):
    config = Config(env="mountaincar", schedule=THREE, episodes=9)
    monkeypatch.setattr("gbdqn_ref.config.regimes", None)
    assert config.regimes == regimes("mountaincar", THREE, 9)


def test_factors_are_described_in_words():
    assert describe(REVERSED) == "force × -1"
    assert describe({"cart_mass": 0.5, "gravity": 1.25}, "\n") == "cart mass × 0.5\ngravity × 1.25"
    assert describe(STOCK) == "stock physics"


MALFORMED = {
    "an entry": ({"episode": 1, "gravity": 2.0}, "must be a list"),
    "a number": (5, "must be a list.*, not 5"),
    "a word": ("drift", "must be a list"),
    "a list of numbers": ([150, 250], "a schedule entry must be like .*, not 150"),
    "no episode": ([{"gravity": 2.0}], "'episode'"),
    "a negative episode": ([{"episode": -1, "gravity": 2.0}], "non-negative"),
    "a fractional episode": ([{"episode": 1.5, "gravity": 2.0}], "non-negative whole number"),
    "true as an episode": ([{"episode": True, "gravity": 2.0}], "non-negative whole number"),
    "decreasing episodes": (
        [{"episode": 5, "gravity": 2.0}, {"episode": 4, "reset": True}],
        "4 follows 5",
    ),
    "an episode twice": (
        [{"episode": 5, "gravity": 2.0}, {"episode": 5, "reset": True}],
        "5 follows 5",
    ),
    "an unknown factor": ([{"episode": 1, "wind": 2.0}], "'wind'.*it has gravity, cart_mass, "),
    "a factor of another environment": ([{"episode": 1, "mass": 2.0}], "'mass'.*pole_mass"),
    "neither factors nor a reset": ([{"episode": 1}], "'episode': 1.*gravity.*reset"),
    "a reset that is false": ([{"episode": 1, "reset": False}], "gravity.*reset"),
    "both factors and a reset": ([{"episode": 1, "gravity": 2.0, "reset": True}], "gravity.*reset"),
    "a reset that is 1": ([{"episode": 1, "reset": 1}], "gravity.*reset"),
    "a factor 0": (
        [{"episode": 1, "gravity": 0}],
        "'gravity' must be a number from 0.01 to 100, not 0",
    ),
    "no push": (
        [{"episode": 1, "force": 0.0}],
        "'force' must be a number from 0.01 to 100, of either sign, not 0",
    ),
    "a negative factor": (
        [{"episode": 1, "pole_mass": -1.0}],
        "'pole_mass' must be a number from 0.01 to 100",
    ),
    "a factor of NaN": ([{"episode": 1, "gravity": float("nan")}], "'gravity'.*nan"),
    "an infinite factor": ([{"episode": 1, "force": float("inf")}], "'force'.*inf"),
    "a factor too small": ([{"episode": 1, "force": -0.009}], "from 0.01 to 100.*-0.009"),
    "a factor too large": ([{"episode": 1, "gravity": 101}], "from 0.01 to 100, not 101"),
    "a factor too large for a float": ([{"episode": 1, "gravity": 10**400}], "'gravity'"),
    "a word for a factor": ([{"episode": 1, "gravity": "2"}], "'gravity'.*'2'"),
    "true as a factor": ([{"episode": 1, "gravity": True}], "'gravity'.*True"),
    "None as a factor": ([{"episode": 1, "gravity": None}], "'gravity'.*None"),
}


@pytest.mark.parametrize(("schedule", "message"), MALFORMED.values(), ids=MALFORMED)
@pytest.mark.parametrize("use", [regimes, drift.make])
def test_a_malformed_schedule_is_refused_in_one_line(use, schedule, message):
    with pytest.raises(UsageError, match=message) as caught:
        use("cartpole", schedule)
    assert "\n" not in str(caught.value)

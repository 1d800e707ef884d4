"""Statistics of runs, on examples small enough to compute by hand."""

import re
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import reals, rngs

from gbdqn_ref import UsageError
from gbdqn_ref.stats import (
    bootstrap_interval,
    final_return,
    forgetting,
    gain,
    holm,
    iqm,
    match_alarms,
    mean_std,
    median_recovery,
    paired_difference,
    recovery,
    regime_medians,
    regime_table,
    sign_flip_test,
    standard_error,
    trailing_mean,
)

runs = st.lists(reals(), min_size=1, max_size=9).map(np.array)


def records(*regimes):
    """The records of a run, given the returns of each regime's episodes."""
    rows = []
    for regime, returns in enumerate(regimes):
        for i, r in enumerate(returns):
            event = "drift" if regime and not i else ""
            row = {"regime": regime, "event": event, "return": float(r)}
            rows.append(row | {"episode": len(rows)})
    return rows


def test_the_final_return_is_the_mean_of_the_last_50_episodes():
    assert final_return([1000.0] * 550 + [2.0] * 25 + [4.0] * 25) == 3.0


def test_the_final_return_of_a_short_run_is_the_mean_of_all_its_episodes():
    assert final_return([1.0, 2.0, 6.0]) == 3.0


def test_the_final_return_is_a_python_float():
    assert type(final_return([1.0])) is float


def test_a_trailing_mean_only_looks_back():
    assert trailing_mean(np.array([0.0, 0.0, 3.0, 6.0]), 3).tolist() == [1.0, 3.0]
    assert trailing_mean(np.array([4.0, 2.0]), 1).tolist() == [4.0, 2.0]


@pytest.mark.parametrize("n", [0, 1, 4])
def test_a_trailing_mean_of_too_few_values_is_empty(n):
    assert trailing_mean(np.ones(n), 5).shape == (0,)
    assert trailing_mean(np.ones(5), 5).shape == (1,)


@pytest.mark.parametrize(
    ("levels", "episodes"),
    [
        ([1.0] * 10, 10),  # the first possible mean of 10
        ([0.91] * 10, 10),
        ([0.0] * 10 + [1.0] * 20, 19),  # nine ones and a zero among the last ten: exactly 0.9
        ([0.0] + [1.0] * 9, 10),
        ([0.0] * 2 + [1.0] * 9, 11),
        ([2.0] * 5 + [0.0] * 100, 10),
    ],
)
def test_recovery_is_the_episode_at_which_the_mean_of_10_is_first_at_90_percent(levels, episodes):
    assert recovery(levels) == episodes


@pytest.mark.parametrize(
    "levels", [[0.89] * 300, [0.0] * 10, [0.0, 1.0] * 50, [-5.0] * 40 + [1.0] * 8]
)
def test_a_recovery_that_never_comes_is_none(levels):
    assert recovery(levels) is None


@pytest.mark.parametrize("levels", [[], [5.0], [5.0] * 9])
def test_fewer_than_10_episodes_do_not_show_a_recovery(levels):
    assert recovery(levels) is None


def test_one_good_episode_is_no_recovery():
    assert recovery([0.0] * 5 + [1.0] + [0.0] * 30) is None


def test_a_single_regime_has_neither_drop_nor_recovery():
    place = dict(regime=0, first_episode=0, episodes=2, event="")
    undefined = dict(drop=None, recovery=None, area=None)
    assert regime_table(records([10, 20]), 0.0) == [place | dict(mean_return=15.0) | undefined]


def test_a_drop_and_a_recovery_by_hand():
    """The last 20 before the drift have mean 100, the random policy 20: 60 is level 0.5.

    Level 0.9 is 92 = (2 · 60 + 8 · 100) / 10, which the first 28 episodes reach.
    """
    table = regime_table(records([0] * 5 + [100] * 20, [60] * 20 + [100] * 20), 20.0)
    place = dict(regime=1, first_episode=25, episodes=40, event="drift")
    assert table[1] == place | dict(mean_return=80.0, drop=0.5, recovery=28, area=0.75)


def test_a_run_of_two_regimes_worked_by_hand():
    """Mean, median, minimum, first and last all differ, and so do 19, 20 and 21 episodes.

    Reference: 20 episodes of 9 and 11 in turn, mean 10; random policy 0. Levels after the drift:
    1 (4 times), 0 (16), 2 (5); the first mean of 10 at 0.9 has five zeros and five twos.
    """
    rows = records([1000] * 5 + [9, 11] * 10, [10] * 4 + [0] * 16 + [20] * 5)
    for number, each in enumerate(rows):
        each["episode"] = 100 + number  # a run's later part
    first, second = regime_table(rows, 0.0)
    assert first["mean_return"] == 208.0 and first["first_episode"] == 100  # (5000 + 200) / 25
    place = dict(regime=1, first_episode=125, episodes=25, event="drift")
    levels = dict(drop=1 - 4 / 20, recovery=25, area=pytest.approx(0.56))
    assert second == place | dict(mean_return=(4 * 10 + 5 * 20) / 25) | levels
    assert {type(value) for value in second.values()} == {int, float, str}  # JSON's own


def test_the_reference_is_the_last_20_episodes_before_the_drift():
    table = regime_table(records([0] * 100 + [100] * 20, [50] * 20), 0.0)
    assert table[1]["drop"] == 0.5  # catches the mean of the whole regime, or the first 20


def test_the_drop_covers_the_first_20_episodes_after_the_drift():
    assert regime_table(records([100] * 20, [50] * 20 + [100] * 80), 0.0)[1]["drop"] == 0.5


def test_a_gain_is_a_negative_drop():
    row = regime_table(records([100] * 20, [150] * 20), 0.0)[1]
    assert (row["drop"], row["recovery"]) == (-0.5, 10)


def test_negative_returns_are_measured_from_the_random_policy():
    """−140 is (500 − 140) / 400 = 0.9 of the way from −500 to −100."""
    row = regime_table(records([-100] * 20, [-140] * 30), -500.0)[1]
    assert row["drop"] == pytest.approx(0.1)
    assert regime_table(records([-100] * 20, [-141] * 30), -500.0)[1]["recovery"] is None
    assert regime_table(records([-100] * 20, [-139] * 30), -500.0)[1]["recovery"] == 10


def test_a_recovery_after_the_end_of_the_regime_does_not_count():
    table = regime_table(records([100] * 20, [0] * 30, [100] * 30), 0.0)
    assert (table[1]["drop"], table[1]["recovery"]) == (1.0, None)


@pytest.mark.parametrize("before", [20.0, 19.0, -3.0])
def test_a_level_no_better_than_random_has_nothing_to_lose(before):
    row = regime_table(records([before] * 20, [100] * 30), 20.0)[1]
    assert (row["drop"], row["recovery"]) == (None, None)


def test_a_standard_error_by_hand():
    assert standard_error([1.0, 2.0, 3.0]) == pytest.approx(1 / 3**0.5)  # √((1 + 0 + 1) / 2) / √3
    assert standard_error([4.0, 4.0]) == 0.0
    assert standard_error([0.0, 2.0]) == pytest.approx(1.0)  # √2 / √2; dividing by n gives 1 / √2


def test_a_single_episode_has_an_infinite_standard_error():
    assert standard_error([7.0]) == np.inf


@pytest.mark.parametrize(
    ("random", "expected"), [(79.9, 20.1), (80.0, None), (81.0, None), (-5.0, 105.0)]
)
def test_a_gain_is_more_than_two_standard_errors_above_the_random_policy(random, expected):
    """(90, 110): mean 100, standard error √200 / √2 = 10."""
    assert gain([90.0, 110.0], random) == (expected and pytest.approx(expected))


def test_a_single_episode_before_a_drift_shows_no_gain():
    """A single episode of an untrained agent may be lucky; any drop would be meaningless."""
    row = regime_table(records([40], [100] * 30), 20.0)[1]
    assert (row["drop"], row["recovery"], row["area"]) == (None, None, None)


def test_a_level_within_two_standard_errors_of_random_has_nothing_to_lose():
    """1, 2, 3 is 2 ± 0.58, so it is not above 1 by two standard errors."""
    row = regime_table(records([1, 2, 3], [1] * 30), 1.0)[1]
    assert (row["drop"], row["recovery"], row["area"]) == (None, None, None)
    assert regime_table(records([1, 2, 3], [1] * 30), 0.8)[1]["drop"] is not None


def test_each_regime_is_compared_with_the_one_just_before_it():
    table = regime_table(records([100] * 20, [50] * 20, [25] * 20), 0.0)
    assert [row["drop"] for row in table] == [None, 0.5, 0.5]


def test_a_short_regime_is_compared_with_all_earlier_episodes_available():
    table = regime_table(records([10] * 4, [5] * 3, [6] * 2), 0.0)
    assert [row["episodes"] for row in table] == [4, 3, 2]
    assert table[1]["drop"] == 0.5
    # the last regime's reference covers two regimes: (4 · 10 + 3 · 5) / 7 = 55/7
    assert table[2]["drop"] == pytest.approx(1 - 6 / (55 / 7))


def test_the_table_gives_each_regimes_first_episode_and_event():
    rows = records([1] * 3, [1] * 4, [1] * 5)
    rows[7]["event"] = "reset"
    found = [(row["first_episode"], row["event"]) for row in regime_table(rows, 0.0)]
    assert found == [(0, ""), (3, "drift"), (7, "reset")]


def test_the_area_of_a_regime_is_its_mean_level():
    """With reference 100 and random policy 0, 20 episodes of 50 and 20 of 100 give 0.75."""
    rows = regime_table(records([100] * 20, [50] * 20 + [100] * 20), 0.0)
    assert (rows[0]["area"], rows[1]["area"]) == (None, 0.75)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([0, 1, 2, 3, 100], 2),  # (0.15 · 1 + 0.2 · 2 + 0.15 · 3) · 2
        ([4, 0, 0, 4, 9], 2.8),  # sorted 0 0 4 4 9: (0.15 · 0 + 0.2 · 4 + 0.15 · 4) · 2
        ([1, 2, 6, 100], 4),  # all of the second and the third
        ([7], 7),
        ([1, 5], 3),
        ([0, 3, 9], 3.5),  # thirds: (1/3 − 1/4) · 0 + 1/3 · 3 + (3/4 − 2/3) · 9, twice
    ],
)
def test_the_interquartile_mean_by_hand(values, expected):
    assert iqm(np.array(values, float)) == pytest.approx(expected)


@given(runs, reals(), st.floats(0.1, 10))
def test_the_interquartile_mean_moves_and_scales_with_its_values(x, shift, scale):
    assert iqm(scale * x + shift) == pytest.approx(scale * iqm(x) + shift, abs=1e-9)
    assert np.quantile(x, 0.25, method="inverted_cdf") - 1e-9 <= iqm(x)
    assert iqm(x) <= np.quantile(x, 0.75, method="inverted_cdf") + 1e-9


def test_the_interquartile_mean_is_taken_along_an_axis():
    x = np.arange(10.0).reshape(2, 5)
    assert iqm(x).tolist() == [2, 7] and iqm(x.T, axis=0).tolist() == [2, 7]
    assert iqm([[9, 0], [1, 8], [5, 4], [6, 4]], axis=0).tolist() == [5.5, 4]


@given(runs, rngs())
def test_an_interval_lies_within_the_values_and_depends_only_on_its_seed(x, rng):
    state = rng.bit_generator.state
    low, high = bootstrap_interval(x, rng, resamples=50)
    assert x.min() - 1e-9 <= low <= high <= x.max() + 1e-9
    rng.bit_generator.state = state
    assert bootstrap_interval(x, rng, resamples=50) == (low, high)


def test_an_interval_of_two_values_by_hand():
    """A resample of (0, 1) has mean 0, ½ or 1, with probabilities ¼, ½, ¼."""
    rng = np.random.default_rng(0)
    assert bootstrap_interval([0.0, 1.0], rng, np.mean, level=0.4) == (0.5, 0.5)
    assert bootstrap_interval([0.0, 1.0], rng, np.mean, level=0.6) == (0.0, 1.0)


@pytest.mark.parametrize(
    "ask",
    [
        lambda: iqm([]),
        lambda: iqm(np.empty((2, 0))),
        lambda: final_return([]),
        lambda: mean_std([]),
        lambda: standard_error([]),
        lambda: median_recovery([]),
        lambda: regime_medians([]),
        lambda: bootstrap_interval([], np.random.default_rng(0)),
        lambda: paired_difference([], [], np.random.default_rng(0)),
    ],
)
def test_an_average_of_no_values_is_refused(ask):
    with pytest.raises(UsageError, match=r"^at least one value is needed$"):
        ask()


@pytest.mark.parametrize(
    ("x", "y"), [([1, 2], [1]), ([1], [1, 2]), ([[1, 2]], [1, 2]), (3, [1]), (3, 1)]
)
def test_unpaired_results_are_refused_and_not_broadcast(x, y):
    shapes = re.escape(f"not {np.shape(x)} and {np.shape(y)}")
    with pytest.raises(UsageError, match=f"one result per seed from both, {shapes}"):
        paired_difference(x, y, np.random.default_rng(0))


def test_an_interval_ends_at_the_percentiles_of_all_resamples():
    """2.5 and 97.5 % of the IQMs of all 5⁵ resamples, each to within one percent."""
    values = [0.0, 1.0, 3.0, 7.0, 20.0]
    every = np.array([iqm(resample) for resample in product(values, repeat=5)])
    ends = bootstrap_interval(values, np.random.default_rng(0), resamples=3000)
    for end, part in zip(ends, (0.025, 0.975), strict=True):
        below, up_to = (every < end - 1e-9).mean(), (every < end + 1e-9).mean()
        assert below - 0.01 < part < up_to + 0.01


def test_an_interval_leaves_two_and_a_half_percent_on_either_side():
    """(0, 0, 1): the mean is 1 in 1/27 = 3.7 % of the resamples, inside 95 %, outside 90 %."""
    assert bootstrap_interval([0, 0, 1], np.random.default_rng(0), np.mean) == (0.0, 1.0)
    low, high = bootstrap_interval([0, 0, 1], np.random.default_rng(0), np.mean, level=0.9)
    assert (low, high) == (0.0, pytest.approx(2 / 3))


STATED = re.findall(r"(\d+\.\d) % with\s+(\d+)", bootstrap_interval.__doc__)


@pytest.mark.parametrize(
    ("statistic", "stated"), [*zip((iqm, iqm, iqm, np.mean), STATED, strict=True)]
)
def test_an_interval_covers_the_truth_as_often_as_its_docstring_says(statistic, stated):
    """For 4000 samples of a normal distribution, whose mean and IQM are 0."""
    rng, stated, n = np.random.default_rng(0), float(stated[0]), int(stated[1])
    intervals = [bootstrap_interval(rng.normal(size=n), rng, statistic) for _ in range(4000)]
    covered = 100 * np.mean([low <= 0 <= high for low, high in intervals])
    assert covered == pytest.approx(stated, abs=3 * np.sqrt(stated * (100 - stated) / 4000))


def test_each_environment_is_resampled_separately():
    """Runs that agree within each environment have no spread, however much these differ."""
    x = np.array([[1.0] * 5, [9.0] * 5])
    assert bootstrap_interval(x, np.random.default_rng(0)) == (5.0, 5.0)
    assert bootstrap_interval(x.ravel(), np.random.default_rng(0)) != (5.0, 5.0)


@given(runs, rngs())
def test_swapping_the_pair_changes_the_sign_of_the_difference(x, rng):
    y, state = x[::-1].copy(), rng.bit_generator.state
    middle, low, high = paired_difference(x, y, rng, resamples=200)
    rng.bit_generator.state = state
    back = paired_difference(y, x, rng, resamples=200)
    np.testing.assert_allclose(back, (-middle, -high, -low), atol=1e-9)


def test_pairing_removes_variation_shared_by_the_seeds():
    seeds = np.array([0.0, 100.0, 200.0, 300.0, 400.0])
    assert paired_difference(seeds + 1, seeds, np.random.default_rng(0)) == (1.0, 1.0, 1.0)


def test_a_paired_difference_by_hand():
    """The differences 1, 2, −7, 10 have the middle half 1 and 2; the two IQMs differ by 2.5."""
    x, y = [1.0, 2.0, 3.0, 10.0], [0.0, 0.0, 10.0, 0.0]
    middle, low, high = paired_difference(x, y, np.random.default_rng(0), resamples=1)
    assert middle == 1.5 and low == high  # of one resample


def test_mean_and_std_by_hand():
    assert mean_std([0.0, 0.0, 3.0]) == (1.0, pytest.approx(3**0.5))  # √((1 + 1 + 4) / 2)
    assert mean_std([1.0, 3.0]) == (2.0, pytest.approx(2**0.5))
    assert mean_std([4.0]) == (4.0, None)


@pytest.mark.parametrize(
    ("times", "median"),
    [([10, 30, 20], 20), ([10, None, 20], 20), ([None, 10, None], None)]
    + [([10, 20], 15), ([10, None], None), ([9], 9)],
)
def test_a_recovery_that_never_came_counts_as_the_latest(times, median):
    assert median_recovery(times) == median


def row(drop, recovery, area):
    return {"drop": drop, "recovery": recovery, "area": area}


def test_medians_use_only_runs_with_something_to_lose():
    rows = [row(0.5, 40, 0.9), row(None, None, None), row(0.7, None, 0.1), row(0.1, 10, 0.4)]
    assert regime_medians(rows) == {"recovery": 40, "area": 0.4, "undefined": 1}


def test_a_regime_that_most_runs_never_recover_from_has_an_area_but_no_recovery():
    rows = [row(0.5, 40, 0.25), row(0.9, None, 0.75)]
    assert regime_medians(rows) == {"recovery": None, "area": 0.5, "undefined": 0}


def test_without_runs_that_had_something_to_lose_medians_are_undefined():
    rows = [row(None, None, None)] * 3
    assert regime_medians(rows) == {"recovery": None, "area": None, "undefined": 3}


def test_forgetting_is_the_best_evaluation_minus_the_last():
    """Regime 0 falls from 90 to 60; regime 1 ends at its best."""
    assert forgetting([[80, 99, 0], [90, 50, 0], [60, 70, 40]]) == [30.0, 0.0]


def test_the_evaluation_right_after_a_regime_counts_as_its_best():
    assert forgetting([[100, 0], [70, 5]]) == [30.0]


# --- detectors and hypotheses ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("alarms", "drifts", "expected"),
    [
        ([], [], ([], 0, 0)),
        ([], [5], ([], 1, 0)),
        ([5], [5], ([1], 0, 0)),
        ([14], [5], ([10], 0, 0)),
        ([15], [5], ([], 1, 1)),
        ([4], [5], ([], 1, 1)),
        ([6, 7], [5], ([2], 0, 1)),
        ([6, 21], [5, 20, 40], ([2, 2], 1, 0)),
        ([12], [5, 10], ([3], 1, 0)),
        ([6, 12], [5, 10], ([2, 3], 0, 0)),
    ],
)
def test_alarms_are_matched_with_drifts(alarms, drifts, expected):
    assert match_alarms(alarms, drifts) == expected


def test_a_sign_flip_test_enumerates():
    """Of the 16 sign flips of (1, 2, 3, 4) only one has as large a mean."""
    p = sign_flip_test([1, 2, 3, 4], np.random.default_rng(0), statistic=np.mean, flips=40_000)
    assert p == pytest.approx(1 / 16, abs=0.005)
    p = sign_flip_test([-1, -2, -3, -4], np.random.default_rng(0), statistic=np.mean)
    assert p == 1.0


def test_the_test_asks_for_more_than_the_margin():
    x = [11.0, 12.0, 13.0, 9.5, 14.0, 12.5, 11.5, 13.5]
    ps = [sign_flip_test(x, np.random.default_rng(0), margin) for margin in (0.0, 12.0, 13.0)]
    assert ps[0] < 0.05 < ps[1] < 0.9 < ps[2]


@pytest.mark.parametrize("x", [[1.0, np.nan, 2.0, 3.0], [np.nan] * 8, [1e300, np.inf]])
def test_what_is_not_finite_shows_nothing(x):
    with np.errstate(invalid="ignore"):
        assert sign_flip_test(x, np.random.default_rng(0)) == 1.0


def test_ties_are_counted_whatever_the_unit():
    """Of the eight flips of 3 − 1 − 2 three have a mean above 0, and two 0, but for rounding."""
    for unit in np.geomspace(1e-9, 1e9, 19) / 7:
        x = np.array([3.0, -1.0, -2.0]) * unit * np.pi
        p = sign_flip_test(x, np.random.default_rng(0), statistic=np.mean)
        assert p == pytest.approx(5 / 8, abs=0.02)


def test_the_smallest_p_is_not_0():
    p = sign_flip_test(np.arange(1.0, 31.0), np.random.default_rng(0), flips=99)
    assert p == 0.01


def test_a_true_null_is_rejected_as_often_as_stated():
    rng = np.random.default_rng(0)
    ps = np.array([sign_flip_test(rng.normal(size=20), rng, flips=400) for _ in range(800)])
    assert [np.mean(ps <= level) for level in (0.05, 0.2)] == pytest.approx([0.05, 0.2], abs=0.03)


def test_holm_steps_down():
    assert holm([0.04, 0.01, 0.03, 0.005]) == pytest.approx([0.06, 0.03, 0.06, 0.02])
    assert holm([0.6, 0.5]) == [1.0, 1.0]
    assert holm([0.02]) == [0.02]
    assert holm([0.001, np.nan]) == [0.002, 1.0]

"""The experiments, by arithmetic: what the printed numbers and settings imply, before anything is
run again.

What the paper leaves open and a check must assume is named where it is assumed: that ± is over the
five runs, and how long an episode of Hopper is.
"""

from math import gamma, pi, sqrt

import numpy as np
import paper
import pytest
from ledger import claim, control, shows
from paper import RUNS, TABLES
from worlds import mean_return

from gbdqn_ref.agents import AGENTS
from gbdqn_ref.bellman import epsilon_schedule, softmax_policy
from gbdqn_ref.config import Config
from gbdqn_ref.schedule import regimes
from gbdqn_ref.stats import final_return

OTHERS = ("DQN", "Ensemble", "Reset", "Sliding")
ROUNDING = 0.005  # what a printed number may differ from the true one


def largest_std(mean, low, high):
    """Bhatia and Davis: Var ≤ (high − mean)(mean − low) for whatever lies in [low, high]."""
    return sqrt(max(0.0, (high - mean) * (mean - low)))


def impossible(tables):
    """Every (environment, method) whose std no returns with that mean can have; none is above 0."""
    return [
        (env, name)
        for env, low in paper.LOWEST.items()
        for name, (mean, std) in tables[env].items()
        if std - ROUNDING > largest_std(mean + ROUNDING, low, 0)
    ]


def replaced(env, name, mean, std):
    """The paper's tables with one entry replaced."""
    return TABLES | {env: TABLES[env] | {name: (mean, std)}}


@claim("X1")
def test_a_mean_at_the_edge_leaves_no_room_for_a_std():
    """The printed std is impossible, whatever the returns were."""
    assert ("MountainCar", "Ensemble") in impossible(TABLES)
    mean, std = TABLES["MountainCar"]["Ensemble"]
    most = largest_std(mean + ROUNDING, paper.LOWEST["MountainCar"], 0)
    assert most < 1 < std
    shows("{:.2f} printed, {:.1f} possible (any number of returns)", std, most)


@claim("X1")
def test_five_runs_leave_even_less():
    """Four runs at the lowest return, and one as far above it as the rounded mean allows."""
    mean, _ = TABLES["MountainCar"]["Ensemble"]
    runs = np.array([mean] * (RUNS - 1) + [mean + RUNS * ROUNDING])
    assert final_return(runs, last=RUNS) == pytest.approx(mean + ROUNDING)
    std = np.std(runs, ddof=1)
    assert std < 0.0112
    shows("{:.3f} for five; and the text says zero variance", std)


@claim("X15")
def test_the_other_stds_are_possible():
    """One pair of mean and std exceeds the bound, and the others do not."""
    pairs = sum(len(TABLES[env]) for env in paper.LOWEST)
    ((env, name),) = impossible(TABLES)
    shows(
        "{} of {} pairs within √((0 − mean)(mean − lowest)), all but {}'s {}",
        pairs - 1,
        pairs,
        env,
        name,
    )


@control("X15")
def test_control_the_bound_is_reached():
    """Two values at the ends of the range have exactly the largest std, and a larger one is
    impossible.
    """
    ends = [paper.LOWEST["MountainCar"], 0.0]
    mean, std = final_return(ends), np.std(ends)
    assert std == largest_std(mean, *ends)
    found = impossible(replaced("MountainCar", "Sliding", mean, std + 1))
    assert ("MountainCar", "Sliding") in found


@control("X1")
def test_control_a_little_off_the_edge_it_would_be_possible():
    """With a mean 1.9 higher the same std is possible."""
    mean, std = TABLES["MountainCar"]["Ensemble"]
    assert impossible(replaced("MountainCar", "Ensemble", mean + 1.9, std)) == []


def lead(table):
    """GB-DQN's mean minus the best one of the others."""
    return table["GB-DQN"][0] - max(table[name][0] for name in OTHERS)


@claim("X2")
def test_gb_dqn_has_the_best_mean():
    """In each table it is ahead of the best of the others."""
    leads = [lead(TABLES[env]) for env in ("Acrobot", "MountainCar", "Hopper")]
    assert min(leads) > 0
    shows("by {:.2f} (Acrobot), {:.2f} (MountainCar) and {:.2f} (Hopper) over the second", *leads)


@control("X2")
@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_control_with_dqns_mean_it_would_not_lead(table):
    """With DQN's number in its place GB-DQN is ahead nowhere."""
    assert lead(table | {"GB-DQN": table["DQN"]}) <= 0


def p_value(first, second):
    """Welch's two-sided p for two (mean, std) over RUNS runs each: the tails of Student's t,
    integrated numerically.
    """
    (mean1, std1), (mean2, std2) = first, second
    var1, var2 = std1**2 / RUNS, std2**2 / RUNS
    t = abs(mean1 - mean2) / sqrt(var1 + var2)
    df = (var1 + var2) ** 2 / ((var1**2 + var2**2) / (RUNS - 1))
    x = np.linspace(0, t, 20_001)
    density = (
        gamma((df + 1) / 2) / (sqrt(df * pi) * gamma(df / 2)) * (1 + x**2 / df) ** (-(df + 1) / 2)
    )
    return 1 - 2 * np.trapezoid(density, x)


def p_values(std_factor=1.0):
    """{environment: p of GB-DQN against each other method}, with every std scaled."""
    scaled = {
        env: {name: (mean, std * std_factor) for name, (mean, std) in table.items()}
        for env, table in TABLES.items()
    }
    return {
        env: [p_value(table["GB-DQN"], table[name]) for name in OTHERS]
        for env, table in scaled.items()
    }


@claim("X3")
def test_no_comparison_is_significant():
    """Welch's test of GB-DQN against each of the others in each table."""
    p = p_values()
    smallest = min(min(values) for values in p.values())
    assert smallest > 0.05
    np.testing.assert_allclose(p["Acrobot"], [0.80, 0.67, 0.12, 0.87], atol=0.005)
    np.testing.assert_allclose(p["MountainCar"], [0.77, 0.054, 0.066, 0.41], atol=0.005)
    np.testing.assert_allclose(p["Hopper"], [0.99, 0.93, 0.85, 0.89], atol=0.005)
    count = sum(map(len, p.values()))
    against_dqn = [values[0] for values in p.values()]
    shows(
        "Welch's p against DQN: {:.2f}; the smallest of {} is {:.3f}", against_dqn, count, smallest
    )


@control("X3")
def test_control_with_a_third_of_the_std_some_would_be():
    """The test does find differences: with stds a third as large some reach p < 0.05."""
    small = sum(p < 0.05 for values in p_values(1 / 3).values() for p in values)
    assert small >= 3


def smaller_stds(std_factor=1.0):
    """{environment: the methods whose std is below GB-DQN's}, with GB-DQN's std scaled."""
    return {
        env: [name for name in OTHERS if table[name][1] < std_factor * table["GB-DQN"][1]]
        for env, table in TABLES.items()
    }


@claim("X4")
def test_half_of_the_stds_are_smaller():
    """Of the others' stds half are below GB-DQN's."""
    smaller = smaller_stds()
    assert sum(map(len, smaller.values())) == len(TABLES) * len(OTHERS) / 2
    by_env = [f"{', '.join(names)} on {env}" for env, names in smaller.items()]
    shows("smaller: {}", "; ".join(by_env))


@control("X4")
def test_control_with_a_third_of_its_std_gb_dqn_would_have_the_smallest():
    """No other std is below a third of GB-DQN's."""
    assert not any(smaller_stds(1 / 3).values())


def lowest(table):
    """The method with the lowest mean."""
    return min(table, key=lambda name: table[name][0])


@claim("X7")
def test_reset_has_the_lowest_mean_on_hopper():
    """Every other method has a higher mean."""
    means = {name: mean for name, (mean, _) in TABLES["Hopper"].items()}
    assert lowest(TABLES["Hopper"]) == "Reset"
    reset, *others = sorted(means.values())
    shows("{:.2f}, where the others have {:.2f} to {:.2f}", reset, others[0], others[-1])


@control("X7")
def test_control_with_a_return_of_one_more_another_would_be_the_lowest():
    """Reset is the lowest by less than 1."""
    mean, std = TABLES["Hopper"]["Reset"]
    assert lowest(TABLES["Hopper"] | {"Reset": (mean + 1, std)}) == "Sliding"


def hopper(length):
    """(steps, ε at the end, episode of the first update, updates) of the printed settings, by
    episode length.
    """
    steps, start = paper.HOPPER_EPISODES * length, paper.HOPPER_LEARNING_STARTS
    return (
        steps,
        epsilon_schedule(steps, *paper.EPSILON, paper.HOPPER_EPSILON_STEPS),
        start // length,
        max(0, steps - start) // paper.UPDATE_EVERY,
    )


@claim("X5")
def test_hopper_ends_before_it_begins():
    """ε has hardly fallen at the end, the first update comes after two of the three drifts, and the
    sliding window never slides.
    """
    length = 20
    steps, epsilon, first_update, updates = hopper(length)
    assert epsilon > 0.9
    assert paper.HOPPER_DRIFTS[1] < first_update == paper.HOPPER_EPISODES / 2
    assert steps < paper.HOPPER_WINDOW
    assert updates == (steps - paper.HOPPER_LEARNING_STARTS) / paper.UPDATE_EVERY
    shows(
        "assumed: {} steps an episode. {} steps, ε = {:.3f}, first update at episode {}, {}"
        " updates",
        length,
        steps,
        epsilon,
        first_update,
        updates,
    )


@control("X5")
def test_control_with_long_episodes_the_settings_would_do():
    """At 200 steps an episode ε reaches its final value, and learning starts before the first
    drift.
    """
    _, epsilon, first_update, _ = hopper(200)
    assert epsilon == pytest.approx(paper.EPSILON[1]) and first_update < paper.HOPPER_DRIFTS[0]


@claim("X6")
def test_hoppers_returns_are_those_of_chance():
    """With our seven actions (the paper's are not said: D16); the levels are rounded down, since
    simulators differ.
    """
    rng = np.random.default_rng(0)
    means = [mean for mean, _ in TABLES["Hopper"].values()]
    by_chance = mean_return("hopper", lambda: rng.integers(7), episodes=20)
    by_nothing = mean_return("hopper", lambda: 0, episodes=5)
    assert by_chance > max(means) / 2 and by_nothing > 5 * max(means)
    shows(
        "printed {:.1f} to {:.1f}; random actions over {}, doing nothing over {}, under our seven"
        " actions",
        min(means),
        max(means),
        10 * int(by_chance // 10),
        100 * int(by_nothing // 100),
    )


@control("X6")
def test_control_doing_nothing_is_nothing_on_mountaincar():
    """There it earns the lowest return, and all printed means but one are above it."""
    by_nothing = mean_return("mountaincar", lambda: 1, episodes=1)
    assert by_nothing == paper.LOWEST["MountainCar"]
    means = {name: mean for name, (mean, _) in TABLES["MountainCar"].items()}
    assert [name for name in means if means[name] <= by_nothing] == ["Ensemble"]


def smallest_at_most(table, n):
    """{method: a bound on the smallest of n numbers}: with mean μ and std s it is at most
    μ − s/√n.
    """
    return {name: mean - std / sqrt(n) for name, (mean, std) in table.items()}


@claim("X8")
def test_the_stds_of_hopper_over_runs_ask_for_a_run_near_0():
    """The smallest of five runs would be at or near 0 for every method."""
    bounds = smallest_at_most(TABLES["Hopper"], RUNS)
    assert bounds["Sliding"] < 0 and max(bounds.values()) < 6
    names = [name.removesuffix("-DQN") for name in bounds]
    shows("the lowest of five runs is at most {:.1f} ({})", list(bounds.values()), names)


@control("X8")
def test_control_the_bound_is_reached_by_four_runs_alike():
    """Four runs at the bound and one far above them have the printed mean and std."""
    mean, std = TABLES["Hopper"]["DQN"]
    low = smallest_at_most(TABLES["Hopper"], RUNS)["DQN"]
    runs = np.array([low] * (RUNS - 1) + [RUNS * mean - (RUNS - 1) * low])
    assert final_return(runs) == pytest.approx(mean)
    assert np.std(runs, ddof=1) == pytest.approx(std)


@control("X8")
def test_control_over_episodes_nothing_follows():
    """Over the 250 final episodes of five runs the same bound leaves the smallest within 3 of the
    mean.
    """
    bounds = smallest_at_most(TABLES["Hopper"], RUNS * 50)
    assert all(mean - bounds[name] < 3 for name, (mean, _) in TABLES["Hopper"].items())


@claim("X9")
def test_the_last_regime_is_the_first_one():
    """On Acrobot and MountainCar, for at least the 50 episodes of the final return."""
    for env in ("acrobot", "mountaincar"):
        config = Config.preset(env)
        first, drift, *_, last = config.regimes
        assert (last.factors, last.event) == (first.factors, "reset")
        assert last.end - last.start >= 50
    shows(
        "the last {} of {} episodes have the physics of the first {}, and GB-DQN adds no booster"
        " there",
        last.end - last.start,
        last.end,
        drift.start,
    )


@control("X9")
def test_control_without_the_reset_the_last_regime_is_another():
    """Without the last event the run ends in a regime that the agent had to adapt to."""
    *schedule, _ = Config.preset("acrobot").schedule
    first, *_, last = regimes("acrobot", schedule)
    assert last.event != "reset" and last.factors != first.factors


@claim("X10")
def test_the_replay_is_confounded_with_the_method():
    """Of the five methods as the package runs them, GB-DQN alone has another replay."""
    replays = {
        agent: Config(agent=agent).resolved().replay
        for agent in ("gbdqn", "dqn", "ensemble", "reset", "sliding")
    }
    assert replays.pop("gbdqn") == "recency"
    assert set(replays.values()) == {"proportional"}
    shows("as printed: recency and PER for GB-DQN, PER for the rest")


@control("X10")
def test_control_the_controls_separate_the_two():
    """DQN with GB-DQN's replay, and GB-DQN with DQN's, differ in one thing only."""
    own = {agent: Config(agent=agent).resolved().replay for agent in AGENTS}
    assert own["dqn-recency"] == own["gbdqn"] != own["gbdqn-per"] == own["dqn"]


def better_by_softmax(gap, temperature):
    """The probability of the better of two actions under softmax."""
    return softmax_policy(np.array([gap, 0.0]), temperature)[0]


@claim("X13")
def test_the_two_policies_are_not_the_same():
    """One letter τ for both: at the printed 0.01 softmax is greedier than ε-greedy, at 1 it nearly
    draws evenly.
    """
    gap, epsilon, temperatures = 0.1, paper.EPSILON[1], [0.01, 1.0]
    greedy = 1 - epsilon / 2
    cold, warm = (better_by_softmax(gap, temperature) for temperature in temperatures)
    assert warm < 0.53 < greedy < 0.9999 < cold
    shows(
        "Q = ({}, 0): the better action with {:.3f} (ε = {}), {:.5f} (τ = {}) or {:.3f} (τ = {})",
        *(gap, greedy, epsilon, cold, temperatures[0], warm, temperatures[1]),
    )


@control("X13")
def test_control_with_the_temperature_fitted_they_agree_on_one_state():
    """For one gap there is a τ with ε-greedy's probabilities, and twice the gap needs another."""
    greedy = 1 - paper.EPSILON[1] / 2
    temperature = 0.1 / np.log(greedy / (1 - greedy))
    assert better_by_softmax(0.1, temperature) == pytest.approx(greedy)
    assert better_by_softmax(0.2, temperature) > 0.99


def episodes_held(capacity):
    """How many episodes of DQN's printed mean return fit in, at −1 a step."""
    return capacity // round(-TABLES["Acrobot"]["DQN"][0])


@claim("X14")
def test_the_buffer_is_longer_than_a_regime():
    """The buffer holds three regimes and more, the window less than half of one."""
    config, regime = Config.preset("acrobot"), paper.DRIFTS[2] - paper.DRIFTS[1]
    held, window = episodes_held(config.capacity), episodes_held(config.window)
    assert held > 3 * regime and window < regime / 2
    shows(
        "assumed: {} steps an episode. The buffer holds {} episodes, the window {}, and a regime"
        " has {}",
        round(-TABLES["Acrobot"]["DQN"][0]),
        held,
        window,
        regime,
    )


@control("X14")
def test_control_a_third_of_the_buffer_would_hold_about_one_regime():
    """With a third of the capacity the buffer is no longer than a regime and a tenth."""
    regime = paper.DRIFTS[2] - paper.DRIFTS[1]
    assert regime <= episodes_held(Config.preset("acrobot").capacity // 3) < 1.1 * regime

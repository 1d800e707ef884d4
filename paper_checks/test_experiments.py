"""The experiments: what the printed numbers and settings imply, what the environments are, and what
the stored reruns say where the paper prints no number.

What the paper leaves open and a check must assume is named where it is assumed: that ± is over the
five runs, how long an episode of Hopper is, and which its seven actions are.
"""

from math import exp, lgamma, pi, sqrt

import gymnasium
import numpy as np
import paper
import pytest
import reruns
from ledger import claim, control, shows
from paper import RUNS, TABLES
from worlds import mean_return, one_hot_agent

from gbdqn_ref.agents import AGENTS
from gbdqn_ref.bellman import epsilon_schedule, softmax_policy, td_target
from gbdqn_ref.config import Config
from gbdqn_ref.drift import make
from gbdqn_ref.presets import HELD_OUT
from gbdqn_ref.schedule import regimes
from gbdqn_ref.stats import final_return, paired_difference, standard_error

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
    found = impossible(TABLES)
    assert len(found) == 1
    ((env, name),) = found
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
def test_control_a_sixth_of_its_std_lower_it_would_lead_nowhere(table):
    """Each lead is less than a sixth of GB-DQN's own std."""
    mean, std = table["GB-DQN"]
    assert lead(table | {"GB-DQN": (mean - std / 6, std)}) < 0


def p_value(first, second, n=RUNS):
    """Welch's two-sided p for two (mean, std) over n numbers each: the tails of Student's t,
    integrated numerically.
    """
    (mean1, std1), (mean2, std2) = first, second
    var1, var2 = std1**2 / n, std2**2 / n
    t = abs(mean1 - mean2) / sqrt(var1 + var2)
    df = (var1 + var2) ** 2 / ((var1**2 + var2**2) / (n - 1))
    x = np.linspace(0, t, 20_001)
    height = exp(lgamma((df + 1) / 2) - lgamma(df / 2)) / sqrt(df * pi)
    return 1 - 2 * np.trapezoid(height * (1 + x**2 / df) ** (-(df + 1) / 2), x)


def p_values(std_factor=1.0, n=RUNS):
    """{environment: p of GB-DQN against each other method}, with every std scaled."""
    scaled = {
        env: {name: (mean, std * std_factor) for name, (mean, std) in table.items()}
        for env, table in TABLES.items()
    }
    return {
        env: [p_value(table["GB-DQN"], table[name], n) for name in OTHERS]
        for env, table in scaled.items()
    }


@claim("X3")
def test_no_comparison_is_significant():
    """Welch's test of GB-DQN against each of the others in each table."""
    p = p_values()
    smallest, following, *others = sorted(each for values in p.values() for each in values)
    assert smallest > 0.05 and smallest == p["MountainCar"][1]
    np.testing.assert_allclose(p["Acrobot"], [0.80, 0.67, 0.12, 0.87], atol=0.005)
    np.testing.assert_allclose(p["MountainCar"], [0.77, 0.054, 0.066, 0.41], atol=0.005)
    np.testing.assert_allclose(p["Hopper"], [0.99, 0.93, 0.85, 0.89], atol=0.005)
    shows(
        "Welch's p against DQN: {:.2f}; the smallest of {} is {:.3f}, against the entry that X1"
        " finds impossible, and the next {:.3f}",
        [values[0] for values in p.values()],
        2 + len(others),
        smallest,
        following,
    )


@claim("X3")
def test_the_impossible_entry_mended_one_would():
    """MountainCar's ensemble, with the std that its mean allows; not if all twelve are tested."""
    (mean, _), gb_dqn = TABLES["MountainCar"]["Ensemble"], TABLES["MountainCar"]["GB-DQN"]
    p, tests = p_value(gb_dqn, (mean, 0.0)), len(TABLES) * len(OTHERS)
    assert p < 0.05 < tests * p
    shows(
        "with a std of 0 in place of the entry of X1, MountainCar's ensemble would: p = {:.3f},"
        " corrected for {} {:.2f}",
        *(p, tests, tests * p),
    )


@claim("X3")
def test_over_episodes_some_would_be():
    """Were ± over the last 50 episodes of each run, and were these independent."""
    n = 50 * RUNS
    small = [sum(p < 0.05 for p in values) for values in p_values(n=n).values()]
    against_dqn = [values[0] for values in p_values(n=n).values()]
    assert small == [2, 4, 0]
    shows(
        "over {} episodes as if independent: significant against {} of the {} others (Acrobot,"
        " MountainCar, Hopper); p against DQN: {:.2f}",
        n,
        small,
        len(OTHERS),
        against_dqn,
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


@claim("X4")
def test_on_hopper_three_of_four_are_larger():
    """Of DQN and the ensemble, which the text compares there, both."""
    smaller, table = smaller_stds()["Hopper"], TABLES["Hopper"]
    assert smaller == ["Reset"]
    lead = table["GB-DQN"][1] - table["Reset"][1]
    shows("on Hopper only {}'s is smaller, by {:.2f}", *smaller, lead)


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
    lengths = 20, 24
    steps, epsilon, first_update, updates = zip(*map(hopper, lengths), strict=True)
    assert min(epsilon) > 0.88 and min(first_update) > paper.HOPPER_DRIFTS[1]
    assert max(steps) < paper.HOPPER_WINDOW
    shows(
        "assumed: {} or {} steps an episode. {} or {} steps, ε = {:.3f} or {:.3f}, first update at"
        " episode {} or {}, {} or {} updates",
        *(value for pair in (lengths, steps, epsilon, first_update, updates) for value in pair),
    )


@claim("X5")
def test_a_random_policy_lasts_24_steps():
    """Under our seven actions; the first update follows the second drift up to 24 steps."""
    rng, episodes = np.random.default_rng(0), 600
    length = episode_lengths(make("hopper"), lambda: rng.integers(7), episodes).mean()
    assert 23 < length < 25 and hopper(24)[2] > paper.HOPPER_DRIFTS[1]
    shows("random actions: {:.0f} steps in the mean of {} episodes", length, episodes)


@control("X5")
@pytest.mark.parametrize("length", [26, 200])
def test_control_with_longer_episodes_the_settings_would_do(length):
    """From 26 steps on the second drift finds an agent that learns; at 200 the first one does, and
    ε reaches its final value.
    """
    steps, epsilon, first_update, _ = hopper(length)
    assert first_update < paper.HOPPER_DRIFTS[1]
    if steps >= paper.HOPPER_EPSILON_STEPS:
        assert epsilon == pytest.approx(paper.EPSILON[1])
        assert first_update < paper.HOPPER_DRIFTS[0] and steps > paper.HOPPER_WINDOW


def episodes_of(env, act, episodes):
    """The rewards of each episode, from the starts of seeds 0, 1, …, and how each ended."""
    for seed in range(episodes):
        env.reset(seed=seed)
        rewards, terminated, truncated = [], False, False
        while not (terminated or truncated):
            _, r, terminated, truncated, _ = env.step(act())
            rewards.append(float(r))
        yield rewards, terminated


def episode_lengths(env, act, episodes):
    return np.array([len(rewards) for rewards, _ in episodes_of(env, act, episodes)])


def random_return(env, act, episodes):
    """(mean return, its standard error)."""
    returns = [sum(rewards) for rewards, _ in episodes_of(env, act, episodes)]
    return np.mean(returns), standard_error(returns)


def nearest(x, unit):
    """x to the next multiple: the level of a return, since simulators differ."""
    return unit * round(x / unit)


def printed_on_hopper():
    """(the lowest, the highest mean)."""
    means = [mean for mean, _ in TABLES["Hopper"].values()]
    return min(means), max(means)


@claim("X6")
def test_random_actions_reach_the_printed_means():
    """Under our seven actions: above the lowest mean, and two standard errors reach the highest."""
    rng, episodes = np.random.default_rng(0), 600
    low, high = printed_on_hopper()
    mean, error = random_return(make("hopper"), lambda: rng.integers(7), episodes)
    nothing = mean_return("hopper", lambda: 0, episodes=5)
    assert low < mean and high < mean + 2 * error and error < 1 and nothing > 5 * high
    shows(
        "printed {:.1f} to {:.1f}; under our seven actions, {} episodes: random about {}, within"
        " two standard errors of the highest, doing nothing about {}",
        low,
        high,
        episodes,
        nearest(mean, 5),
        nearest(nothing, 50),
    )


@claim("X6")
def test_the_level_of_chance_depends_on_the_seven_actions():
    """All three motors at once, at seven of the eight corners of the torque cube: far below. Half
    of our torques: far above.
    """
    rng = np.random.default_rng(0)
    low, high = printed_on_hopper()
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(7)]) * 2.0 - 1
    halves = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)]) / 2
    env = gymnasium.make("Hopper-v5")
    below, error = random_return(env, lambda: corners[rng.integers(7)], 100)
    above, spread = random_return(env, lambda: halves[rng.integers(7)], 100)
    assert below + 5 * error < low and above - 2 * spread > high
    shows(
        "random among seven corners about {}, among half torques about {}",
        nearest(below, 5),
        nearest(above, 5),
    )


@control("X6")
def test_control_the_first_twenty_episodes_say_the_opposite():
    """Their mean is below all five printed ones: too few returns whose spread is their mean."""
    rng = np.random.default_rng(0)
    mean, _ = random_return(make("hopper"), lambda: rng.integers(7), 20)
    assert mean < printed_on_hopper()[0]


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


def boosters(told):
    """How many boosters GB-DQN has frozen at the end of Acrobot's schedule, if it is told of its
    drifts or not; the rewards change with each.
    """
    agent = one_hot_agent(behaviour="softmax", learning_starts=8, batch_size=8)
    for k, regime in enumerate(Config.preset("acrobot").regimes):
        if told and k:
            agent.on_drift(regime.event)
        for _ in range(50):
            s = np.eye(3, dtype=np.float32)[agent.rng.integers(3)]
            agent.observe(s, 0, 10.0 * k, s, False)
            agent.learn()
    return len(agent.ensemble)


@claim("X12")
def test_a_booster_is_added_when_the_schedule_says_so():
    """At each drift that is no reset."""
    frozen = boosters(told=True)
    drifts = [regime for regime in Config.preset("acrobot").regimes if regime.event == "drift"]
    assert frozen == len(drifts)
    shows("told of {} drifts and a reset, it freezes {} learners", len(drifts), frozen)


@control("X12")
def test_control_untold_it_adds_none():
    """The same changes of reward, unannounced."""
    assert boosters(told=False) == 0


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


def episodes_held(capacity, length):
    """How many episodes of this many steps fit in."""
    return capacity // length


@claim("X14")
def test_the_buffer_is_longer_than_a_regime():
    """At DQN's printed mean return, −1 a step, the buffer holds three regimes and more, the window
    less than half of one.
    """
    config, regime = Config.preset("acrobot"), paper.DRIFTS[2] - paper.DRIFTS[1]
    length = round(-TABLES["Acrobot"]["DQN"][0])
    held, window = (episodes_held(size, length) for size in (config.capacity, config.window))
    assert held > 3 * regime and window < regime / 2
    shows(
        "assumed: {} steps an episode. The buffer holds {} episodes, the window {}, and a regime"
        " has {}",
        length,
        held,
        window,
        regime,
    )


@control("X14")
def test_control_with_the_longest_episodes_it_holds_one_regime():
    """At 500 steps an episode, the most there are."""
    config, regime = Config.preset("acrobot"), paper.DRIFTS[2] - paper.DRIFTS[1]
    assert episodes_held(config.capacity, -round(paper.LOWEST["Acrobot"])) == regime


# What the text says of recovery, drops, consistency and rewards


def drops(agent):
    """Mean drop over the three drifts of our Acrobot that are no reset, one per seed."""
    return [
        np.mean([regime["drop"] for regime in run["regimes"] if regime["event"] == "drift"])
        for run in reruns.runs_of("acrobot", agent)
    ]


def drop_difference(agent, other):
    """(IQM, low, high) of the difference between their drops."""
    return paired_difference(drops(agent), drops(other), np.random.default_rng(0))


def slowest(agent):
    """The longest median recovery of those drifts, in episodes."""
    regimes = zip(*(run["regimes"][1:4] for run in reruns.runs_of("acrobot", agent)), strict=True)
    return max(np.median([each["recovery"] or np.inf for each in row]) for row in regimes)


@claim("X16")
def test_in_our_acrobot_reset_drops_further_and_recovers_later():
    """DQN's drops are larger too, by little; its recovery is the fastest that can be measured."""
    from_reset, from_dqn = drop_difference("gbdqn", "reset"), drop_difference("gbdqn", "dqn")
    assert from_reset[2] < -0.5 and -0.05 < from_dqn[1] < from_dqn[2] < 0
    assert slowest("gbdqn") == slowest("dqn") == 10 < slowest("reset")
    shows(
        "drop minus DQN's {:+.2f} [{:+.2f}, {:+.2f}] of the level before, minus Reset-DQN's {:+.2f}"
        " [{:+.2f}, {:+.2f}]; slowest median recovery {:.0f}, {:.0f} and {:.0f} episodes",
        *from_dqn,
        *from_reset,
        *map(slowest, ("gbdqn", "dqn", "reset")),
    )


@control("X16")
def test_control_with_runs_in_another_order_the_drop_from_reset_stays():
    """Reset's is the larger drop whichever seeds are paired, and DQN's is not larger than its
    own.
    """
    own = np.array(drops("reset"))
    for shift in range(RUNS):
        _, low, high = paired_difference(
            np.roll(own, shift), drops("dqn"), np.random.default_rng(0)
        )
        assert 0.5 < low < high
    assert drop_difference("dqn", "dqn") == (0, 0, 0)


@claim("X17")
def test_beside_its_own_replay_boosting_brings_nothing_detectable():
    """The control that the tables lack: DQN with GB-DQN's replay, in our reruns."""
    found = [
        reruns.paired(env, "gbdqn", "dqn-recency") for env in ("acrobot", "mountaincar", "hopper")
    ]
    assert all(low < 0 for _, low, _ in found)
    middles, lows, highs = zip(*found, strict=True)
    shows(
        "minus DQN with the same replay: {:+.1f} (Acrobot, MountainCar, Hopper), from {:+.1f}"
        " up to {:+.1f}",
        middles,
        lows,
        highs,
    )


@control("X17")
def test_control_a_gain_of_one_span_would_be_seen():
    """From the random policy to DQN, every interval lies above 0."""
    for env in ("acrobot", "mountaincar", "hopper"):
        assert reruns.paired(env, "dqn", "random")[1] > 0


def td_errors(rewards):
    """δ at Q = Q* = 0 of one state that never ends, for these rewards."""
    rewards = np.asarray(rewards)
    none = np.zeros(len(rewards))
    return td_target(rewards, none, none[:, None], paper.GAMMA)


@claim("X18")
def test_noise_alone_gives_a_td_error_where_nothing_drifts():
    """Rewards of 1 and −1, half each: Q* = 0, and no transition has δ = 0."""
    delta = td_errors([1.0, -1.0])
    assert delta.mean() == 0 and (np.abs(delta) > 0).all()
    shows("rewards ±1 in turn, no drift, Q = Q*: δ = ({})", delta)


@control("X18")
def test_control_without_noise_only_a_drift_gives_one():
    """Rewards of 0 give δ = 0; after a drift to 1, δ = 1."""
    assert not td_errors([0.0, 0.0]).any()
    assert td_errors([1.0, 1.0]).tolist() == [1, 1]


def by_chance(env, episodes=200):
    """(rewards on the way, share of episodes that arrive), by random actions."""
    rng, world = np.random.default_rng(0), make(env)
    played = list(episodes_of(world, lambda: rng.integers(world.action_space.n), episodes))
    on_the_way = {r for rewards, ended in played for r in rewards[: len(rewards) - ended]}
    return on_the_way, np.mean([ended for _, ended in played])


@claim("X19")
def test_both_pay_the_same_until_the_goal():
    """−1 for each step, on Acrobot and on MountainCar; chance arrives on the first alone."""
    acrobot, mountaincar = by_chance("acrobot"), by_chance("mountaincar")
    assert acrobot[0] == mountaincar[0] == {-1.0}
    assert acrobot[1] > 0 == mountaincar[1]
    shows(
        "each step pays {:.0f} on both; random actions arrive in {:.1%} of the episodes on Acrobot"
        " and in {:.1%} on MountainCar",
        *acrobot[0],
        acrobot[1],
        mountaincar[1],
    )


@control("X19")
def test_control_hopper_pays_differently_at_every_step():
    """A dense reward has many values on the way."""
    assert len(by_chance("hopper", episodes=5)[0]) > 50


def larger_on_hopper(tables):
    """The methods whose std on Hopper exceeds that on Acrobot."""
    acrobot, hopper_ = tables["Acrobot"], tables["Hopper"]
    return [name for name in hopper_ if hopper_[name][1] > acrobot[name][1]]


@claim("X20")
def test_no_std_on_hopper_is_as_large_as_on_acrobot():
    """For every method; in relation to the mean every one is larger."""
    assert larger_on_hopper(TABLES) == []
    relative = relative_to_means()
    assert larger_on_hopper(relative) == list(TABLES["Hopper"])
    stds = [[std for _, std in TABLES[env].values()] for env in ("Hopper", "Acrobot")]
    ratios = [[std for _, std in relative[env].values()] for env in ("Hopper", "Acrobot")]
    shows(
        "std at most {:.1f} on Hopper and at least {:.1f} on Acrobot; std/|mean| at least {:.2f}"
        " and at most {:.2f}",
        *(max(stds[0]), min(stds[1]), min(ratios[0]), max(ratios[1])),
    )


def relative_to_means():
    """The tables with each std divided by its mean's size."""
    return {
        env: {name: (mean, std / abs(mean)) for name, (mean, std) in table.items()}
        for env, table in TABLES.items()
    }


def returns_from(name, seed, noise):
    """Rewards of 10 steps from the start of a seed, with the environment's later draws replaced."""
    env, rng = make(name), np.random.default_rng(0)
    env.reset(seed=seed)
    env.unwrapped.np_random = np.random.default_rng(noise)
    return [env.step(rng.integers(env.action_space.n))[0].tolist() for _ in range(10)]


@claim("X20")
def test_the_start_is_all_that_is_random():
    """In each environment the same start and actions give the same states, whatever is drawn
    later.
    """
    names = "acrobot", "mountaincar", "hopper"
    equal = [returns_from(name, 0, noise=1) == returns_from(name, 0, noise=2) for name in names]
    assert all(equal)
    shows("transitions are deterministic in {} of {} environments", sum(equal), len(names))


@control("X20")
def test_control_another_start_gives_another_path():
    """And Acrobot's stds cut to a fifth would be smaller than Hopper's for every method."""
    assert all(returns_from(env, 0, 1) != returns_from(env, 1, 1) for env in ("acrobot", "hopper"))
    cut = {name: (mean, std / 5) for name, (mean, std) in TABLES["Acrobot"].items()}
    assert larger_on_hopper(TABLES | {"Acrobot": cut}) == list(TABLES["Hopper"])


def spacings(schedule):
    """The episodes between one drift and the next."""
    return set(np.diff([entry["episode"] for entry in schedule]).tolist())


@claim("X21")
def test_each_environment_has_one_schedule_with_one_spacing():
    """As printed; the factors are not."""
    found = {
        env: spacings(Config.preset(env).schedule) for env in ("acrobot", "mountaincar", "hopper")
    }
    assert {100} == found["acrobot"] == found["mountaincar"] == found["hopper"]
    assert set(np.diff(paper.DRIFTS)) == set(np.diff(paper.HOPPER_DRIFTS)) == {100}
    shows("{} episodes from one drift to the next, in all three", *found["hopper"])


@control("X21")
def test_control_a_schedule_that_varies_the_spacing():
    """Our held-out ones do."""
    assert all(len(spacings(preset["schedule"])) > 1 for preset in HELD_OUT.values())


def spread_of_differences(table):
    """(least, most) std of GB-DQN's runs minus DQN's, if none of them is negative.

    However runs are paired, s_{x−y} ≥ |s_x − s_y|. Of n numbers ≥ 0 with mean d it is at most d√n:
    all of them 0 but one.
    """
    (mean, std), (dqn, dqn_std) = table["GB-DQN"], table["DQN"]
    return abs(std - dqn_std) - 2 * ROUNDING, (mean - dqn + 2 * ROUNDING) * sqrt(RUNS)


@claim("X22")
def test_some_run_of_dqn_ends_above_the_run_of_gb_dqn_that_it_is_paired_with():
    """On MountainCar and Hopper, if ± is over the five runs, whatever the pairs."""
    found = [spread_of_differences(TABLES[env]) for env in ("MountainCar", "Hopper")]
    assert all(least > most for least, most in found)
    shows(
        "std of the differences at least {:.2f}, and at most {:.2f} if none is negative"
        " (MountainCar); {:.2f} and {:.2f} (Hopper)",
        *np.ravel(found),
    )


@control("X22")
@pytest.mark.parametrize("env", ["MountainCar", "Hopper"])
def test_control_with_dqns_std_no_run_need_be_worse(env):
    """Then each run of GB-DQN could be DQN's plus the lead."""
    table = TABLES[env]
    least, most = spread_of_differences(table | {"GB-DQN": (table["GB-DQN"][0], table["DQN"][1])})
    assert least < 0 < most


@control("X22")
def test_control_one_of_five_numbers_reaches_the_bound():
    """Of five numbers ≥ 0 with mean 1, the one that is 5 alone has a std of √5."""
    assert np.std([0, 0, 0, 0, 5], ddof=1) == pytest.approx(sqrt(RUNS))


def third_drift(**factors):
    """Return of one episode of Hopper in the third drift of our preset, with other factors."""
    entry = {**Config.preset("hopper").schedule[2], "episode": 1, **factors}
    env, rng = make("hopper", [entry]), np.random.default_rng(0)
    env.reset(seed=0)
    ((rewards, _),) = episodes_of(env, lambda: rng.integers(7), 1)
    return sum(rewards)


FRICTION = Config.preset("hopper").schedule[2]["friction"]


@claim("X23")
def test_friction_changes_what_the_third_drift_is():
    """The same start and the same actions."""
    assert abs(third_drift() - third_drift(friction=1.0)) > 0.001
    shows("friction × {}: another return from the same start and actions", FRICTION)


@control("X23")
def test_control_the_same_friction_gives_the_same_return():
    assert third_drift(friction=FRICTION) == third_drift()


def ordered(tables):
    """How many of the orders that the text states hold in these tables, of how many."""
    acrobot, car, hopper_ = (tables[env] for env in ("Acrobot", "MountainCar", "Hopper"))
    stated = [
        acrobot["DQN"][0] > acrobot["Ensemble"][0],
        lowest(acrobot) == "Reset",
        max(acrobot, key=lambda name: acrobot[name][1]) == "Reset",
        acrobot["Sliding"][0] > acrobot["DQN"][0],
        car["Sliding"][0] > car["Reset"][0],
        car["DQN"][0] > car["Sliding"][0],
        lowest(car) == "Ensemble",
        hopper_["Ensemble"][1] < hopper_["DQN"][1],
    ]
    return sum(stated), len(stated)


@claim("X27")
def test_the_orders_that_the_text_states_are_those_of_the_tables():
    """Of means and of stds, besides GB-DQN's lead."""
    held, of = ordered(TABLES)
    assert held == of
    shows("{} of {}", held, of)


@control("X27")
@pytest.mark.parametrize(("env", "two"), [("Acrobot", "Ensemble"), ("MountainCar", "Reset")])
def test_control_with_two_rows_swapped_one_fails(env, two):
    """DQN's row and another's."""
    table = TABLES[env]
    swapped = table | {"DQN": table[two], two: table["DQN"]}
    held, of = ordered(TABLES | {env: swapped})
    assert held < of

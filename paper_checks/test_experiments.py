"""The experiments, by arithmetic: what the printed numbers and settings imply, before anything is
run again.

What the paper leaves open and a check must assume is named where it is assumed: that ± is over the
five runs, and how long an episode of Hopper is.
"""

from math import gamma, pi, sqrt

import numpy as np
import pytest
from ledger import claim, control, shows

from gbdqn_ref.bellman import epsilon_schedule, softmax_policy
from gbdqn_ref.config import Config
from gbdqn_ref.drift import check_schedule, make
from gbdqn_ref.stats import final_return

RUNS = 5
TABLES = {  # mean ± std of the "Final Return", as printed
    "Acrobot": {
        "DQN": (-154.82, 85.56),
        "GB-DQN": (-140.16, 88.52),
        "Ensemble": (-166.32, 97.39),
        "Reset": (-264.58, 130.77),
        "Sliding": (-149.59, 85.72),
    },
    "MountainCar": {
        "DQN": (-176.33, 9.38),
        "GB-DQN": (-173.65, 17.54),
        "Ensemble": (-200.00, 19.20),
        "Reset": (-193.20, 7.46),
        "Sliding": (-182.21, 13.27),
    },
    "Hopper": {
        "DQN": (19.90, 40.01),
        "GB-DQN": (20.24, 32.64),
        "Ensemble": (18.14, 36.10),
        "Reset": (16.32, 32.59),
        "Sliding": (17.10, 38.67),
    },
}
LOWEST = {"Acrobot": -500.0, "MountainCar": -200.0}  # no return is lower, none is above 0
OTHERS = ("DQN", "Ensemble", "Reset", "Sliding")


def largest_std(mean, low, high):
    """Bhatia and Davis: Var ≤ (high − mean)(mean − low) for whatever lies in [low, high]."""
    return sqrt(max(0.0, (high - mean) * (mean - low)))


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


@claim(
    "X1",
    place="section MountainCar, table",
    says="Ensemble-DQN ends at −200.00 ± 19.20, and with zero variance",
    verdict=(
        "fails: returns are in [−200, 0], so a mean of −200.00 leaves a std of at most 1.0, over 5"
        " runs 0.011"
    ),
    uses="stats.final_return",
)
def test_a_mean_at_the_edge_leaves_no_room_for_a_std():
    mean, std = TABLES["MountainCar"]["Ensemble"]
    highest = mean + 0.005  # what still rounds to −200.00
    assert largest_std(highest, -200, 0) < 1.0 < std
    runs = np.array([-200.0] * 4 + [-200 + RUNS * 0.005])  # the most that five can spread
    assert final_return(runs, last=RUNS) == pytest.approx(highest)
    assert np.std(runs, ddof=1) < 0.0112
    shows(
        "19.20 printed, 1.0 possible (any number of returns), 0.011 for five; and the text says"
        " zero variance"
    )


@claim(
    "X15",
    place="section Acrobot, section MountainCar, tables",
    says="the other means and stds are possible",
    verdict="holds",
    uses="stats.final_return",
)
def test_the_other_stds_are_possible():
    """By Bhatia and Davis, which is sharp: two values, at the ends of the range, reach it."""
    for env, low in LOWEST.items():
        for name, (mean, std) in TABLES[env].items():
            assert (env, name) == ("MountainCar", "Ensemble") or std <= largest_std(mean, low, 0)
    assert final_return([-200.0, 0.0]) == -100 and np.std([-200.0, 0.0]) == largest_std(
        -100, -200, 0
    )
    shows("9 of 10 pairs within √((0 − mean)(mean − lowest)), all but MountainCar's Ensemble")


@control("X1", "X15")
def test_control_a_little_off_the_edge_it_would_be_possible():
    """Negative control: at a mean of −198.1 a std of 19.2 is possible, so it is the edge that
    forbids it.
    """
    assert largest_std(-198.1, -200, 0) > 19.2


@claim(
    "X2",
    place="section Experimental Results, tables",
    says="GB-DQN has the best mean in all three",
    verdict="holds",
    uses="",
)
def test_gb_dqn_has_the_best_mean():
    for table in TABLES.values():
        assert max(table, key=lambda name: table[name][0]) == "GB-DQN"
    shows("by 9.43 (Acrobot), 2.68 (MountainCar) and 0.34 (Hopper) over the second")


@claim(
    "X3",
    place="section Experimental Results",
    says="GB-DQN consistently outperforms all baselines",
    verdict="fails: if ± is over the five runs, not one of twelve comparisons reaches p < 0.05",
    uses="",
)
def test_no_comparison_is_significant():
    p = p_values()
    assert min(min(values) for values in p.values()) > 0.05
    np.testing.assert_allclose(p["Acrobot"], [0.80, 0.67, 0.12, 0.87], atol=0.005)
    np.testing.assert_allclose(p["MountainCar"], [0.77, 0.054, 0.066, 0.41], atol=0.005)
    np.testing.assert_allclose(p["Hopper"], [0.99, 0.93, 0.85, 0.89], atol=0.005)
    shows("Welch's p against DQN: 0.80, 0.77, 0.99; the smallest of twelve is 0.054")


@control("X2", "X3")
def test_control_with_a_third_of_the_std_some_would_be():
    """Negative control: the test does find differences; with stds a third as large five of twelve
    reach p < 0.05.
    """
    small = sum(p < 0.05 for values in p_values(1 / 3).values() for p in values)
    assert small >= 3
    assert p_values(1 / 3)["Hopper"][0] > 0.9  # but the 0.34 of Hopper stays nothing


@claim(
    "X4",
    place="section Experimental Results",
    says="GB-DQN has lower variance than DQN, ensembles, resets and the sliding window",
    verdict="fails: in 6 of 12 comparisons the other std is the smaller one",
    uses="",
)
def test_half_of_the_stds_are_smaller():
    smaller = [
        (env, name)
        for env, table in TABLES.items()
        for name in OTHERS
        if table[name][1] < table["GB-DQN"][1]
    ]
    assert smaller == [
        ("Acrobot", "DQN"),
        ("Acrobot", "Sliding"),
        ("MountainCar", "DQN"),
        ("MountainCar", "Reset"),
        ("MountainCar", "Sliding"),
        ("Hopper", "Reset"),
    ]
    shows(
        "smaller: DQN and Sliding on Acrobot, DQN, Reset and Sliding on MountainCar, Reset on"
        " Hopper"
    )


@claim(
    "X7",
    place="section Hopper",
    says="Reset-DQN has a competitive mean on Hopper",
    verdict="fails: it is the lowest of the five",
    uses="",
)
def test_reset_has_the_lowest_mean_on_hopper():
    assert min(TABLES["Hopper"], key=lambda name: TABLES["Hopper"][name][0]) == "Reset"
    shows("16.32, where the others have 17.10 to 20.24")


@control("X4", "X7")
def test_control_elsewhere_the_same_question_has_another_answer():
    """Negative control: Ensemble's std is nowhere the smaller one, and Reset is not everywhere the
    lowest.
    """
    assert all(table["Ensemble"][1] > table["GB-DQN"][1] for table in TABLES.values())
    assert min(TABLES["MountainCar"], key=lambda name: TABLES["MountainCar"][name][0]) == "Ensemble"


def hopper(length):
    """(steps, ε at the end, episode of the first update, updates) of the printed settings, by
    episode length.
    """
    steps, start, every = 500 * length, 5_000, 4
    return (
        steps,
        epsilon_schedule(steps, 1.0, 0.05, 100_000),
        start // length,
        max(0, steps - start) // every,
    )


@claim(
    "X5",
    place="section Hopper",
    says="the Hopper table compares trained agents",
    verdict=(
        "fails: at the 20 steps of a random policy's episode it ends at ε = 0.9, half of it before"
        " any update"
    ),
    uses="bellman.epsilon_schedule",
)
def test_hopper_ends_before_it_begins():
    steps, epsilon, first_update, updates = hopper(20)
    assert (steps, first_update, updates) == (10_000, 250, 1_250)
    assert epsilon == pytest.approx(0.905)
    assert first_update > 200  # two of the three drifts are over by then
    assert steps < 50_000  # so the sliding window never slides, and Sliding-DQN is DQN
    shows(
        "assumed: 20 steps an episode. 10,000 steps, ε = 0.905, first update at episode 250, 1,250"
        " updates"
    )


@control("X5")
def test_control_with_long_episodes_the_settings_would_do():
    """Negative control: at 200 steps an episode ε reaches 0.05; it is the short episodes that
    starve it.
    """
    _, epsilon, first_update, _ = hopper(200)
    assert epsilon == pytest.approx(0.05) and first_update < 100


def mean_return(act, episodes=20):
    """Mean return on Hopper's stock physics of a policy that looks at nothing."""
    env, returns = make("hopper"), []
    for seed in range(episodes):
        env.reset(seed=seed)
        total, ends = 0.0, False
        while not ends:
            _, r, terminated, truncated, _ = env.step(act())
            total, ends = total + float(r), terminated or truncated
        returns.append(total)
    return np.mean(returns)


@claim(
    "X6",
    place="section Hopper, table",
    says="returns of 16 to 20 on Hopper are the outcome of learning",
    verdict="fails: random actions reach as much, and doing nothing several times as much",
    uses="physics.SevenActions, drift.make",
)
def test_hoppers_returns_are_those_of_chance():
    """With our seven actions (the paper's are not said: D16); the levels are rounded down to what
    is safe to say.
    """
    rng = np.random.default_rng(0)
    best = max(mean for mean, _ in TABLES["Hopper"].values())
    assert mean_return(lambda: rng.integers(7)) > best / 2
    assert mean_return(lambda: 0, episodes=5) > 5 * best
    shows(
        "printed 16.3 to 20.2; random actions over 10, doing nothing over 100, under our seven"
        " actions"
    )


@control("X6")
def test_control_doing_nothing_is_nothing_on_mountaincar():
    """Negative control: where doing nothing earns nothing, the printed means are better than it."""
    assert all(
        mean > -200 or name == "Ensemble" for name, (mean, _) in TABLES["MountainCar"].items()
    )


@claim(
    "X8",
    place="section Hopper, table",
    says="± is the standard deviation over the five runs",
    verdict="ambiguous: never said; over five runs each method would need a run at or near 0",
    uses="stats.final_return",
)
def test_the_stds_of_hopper_over_runs_ask_for_a_run_near_0():
    """Of five numbers with mean μ and std s the smallest is at most μ − s/√5: four alike, one far
    above them.
    """
    low = {name: mean - std / sqrt(RUNS) for name, (mean, std) in TABLES["Hopper"].items()}
    assert low["Sliding"] < 0 and max(low.values()) < 6
    runs = np.array([low["DQN"]] * 4 + [0.0])
    runs[4] = RUNS * TABLES["Hopper"]["DQN"][0] - runs[:4].sum()
    assert final_return(runs) == pytest.approx(19.90) and np.std(runs, ddof=1) == pytest.approx(
        40.01
    )
    shows(
        "the lowest of five runs is at most 2.0, 5.6, 2.0, 1.7, −0.2 (DQN, GB, Ensemble, Reset,"
        " Sliding)"
    )


@control("X8")
def test_control_over_episodes_nothing_follows():
    """Negative control: over 250 final episodes the same bound leaves the smallest within 3 of the
    mean.
    """
    assert all(std / sqrt(250) < 3 for _, std in TABLES["Hopper"].values())


@claim(
    "X9",
    place="section Experimental Results",
    says="the final return measures adaptation to drift",
    verdict=(
        "ambiguous: the last event restores the stock physics, so it measures what is left of the"
        " first task"
    ),
    uses="drift.check_schedule, config.Config.preset",
)
def test_the_last_regime_is_the_first_one():
    for env in ("acrobot", "mountaincar"):
        config = Config.preset(env)
        regimes = check_schedule(env, config.schedule)
        (_, first, _), (start, last, event) = regimes[0], regimes[-1]
        assert (last, event) == (first, "reset") and config.episodes - start >= 50
    shows(
        "the last 150 of 600 episodes have the physics of the first 150, and GB-DQN adds no booster"
        " there"
    )


@control("X9")
def test_control_without_the_reset_the_last_regime_is_another():
    """Negative control: drop the last event and the run ends in a regime that the agent had to
    adapt to.
    """
    *schedule, _ = Config.preset("acrobot").schedule
    regimes = check_schedule("acrobot", schedule)
    assert regimes[-1][1] != regimes[0][1]


@claim(
    "X10",
    place="section Acrobot",
    says="all methods are compared under identical conditions",
    verdict=(
        "fails: GB-DQN's replay mixes in recency and the others' does not, so two things differ at"
        " once"
    ),
    uses="config.Config",
)
def test_the_replay_is_confounded_with_the_method():
    replays = {
        agent: Config(agent=agent).replay
        for agent in ("gbdqn", "dqn", "ensemble", "reset", "sliding")
    }
    assert replays.pop("gbdqn") == "recency"
    assert set(replays.values()) == {"proportional"}
    shows("as printed: recency and PER for GB-DQN, PER for the rest")


@control("X10")
def test_control_the_controls_separate_the_two():
    """Negative control: DQN with GB-DQN's replay, and GB-DQN with DQN's, differ in one thing
    only.
    """
    assert Config(agent="dqn-recency").replay == Config(agent="gbdqn").replay
    assert Config(agent="gbdqn-per").replay == Config(agent="dqn").replay


@claim(
    "X13",
    place="section Gradient Boosted DQN, section Acrobot",
    says="the behaviour policy",
    verdict="ambiguous: softmax in the text and in Algorithm 1, ε-greedy in the experiments",
    uses="bellman.softmax_policy",
)
def test_the_two_policies_are_not_the_same():
    """One letter τ for both: at the printed 0.01 a gap of 0.1 is e¹⁰ to 1; ε = 0.05 explores
    whatever the gap is.
    """
    q = np.array([0.1, 0.0])
    greedy = 1 - 0.05 / 2
    assert softmax_policy(q, 0.01)[0] > 0.9999 > greedy
    assert softmax_policy(q, 1.0)[0] < 0.53 < greedy
    shows(
        "Q = (0.1, 0): the better action with 0.975 (ε = 0.05), 0.99995 (τ = 0.01) or 0.525 (τ = 1)"
    )


@control("X13")
def test_control_with_the_temperature_fitted_they_agree_on_one_state():
    """Negative control: for one gap there is a τ with ε-greedy's probabilities, and twice the gap
    needs another.
    """
    tau = 0.1 / np.log(0.975 / 0.025)
    np.testing.assert_allclose(softmax_policy(np.array([0.1, 0.0]), tau)[0], 0.975)
    assert softmax_policy(np.array([0.2, 0.0]), tau)[0] > 0.99


@claim(
    "X14",
    place="section Acrobot",
    says="replay of 50,000 lets DQN follow the drifts",
    verdict=(
        "fails: at the printed returns it holds three regimes at once, the sliding window a third"
        " of one"
    ),
    uses="config.Config.preset",
)
def test_the_buffer_is_longer_than_a_regime():
    """A return of −155 is an episode of about 155 steps (assumed: DQN's printed mean); a regime has
    100 of them.
    """
    config, length = Config.preset("acrobot"), 155
    assert (config.capacity // length, config.window // length) == (322, 32)
    shows(
        "assumed: 155 steps an episode. The buffer holds 322 episodes, the window 32, and a regime"
        " has 100"
    )


@control("X14")
def test_control_a_buffer_of_a_regime_would_hold_only_it():
    """Negative control: 15,500 transitions would be one regime."""
    assert 15_500 // 155 == 100

"""Replay, claim by claim: what is unbiased, whom the priorities favour, what their clock and their
sum need.

The mixture of Eqs. 10–11, Theorem 3 and the importance weights are in test_replay.py.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import (
    exact,
    filled,
    loop,
    normalise,
    one_hot_agent,
    row,
    with_errors,
)

from gbdqn_ref.bellman import loss_gradient, td_target
from gbdqn_ref.drift import make
from gbdqn_ref.replay import (
    ProportionalReplay,
    RecencyReplay,
    importance_weights,
    mixed_priority,
    td_priority,
    time_priority,
)
from gbdqn_ref.tabular import MDP

# What off-policy learning excuses


def random_world(seed):
    """(an MDP of 3 states and 2 actions, a Q, how often a behaviour visits each pair), exactly."""
    rng = np.random.default_rng(seed)
    weights, rewards, Q, visits = (
        rng.integers(1, 10, size) + F(0) for size in ((3, 2, 3), (3, 2), (3, 2), (3, 2))
    )
    return MDP(weights / weights.sum(-1, keepdims=True), rewards, F(9, 10)), Q, visits


def mean_targets(mdp, q_next, visits):
    """E[y | s, a] in data with so many visits, where q_next (S, A) are the values of s′."""
    seen = visits[:, :, None] * mdp.P  # how often (s, a, s') is in the data
    y = td_target(
        np.broadcast_to(mdp.r[:, :, None], seen.shape),
        np.zeros(seen.shape, bool),
        np.broadcast_to(q_next, (*seen.shape, 2)),
        mdp.gamma,
    )
    return (seen * y).sum(-1) / seen.sum(-1)


@claim("R1")
@given(st.integers(0, 10**6))
def test_the_mean_target_of_a_pair_is_its_backup_whatever_the_behaviour(seed):
    """E[y | s, a] = (𝒯Q)(s, a): how often a pair is visited cancels, for the next state depends on
    the pair alone.
    """
    mdp, Q, visits = random_world(seed)
    assert (mean_targets(mdp, Q, visits) == mdp.bellman(Q)).all()
    shows(
        "E[y | s, a] = (𝒯Q)(s, a) exactly, random MDPs and visits of {} states and {} actions",
        *Q.shape,
    )


@control("R1")
def test_control_two_steps_do_depend_on_the_behaviour():
    """Where the second step too is taken from the data, its action is the behaviour's, and two
    behaviours give two mean targets.
    """
    mdp, Q, visits = random_world(0)
    found = []
    for behaviour in (visits, visits[:, ::-1]):
        second = (behaviour * mean_targets(mdp, Q, behaviour)).sum(-1) / behaviour.sum(-1)
        found.append(mean_targets(mdp, np.stack([second] * 2, -1), behaviour))
    assert (found[0] != found[1]).all() and (found[0] != mdp.bellman(mdp.bellman(Q))).all()


@control("R1")
def test_control_in_data_of_two_physics_it_is_no_backup():
    """Half of the visits are from other physics: the mean is neither's backup."""
    (mdp, Q, visits), (old, _, _) = random_world(0), random_world(1)
    both = MDP((mdp.P + old.P) / 2, (mdp.r + old.r) / 2, mdp.gamma)
    mean = mean_targets(both, Q, visits)
    assert (mean != mdp.bellman(Q)).all() and (mean != old.bellman(Q)).all()


def fitted(replay, y):
    """The least-squares fit of a constant to the targets, as the replay draws and weighs them."""
    P = replay.probabilities()
    weight = P * importance_weights(P, len(P), replay.is_exponent, None)
    return float(weight @ y / weight.sum())


def fixed_point_of_the_buffer(rewards, backups=200):
    """The Q of the loop that fitting the buffer again and again ends at, from 0."""
    replay, Q = filled(ProportionalReplay(len(rewards), 1), rewards), 0.0
    for _ in range(backups):
        q_next = np.full((len(rewards), 1), Q)
        Q = fitted(replay, td_target(replay.r, replay.terminated, q_next, 0.9))
    return Q


@claim("R2")
def test_old_physics_bias_the_fixed_point():
    """Half of the buffer is from before a drift of the reward from 0 to 1."""
    half_old, right = fixed_point_of_the_buffer([0, 1]), loop(1, F(9, 10)).q_star().item()
    assert half_old == pytest.approx(right / 2)
    shows("half old: {:.3g} for {:.3g}", half_old, right)


def fitted_to_a_lottery(is_exponent, rewards=(0,) * 9 + (10,)):
    """A step that ends the episode and pays 0 nine times in ten, else 10; Q_{m−1} = 0, so δ is the
    reward.
    """
    replay = ProportionalReplay(len(rewards), 1, is_exponent=is_exponent)
    filled(replay, rewards).update_priorities(np.arange(len(rewards)), replay.r)
    return fitted(replay, replay.r), np.mean(rewards)


@claim("R2")
def test_draws_by_error_favour_the_lucky_outcomes():
    """The δ of Q_{m−1} = 0 draws them more, and only full importance weights undo it."""
    exponent = 0.5
    (plain, mean), (half, _) = fitted_to_a_lottery(0), fitted_to_a_lottery(exponent)
    assert plain > half > 4 * mean
    shows("lottery of mean {}: {:.3f}, with IS {:/} {:.3f}", mean, plain, exponent, half)


def mean_of_the_largest(noise, actions):
    """(γ, the mean target where Q̄(s′, ·) is 0 but for noise, independent for each action)."""
    gamma = F(1, 2)
    q = np.array(np.meshgrid(*[exact(*noise)] * actions)).reshape(actions, -1).T
    y = td_target(np.full(len(q), F(0)), np.zeros(len(q), bool), q, gamma)
    return gamma, y.mean()


@claim("R2")
def test_the_maximum_takes_the_lucky_noise():
    """Of two noises ±1 the larger one has mean ½."""
    noise = exact(1, -1)
    gamma, mean = mean_of_the_largest(noise, 2)
    assert mean == gamma / 2 > noise.mean()
    shows("noise ±{}: γ/{} for {}", noise[0], gamma / mean, noise.mean())


@control("R2")
def test_control_without_drift_the_fixed_point_is_right():
    """All of the buffer is from the new physics."""
    assert fixed_point_of_the_buffer([1, 1]) == pytest.approx(loop(1, F(9, 10)).q_star().item())


@control("R2")
@pytest.mark.parametrize(
    "lottery", [(1.0,), (0.0, (1,) * 10)], ids=["full weights", "certain outcome"]
)
def test_control_with_full_weights_or_one_outcome_the_fit_is_the_mean(lottery):
    """Full importance weights undo the draws, and equal outcomes are drawn alike."""
    fit, mean = fitted_to_a_lottery(*lottery)
    assert fit == pytest.approx(mean)


@control("R2")
@pytest.mark.parametrize(("noise", "actions"), [((1, -1), 1), ((0,), 2)])
def test_control_without_choice_or_noise_the_target_is_unbiased(noise, actions):
    """One action leaves nothing to choose, and without noise all are alike."""
    assert mean_of_the_largest(noise, actions)[1] == 0


# Whom the priorities favour


def drawn(delta, **settings):
    """P of transitions with these TD errors under proportional replay."""
    return with_errors(ProportionalReplay(len(delta), 1, **settings), delta).probabilities()


@claim("R3")
@given(st.floats(0, 100), st.floats(0.01, 100), st.floats(0.1, 2))
def test_the_priority_rises_with_the_error(small, more, exponent):
    """Whatever its sign; the same section says so a paragraph later."""
    well, badly = td_priority(np.array([small, -small - more]), 0.01, exponent)
    assert well < badly
    shows("p^TD rises with |δ|")


@claim("R3")
def test_the_worse_predicted_is_drawn_more():
    """With the package's offset and exponent."""
    delta, offset, exponent = (0.0, 1.0), 0.01, 0.6
    P = drawn(delta, priority_offset=offset, priority_exponent=exponent)
    assert P[1] > 10 * P[0]
    shows(
        "δ = ({}), ε = {}, exponent {}: drawn with {:.3f} and {:.3f}",
        *(delta, offset, exponent, *P),
    )


@control("R3")
@pytest.mark.parametrize(("exponent", "sign"), [(-0.6, 1), (0.0, 0)])
def test_control_with_another_exponent_it_would_not_be(exponent, sign):
    """A negative one favours the well-predicted transition, and 0 neither."""
    P = drawn((0.0, 1.0), priority_exponent=exponent)
    assert np.sign(P[0] - P[1]) == sign


OLD, NEW, RATE = 10_000, 1_000, 0.01


def stale_mass(Q, mix):
    """(largest |δ| of the old transitions, of the new ones, the old ones' part of the draws)."""
    replay = filled(RecencyReplay(OLD + NEW, 1, mix=mix, recency_rate=RATE), [0] * OLD + [1] * NEW)
    delta = td_target(replay.r, replay.terminated, np.full((OLD + NEW, 1), Q), 0.9) - Q
    replay.update_priorities(np.arange(OLD + NEW), delta)
    return abs(delta[:OLD]).max(), abs(delta[OLD:]).max(), replay.probabilities()[:OLD].sum()


@claim("R4")
def test_the_old_data_have_no_error_until_q_has_adapted():
    """The loop's reward drifts from 0 to 1. Priorities by |δ| help before Q has adapted and hurt
    afterwards, when the old data have nearly all of the draws.
    """
    mix, q_old, q_new = 0.5, 0, 10
    assert loop(0, F(9, 10)).residual(row(q_old)) == loop(1, F(9, 10)).residual(row(q_new)) == 0
    old, new, before = stale_mass(q_old, mix)
    later_old, later_new, after = stale_mass(q_new, mix)
    assert (old, new, later_old) == (0, 1, 1) and later_new == pytest.approx(0, abs=1e-9)
    assert before < 0.5 < 0.9 < after
    shows(
        "|δ| of {} old, {} new: {}, {}, later {}, {:.0f}; β = {:/}: the old have {:.3f} of draws,"
        " later {:.3f}",
        *(OLD, NEW, old, new, later_old, later_new, mix, before, after),
    )


@control("R4")
@pytest.mark.parametrize("Q", [0.0, 10.0])
def test_control_recency_alone_prefers_the_new_data_whatever_q_is(Q):
    """Without the TD part the old data have e^{−10} of the draws, before as after."""
    assert stale_mass(Q, mix=0)[2] == pytest.approx(np.exp(-RATE * NEW), rel=1e-6)


# The TD error and its priority


def agent_with_one_transition(target):
    """A GB-DQN at its second learner, whose buffer holds one transition: r = 3 on a loop, Q_{m−1} =
    about 1.
    """
    agent = one_hot_agent(
        states=1,
        actions=1,
        replay="recency",
        capacity=1,
        batch_size=1,
        gamma=0.0,
        lr=0.05,
        tau=0.01,
        target=target,
        loss_on="h",
        alpha=1.0,
    )
    s = np.ones(1, np.float32)
    agent.observe(s, 0, 1.0, s, False)
    for _ in range(300):
        agent.learn()
    agent.on_drift("drift")
    agent.observe(s, 0, 3.0, s, False)
    return agent


def deltas(target, updates):
    """δ before each of so many updates."""
    agent = agent_with_one_transition(target)
    return [float(agent.learn()[0]) for _ in range(updates)]


@claim("R5")
def test_from_stage_to_stage_it_varies():
    """Folded in, the booster takes its part of the residual off δ."""
    agent = agent_with_one_transition("frozen")
    before = float([agent.learn()[0] for _ in range(500)][-1])
    agent.on_drift("drift")
    after = float(agent.learn()[0])
    assert before == pytest.approx(2, abs=0.01) and after == pytest.approx(0, abs=0.01)
    shows("δ is {:.2f} in one stage, {:.0f} in the next", before, abs(after))


@control("R5")
@claim("R5")
def test_the_td_error_stands_still_while_the_booster_learns():
    """Nothing in it moves until the next booster."""
    delta = deltas("frozen", 500)
    assert set(delta) == {delta[0]} and delta[0] == pytest.approx(2, abs=0.01)
    shows("{} updates leave δ the same to the bit", len(delta))


@claim("R5")
def test_what_is_learnt_is_still_drawn():
    """The booster fits the larger residual exactly, which still has the higher priority."""
    residual, h = exact(5, 1), exact(5, 0)
    gradient = loss_gradient(residual - h, exact(1, 1), np.zeros(2, int), 1).ravel()
    P = normalise(td_priority(residual, 0, 1))
    assert gradient[0] == 0 != gradient[1] and P[0] > P[1]
    shows("residuals ({}), h = ({}): P = ({}), gradients {} and {:/}", residual, h, P, *gradient)


@claim("R14")
def test_before_or_after_the_step_is_all_one():
    """The second δ is what the first would have been after its step."""
    before, after = deltas("frozen", 2)
    assert before == after
    shows("frozen target: δ before the step is δ after it, to the bit")


@control("R5", "R14")
def test_control_with_a_live_target_the_td_error_moves():
    """Where h_m counts at once, each step changes δ, and learning takes it to 0."""
    delta = deltas("live", 500)
    assert delta[0] > delta[1] + 0.01
    assert abs(delta[-1]) < 0.01


LARGEST = 1e300
magnitudes = st.one_of(st.just(0.0), st.floats(1 / LARGEST, LARGEST))


@claim("R6")
@given(magnitudes, magnitudes, st.floats(1e-3, 1), st.floats(0.1, 1))
def test_the_td_priority(one, other, offset, exponent):
    """It is at least ε^γ, even and nondecreasing, over the whole range of floats."""
    small, large = sorted((one, other))
    p = td_priority(np.array([0.0, small, large, -large]), offset, exponent)
    assert 0 < offset**exponent == pytest.approx(p[0])
    assert (np.diff(p[:3]) >= -1e-12 * p[:2]).all()
    assert p[2] == p[3] < np.inf
    shows(
        "at least ε^γ, even and nondecreasing in |δ|, for 0 and from {:g} to {:g}",
        *(1 / LARGEST, LARGEST),
    )


@control("R6")
def test_control_without_an_offset_a_transition_is_never_drawn_again():
    """ε = 0 and δ = 0 give P = 0, and what is never drawn has its δ never computed again."""
    assert drawn((0.0, 1.0), priority_offset=0.0).tolist() == [0, 1]


@claim("R7")
@given(st.lists(st.fractions(-100, 100), min_size=1, max_size=6).filter(any))
def test_per_is_proportional_to_the_td_error(delta):
    """P Σ |δ| = |δ|, in fractions."""
    delta = exact(*delta)
    P = normalise(td_priority(delta, 0, 1))
    assert (P * abs(delta).sum() == abs(delta)).all()
    shows("P = |δ| / Σ |δ| exactly")


def draws_of_twice_the_error(offset, exponent):
    """How many times the draws twice the |δ| has."""
    two, one = td_priority(np.array([2.0, 1.0]), offset, exponent)
    return two / one


@claim("R7")
def test_with_the_usual_constants_it_is_not():
    """An offset and an exponent below 1 both bend it."""
    offset, exponent = 0.01, 0.6
    ratio = draws_of_twice_the_error(offset, exponent)
    assert 1 < ratio < 2
    shows(
        "with ε = {} and exponent {} twice the |δ| has {:.2f} times the draws",
        *(offset, exponent, ratio),
    )


@control("R7")
@pytest.mark.parametrize(
    ("offset", "exponent", "ratio"), [(0, 1, 2), (0.01, 1, 1.99), (0, 0.6, 1.516)]
)
def test_control_an_offset_or_an_exponent_bends_it(offset, exponent, ratio):
    """Each alone; with neither twice the |δ| has twice the draws."""
    assert draws_of_twice_the_error(offset, exponent) == pytest.approx(ratio, abs=5e-4)


# The clock and its rate


@claim("R8")
@given(st.integers(1, 60), st.integers(1, 20), st.floats(1e-6, 10))
def test_the_time_priority_with_a_clock_of_the_whole_run(added, capacity, rate):
    """The ring's age is T − t in transitions added: 0 for the newest, N − 1 for the oldest."""
    replay = filled(RecencyReplay(capacity, 1), range(added))
    newest_first = np.argsort(-replay.r[: len(replay)])
    age = replay.age(newest_first)
    assert age.tolist() == list(range(len(replay)))
    p = time_priority(age, rate)
    assert p[0] == 1 and (p > 0).all() and (np.diff(p) < 0).all()
    shows("with age = transitions added since")


def by_the_step_within_the_episode(steps, now, rate=0.01):
    """p^time to the letter, with t the step within the episode."""
    return time_priority(now - np.array(steps), rate)


@claim("R8")
def test_to_the_letter_an_old_step_is_above_1():
    """The last step of a long episode, when the next one begins."""
    last, now, rate = 500, 1, 0.01
    literal = by_the_step_within_the_episode([last], now, rate)[0]
    assert literal > 1
    shows("to the letter step {} has {:.1f} at the next T = {}, α = {}", last, literal, now, rate)


@control("R8")
def test_control_by_the_step_within_the_episode_the_order_is_wrong():
    """After an episode of 3 steps and 2 of the next, the last step of the first is above the
    newest.
    """
    p = by_the_step_within_the_episode([1, 2, 3, 1, 2], now=2)
    assert p.argmax() == 2 and p[2] > p[-1] == 1


@control("R8")
def test_control_stored_as_it_comes_there_is_no_recency():
    """Were p stored when its transition comes, as in Algorithm 1, every p^time is 1."""
    assert {by_the_step_within_the_episode([t], now=t)[0] for t in range(1, 6)} == {1}


def mass_on_the_newest(k, n, mix, rate):
    """P of the newest k of n transitions with equal TD priorities of 1."""
    replay = filled(RecencyReplay(n, 1, mix=mix, recency_rate=rate), [0] * n)
    return replay.probabilities()[-k:].sum()


@claim("R9")
@given(st.floats(0.01, 2), st.floats(0.01, 2), st.integers(1, 40))
def test_a_larger_rate_favours_the_newer_of_any_two(rate, more, age):
    """p^time of a new transition is e^{α age} times that of an older one, which rises with α."""
    slow, fast = (np.divide(*time_priority([0, age], each)) for each in (rate, rate + more))
    assert slow == pytest.approx(np.exp(rate * age)) and slow < fast
    shows("p^time: a newer transition has e^{{α age}} times the priority of an older one")


@control("R9")
@claim("R9")
def test_a_larger_rate_can_mean_less_recency():
    """Three transitions of equal |δ|: as e^{−α} falls, the newest two first get more of the draws
    and then less.
    """
    mix, factors = F(1, 2), [F(1), F(1, 6), F(1, 10)]
    mass = []
    for x in factors:
        tau = exact(1, x, x * x)
        P = normalise(mixed_priority(td_priority(exact(1, 1, 1), 0, 1), tau, mix))
        mass.append(P[:2].sum())
    assert mass[1] > mass[0] and mass[1] > mass[2]
    shows(
        "N = {}, β = {}: e^{{−α}} = {} gives the newest 2 {}, {} gives {}, which is less",
        *(len(tau), mix, factors[1], mass[1], factors[2], mass[2]),
    )


@claim("R9")
def test_in_a_buffer_of_1000_too():
    """The share of the newest 10 rises with the rate, and falls again."""
    n, newest, rates = 1000, 10, (0.001, 0.1, 10)
    mass = [mass_on_the_newest(newest, n, 0.5, rate) for rate in rates]
    assert mass[1] > mass[0] and mass[1] > mass[2]
    shows("N = {}: α = {}, {} and {} give the newest {} {:.5f}", n, *rates, newest, mass)


@claim("R9")
@given(st.integers(1, 30), st.integers(1, 30), st.floats(0, 5), st.floats(0, 5))
def test_pure_recency_does_as_it_says(k, more, rate, faster):
    """At β = 0 the newest k have (1 − x^k)/(1 − x^N), x = e^{−α}, which rises with α."""
    mass, faster_mass = (mass_on_the_newest(k, k + more, 0, r) for r in (rate, rate + faster))
    assert mass <= faster_mass + 1e-12
    shows("at β = 0 the newest k of N have more of the draws, for every k")


# What is stored, and its sum


@claim("R11")
@given(st.integers(1, 40), st.integers(0, 10**6), st.floats(0, 1), st.floats(0, 1e4))
def test_the_probabilities_sum_to_1(n, seed, mix, rate):
    """Also at β = 0 with a rate at which every p^time but the newest underflows to 0."""
    replay = filled(RecencyReplay(20, 1, mix=mix, recency_rate=rate), [0] * n)
    delta = np.random.default_rng(seed).normal(size=len(replay))
    replay.update_priorities(np.arange(len(replay)), delta)
    P = replay.probabilities()
    assert (P >= 0).all() and P.sum() == pytest.approx(1)
    shows("random buffers, mixes and rates; β = 1, ε = 0 and δ = 0 everywhere is 0/0")


def without_errors(mix):
    """A buffer with ε = 0 and no error anywhere."""
    return with_errors(RecencyReplay(3, 1, mix=mix, priority_offset=0.0), np.zeros(3))


@control("R11")
def test_control_all_zero_is_no_distribution():
    """With β = 1 Eq. 11 reads 0/0 there."""
    with pytest.raises(ValueError, match="every priority is 0"):
        without_errors(mix=1.0).probabilities()


@control("R11")
def test_control_a_little_recency_is_enough():
    """With β = 0.99 the newest has p^time = 1."""
    assert without_errors(mix=0.99).probabilities().sum() == pytest.approx(1)


def with_a_new_one(replay, old_deltas):
    """The replay with transitions of these TD errors, and one that is new, in the last slot."""
    return filled(with_errors(replay, old_deltas), [0])


@claim("R13")
@given(st.lists(st.floats(-100, 100), min_size=1, max_size=8))
def test_a_new_transition_enters_at_the_top(old_deltas):
    """With the largest TD priority seen so far, as the package does it (D4), none is drawn more."""
    P = with_a_new_one(RecencyReplay(len(old_deltas) + 1, 1), old_deltas).probabilities()
    assert P[-1] >= P.max() * (1 - 1e-12)
    shows("as the text has it, none is drawn more")


def part_of_the_new_one(own_delta=None):
    """P of a new transition beside one of |δ| = 1, as it enters or after its own TD error has been
    noted.
    """
    replay = with_a_new_one(ProportionalReplay(2, 1), [1.0])
    if own_delta is not None:
        replay.update_priorities(np.array([1]), np.array([own_delta]))
    return replay.probabilities()[1]


@claim("R13")
def test_by_its_own_error_it_can_enter_anywhere():
    """Below the other one where its error is 0, above it where its error is larger."""
    small, large = 0.0, 10.0
    top, bottom, above = (part_of_the_new_one(own) for own in (None, small, large))
    assert bottom < top < above and top == pytest.approx(1 / 2, abs=0.01)
    shows(
        "PER, beside one of |δ| = 1: {:.3f} maximal; by its own δ = {} {:.3f}, by δ = {} {:.3f}",
        *(top, small, bottom, large, above),
    )


@control("R13")
def test_control_with_the_largest_error_so_far_the_two_rules_agree():
    """Where its own |δ| equals the largest in the buffer, line 11 gives it the maximum as well."""
    assert part_of_the_new_one(own_delta=-1.0) == part_of_the_new_one()


def ending(name, action):
    """(terminated, truncated, last observation) of an episode whose actions are a function of the
    observation.
    """
    env = make(name)
    s, _ = env.reset(seed=0)
    terminated = truncated = False
    while not (terminated or truncated):
        s, _, terminated, truncated, _ = env.step(action(s))
    return terminated, truncated, s


@claim("R15")
@pytest.mark.parametrize("name", ["cartpole", "hopper"])
def test_done_can_be_a_failure(name):
    """Pushed left the pole falls, left alone the hopper does."""
    terminated, truncated, _ = ending(name, lambda s: 0)
    assert (terminated, truncated) == (True, False)
    shows("CartPole and Hopper end by a fall")


@claim("R15")
@pytest.mark.parametrize("name", ["mountaincar", "acrobot"])
def test_done_can_be_the_clock(name):
    """Doing nothing takes neither to its goal, and there y must bootstrap."""
    terminated, truncated, _ = ending(name, lambda s: 1)
    assert (terminated, truncated) == (False, True)
    r, q_next = np.array([-1.0]), np.full((1, 2), -50.0)
    y, cut = (td_target(r, np.array([end]), q_next, 0.99)[0] for end in (terminated, True))
    assert y < cut == r
    shows(
        "doing nothing ends MountainCar and Acrobot by the clock, where y = {} must not be {}",
        y,
        cut,
    )


@control("R15")
def test_control_on_mountaincar_a_termination_is_the_goal():
    """Pushing the way the car moves takes it to the flag at 0.5, and that is what terminates."""
    terminated, truncated, s = ending("mountaincar", lambda s: 2 if s[1] >= 0 else 0)
    assert (terminated, truncated) == (True, False) and s[0] >= 0.5

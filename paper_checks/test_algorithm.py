"""Algorithm 1 and its target networks: what it bootstraps with, what it acts by, and what it adds
at the end.

The agents are the package's GBDQN with a linear network on one-hot states, a table that converges
in a second.
"""

from fractions import Fraction as F

import numpy as np
import paper
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows
from worlds import (
    GAMMA_99,
    NEW_REWARDS,
    NEXT,
    ONE_HOT,
    TRIANGLE_GAMMA,
    column,
    funnel,
    loop,
    one_hot_agent,
    row,
    triangle,
)

from gbdqn_ref.bellman import loss_gradient, softmax_policy, td_target
from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.optim import Adam, clip_by_norm, polyak

TOLERANCE = 2e-3


def ensemble_agent(seed, alphas, **reading):
    """An agent with random frozen boosters of these α, a random learner in training and a random
    target of it.
    """
    agent = one_hot_agent(seed=seed, **reading)
    for alpha in alphas:
        agent.ensemble.add(agent.net.init(agent.rng), alpha)
    agent.theta, agent.theta_target = agent.net.init(agent.rng, k=2)
    agent.alpha = 0.5
    return agent


def targets_used(agent, updates=1):
    """The y of each training step on one transition, from state 0 by action 1 to 2: learn() returns
    y − Q(s, a).
    """
    agent.observe(ONE_HOT[0], 1, 1.0, ONE_HOT[2], False)
    return [agent.q(ONE_HOT[0])[1] + agent.learn()[0] for _ in range(updates)]


def target_predictions(agent, alphas):
    """α_j Q̄_j(s′, ·) of every member, (m, A): a frozen one is its own target (D3), the learner has
    θ̄.
    """
    members = zip([*alphas, agent.alpha], [*agent.ensemble.theta, agent.theta_target], strict=True)
    return np.array([alpha * agent.net.forward(theta, ONE_HOT)[0][2] for alpha, theta in members])


@claim("P2")
@given(st.integers(0, 10**6), st.lists(st.floats(-2, 2), max_size=3))
def test_the_target_is_the_maximum_of_the_sum_of_targets(seed, alphas):
    """The y of a training step is r + γ max_a' Σ α_j Q̄_j(s', a')."""
    agent = ensemble_agent(seed, alphas, target="live")
    q_next = target_predictions(agent, alphas).sum(0)
    assert targets_used(agent) == pytest.approx([1 + TRIANGLE_GAMMA * q_next.max()], abs=1e-4)
    shows("y = r + γ max Σ α_j Q̄_j in training steps of GB-DQN, random ensembles of up to four")


@control("P2")
def test_control_the_sum_of_the_maxima_is_another_target():
    """Where the members prefer different actions the sum of their maxima is larger."""
    agent = ensemble_agent(0, [1.0], target="live")
    agent.alpha, agent.ensemble.theta[:], agent.theta_target[:] = 1.0, 0, 0
    for theta, action in ((agent.ensemble.theta[0], 0), (agent.theta_target, 1)):
        (_, bias), *_ = agent.net.unpack(theta)
        bias[action] = 1
    maxima = target_predictions(agent, [1.0]).max(-1).sum()
    assert targets_used(agent)[0] + 0.5 < 1 + TRIANGLE_GAMMA * maxima


def with_and_without_noise(target, updates=50):
    """(y of the training steps, θ after them), and the same where the learner's target network
    began elsewhere.
    """
    runs = []
    for noise in (0, 1):
        agent = ensemble_agent(0, [1.0], target=target)
        agent.theta_target += noise
        runs.append((targets_used(agent, updates), agent.theta))
    return runs


@claim("P3")
def test_the_target_stands_still():
    """y has only Q̄_{m−1}, all of whose members are frozen, and nothing depends on θ̄_m."""
    (y, theta), (noisy_y, noisy_theta) = with_and_without_noise("frozen")
    np.testing.assert_allclose(y, y[0], atol=1e-6)
    assert y == noisy_y
    assert np.array_equal(theta, noisy_theta)
    shows(
        "frozen reading: {} updates leave y as it was, and noise in θ̄_m changes no bit of θ_m",
        len(y),
    )


@control("P3")
def test_control_a_live_target_varies():
    """Where y has Q̄_m it moves while h_m learns, and θ̄_m matters."""
    (y, theta), (noisy_y, noisy_theta) = with_and_without_noise("live")
    assert np.ptp(y) > 0.1
    assert np.abs(np.subtract(y, noisy_y)).max() > 0.1
    assert np.abs(theta - noisy_theta).max() > 0.01


STATE, OLD, NEW = np.ones(1, np.float32), (0, 0), (0, 1)


def drifted_bandit(target):
    """One state, whose actions end the episode; Q = 0 was right when the rewards drift from OLD to
    NEW.
    """
    agent = one_hot_agent(
        states=1, target=target, loss_on="h", alpha=1.0, behaviour="softmax", temperature=1.0
    )
    agent.theta[:] = 0
    assert agent.q(STATE).tolist() == list(OLD)
    agent.on_drift("drift")
    for action, reward in enumerate(NEW):
        agent.observe(STATE, action, float(reward), STATE, True)
    return agent


def policies(agent, updates):
    """π(better action) before each of so many updates, and after the last."""
    found = []
    for _ in range(updates):
        found.append(better(agent))
        agent.learn()
    return [*found, better(agent)]


def better(agent):
    """π(better action) of softmax with τ = 1."""
    return softmax_policy(agent.q(STATE).astype(float), 1.0)[1]


@claim("A1")
def test_the_policy_waits_for_the_last_line():
    """The booster has found the new rewards, and still both actions are equally likely until it is
    folded in.
    """
    agent, updates = drifted_bandit("frozen"), 600
    during = set(policies(agent, updates))
    assert during == {0.5}
    np.testing.assert_allclose(agent.net.forward(agent.theta, STATE[None])[0][0], NEW, atol=0.002)
    agent = agent.finish()
    folded = better(agent)
    assert folded == pytest.approx(1 / (1 + np.exp(-1)), abs=1e-3)
    shows(
        "two actions, r ({}) → ({}): π(better) is {:/} in all {} updates, h_m has long"
        " converged; folded in {:.3f}",
        *(OLD, NEW, during.pop(), updates, folded),
    )


def test_the_agent_acts_by_that_policy():
    """Of 2,000 actions about half are the better one, though h_m has converged."""
    agent = drifted_bandit("frozen")
    policies(agent, 600)
    assert np.mean([agent.act(STATE) for _ in range(2000)]) == pytest.approx(0.5, abs=0.05)


@control("A1")
def test_control_a_live_agent_acts_by_what_it_learns():
    """With Q_m in the policy the better action becomes the more likely one during the stage."""
    during = policies(drifted_bandit("live"), 600)
    assert during[0] == 0.5 and during[-1] == pytest.approx(1 / (1 + np.exp(-1)), abs=1e-3)


def one_call(steps=4000, look=ONE_HOT, every=1, **settings):
    """(Q_{m−1}, Q_m, the MDP) of one call of Algorithm 1: its own behaviour, replay, priorities and
    weights. States look like the rows of `look`. The first pair pays its reward of 1 for `every` so
    many visits together, at one of them.
    """
    reading = {"target": "frozen", "loss_on": "h", "alpha": 1.0}
    agent = one_hot_agent(behaviour="softmax", **{"replay": "recency"} | reading | settings)
    agent.on_drift("drift")  # Q_{m−1} is a random network
    before, s, visits = agent.q(look), 0, 0
    for _ in range(steps):
        a, r = agent.act(look[s]), 0
        visits += (s, a) == (0, 0)
        if (s, a) != (0, 0) or visits % every == 0:
            r = NEW_REWARDS[s, a] * (every if (s, a) == (0, 0) else 1)
        agent.observe(look[s], a, r, look[NEXT[s, a]], False)
        agent.learn()
        s = NEXT[s, a]
    agent = agent.finish()
    return before, agent.q(look), triangle(NEW_REWARDS)


@claim("A2")
def test_one_call_is_one_backup():
    """Where the fit is exact it is the same under all positive weights, so behaviour and replay
    drop out.
    """
    steps = 4000
    before, after, mdp = one_call(steps)
    np.testing.assert_allclose(after, mdp.bellman(before), atol=TOLERANCE)
    shows(
        "{} steps by softmax with recency and PER on {} states and {} actions: Q_m = 𝒯Q_{{m−1}} to"
        " {}",
        *(steps, *NEXT.shape, TOLERANCE),
    )


@control("A2")
def test_control_a_live_call_is_no_backup():
    """With the same actions, replay and weights a live target ends at Q*, not at the backup."""
    before, after, mdp = one_call(target="live")
    np.testing.assert_allclose(after, mdp.q_star(), atol=TOLERANCE)
    assert np.abs(after - mdp.bellman(before)).max() > 100 * TOLERANCE


@control("A2")
def test_control_with_two_outcomes_a_call_is_no_backup():
    """One pair pays 10 at every tenth visit instead of 1 at each. By |δ| alone the fit is more than
    2 above the backup; uniform draws fit the mean, so it is the draws that matter.
    """
    by_error = {"mix": 1.0, "is_exponent": 0.0}
    for draws, low, high in ((by_error, 2, 9), ({"replay": "uniform"}, -0.3, 0.3)):
        before, after, mdp = one_call(every=10, **draws)
        assert low < (after - mdp.bellman(before))[0, 0] < high


@control("A2")
def test_control_where_two_states_look_alike_a_call_is_no_backup():
    """One row of the table for two states: the fit has to lie between two residuals."""
    look = ONE_HOT[[0, 0, 2]]
    before, after, mdp = one_call(look=look)
    assert np.abs(after - mdp.bellman(before)).max() > 100 * TOLERANCE


def fitted_next(next_states):
    """The targets y of the six transitions of the triangle where these states come next, (3, 2)."""
    Q = np.arange(6.0).reshape(3, 2) ** 2
    terminated = np.zeros(NEXT.size, bool)
    y = td_target(NEW_REWARDS.ravel(), terminated, Q[np.ravel(next_states)], TRIANGLE_GAMMA)
    return y.reshape(NEXT.shape), triangle(NEW_REWARDS).bellman(Q)


@claim("A8")
def test_with_the_current_next_state_every_target_has_the_same_value():
    """At the moment the agent is in state 2, so y_i − r_i is γ max Q(2, ·) for all six samples."""
    y, backup = fitted_next(np.full(NEXT.shape, 2))
    printed, right = (np.unique((each - NEW_REWARDS).round(9)) for each in (y, backup))
    assert len(printed) == 1 < len(right) and abs(y - backup).max() > 1
    shows(
        "{} samples, the agent in state {}: y_i − r_i is {:.3g} for all, and by s′_i {:.3g}",
        *(NEXT.size, NEXT.max(), printed, right),
    )


@claim("A8")
def test_with_its_own_next_state_every_target_is_the_backup():
    """y_i is (𝒯Q)(s_i, a_i)."""
    y, backup = fitted_next(NEXT)
    np.testing.assert_allclose(y, backup)
    shows("with s′_i instead y_i = (𝒯Q)(s_i, a_i) on all {} pairs", NEXT.size)


@control("A8")
def test_control_for_the_transition_just_stored_both_are_the_same():
    """Its s′_i is the current s′: where all samples lead there, line 16 is right as printed."""
    mdp, Q = funnel(1, 2, F(1, 2)), column(3, 5)
    y = td_target(mdp.r[:, 0], np.zeros(2, bool), np.broadcast_to(Q[1], (2, 1)), mdp.gamma)
    assert (y == mdp.bellman(Q)[:, 0]).all()


def left_by_steps(residual, h, eta):
    """(α, Σ (r − α h)²) for the closed form, η in its place, and η times it."""
    closed = closed_form_alpha(residual, h)
    alphas = [closed, eta, eta * closed]
    return alphas, [((residual - alpha * h) ** 2).sum() for alpha in alphas]


@claim("A3")
def test_three_step_sizes_fit_the_last_line():
    """With a booster that fits only in part, the three leave different residuals."""
    residual, h, eta = np.array([2.0, -1.0]), np.array([1.0, 1.0]), paper.SHRINKAGE
    (closed, shrunk, product), left = left_by_steps(residual, h, eta)
    assert len(set(left)) == 3
    shows(
        "r = ({}), h = ({}): α = {:/}, {} or {}, and Σ (r − α h)² falls from {} to {}, {} or {}",
        *(residual, h, closed, shrunk, product, (residual**2).sum(), *left),
    )


@control("A3")
@given(st.lists(st.floats(-100, 100).filter(lambda x: abs(x) > 1e-3), min_size=1, max_size=8))
def test_control_two_of_them_agree_where_the_fit_is_exact(residual):
    """With h = r Eq. 8 gives 1, so η in its place and η times it are the same step."""
    residual = np.array(residual)
    (_, shrunk, product), _ = left_by_steps(residual, residual, paper.SHRINKAGE)
    assert shrunk == pytest.approx(product, rel=1e-12)


def learners_after(*events):
    """How many networks GB-DQN has after these events; None is an update."""
    agent = drifted_bandit("frozen")
    for event in events:
        agent.on_drift(event) if event else agent.learn()
    return len(agent.ensemble) + 1


@claim("A4")
def test_a_booster_is_added_per_drift():
    """As in the experiments: no update and no return to the stock physics adds one."""
    updates = [None] * 50
    first = learners_after()  # the first network, and the booster of the first drift
    assert first == 2 == learners_after(*updates, "reset")
    learners = learners_after("drift", *updates, "drift", "reset", None)
    assert learners == first + 2
    shows("{} drifts and a reset: 1 + {} learners", first + 1, learners - 1)


@claim("A4")
def test_a_backup_per_drift_is_not_one_per_episode():
    """On one loop, what is left of an error of 1 after 3 and after 600 backups."""
    mdp, Q, errors, counts = loop(0, GAMMA_99), row(1), [], (3, 600)
    for _ in range(max(counts)):
        Q = mdp.bellman(Q)
        errors.append(Q.item())
    left = [errors[count - 1] for count in counts]
    assert left == [GAMMA_99**count for count in counts]
    shows(
        "on one loop 𝒯^{} leaves {:.3f} of 1, 𝒯^{} {:.4f}",
        *(counts[0], left[0], counts[1], left[1]),
    )


@control("A4")
def test_control_told_of_a_drift_at_each_iteration_it_adds_one_each():
    """It is the event that counts: told so each time, it adds a booster each time."""
    assert learners_after(*["drift", None] * 10) == learners_after() + 10


def gap_left(episode_length, steps=1000, tau=0.01):
    """The part of θ − θ̄ that is left after so many steps of Algorithm 1's inner loop, where θ
    stands still.
    """
    theta, theta_target = np.ones(1), np.zeros(1)
    for step in range(1, steps + 1):
        if step % episode_length == 0:
            continue  # done: line 23 leaves the loop before line 26 comes
        polyak(theta_target, theta, tau)
    return 1 - theta_target.item()


@claim("A5")
def test_the_last_step_of_an_episode_updates_no_target():
    """The shorter the episodes, the more of the gap is left."""
    lengths, steps, tau = (1, 2, 200), 1000, 0.01
    left = [gap_left(length, steps, tau) for length in lengths]
    updates = [steps - steps // length for length in lengths]
    assert left == pytest.approx([(1 - tau) ** count for count in updates], rel=1e-9)
    shows(
        "τ = {}, {} steps, episodes of {}, {} and {} steps: of the gap {:.3g} is left",
        *(tau, steps, *lengths, left),
    )


def test_ours_moves_the_target_at_each_update():
    """Also where the episode ends there (D9)."""
    agent = drifted_bandit("live")  # all of its transitions end the episode
    before = agent.theta_target.copy()
    agent.learn()
    np.testing.assert_allclose(agent.theta_target, 0.9 * before + 0.1 * agent.theta, atol=1e-7)
    assert not np.array_equal(agent.theta_target, before)


@control("A5")
def test_control_in_an_episode_that_does_not_end_no_update_is_lost():
    """An episode longer than the run has all 1,000 updates."""
    assert gap_left(1001) == pytest.approx(0.99**1000)


def adam_path(grads, scale, max_norm=None):
    """θ after Adam's steps along these gradients, scaled, and clipped if max_norm is given."""
    theta, adam = np.zeros(2), Adam(2, lr=0.1)
    for grad in scale * grads:
        adam.step(theta, grad if max_norm is None else clip_by_norm(grad, max_norm))
    return theta


@claim("A6")
@given(st.integers(1, 64), st.integers(0, 10**6))
def test_the_printed_gradient_is_2n_times_ours(n, seed):
    """Of Σ w e² against the mean of ½ w e²."""
    error, weight = np.random.default_rng(seed).uniform(0.1, 10, (2, n))
    ours = loss_gradient(error, weight, np.zeros(n, int), 1)[:, 0]
    np.testing.assert_allclose(-2 * weight * error, 2 * n * ours)
    shows("gradients 2n times as long")


@claim("A6")
@given(st.lists(st.tuples(*[st.floats(0.1, 10)] * 2), min_size=1, max_size=10))
def test_adam_does_not_see_the_scale_of_the_loss(grads):
    """Adam's step is m̂/(√v̂ + ε), and m̂ and √v̂ both scale with the gradient."""
    grads, n, tolerance = np.array(grads), 64, 1e-6
    np.testing.assert_allclose(adam_path(grads, 2 * n), adam_path(grads, 1), atol=tolerance)
    shows("with n = {} Adam's path is the same to {:f} all the same", n, tolerance)


@control("A6")
def test_control_clipping_sees_it():
    """Norms of 5 and ½ are within 10, and 128 times as long ones are both cut to 10."""
    grads = np.array([[3.0, 4.0], [-0.3, -0.4]])
    apart = adam_path(grads, 128, max_norm=10) - adam_path(grads, 1, max_norm=10)
    assert np.abs(apart).max() > 0.05

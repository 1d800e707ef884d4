"""Algorithm 1 and its target networks: what it bootstraps with, what it acts by, and what it adds
at the end.

The agents are the package's GBDQN with a linear network on one-hot states, a table that converges
in a second.
"""

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
    loop,
    one_hot_agent,
    row,
    triangle,
)

from gbdqn_ref.bellman import loss_gradient, softmax_policy
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


def one_call(target, steps=4000, lottery=1):
    """(Q_{m−1}, Q_m, the MDP) of one call of Algorithm 1: its own behaviour, replay, priorities and
    weights. The reward of 1 of the first pair is paid as a lottery, so many times as much once in
    so many times.
    """
    agent = one_hot_agent(
        target=target, loss_on="h", alpha=1.0, behaviour="softmax", replay="recency"
    )
    agent.on_drift("drift")  # Q_{m−1} is a random network
    before, s, rng = agent.q(ONE_HOT), 0, np.random.default_rng(0)
    for _ in range(steps):
        a = agent.act(ONE_HOT[s])
        r = NEW_REWARDS[s, a] if s or a else lottery * (rng.random() < 1 / lottery)
        agent.observe(ONE_HOT[s], a, r, ONE_HOT[NEXT[s, a]], False)
        agent.learn()
        s = NEXT[s, a]
    agent = agent.finish()
    return before, agent.q(ONE_HOT), triangle(NEW_REWARDS)


@claim("A2")
def test_one_call_is_one_backup():
    """Where the fit is exact it is the same under all positive weights, so behaviour and replay
    drop out.
    """
    steps = 4000
    before, after, mdp = one_call("frozen", steps)
    np.testing.assert_allclose(after, mdp.bellman(before), atol=TOLERANCE)
    shows(
        "{} steps by softmax with recency and PER on {} states and {} actions: Q_m = 𝒯Q_{{m−1}} to"
        " {}",
        *(steps, *NEXT.shape, TOLERANCE),
    )


@control("A2")
def test_control_a_live_call_is_no_backup():
    """With the same actions, replay and weights a live target ends at Q*, not at the backup."""
    before, after, mdp = one_call("live")
    np.testing.assert_allclose(after, mdp.q_star(), atol=TOLERANCE)
    assert np.abs(after - mdp.bellman(before)).max() > 100 * TOLERANCE


@control("A2")
def test_control_with_two_outcomes_a_call_is_no_backup():
    """Where one pair pays 2 half of the time instead of 1, the fit is not its mean (R2)."""
    before, after, mdp = one_call("frozen", lottery=2)
    assert abs(after - mdp.bellman(before))[0, 0] > 50 * TOLERANCE


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

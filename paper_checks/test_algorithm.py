"""Algorithm 1 and its target networks: what it bootstraps with, what it acts by, and what it adds
at the end.

The agents are the package's GBDQN with a linear network on one-hot states, a table that converges
in a second.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.bellman import loss_gradient, softmax_policy
from gbdqn_ref.boosting import closed_form_alpha
from gbdqn_ref.config import Config
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.optim import Adam, clip_by_norm, polyak
from gbdqn_ref.replay import importance_weights, td_priority
from gbdqn_ref.tabular import MDP

STATES, ACTIONS, GAMMA = 3, 2, 0.8
NEXT = np.array([[1, 2], [2, 0], [0, 1]])  # deterministic: where action a leads from state s
REWARDS = np.array([[1.0, -1.0], [0.0, 2.0], [0.3, -0.5]])
EYE = np.eye(STATES, dtype=np.float32)
TOLERANCE = 2e-3


def new_agent(seed=0, states=STATES, **reading):
    settings = dict(
        agent="gbdqn", replay="uniform", hidden=(), capacity=500, lr=0.02, tau=0.1, gamma=GAMMA
    )
    return GBDQN(states, ACTIONS, Config(**settings | reading), np.random.default_rng(seed))


def ensemble_agent(seed, alphas, **reading):
    """An agent with random frozen boosters of these α, a random learner in training and a random
    target of it.
    """
    agent = new_agent(seed, **reading)
    for alpha in alphas:
        agent.ensemble.add(agent.net.init(agent.rng), alpha)
    agent.theta, agent.theta_target = agent.net.init(agent.rng, k=2)
    agent.alpha = 0.5
    return agent


def targets_used(agent, updates=1):
    """The y of each training step on one transition, from state 0 by action 1 to 2: learn() returns
    y − Q(s, a).
    """
    agent.observe(EYE[0], 1, 1.0, EYE[2], False)
    return [agent.q(EYE[0])[1] + agent.learn()[0] for _ in range(updates)]


@claim(
    "P2",
    place="section Ensemble Target Networks",
    says=(
        "the target of the ensemble is the weighted sum of its members' targets, and the maximum of"
        " that sum counts"
    ),
    verdict="holds",
    uses="gbdqn.GBDQN.learn, boosting.Ensemble.add",
)
@given(st.integers(0, 10**6), st.lists(st.floats(-2, 2), max_size=3))
def test_the_target_is_the_maximum_of_the_sum_of_targets(seed, alphas):
    """y = r + γ max_a' Σ α_j Q̄_j(s', a'). A frozen member is its own target (D3); the learner's
    has parameters θ̄.
    """
    agent = ensemble_agent(seed, alphas, target="live")
    members = zip([*alphas, agent.alpha], [*agent.ensemble.theta, agent.theta_target], strict=True)
    q_next = sum(alpha * agent.net.forward(theta, EYE)[0][2] for alpha, theta in members)
    assert targets_used(agent) == pytest.approx([1 + GAMMA * q_next.max()], abs=1e-4)
    shows("y = r + γ max Σ α_j Q̄_j in training steps of GB-DQN, random ensembles of up to four")


@control("P2")
def test_control_the_sum_of_the_maxima_is_another_target():
    """Negative control: Q̄_1 = (1, 0), Q̄_2 = (0, 1): the sum has the maximum 1, the maxima would
    have the sum 2.
    """
    agent = ensemble_agent(0, [1.0], target="live")
    agent.alpha, agent.ensemble.theta[:], agent.theta_target[:] = 1.0, 0, 0
    for theta, action in ((agent.ensemble.theta[0], 0), (agent.theta_target, 1)):
        (_, bias), *_ = agent.net.unpack(theta)
        bias[action] = 1
    y = targets_used(agent)
    assert y == pytest.approx([1 + GAMMA * 1], abs=1e-6)
    assert y != pytest.approx([1 + GAMMA * 2], abs=0.5)


def with_and_without_noise(target):
    """(y of 50 training steps, θ after them), and the same where the learner's target network began
    elsewhere.
    """
    runs = []
    for noise in (0, 1):
        agent = ensemble_agent(0, [1.0], target=target)
        agent.theta_target += noise
        runs.append((targets_used(agent, updates=50), agent.theta))
    return runs


@claim(
    "P3",
    place="section Ensemble Target Networks",
    says="residuals are learnt against a bootstrap target that varies slowly",
    verdict=(
        "fails: in Algorithm 1 it stands still, and the target network of h_m is kept up but never"
        " asked"
    ),
    uses="gbdqn.GBDQN.learn",
)
def test_the_target_stands_still():
    """y has only Q̄_{m−1}, all of whose members are frozen: Polyak averaging has nothing to follow
    in them (D3).

    A target of theirs that still lags behind closes its gap by (1 − τ)^k, as P1 says, whatever is
    learnt.
    """
    (y, theta), (noisy_y, noisy_theta) = with_and_without_noise("frozen")
    np.testing.assert_allclose(y, y[0], atol=1e-6)
    assert y == noisy_y
    assert np.array_equal(theta, noisy_theta)
    shows("frozen reading: 50 updates leave y as it was, and noise in θ̄_m changes no bit of θ_m")


@control("P3")
def test_control_a_live_target_varies():
    """Negative control: where y has Q̄_m it moves while h_m learns, and θ̄_m matters."""
    (y, theta), (noisy_y, noisy_theta) = with_and_without_noise("live")
    assert np.ptp(y) > 0.1
    assert np.abs(np.subtract(y, noisy_y)).max() > 0.1
    assert np.abs(theta - noisy_theta).max() > 0.01


def drifted_bandit(target):
    """One state, whose actions end the episode; Q = 0 was right when the rewards drift from (0, 0)
    to (0, 1).
    """
    agent = new_agent(
        states=1, target=target, loss_on="h", alpha=1.0, behaviour="softmax", temperature=1.0
    )
    agent.theta[:] = 0
    agent.on_drift("drift")
    for action in (0, 1):
        agent.observe(np.ones(1), action, float(action), np.ones(1), True)
    return agent


def policy(agent):
    return softmax_policy(agent.q(np.ones(1, np.float32)).astype(float), 1.0)


def learnt(agent):
    return agent.net.forward(agent.theta, np.ones((1, 1), np.float32))[0][0]


@claim(
    "A1",
    place="Algorithm 1, line 7",
    says="while a booster learns, the agent acts better",
    verdict=(
        "fails: it acts by Q_{m−1}, so nothing that is learnt after a drift changes an action"
        " before the next one"
    ),
    uses="gbdqn.GBDQN, bellman.softmax_policy",
)
def test_the_policy_waits_for_the_last_line():
    """The booster has found the new rewards, and still both actions are equally likely until it is
    folded in.
    """
    agent = drifted_bandit("frozen")
    for _ in range(600):
        assert policy(agent).tolist() == [0.5, 0.5]
        agent.learn()
    np.testing.assert_allclose(learnt(agent), [0, 1], atol=TOLERANCE)
    actions = [agent.act(np.ones(1, np.float32)) for _ in range(2000)]
    assert np.mean(actions) == pytest.approx(0.5, abs=0.05)
    agent.on_drift("end")
    assert policy(agent)[1] == pytest.approx(1 / (1 + np.exp(-1)), abs=1e-3)
    shows(
        "two actions, r (0, 0) → (0, 1): π(better) is ½ in all 600 updates, h_m has long converged;"
        " folded in 0.731"
    )


@control("A1")
def test_control_a_live_agent_acts_by_what_it_learns():
    """Negative control: with Q_m in the policy the better action is the more likely one during the
    stage.
    """
    agent = drifted_bandit("live")
    for _ in range(600):
        agent.learn()
    assert policy(agent)[1] == pytest.approx(1 / (1 + np.exp(-1)), abs=1e-3)


def one_call(target):
    """(Q_{m−1}, Q_m, the MDP) of one call of Algorithm 1: its own behaviour, replay, priorities and
    weights.
    """
    agent = new_agent(target=target, loss_on="h", alpha=1.0, behaviour="softmax", replay="recency")
    agent.on_drift("drift")  # Q_{m−1} is a random network
    before, s = agent.q(EYE), 0
    for _ in range(4000):
        a = agent.act(EYE[s])
        agent.observe(EYE[s], a, REWARDS[s, a], EYE[NEXT[s, a]], False)
        agent.learn()
        s = NEXT[s, a]
    agent.on_drift("end")
    return before, agent.q(EYE), MDP(EYE[NEXT], REWARDS, GAMMA)


@claim(
    "A2",
    place="Algorithm 1",
    says=(
        "what one call of it makes of Q, with its own actions, priorities and weights: one Bellman"
        " backup"
    ),
    verdict=(
        "holds if every pair is visited, h_m can fit them all and each has one outcome: no weight"
        " matters then"
    ),
    uses="gbdqn.GBDQN, replay.RecencyReplay, tabular.MDP.bellman",
)
def test_one_call_is_one_backup():
    """Where the fit is exact it is the same under all positive weights, so behaviour and replay
    drop out.
    """
    before, after, mdp = one_call("frozen")
    np.testing.assert_allclose(after, mdp.bellman(before), atol=TOLERANCE)
    shows(
        "4,000 steps by softmax with recency and PER on 3 states and 2 actions: Q_m = 𝒯Q_{m−1} to"
        " 0.002"
    )


@control("A2")
def test_control_a_live_call_is_no_backup():
    """Negative control: with the same actions, replay and weights a live target ends at Q*, not at
    the backup.
    """
    before, after, mdp = one_call("live")
    np.testing.assert_allclose(after, mdp.q_star(), atol=TOLERANCE)
    assert np.abs(after - mdp.bellman(before)).max() > 100 * TOLERANCE


@control("A2")
@pytest.mark.parametrize(("is_exponent", "fitted"), [(0.0, 8.752), (0.5, 4.689), (1.0, 1.0)])
def test_control_with_two_outcomes_the_priorities_bias_the_backup(is_exponent, fitted):
    """Negative control: y = 0 nine times in ten and 10 once, Q_{m−1} = 0: the backup is 1, and the
    fit is not.

    Drawn by P and weighted by w, the booster learns Σ P w y / Σ P w.
    """
    y = np.array([0.0] * 9 + [10.0])
    p = td_priority(y, 0.01, 0.6)
    P = p / p.sum()
    w = importance_weights(P, len(P), is_exponent, None)
    assert (P * w * y).sum() / (P * w).sum() == pytest.approx(fitted, abs=1e-3)


def squares_left(residual, h, alpha):
    return float(((residual - alpha * h) ** 2).sum())


@claim(
    "A3",
    place="Algorithm 1, last line",
    says="the booster is added with the step size α_m",
    verdict=(
        "ambiguous: no line computes it; Eq. 8, the shrinkage 0.1 in its place and their product"
        " are three steps"
    ),
    uses="boosting.closed_form_alpha",
)
def test_three_step_sizes_fit_the_last_line():
    """With a booster that fits only in part, Σ (r − α h)² falls from 5 by 0.5, 0.18 or 0.095."""
    residual, h = np.array([2.0, -1.0]), np.array([1.0, 1.0])
    closed = closed_form_alpha(residual, h)
    left = [squares_left(residual, h, alpha) for alpha in (closed, 0.1, 0.1 * closed)]
    assert left == pytest.approx([4.5, 4.82, 4.905], abs=1e-12)
    shows(
        "r = (2, −1), h = (1, 1): α = ½, 0.1 or 0.05, and Σ (r − α h)² falls from 5 to 4.5, 4.82 or"
        " 4.905"
    )


@control("A3")
@given(st.lists(st.floats(-100, 100).filter(lambda x: abs(x) > 1e-3), min_size=1, max_size=8))
def test_control_two_of_them_agree_where_the_fit_is_exact(residual):
    """Negative control: with h = r Eq. 8 gives 1, so 0.1 in its place and 0.1 times it are the same
    step.
    """
    residual = np.array(residual)
    assert 0.1 * closed_form_alpha(residual, residual) == pytest.approx(0.1, rel=1e-12)


def learners_after(*events):
    agent = drifted_bandit("frozen")
    for event in events:
        agent.on_drift(event) if event else agent.learn()
    return len(agent.ensemble) + 1


@claim(
    "A4",
    place="section Gradient Boosted DQN",
    says="a booster is added when a drift is detected, and also: at each iteration",
    verdict=(
        "ambiguous: of an error of 1, three drifts leave 0.970, and 600 episodes as iterations"
        " 0.0024 (γ = 0.99)"
    ),
    uses="gbdqn.GBDQN.on_drift, gbdqn.GBDQN.learn, tabular.MDP.bellman",
)
def test_a_booster_per_drift_is_not_one_per_iteration():
    """GB-DQN adds one per drift, as in the experiments: no update and no return to the stock
    physics adds any.
    """
    assert learners_after() == 2  # the first one, and the booster of the first drift
    assert learners_after(*[None] * 50, "reset") == 2
    assert learners_after("drift", *[None] * 50, "drift", "reset", None) == 4
    mdp, Q, errors = MDP([[[1.0]]], [[0.0]], 0.99), np.ones((1, 1)), []
    for _ in range(600):
        Q = mdp.bellman(Q)
        errors.append(Q.item())
    assert [errors[2], errors[-1]] == pytest.approx([0.970299, 0.99**600], abs=1e-12)
    shows(
        f"three drifts and a reset: 1 + 3 learners. On one loop 𝒯³ leaves {errors[2]:.3f} of 1,"
        f" 𝒯⁶⁰⁰ {errors[-1]:.4f}"
    )


@control("A4")
def test_control_told_of_a_drift_at_each_iteration_it_adds_one_each():
    """Negative control: it is the event that counts, so the other reading is the same agent told so
    each time.
    """
    assert learners_after(*["drift", None] * 10) == 12


def gap_left(episode_length, steps, tau=0.01):
    """The part of θ − θ̄ that is left after so many steps of Algorithm 1's inner loop, where θ
    stands still.
    """
    theta, theta_target = np.ones(1), np.zeros(1)
    for step in range(1, steps + 1):
        if step % episode_length == 0:
            continue  # done: line 23 leaves the loop before line 26 comes
        polyak(theta_target, theta, tau)
    return 1 - theta_target.item()


@claim(
    "A5",
    place="Algorithm 1, lines 22–26",
    says="the target networks are updated at each step",
    verdict=(
        "fails: the break at the end of an episode comes first, so episodes of one step never"
        " update any"
    ),
    uses="optim.polyak, gbdqn.GBDQN.learn",
)
def test_the_last_step_of_an_episode_updates_no_target():
    """Ours moves the target at each update, also where the episode ends there (D9)."""
    left = [gap_left(length, 1000) for length in (1, 2, 200)]
    assert left == pytest.approx([1, 0.99**500, 0.99**995], rel=1e-9)
    agent = drifted_bandit("live")  # all of its transitions end the episode
    before = agent.theta_target.copy()
    agent.learn()
    np.testing.assert_allclose(agent.theta_target, 0.9 * before + 0.1 * agent.theta, atol=1e-7)
    assert not np.array_equal(agent.theta_target, before)
    shown = ", ".join(f"{part:.3g}" for part in left)
    shows(f"τ = 0.01, 1,000 steps, episodes of 1, 2 and 200 steps: of the gap {shown} is left")


@control("A5")
def test_control_in_long_episodes_it_hardly_matters():
    """Negative control: an episode as long as the run loses one update of 1,000, a factor of 1
    − τ.
    """
    assert gap_left(1000, 1000) == pytest.approx(gap_left(1001, 1000) / 0.99)


def adam_path(grads, scale, max_norm=None):
    theta, adam = np.zeros(2), Adam(2, lr=0.1)
    for grad in grads:
        grad = scale * grad
        adam.step(theta, grad if max_norm is None else clip_by_norm(grad, max_norm))
    return theta


@claim(
    "A6",
    place="Algorithm 1, lines 19–21",
    says="a loss without ½, and summed instead of averaged over the batch, trains alike",
    verdict=(
        "holds if Adam makes the step and no gradient is clipped; the descent of line 21 goes 2n"
        " times as far"
    ),
    uses="optim.Adam.step, bellman.loss_gradient",
)
@given(
    st.lists(st.tuples(*[st.floats(0.1, 10)] * 2), min_size=1, max_size=10),
    st.sampled_from([2, 128]),
)
def test_adam_does_not_see_the_scale_of_the_loss(grads, scale):
    """Adam's step is m̂/(√v̂ + ε), and m̂ and √v̂ both scale with the gradient: only ε tells."""
    grads = np.array(grads)
    error, weight = grads[:, 0], grads[:, 1]
    as_printed = -2 * weight * error  # of Σ w e²
    ours = loss_gradient(error, weight, np.zeros(len(error), int), 1)[:, 0]
    np.testing.assert_allclose(as_printed, 2 * len(error) * ours)
    np.testing.assert_allclose(adam_path(grads, scale), adam_path(grads, 1), atol=1e-6)
    shows("gradients 2n times as long; with n = 64 Adam's path is the same to 10⁻⁶ all the same")


@control("A6")
def test_control_clipping_sees_it():
    """Negative control: norms of 5 and ½ are within 10, and 128 times as long ones are both cut to
    10.
    """
    grads = np.array([[3.0, 4.0], [-0.3, -0.4]])
    assert (
        np.abs(adam_path(grads, 128, max_norm=10) - adam_path(grads, 1, max_norm=10)).max() > 0.05
    )

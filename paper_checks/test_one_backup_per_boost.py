"""Algorithm 1 to the letter makes one Bellman backup per booster; its live reading reaches the new
Q*. Checked with the package's agent.

The agent is GBDQN with a linear network on one-hot states, which is a table. Every (s, a) is in the
buffer once, so a converged booster is the exact least-squares fit, and a drift replaces the whole
buffer. What follows for perfect boosters is in test_perfect_boosters.py.
"""

from functools import cache

import numpy as np
import paper
import pytest
from ledger import claim, control, shows
from worlds import NEW_REWARDS, NEXT, OLD_REWARDS, ONE_HOT, loop, one_hot_agent, triangle

TOLERANCE = 2e-3


def live_through(agent, rewards, updates=4000):
    """Replace the buffer by every transition of the MDP with these rewards, and let the newest
    learner converge.
    """
    for s, a in np.ndindex(NEXT.shape):
        agent.observe(ONE_HOT[s], a, rewards[s, a], ONE_HOT[NEXT[s, a]], False)
    for _ in range(updates):
        agent.learn()


@cache  # a few checks look at the same run
def after_drift(drifts=1, **reading):
    """(Q when the first drift comes, Q when the last booster is folded in, how many members it has,
    the MDP after the last drift); each drift has rewards of its own.
    """
    agent = one_hot_agent(capacity=NEXT.size, **reading)
    live_through(agent, OLD_REWARDS)
    before = agent.q(ONE_HOT)
    for k in range(drifts):
        agent.on_drift("drift")
        live_through(agent, NEW_REWARDS + (drifts - 1 - k))
    agent = agent.finish()
    return before, agent.q(ONE_HOT), len(agent.ensemble), triangle(NEW_REWARDS)


def test_the_first_learner_is_a_dqn_and_reaches_the_old_optimum():
    """Before the first drift the agent has the old Q*."""
    before, *_ = after_drift(target="frozen", loss_on="h", alpha=1.0)
    np.testing.assert_allclose(before, triangle(OLD_REWARDS).q_star(), atol=TOLERANCE)


@claim("B1")
@pytest.mark.parametrize("alpha", [1.0, 0.1, "closed-form"])
def test_a_frozen_target_makes_one_damped_bellman_backup(alpha):
    """Q_m = (1 − α) Q_{m−1} + α 𝒯_new Q_{m−1}; the closed form finds α = 1, for the fit is
    exact.
    """
    before, after, _, mdp = after_drift(target="frozen", loss_on="h", alpha=alpha)
    step = 1.0 if alpha == "closed-form" else alpha
    np.testing.assert_allclose(after, before + step * mdp.residual(before), atol=TOLERANCE)
    shows(
        "GB-DQN trained to convergence on a table: Q_m = (1 − α) Q + α 𝒯Q; its error keeps 1 − α(1"
        " − γ) at worst"
    )


@control("B1")
def test_control_with_a_live_target_it_is_no_backup():
    """The same agent and the same data, and Q_m in the target."""
    before, after, _, mdp = after_drift(target="live", loss_on="h", alpha=1.0)
    assert np.abs(after - mdp.bellman(before)).max() > 100 * TOLERANCE


@control("B2")
@claim("B2")
def test_with_j_m_shrinkage_is_undone():
    """Q_m is the full backup, though α is below 1."""
    alpha = 0.5
    before, after, _, mdp = after_drift(target="frozen", loss_on="alpha_h", alpha=alpha)
    np.testing.assert_allclose(after, mdp.bellman(before), atol=TOLERANCE)
    shows("α = {}, a whole backup all the same", alpha)


@claim("B2")
def test_with_the_loss_on_h_the_step_is_shorter():
    """With the same α outside the loss, as in Algorithm 1, half of the backup."""
    alpha = 0.5
    before, after, _, mdp = after_drift(target="frozen", loss_on="h", alpha=alpha)
    np.testing.assert_allclose(after - before, alpha * mdp.residual(before), atol=TOLERANCE)
    assert np.abs(after - mdp.bellman(before)).max() > 100 * TOLERANCE
    shows("α = {} outside the loss: {:.0%} of the backup", alpha, alpha)


@claim("B3")
@pytest.mark.parametrize(
    "reading",
    [{"alpha": "closed-form", "loss_on": "h"}, {"alpha": 0.5, "loss_on": "alpha_h"}],
    ids=str,
)
def test_a_live_target_reaches_the_new_optimum_with_one_booster(reading):
    """Q' = 𝒯_new Q' is the fixed point of the stage, and its only one."""
    _, after, _, mdp = after_drift(target="live", **reading)
    np.testing.assert_allclose(after, mdp.q_star(), atol=TOLERANCE)
    shows("GB-DQN with a live target on a table reaches the new Q* with one booster")


@control("B3")
def test_control_a_live_target_with_the_loss_on_h_stops_short():
    """The fourth reading: Q' = (1 − η) Q_{m−1} + η 𝒯_new Q', the implicit Euler step."""
    eta = 0.5
    before, after, _, mdp = after_drift(target="live", alpha=eta, loss_on="h")
    np.testing.assert_allclose(after, (1 - eta) * before + eta * mdp.bellman(after), atol=TOLERANCE)
    assert np.abs(after - mdp.q_star()).max() > 100 * TOLERANCE


@claim("B4")
def test_three_boosters_are_three_backups():
    """One booster per drift, one backup under the rewards of each."""
    drifts = 3
    Q, after, members, _ = after_drift(drifts, target="frozen", loss_on="h", alpha=1.0)
    for k in range(drifts):
        Q = triangle(NEW_REWARDS + (drifts - 1 - k)).bellman(Q)
    np.testing.assert_allclose(after, Q, atol=drifts * TOLERANCE)
    assert members == 1 + drifts
    shows("Q_{} = 𝒯₃ 𝒯₂ 𝒯₁ Q_1 on a table, rewards other after each drift", members)


@claim("B4")
@pytest.mark.parametrize("eta", [1, paper.SHRINKAGE])
def test_what_three_backups_guarantee(eta):
    """On one loop without reward the error falls by exactly the guaranteed factor."""
    left = {step: loop_error(step) for step in (1, paper.SHRINKAGE)}
    assert left[eta] == pytest.approx((1 - eta * (1 - paper.GAMMA)) ** 3)
    shows(
        "guaranteed factors {}^3 = {:.6f} and, with η = {}, {}^3 = {:.6f}",
        *(paper.GAMMA, left[1], paper.SHRINKAGE),
        *(1 - paper.SHRINKAGE * (1 - paper.GAMMA), left[paper.SHRINKAGE]),
    )


def loop_error(eta, boosters=3):
    """What so many damped backups leave of an error of 1 on one loop without reward."""
    mdp, Q = loop(0, paper.GAMMA), np.ones((1, 1))
    for _ in range(boosters):
        Q = Q + eta * mdp.residual(Q)
    return float(Q.item())


@control("B4")
def test_control_with_a_live_target_the_first_booster_converges():
    """One drift is enough there, where three frozen ones leave an error."""
    _, frozen, _, mdp = after_drift(3, target="frozen", loss_on="h", alpha=1.0)
    _, live, _, _ = after_drift(1, target="live", loss_on="h", alpha=1.0)
    assert np.abs(frozen - mdp.q_star()).max() > 100 * TOLERANCE
    np.testing.assert_allclose(live, mdp.q_star(), atol=TOLERANCE)

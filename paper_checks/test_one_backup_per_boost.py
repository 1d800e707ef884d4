"""Algorithm 1 to the letter makes one Bellman backup per booster; its live reading reaches the new Q*.

The agent is the package's GBDQN with a linear network on one-hot states, which is a table. Every (s, a) is in the
buffer once, so a converged booster is the exact least-squares fit, and a drift replaces the whole buffer.
"""

import numpy as np
import pytest
from ledger import claim, control, shows

from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.tabular import MDP
from gbdqn_ref.train import Config

STATES, ACTIONS, GAMMA = 3, 2, 0.8
NEXT = np.array([[1, 2], [2, 0], [0, 1]])  # deterministic: where action a leads from state s
OLD_REWARDS = np.array([[0.0, 1.0], [0.5, 0.0], [-1.0, 0.2]])
NEW_REWARDS = np.array([[1.0, -1.0], [0.0, 2.0], [0.3, -0.5]])
TOLERANCE = 2e-3


def table(rewards):
    return MDP(np.eye(STATES)[NEXT], rewards, GAMMA)


def new_agent(**reading):
    config = Config(
        agent="gbdqn", replay="uniform", hidden=(), capacity=STATES * ACTIONS, lr=0.02, tau=0.1, gamma=GAMMA, **reading
    )
    return GBDQN(STATES, ACTIONS, config, np.random.default_rng(0))


def live_through(agent, rewards, updates=4000):
    """Replace the buffer by every transition of the MDP with these rewards, and let the newest learner converge."""
    one_hot = np.eye(STATES, dtype=np.float32)
    for s, a in np.ndindex(STATES, ACTIONS):
        agent.observe(one_hot[s], a, rewards[s, a], one_hot[NEXT[s, a]], False)
    for _ in range(updates):
        agent.learn()


def q_table(agent):
    return agent.q(np.eye(STATES, dtype=np.float32))


def after_drift(**reading):
    """(Q when the drift comes, Q when the booster that it added is folded in, the residuals' operator)."""
    agent = new_agent(**reading)
    live_through(agent, OLD_REWARDS)
    agent.on_drift("drift")
    before = q_table(agent)
    live_through(agent, NEW_REWARDS)
    agent.on_drift("end")
    return before, q_table(agent), table(NEW_REWARDS)


def test_the_first_learner_is_a_dqn_and_reaches_the_old_optimum():
    before, _, _ = after_drift(target="frozen", loss_on="h", alpha=1.0)
    np.testing.assert_allclose(before, table(OLD_REWARDS).q_star(), atol=TOLERANCE)


@claim(
    "B1",
    place="Algorithm 1",
    says="what a perfect booster of Algorithm 1 to the letter makes of Q: one Bellman backup, damped by α",
    verdict="holds",
    uses="gbdqn.GBDQN, tabular.MDP",
)
@pytest.mark.parametrize("alpha", [1.0, 0.1, "closed-form"])
def test_a_frozen_target_makes_one_damped_bellman_backup(alpha):
    """Q_m = (1 − α) Q_{m−1} + α 𝒯_new Q_{m−1}; the closed form finds α = 1, for the fit is exact."""
    before, after, mdp = after_drift(target="frozen", loss_on="h", alpha=alpha)
    step = 1.0 if alpha == "closed-form" else alpha
    np.testing.assert_allclose(after, before + step * mdp.residual(before), atol=TOLERANCE)
    shows("GB-DQN trained to convergence on a table: Q_m = (1 − α) Q + α 𝒯Q; its error keeps 1 − α(1 − γ) at worst")


@control("B1", "B4")
def test_control_one_backup_is_far_from_the_new_optimum():
    """Negative control: were a backup all there is to do, the check above would hold of any reading."""
    _, after, mdp = after_drift(target="frozen", loss_on="h", alpha=1.0)
    assert np.abs(after - mdp.q_star()).max() > 100 * TOLERANCE


@claim(
    "B2",
    place="Eq. 5",
    says="a shrinkage of η makes the steps smaller",
    verdict="fails: under the loss of Eq. 5, α h is fitted to the residual, so h = residual/α and α cancels",
    uses="gbdqn.GBDQN, tabular.MDP.bellman",
)
def test_with_j_m_shrinkage_is_undone():
    """Eq. 5 fits α h to the residual, so h = residual / α, and Q_m is the full backup whatever α is."""
    before, after, mdp = after_drift(target="frozen", loss_on="alpha_h", alpha=0.5)
    np.testing.assert_allclose(after, mdp.bellman(before), atol=TOLERANCE)
    shows("α = 0.5, a whole backup all the same")


@claim(
    "B3",
    place="Algorithm 1",
    says="one booster adapts Q to the new physics",
    verdict="holds if it bootstraps with the sum that it is part of: the stage's only fixed point is then the new Q*",
    uses="gbdqn.GBDQN, tabular.MDP.q_star",
)
@pytest.mark.parametrize(
    "reading", [{"alpha": "closed-form", "loss_on": "h"}, {"alpha": 0.5, "loss_on": "alpha_h"}], ids=str
)
def test_a_live_target_reaches_the_new_optimum_with_one_booster(reading):
    """Q' = 𝒯_new Q' is the fixed point of the stage, and its only one."""
    _, after, mdp = after_drift(target="live", **reading)
    np.testing.assert_allclose(after, mdp.q_star(), atol=TOLERANCE)
    shows("GB-DQN with a live target on a table reaches the new Q* with one booster")


@control("B2", "B3")
def test_control_a_live_target_with_the_loss_on_h_stops_short():
    """Negative control, and the fourth reading: Q' = (1 − η) Q_{m−1} + η 𝒯_new Q', the implicit Euler step."""
    eta = 0.5
    before, after, mdp = after_drift(target="live", alpha=eta, loss_on="h")
    np.testing.assert_allclose(after, (1 - eta) * before + eta * mdp.bellman(after), atol=TOLERANCE)
    assert np.abs(after - mdp.q_star()).max() > 100 * TOLERANCE


@claim(
    "B4",
    place="Algorithm 1",
    says="after the three drifts of the experiments, Algorithm 1 has converged",
    verdict="fails: three boosters are three backups, so at γ = 0.99 an error of 100 may still be 97.03, shrunk 99.70",
    uses="gbdqn.GBDQN, tabular.MDP.bellman",
)
def test_three_boosters_are_three_backups():
    """One booster per drift, three drifts: ‖Q − Q*‖∞ has fallen by γ³ at the most that is guaranteed."""
    agent = new_agent(target="frozen", loss_on="h", alpha=1.0)
    live_through(agent, OLD_REWARDS)
    mdp, Q = table(NEW_REWARDS), q_table(agent)
    for _ in range(3):
        agent.on_drift("drift")
        live_through(agent, NEW_REWARDS)
        Q = mdp.bellman(Q)
    agent.on_drift("end")
    np.testing.assert_allclose(q_table(agent), Q, atol=3 * TOLERANCE)
    assert len(agent.ensemble) == 4
    assert [100 * (1 - eta * (1 - 0.99)) ** 3 for eta in (1, 0.1)] == pytest.approx([97.0299, 99.7003], abs=1e-4)
    shows("Q_4 = 𝒯³ Q_1 on a table; guaranteed factors 0.99³ = 0.970299 and, with η = 0.1, 0.999³ = 0.997003")

"""GB-DQN among its kin: which reading of it was published before, and under which name.

Two worlds in which a drift changes the policy everywhere, ten rooms whose goal moves to the other
end; and twenty random MDPs of which half is redrawn. γ = 0.99. A booster here is a perfect fit, so
what is compared is how far news travels per booster, not how well a network learns.
"""

from fractions import Fraction as F
from functools import partial
from itertools import islice, pairwise

import numpy as np
import pytest
from kin import (
    GAMMA,
    boosted_curriculum,
    boosted_fqi,
    boosters,
    drifted,
    frozen,
    ideal_basis,
    iterated,
    krylov,
    live,
    moved_goal,
    plasticity_injection,
)
from ledger import claim, control, shows

from gbdqn_ref.config import Config
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.tabular import MDP

WALL, ABSORBING = False, True  # the two kinds of goal
SEEDS = range(20)
damped = partial(frozen, alpha=0.1)


def after(procedure, mdp, Q, boosts):
    return next(islice(procedure(mdp, Q), boosts - 1, None))


def exactly(mdp, Q):
    """The same MDP and Q in Fractions."""
    P, r, Q = (np.vectorize(F, otypes=[object])(x) for x in (mdp.P, mdp.r, Q.round(6)))
    return MDP(P, r, F(99, 100)), Q


@claim("K1")
@pytest.mark.parametrize("goal", [WALL, ABSORBING])
def test_algorithm_1_is_boosted_fitted_q_iteration(goal):
    mdp, Q = moved_goal(goal)
    world = exactly(mdp, Q)
    assert (after(frozen, *world, 6) == after(boosted_fqi, *world, 6)).all()
    counts = boosters(boosted_fqi, mdp, Q)
    assert counts == boosters(frozen, mdp, Q) == (18, 449)
    shows("ten rooms: the right policy after {} boosters, 1 % of the error after {}", *counts)


@control("K1")
@pytest.mark.parametrize(("goal", "counts"), [(WALL, (129, 4526)), (ABSORBING, (128, 4503))])
def test_control_with_shrinkage_it_is_another_procedure(goal, counts):
    mdp, Q = moved_goal(goal)
    world = exactly(mdp, Q)
    assert (
        after(partial(frozen, alpha=F(1, 10)), *world, 6) != after(boosted_fqi, *world, 6)
    ).any()
    assert boosters(damped, mdp, Q, most=4600) == counts


@claim("K2")
@pytest.mark.parametrize("seed", range(5))
def test_the_live_booster_is_the_value_of_the_error(seed):
    """One action per state: h is the value function of the MDP whose rewards are the residual."""
    rng = np.random.default_rng(seed)
    P, r, Q = rng.dirichlet(np.ones(5), size=(5, 1)), *rng.normal(size=(2, 5, 1))
    mdp = MDP(P, r, GAMMA)
    h = MDP(P, mdp.residual(Q), GAMMA).q_star()
    np.testing.assert_allclose(Q + h, next(live(mdp, Q)), atol=1e-8)
    np.testing.assert_allclose(Q + h, next(ideal_basis(mdp, Q)), atol=1e-8)
    shows("random chains of {} states: one booster, and no error", len(Q))


@control("K2")
def test_control_with_a_choice_of_actions_the_values_of_the_error_do_not_add_up():
    """Two actions: max(Q + h) is not max Q + max h, so the error's own Q* is no longer what is
    missing; a live target finds it, and evaluating the greedy policy takes ten rounds or eleven.
    """
    mdp, Q = moved_goal(ABSORBING)
    h = MDP(mdp.P, mdp.residual(Q), GAMMA).q_star()
    assert np.abs(Q + h - mdp.q_star()).max() > 50
    assert boosters(live, mdp, Q) == (1, 1)
    assert [boosters(ideal_basis, *moved_goal(goal)) for goal in (ABSORBING, WALL)] == [
        (9, 10),
        (10, 11),
    ]


@claim("K3")
@pytest.mark.parametrize("goal", [WALL, ABSORBING])
def test_the_live_reading_is_boosted_curriculum_rl(goal):
    """Fit k of 𝒯(Q + h) − Q makes 𝒯^k Q of Q + h, as k boosters do; its limit is the new Q*."""
    mdp, Q = moved_goal(goal)
    world = exactly(mdp, Q)
    assert (after(boosted_curriculum, *world, 6) == after(boosted_fqi, *world, 6)).all()
    fits = boosters(boosted_curriculum, mdp, Q)
    assert boosters(live, mdp, Q) == (1, 1) and fits == boosters(frozen, mdp, Q)
    np.testing.assert_allclose(
        after(boosted_curriculum, mdp, Q, 3000), next(live(mdp, Q)), atol=1e-9
    )
    shows("ten rooms: one booster, with {} fits inside it to the right policy, {} to 1 %", *fits)


@control("K3")
def test_control_if_the_booster_does_not_bootstrap_with_itself_one_is_not_enough():
    """The letter: 𝒯Q − Q in the place of 𝒯(Q + h) − Q, and no fit after the first changes h."""
    mdp, Q = moved_goal(ABSORBING)
    h = mdp.bellman(Q) - Q
    assert np.abs(Q + h - mdp.q_star()).max() > 0.5 * np.abs(Q - mdp.q_star()).max()
    assert (after(boosted_curriculum, mdp, Q, 2) != Q + h).any()


def booster_added(zero_output):
    """(Q before, Q after a booster is added) of the package's live GB-DQN on one-hot states."""
    config = Config(
        agent="gbdqn", replay="uniform", hidden=(8,), capacity=4, zero_output=zero_output
    )
    agent, states = GBDQN(3, 2, config, np.random.default_rng(0)), np.eye(3, dtype=np.float32)
    agent.observe(states[0], 0, 1.0, states[1], False)
    before = agent.q(states)
    agent.on_drift("drift")
    return before, agent.q(states)


@claim("K4")
@pytest.mark.parametrize("seed", range(5))
def test_plasticity_injection_is_the_live_reading_from_a_zero_booster(seed):
    """Q + h − h′ is Q at once, whatever h starts as; then it goes through the fits of K3."""
    mdp, Q = moved_goal(WALL)
    start = np.random.default_rng(seed).normal(size=Q.shape)
    injected = list(islice(plasticity_injection(mdp, Q, start), 19))
    np.testing.assert_allclose(injected[0], Q, atol=1e-12)
    np.testing.assert_allclose(injected[18], after(boosted_curriculum, mdp, Q, 18), atol=1e-9)
    before, later = booster_added(zero_output=True)
    assert (before == later).all()
    shows("the package's Q on {} states is the same to the bit", len(before))


@control("K4")
def test_control_a_booster_with_random_output_changes_q_at_once():
    before, later = booster_added(zero_output=False)
    assert np.abs(later - before).max() > 0.01


def medians(procedure, most=600):
    """Medians of both counts over the random drifted MDPs, and all of the counts."""
    counts = np.array([boosters(procedure, *drifted(seed), most) for seed in SEEDS])
    return np.median(counts, axis=0).tolist(), counts


@claim("K5")
def test_refitting_all_weights_cures_the_value_and_not_the_policy():
    """Their paper evaluates policies; one refit per booster under the greedy policy is ours. Twenty
    pairs have at most twenty features, and that many it needs where the goal absorbs.
    """
    rooms = [boosters(krylov, *moved_goal(goal)) for goal in (WALL, ABSORBING)]
    assert rooms == [(8, 11), (19, 20)]
    (policy, value), counts = medians(krylov)
    (policy_letter, value_letter), letter = medians(frozen)
    assert (policy, value) == (14, 15.5) and (policy_letter, value_letter) == (7, 439.5)
    assert (counts[:, 1] < letter[:, 1] / 10).all() and counts[:, 1].max() == 18
    shows(
        "medians of {}: 1 % of the error after {} boosters, to the letter {}; right policy {}, {}",
        len(counts),
        *(value, value_letter, policy, policy_letter),
    )


@control("K5")
@pytest.mark.parametrize("goal", [WALL, ABSORBING])
def test_control_with_weights_of_1_it_is_one_backup_per_booster(goal):
    """The same features, not refitted: the sum of the residuals, which is the letter (K1)."""
    mdp, Q = moved_goal(goal)
    assert boosters(boosted_fqi, mdp, Q)[1] > 20 * boosters(krylov, mdp, Q)[1]


@claim("K6")
@pytest.mark.parametrize("goal", [WALL, ABSORBING])
def test_a_chain_of_heads_makes_as_many_backups(goal):
    mdp, Q = moved_goal(goal)
    heads = (1, 2, 3, 5, 9, 18)
    stages = [boosters(partial(iterated, heads=K), mdp, Q, 40)[0] for K in heads]
    rolling = [boosters(partial(iterated, heads=K, roll=True), mdp, Q, 40)[0] for K in heads]
    assert stages == [-(-18 // K) for K in heads] == [18, 9, 6, 4, 2, 1]
    assert rolling == [18 - K + 1 for K in heads]
    shows("ten rooms, K = {}: the right policy after {} stages, rolling {}", heads, stages, rolling)


@control("K6")
def test_control_heads_that_share_one_target_make_one_backup():
    """Were each head's target the first head, all would be 𝒯Q: an ensemble."""
    mdp, Q = moved_goal(WALL)
    last = after(partial(iterated, heads=3), mdp, Q, 1)
    np.testing.assert_allclose(last, after(frozen, mdp, Q, 3), atol=1e-12)
    assert np.abs(last - mdp.bellman(Q)).max() > 0.5


@claim("K7")
def test_boosted_fitted_q_iteration_adds_one_fit_at_a_time():
    """What each step adds is the residual of the step before, and nothing else has moved."""
    mdp, Q = exactly(*moved_goal(WALL))
    path = [Q, *islice(boosted_fqi(mdp, Q), 6)]
    for before, later in pairwise(path):
        assert (later - before == mdp.residual(before)).all()
    shows("{} steps, each adds the last residual, exactly", len(path) - 1)


@control("K7")
def test_control_refitted_weights_do_change_what_was_there():
    """Krylov–Bellman boosting does rebuild the sum: what a step adds is not along the residual."""
    mdp, Q = moved_goal(WALL)
    first, second = islice(krylov(mdp, Q), 2)
    g, change = mdp.residual(first).ravel(), (second - first).ravel()
    cosine = abs(g @ change) / np.linalg.norm(g) / np.linalg.norm(change)
    assert cosine < 0.99

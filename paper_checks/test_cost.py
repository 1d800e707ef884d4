"""What an ensemble costs, counted: forward passes and parameters; and what frozen boosters keep."""

from fractions import Fraction as F
from unittest import mock

import numpy as np
import paper
import pytest
from ledger import claim, control, shows
from worlds import GAMMA_99, ROOMS, chain, loop

from gbdqn_ref.boosting import Ensemble
from gbdqn_ref.config import Config
from gbdqn_ref.dqn import DQN
from gbdqn_ref.drift import make
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.nn import MLP

BATCH, BOOSTERS = 8, (1, 4, 16)


def agent_with(boosters):
    """GB-DQN with so many frozen boosters, each of which has seen a little."""
    config = Config(hidden=[8], capacity=50, batch_size=BATCH)
    agent = GBDQN(2, 3, config, np.random.default_rng(0))
    for _ in range(boosters + 1):
        for _ in range(10):
            s, s2 = agent.rng.normal(size=(2, 2)).astype(np.float32)
            agent.observe(s, agent.rng.integers(3), -1.0, s2, False)
        agent.learn()
        if len(agent.ensemble) < boosters:
            agent.on_drift("drift")
    return agent


def counted(call):
    """(network rows forward, network rows backward) of a call: a stack of K networks on B rows is K
    · B.
    """
    rows = {"forward": 0, "backward": 0}

    def count(name, method, net, theta, *args):
        x = args[0] if name == "forward" else args[1]
        rows[name] += int(np.prod(theta.shape[:-1], initial=1)) * (x.size // x.shape[-1])
        return method(net, theta, *args)

    with (
        mock.patch.object(
            MLP, "forward", lambda *args, real=MLP.forward: count("forward", real, *args)
        ),
        mock.patch.object(
            MLP, "backward", lambda *args, real=MLP.backward: count("backward", real, *args)
        ),
    ):
        call()
    return rows["forward"], rows["backward"]


@claim("M17")
@pytest.mark.parametrize("boosters", BOOSTERS)
def test_an_update_costs_the_same_however_many_boosters_there_are(boosters):
    """Per sample one forward pass of h_m, one of its target, one backward."""
    forward, backward = (rows / BATCH for rows in counted(agent_with(boosters).learn))
    assert (forward, backward) == (2, 1)
    shows(
        "update: {} forward passes and {} backward per sample at {}, {} and {} boosters",
        *(forward, backward, *BOOSTERS),
    )


@claim("M17")
def test_dqns_update_costs_as_much():
    """DQN's update has the same passes as that of GB-DQN."""
    agent = DQN(2, 3, Config(agent="dqn", hidden=[8], batch_size=BATCH), np.random.default_rng(0))
    for _ in range(BATCH):
        agent.observe(np.zeros(2, np.float32), 0, -1.0, np.ones(2, np.float32), False)
    forward, backward = (rows / BATCH for rows in counted(agent.learn))
    assert (forward, backward) == (2, 1)
    shows("DQN's update: {} and {}", forward, backward)


@claim("M17")
@pytest.mark.parametrize("boosters", BOOSTERS)
def test_an_action_asks_every_booster(boosters):
    """In a state not yet asked for, the m frozen networks and the one that learns."""
    agent, state = agent_with(boosters), np.full(2, 0.5, np.float32)
    forward, backward = counted(lambda: agent.act(state, greedy=True))
    assert (forward - boosters, backward) == (1, 0)
    shows("m + {} for an action", forward - boosters)


@pytest.mark.parametrize("boosters", BOOSTERS)
def test_folding_in_passes_over_the_buffer_once(boosters):
    """One forward pass for each s and one for each s′ in the buffer."""
    agent = agent_with(boosters)
    assert counted(agent.fold_in)[0] == 2 * len(agent.replay)


@control("M17")
@pytest.mark.parametrize("boosters", [1, 4])
def test_control_without_the_cache_it_grows_with_the_boosters(boosters):
    """Asking the ensemble for the batch's s and s′ adds 2 m forward passes per sample."""
    agent = agent_with(boosters)

    def naive():
        batch = agent.replay.sample(BATCH, agent.rng)
        agent.ensemble.q(batch.s)
        agent.ensemble.q(batch.s2)
        agent.learn()

    assert counted(naive) == ((2 * boosters + 2) * BATCH, BATCH)


def parameters(name):
    """(of the first network, of a booster) on a benchmark with the preset's hidden layers."""
    env, config = make(name), Config.preset(name)
    agent = GBDQN(
        env.observation_space.shape[0], int(env.action_space.n), config, np.random.default_rng(0)
    )
    first = agent.theta.size
    agent.on_drift("drift")
    return first, agent.theta.size


def printed(name):
    """Of the network that the paper describes."""
    env = make(name)
    ends = env.observation_space.shape[0], int(env.action_space.n)
    return MLP((ends[0], *paper.HIDDEN[name], ends[1])).size


@claim("M18")
def test_a_booster_has_as_many_parameters_as_a_dqn():
    """On Acrobot and on Hopper, the smaller and the larger network of the paper."""
    acrobot, booster = parameters("acrobot")
    hopper, hopper_booster = parameters("hopper")
    assert acrobot == booster == printed("acrobot")
    assert hopper == hopper_booster == printed("hopper")
    shows(
        "{} parameters on Acrobot, {} on Hopper, for the first network and for every booster",
        *(booster, hopper_booster),
    )


@control("M18")
def test_control_one_small_layer_would_be_light():
    """With one hidden layer of 8 a booster would have under a hundredth of them."""
    env = make("acrobot")
    small = MLP((env.observation_space.shape[0], 8, int(env.action_space.n))).size
    assert 100 * small < parameters("acrobot")[1]


def moves(agent, call):
    """(whether θ_m has moved, whether anything in the ensemble has) in a call."""
    theta, frozen = agent.theta.copy(), (agent.ensemble.theta.copy(), agent.ensemble.alpha.copy())
    call()
    same = map(np.array_equal, frozen, (agent.ensemble.theta, agent.ensemble.alpha))
    return not np.array_equal(theta, agent.theta), not all(same)


@claim("M19")
def test_only_the_newest_network_moves():
    """Five updates move its parameters, and no bit of the frozen ones."""
    agent, updates = agent_with(3), 5
    assert moves(agent, lambda: [agent.learn() for _ in range(updates)]) == (True, False)
    frozen = len(agent.ensemble)
    shows(
        "{} updates with {} frozen boosters: θ_{} moves, θ_1 to θ_{} stay to the bit",
        *(updates, frozen, frozen + 1, frozen),
    )


@control("M19")
def test_control_a_drift_changes_the_ensemble():
    """Folding in is seen in its parameters."""
    agent = agent_with(1)
    assert moves(agent, agent.fold_in) == (False, True)


def costs(*events):
    """(learners, parameters kept, forward rows of an action, of an update) after these events."""
    agent = agent_with(0)
    for event in events:
        agent.on_drift(event)
    networks = len(agent.ensemble) + 1
    kept = agent.ensemble.theta.size + agent.theta.size
    action = counted(lambda: agent.act(np.full(2, 0.5, np.float32), greedy=True))[0]
    return networks, kept, action, counted(agent.learn)[0]


@claim("M22")
@pytest.mark.parametrize("drifts", [1, 4, 16])
def test_memory_and_actions_grow_with_the_drifts(drifts):
    """In proportion to 1 + drifts; an update costs what it did."""
    one, parameters, action, update = costs()
    networks, kept, asked, learnt = costs(*["drift"] * drifts)
    assert (one, action) == (1, 1) and networks == asked == 1 + drifts
    assert kept == (1 + drifts) * parameters and learnt == update
    shows("D drifts: D + {} networks to keep and to ask for an action; updates as before", one)


@control("M22")
def test_control_without_drifts_nothing_grows():
    """Resets of the physics add no booster."""
    assert costs(*["reset"] * 16) == costs()


def cached(agent):
    """(Q_{m−1}(s_i, a_i) and Q_{m−1}(s′_i, ·) as cached, and from all the networks)."""
    replay, slots = agent.replay, agent.replay.slots()
    kept = agent.q_frozen[slots], agent.q_frozen_next[slots]
    now = agent.ensemble.q(replay.s[slots]), agent.ensemble.q(replay.s2[slots])
    return kept, (now[0][np.arange(len(slots)), replay.a[slots]], now[1])


@claim("M23")
@pytest.mark.parametrize("boosters", BOOSTERS)
def test_the_cached_predictions_are_those_of_the_ensemble(boosters):
    """Also where transitions have come before and after a booster, and where slots were reused."""
    agent = agent_with(boosters)
    assert (len(agent.replay) == agent.config.capacity) == (boosters > 1)
    for kept, now in zip(*cached(agent), strict=True):
        np.testing.assert_allclose(kept, now, atol=1e-5)
    shows("random transitions, {}, {} and {} boosters: the same to rounding", *BOOSTERS)


@control("M23")
def test_control_if_a_booster_is_not_frozen_the_cache_is_stale():
    """One parameter of one booster moves, and the ensemble is no longer what is cached."""
    agent = agent_with(4)
    agent.ensemble.theta[0, -1] += 1
    kept, now = cached(agent)
    assert np.abs(kept[1] - now[1]).max() > 0.1


def when_a_booster_comes(zero_output):
    """(Q before, Q after a live GB-DQN with a booster is told of a drift), on random states."""
    config = Config(hidden=[8], capacity=50, batch_size=BATCH, zero_output=zero_output)
    agent, x = GBDQN(2, 3, config, np.random.default_rng(0)), np.random.default_rng(1)
    x = x.normal(size=(500, 2)).astype(np.float32)
    agent.on_drift("drift")
    agent.theta = agent.net.init(agent.rng)  # as if it had learnt
    before = agent.q(x)
    agent.on_drift("drift")
    return before, agent.q(x)


@claim("M24")
def test_a_new_booster_of_zero_output_changes_no_action():
    """Nor any value, beyond rounding."""
    before, after = when_a_booster_comes(zero_output=True)
    np.testing.assert_allclose(after, before, atol=1e-6)
    same = (after.argmax(-1) == before.argmax(-1)).sum()
    assert same == len(before)
    shows("on {} of {} random states the greedy action is the one before", same, len(before))


@control("M24")
def test_control_a_new_booster_of_random_output_changes_actions():
    """What it says before it has learnt anything is added to Q."""
    before, after = when_a_booster_comes(zero_output=False)
    assert (after.argmax(-1) != before.argmax(-1)).any()


@claim("M20")
def test_folding_in_forgets_nothing():
    """Through updates, drifts and a reset the old networks and weights stay, to the bit, and so
    does what each stage answers.
    """
    agent, x, drifts = agent_with(2), np.ones((1, 2), np.float32), 3
    theta, alpha = agent.ensemble.theta.copy(), agent.ensemble.alpha.copy()
    old = agent.ensemble.staged_q(x)
    for event in [*["drift"] * drifts, "reset"]:
        agent.learn()
        agent.on_drift(event)
    kept = len(theta)
    assert len(agent.ensemble) == kept + drifts
    assert np.array_equal(agent.ensemble.theta[:kept], theta)
    assert np.array_equal(agent.ensemble.alpha[:kept], alpha)
    np.testing.assert_allclose(agent.ensemble.staged_q(x)[:kept], old, atol=1e-6)
    shows("{} drifts later θ_1, θ_{} and their α are the same to the bit", drifts, kept)


@claim("M20")
def test_what_was_known_is_kept():
    """A reset adds nothing, takes nothing away, and moves no parameter."""
    agent = agent_with(2)
    assert moves(agent, lambda: agent.on_drift("reset")) == (False, False)
    shows("at a reset no parameter moves")


@claim("M20")
def test_what_was_known_is_no_longer_said():
    """One loop whose reward goes from 0 to 1 and back, perfect adaptation: at the reset Q is that
    of the drifted loop.
    """
    drifted, stock = loop(1, GAMMA_99), loop(0, GAMMA_99)
    Q = drifted.bellman(np.full((1, 1), 1 / (1 - GAMMA_99)))
    assert drifted.residual(Q) == 0
    off = abs(Q - stock.q_star()).max()
    assert off == 1 / (1 - GAMMA_99)
    shows(
        "r {} → {} → {} at γ = {:g}: Q is {:g} off when the old physics return",
        *(stock.r, drifted.r, stock.r, GAMMA_99, off),
    )


@control("M20")
def test_control_the_first_stage_still_knows():
    """The first stage of the ensemble answers as on the day it was frozen, where Q does not."""
    agent = agent_with(0)
    x = np.ones((1, 2), np.float32)
    first = agent.q(x)
    agent.on_drift("drift")
    for _ in range(5):
        agent.learn()
    agent.on_drift("drift")
    np.testing.assert_allclose(agent.staged_q(x)[0], first, atol=1e-6)
    assert not np.allclose(agent.q(x), first, atol=1e-6)


def planned(Q, boosters):
    """Q after so many exact boosters, on ten rooms in a row: −1 a step, the last room is the
    goal.
    """
    rewards = np.full((ROOMS, 2), F(-1))
    rewards[-1] = F(0)
    for _ in range(boosters):
        Q = chain(rewards).bellman(Q)
    return Q


@claim("M21")
def test_from_nothing_m_boosters_plan_m_steps():
    """The rooms from which the goal is m steps away or more are all alike, with either action."""
    nothing = Ensemble(MLP((3, 4, 2))).q(np.zeros((ROOMS, 3), np.float32))
    boosters = 4
    Q = planned(nothing.astype(int), boosters)
    far = (Q[:-1, 0] == Q[:-1, 1]).sum()
    assert far == ROOMS - boosters
    assert (Q[:far] == -(1 - GAMMA_99**boosters) / (1 - GAMMA_99)).all()
    shows(
        "−1 a step, {} states: after {} boosters the {} farthest have Q = ({:.4f}), no action"
        " preferred",
        *(ROOMS, boosters, far, Q[0]),
    )


@control("M21")
def test_control_from_an_ensemble_that_knows_the_way_every_state_has_a_preference():
    """With Q_1 = Q* instead of 0 the same boosters leave right the better action in every room."""
    optimal = planned(np.full((ROOMS, 2), F(0)), ROOMS)
    Q = planned(optimal, 4)
    assert (Q[:-1, 1] > Q[:-1, 0]).all()

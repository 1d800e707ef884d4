"""What an ensemble costs, counted: forward passes and parameters; and what frozen boosters keep."""

from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.boosting import Ensemble
from gbdqn_ref.config import Config
from gbdqn_ref.drift import make
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.nn import MLP
from gbdqn_ref.tabular import MDP

BATCH = 8


def new_agent(boosters, **reading):
    """GB-DQN with so many frozen boosters, each of which has seen a little."""
    config = Config(hidden=[8], capacity=50, batch_size=BATCH, **reading)
    agent = GBDQN(2, 3, config, np.random.default_rng(0))
    for _ in range(boosters + 1):
        for _ in range(10):
            agent.observe(
                *(agent.rng.normal(size=2).astype(np.float32), 0, -1.0),
                np.ones(2, np.float32),
                False,
            )
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


@claim(
    "M17",
    place="section Gradient Boosted DQN",
    says="the cost per step is about that of one DQN",
    verdict="holds if frozen predictions are kept per transition; acting still asks every booster",
    uses="gbdqn.GBDQN.learn, gbdqn.GBDQN.act",
)
@pytest.mark.parametrize("boosters", [1, 4, 16])
def test_an_update_costs_the_same_however_many_boosters_there_are(boosters):
    """Per sample one forward pass of h_m, one of its target, one backward; an action asks all m + 1
    networks.
    """
    agent = new_agent(boosters)
    assert counted(agent.learn) == (2 * BATCH, BATCH)
    state = np.full(2, 0.5, np.float32)  # not yet asked
    assert counted(lambda: agent.act(state, greedy=True)) == (boosters + 1, 0)
    assert counted(agent.fold_in)[0] == 2 * len(agent.replay)
    shows(
        "update: 2 forward passes and 1 backward per sample at 1, 4 and 16 boosters, as DQN; an"
        " action: m + 1"
    )


@control("M17")
@pytest.mark.parametrize("boosters", [1, 4])
def test_control_without_the_cache_it_grows_with_the_boosters(boosters):
    """Negative control: asking the ensemble for the batch's s and s′ adds 2 m forward passes per
    sample.
    """
    agent = new_agent(boosters)

    def naive():
        batch = agent.replay.sample(BATCH, agent.rng)
        agent.ensemble.q(batch.s)
        agent.ensemble.q(batch.s2)
        agent.learn()

    assert counted(naive) == ((2 * boosters + 2) * BATCH, BATCH)


@claim(
    "M18",
    place="section Gradient Boosted DQN",
    says="the boosters are light",
    verdict="fails: in the experiments each is a network of the first one's size",
    uses="nn.MLP, config.Config.preset",
)
def test_a_booster_has_as_many_parameters_as_a_dqn():
    sizes = {}
    for name in ("acrobot", "hopper"):
        env, config = make(name), Config.preset(name)
        sizes[name] = MLP(
            (env.observation_space.shape[0], *config.hidden, int(env.action_space.n))
        ).size
    assert sizes == {"acrobot": 17_795, "hopper": 70_663}
    shows(
        "17,795 parameters on Acrobot, 70,663 on Hopper, for the first network and for every"
        " booster"
    )


@claim(
    "M19",
    place="section Gradient Boosted DQN",
    says="one network trains at a time",
    verdict="holds",
    uses="gbdqn.GBDQN.learn, boosting.Ensemble",
)
def test_only_the_newest_network_moves():
    agent = new_agent(3)
    frozen, alpha, theta = (
        agent.ensemble.theta.copy(),
        agent.ensemble.alpha.copy(),
        agent.theta.copy(),
    )
    for _ in range(5):
        agent.learn()
    assert (agent.ensemble.theta == frozen).all() and (agent.ensemble.alpha == alpha).all()
    assert (agent.theta != theta).any()
    shows("five updates with three frozen boosters: θ_4 moves, θ_1 to θ_3 stay to the bit")


@control("M18", "M19")
def test_control_a_smaller_booster_would_be_light_and_a_fold_moves_the_ensemble():
    """Negative control: one hidden layer of 8 has 83 parameters here, and folding in is seen in
    θ.
    """
    assert MLP((6, 8, 3)).size == 83
    agent = new_agent(1)
    agent.fold_in()
    assert len(agent.ensemble) == 2


def loop(reward, gamma=0.99):
    return MDP(np.ones((1, 1, 1)), np.array([[float(reward)]]), gamma)


@claim(
    "M20",
    place="section Gradient Boosted DQN",
    says="frozen boosters preserve what was known",
    verdict=(
        "holds if their parameters are meant; as a function Q_m is another one, also where the old"
        " physics return"
    ),
    uses="gbdqn.GBDQN, tabular.MDP.q_star",
)
def test_what_was_known_is_kept_and_no_longer_said():
    """One loop, r 0 → 1 → 0, perfect adaptation: Q = 0, then 100; at the reset nothing is removed,
    and 100 stays.
    """
    drifted, stock = loop(1), loop(0)
    frozen_error = np.abs(drifted.q_star() - stock.q_star()).max()  # of Q_m at the reset
    assert frozen_error == pytest.approx(100)
    agent = new_agent(2)
    before = len(agent.ensemble)
    agent.on_drift("reset")
    assert len(agent.ensemble) == before  # nothing is added there, and nothing taken away
    shows(
        "r 0 → 1 → 0 at γ = 0.99: no parameter has moved, and Q is 100 off when the old physics"
        " return"
    )


@control("M20")
def test_control_the_first_stage_still_knows():
    """Negative control: the knowledge is in the ensemble: its first stage answers as on the day it
    was frozen.
    """
    agent = new_agent(0)
    x = np.ones((1, 2), np.float32)
    first = agent.q(x)
    agent.on_drift("drift")
    for _ in range(5):
        agent.learn()
    agent.on_drift("drift")
    np.testing.assert_allclose(agent.staged_q(x)[0], first, atol=1e-6)
    assert not np.allclose(agent.q(x), first, atol=1e-6)


@claim(
    "M21",
    place="Eq. 1, Algorithm 1",
    says="boosting starts from the empty ensemble",
    verdict=(
        "ambiguous: then Q_m = 𝒯^m 0, a plan of m steps; the experiments start from a trained"
        " network (D8)"
    ),
    uses="boosting.Ensemble.q, tabular.MDP.bellman",
)
@given(st.integers(0, 10**6))
def test_from_nothing_m_boosters_plan_m_steps(seed):
    """A chain of ten states, −1 a step, the last one the goal: after four boosters all from five
    steps on are alike.
    """
    P = np.zeros((10, 2, 10))
    for s in range(9):
        P[s, 0, max(s - 1, 0)] = P[s, 1, s + 1] = 1
    P[9, :, 9] = 1
    chain = MDP(P, np.where(np.arange(10)[:, None] == 9, 0.0, -1.0) * np.ones((1, 2)), 0.99)
    net = MLP((3, 4, 2))
    Q = Ensemble(net).q(np.random.default_rng(seed).normal(size=(10, 3)).astype(np.float32))
    assert not Q.any()
    for _ in range(4):
        Q = chain.bellman(Q)
    np.testing.assert_allclose(Q[:5], -(1 - 0.99**4) / 0.01, atol=1e-6)
    assert (Q[:5, 0] == Q[:5, 1]).all() and Q[8, 1] > Q[8, 0]
    shows(
        "−1 a step, ten states: after 4 boosters the five farthest have Q = (−3.9404, −3.9404), no"
        " action preferred"
    )


@control("M21")
def test_control_from_a_trained_network_the_far_states_know_their_way():
    """Negative control: from Q* one more backup changes nothing, however far the goal is."""
    mdp = loop(1)
    np.testing.assert_allclose(mdp.bellman(mdp.q_star()), mdp.q_star(), atol=1e-9)

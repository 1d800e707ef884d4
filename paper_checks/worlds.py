"""The small worlds of the checks, each once: MDPs, replay buffers, and a GB-DQN that is a table.

Numbers are Fractions wherever no limit is taken, so that a figure is exact.
"""

from fractions import Fraction as F

import numpy as np

from gbdqn_ref.config import Config
from gbdqn_ref.drift import make
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.tabular import MDP

GAMMA_99 = F(99, 100)  # the paper's discount
ROOMS = 10  # of a chain


def exact(*values):
    """These numbers as Fractions, (n,)."""
    return np.array([F(value) for value in values])


def row(*values):
    """Q of one state, exactly, (1, n)."""
    return exact(*values)[None]


def column(*values):
    """Q of one action, exactly, (n, 1)."""
    return exact(*values)[:, None]


def normalise(p):
    """P = p / Σp."""
    return p / p.sum()


# MDPs


def loops(rewards, gamma):
    """One state whose actions, one per reward, all stay in it."""
    return MDP(np.full((1, len(rewards), 1), F(1)), row(*rewards), gamma)


def loop(reward, gamma):
    """One state, one action that stays in it: Q* = reward / (1 − γ)."""
    return loops((reward,), gamma)


def funnel(first, second, gamma):
    """Two states, one action each, both lead to the second; their rewards."""
    return MDP([[exact(0, 1)], [exact(0, 1)]], column(first, second), gamma)


def chain(rewards, gamma=GAMMA_99):
    """Ten states in a row, actions left and right, which stay put at the ends; rewards (10, 2)."""
    P = np.full((ROOMS, 2, ROOMS), F(0))
    for s, a in np.ndindex(ROOMS, 2):
        P[s, a, min(max(s + (-1, 1)[a], 0), ROOMS - 1)] = F(1)
    return MDP(P, rewards, gamma)


def random_mdp(rng, gamma, states=3, actions=2):
    """Transitions drawn from Dirichlet's distribution, rewards from the normal one."""
    P = rng.dirichlet(np.ones(states), size=(states, actions))
    return MDP(P, rng.normal(size=(states, actions)), gamma)


def swap(gamma):
    """Two states, one action each, which change places; no rewards, so Q* = 0."""
    return MDP([[exact(0, 1)], [exact(1, 0)]], column(0, 0), gamma)


def by_definition(mdp, Q):
    """𝒯*Q − Q in a plain loop: the best action of the next state counts, and no other."""
    found = -Q
    for s, a in np.ndindex(Q.shape):
        next_values = [p * max(values) for p, values in zip(mdp.P[s, a], Q, strict=True)]
        found[s, a] += mdp.r[s, a] + mdp.gamma * sum(next_values)
    return found


# Three states, of which each action leads to another one

NEXT = np.array([[1, 2], [2, 0], [0, 1]])  # where action a leads from state s
OLD_REWARDS = np.array([[0.0, 1.0], [0.5, 0.0], [-1.0, 0.2]])
NEW_REWARDS = np.array([[1.0, -1.0], [0.0, 2.0], [0.3, -0.5]])
ONE_HOT = np.eye(len(NEXT), dtype=np.float32)
TRIANGLE_GAMMA = 0.8


def triangle(rewards):
    """The MDP of NEXT with these rewards."""
    return MDP(np.eye(len(NEXT))[NEXT], rewards, TRIANGLE_GAMMA)


def one_hot_agent(states=3, actions=2, seed=0, **settings):
    """GB-DQN with one linear layer: on one-hot states it is a table, which converges in a
    second.
    """
    usual = {"agent": "gbdqn", "replay": "uniform", "hidden": (), "capacity": 500, "lr": 0.02}
    config = Config(**usual | {"tau": 0.1, "gamma": TRIANGLE_GAMMA} | settings)
    return GBDQN(states, actions, config, np.random.default_rng(seed))


# Replay buffers


def filled(replay, rewards):
    """The replay after a loop of one state and one action has paid these rewards."""
    for reward in rewards:
        replay.add(0.0, 0, reward, 0.0, False)
    return replay


def with_errors(replay, delta):
    """The replay, full of transitions with these TD errors, the newest last."""
    replay.added = len(delta)  # add() would take seconds for 100,000
    replay.update_priorities(np.arange(len(delta)), np.asarray(delta, float))
    return replay


# Environments


def mean_return(name, act, episodes):
    """Mean return in the stock physics of a policy that looks at nothing."""
    env, total = make(name), 0.0
    for seed in range(episodes):
        env.reset(seed=seed)
        ends = False
        while not ends:
            _, r, terminated, truncated, _ = env.step(act())
            total, ends = total + float(r), terminated or truncated
    return total / episodes

"""Published ways to add a network to a Q-function, as procedures on tables, beside our readings.

Each yields Q after every booster, or after every fit inside one. A fit is perfect: it is the exact
least-squares optimum over all functions of (s, a), every pair is in the data, and the model stands
in for sampled means. What we read of each is said in its docstring, and what is ours. No code was
taken over. The papers on policy evaluation (BEBF, the ideal basis, Krylov–Bellman boosting) are
carried over to control by evaluating the greedy policy of the current Q; that step is ours.

Letters: P, r, γ, Q, g as in tabular; h a booster, α its weight.
"""

from itertools import islice

import numpy as np
from worlds import ROOMS, chain

from gbdqn_ref.tabular import MDP

GAMMA = 0.99
TIE = 1e-9  # values that differ by no more are the same


# Readings of GB-DQN: claims B1, B3, B5


def frozen(mdp, Q, alpha=1):
    """Algorithm 1 to the letter: Q ← Q + α g, one damped backup per booster."""
    while True:
        Q = Q + alpha * mdp.residual(Q)
        yield Q


def live(mdp, Q):
    """The live target: the stage's only fixed point, Q*, with one booster."""
    yield mdp.q_star()


# What was published


def boosted_fqi(mdp, Q):
    """Boosted fitted Q-iteration: each fit is of the Bellman residual, and Q is the sum of all.

    Tosatto, Pirotta, D'Eramo and Restelli, ICML 2017; the abstract was read.
    """
    fits = [Q]
    while True:
        fits.append(mdp.residual(sum(fits)))
        yield sum(fits)


def boosted_curriculum(mdp, Q):
    """Boosted curriculum RL: one h per task on top of the frozen sum Q; fits of 𝒯(Q + h) − Q.

    Klink, D'Eramo, Peters and Pajarinen, ICLR 2022; the abstract and the code were read.
    """
    h = 0 * Q
    while True:
        h = mdp.bellman(Q + h) - Q
        yield Q + h


def plasticity_injection(mdp, Q, start):
    """Plasticity injection: Q + h − h′, h′ a frozen copy of the h that the new network starts with.

    Nikishin, Oh, Ostrovski, Lyle, Pascanu, Dabney and Barreto, NeurIPS 2023; the abstract and a
    summary of the architecture were read. That all of Q is frozen, and not a head, is ours.
    """
    h = start
    while True:
        yield Q + h - start
        h = mdp.bellman(Q + h - start) - Q + start


def ideal_basis(mdp, Q):
    """The value function of the MDP whose rewards are the Bellman error, as a new basis function.

    Sun, Gomez, Ring and Schmidhuber, ICML 2011; the abstract was read. Under the greedy policy of Q
    this is one step of policy iteration: h = (I − γ P_π)⁻¹ g.
    """
    while True:
        h = np.linalg.solve(evaluation(mdp, Q), mdp.residual(Q).ravel())
        Q = Q + h.reshape(Q.shape)
        yield Q


def krylov(mdp, Q):
    """Krylov–Bellman boosting: the residual is a new feature, and the weights of all are refitted.

    Xia and Wainwright, AISTATS 2023; the abstract and parts of the introduction were read. Its
    features are the Bellman error basis functions of Parr, Painter-Wakefield, Li and Littman, ICML
    2007 (abstract and introduction read), so on a table, where fits are exact, the two are one. The
    weights solve Φᵀ (I − γ P_π) Φ w = Φᵀ g_0, least-squares temporal differences.
    """
    start, features = Q, []
    while (size := np.linalg.norm(g := mdp.residual(Q))) > 1e-6:
        features.append(g.ravel() / size)
        basis = np.linalg.qr(np.column_stack(features))[0]
        M = evaluation(mdp, Q)
        rest = mdp.r.ravel() - M @ start.ravel()  # what the boosters have to add up to
        weights = np.linalg.solve(basis.T @ M @ basis, basis.T @ rest)
        Q = start + (basis @ weights).reshape(Q.shape)
        yield Q


def iterated(mdp, Q, heads, roll=False):
    """Iterated Q-networks: a chain of heads, each the target of the next, all learning at once.

    Vincent, Palenicek, Belousov, Peters and D'Eramo, TMLR 2025; the abstract and the code were
    read. When none learns any more the window shifts: all heads become the last one (in the code
    for fitted Q-iteration), or each becomes the next (`roll`, in the code for DQN).
    """
    chain = [Q] * (heads + 1)
    while True:
        for _ in range(heads):
            chain[1:] = map(mdp.bellman, chain[:-1])
        yield chain[-1]
        chain = chain[1:] + chain[-1:] if roll else chain[-1:] * (heads + 1)


def evaluation(mdp, Q):
    """I − γ P_π on pairs, (SA, SA), with π the greedy policy of Q, of ties the first action."""
    best = Q.max(-1, keepdims=True) - TIE <= Q
    greedy = np.eye(Q.shape[1])[best.argmax(-1)]
    return np.eye(Q.size) - mdp.gamma * (mdp.P[..., None] * greedy).reshape(Q.size, Q.size)


# Worlds


def rooms(goal, absorbing):
    """Ten rooms in a row, left and right; the goal is an end.

    Absorbing: −1 a step, and the goal is never left. Else: 1 for each step against the goal's wall.
    """
    P, r = chain(np.zeros((ROOMS, 2))).P.astype(float), np.zeros((ROOMS, 2))
    if absorbing:
        P[goal], r = np.eye(ROOMS)[goal], np.where(np.arange(ROOMS)[:, None] == goal, 0.0, -1 - r)
    else:
        r[goal, int(goal > 0)] = 1
    return MDP(P, r, GAMMA)


def moved_goal(absorbing):
    """(the new MDP, the old Q*): the goal moves from the first room to the last."""
    return rooms(ROOMS - 1, absorbing), rooms(0, absorbing).q_star()


def drifted(seed, states=30, actions=2, successors=3):
    """(the new MDP, the old Q*): half of the pairs get new successors and a new reward."""
    rng = np.random.default_rng(seed)
    (P, r), (P_new, r_new) = (_random(rng, states, actions, successors) for _ in range(2))
    changes = rng.random(r.shape) < 0.5
    new = MDP(np.where(changes[..., None], P_new, P), np.where(changes, r_new, r), GAMMA)
    return new, MDP(P, r, GAMMA).q_star()


def _random(rng, states, actions, successors):
    P = np.zeros((states, actions, states))
    for s, a in np.ndindex(states, actions):
        next_states = rng.choice(states, successors, replace=False)
        P[s, a, next_states] = rng.dirichlet(np.ones(successors))
    return P, rng.normal(size=(states, actions))


# How many boosters it takes


def boosters(procedure, mdp, Q, most=600):
    """(until the greedy policy is right, until 1 % of the error is left), each to stay so.

    None where `most` boosters are not enough. The error is ‖Q − Q*‖∞; a policy is right if no
    action that is greedy for Q is worse than another.
    """
    q_star, path = mdp.q_star(), list(islice(procedure(mdp, Q), most))
    worse = q_star < q_star.max(-1, keepdims=True) - TIE
    wrong = [(worse & (q >= q.max(-1, keepdims=True) - TIE)).any() for q in path]
    far = [np.abs(q - q_star).max() > np.abs(Q - q_star).max() / 100 for q in path]
    return _settled(wrong), _settled(far)


def _settled(flags):
    last = max((k for k, flag in enumerate(flags, 1) if flag), default=0)
    return last + 1 if last < len(flags) else None

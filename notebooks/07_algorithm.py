# %% [markdown]
# # 7 · Algorithm 1, line by line
#
# You will be able to point from each printed line to its line of code, and say which
# readings of the algorithm adapt, and by how much per booster.
#
# *Time: 30 minutes. Needs: notebooks 2, 4, 5 and 6; geometric sequences. With the paper
# open: section “Algorithm”, Algorithm 1; Eqs. 1, 4, 5, 8 and 9.*
#
# **How to read this with the paper open.** Line 1 of Algorithm 1 is “$h_m$: dqn network
# to train”. Mark every $Q_{m-1}$ and every $Q_m$. There is one $Q_m$, in the last line.

# %% [markdown]
# ## Algorithm 1, lines 1–29 · where each line lives
#
# You wrote forty lines in notebook 2. Here is where the package has each printed line.
# The cell fails unless each line of code is there, exactly once.

# %%
import copy
from math import ceil, log

import numpy as np
from exercises import check, solution
from lesson import corridor, show, step
from pictures import algorithm as pictures

from gbdqn_ref.config import Config
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.nn import MLP
from gbdqn_ref.replay import td_priority
from gbdqn_ref.tabular import MDP

pictures.table()

# %% [markdown]
# Four things strike the reader.
#
# 1. **Nothing detects a drift, and nothing computes $\alpha_m$** (claims X24, A3). Here
#    a drift is announced, and α is an option: a number, or the closed form of Eq. 8
#    (D15, D7).
# 2. **Lines 9–11 compute a target and a residual for the new transition**, but only its
#    first priority needs them. The package computes both in `gbdqn.GBDQN.learn`, when
#    a transition is drawn. Until then its priority is the largest so far (D4).
# 3. **Line 26 stands after the `break` of line 23.** So the last step of an episode
#    does not move the target network (claim A5); the package moves it at each update
#    (D9). Besides, lines 9 and 16 read $\bar Q_{m-1}$. Its networks are frozen, so
#    there is nothing for it to follow (claim P3).
# 4. **Lines 7, 9 and 16 say $Q_{m-1}$, never $Q_m$.** The rest of this page is about
#    that.
#
# The second point, with one transition:

# %%
ONE_HOT = np.eye(10, dtype=np.float32)
config = Config(replay="proportional", hidden=(), capacity=18)
agent = GBDQN(10, 2, config, np.random.default_rng(0))
agent.observe(ONE_HOT[8], 1, -1.0, ONE_HOT[9], True)
waiting, delta = agent.replay.tree.leaves[0], agent.learn()[0]
drawn = td_priority(delta, config.priority_offset, config.priority_exponent)
print(f"priority {waiting:.2f} until it is drawn, then {drawn:.2f}")
assert waiting == 1 and np.isclose(agent.replay.tree.leaves[0], drawn, atol=1e-6)

# %% [markdown]
# ## Algorithm 1, lines 4–12 · the switch: frozen or live
#
# The package's `GBDQN.live` is the switch of notebook 2: with `target="frozen"` the
# agent acts and bootstraps with $Q_{m-1}$, with `target="live"` with $Q_m$.

# %%
pictures.beside(GBDQN.live.fget, GBDQN.q)

# %% [markdown]
# Here is the package's agent in the ten rooms. Its network is a table plus, for each
# action, a **bias**: a constant that all rooms share. The buffer holds each of the 18
# transitions once. So neither approximation nor exploration is to blame for what you
# will see.


# %%
def table_agent(**reading):
    settings = dict(replay="uniform", hidden=(), capacity=18, lr=0.03, tau=0.1)
    config = Config(**settings | dict(gamma=0.9) | reading)
    return GBDQN(10, 2, config, np.random.default_rng(0))


def table(agent, goal):
    """Its Q, 0 at the goal."""
    Q = agent.q(ONE_HOT)
    Q[goal] = 0
    return Q


def live_through(agent, goal, updates, every=50):
    """Fill the buffer with this world's transitions, and learn: Q, now and then."""
    for room, action in np.ndindex(10, 2):
        if room != goal:
            room2, r, terminated = step(room, action, goal)
            agent.observe(ONE_HOT[room], action, r, ONE_HOT[room2], terminated)
    track = []
    for k in range(updates):
        if k % every == 0:
            track.append(table(agent, goal))
        agent.learn()
    return track


UPDATES = 1_000


def after_drift(**reading):
    """The agent before line 29, and its Q over the updates since the drift."""
    agent = table_agent(**reading)
    live_through(agent, 9, UPDATES)
    agent.on_drift("drift")
    return agent, live_through(agent, 0, UPDATES)


def turned(Q):
    """In how many of the nine rooms Q goes left."""
    return int((Q[1:, 0] > Q[1:, 1] + 1e-6).sum())


# %% [markdown]
# > **Predict.** An agent under Algorithm 1 to the letter has learnt the way to room 9.
# > The goal moves to room 0. Its booster trains until it fits its residuals. In how
# > many rooms does the agent act differently from before? And an agent with a live
# > target?

# %% tags=["predicted"]
letter, frozen = after_drift(target="frozen", loss_on="h", alpha=1.0)
live, moving = after_drift(target="live", loss_on="alpha_h", alpha=0.5)
for name, track, agent in (("frozen", frozen, letter), ("live", moving, live)):
    changed = (table(agent, 0).argmax(1) != track[0].argmax(1))[1:].sum()
    now = turned(table(agent, 0))
    print(f"{name}: acts differently in {changed} rooms, goes left in {now}")
assert (table(letter, 0) == frozen[0]).all() and turned(table(live, 0)) == 9
assert (letter.ensemble.q(ONE_HOT) == live.ensemble.q(ONE_HOT)).all()  # before (D8)

# %%
show(
    pictures.switch(frozen, moving, 50),
    alt="Two maps of arrows: a row for every hundred updates after the drift, a column "
    "for each room. Frozen: all arrows point right, in all rows. Live: rooms 1 to 8 "
    "turn left one after the other, and room 9 at once.",
)

# %% [markdown]
# Line 7 acts by $Q_{m-1}$, without the booster (claim A1). Only line 29 can change an
# action. The time between two drifts is a **regime**. The experiments report adaptation
# *within* regimes, so `target="live"` is the default here (D6). Move the switch
# yourself. In Jupyter it is this agent's. On the site the instrument of [notebook
# 2](02_forty_lines.ipynb) stands here, whose boosters are perfect.

# %% tags=["slider", "live:rooms"]
from ipywidgets import interact


@interact(target=["frozen", "live"], loss_on=["alpha_h", "h"], alpha=(0.1, 1.0, 0.1))
def rooms_after_the_drift(target, loss_on, alpha):
    _, track = after_drift(target=target, loss_on=loss_on, alpha=alpha)
    show(
        pictures.corridors(track, 50),
        alt="the ten rooms over the updates after a drift",
    )


# %% [markdown]
# ## Algorithm 1, lines 13–21 · one update
#
# $$y_i = r_i + \gamma \max_{a'} \bar Q(s'_i, a'), \qquad
#   \hat y_i = y_i - Q_{m-1}(s_i,a_i), \qquad
#   L_i = w_i\,\big(\hat y_i - h_m(s_i,a_i)\big)^2$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\bar Q(s'_i,\cdot)$ | `q_next` | (B, A) | $\bar Q_{m-1}$ or $\bar Q_m$; its largest entry counts (P2); line 16 prints $s'$ for $s'_i$ (A8) |
# | $y_i$ | `y` | (B,) | the target; no bootstrap at a terminal state (D1) |
# | $\hat y_i$ | `residual` | (B,) | Eq. 4 |
# | $h_m(s_i,a_i)$ | `h` | (B,) | the booster's answer |
# | – | `factor` | scalar | α if the loss is on $\alpha h$ (Eq. 5), 1 if on $h$ (line 19) |

# %%
pictures.beside(GBDQN.learn)

# %% [markdown]
# The same update, one sample after the other, every network asked anew:

# %%
agent = table_agent(target="frozen", loss_on="h", replay="recency", batch_size=8)
live_through(agent, 9, 60)
agent.on_drift("drift")
live_through(agent, 0, 5)

twin, grad = copy.deepcopy(agent), np.zeros(agent.net.size, np.float32)
batch, residuals = twin.replay.sample(8, twin.rng), []
rows = (batch.s, batch.a, batch.r, batch.s2, batch.terminated, batch.weight)
for s, a, r, s2, done, w in zip(*rows, strict=True):
    y = r + 0.9 * (0 if done else twin.ensemble.q(s2).max())
    residuals.append(y - twin.ensemble.q(s)[a])
    h, cache = twin.net.forward(twin.theta, s[None])
    dq = np.zeros((1, 2), np.float32)
    dq[0, a] = -w * (residuals[-1] - h[0, a]) / 8  # ½ of the mean, not the sum (D2)
    grad += twin.net.backward(twin.theta, cache, dq)
twin.adam.step(twin.theta, grad)

agent.learn()
assert np.linalg.norm(grad) < agent.config.max_grad_norm  # so clipping did nothing
assert np.allclose(agent.theta, twin.theta, atol=1e-5)
c = agent.config
anew = td_priority(np.array(residuals), c.priority_offset, c.priority_exponent)
assert np.allclose(agent.replay.tree.leaves[batch.index], anew, atol=1e-4)  # line 18

# %% [markdown]
# (A mean with ½, or the printed sum: to Adam it is nearly the same, claim A6.)
#
# **Exercise 1.** Compute what the booster is to learn. By hand first: r = −1,
# $\bar Q_{m-1}(s', \cdot)$ = (−5, −4), $Q_{m-1}(s,a) = -6$ and γ = 0.9 give y = −4.6
# and the residual 1.4. If s′ is terminal, y = −1 and the residual is 5. The printed
# line has no factor for the end and gives 1.4 all the same (claim P4).


# %%
def residual_target(r, terminated, next_frozen, frozen, h_next, live, gamma):
    """ŷ of line 17. next_frozen is Q_{m−1}(s′, ·), and h_next is α h(s′, ·)."""
    ...  # yours


residual_target = check("residual_target", residual_target)
solution("residual_target")

# %%
frozen_part = np.array([-5, -4]), -6, np.zeros(2), False, 0.9
assert np.isclose(residual_target(-1, False, *frozen_part), 1.4)
assert np.isclose(residual_target(-1, True, *frozen_part), 5)

# %% [markdown]
# ## Algorithm 1, line 29 · adding the booster, Eq. 9
#
# Line 29 sets $Q_m = Q_{m-1} + \alpha_m h_m$. A frozen network never changes again. So
# its answers for a stored transition are computed once and kept, in a **cache**, and it
# is its own target network (D3). No line ever takes a booster away (claim M22).

# %%
pictures.beside(GBDQN.fold_in)

# %%
agent = table_agent(target="live")
live_through(agent, 9, 100)
for goal in (0, 9, 0):
    agent.on_drift("drift")
    live_through(agent, goal, 100)
replay, asked = agent.replay, agent.ensemble.q
assert np.allclose(agent.q_frozen, asked(replay.s)[range(18), replay.a], atol=1e-4)
assert np.allclose(agent.q_frozen_next, asked(replay.s2), atol=1e-4)
print(len(agent.ensemble), "boosters frozen, one learning: the cache is exact")

# %% [markdown]
# > **Predict.** To ask one network about one state costs 1 unit, and its gradient costs
# > 2. DQN spends 4 units on a training sample. What does GB-DQN spend with 8 networks?


# %% tags=["predicted"]
class Counting(MLP):
    def forward(self, theta, x):
        units.append(len(x) * (len(theta) if theta.ndim > 1 else 1))
        return super().forward(theta, x)

    def backward(self, theta, cache, dq):
        units.append(2 * len(dq))
        return super().backward(theta, cache, dq)


for target, expected in (("live", [4, 4, 4, 4]), ("frozen", [4, 3, 3, 3])):
    costs = []
    for m in (1, 2, 4, 8):
        agent = table_agent(target=target)
        live_through(agent, 9, 0)
        for _ in range(m - 1):
            agent.on_drift("drift")
        agent.net, units = Counting(agent.net.widths), []
        agent.ensemble.net = agent.net
        agent.learn()
        costs.append(sum(units) / agent.config.batch_size)
    print(f"{target:7} with 1, 2, 4, 8 networks:", *costs)
    assert costs == expected

# %% [markdown]
# At most as much as DQN, however many networks there are. Without the cache each frozen
# network would be asked about s and s′ and add 2. Acting still asks all m networks
# (claim M17).
#
# ## The readings, as options
#
# | what the pages say | option of `Config` | |
# |---|---|---|
# | lines 7, 9, 16: $Q_{m-1}$; the experiments: adaptation within a regime | `target` | D6 |
# | line 19: loss on $h$; Eq. 5: loss on $\alpha h$ | `loss_on` | M13 |
# | Eq. 8: closed form; the experiments: η = 0.1 | `alpha` | D15, D7 |
# | line 7: softmax; the experiments: ε-greedy | `behaviour` | D10 |
#
# ## Algorithm 1 · one backup per boost
#
# Write $\mathcal{T}Q$ for the targets that Q gives in all rooms: one **Bellman
# backup**. Let the booster be perfect. To the letter it equals
# $\mathcal{T}Q_{m-1} - Q_{m-1}$, and line 29 adds α times that:
#
# $$Q_m = (1-\alpha)\,Q_{m-1} + \alpha\,\mathcal{T}Q_{m-1}$$
#
# This is one backup, damped by α, **per drift** (claims A2, B1). Each reading comes to
# rest at a Q′ of its own; only in row 3 is it Q*, the **fixed point** of $\mathcal{T}$,
# the Q that a backup does not change. The right column is the part of the error
# $\|Q - Q^*\|_\infty$ that a booster may leave (claims B5, B6); η is the shrinkage of
# the experiments:
#
# | reading | a stage ends at Q′ | leaves at worst |
# |---|---|---|
# | 1 frozen, α = 1; or frozen, loss on $\alpha h$ | $Q' = \mathcal{T}Q$ | γ |
# | 2 frozen, loss on $h$, α = η | $Q' = Q + \eta(\mathcal{T}Q - Q)$ | 1 − η(1 − γ) |
# | 3 live, loss on $\alpha h$ | $Q' = \mathcal{T}Q' = Q^*$ | 0 |
# | 4 live, loss on $h$, α = η | $Q' = (1-\eta)Q + \eta\mathcal{T}Q'$ | (1 − η)/(1 − ηγ) |
# | 5 live with α = 1, then α = η | $Q' = Q + \eta(Q^* - Q)$ | 1 − η |
#
# Row 4, for example:
# $Q' - Q^* = (1-\eta)(Q - Q^*) + \eta(\mathcal{T}Q' - \mathcal{T}Q^*)$. Let e be the
# error of Q and e′ that of Q′. Then $e' \le (1-\eta)e + \eta\gamma e'$. Row 3 is the
# package's default; row 5 is no option of it.
#
# **Exercise 2.** What does a perfect booster make of Q under each reading?


# %%
def perfect_boost(reading, Q, eta, backup, q_star):
    """Q′ of the table; backup(Q) is 𝒯Q. For row 4 start at Q and repeat 200 times."""
    ...  # yours


perfect_boost = check("perfect_boost", perfect_boost)
solution("perfect_boost")

# %% [markdown]
# Now the package's agent against the rows, trained until its booster has converged:

# %%
OPTIONS = {
    1: dict(target="frozen", loss_on="alpha_h"),
    2: dict(target="frozen", loss_on="h"),
    3: dict(target="live", loss_on="alpha_h"),
    4: dict(target="live", loss_on="h"),
}
new, tracks = corridor(0), {}
q_new = new.q_star()
for reading, options in OPTIONS.items():
    agent, tracks[reading] = after_drift(alpha=0.5, **options)
    before = agent.ensemble.q(ONE_HOT)
    before[0] = 0
    after = table(agent.finish(), 0)  # line 29
    tracks[reading].append(after)
    perfect = perfect_boost(reading, before, 0.5, new.bellman, q_new)
    assert np.abs(after - perfect).max() < 0.02
    error = np.abs(after - q_new).max()
    print(f"reading {reading}: {error:.2f} from Q*, {turned(after)} rooms turned")
    assert (error < 0.02) == (reading == 3)

# %%
show(
    pictures.stage(tracks, q_new, 50),
    alt="Two panels over the updates after the drift. The error stays at 5.5 for the "
    "frozen readings until line 29 lowers it to about 4; reading 4 falls to about 4; "
    "reading 3 falls to 0. Rooms that go left: 9 for reading 3, two or three for the "
    "others.",
)

# %% [markdown]
# Every booster fits its targets exactly. (Reading 1 turns three rooms, not one. Before
# the drift no transition started in room 9, so Q there had fallen with the biases;
# after the backup rooms 8 and 9 go left, too.) But only the live target with the loss on
# $\alpha h$ arrives (claim B3). And α = 0.5 does not shrink the step of reading 1: α
# cancels (claim B2).
#
# > **Predict.** γ = 0.99 and η = 0.1, as in the experiments. The reward of a room that
# > leads back to itself drifts from 0 to 1, so Q is off by 100. After three boosters,
# > one per drift, how much of the 100 is left under each reading?

# %% tags=["predicted"]
loop, eta, boosts = MDP(np.ones((1, 1, 1)), np.ones((1, 1)), 0.99), 0.1, 200
FACTORS = {1: 0.99, 2: 0.999, 3: 0, 4: 0.9 / 0.901, 5: 0.9}  # the right column
old = corridor(9).q_star()
old[0] = 0
errors, rooms = {}, {}
for k, factor in FACTORS.items():
    q, Q, errors[k], rooms[k] = np.zeros((1, 1)), old, [], []
    for _ in range(boosts + 1):
        errors[k].append(abs(q - 100).max())
        rooms[k].append(turned(Q))
        q = perfect_boost(k, q, eta, loop.bellman, np.full((1, 1), 100.0))
        Q = perfect_boost(k, Q, eta, new.bellman, q_new)
    assert np.allclose(errors[k], 100 * np.float64(factor) ** np.arange(boosts + 1))
    turn = rooms[k].index(9)
    print(f"{k}: {errors[k][3]:.2f} of 100 left; all rooms turned by boost {turn}")
assert [rooms[k].index(9) for k in (1, 2, 3)] == [10, 82, 1]

# %%
show(
    pictures.boosts(errors, rooms),
    alt="Two panels over the boosts, on a logarithmic axis, for five readings. Error "
    "of the loop: readings 1, 2 and 4 have barely moved after three boosts. Rooms "
    "with the right action: reading 3 has all nine after one boost, reading 1 after "
    "10, reading 2 after 82.",
)

# %% [markdown]
# To the letter, more than 97 of 100 are left after three boosters (claims B4, B6). What
# one drift leaves is still there at the next (claim B10). In the corridor the news
# of the goal spreads by one room per boost, from both ends (claim B8), and the old
# goal's value fades slowly: the last room turns after 10 boosts, or 82 with η. In the
# ledger's corridor, where no episode ends, it takes longer (claim B9).
#
# How many boosts halve the error at worst (claim B7)? And which rooms has the news not
# reached after three?

# %%
halve = {k: ceil(log(0.5) / log(max(f, 1e-9))) for k, f in FACTORS.items()}
three = new.bellman(new.bellman(new.bellman(old)))
silent = 1 + np.flatnonzero(np.isclose(three, old)[1:].all(1))  # room 0 is the goal
print("boosts to halve the error:", halve, "  rooms untouched by three:", silent)
assert halve == {1: 69, 2: 693, 3: 1, 4: 625, 5: 7} and silent.tolist() == [4, 5, 6]

# %% [markdown]
# ## Eq. 1 · from the empty ensemble
#
# Algorithm 1 does not say what the first $Q_{m-1}$ is (claim M21). If it is Eq. 1's
# empty sum, then $Q_0 = 0$, and to the letter the *first* network is one backup as
# well: $Q_m$ is m backups of 0, and looks m steps ahead.
#
# > **Predict.** Four perfect boosters, from nothing, with the goal in room 0. Which
# > action does Q prefer in room 9?

# %% tags=["predicted"]
Q = np.zeros((10, 2))
for _ in range(4):
    Q = new.bellman(Q)
print("rooms 1, 3, 4 and 9:", *Q[[1, 3, 4, 9]].round(3).tolist())
assert turned(Q) == 3 and np.allclose(Q[4:], -(1 + 0.9 + 0.81 + 0.729))

# %% [markdown]
# None. In rooms 4 to 9 both actions cost the four steps that it looks ahead. Therefore
# the first learner is a plain DQN here, with $\alpha_1 = 1$ (D8).

# %% [markdown]
# ## Summary
#
# To the letter a perfect booster is one Bellman backup, added once per drift. Two
# changes repair it: bootstrap with the sum that the booster is part of, and fit
# $\alpha h$ (or take α = 1). Then one booster is enough on a table, but it is no longer
# boosting of a fixed residual: it is DQN on top of a frozen sum.
#
# [← 6](06_replay.ipynb) · [contents](README.md) · [8 →](08_theorem_1.ipynb)

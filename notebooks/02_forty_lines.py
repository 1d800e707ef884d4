# %% [markdown]
# # 2 · Forty lines
#
# After this notebook you have written GB-DQN (gradient-boosted deep Q-networks) on a
# table. You know what freezing does to a table, and why Algorithm 1, taken to the
# letter, does not adapt.
#
# *Time: 23 minutes. Needs: notebook 1. With the paper open: section “Gradient Boosted
# DQN”, Eqs. 1 and 4, and Algorithm 1.*

# %%
import numpy as np
from exercises import check, solution
from lesson import (
    FAST,
    GAMMA,
    LEFT,
    RIGHT,
    ROOMS,
    correct_rooms,
    corridor,
    show,
    source,
    step,
)
from pictures import forty_lines as pictures

from gbdqn_ref.tabular import MDP

# %% [markdown]
# ## Two ways to go on
#
# You have a Q that was right yesterday. Overnight the goal has moved. You can
#
# - **go on**: let new transitions write over the old Q, or
# - **freeze**: keep the old Q as it is, and learn only a correction $h$ beside it.
#
# The second way is the paper's: “previously learned components are frozen and
# preserved” (section “Introduction”). There the components are DQNs: they learn as you
# did in notebook 1, but a network takes the table's place. A network is one function
# that computes Q in every room from the same adjustable numbers, its weights. Here we
# keep the table.
#
# The idea comes from gradient boosting. The frozen part stays, and the next learner is
# fitted to the **residual**, to what is still missing:
#
# $$Q = \text{frozen} + h, \qquad \text{residual} = y - \text{frozen}(s, a) .$$
#
# (For a fixed $y$ this is minus the gradient of $\frac12 (y - \text{frozen})^2$; hence
# the name.)
#
# | here | in the paper | where |
# |---|---|---|
# | frozen | $Q_{m-1}$, the **ensemble** of all earlier learners | Eq. 1 |
# | $h$ | $h_m$, the new learner, also called the **booster** | Eq. 1 |
# | $Q$ = frozen + $h$ | $Q_m = Q_{m-1} + \alpha_m h_m$; here $\alpha_m = 1$ | Eq. 1 |
# | residual | $y - Q_{m-1}(s, a)$ | Eq. 4 |
#
# The residual is not quite the TD error. Both start from the target $y$. The TD error
# subtracts all of Q, the residual only the part that is frozen. What $h$ has learnt
# already is not subtracted, because it is $h$ that learns it.
#
# > **Predict.** Which way turns around faster? Write down a number for each: after how
# > many episodes does the agent go left from all nine rooms?
#
# ## Write it
#
# **Exercise 1.** An agent with two tables, `frozen` and `h`. Three methods are yours.
# The flag `live` says whether `h` counts while it learns: if it is True, the agent acts
# by frozen + h and makes its targets from it, as if nothing had been split. We shall
# need False later.
#
# γ is the global `GAMMA`. There is no `target` on this page: write $y$ out, or take ours
# by `from exercises.ten_rooms import target`. `drift` may change the tables in place or
# make new ones, as long as `h` is all 0 afterwards.


# %%
class Boosted:
    """Q = frozen + h. Only h learns; at a drift it joins the frozen part."""

    def __init__(self, live=True):
        self.frozen, self.h = np.zeros((ROOMS, 2)), np.zeros((ROOMS, 2))
        self.live = live

    def q(self):
        """The table it acts by and bootstraps with: with h if live, else without."""
        ...  # yours

    def learn(self, room, action, reward, room2, terminated, rate=0.5):
        """With residual = y − frozen: h += rate * (residual − h) at [room, action]."""
        ...  # yours

    def drift(self):
        """Freeze what is known: h joins the frozen part, and a new h begins at 0."""
        ...  # yours


Boosted = check("Boosted", Boosted)

# %%
solution("Boosted")

# %% [markdown]
# The walk is that of notebook 1, with your agent in it:


# %%
def train(agent, goal, episodes, rng):
    """Walk and learn for some episodes of at most 100 steps, from random rooms."""
    for _ in range(episodes):
        room = rng.choice([r for r in range(ROOMS) if r != goal])
        for _ in range(100):
            action = agent.q()[room].argmax()
            if rng.random() < 0.2:
                action = rng.integers(2)
            room2, reward, terminated = step(room, action, goal)
            agent.learn(room, action, reward, room2, terminated)
            room = room2
            if terminated:
                break


# %% [markdown]
# That is GB-DQN on a table, in forty lines with `step`: your class and `train`. You
# find them in one file, ready to run, in [`forty_lines.py`](forty_lines.py).
#
# ## Go on, or freeze?

# %% tags=["predicted"]
SEEDS = 2 if FAST else 5
EPISODES = (0, 1, 2, 5, 10, 20, 50, 100, 300)


def live_through(seed, freeze, live=True):
    """Learn goal 9, then goal 0: the agent, and how many rooms are right when."""
    agent, rng, lived, found = Boosted(), np.random.default_rng(seed), 0, []
    train(agent, 9, 300, rng)
    assert correct_rooms(agent.q(), 9) == 9
    if freeze:
        agent.drift()
    agent.live = live
    for episodes in EPISODES:
        train(agent, 0, episodes - lived, rng)
        lived = episodes
        found.append(correct_rooms(agent.q(), 0))
    return agent, np.array(found)


print("episodes      ", *(f"{n:4}" for n in EPISODES))
went_on, froze = [], []  # for each seed: the agent, and its counts
for seed in range(SEEDS):
    for name, freeze, kept in (("go on ", False, went_on), ("freeze", True, froze)):
        kept.append(live_through(seed, freeze))
        print(f"seed {seed}, {name}", *(f"{n:4}" for n in kept[-1][1]))

gap = max(
    np.abs(a.q() - b.q()).max() for (a, _), (b, _) in zip(went_on, froze, strict=True)
)
print(f"largest difference between the two Qs after 300 episodes: {gap:.0e}")
assert gap < 1e-12
assert all((a == b).all() for (_, a), (_, b) in zip(went_on, froze, strict=True))

# %% [markdown]
# The same. Not similar: the same rooms after the same episodes, with every seed. The
# two Qs differ by rounding alone. Look at what `learn` does to the sum:
#
# $$\text{frozen} + h + \text{rate}\cdot(y - \text{frozen} - h)
#   \;=\; Q + \text{rate}\cdot(y - Q) .$$
#
# To move $h$ towards $y$ − frozen is to move Q towards $y$, by just as much. **With a
# table, freezing is the same as going on.** Whatever freezing brings or costs must come
# from something that a table does not have. That is a network. All rooms share its
# weights, so one room's Q cannot move without moving the others' (notebook 3).

# %% tags=["predicted"]
agent, _ = froze[0]  # seed 0
show(
    pictures.two_parts(agent.frozen, agent.h),
    alt="Q of left and right in each room as the sum of two parts. Grey points, the "
    "frozen part, rise towards room 9, the old goal. Arrows, the correction h, lead "
    "from them to the new Q, which rises towards room 0.",
)

# %% [markdown]
# ## To the letter
#
# Now read Algorithm 1. Line 7 chooses the action by the “softmax-based policy” of
# $Q_{m-1}$. Lines 9 and 16 make the target from $\bar Q_{m-1}$. All three name the
# *frozen* part alone. The booster is added in line 29, when its time is over. The
# formula of the policy in the text has $Q_m$; so the paper says two things (A1), and
# the code can do both (D6). (As in notebook 1 such codes lead to the ledger; D is for
# what our code decides or does differently.)
#
# The softmax chooses at random among the actions, and the bar marks a delayed copy of a
# network. Neither matters here: a choice by the frozen part does not depend on $h$, and
# the frozen part stands still, so a delayed copy of it is soon the same.
#
# To the letter is one line of your code: `agent.live = False`, after the drift. Before
# the first drift nothing is frozen, so the first learner is live under both readings
# (D8).
#
# > **Predict.** How many rooms are right after 300 episodes? And how many once $h$ is
# > added?

# %% tags=["predicted"]
letter = [live_through(seed, freeze=True, live=False) for seed in range(SEEDS)]
for seed, (agent, found) in enumerate(letter):
    Q = agent.frozen + agent.h
    turned = np.flatnonzero(Q[:, LEFT] > Q[:, RIGHT])
    print(f"seed {seed}: {found[-1]} of 9 rooms right; with h added: rooms", turned)
    assert (found == 0).all() and turned.tolist() == [1]

walk = [5]
while len(walk) < 12:
    walk.append(step(walk[-1], agent.q()[walk[-1]].argmax(), goal=0)[0])
print("a greedy walk:", *walk)

# %% tags=["predicted"]
curves = [
    np.mean([found for _, found in runs], axis=0) for runs in (went_on, froze, letter)
]
show(
    pictures.turning(EPISODES, *curves),
    alt="Rooms that are right, of nine, against episodes after the drift. Going on and "
    "freezing lie on one line, from 0 to 9 within 50 episodes. Freezing to the letter "
    "stays at 0 throughout.",
)

# %% [markdown]
# None, however long it lives. The agent walks by yesterday's map to where the goal used
# to be, and stays about there. (It steps back from room 9, where yesterday's walks
# ended: left and right tie at 0 there, and `argmax` takes left.) The targets that $h$ is
# fitted to come from yesterday's map too. When $h$ is added at last, one room is right,
# the one beside the new goal.
#
# ## How many boosters would it take?
#
# Perhaps the walk is to blame, since it sees so little. So let the booster be perfect:
# $h(s, a)$ is exactly the residual, in every room. To the letter, one stage then gives
#
# $$\text{frozen} \;\leftarrow\; \text{frozen} + \alpha\,(y - \text{frozen}),
#   \qquad y = r + \gamma \max_{a'} \text{frozen}(s', a') .$$
#
# **Exercise 2.** Write that stage, for all rooms and both actions.


# %%
def boost(frozen, goal, alpha):
    """frozen + α h, where h is the residual, and 0 in the goal's row."""
    ...  # yours


boost = check("boost", boost)

# %%
solution("boost")

# %% [markdown]
# At α = 1 that is one sweep of notebook 1: every Q(s, a) is replaced by its target
# once. The field calls it a **Bellman backup**. So a perfect booster of Algorithm 1 is
# one Bellman backup, damped by α (B1). The package has it for any finite world, and
# `source` prints that code below the cell. (`world.residual(Q)` is `bellman(Q)` − Q,
# the residual when all of Q is frozen.)

# %%
source(MDP.bellman)
Q, world = corridor(9).q_star(), corridor(0)
Q[0] = 0  # nothing comes after the new goal
assert np.allclose(boost(Q, 0, 1), world.bellman(Q))
assert np.allclose(boost(Q, 0, 0.1), Q + 0.1 * world.residual(Q))

# %% [markdown]
# The paper adds one booster at each drift. Its experiments set a “shrinkage
# coefficient” of 0.1 and do not say how it enters $\alpha_m$ (A3). For a perfect booster
# Eq. 8 gives α = 1, and the shrinkage makes it 0.1.
#
# > **Predict.** The agent knows goal 9 perfectly, and the goal moves to room 0. How
# > many perfect boosters until all nine rooms are right, at α = 1? And at α = 0.1?

# %% tags=["predicted"]


def stages(alpha, gamma=GAMMA):
    """How many rooms are right after 0, 1, 2, … perfect boosters, until all are."""
    Q, world = corridor(9, gamma).q_star(), corridor(0, gamma)
    Q[0], found = 0, [correct_rooms(Q, 0)]
    while found[-1] < 9:
        Q = Q + alpha * world.residual(Q)
        found.append(correct_rooms(Q, 0))
    return found


counts = {f"α = {alpha:g}": stages(alpha) for alpha in (1, 0.1)}
for name, found in counts.items():
    print(f"{name}: {len(found) - 1} boosters")
paper = {alpha: len(stages(alpha, gamma=0.99)) - 1 for alpha in (1, 0.1)}
print("at the paper's γ = 0.99:", paper)
assert [len(found) - 1 for found in counts.values()] == [10, 82]
assert paper == {1: 10, 0.1: 80}
assert counts["α = 1"] == [0, 1, 2, 3, 4, 4, 5, 6, 7, 8, 9]
steps = [np.log(1 - 0.1 * (1 - gamma)) / np.log(gamma) for gamma in (GAMMA, 0.99)]
assert np.allclose(steps, [0.0954, 0.0995], atol=5e-5)

# %% tags=["predicted"]
show(
    pictures.boosters(counts),
    alt="Rooms that are right, of nine, against the number of perfect boosters. With "
    "α = 1 the last room turns at booster 10, with α = 0.1 at booster 82.",
)

# %% [markdown]
# Ten drifts, or eighty-two, before the agent has answered the first one. There are two
# reasons. The news of the new goal travels one room per backup (B8). And the promise of
# the old goal is taken back slowly: room 9 was worth 0, and each backup lowers it by
# one more discounted step. The paper expects “rapid and localized adaptation” (B9).
#
# <details><summary>Why 10 and not 9? Why 80 and not 82?</summary>
#
# At α = 1 the news reaches room k with booster k. Up to room 4 the room turns at once.
# From room 5 on, the promise of the old goal has by then sunk to the same k steps: left
# and right tie. The next booster lowers the promise again, and the room turns. So
# booster 5 turns no room, and booster 10 turns room 9.
#
# At α = 0.1 the first booster lowers room 9 from 0 to −0.1. That is the worth of n
# steps with (1 − γⁿ)/(1 − γ) = 0.1: n is 0.0954 at γ = 0.9 and 0.0995 at γ = 0.99, and
# each further booster takes back as much. So at 0.99 the promise goes a little faster.
#
# </details>
#
# Live, one booster is enough (B3). Its target contains what it learns itself, so it can
# settle only where Q is its own target, at the new Q*. A perfect live booster is
# $h$ = new Q* − frozen. The walked one approaches it, first where it walks. We compare
# the larger Q of each room, since the other action is tried too seldom:

# %%
new = corridor(0).q_star()
for agent, _ in froze:
    gap = np.abs(agent.q().max(1) - new.max(1))[1:].max()
    both = np.abs(agent.q() - new)[1:].max()
    print(f"from the new Q*: {gap:.0e} in the larger Q, {both:.2f} in either")
    assert gap < 0.01

# %% [markdown]
# Try it (in Jupyter, run the next cell): the rooms after some perfect boosters.

# %% tags=["slider", "live:rooms"]
from ipywidgets import interact


@interact(boosters=(0, 110), alpha=(0.1, 1.0))
def look(boosters=0, alpha=1.0):
    Q = corridor(9).q_star()
    for _ in range(boosters):
        Q = boost(Q, 0, alpha)
    title = f"{boosters} boosters: {correct_rooms(Q, 0)} of 9 rooms are right"
    show(pictures.after(Q, 0, title), alt=title)


# %% [markdown]
# ## With the paper open
#
# Find Eq. 1: its sum is `frozen`, its last term is `h`. Find Eq. 4: it is what $h$
# moves towards in your `learn`. Then go through Algorithm 1 with a pencil and mark
# every $Q_{m-1}$ and every $\bar Q_{m-1}$: those are the places where `live` decides.
# Lines 11, 13, 14 and 18 belong to notebook 6. No line says how a drift is noticed, and
# none computes $\alpha_m$ (A3, A4).

# %% [markdown]
# ## Summary
#
# GB-DQN splits Q into a frozen part and a learner $h$, which is fitted to the residual.
# On a table the split changes nothing, because moving $h$ moves Q by as much. It
# matters only through what the learner is, and that is the next notebook. Algorithm 1
# to the letter is another matter: it acts by the frozen part and makes its targets from
# it. Then a whole stage changes no action, and even a perfect booster is one Bellman
# backup.
#
# [← 1](01_ten_rooms.ipynb) · [contents](README.md) · [3 →](03_forgetting.ipynb)

# %% [markdown]
# # 2 · Forty lines
#
# After this notebook you have written GB-DQN (gradient-boosted deep Q-networks) on a
# table. You know what freezing does to a table, and why Algorithm 1, taken to the
# letter, does not adapt.
#
# *Time: 25 minutes. Needs: notebook 1. With the paper open: section “Gradient Boosted
# DQN”, Eqs. 1 and 4, and Algorithm 1.*
#
# **How to read this with the paper open.** Eq. 1 is what you will write: its last term
# is your `h`, the rest your `frozen`. Eq. 4 is what `h` moves towards. Go through
# Algorithm 1 with a pencil and mark every $Q_{m-1}$ and every $\bar Q_{m-1}$: you will
# need these marks in the section “To the letter”. Lines 11–14 and 18 belong to notebook
# 6. No line says how a drift is noticed (X24).

# %%
import numpy as np
from exercises import check, solution
from lesson import (
    FAST,  # True in tests, which run fewer seeds
    GAMMA,
    LEFT,
    RIGHT,
    ROOMS,
    correct_rooms,
    corridor,
    show,
    source,  # shows the package's code
    step,  # that of notebook 1
)
from pictures import forty_lines as pictures
from pictures import instrument  # a picture, and sliders

from gbdqn_ref.tabular import MDP  # any finite world, as in notebook 1

# %% [markdown]
# ## Two ways to go on
#
# You have a Q that was correct yesterday. Overnight the goal has moved. You can
#
# - **go on**: let new transitions write over the old Q, or
# - **freeze**: keep the old Q as it is, and learn only a correction $h$ beside it.
#
# The second way is the paper's: “previously learned components are frozen and
# preserved” (section “Introduction”). There the components are DQNs: they learn as you
# did in notebook 1, but a **network** takes the table's place: one function that
# computes Q in every room from the same adjustable numbers, its **weights**. Here we
# keep the table.
#
# The idea comes from **gradient boosting**, which builds a sum of small models, one
# after the other. The time in which one is trained is a **stage**. The earlier models
# are frozen, and the new one is fitted to the **residual**, to what their sum lacks:
#
# $$Q = \text{frozen} + h, \qquad \text{residual} = y - \text{frozen}(s, a) .$$
#
# (Hence the name. A **gradient** holds a function's derivatives, one for each of its
# variables. For a fixed $y$ the residual is minus the derivative of
# $\frac12 (y - \text{frozen})^2$ with respect to frozen.)
#
# | here | in the paper | where |
# |---|---|---|
# | frozen | $Q_{m-1}$, the **ensemble** of all earlier learners | Eq. 1 |
# | $h$ | $h_m$, the new learner, also called the **booster** | Eq. 1 |
# | $Q$ = frozen + $h$ | $Q_m = Q_{m-1} + \alpha_m h_m$; here $\alpha_m = 1$ | Eq. 1 |
# | residual | $y - Q_{m-1}(s, a)$ | Eq. 4 |
#
# $m$ counts the stages, and $\alpha_m$ says how much of $h_m$ is added.
#
# The residual $y$ − frozen is what $h$ should become. The step that $h$ takes is
# rate · (residual − $h$).
#
# > **Predict.** Which way turns around faster, or is there no difference? Write down a
# > number for each: after how many episodes does the agent go left from all nine rooms?
#
# ## Write it
#
# **Exercise 1.** An agent with two tables, `frozen` and `h`. Three methods are yours.
# If `live` is True, the agent acts by frozen + h and makes its targets from it. If
# False, from frozen alone; we need that further down.
#
# γ is the global `GAMMA`. There is no `target` on this page: write $y$ out, or take
# ours by `from exercises.ten_rooms import target`. `drift` may change the tables in
# place or make new ones, as long as `h` is all 0 afterwards.


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
# That is GB-DQN on a table: `step`, your class and `train`, together forty lines. Close
# this page and write them once from memory. Then compare:
# [`forty_lines.py`](forty_lines.py) has them in one file that runs.
#
# ## Go on, or freeze?

# %%
SEEDS = 2 if FAST else 5
EPISODES = (0, 1, 2, 5, 10, 20, 50, 100, 300)


def live_through(seed, freeze, live=True):
    """Learn goal 9, then goal 0; count correct rooms after each number of episodes."""
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


# %% tags=["predicted"]
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

# %% [markdown]
# The same. Not similar: the same number of rooms each time, with every seed. After 50
# episodes all nine have turned. The two Qs differ by rounding alone. Here $y$ is made
# from frozen + $h$, so residual − $h$ is the TD error of the sum Q. Look at what
# `learn` does to it:
#
# $$\text{frozen} + h + \text{rate}\cdot(y - \text{frozen} - h)
#   \;=\; Q + \text{rate}\cdot(y - Q) .$$
#
# To move $h$ towards $y$ − frozen is to move Q towards $y$, by just as much. **With a
# table, this update and α = 1, freezing is the same as going on.** Whatever else
# freezing does must come from something that is missing here: another α, an optimizer
# with a memory, or a network. All rooms share its weights, so one room's Q cannot move
# without moving the others' (notebook 3).

# %% tags=["predicted"]
agent, _ = froze[0]  # seed 0
show(
    pictures.two_parts(agent.frozen, agent.h),
    alt="Q of left and right in each room as the sum of two parts. Grey points, the "
    "frozen part, rise towards room 9, the old goal. Arrows, the correction h, lead "
    "from them to the new Q, which rises towards room 0.",
)

# %% [markdown]
# (In the picture, of seed 0, Q(8, right) and Q(9, right) end below −6.51, the lowest Q*
# of the new world. They fell too low while the targets came from rooms that were too
# low themselves, and going right is tried too seldom there to recover.)
#
# ## To the letter
#
# Now read Algorithm 1. Line 7 chooses the action by a **softmax** of $Q_{m-1}$: at
# random, but an action with a larger Q more often. Lines 9 and 16 make the target from
# $\bar Q_{m-1}$. All three name the *frozen* part alone. The booster is added in line
# 29, when its stage ends. The formula of the policy, in section “Gradient Boosted DQN”,
# has $Q_m$; so formula and algorithm disagree (A1), and the code can do both (D6). (D
# is for what our code decides or does differently.)
#
# The bar marks a delayed copy of a network. Neither bar nor softmax matters for how
# many rooms are correct. The frozen part does not move, so nothing that $h$ learns can
# change the choice, and the copy is soon equal.
#
# To follow the letter takes one line: `agent.live = False`, after the drift. Before the
# first drift the frozen part is 0 everywhere: an agent that acted by it would learn
# only that a step costs 1. So we let the first learner be live under both readings
# (D8).
#
# > **Predict.** How many rooms are correct after 300 episodes? And how many once $h$ is
# > added? (Notebook 1 printed the TD errors of the old Q.)

# %% tags=["predicted"]
letter = [live_through(seed, freeze=True, live=False) for seed in range(SEEDS)]
for seed, (agent, found) in enumerate(letter):
    Q = agent.frozen + agent.h
    turned = np.flatnonzero(Q[:, LEFT] > Q[:, RIGHT])
    print(f"seed {seed}: {found[-1]} of 9 rooms are correct; with h: rooms", turned)

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
    alt="Correct rooms, of nine, against episodes after the drift. Going on and "
    "freezing lie on one line, from 0 to 9 within 50 episodes. Freezing to the letter "
    "stays at 0 throughout.",
)

# %% [markdown]
# None, however long it lives. The agent walks by yesterday's map to where the goal used
# to be, and stays about there. (It steps back from room 9, where yesterday's walks
# ended: left and right tie at 0 there, and `argmax` takes left.) The targets that $h$
# is fitted to come from yesterday's map too. So $h$ has learnt what notebook 1 drew,
# the TD error of the old Q: large in (1, left), negative in room 9, 0 elsewhere. When
# $h$ is added at last, room 1 turns, and room 9 prefers right.
#
# ## How many boosters would it take?
#
# Perhaps the walk is to blame, since it sees so little. So let the booster be perfect:
# $h(s, a)$ is exactly the residual, in every room. To the letter, one stage then gives
#
# $$\text{frozen} \;\leftarrow\; \text{frozen} + \alpha\,(y - \text{frozen}),
#   \qquad y = r + \gamma \max_{a'} \text{frozen}(s', a')
#   \text{, or } r \text{ if } s' \text{ is terminal.}$$
#
# **Exercise 2.** Write that stage, for all rooms and both actions.


# %%
def boost(frozen, goal, alpha):
    """A new table, frozen + α h: h is the residual, and 0 in the goal's row."""
    ...  # yours


boost = check("boost", boost)

# %%
solution("boost")

# %% [markdown]
# At α = 1 that is one sweep of notebook 1: every Q(s, a) is replaced by its target
# once. The field calls it a **Bellman backup**. So a perfect booster of Algorithm 1 is
# one Bellman backup, damped by α (B1). The package has it for any finite world, and
# `source` prints that code below the cell. (`world.residual(Q)` is `bellman(Q)` − Q,
# the residual when all of Q is frozen.) It has no case for the end. In `MDP` the goal
# is a room that one never leaves, with reward 0; if its Q is 0, that is the same.

# %%
source(MDP.bellman)
Q, world = corridor(9).q_star(), corridor(0)
Q[0] = 0  # now the end: what the old Q said of room 0 must not enter the target
assert np.allclose(boost(Q, 0, 1), world.bellman(Q))
assert np.allclose(boost(Q, 0, 0.1), Q + 0.1 * world.residual(Q))

# %% [markdown]
# The paper adds one booster at each drift. Its Eq. 8 takes as α the weight of $h$ that
# minimises the squared error. For a perfect booster this is 1. The experiments also
# have a **shrinkage** of 0.1, which is to keep each step small, and do not say how it
# enters $\alpha_m$ (A3). If it is a factor, α is 0.1.
#
# > **Predict.** The agent knows goal 9 perfectly, and the goal moves to room 0. How
# > many perfect boosters until all nine rooms are correct, at α = 1? And at α = 0.1?


# %% tags=["predicted"]
def stages(alpha, gamma=GAMMA):
    """How many rooms are correct after 0, 1, 2, … perfect boosters, until all are."""
    Q, world = corridor(9, gamma).q_star(), corridor(0, gamma)
    Q[0], found = 0, [correct_rooms(Q, 0)]
    while found[-1] < 9:
        Q = Q + alpha * world.residual(Q)
        found.append(correct_rooms(Q, 0))
    return found


counts = {f"α = {alpha:g}": stages(alpha) for alpha in (1, 0.1)}
for name, found in counts.items():
    print(f"{name}: {len(found) - 1} boosters")

# %% tags=["predicted"]
show(
    pictures.boosters(counts),
    alt="Correct rooms, of nine, against the number of perfect boosters. With "
    "α = 1 the last room turns at booster 10, with α = 0.1 at booster 82.",
)

# %% [markdown]
# Ten boosters, or eighty-two. One comes with each drift. Even if all later drifts left
# the goal in room 0, it would take ten to answer the first. (At the paper's γ = 0.99 it
# is 10 or 80.) There are two reasons. The news of the new goal travels one room per
# backup (B8). And the promise of the old goal is withdrawn slowly: room 9 was worth 0,
# and each backup lowers it by one more discounted step at most. The paper expects
# “rapid and localized adaptation” (B9).
#
# <details><summary>Why 10 and not 9, at α = 1</summary>
#
# After k boosters Q looks k steps ahead. The news of the new goal, k steps to the left,
# reaches room k with booster k. Up to room 4, k steps to the right do not reach room 9:
# what waits there is an old value that still expects more steps, so left wins and the
# room turns at once. From room 5 on, k steps to the right can reach room 9, where the
# old Q promised an end. Then right, too, looks like k steps of −1: a tie. The next
# booster adds a step to the right side alone, and the room turns. So booster 5 turns no
# room, and booster 10 turns room 9.
#
# </details>
#
# Live, with α = 1, one booster is enough (B3). Its target contains what it learns
# itself, so it can settle only where Q is its own target, at the new Q*. A perfect live
# booster is $h$ = new Q* − frozen. The $h$ that your agent learns comes close to it,
# first where the agent walks often. We compare the larger Q of each room, since the
# other action is tried too seldom:

# %%
new = corridor(0).q_star()
for agent, _ in froze:
    gap = np.abs(agent.q().max(1) - new.max(1))[1:].max()
    both = np.abs(agent.q() - new)[1:].max()
    print(f"furthest from the new Q*: {gap:.0e} in the larger Q, {both:.2f} in any Q")
    assert gap < 0.01

# %% [markdown]
# Here is the instrument of the ten rooms. The upper panel shows Q as bars, with what is
# left of the residual; the lower panel shows the policy after each perfect booster,
# green where it is right. In Jupyter, run the cell after the picture, and move α, γ and
# the two switches: target frozen or live, and whether the booster is fitted as $h$ or
# as $\alpha h$. (Fitted as $\alpha h$, it cancels α; fitted as $h$ with α < 1, even a
# live one stops short. Notebooks 4 and 7 say why.)

# %% tags=["still"]
show(
    instrument.instrument(5),
    alt="Q of both actions in each room after five boosts with a frozen target, and "
    "the residual, which remains in rooms 4 to 9. Below, the policy after each boost: "
    "up to boost 4 one more room turns left each time; boost 5 turns none.",
)

# %% tags=["slider", "live:rooms"]
instrument.slider()

# %% tags=["checks"]
for (a, counted), (b, counted_too) in zip(went_on, froze, strict=True):
    assert np.abs(a.q() - b.q()).max() < 1e-12 and (counted == counted_too).all()
old = corridor(9).q_star()
old[0] = 0
delta = corridor(0).residual(old)
for agent, found in letter:
    Q, known = agent.frozen + agent.h, delta.copy()
    known[1, LEFT] = agent.h[1, LEFT]  # still on its way to delta
    assert (found == 0).all() and 2 < agent.h[1, LEFT] < delta[1, LEFT]
    assert np.allclose(agent.h, known, atol=0.01)
    assert np.flatnonzero(Q[:, LEFT] > Q[:, RIGHT]).tolist() == [1]
    assert Q[9, RIGHT] > Q[9, LEFT]
assert (froze[0][0].q()[8:, RIGHT] < new.min()).all()
assert np.isclose(new.min(), -6.51, atol=0.005)
assert [len(found) - 1 for found in counts.values()] == [10, 82]
assert counts["α = 1"] == [0, 1, 2, 3, 4, 4, 5, 6, 7, 8, 9]
assert [len(stages(alpha, gamma=0.99)) - 1 for alpha in (1, 0.1)] == [10, 80]

# %% [markdown]
# ## Summary
#
# GB-DQN splits Q into a frozen part and a learner $h$, which is fitted to the residual.
# On a table the split changes nothing, because moving $h$ moves Q by as much. It can
# matter only with a network, another optimizer or another α. The next notebook takes a
# network. Algorithm 1 to the letter is another matter: it acts by the frozen part and
# makes its targets from it. Then a whole stage changes no action, and even a perfect
# booster is one Bellman backup.
#
# [← 1](01_ten_rooms.ipynb) · [contents](README.md) · [3 →](03_forgetting.ipynb)

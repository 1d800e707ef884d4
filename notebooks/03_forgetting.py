# %% [markdown]
# # 3 · A network forgets
#
# After this notebook you can say why a network forgets, measure how much, and say what
# freezing keeps and what it does not.
#
# *Time: 22 minutes. Needs: notebooks 1 and 2, and derivatives. With the paper open:
# section “Introduction”, paragraphs 2 and 3.*
#
# **How to read this with the paper open.** Mark “destructive interference” in paragraph
# 2 and “frozen and preserved” in paragraph 3. One picture below shows both: the first
# in rooms 5 to 8, the second as a line at 0. Ask of each sentence about forgetting: does
# it speak of the components, or of the sum that acts?

# %%
from copy import deepcopy

import numpy as np
from exercises import check, solution
from forty_lines import Boosted
from lesson import (
    FAST,
    GAMMA,
    LEFT,
    RIGHT,
    ROOMS,
    correct_rooms,
    corridor,
    show,
    step,
)
from pictures import forgetting as pictures

from gbdqn_ref.nn import MLP
from gbdqn_ref.optim import Adam

# %% [markdown]
# ## One room's Q moves the others'
#
# A table has a number for each room and action. Change one, and the others stay. That
# works for ten rooms, but not for a robot arm, whose angles are real numbers. So one
# uses a function that computes Q from the state and from adjustable numbers, its
# **parameters**. Usually it is a network, and the parameters are its weights.
#
# The smallest such function is a line. Let $x$ be the position of a room, from −1 at
# the left end to 1 at the right, and $Q(x) = w x + b$. How wrong Q is at $x$ is measured
# by a **loss**, here $\frac12 (y - Q(x))^2$. A gradient step moves the parameters a
# little against the loss's gradient. With $\delta = y - Q(x)$ it adds rate · δ · x to
# $w$ and rate · δ to $b$.
#
# **Exercise 1.** By how much does this step at $x$ change Q at another position, $x_2$?


# %%
def elsewhere(x, x2, delta, rate):
    """The change of Q(x2) = w x2 + b by one gradient step at x."""
    ...  # yours


elsewhere = check("elsewhere", elsewhere)

# %%
solution("elsewhere")

# %% [markdown]
# So a step at one place moves Q almost everywhere. For any function with parameters θ,
# the same calculation gives, for a small step,
#
# $$\Delta Q(x_2) \;\approx\; \text{rate} \cdot \delta \cdot
#   \nabla_\theta Q(x) \cdot \nabla_\theta Q(x_2) .$$
#
# Where the two gradients point the same way, $Q(x_2)$ moves along with $Q(x)$. If that
# is welcome, it is called **generalization**; if it is not, **interference**. It is the
# same thing.
#
# ## Your forty lines, with a network
#
# Here is your class from notebook 2 once more. `h` is now a small network of the
# position, from the package. Each of its 32 **hidden units** computes max(0, w x + b),
# with numbers of its own; each Q is a weighted sum of the 32, plus a constant.
# `nn.MLP.forward` computes this, `nn.MLP.backward` gives the gradient, and **Adam**
# turns the gradient into a step: it divides each weight's part by the size that this
# part usually has (notebook 14 takes all three apart). There are only ten rooms, so we
# keep the frozen network's answers as a table. A new $h$ begins as the zero function
# (D11), so that a drift alone changes nothing.


# %%
POSITION = np.linspace(-1, 1, ROOMS, dtype=np.float32)[:, None]


class BoostedNetwork:
    """Q = frozen + h, where h is a network; only h learns."""

    def __init__(self, seed):
        self.rng, self.net = np.random.default_rng(seed), MLP((1, 32, 2))
        self.frozen = np.zeros((ROOMS, 2))
        self.begin_anew()

    def begin_anew(self, zero=False):
        """A new network h; with zero, it is the zero function at first."""
        self.theta = self.net.init(self.rng, zero_output=zero)
        self.adam = Adam(self.net.size, lr=0.003)

    def q(self):
        return self.frozen + self.net.forward(self.theta, POSITION)[0]

    def learn(self, transitions):
        """One step of h towards the residuals of all these transitions at once."""
        room, action, room2, reward, terminated = transitions
        h, cache = self.net.forward(self.theta, POSITION)
        q_next = (self.frozen + h)[room2].max(1)
        y = np.where(terminated, reward, reward + GAMMA * q_next)
        residual = y - self.frozen[room, action]
        dq = np.zeros((ROOMS, 2), np.float32)  # the gradient of ½ Σ (residual − h)²
        dq[room, action] = h[room, action] - residual
        self.adam.step(self.theta, self.net.backward(self.theta, cache, dq))

    def drift(self):
        """Freeze what is known; a new h begins at 0."""
        self.frozen = self.q()
        self.begin_anew(zero=True)


def transitions(goal, rooms=range(ROOMS)):
    """Each action in each of these rooms once, as arrays."""
    pairs = [(room, a) for room in rooms if room != goal for a in (LEFT, RIGHT)]
    rows = [(room, a, *step(room, a, goal)) for room, a in pairs]
    room, action, room2, reward, terminated = map(np.array, zip(*rows, strict=True))
    return room, action, room2, reward, terminated


# %% [markdown]
# There is no walking here. The transitions that one update learns from are a
# **batch**. Here a batch has every transition of the rooms in question, at first all 18
# of the nine rooms. So whatever we find is not a matter of exploring. First it learns
# that the goal is room 9:

# %%
UPDATES = 800


def trained(seed):
    """A network that has learnt goal 9, without any freezing so far."""
    agent, world = BoostedNetwork(seed), transitions(9)
    for _ in range(UPDATES):
        agent.learn(world)
    assert correct_rooms(agent.q(), 9) == 9
    return agent


experts = [trained(seed) for seed in range(3 if FAST else 10)]

# %% [markdown]
# > **Predict.** Now it learns one thing only: left of room 1 is the goal. Q(1, left)
# > must rise from −6.5 to −1. We stop half-way. What happens to Q(s, left) in the other
# > rooms, in a table and in this network? Sketch both.

# %% tags=["predicted"]
agent = deepcopy(experts[0])
start = agent.q()
assert abs(corridor(9).q_star()[1, LEFT] + 6.5) < 0.05
one = tuple(column[:1] for column in transitions(0, [1]))  # (1, left) alone
while agent.q()[1, LEFT] - start[1, LEFT] < 2.75:
    agent.learn(one)
table = np.zeros(ROOMS)
table[1] = 2.75
show(
    pictures.one_update(table, (agent.q() - start)[:, LEFT]),
    alt="Change of Q(s, left) in the ten rooms. In a table only room 1 changes, by "
    "2.75. In the network it changes in all rooms, most of all near room 1.",
)
moved = np.abs(agent.q() - start)[:, LEFT]
print("rooms that have moved by more than 0.1:", int((moved > 0.1).sum()))

# %% [markdown]
# ## Forgetting
#
# When what an agent knew gets lost because it learns something else, that is
# **forgetting**. When a network loses nearly all of it, the field says **catastrophic
# forgetting**. The paper is written against it: freezing “directly mitigates
# catastrophic forgetting” (section “Introduction”). We measure it in two ways.
#
# **Exercise 2.** First, a measure. Given for each room whether its action was right and
# whether it still is, how many rooms have been forgotten?


# %%
def forgotten(was_right, is_right):
    """The number of rooms that were right and are not any more; two boolean arrays."""
    ...  # yours


forgotten = check("forgotten", forgotten)

# %%
solution("forgotten")

# %% [markdown]
# ### Rooms that it no longer visits
#
# The goal moves to room 0, and the agent now lives beside it: all transitions that it
# sees start in rooms 1 to 3. It never acts in rooms 5 to 8 again, and nothing it sees
# says anything about them.
#
# > **Predict.** How far does Q move in rooms 5 to 8, if it goes on? And if it freezes,
# > and only a new $h$ learns?


# %% tags=["predicted"]
def near_the_goal(agent, freeze, updates=600):
    """How far Q moves in each room, and how many of rooms 5 to 8 are forgotten."""
    agent = deepcopy(agent)
    if freeze:
        agent.drift()
    before, world = agent.q(), transitions(0, range(1, 4))
    for _ in range(updates):
        agent.learn(world)
    right = [Q[5:9, RIGHT] > Q[5:9, LEFT] for Q in (before, agent.q())]
    return np.abs(agent.q() - before).mean(1), forgotten(*right)


changes = {}
for name, freeze in (("go on", False), ("freeze", True)):
    found = [near_the_goal(expert, freeze) for expert in experts]
    changes[name] = np.array([moved for moved, _ in found])
    far, lost = changes[name][:, 5:9].mean(), [count for _, count in found]
    print(f"{name}: Q moves by {far:.2f} on average; of 4 rooms it forgets {lost}")
    assert far > 0.5 and sum(lost) >= len(lost)

table = Boosted()
table.frozen = corridor(9).q_star()
for _ in range(100):
    for room, action, room2, reward, end in zip(
        *transitions(0, range(1, 4)), strict=True
    ):
        table.learn(room, action, reward, room2, end)
assert (table.h[4:] == 0).all()
print("table: Q moves by 0, with or without freezing")

# %% tags=["predicted"]
show(
    pictures.unvisited(changes),
    alt="Change of Q in each room after learning in rooms 1 to 3 only. Going on and "
    "freezing move Q in the unvisited rooms too, by 1 to 3 on average, and their "
    "ranges overlap. The frozen part stays at 0.",
)

# %% [markdown]
# Freezing does not prevent it. The frozen part has not moved at all. But the agent acts
# by frozen + $h$, and $h$ is a network too: what it learns in room 1 it also says in
# room 8. The paper writes that earlier components “remain largely intact, mitigating
# catastrophic forgetting” (section “Acrobot”). The components do remain intact, to the
# last bit. The sum does not (M20).
#
# Look at which action they have learnt, though. In the new world left *is* the correct
# action in rooms 5 to 8, and the network guessed it from rooms 1 to 3. What is
# forgetting for the old goal is generalization for the new one. A network cannot tell
# which you want.
#
# ### The old goal comes back
#
# Second, the goal moves from 9 to 0, now seen from all rooms, and then it moves back to
# 9. An agent that has kept something should be quick. We compare agents that
#
# - **go on** with the same network,
# - **freeze** it at both drifts, and learn a new $h$,
# - **begin anew** with a random network.
#
# > **Predict.** Who needs the fewest updates until Q is within 0.5 of Q*, after the
# > first drift and after the second? Rank the three.


# %% tags=["predicted"]
def two_drifts(agent, name, updates=600):
    """The largest error of Q, per drift and update."""
    agent, errors = deepcopy(agent), []
    for goal in (0, 9):
        if name == "freeze":
            agent.drift()
            assert correct_rooms(agent.frozen, 9 - goal) == 9  # Q_1, and then Q_2
        elif name == "begin anew":
            agent.begin_anew()
        elif name == "go on, new Adam":
            agent.adam = Adam(agent.net.size, lr=0.003)
        world, q_star = transitions(goal), corridor(goal).q_star()
        for _ in range(updates):
            errors.append(np.abs(np.delete(agent.q() - q_star, goal, axis=0)).max())
            agent.learn(world)
        assert correct_rooms(agent.q(), goal) == 9
        assert correct_rooms(agent.q(), 9 - goal) == 0
    return np.reshape(errors, (2, updates))


NAMES = "go on", "freeze", "begin anew", "go on, new Adam"
errors = {
    name: np.array([two_drifts(expert, name) for expert in experts]) for name in NAMES
}
updates = {name: (errors[name] < 0.5).argmax(2) for name in NAMES}  # (seeds, drifts)
print("median updates        drift 1  drift 2")
for name in NAMES:
    first, second = np.median(updates[name], axis=0)
    print(f"{name:<20}{first:8.0f} {second:8.0f}")

assert (updates["go on"] < updates["freeze"]).mean() >= 0.9
assert (updates["freeze"] < updates["begin anew"]).mean() >= 0.8
ratio = np.median(updates["freeze"], axis=0) / np.median(updates[NAMES[-1]], axis=0)
assert np.abs(np.log(ratio)).max() < 0.3

# %% tags=["predicted"]
show(
    pictures.recoveries(errors),
    alt="Largest error of Q against updates after each of the two drifts, mean over "
    "the seeds. Going on falls first. Freezing and going on with a new Adam fall "
    "together, later. Beginning anew is the slowest.",
)

# %% [markdown]
# Going on is fastest, after both drifts. Before you conclude that freezing is slow,
# look at the last row. It is a **control**: it changes one suspected cause and nothing
# else. Adam, the optimizer, remembers how large the gradients were, and makes larger
# steps after small gradients. An agent that goes on enters the drift with small
# gradients in that memory; a new $h$ comes with a new Adam. Give a new Adam to the agent
# that goes on, too, and its lead is gone. **Here freezing and going on are about
# equally quick; what differed was the optimizer.** An experiment that compares methods
# has to hold such things equal (notebook 12).
#
# The paper says that “new learners correct only the discrepancies introduced by drift
# rather than relearning the value function from scratch” (section “Introduction”).
# Freezing does beat beginning anew. But it does not beat what it is meant to replace.
# When the goal moves to the other end, the discrepancy is no small correction: it is as
# large as Q itself.
#
# And when the old goal is back, freezing takes as long as the first time. Yet what it
# is looking for lies in its ensemble: $Q_1$, frozen at the first drift.

# %%
agent = deepcopy(experts[0])
agent.drift()
for _ in range(600):
    agent.learn(transitions(0))
print("right for goal 9, as it acts:", correct_rooms(agent.q(), 9), "of 9 rooms")
print("right for goal 9, in its Q_1:", correct_rooms(agent.frozen, 9), "of 9 rooms")
assert correct_rooms(agent.q(), 9) == 0 and correct_rooms(agent.frozen, 9) == 9
size = np.abs(corridor(0).q_star() - corridor(9).q_star()).max()
print(f"Q* changes by up to {size:.1f}; its largest entry is", end=" ")
print(f"{np.abs(corridor(0).q_star()).max():.1f}")

# %% [markdown]
# **What is kept is $Q_1$ inside the ensemble, not the behaviour.** To use it again, an
# agent would have to notice that the old world is back, and to act by $Q_1$ alone. That
# would take no update at all. Nothing in Algorithm 1 does so; it adds a third learner.
# Notebook 13 comes back to this.
#
# This was one small network in one small world. The experiments of notebook 12 ask the
# same of larger ones.

# %% [markdown]
# ## Summary
#
# In a network one room's Q cannot move without moving the others'. So a network that
# learns in one place forgets, or generalizes, in another. Freezing keeps the old
# components exactly, but the agent acts by the sum, and the sum forgets as much as a
# network that goes on. With equal optimizers the two are about equally quick after a
# drift, also when the old goal returns. The next notebooks take the parts one by one,
# beginning with the residual.
#
# [← 2](02_forty_lines.ipynb) · [contents](README.md) · [4 →](04_boosting.ipynb)

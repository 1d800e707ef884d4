# %% [markdown]
# # 1 · Ten rooms
#
# After this notebook you can compute Q on ten rooms, by hand and by walking, and say
# what the TD error shows when the goal moves, and what it does not.
#
# *Time: 22 minutes. Needs: Python, the geometric series and, for one folded proof, the
# triangle inequality. With the paper open: section “Introduction”, first two
# paragraphs.*
#
# The paper is *GB-DQN: Gradient Boosted DQN Models for Non-stationary Reinforcement
# Learning* (arXiv 2512.17034). DQN is short for deep Q-network; Q comes below.
#
# **How to read this with the paper open.** Read those two paragraphs now, without
# minding the words that you do not know, and again at the end. By then you will know
# that the paper's “value function” is our Q, and its “model drift” our drift. It says
# that a drift leaves old value functions “systematically biased”. The summary says
# where.

# %%
import numpy as np
from exercises import check, solution
from lesson import GAMMA, LEFT, RIGHT, ROOMS, correct_rooms, corridor, show
from pictures import ten_rooms as pictures  # our drawings; show() shows one

from gbdqn_ref.tabular import MDP

# %% [markdown]
# ## The rooms
#
# You stand in one of ten rooms in a row, a corridor with a wall at either end. You can
# go left or right; a step into a wall leaves you where you are. Every step costs 1. One
# room is the goal, and when you reach it the walk is over.
#
#     room    0    1    2    3    4    5    6    7    8    9
#                                                         goal
#
# The field has words for this.
#
# - Your room is the **state** $s$.
# - Left and right are the **actions** $a$. In code `LEFT` is 0 and `RIGHT` is 1.
# - The −1 that a step costs is the **reward** $r$.
# - One step is a **transition**: from $s$, by $a$, for $r$, to the next state $s'$.
# - The goal is a **terminal state**: nothing comes after it.
# - The walk from the start to the end is an **episode**.
# - The walker, who learns from the walks, is the **agent**.


# %%
def step(room, action, goal):
    """Walk one room: (next room, reward, whether that is the end)."""
    room2 = room + 1 if action == RIGHT else room - 1
    room2 = min(max(room2, 0), ROOMS - 1)  # there is a wall at either end
    return room2, -1.0, room2 == goal


print(step(8, RIGHT, goal=9), step(0, LEFT, goal=9))

# %% [markdown]
# ## What a walk is worth
#
# The **return** of a walk is the sum of its rewards, where later ones count less. The
# first reward counts in full, the second 0.9 times, the third 0.81 times, and so on.
# The factor γ = 0.9 is the **discount**.
#
# $$G = r_0 + \gamma\, r_1 + \gamma^2 r_2 + \dots$$
#
# From room 6 you walk three steps: −1 − 0.9 − 0.81 = −2.71.
#
# **Exercise 1.** Write the return down as a function. Run the cell as it is, and you
# see what the checker says. Then replace the dots. Until yours is right, ours stands in
# for it, so the page goes on; `solution` shows ours, folded.


# %%
def discounted(rewards, gamma):
    """G, the sum of γ to the k times rewards[k], k = 0, 1, …"""
    ...  # yours


discounted = check("discounted", discounted)
print(f"{discounted([-1, -1, -1], GAMMA):.2f}")

# %%
solution("discounted")

# %% [markdown]
# A **policy** says which action to take in each state. Here the best one needs no
# thought: go right.
#
# > **Predict.** Another policy always goes left. It never reaches the goal. What is its
# > return?
#
# <details><summary>Answer</summary>
#
# A reward of −1 for ever: −1 − γ − γ² − … = −1/(1 − γ) = −10. The discount makes even
# an endless walk's return finite. No walk in this corridor can be worse, since no
# reward is below −1.
#
# </details>
#
# ## Q
#
# **Q(s, a)** is the return that you get if you take action $a$ in state $s$, and do the
# best you can from then on. If you know Q, you know the best action: the one whose Q is
# largest. The policy that takes it is called **greedy**.
#
# > **Predict.** Q(8, right) is −1: one step, and you are there. What is Q(8, left)?
#
# <details><summary>Answer</summary>
#
# You go to room 7, which is two steps from the goal: −1 + 0.9 · (−1 − 0.9) = −2.71.
#
# </details>
#
# The answer used the Q of room 7. In general, Q in one room follows from Q in the next:
#
# $$Q(s, a) = r + \gamma \max_{a'} Q(s', a'),
#   \qquad\text{or just } r \text{ if } s' \text{ is terminal.}$$
#
# In words: what the step costs, and then the best that the next room offers. This sum
# is called the **target**, $y$.
#
# **Exercise 2.** Write the target.


# %%
def target(reward, terminated, q_next, gamma):
    """y. q_next is the array Q[s′], a number per action; terminated: s′ is terminal."""
    ...  # yours


target = check("target", target)

# %%
solution("target")

# %% [markdown]
# Start with Q = 0 everywhere, replace each Q(s, a) by its target, and do so again and
# again, until nothing changes. (After k sweeps Q looks k steps ahead. Here ten are
# enough.) The Q that is its own target is the exact one, Q*. A proof below shows that
# there is only one.


# %%
def sweep(Q, goal):
    """Every Q(s, a) replaced by its target."""
    new = np.zeros((ROOMS, 2))
    for room in range(ROOMS):
        for action in (LEFT, RIGHT):
            if room != goal:
                room2, reward, terminated = step(room, action, goal)
                new[room, action] = target(reward, terminated, Q[room2], GAMMA)
    return new


print("sweep  Q(0, left)  Q(0, right)  Q(8, left)")
Q, sweeps = np.zeros((ROOMS, 2)), 0
while (sweep(Q, goal=9) != Q).any():
    Q, sweeps = sweep(Q, goal=9), sweeps + 1
    print(f"{sweeps:5}{Q[0, LEFT]:12.3f}{Q[0, RIGHT]:13.3f}{Q[8, LEFT]:12.3f}")

q_old = corridor(9).q_star()  # the same world, as all notebooks have it
assert np.allclose(Q, q_old)

# %%
show(
    pictures.q_and_policy(q_old, goal=9),
    alt="Q of both actions in the rooms 0 to 8. Right is worth more than left in each, "
    "and both rise towards the goal in room 9. Below, an arrow to the right in each.",
)

# %% [markdown]
# ## Learning by walking
#
# So far we knew where each step leads. An agent does not know. It walks, and each
# transition tells it about one pair $(s, a)$. Its Q is an estimate. Its target contains
# $Q(s', a')$, so the target is an estimate too. To learn one estimate from another is
# to **bootstrap**. The target minus what Q says now is the **TD error** (TD stands for
# temporal difference):
#
# $$\delta = y - Q(s, a), \qquad Q(s, a) \leftarrow Q(s, a) + \text{rate} \cdot \delta .$$
#
# The **learning rate** says how far Q moves towards the target: with 0.5, half the way.
#
# **Exercise 3.** Write this update.


# %%
def update(Q, room, action, y, rate):
    """Move Q[room, action] towards y, in place."""
    ...  # yours


update = check("update", update)

# %%
solution("update")

# %% [markdown]
# This rule is called **Q-learning**. Which action should it take meanwhile? Mostly the
# greedy one. But an agent that is always greedy learns nothing about what it never
# tries, so one action in five is random. Such a policy is called **ε-greedy**, here
# with ε = 0.2. (At a tie `argmax` takes the first action, left.)


# %%
def train(Q, goal, episodes, rng):
    """Walk and learn for some episodes of at most 100 steps, from random rooms."""
    for _ in range(episodes):
        room = rng.choice([r for r in range(ROOMS) if r != goal])
        for _ in range(100):
            action = rng.integers(2) if rng.random() < 0.2 else Q[room].argmax()
            room2, reward, terminated = step(room, action, goal)
            y = target(reward, terminated, Q[room2], GAMMA)
            update(Q, room, action, y, rate=0.5)
            room = room2
            if terminated:
                break


# %% [markdown]
# `correct_rooms(Q, goal)` counts the rooms in which the way to the goal has the
# strictly larger Q: nine at best.
#
# > **Predict.** Five agents start with Q = 0. After how many episodes do all five
# > prefer the best action in all nine rooms: 1, 5, 10, 20, 50 or 100?

# %% tags=["predicted"]
EPISODES, counts = (1, 5, 10, 20, 50, 100), []
print("episodes  ", *(f"{n:4}" for n in EPISODES))
for seed in range(5):
    rng, Q, lived, found = np.random.default_rng(seed), np.zeros((ROOMS, 2)), 0, []
    for episodes in EPISODES:
        train(Q, 9, episodes - lived, rng)
        lived = episodes
        found.append(correct_rooms(Q, 9))
    print(f"seed {seed}    ", *(f"{n:4}" for n in found))
    counts.append(found)
all_correct = EPISODES[(np.array(counts) == 9).all(0).argmax()]
print("all five are correct in all rooms after", all_correct, "episodes")

# %% [markdown]
# <details><summary>Why a seed can lose rooms again</summary>
#
# Seed 0 is correct everywhere after 20 episodes and has lost two rooms after 50.
# Learning goes on after a room is correct. Q starts at 0, above Q*, and falls to it.
# The action that is walked more often falls sooner. For a while the other one looks
# better, until it has been tried and has fallen too.
#
# </details>

# %% [markdown]
# ## The goal moves
#
# You know the way. Then, overnight, the goal moves to room 0, and nobody tells you. A
# change of the world while an agent lives in it is called a **drift**. Room 9 was
# terminal, so the old Q there is still 0 for both actions.
#
# > **Predict.** In how many of the nine rooms outside the new goal does the old Q still
# > prefer the best action? And where will the TD error show that something has changed?
# > Name the rooms.

# %% tags=["predicted"]
delta = np.zeros((ROOMS, 2))
for room in range(1, ROOMS):  # room 0 is the goal now
    for action in (LEFT, RIGHT):
        room2, reward, terminated = step(room, action, goal=0)
        y = target(reward, terminated, q_old[room2], GAMMA)
        delta[room, action] = y - q_old[room, action]

seen = np.flatnonzero(np.abs(delta).max(1) > 1e-9)
print("rooms in which the old Q is correct:", correct_rooms(q_old, 0))
print("rooms in which a TD error shows:    ", seen.tolist())
for room in seen:
    print(f"δ({room}, left) and δ({room}, right):", *delta[room].round(2))

# %% tags=["predicted"]
old = [RIGHT] * 9 + [None]
new = [None] + [LEFT] * 9
show(
    pictures.errors_and_policies(delta, old, new, goal=0),
    alt="TD errors of the old Q, now that the goal is room 0: a large positive one "
    "in room 1 for going left, two negative ones in room 9, none in the rooms between. "
    "Below, the best action was right in rooms 0 to 8 and is left in rooms 1 to 9.",
)

# %% [markdown]
# None of the nine is correct: every room has to turn around. (In room 9 left and right
# tie, and a tie does not count.) Only two of them notice, rooms 1 and 9. In room 1
# going left is a good surprise. In room 9, where walks used to end, every step is a bad
# one. Room 8 is silent: before, nothing came after room 9; now the Q there is 0, which
# is the same. In room 5 nothing seems wrong: its Q agrees with the Q of rooms 4 and 6,
# which are just as outdated. **The TD error looks one step ahead. It shows where Q
# contradicts itself, not where Q is wrong.** The news must travel from room to room.
#
# ## How much does a TD error tell?
#
# Drift can also be silent. The paper concludes that “non-trivial model drift
# necessarily induces a positive TD-error signal” (section “Conclusions”). “Positive”
# may mean above 0, or only not 0. Take one state and one action. Before: a reward of 1
# at every step, for ever. After: a reward of 2, and the end. At γ = ½ both are worth 2.

# %%
q_before = 1 / (1 - 0.5)
y = target(2.0, True, np.array([q_before]), 0.5)
print("TD error after the change:", y - q_before)
print(f"at γ = 0.9 it would be:    {y - 1 / (1 - 0.9):.1f}")
assert y - q_before == 0 and np.isclose(y - 1 / (1 - 0.9), -8)

# %% [markdown]
# Another world, and no TD error, neither above 0 nor below. So the sentence needs an
# assumption: that the values move. Here they have not, and nothing has to be learnt
# anew. At γ = 0.9 the same change does change them, and δ shows it. (Claim C1. Codes
# like this one lead to our [ledger](../paper_checks/README.md) of the paper's claims,
# where each has its proof or test.)
#
# What does hold is a bound in both directions (C2). Write $\Delta Q^*$ for the new Q*
# minus the old one. Write $\lVert x \rVert_\infty$ for the largest absolute entry of
# $x$, the **sup norm**. And let $\delta$ be the TD errors of the old Q* in the new
# world, at all states and actions. Then
#
# $$(1 - \gamma)\,\lVert \Delta Q^* \rVert_\infty \;\le\; \lVert \delta \rVert_\infty
#   \;\le\; (1 + \gamma)\,\lVert \Delta Q^* \rVert_\infty .$$
#
# <details><summary>Proof</summary>
#
# Let $TQ$ be Q after one sweep of the new world, so that $T Q^*_{new} = Q^*_{new}$.
# Then $\delta = T Q^*_{old} - Q^*_{old} = (T Q^*_{old} - T Q^*_{new}) + \Delta Q^*$.
# Both terms of the bracket have the new world's rewards, which cancel. What remains is
# γ times the difference of the two maxima in the next state (or its mean, if several
# next states are possible). And
# $|\max a - \max b| \le \max |a - b|$. So the bracket is at most
# $\gamma \lVert \Delta Q^* \rVert_\infty$. The triangle inequality gives both sides.
#
# In the same way one sweep shrinks the distance of any two Q to at most γ times what it
# was. If both are their own targets, a sweep leaves them where they are: their distance
# $d$ is at most $\gamma d$, and so it is 0.
#
# </details>
#
# So complete silence is harmless: if δ is 0 at every pair, Q* has not changed, and
# there is nothing to relearn. And if Q* has changed, some δ is not 0; in that sense the
# paper is right. But the bound is about the old Q* and the largest |δ| over *all*
# pairs. A walking agent sees only the pairs that it visits.
#
# At γ = 0.9 the sides are a factor of 19 apart: a largest TD error of 1 may mean that
# Q* has moved by 0.53 or by 10. We try the bound on random worlds, and on one where its
# lower side is reached: every reward falls by 1, and no walk ends.
#
# `MDP` is any finite world (a Markov decision process, **MDP**): `P` holds the
# probabilities of the next states, `r` the rewards. A step may have several outcomes;
# then targets and Q* are averages over them. `q_star()` is Q*. `residual(Q)` is the TD
# error of Q at every pair; notebook 2 says why the package calls it so.

# %%
rng = np.random.default_rng(0)


def random_world():
    """Three states, two actions, no end."""
    P = rng.dirichlet(np.ones(3), size=(3, 2))  # probabilities: each row adds up to 1
    return MDP(P, rng.normal(size=(3, 2)), GAMMA)


for _ in range(100):
    before, after = random_world(), random_world()
    moved = np.abs(after.q_star() - before.q_star()).max()
    shown = np.abs(after.residual(before.q_star())).max()
    assert (1 - GAMMA) * moved - 1e-9 <= shown <= (1 + GAMMA) * moved + 1e-9

before = random_world()
dearer = MDP(before.P, before.r - 1, GAMMA)
moved = np.abs(dearer.q_star() - before.q_star()).max()
shift = dearer.residual(before.q_star())
shown = np.abs(shift).max()
print(f"every reward 1 less: Q* moves by {moved:.2f}, every δ is {shift.max():.2f}")
assert np.allclose(shift, -1) and np.isclose(shown, (1 - GAMMA) * moved)
assert np.allclose([1 / (1 + GAMMA), 1 / (1 - GAMMA)], [0.53, 10], atol=0.005)
assert (dearer.q_star().argmax(1) == before.q_star().argmax(1)).all()

# %% [markdown]
# In that last world every TD error is negative. Every value moved by 10, and no action
# changed: what is added everywhere is no reason to act differently. (Where walks end,
# it can be a reason: a cost per step favours short walks.) **A drift of the values need
# not be a drift of the policy.** An experiment can tell who adapts only if its
# drifts change what to do.

# %% tags=["checks"]
assert np.isclose(discounted([-1] * 500, GAMMA), -10)  # always to the left
assert counts[0][3:] == [9, 7, 9] and all_correct == 100
for seed in range(5):
    rng, Q = np.random.default_rng(seed), np.zeros((ROOMS, 2))
    for _ in range(100):
        before = Q.copy()
        train(Q, 9, 1, rng)
        assert (q_old - 1e-9 <= Q).all() and (before >= Q).all()  # Q falls to Q*
assert correct_rooms(q_old, 0) == 0 and seen.tolist() == [1, 9]
assert delta[1, LEFT] > 5 and (delta[9] < 0).all() and delta[1, RIGHT] == 0

# %% [markdown]
# ## Summary
#
# Q(s, a) is the return of taking $a$ in $s$ and acting well afterwards. An agent learns
# it by moving Q towards the target $y = r + \gamma \max_{a'} Q(s', a')$, or $y = r$ at
# the end. When the goal moves, the old Q is wrong in all nine rooms, and the TD error
# shows in two: where Q contradicts the new world one step ahead.
# In the next notebook you decide what to do with the old Q: write over it, or freeze
# it.
#
# [contents](README.md) · [2 →](02_forty_lines.ipynb)

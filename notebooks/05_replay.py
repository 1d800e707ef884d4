# %% [markdown]
# # 5 · The replay: error, recency, and how to correct for both
#
# **Eqs. 10–11, importance weights.** GB-DQN learns from stored transitions, and it does not draw them evenly: it prefers
# those with a large TD error, and recent ones. After this notebook you can write that sampler, exactly and in a few lines;
# you know what it draws as a drift passes, which is not what one expects; and what importance weights repair and undo.
#
# *Before:* notebook 3 (target, TD error δ). *Needs:* probabilities, geometric series. *Time:* a quarter of an hour, without the
# exercises.

# %%
from itertools import product

import numpy as np
from lesson import BLUE, FAST, GREEN, ORANGE, PURPLE, SKY, VERMILLION, plt, source

from gbdqn_ref.bellman import td_target
from gbdqn_ref.replay import (
    ProportionalReplay,
    RecencyReplay,
    SumTree,
    UniformReplay,
    importance_weights,
    mixed_priority,
    td_priority,
    time_priority,
)

rng = np.random.default_rng(0)

# %% [markdown]
# ## The buffer, and what "age" is
#
# The buffer is a ring: one slot after the other is filled, and when it is full the oldest transition is overwritten. The
# **age** of a transition is the number of transitions that were added since, 0 for the newest.

# %%
source(UniformReplay.add, UniformReplay.age)

# %%
ring = UniformReplay(capacity=5, state_dim=1)
for t in range(7):  # transitions 0 … 6; the reward says which one it is
    ring.add(0.0, 0, float(t), 0.0, False)
print("slot ", np.arange(5))
print("holds", ring.r.astype(int))
print("age  ", ring.age(np.arange(5)))

for slot in range(5):
    assert ring.age(slot) == 6 - ring.r[slot]

# %% [markdown]
# This clock runs on across episodes. Algorithm 1 (line 12) stores the step *within the episode* instead, and by that clock
# old data look new: a transition from step 500 of the last episode, seen at step 1 of this one, would have the age −499 and
# the recency $e^{0.01 \cdot 499} \approx 147$, where 1 is the most there should be (claim R8, D5).
#
# ## Drawing evenly, and why that is not enough
#
# `UniformReplay` draws each of N transitions with P = 1/N. In a world that stands still that is fine, whoever collected
# the data (claim R1). In one that drifts it is not, although the paper says that learning stays unbiased because it is
# off-policy (claim R2). The smallest world: one state, one action, which leads back to the state. The reward was 0, and
# now it is 1; γ = 0.9. So $Q^*_{old} = 0$ and $Q^*_{new} = 1/(1 - 0.9) = 10$.
#
# > **Predict, then run.** Half of the buffer is old. To what does Q converge if it is drawn evenly?

# %%
Q = 0.0
for _ in range(300):  # Q ← the mean target of one old and one new transition
    Q = td_target(np.array([0.0, 1.0]), np.zeros(2, bool), np.full((2, 1), Q), 0.9).mean()
assert np.isclose(Q, 5)
round(float(Q), 6)

# %% [markdown]
# To 5, which is right in neither world. *Which* transitions are drawn decides what is learnt; that is what this notebook is
# about, and this one-state world will stay with us.
#
# ## The first half of Eq. 10 · Priority by error
#
# $$p^{TD}_i = (|\delta_i| + \varepsilon)^{\gamma}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\delta_i$ | `delta` | (B,) | TD error, when the transition was last looked at |
# | $\varepsilon$ | `priority_offset` | scalar | so that an error of 0 does not mean never again |
# | $\gamma$ | `priority_exponent` | scalar | *not* the discount, which is also called γ |
# | $p^{TD}_i$ | `td_priority(…)` | (B,) | priority by error, always positive (claim R6) |

# %%
source(td_priority)

# %%
delta = np.array([0.0, 1.0, -1.0, 10.0])

p = np.zeros(4)
for i in range(4):
    p[i] = (abs(delta[i]) + 0.01) ** 0.6

assert np.allclose(p, td_priority(delta, 0.01, 0.6))
p.round(3)

# %% [markdown]
# Ten times the error is four times the priority: only exponent 1 without an offset would make it "proportional to the TD
# error" (claim R7). And the priority *grows* with the error. In one place the paper says that the sampling favours what the
# ensemble does well; it is the other way round (claim R3).
#
# ### Drawing in proportion: the sum tree
#
# Lay N priorities end to end on a line and drop a point u on it: it falls on number i with probability $p_i / \sum p$.
# To find i one would add up N numbers. A **sum tree** keeps sums of groups, sums of those, and so on, and only goes down
# one path. The package sums 32 numbers at a time; here are 2, so that it fits on a page.


# %%
class SmallTree(SumTree):
    FAN, TOP = 2, 2


tree = SmallTree(8)
tree.set(np.arange(8), np.array([3.0, 1.0, 4.0, 1.0, 5.0, 2.0, 2.0, 6.0]))
u = 14.5

figure, axes = plt.subplots(figsize=(8, 2.6))
for row, level in enumerate(tree.levels):
    ends = level.cumsum()
    for number, end in zip(level, ends, strict=True):
        hit = end - number <= u < end
        axes.barh(
            row,
            number,
            left=end - number,
            height=0.8,
            color=SKY if hit else "0.93",
            edgecolor="0.4",
        )
        axes.text(
            end - number / 2 + (0.4 if hit else 0), row, f"{number:g}", ha="center", va="center"
        )
axes.axvline(u, color=VERMILLION, linestyle="--")
axes.set(
    xlabel="all priorities, laid end to end (dashed: u = 14.5)",
    yticks=range(3),
    xlim=(0, tree.total()),
)
axes.set_yticklabels(["leaves", "sums of 2", "sums of 4"])
axes.set_title("From top to bottom: one box per level holds u, and the last one is what is drawn")
plt.show()

# %% [markdown]
# Downwards: 14.5 is beyond 9, so go right, with 14.5 − 9 = 5.5 left; 5.5 is within 7, so go left; 5.5 is beyond 5, so go
# right. That is leaf 5. The same by adding up all leaves, and by the tree:

# %%
leaf, end = 0, tree.leaves[0]
while u >= end:
    leaf += 1
    end += tree.leaves[leaf]

assert leaf == tree.find(np.array([u]))[0] == 5

# %% [markdown]
# **Exercise 1.** Change leaf 7 from 6 to 0, with `set`. How many numbers does that change, and can leaf 7 still be drawn?
# Draw 100,000 times, and compare the frequencies with $p_i / \sum p$.

# %% tags=["solution"] jupyter={"source_hidden": true}
before = [level.copy() for level in tree.levels]
tree.set(np.array([7]), np.array([0.0]))
changed = sum((level != was).sum() for level, was in zip(tree.levels, before, strict=True))
drawn = np.bincount(tree.find(rng.random(100_000) * tree.total()), minlength=8) / 100_000
assert changed == 3 and drawn[7] == 0  # one per level; a number of width 0 is never hit
assert np.abs(drawn - tree.leaves / tree.leaves.sum()).max() < 0.01

# %% [markdown]
# ## The second half of Eq. 10 · Priority by recency
#
# $$p^{time}_i = e^{-\alpha (T - t_i)}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $T - t_i$ | `age` | (B,) | transitions added since (D5) |
# | $\alpha$ | `recency_rate` | scalar | *not* the weight of a booster, which is also called α |
# | $p^{time}_i$ | `time_priority(age, recency_rate)` | (B,) | 1 for the newest, in (0, 1] |

# %%
source(time_priority)

# %% [markdown]
# The paper keeps one stored number per transition, $p_i$ of Eq. 10, renewed when the transition is drawn (Algorithm 1,
# lines 11 and 18). Stored when the transition is new, at age 0, its recency is 1.
#
# > **Predict, then run.** A thousand transitions come in, and none is drawn. What are the stored recencies, and what should
# > they be?

# %%
stored = [float(time_priority(0, 0.01)) for _ in range(1000)]  # each computed when it came in
fresh = time_priority(np.arange(1000)[::-1], 0.01)
print("stored: oldest", stored[0], "  newest", stored[-1])
print("fresh:  oldest", f"{fresh[0]:.6f}", "  newest", fresh[-1])
assert set(stored) == {1.0}

# %% [markdown]
# A stored number does not decay. All thousand look brand-new, and go on doing so until each happens to be drawn. So the code
# stores no recency at all (D5). But then it changes for *every* transition at *every* step, and no tree could keep up. The
# way out: one can draw an **age** directly. The sum over ages 0 … k is a geometric series,
#
# $$S_{time} = \sum_{k=0}^{N-1} e^{-\alpha k} = \frac{1 - e^{-\alpha N}}{1 - e^{-\alpha}}, \qquad
#   \Pr(\text{age} \le k) = \frac{1 - e^{-\alpha (k + 1)}}{1 - e^{-\alpha N}},$$
#
# and solving the second for k gives the age at which a uniform u lands:
# $\text{age} = \lfloor -\ln(1 - u\,(1 - e^{-\alpha N})) / \alpha \rfloor$.

# %%
source(RecencyReplay.time_total, RecencyReplay._age_at)

# %%
replay = RecencyReplay(capacity=40, state_dim=1, mix=0.3, recency_rate=0.1)
for t in range(55):
    replay.add(0.0, 0, float(t), 0.0, False)

total = sum(np.exp(-0.1 * k) for k in range(40))
assert np.isclose(total, replay.time_total())
for u in rng.random(500):
    age, end = 0, 1.0  # lay e^{−α·0}, e^{−α·1}, … end to end, and walk to u
    while u * total >= end:
        age += 1
        end += np.exp(-0.1 * age)
    assert age == replay._age_at(np.array([u]))[0]

# %% [markdown]
# ## Eqs. 10–11 · The mixture
#
# $$p_i = \beta\, p^{TD}_i + (1 - \beta)\, p^{time}_i \tag{10}$$
# $$P(i) = \frac{p_i}{\sum_j p_j} \tag{11}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\beta$ | `mix` | scalar | *not* the exponent of the importance weights, which is also called β (claim W4) |
# | $p_i$ | `mixed_priority(p_td, p_time, mix)` | (N,) | priority |
# | $P(i)$ | `replay.probabilities()` | (N,) | what is drawn from (claim R11: some $p_j$ must be positive) |
# | λ below | `replay.td_share()` | scalar | part of the draws that goes by error |

# %%
source(mixed_priority, RecencyReplay.td_share, RecencyReplay._draw)

# %%
delta = rng.normal(size=40)
replay.update_priorities(np.arange(40), delta)

p = np.zeros(40)
for i in range(40):
    by_error = (abs(delta[i]) + replay.priority_offset) ** replay.priority_exponent
    p[i] = 0.3 * by_error + 0.7 * np.exp(-0.1 * (54 - replay.r[i]))

assert np.allclose(p / p.sum(), replay.probabilities())

# %% [markdown]
# Why may `_draw` have two stages? Because a sum of priorities is a *mixture of two distributions* (claim R10). Write
# $S = \sum p$ for each part, and take the sums out:
#
# $$P = \frac{\beta S_{TD} \cdot p^{TD}/S_{TD} + (1 - \beta) S_{time} \cdot p^{time}/S_{time}}
#            {\beta S_{TD} + (1 - \beta) S_{time}}
#     = \lambda\, P_{TD} + (1 - \lambda)\, P_{time}, \qquad
#   \lambda = \frac{\beta S_{TD}}{\beta S_{TD} + (1 - \beta) S_{time}} .$$
#
# So toss a coin: with probability λ go down the tree, else draw an age. No age is ever stored, and what is drawn has the
# distribution of Eq. 11 exactly:

# %%
share = replay.td_share()
p_td = td_priority(delta, replay.priority_offset, replay.priority_exponent)
p_time = time_priority(replay.age(np.arange(40)), 0.1)
assert np.allclose(
    replay.probabilities(), share * p_td / p_td.sum() + (1 - share) * p_time / p_time.sum()
)

draws = 20_000 if FAST else 200_000
counts = np.bincount(replay.sample(draws, rng).index, minlength=40)
order = np.argsort(replay.age(np.arange(40)))

_, axes = plt.subplots()
axes.bar(
    np.arange(40),
    (share * p_td / p_td.sum())[order],
    color=ORANGE,
    label="exact: the part by error",
)
slope = (1 - share) * p_time / p_time.sum()
axes.bar(
    np.arange(40),
    slope[order],
    bottom=(replay.probabilities() - slope)[order],
    color=SKY,
    label="by recency",
)
axes.plot(
    np.arange(40),
    counts[order] / draws,
    "o",
    color="black",
    markersize=4,
    label=f"frequency in {draws:,} draws",
)
axes.set(xlabel="age (transitions)", ylabel="probability of being drawn")
axes.set_title(
    f"Two layers, drawn as computed: λ = {share:.0%} by error, {1 - share:.0%} by recency"
)
axes.legend()
plt.show()
expected = replay.probabilities() * draws
assert (np.abs(counts - expected) < 6 * np.sqrt(expected)).all()  # within six standard deviations

# %% [markdown]
# **Exercise 2.** Show that one formula is not in the code: the *product* of error and recency, to which Theorem 3 says this
# rule tends. Take |δ| = (2, 1), recencies (1, ½), exponent 1 and no offset, and compute P for several β.

# %% tags=["solution"] jupyter={"source_hidden": true}
p_td, p_time = td_priority(np.array([2.0, 1.0]), 0, 1), np.array([1.0, 0.5])
for mix in (0.0, 0.25, 0.5, 1.0):
    P = mixed_priority(p_td, p_time, mix)
    assert np.allclose(
        P / P.sum(), [2 / 3, 1 / 3]
    )  # the same for every β, since both parts have the ratio 2 : 1
assert np.allclose(p_td * p_time / (p_td * p_time).sum(), [4 / 5, 1 / 5])  # claim T3-a; notebook 7

# %% [markdown]
# ### What the two knobs do
#
# A thousand transitions, all with $p^{TD} = 1$, so that nothing but the mixture is seen:

# %%
even = RecencyReplay(1_000, 1)
for _ in range(1_000):
    even.add(0.0, 0, 0.0, 0.0, False)  # all enter with the priority 1


def over_age(mix, rate):
    """P over age, the newest first."""
    even.mix, even.recency_rate = mix, rate
    return even.probabilities()[::-1]


def knobs(settings, top=1.5):
    """P over age for each (mix, recency rate, colour, line)."""
    _, axes = plt.subplots()
    for mix, rate, colour, line in settings:
        P = over_age(mix, rate)
        label = f"mix {mix:g}, rate {rate:g}: newest tenth has {P[:100].sum():.0%}"
        axes.plot(np.arange(1, 1_001), P, line, color=colour, label=label)
    axes.axhline(1e-3, color="0.6", linewidth=1, linestyle=":")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="age + 1 (transitions)",
        ylabel="probability",
        ylim=(1e-5, top),
    )
    axes.set_title(
        "Probability over age: error gives the floor, recency the hill (dotted: even draws)"
    )
    axes.legend()
    plt.show()


knobs(
    [
        (0.3, 0.001, BLUE, "-"),
        (0.3, 0.01, VERMILLION, "--"),
        (0.3, 1.0, GREEN, "-."),
        (0.0, 0.01, PURPLE, ":"),
    ],
    top=0.2,
)

# %% tags=["slider"]
from ipywidgets import FloatLogSlider, FloatSlider, interact

_ = interact(
    lambda mix, rate: knobs([(mix, rate, BLUE, "-")]),
    mix=FloatSlider(value=0.3, min=0, max=1, step=0.05, description="mix β"),
    rate=FloatLogSlider(value=0.01, min=-4, max=1, step=0.25, description="rate α"),
)

# %% [markdown]
# > **Predict, then run.** β = ½ and α = 0.01: error and recency seem to have equal say. What share of the draws goes by
# > recency when the buffer holds 100 transitions? 10,000? And 50,000, the paper's capacity?

# %%
sizes = (100, 300, 1_000, 3_000, 10_000, 50_000)
lines = {
    "β = 0.1": (0.1, None, BLUE, "o-"),
    "β = 0.5": (0.5, None, VERMILLION, "s--"),
    "β = 0.9": (0.9, None, GREEN, "^-."),
    "β = 0.5, but α = 3/N": (0.5, 3, "0.4", "D:"),
}
recency_share = {name: [] for name in lines}
filling = RecencyReplay(sizes[-1], 1)  # all enter with priority 1
for n in range(1, sizes[-1] + 1):
    filling.add(0.0, 0, 0.0, 0.0, False)
    if n in sizes:
        for name, (mix, times_n, _, _) in lines.items():
            filling.mix, filling.recency_rate = mix, times_n / n if times_n else 0.01
            recency_share[name].append(1 - filling.td_share())

_, axes = plt.subplots()
for name, (_, _, colour, line) in lines.items():
    axes.plot(sizes, recency_share[name], line, color=colour, label=name)
axes.set(
    xscale="log",
    ylim=(0, 1),
    xlabel="transitions in the buffer, N",
    ylabel="share of the draws by recency",
)
axes.set_title("With α = 0.01 recency fades as the buffer fills, whatever β (all |δ| alike)")
axes.legend()
plt.show()
for n, part in zip(sizes, recency_share["β = 0.5"], strict=True):
    print(f"{n:6,} transitions: {part:6.2%} of the draws by recency")
assert recency_share["β = 0.5"][-1] < 0.003 < 0.2 < recency_share["β = 0.5, but α = 3/N"][-1]

# %% [markdown]
# $S_{time}$ never exceeds $1/(1 - e^{-\alpha})$, a hundred here, while $S_{TD}$ grows with every transition. So β sets no
# balance: in a full buffer the mixture *is* prioritized replay, for any β that is not tiny (claim R12). Where α falls as
# 1/N recency keeps its share; our presets choose α with the size of the buffer in mind (D13).
#
# **Exercise 3.** A larger α is said to favour recent transitions (R9). Compute the probability of the newest ten of the thousand
# for α = 0.001, 0.1 and 10 at β = ½ (`over_age`). What happened (claim R9)?

# %% tags=["solution"] jupyter={"source_hidden": true}
newest = [float(over_age(0.5, rate)[:10].sum()) for rate in (0.001, 0.1, 10.0)]
assert newest[0] < newest[1] > newest[2]
# at α = 10 nothing but the newest one has any recency: S_time is 1, against an S_TD of 1,000
[round(part, 5) for part in newest]

# %% [markdown]
# ## Priority mass over age, as a drift passes
#
# > **Predict, then run.** In the one-state world, 10,000 transitions of the old regime (reward 0) are in the buffer. Then
# > the reward becomes 1, and 1,000 transitions of the new regime come in. Which ones have the large TD errors? Does it
# > stay so as the agent adapts, from $Q = 0$ to $Q = 10$?
#
# The paper expects large errors on the old data and small ones on the new, and prefers recent data for that reason. Let us
# compute δ from the stored transitions, and from δ the probabilities:

# %%
OLD, NEW = 10_000, 1_000
drifted = RecencyReplay(OLD + NEW, 1, mix=0.5, recency_rate=0.01)
for t in range(OLD + NEW):
    drifted.add(0.0, 0, float(t >= OLD), 0.0, False)  # reward 0, and from the drift on 1


def errors(replay, Q):
    """δ of every stored transition, if the one state has the value Q."""
    n = len(replay)
    return td_target(replay.r[:n], replay.terminated[:n], np.full((n, 1), Q), 0.9) - Q


def stale(Q, mix=0.5, rate=0.01):
    """Part of the draws that are old, with all priorities up to date."""
    drifted.mix, drifted.recency_rate = mix, rate
    drifted.update_priorities(np.arange(OLD + NEW), errors(drifted, Q))
    return float(drifted.probabilities()[:OLD].sum())


for Q in (0.0, 5.0, 10.0):
    delta = errors(drifted, Q)
    print(
        f"Q = {Q:4.1f}: δ of the old {delta[0]:+.1f}, of the new {delta[-1]:+.1f}; old: {stale(Q):.1%} of the draws"
    )
assert np.isclose(stale(0.0), 0.363, atol=1e-3) and np.isclose(stale(10.0), 0.984, atol=1e-3)

# %% [markdown]
# At the drift it is the *other way round*: the old data fit $Q = Q^*_{old}$ with δ = 0, and the new ones surprise. Only once
# the agent has adapted do the old ones have the large errors, and then the sampler goes back to them (claim R4):

# %%
undrifted = RecencyReplay(OLD, 1, mix=0.5, recency_rate=0.01)
for _ in range(OLD):
    undrifted.add(0.0, 0, 0.0, 0.0, False)
edges = (
    np.unique(np.round(np.logspace(0, np.log10(OLD + NEW + 1), 25))).astype(int) - 1
)  # alike on a log axis

figure, axes = plt.subplots(1, 3, figsize=(9.5, 3.4), sharey=True)
for panel, title, held, Q in (
    (axes[0], "before the drift", undrifted, 0.0),
    (axes[1], "just after: $Q = Q^*_{old}$", drifted, 0.0),
    (axes[2], "adapted: $Q = Q^*_{new}$", drifted, 10.0),
):
    held.mix, held.recency_rate = 0.5, 0.01
    held.update_priorities(np.arange(len(held)), errors(held, Q))
    P, age = held.probabilities(), held.age(np.arange(len(held)))
    is_old, bottom = held.r[: len(held)] == 0, 0.0
    for what, colour, hatch, part in (
        ("old world", ORANGE, "///", is_old),
        ("new world", BLUE, "", ~is_old),
    ):
        mass, _ = np.histogram(age[part], edges, weights=P[part])
        look = dict(align="edge", color=colour, hatch=hatch, edgecolor="white", linewidth=0)
        panel.bar(edges[:-1] + 1, mass, np.diff(edges), bottom=bottom, label=what, **look)
        bottom = bottom + mass
    panel.set(xscale="log", xlabel="age + 1 (transitions)")
    panel.set_title(f"{title}\n{P[is_old].sum():.0%} of the draws are old")
axes[0].set(ylim=(0, 0.4), ylabel="part of the draws, per bin of age")
axes[1].legend(loc="upper left")
plt.show()

# %% [markdown]
# So it is not the drift that sends the sampler into the past, it is having *overcome* the drift. The more the agent has
# learnt, the more it is shown a world that is no more, each time with a target against what it knows. Recency was to
# prevent that. Between the two ends:

# %%
path = np.linspace(0, 10, 41)
_, axes = plt.subplots()
for (mix, rate), colour, line, name in (
    ((1.0, 0.01), ORANGE, "--", "error alone: prioritized replay (β = 1)"),
    ((0.5, 0.01), VERMILLION, "-", "β = ½, α = 0.01"),
    ((0.3, 1e-4), GREEN, "-.", "the package's defaults: β = 0.3, α = 0.0001"),
    ((0.01, 1e-3), BLUE, ":", "β = 0.01, α = 0.001"),
):
    axes.plot(path, [stale(Q, mix, rate) for Q in path], line, color=colour, label=name)
axes.axhline(OLD / (OLD + NEW), color="0.6", linewidth=1)
axes.text(0, OLD / (OLD + NEW) - 0.055, "even draws", color="0.4")
axes.set(
    ylim=(0, 1),
    xlabel="Q, on its way from Q*old = 0 to Q*new = 10",
    ylabel="part of the draws that are old",
)
axes.set_title("The better it knows the new world, the more it is shown the old one")
axes.legend(loc="lower right", fontsize=9)
plt.show()

# %% [markdown]
# **Exercise 4.** Find knobs with which less than half of the draws are old once the agent has adapted. First try to do it
# with the rate alone, at β = ½. Why is that impossible?

# %% tags=["solution"] jupyter={"source_hidden": true}
rates = np.logspace(-6, 0, 25)
assert min(stale(10.0, 0.5, rate) for rate in rates) > 0.5
# a large rate: S_time is small, and nearly all draws go by error, that is to the old. A small rate: recency has its
# share, but looks back so far that it is old data again. So β must fall as well:
assert stale(10.0, 0.01, 1e-3) < 0.5

# %% [markdown]
# ## Algorithm 1, lines 11 and 18 · What goes stale, and how a transition enters
#
# The figures above have every priority up to date. In the code no *recency* goes stale, but errors still do: a δ is renewed
# only when its transition is drawn.
#
# > **Predict, then run.** In one buffer of 10,000 all errors fell from 1 to 0, in another all rose from 0 to 1, and no
# > priority says so yet. Which of the two takes longer to be put right?

# %%
for was, now in ((1.0, 0.0), (0.0, 1.0)):
    pending = ProportionalReplay(10_000, 1)
    for _ in range(10_000):
        pending.add(0.0, 0, 0.0, 0.0, False)
    pending.update_priorities(np.arange(10_000), np.full(10_000, was))
    outdated = {}
    for update in range(1, 501):
        batch = pending.sample(64, rng)
        pending.update_priorities(batch.index, np.full(64, now))
        outdated[update] = np.isclose(pending.tree.leaves, td_priority(was, 0.01, 0.6)).mean()
    print(
        f"from {was:g} to {now:g}, still outdated after … updates:",
        ", ".join(f"{k}: {outdated[k]:.0%}" for k in (50, 150, 500)),
    )
    assert outdated[500] < 0.01 if now < was else outdated[500] > 0.3

# %% [markdown]
# An error that is overestimated is drawn soon, and so corrected. One that is *under*estimated is hardly drawn, and those
# that are already known keep it from being drawn: after 500 updates, which draw three times as many transitions as there
# are, half are still not found out. Old data whose target has become wrong are of this second kind. (In Algorithm 1 to
# the letter δ does not change during a stage, since it is the residual of the *frozen* ensemble without the learner; so
# it cannot go stale, nor does it show what is left to learn: claims R5, R14.)
#
# And which priority has a newcomer, whose δ nobody has computed? The text says the largest so far; Algorithm 1, line 11,
# says that of its own TD error (claim R13). The code follows the text (D4): "so far" means *ever*.

# %%
source(ProportionalReplay.add, ProportionalReplay.update_priorities)

# %% [markdown]
# **Exercise 5.** 1,000 transitions with |δ| = 1 are in the buffer, and one more comes in. How many draws does it take on
# average until it is looked at, by the text, and by Algorithm 1 if the network happens to fit it (δ = 0)?

# %% tags=["solution"] jupyter={"source_hidden": true}
buffer = ProportionalReplay(2_000, 1)
for _ in range(1_000):
    buffer.add(0.0, 0, 0.0, 0.0, False)
buffer.update_priorities(np.arange(1_000), np.ones(1_000))
slot = buffer.add(0.0, 0, 0.0, 0.0, False)
by_text = 1 / buffer.probabilities()[slot]  # the mean of a geometric distribution
buffer.update_priorities(np.array([slot]), np.zeros(1))
by_algorithm = 1 / buffer.probabilities()[slot]
assert np.isclose(by_text, 1_001) and 15 < by_algorithm / by_text < 17
print(f"{by_text:,.0f} and {by_algorithm:,.0f}")

# %% [markdown]
# ## Algorithm 1, line 14 · Importance weights
#
# $$w_i = \Bigl(\frac{1}{N \cdot P(i)}\Bigr)^{\beta}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $P(i)$ | `probabilities` | (B,) | of the drawn ones |
# | $\beta$ | `is_exponent` | scalar | *not* that of Eq. 10 (claim W4) |
# | – | `normalise` | – | `"batch"`: divided by the batch's largest, as in the text; Algorithm 1 does not; `None` |
#
# What is drawn more often is to count less.

# %%
source(importance_weights)

# %%
P = np.array([0.5, 0.3, 0.2])

w = np.zeros(3)
for i in range(3):
    w[i] = (1 / (3 * P[i])) ** 0.4

assert np.allclose(w, importance_weights(P, 3, 0.4, None))
assert np.allclose(w / w.max(), importance_weights(P, 3, 0.4, "batch"))

# %% [markdown]
# Do they correct the bias? Let us not sample but *enumerate*: two transitions with P = (0.8, 0.2), and the values
# f = (0, 1), whose true mean is ½. For each possible batch, its probability times its weighted mean:

# %%
P = np.array([0.8, 0.2])


def expectation(f, exponent, normalise, size):
    """E of the batch's mean of w f, over every batch of this size."""
    total = 0.0
    for batch in product(range(2), repeat=size):
        index = np.array(batch)
        w = importance_weights(P[index], 2, exponent, normalise)
        total += P[index].prod() * (w * f[index]).mean()
    return total


for exponent in (0.0, 0.5, 1.0):
    print(
        f"exponent {exponent}: {expectation(np.array([0.0, 1.0]), exponent, None, 1):.4f}, truth 0.5"
    )
for size in (1, 3):
    assert np.isclose(expectation(np.array([0.0, 1.0]), 1.0, None, size), 0.5)

# %% [markdown]
# By hand: 0.2 · w₂ · 1 with $w_2 = 1/(2 \cdot 0.2)$ is ½. In general $E[w f] = \sum P f / (N P)$ is the mean of f, and
# only at exponent 1 (claim W1). With an exponent b the transitions count as $P^{1-b}$.
#
# > **Predict, then run.** The text divides the weights of a batch by their largest one. Does that only scale the update?
# > And recency *wants* to see new data more often: what is left of that, once the weights have corrected it?

# %%
batch_sizes = range(1, 9 if FAST else 11)
ratio = [
    expectation(np.array([1.0, 0.0]), 1.0, "batch", size)
    / expectation(np.array([0.0, 1.0]), 1.0, "batch", size)
    for size in batch_sizes
]
recent = time_priority(np.arange(1_000)[::-1], 0.01)
recent = recent / recent.sum()
exponents = np.linspace(0, 1, 11)
old_part = []
for exponent in exponents:
    update = recent * importance_weights(recent, 1_000, exponent, None)
    old_part.append(update[:900].sum() / update.sum())

figure, axes = plt.subplots(1, 2, figsize=(8.5, 3.3))
axes[0].plot(batch_sizes, ratio, "o-", color=VERMILLION, label="divided by the batch's largest")
axes[0].axhline(1, color=GREEN, linestyle="--", label="not divided")
axes[0].set(ylim=(0, 4.3), xlabel="size of the batch", ylabel="first counts … times the second")
axes[0].set_title("P = (0.8, 0.2), exponent 1:\ndivision brings the bias back")
axes[0].legend()
axes[1].plot(exponents, old_part, "s-", color=BLUE)
axes[1].axhline(0.9, color="0.6", linewidth=1)
axes[1].text(0, 0.92, "even draws", color="0.4")
axes[1].set(ylim=(0, 1), xlabel="exponent of the weights", ylabel="part of the update")
axes[1].set_title("Recency alone, α = 0.01:\nthe 900 older of 1,000 in the update")
plt.show()
assert np.isclose(ratio[0], 4) and np.isclose(ratio[1], 3.4)
assert np.allclose([old_part[0], old_part[5], old_part[10]], [0.3679, 0.6039, 0.9], atol=1e-4)

# %% [markdown]
# Left: in a batch of one every weight is 1, and nothing is corrected; only large batches come near 1 : 1. The divisor differs
# from batch to batch, and it is largest just where the rare transition is in it (claim W2). It does keep every
# weight at most 1; the package follows the text here, and has `normalise=None` as the option.
#
# Right: full correction takes back all of the recency, and half of it half (claim W3). One cannot have both: data that are
# seen more often *so as to count more*, and an update in which they do not. And what "unbiased" means here is the mean
# over the *buffer*, old world included.
#
# **Exercise 6.** Show that dividing by the largest weight of the whole *buffer* does only scale. Then show that undivided weights
# are bounded, by $(\sum p / (N\, p_{min}))^{\beta}$ (claim W5), on the buffer `drifted`.

# %% tags=["solution"] jupyter={"source_hidden": true}
largest = importance_weights(P, 2, 1.0, None).max()
means = [expectation(f, 1.0, None, 2) / largest for f in np.eye(2)]
assert np.isclose(means[0], means[1])  # 1 : 1

all_p = drifted.probabilities()
weights = importance_weights(all_p, len(drifted), 1.0, None)
assert np.isclose(all_p @ weights, 1)  # their mean is 1 …
assert weights.max() <= 1 / (len(drifted) * all_p.min()) * (1 + 1e-9)  # … and P = p / Σp
print(f"largest weight {weights.max():.2f}, smallest {weights.min():.4f}")

# %% [markdown]
# ## What to take along
#
# | | as printed | in truth |
# |---|---|---|
# | off-policy learning | stays unbiased | not on data of two worlds: 5, where 0 and 10 are right |
# | data from before a drift | have large errors | not at the drift; only once the agent has adapted, and then they get the draws |
# | Eq. 10 | β balances error and recency | at fixed α recency's share falls as 1/N |
# | larger α | more weight on recent data | on the newest one; of the newest ten it can be less |
# | stored $p_i$, step of the episode | recency | does not decay, and old data can look new (D5) |
# | importance weights | they correct the bias | with exponent 1 and undivided; then they take recency back |
#
# **Next:** notebook 6, where all parts come together in Algorithm 1.

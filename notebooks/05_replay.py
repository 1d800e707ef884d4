# %% [markdown]
# # 5 · The replay: error, recency, and how to correct for both
#
# **Eqs. 10–11.** GB-DQN learns from a replay buffer, and it does not draw from it evenly: it prefers transitions with a
# large TD error, and recent ones. After this notebook you can write that sampler exactly, you know what it draws as a drift
# passes (it is not what one expects), and what importance weights repair and what they undo.
#
# *Before:* notebook 3 (TD error δ). *Needs:* probabilities, geometric series. *Time:* a quarter of an hour.

# %%
from itertools import product

import numpy as np
from lesson import BLUE, FAST, ORANGE, SKY, VERMILLION, plt, source

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
# The buffer is a ring: slot after slot is filled, and when it is full the oldest transition is overwritten. The **age**
# of a transition is the number of transitions that were added since, 0 for the newest. It counts on one clock, across
# episodes. Algorithm 1 stores the step *within the episode* instead, and by that clock old data can look new (D5, claim
# R8).

# %%
ring = UniformReplay(capacity=5, state_dim=1)
for t in range(7):  # transitions 0 … 6; the reward says which one it is
    ring.add(0.0, 0, float(t), 0.0, False)
print("slot ", np.arange(5))
print("holds", ring.r.astype(int))
print("age  ", ring.age(np.arange(5)))
assert (ring.age(np.arange(5)) == 6 - ring.r).all()

# %% [markdown]
# ## Priority by error
#
# $$p^{TD}_i = (|\delta_i| + \varepsilon)^{\gamma}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\delta_i$ | `delta` | (B,) | TD error, when the transition was last seen |
# | $\varepsilon$ | `priority_offset` | scalar | so that an error of 0 does not mean "never again" |
# | $\gamma$ | `priority_exponent` | scalar | not the discount, which is also called γ |

# %%
source(td_priority)

# %% [markdown]
# The priority grows with the error. (At one place the paper says that the priorities emphasise what the ensemble does
# *well*; that is the other way round, claim R3.) To draw in proportion to N numbers without adding up all N at each draw,
# keep their sums in a tree. Here with two numbers per sum, so that it fits on a line:


# %%
class SmallTree(SumTree):
    FAN, TOP = 2, 2  # the package's has 32 and 2,048


tree = SmallTree(4)
tree.set(np.arange(4), np.array([1.0, 2.0, 3.0, 4.0]))
for level in reversed(tree.levels):
    print(level)

# %% [markdown]
# To find where u = 4.5 falls when the numbers are laid end to end: the left half ends at 3, so it is in the right one, with
# 1.5 left; 3 > 1.5, so it is the third leaf. By hand and by the tree:

# %%
u, leaf, end = 4.5, 0, 1.0
while u >= end:
    leaf += 1
    end += tree.leaves[leaf]

assert leaf == tree.find(np.array([u]))[0] == 2

# %% [markdown]
# **Exercise 1.** Draw 100,000 times from the tree, and compare the frequencies with 0.1, 0.2, 0.3, 0.4.

# %% tags=["solution"] jupyter={"source_hidden": true}
drawn = np.bincount(tree.find(rng.random(100_000) * tree.total()), minlength=4) / 100_000
assert np.abs(drawn - [0.1, 0.2, 0.3, 0.4]).max() < 0.01
drawn

# %% [markdown]
# ## Priority by recency
#
# $$p^{time}_i = e^{-\alpha (T - t_i)} = e^{-\alpha \cdot \text{age}_i}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $T - t_i$ | `age` | (B,) | transitions added since (D5) |
# | $\alpha$ | `recency_rate` | scalar | not the weight of a booster, which is also called α |
#
# The paper stores the priority with the transition. A stored number does not decay: between two visits it stays as it
# was. The code stores none of it, and computes $p^{time}$ from the age whenever it is needed.

# %%
source(time_priority)

# %% [markdown]
# ## Eqs. 10–11 · The mixture
#
# $$p_i = \beta\, p^{TD}_i + (1 - \beta)\, p^{time}_i \tag{10}$$
# $$P(i) = \frac{p_i}{\sum_j p_j} \tag{11}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\beta$ | `mix` | scalar | not the exponent of the importance weights, which is also called β (claim W4) |
# | $p_i$ | `mixed_priority(p_td, p_time, mix)` | (N,) | priority |
# | $P(i)$ | `replay.probabilities()` | (N,) | what is drawn from |

# %%
source(mixed_priority)

# %%
replay = RecencyReplay(capacity=40, state_dim=1, mix=0.3, recency_rate=0.1)
for t in range(55):
    replay.add(0.0, 0, float(t), 0.0, False)
delta = rng.normal(size=40)
replay.update_priorities(np.arange(40), delta)

p = np.zeros(40)
for i in range(40):
    by_error = (abs(delta[i]) + replay.priority_offset) ** replay.priority_exponent
    p[i] = 0.3 * by_error + 0.7 * np.exp(-0.1 * (54 - replay.r[i]))

assert np.allclose(p / p.sum(), replay.probabilities())

# %% [markdown]
# Now the trick. A sum of priorities is a *mixture of two distributions* (claim R10):
#
# $$P = \lambda\, P_{TD} + (1 - \lambda)\, P_{time}, \qquad
#   \lambda = \frac{\beta S_{TD}}{\beta S_{TD} + (1 - \beta) S_{time}}, \quad S = \textstyle\sum p .$$
#
# So draw in two stages: with probability λ from the tree of errors; else draw an *age*, by inverting the geometric series
# $S_{time} = (1 - e^{-\alpha N}) / (1 - e^{-\alpha})$. Nothing has to be renewed as time passes, and nothing goes stale.

# %%
source(RecencyReplay)

# %%
share = replay.td_share()
p_td = td_priority(delta, replay.priority_offset, replay.priority_exponent)
p_time = time_priority(replay.age(np.arange(40)), 0.1)
assert np.allclose(replay.probabilities(), share * p_td / p_td.sum() + (1 - share) * p_time / p_time.sum())
assert np.isclose(replay.time_total(), p_time.sum())

draws = 20_000 if FAST else 200_000
counts = np.bincount(replay.sample(draws, rng).index, minlength=40)
order = np.argsort(replay.age(np.arange(40)))
plt.bar(np.arange(40), counts[order] / draws, color=SKY, label=f"{draws:,} draws")
plt.step(np.arange(40), replay.probabilities()[order], color=VERMILLION, where="mid", label="Eq. 11")
plt.plot(np.arange(40), (share * p_td / p_td.sum())[order], ".", color=BLUE, label="the part by error")
plt.gca().set(xlabel="age", ylabel="probability", title="Drawn and exact: a floor of errors, and a slope of recency")
plt.legend()
plt.show()
expected = replay.probabilities() * draws
assert np.abs(counts - expected).max() < 6 * np.sqrt(expected.max())  # six standard deviations

# %% [markdown]
# ### The two knobs
#
# Each transition has the error 1 here, so that only the mixture is seen.


# %%
def over_age(mix, rate, n=1000):
    """P over age for n transitions with |δ| = 1."""
    replay = RecencyReplay(n, 1, mix=mix, recency_rate=rate)
    for _ in range(n):
        replay.add(0.0, 0, 0.0, 0.0, False)
    return replay.probabilities()[::-1]


def picture(mix, rate):
    P = over_age(mix, rate)
    plt.fill_between(np.arange(1000), P, color=SKY, step="mid")
    plt.yscale("log")
    plt.gca().set(xlabel="age", ylabel="probability", ylim=(3e-4, 1))
    plt.title(f"mix {mix:g}, recency rate {rate:g}: the newest tenth has {P[:100].sum():.0%} of the draws")
    plt.show()


picture(0.3, 0.01)

# %% tags=["slider"]
from ipywidgets import FloatLogSlider, FloatSlider, interact

_ = interact(
    picture,
    mix=FloatSlider(value=0.3, min=0, max=1, step=0.05),
    rate=FloatLogSlider(value=0.01, min=-4, max=1, step=0.25),
)

# %% [markdown]
# > **Predict, then run.** With β = ½ and α = 0.01, error and recency seem to have equal say. What share of the draws goes by
# > recency when the buffer holds 100 transitions? 10,000? 50,000?

# %%
sizes = np.array([100, 300, 1_000, 3_000, 10_000, 50_000])
by_recency = []
for n in sizes:
    errors, recencies = 0.5 * n * td_priority(1.0, 0.01, 0.6), 0.5 * time_priority(np.arange(n), 0.01).sum()
    by_recency.append(recencies / (errors + recencies))
for n, part in zip(sizes, by_recency, strict=True):
    print(f"{n:6,} transitions: {part:.2%} of the draws by recency")
assert by_recency[-1] < 0.003

# %% [markdown]
# $S_{time}$ is bounded by $1 / (1 - e^{-\alpha})$, and $S_{TD}$ grows with the buffer. So β does not set a balance: at a
# full buffer the mixture *is* prioritized replay, whatever β one is likely to choose (claim R12). Only with α about
# 1/N does recency keep a share, and that is how our presets choose it (D13).
#
# **Exercise 2.** "A larger α emphasises recent transitions more." Compute the probability of the newest ten of 1,000 for
# α = 0.001, 0.1 and 10 at β = ½. What happened?

# %% tags=["solution"] jupyter={"source_hidden": true}
newest = [over_age(0.5, rate)[:10].sum() for rate in (0.001, 0.1, 10.0)]
assert newest[0] < newest[1] > newest[2]  # at α = 10 only the very newest counts: S_time is 1, one part in a thousand
[round(float(part), 5) for part in newest]

# %% [markdown]
# ## What is drawn as a drift passes
#
# > **Predict, then run.** 10,000 transitions of the old world are in the buffer, then the physics change, and 1,000
# > transitions of the new world come in. Which ones have the large TD errors: the old or the new? Does that stay so?
#
# At the drift $Q = Q^*_{old}$: the *old* transitions fit it, with δ = 0, and the new ones do not. Once the agent has adapted,
# $Q = Q^*_{new}$, and it is the other way round: every old transition is now surprising.


# %%
def mass(old_delta, new_delta, old=10_000, new=1_000, **knobs):
    """(P by slot, part of the old ones), the old ones first."""
    settings = dict(mix=0.5, recency_rate=0.01) | knobs
    replay = RecencyReplay(old + new, 1, **settings)
    for _ in range(old + new):
        replay.add(0.0, 0, 0.0, 0.0, False)
    replay.update_priorities(np.arange(old), np.full(old, float(old_delta)))
    if new:
        replay.update_priorities(np.arange(old, old + new), np.full(new, float(new_delta)))
    P = replay.probabilities()
    return P, P[:old].sum()


figure, axes = plt.subplots(1, 3, figsize=(10, 3.4), sharey=True)
edges = np.unique(np.round(np.logspace(0, np.log10(11_001), 25))).astype(int) - 1  # bins of age, as wide on a log axis
scenes = (
    ("before the drift", 0.0, 0.0, 0),
    ("just after: $Q = Q^*_{old}$", 0.0, 1.0, 1_000),
    ("adapted: $Q = Q^*_{new}$", 1.0, 0.0, 1_000),
)
for panel, (title, old_delta, new_delta, new) in zip(axes, scenes, strict=True):
    P, stale = mass(old_delta, new_delta, new=new)
    age = np.arange(len(P))[::-1]
    for what, colour, part in (("new world", BLUE, slice(10_000, None)), ("old world", ORANGE, slice(10_000))):
        in_bin, _ = np.histogram(age[part], edges, weights=P[part])
        panel.bar(edges[:-1] + 1, in_bin, np.diff(edges), align="edge", color=colour, label=what)
    panel.set(xscale="log", xlabel="age + 1", title=f"{title}:\n{stale:.0%} of the draws are old")
axes[0].set_ylabel("part of the draws, per bin of age")
axes[0].legend(loc="upper left", fontsize=9)
plt.show()
assert np.isclose(mass(0, 1)[1], 0.363, atol=1e-3) and np.isclose(mass(1, 0)[1], 0.984, atol=1e-3)

# %% [markdown]
# So it is not the drift that draws the sampler to the past, it is having *overcome* it: then 98 % of the draws go to a world
# that is no more, each with a target that contradicts what was learnt (claim R4). Recency was to prevent this, and at
# α = 0.01 it has no weight to do so. (D13: our presets leave it a third to a half of the draws.)
#
# **Exercise 3.** Find a `recency_rate` for which less than half of the draws are stale once the agent has adapted, with all
# else as above.

# %% tags=["solution"] jupyter={"source_hidden": true}
rates = np.logspace(-5, -1, 30)
stale = [mass(1, 0, recency_rate=rate)[1] for rate in rates]
assert min(stale) > 0.5  # there is none: at β = ½ errors have the larger sum at any rate
assert mass(1, 0, mix=0.01, recency_rate=1e-3)[1] < 0.5  # it takes another β as well
min(stale)

# %% [markdown]
# ## Importance weights
#
# $$w_i = \Bigl(\frac{1}{N \cdot P(i)}\Bigr)^{\beta}$$
#
# What is drawn more often is to count less. (This β is another one than that of Eq. 10; the code says `is_exponent`.)

# %%
source(importance_weights)

# %% [markdown]
# Do they correct the bias? Let us not sample but *enumerate*: two transitions with P = (0.8, 0.2) and the values f = (0, 1),
# whose true mean is ½. For every possible batch, its probability times its weighted mean:

# %%
P, f = np.array([0.8, 0.2]), np.array([0.0, 1.0])


def expectation(exponent, normalise, size):
    """E of the batch's mean of w f, over every batch of this size."""
    total = 0.0
    for batch in product(range(2), repeat=size):
        index = np.array(batch)
        w = importance_weights(P[index], 2, exponent, normalise)
        total += P[index].prod() * (w * f[index]).mean()
    return total


for exponent in (0.0, 0.5, 1.0):
    print(f"exponent {exponent}: {expectation(exponent, None, 1):.4f}, truth 0.5")
assert np.isclose(expectation(1.0, None, 1), 0.5) and np.isclose(expectation(1.0, None, 3), 0.5)

# %% [markdown]
# Only exponent 1 is unbiased (claim W1). And the usual division by the batch's largest weight?
#
# > **Predict, then run.** Dividing all weights of a batch by their largest one only scales the update, does it not?

# %%
for size in (1, 2, 4, 8):
    f = np.array([1.0, 0.0])
    first = expectation(1.0, "batch", size)
    f = np.array([0.0, 1.0])
    print(f"batches of {size}: the two transitions count {first / expectation(1.0, 'batch', size):.3f} : 1")

# %% [markdown]
# It does more: in a batch of one every weight is 1, and nothing is corrected at all; only very large batches come near 1 : 1.
# The divisor differs from batch to batch, and is large just where the rare transitions are (claim W2).
#
# At last, the two halves of the design pull against each other. Recency *wants* to look more often at new data; full
# correction takes exactly that back (claim W3):

# %%
recent = time_priority(np.arange(1000)[::-1], 0.01)
recent = recent / recent.sum()
for exponent in (0.0, 0.5, 1.0):
    update = recent * importance_weights(recent, 1000, exponent, None)
    print(
        f"exponent {exponent}: the 900 older of 1,000 transitions have {update[:900].sum() / update.sum():.4f} of the update"
    )
assert np.isclose(update[:900].sum() / update.sum(), 0.9)

# %% [markdown]
# **Exercise 4.** A new transition enters with the largest priority seen so far (D4). Why is that better than its own TD
# error, for an agent that looks at a batch of 64 of 50,000? Let 1,000 transitions with |δ| = 1 be in the buffer, add one
# whose δ is unknown, and compute how many draws it takes on average until it is looked at.

# %% tags=["solution"] jupyter={"source_hidden": true}
buffer = ProportionalReplay(2_000, 1)
for _ in range(1_000):
    buffer.add(0.0, 0, 0.0, 0.0, False)
buffer.update_priorities(np.arange(1_000), np.ones(1_000))
slot = buffer.add(0.0, 0, 0.0, 0.0, False)
wait = 1 / buffer.probabilities()[slot]
assert (
    900 < wait < 1_100
)  # as soon as any; a network that happens to fit it (δ = 0) would make it wait 16 times as long
assert 15 < td_priority(1.0, 0.01, 0.6) / td_priority(0.0, 0.01, 0.6) < 17
round(float(wait))

# %% [markdown]
# ## What to take along
#
# | | as printed | in truth |
# |---|---|---|
# | Eq. 10 | β balances error and recency | it does not: at fixed α recency's share tends to 0 with 1/N |
# | – | data from before a drift have large errors | not at the drift; only once the agent has adapted, and then they get the draws |
# | Eqs. 10–11, Theorem 3 | sampling ∝ error × recency | a sum is not a product, for whatever β (claim T3-a; notebook 7) |
# | importance weights | they correct the bias | with exponent 1 and without division by the batch's largest; then they take recency back |
#
# **Next:** notebook 6, where all parts come together in Algorithm 1.

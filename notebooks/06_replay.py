# %% [markdown]
# # 6 · The replay
#
# You will be able to write GB-DQN's sampler, Eqs. 10–11, and to say which transitions
# it draws as a drift passes, and what importance weights undo.
#
# *Time: 30 minutes. Needs: notebook 5. With the paper open: section Recency and
# TD-error Prioritized Replay, Eqs. 10–11.*
#
# **How to read this with the paper open.** γ, α and β each mean two things: exponent and
# discount, rate and booster's weight, mixture and exponent of the weights. Read
# $T - t_i$ as the age in the buffer, and $p_i$ as computed when it is drawn.

# %%
from itertools import product

import numpy as np
from exercises import check, solution
from lesson import FAST, GAMMA, corridor, show, source
from pictures import replay as pictures
from pictures.replay import filled, walk

from gbdqn_ref import replay as buffers
from gbdqn_ref.bellman import td_target
from gbdqn_ref.replay import importance_weights, td_priority, time_priority

rng = np.random.default_rng(0)

# %% [markdown]
# ## A buffer through a drift
#
# GB-DQN draws some of its replay, or **buffer**, more often than the rest: transitions
# with a high **priority**. A large TD error δ raises it, and so does recency. The paper
# expects of old data “high prediction error when evaluated in the new environment”, and
# of new data a lower one.
#
# An agent walks through the ten rooms at random: 10,000 steps with the goal in room 9.
# Then the goal moves to room 0, and it walks 1,000 more.

# %%
OLD, NEW = 10_000, 1_000
q_old, q_new = corridor(9).q_star(), corridor(0).q_star()
before, after = walk(OLD, goal=9, rng=rng), walk(15_000, goal=0, rng=rng)
undrifted = filled(buffers.RecencyReplay(OLD, 1), before)
drifted = filled(buffers.RecencyReplay(OLD + NEW, 1), before + after[:NEW])


def errors(stored, Q):
    """δ of every transition in a batch or a full buffer."""
    s, s2 = stored.s[:, 0].astype(int), stored.s2[:, 0].astype(int)
    y = td_target(stored.r, stored.terminated, Q[s2], GAMMA)
    return y - Q[s, stored.a]


# %% [markdown]
# A priority is ½ of an error term plus ½ of a recency term. The error term is 0.06
# where δ = 0, and 2.8 where |δ| = 5.5. The recency term is 1 for the newest transition
# and fades over some 100, so few of the 11,000 have any. The formulas come below.
#
# > **Predict.** What share of the draws is old just after the drift, while Q is still
# > that of the old world? And when Q has adapted, and knows the new world exactly?

# %% tags=["predicted"]


def moments(mix, rate):
    """(title, age, P, is it old?) of every transition, at three times."""
    for title, replay, Q in (
        ("before the drift", undrifted, q_old),
        ("just after it: $Q = Q^*_{old}$", drifted, q_old),
        ("adapted: $Q = Q^*_{new}$", drifted, q_new),
    ):
        replay.mix, replay.recency_rate = mix, rate
        replay.update_priorities(replay.slots(), errors(replay, Q))
        age = replay.age(replay.slots())
        yield title, age, replay.probabilities(), np.arange(len(replay)) < OLD


seen = list(moments(mix=0.5, rate=0.01))
_, just_after, adapted = (P[old].sum() for _, _, P, old in seen)
assert np.abs(errors(undrifted, q_old)).max() < 1e-9  # no old transition has an error
assert just_after < 0.7 < 0.9 < adapted

show(
    pictures.mass(seen),
    alt="Draws over age at three times. Before the drift all ages are drawn, with a "
    "hump of recent ones. Just after it a third is new. Once Q has adapted nearly "
    "all are old.",
)

# %% [markdown]
# It is the other way round (R4). At the drift the old data fit the old Q exactly, and
# the new ones surprise, though only in rooms 1 and 9. Once Q has adapted, the *old*
# data have the errors, and get the draws. **Not the drift but recovering from it sends
# the sampler back to old data.** Each draw then pulls Q back to a world that no longer
# exists.
#
# Try other settings: `mix` is β, the weight of the error; `rate` is α, how fast recency
# fades.

# %% tags=["slider", "live:replay"]
from ipywidgets import FloatLogSlider, FloatSlider, interact

_ = interact(
    lambda mix, rate: show(pictures.mass(list(moments(mix, rate))), alt="the draws"),
    mix=FloatSlider(value=0.5, min=0, max=1, step=0.05, description="mix β"),
    rate=FloatLogSlider(value=0.01, min=-4, max=0, step=0.25, description="rate α"),
)

# %% [markdown]
# Now watch it happen, in a full buffer of 10,000: each new transition replaces the
# oldest. A table learns from it, 64 draws at every fourth step. Only the draws differ
# (no importance weights); the last replay drops the old data at the drift.
#
# > **Predict.** Put in order: even draws, error alone, the package's defaults (β = 0.3,
# > α = 0.0001), and the drop. After how many steps are all nine rooms right?

# %% tags=["predicted"]
EVERY = 250


def age_through(replay, stored=before):
    """(share of draws that are old, rooms with the right way), every 250 steps."""
    filled(replay, stored).update_priorities(replay.slots(), errors(replay, q_old))
    Q, track = q_old.copy(), []
    for k, transition in enumerate(after, start=1):
        replay.add(*transition)
        if k % 4 == 0:
            batch = replay.sample(64, draws)
            delta, pairs = errors(batch, Q), (batch.s[:, 0].astype(int), batch.a)
            np.add.at(Q, pairs, 0.02 * delta)
            replay.update_priorities(batch.index, delta)
        if k % EVERY == 0:
            old, way = replay.age(replay.slots()) >= k, Q[1:, 0] > Q[1:, 1]
            track.append((replay.probabilities()[old].sum(), way.sum()))
    return np.array(track).T


draws = np.random.default_rng(1)
tracks = {
    "even draws": age_through(buffers.UniformReplay(OLD, 1)),
    "error alone": age_through(buffers.ProportionalReplay(OLD, 1)),
    "β = 0.5, α = 0.01": age_through(buffers.RecencyReplay(OLD, 1, 0.5, 0.01)),
    "the defaults": age_through(buffers.RecencyReplay(OLD, 1, 0.3, 1e-4)),
    "β = 0.01, α = 0.001": age_through(buffers.RecencyReplay(OLD, 1, 0.01, 1e-3)),
    "old data dropped": age_through(buffers.UniformReplay(OLD, 1), stored=[]),
}
last_wrong = {
    name: np.flatnonzero(ways < 9).max() for name, (_, ways) in tracks.items()
}
turned = {name: EVERY * (k + 2) for name, k in last_wrong.items()}
for name, steps in turned.items():
    print(f"{name:20} all nine rooms right from step {steps:6,} on")
assert turned["old data dropped"] < turned["even draws"] / 3
assert turned["the defaults"] > turned["even draws"] / 2

show(
    pictures.ageing(tracks, EVERY),
    alt="Left: the share of old draws over time; error alone stays highest late, a "
    "small β falls fast, dropped data is 0 from the start. Right: all rooms turn "
    "first with dropped data, then with the small β; the others take far longer.",
)

# %% [markdown]
# With even draws the old share falls step by step. Error alone starts lower and ends
# higher. With 10,000 old transitions and 1,000 new ones, what share of the draws is old
# under the defaults?

# %%
_, low, high = (P[old].sum() for _, _, P, old in moments(mix=0.3, rate=1e-4))
even = OLD / (OLD + NEW)
print(f"defaults: {low:.0%} to {high:.0%} old, even draws: {even:.0%}")
assert 0.8 < low < high < even
recent = 0.7 * time_priority(np.arange(50_000), 1e-4).sum()
assert 0.3 < recent / (recent + 0.3 * 50_000) < 1 / 3

# %% [markdown]
# Barely below even draws. The rate 0.0001 looks back over 10,000 transitions, and nine
# in ten of those are old. The defaults suit a full buffer of 50,000: recency keeps
# about a third of the draws when every error term is 1 (D13); they do not forget a
# world that fast. A small β with a larger rate does. It costs nothing here, where 1,000
# random steps show every room. Notebook 13 asks what to keep elsewhere.
#
# ## Why even draws are not enough
#
# In a world that stands still, data of any behaviour will do; the field says that
# Q-learning is **off-policy** (R1). The paper adds that “because the Q-update is
# off-policy, the learning process remains unbiased”. Not on data of two worlds (R2).
#
# > **Predict.** Half of the draws are of the old world, half of the new. Where does Q
# > send you from room 2, and where from room 7?

# %% tags=["predicted"]
Q = np.zeros((10, 2))
for _ in range(300):
    world = {goal: np.where(np.arange(10)[:, None] == goal, 0, Q) for goal in (9, 0)}
    old_y, new_y = corridor(9).bellman(world[9]), corridor(0).bellman(world[0])
    Q = (old_y + new_y) / 2
    Q[0], Q[9] = old_y[0], new_y[9]  # nobody starts in a goal
print("the way from room 1 to 8:", " ".join("←→"[a] for a in Q[1:9].argmax(1)))
was, mixed, new = q_old[1].max(), Q[1].max(), q_new[1].max()
print(f"value of room 1: {mixed:.2f}; old {was:.2f}, new {new:.2f}")
assert was < mixed < new

# %% [markdown]
# To the nearer of two goals, each there half the time: a world that never was.
#
# ## Eq. 10, first half · Priority by error
#
# $p^{TD}_i = (|\delta_i| + \varepsilon)^{\gamma}$, where
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\delta_i$ | `delta` | (B,) | TD error when it was last drawn |
# | $\varepsilon$ | `priority_offset` | scalar | *not* the ε of ε-greedy; so that 0 does not mean never again (R6) |
# | $\gamma$ | `priority_exponent` | scalar | *not* the discount |

# %%
source(td_priority)
p = td_priority(np.array([0.0, 1.0, -1.0, 10.0]), 0.01, 0.6)
assert np.allclose(p, [0.01**0.6, 1.01**0.6, 1.01**0.6, 10.01**0.6])
print(p.round(3))

# %% [markdown]
# Ten times the error is four times the priority; “proportional” needs exponent 1 and ε
# = 0 (R7). The priority grows with the error, so the draws do not favour “transitions
# where the current ensemble performs well” (R3).
#
# **Drawing in proportion** to it is prioritized experience replay (PER, Schaul et al.
# 2016). Lay the priorities end to end and drop a point u on the line. To find its box
# you would add up N numbers. A **sum tree** keeps sums of groups and goes down one
# path. The package has groups of 32, the picture of 2.


# %%
class SmallTree(buffers.SumTree):
    FAN, TOP = 2, 2


tree, u = SmallTree(8), 14.5
tree.set(np.arange(8), np.array([3.0, 1.0, 4.0, 1.0, 5.0, 2.0, 2.0, 6.0]))
leaf = tree.find(np.array([u]))[0]
assert leaf == np.searchsorted(tree.leaves.cumsum(), u, "right") == 5
drawn = np.bincount(tree.find(rng.random(100_000) * 24), minlength=8) / 100_000
assert np.abs(drawn - tree.leaves / 24).max() < 0.01

show(
    pictures.tree(tree.levels, u),
    alt="Three rows of boxes: eight priorities, four sums of two, two sums of four. A "
    "line at u = 14.5 meets one box in each row; the last is the sixth priority.",
)

# %% [markdown]
# Downwards: 14.5 is beyond 9, so right, with 5.5 remaining; 5.5 is within 7, so left;
# 5.5 is beyond 5, so right. A new priority changes one sum in each row.
#
# ## Eq. 10, second half · Priority by recency
#
# $$p^{time}_i = e^{-\alpha (T - t_i)}, \qquad
#   S_{time} = \sum_{k=0}^{N-1} e^{-\alpha k}
#   = \frac{1 - e^{-\alpha N}}{1 - e^{-\alpha}}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $T - t_i$ | `age` | (B,) | transitions added since (D5) |
# | $\alpha$ | `recency_rate` | scalar | *not* the weight of a booster |
# | $p^{time}_i$ | `time_priority(age, recency_rate)` | (B,) | 1 for the newest, in (0, 1] (R8) |
#
# The buffer is a ring: when it is full, the next transition takes the slot of the
# oldest.
#
# **Exercise 1.** A ring of 5 slots has had 7 transitions. Slot 1 holds
# the newest, slot 2 the oldest. Write the age of a slot.


# %%
def age(slot, added, capacity):
    """Transitions added since the one in this slot."""
    ...  # yours


age = check("age", age)
solution("age")

# %%
ring = filled(buffers.UniformReplay(5, 1), before[:7])
assert [age(slot, 7, 5) for slot in range(5)] == ring.age(np.arange(5)).tolist()

# %% [markdown]
# Algorithm 1 (line 12) stores the step *within the episode* instead. By that clock old
# data can look new: step 500 of the last episode, seen at step 1 of this one, has
# the recency $e^{499 \alpha}$, though 1 should be the largest (R8, D5). It also keeps
# $p_i$ until the transition is drawn again, so the recency in it does not decay.
#
# The package draws an age instead: $\Pr(\text{age} \le k) =
# (1 - e^{-\alpha (k + 1)})/(1 - e^{-\alpha N})$.
#
# **Exercise 2.** Solve it for k: at which age does a uniform random u land?


# %%
def age_at(u, rate, n):
    """The ages (B,) for u (B,) in [0, 1), with n transitions stored."""
    ...  # yours


age_at = check("age_at", age_at)
solution("age_at")

# %%
small = filled(buffers.RecencyReplay(40, 1, 0.3, 0.1), before[:55])
u, edges = rng.random(500), np.exp(-0.1 * np.arange(40)).cumsum()
assert np.isclose(edges[-1], small.time_total())
assert (age_at(u, 0.1, 40) == small._age_at(u)).all()
assert (age_at(u, 0.1, 40) == np.searchsorted(edges, u * edges[-1], "right")).all()

# %% [markdown]
# ## Eqs. 10–11 · The mixture
#
# $$p_i = \beta\, p^{TD}_i + (1 - \beta)\, p^{time}_i, \qquad
#   P(i) = \frac{p_i}{\sum_j p_j} \tag{10, 11}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\beta$ | `mix` | scalar | *not* the exponent of the importance weights (W4) |
# | $P(i)$ | `replay.probabilities()` | (N,) | what is drawn from; it sums to 1 (R11) |
# | λ | `replay.td_share()` | scalar | share of the draws that goes by error |
#
# **Exercise 3.** Write P.


# %%
def probabilities(p_td, p_time, mix):
    """P (N,) of Eqs. 10 and 11."""
    ...  # yours


probabilities = check("probabilities", probabilities)
solution("probabilities")

# %% [markdown]
# A sum of priorities is a mixture of two distributions (R10). With $S = \sum p$ of each
# part, $P = \lambda P_{TD} + (1 - \lambda) P_{time}$ and $\lambda = \beta S_{TD} /
# (\beta S_{TD} + (1 - \beta) S_{time})$. So with probability λ go down the tree, else
# draw an age.

# %%
source(buffers.RecencyReplay._draw)
delta = rng.normal(size=40)
small.update_priorities(np.arange(40), delta)
p_td, p_time = (
    td_priority(delta, 0.01, 0.6),
    time_priority(small.age(np.arange(40)), 0.1),
)
P, share = probabilities(p_td, p_time, 0.3), small.td_share()
assert np.allclose(P, small.probabilities())
assert np.allclose(P, share * p_td / p_td.sum() + (1 - share) * p_time / p_time.sum())
n = 20_000 if FAST else 200_000
counts = np.bincount(small.sample(n, rng).index, minlength=40)
assert (np.abs(counts - n * P) < 6 * np.sqrt(n * P)).all()  # six standard deviations

# %% [markdown]
# Theorem 3 says that it tends to the *product* of error and recency. It does not (T3-a,
# notebook 10): with |δ| = (2, 1) and recencies (1, ½) the mixture is (⅔, ⅓) for every
# β, and the product is (⅘, ⅕).
#
# > **Predict.** β = ½ and α = 0.01: half and half? Which share of the draws goes by
# > recency with 100 transitions, with 10,000, and with the paper's 50,000, if all
# > $p^{TD}$ are 1? And which α draws the newest ten of a thousand most often: 0.001,
# > 0.1 or 10?

# %% tags=["predicted"]
two = np.array([2.0, 1.0]), np.array([1.0, 0.5])
assert all(np.allclose(probabilities(*two, mix), [2 / 3, 1 / 3]) for mix in (0, 0.5, 1))
assert np.allclose(np.prod(two, axis=0) / np.prod(two, axis=0).sum(), [4 / 5, 1 / 5])

for n in (100, 10_000, 50_000):
    p_time = time_priority(np.arange(n), 0.01)
    print(f"{n:6,} transitions: {p_time.sum() / (p_time.sum() + n):.1%} by recency")
assert np.isclose(p_time.sum(), 1 / (1 - np.exp(-0.01)))  # about 100, the most

newest = [
    probabilities(np.ones(1000), time_priority(np.arange(1000), rate), 0.5)[:10].sum()
    for rate in (0.001, 0.1, 10.0)
]
print("newest ten:", ", ".join(f"{each:.1%}" for each in newest))
assert newest[0] < newest[1] > newest[2]

# %% [markdown]
# $S_{time}$ stays below $1/(1 - e^{-\alpha})$ while $S_{TD}$ grows with every
# transition. So β sets no balance: in a large buffer nearly all draws go by error,
# unless α falls as 1/N or β is tiny (R12). And a larger α need not favour recent data:
# at α = 10 only the newest has any recency (R9).
#
# ## Algorithm 1, lines 11 and 18 · What goes stale
#
# The first picture had every δ up to date. In a run a transition's δ is renewed only
# when it is drawn.
#
# > **Predict.** In one buffer of 10,000 all errors fell from 1 to 0, in another they
# > rose from 0 to 1. No priority says so yet. Which of the two takes longer to be put
# > right?

# %% tags=["predicted"]
for was, now in ((1.0, 0.0), (0.0, 1.0)):
    pending = filled(buffers.ProportionalReplay(OLD, 1), before)
    pending.update_priorities(np.arange(OLD), np.full(OLD, was))
    for _ in range(500):
        batch = pending.sample(64, rng)
        pending.update_priorities(batch.index, np.full(64, now))
    outdated = np.isclose(pending.tree.leaves[:OLD], td_priority(was, 0.01, 0.6)).mean()
    print(f"from {was:g} to {now:g}: {outdated:.0%} outdated after 500 updates")
    assert outdated < 0.01 if now < was else outdated > 0.3

p_1, p_0 = td_priority(np.array([1.0, 0.0]), 0.01, 0.6)
for place, p in (("text", p_1), ("line 11", p_0)):
    print(f"{place}: a newcomer among 1,000 waits {(1000 * p_1 + p) / p:,.0f} draws")

# %% [markdown]
# An error that is overestimated is drawn soon and corrected. One that is
# *under*estimated is hardly drawn. Old data are of this kind while Q adapts: their
# errors rise. (In Algorithm 1 to the letter δ is the residual of the frozen ensemble:
# it cannot go stale during a stage, nor does it show what is left to learn; R5, R14.)
#
# The text lets a newcomer enter with the largest priority so far, line 11 with that of
# its own δ (R13). If the network happens to fit it, it waits long. The package follows
# the text (D4).
#
# ## Algorithm 1, line 14 · Importance weights
#
# $$w_i = \Bigl(\frac{1}{N \cdot P(i)}\Bigr)^{\beta}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $P(i)$ | `probabilities` | (B,) | of the drawn ones |
# | $\beta$ | `is_exponent` | scalar | *not* that of Eq. 10 (W4) |
# | – | `normalise` | – | `"batch"`: divided by the batch's largest, as in the text; `None`: Algorithm 1 |
#
# **Exercise 4.** Write line 14, undivided.


# %%
def weights(P, n, exponent):
    """w (B,) of drawn transitions with probabilities P (B,), of n stored ones."""
    ...  # yours


weights = check("weights", weights)
solution("weights")

# %% [markdown]
# Do they correct the bias? Two transitions with P = (0.8, 0.2) and values f = (0, 1)
# have the true mean ½. Add up every possible batch's probability times its weighted
# mean.
#
# > **Predict.** The text divides by the batch's largest weight. Does that only scale
# > the update? And recency *wants* new data to count more. How much of that is left,
# > once the weights have corrected it?

# %% tags=["predicted"]
P = np.array([0.8, 0.2])


def expectation(f, exponent, normalise, size):
    """E of a batch's mean of w f."""
    total = 0.0
    for batch in map(np.array, product(range(2), repeat=size)):
        w = importance_weights(P[batch], 2, exponent, normalise)
        total += P[batch].prod() * (w * f[batch]).mean()
    return total


w = weights(drifted.probabilities(), OLD + NEW, 1.0)  # of the whole buffer
assert np.isclose(drifted.probabilities() @ w, 1) and np.isfinite(w).all()
first, second = np.eye(2)
assert np.allclose(weights(P, 2, 0.4), importance_weights(P, 2, 0.4, None))
for size, exponent in product((1, 3), (0.0, 0.5, 1.0)):
    mean = expectation(second, exponent, None, size)
    assert np.isclose(mean, 0.5) == (exponent == 1)
sizes, exponents = range(1, 9 if FAST else 11), np.linspace(0, 1, 11)
ratio = [
    expectation(first, 1.0, "batch", size) / expectation(second, 1.0, "batch", size)
    for size in sizes
]
recent = probabilities(np.zeros(1000), time_priority(np.arange(1000)[::-1], 0.01), 0)
updates = [recent * weights(recent, 1000, exponent) for exponent in exponents]
old_part = [update[:900].sum() / update.sum() for update in updates]
assert np.allclose(ratio[:2], [4, 3.4])
assert np.allclose(np.array(old_part)[[0, 5, 10]], [0.3679, 0.6039, 0.9], atol=1e-4)

show(
    pictures.weights(sizes, ratio, exponents, old_part),
    alt="Left: divided by the largest, the first counts 4 times the second in a batch "
    "of one, falling towards 1. Right: the older share of an update rises to 90 "
    "%.",
)

# %% [markdown]
# By hand: $0.2 \cdot w_2 \cdot 1$ with $w_2 = 1/(2 \cdot 0.2)$ is ½. In general $E[w f]
# = \sum P f/(N P)$, the mean of f, but only at exponent 1 (W1). There undivided weights
# have the mean 1, and they are bounded, since ε > 0 (W5).
#
# Left: in a batch of one every divided weight is 1, and nothing is corrected. The
# divisor is largest just where the rare transition is in the batch (W2). Right: full
# correction takes back all of the recency, the exponent ½ about half (W3). You cannot
# have both: draws that make new data count more, and weights that undo the draws. And
# “unbiased” means the mean over the *buffer*, old world included.

# %% [markdown]
# ## Summary
#
# Data of two worlds teach a third. At a drift the new data have the errors; once the
# agent has adapted, the old ones have them and get the draws. Eq. 10 is a mixture, in
# which recency fades as the buffer fills. The defaults draw old data almost as often as
# even draws do; dropping them is faster. Importance weights that correct the draws take
# the recency back.
#
# [← 5](05_dqn.ipynb) · [contents](README.md) · [7 →](07_algorithm.ipynb)

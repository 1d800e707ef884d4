# %% [markdown]
# # 4 · Boosting
#
# You will be able to derive each step of GB-DQN's boosting, Eqs. 1–9, and to say where
# a residual of zero hides a wrong value.
#
# *Time: 30 minutes. Needs: notebooks 1 to 3. With the paper open: section Gradient
# Boosted DQN, Eqs. 1–9.*
#
# **How to read this with the paper open.** Read Eqs. 2–3 with y held fixed, and keep w
# in the loss at Eq. 6. Read argmin in Eq. 7, and put the weights into both sums of
# Eq. 8. Eq. 4 subtracts $Q_{m-1}$; the text on Algorithm 1 subtracts $\bar Q_{m-1}$, a
# slow copy (M6). A frozen network is its own copy, so that is the same (D3).

# %%
import numpy as np
from exercises import check, solution
from lesson import ROOMS, corridor, show, source
from pictures import boosting as pictures

from gbdqn_ref.bellman import loss_gradient, td_target, weighted_loss
from gbdqn_ref.boosting import Ensemble, closed_form_alpha
from gbdqn_ref.config import Config
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.nn import MLP
from gbdqn_ref.optim import Adam

rng = np.random.default_rng(0)
rooms = np.eye(ROOMS, dtype=np.float32)  # room k as ten numbers: a one at place k

# %% [markdown]
# ## Eq. 1 · The ensemble is a sum
#
# $$Q_m(s, a) = \sum_{j=1}^{m} \alpha_j\, h_j(s, a)
#   = Q_{m-1}(s, a) + \alpha_m h_m(s, a) \tag{1}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $h_j$ | `net.forward(theta, x)[0]` | (B, A) | booster j, a network |
# | $\alpha_j$ | `ensemble.alpha[j]` | scalar | its weight |
# | $\theta_j$ | `ensemble.theta[j]` | (P,) | its parameters; j counts from 0 in code |
# | $Q_m$ | `ensemble.q(x)` | (B, A) | the answer of the ensemble |
#
# Shapes: B states in a batch, A actions, P parameters of a network. All boosters in an
# ensemble are frozen. To add a booster is to add its term to the sum (M1).

# %%
source(Ensemble.boosters, Ensemble.terms)

# %% [markdown]
# `weight` is the boosters' α in the sum that acts; they differ only where a stage is
# reused (notebook 13). It is not the w below. The same in a loop, on the ten rooms:

# %%
net = MLP((ROOMS, 16, 2))
ensemble = Ensemble(net)
for alpha in (1.0, 0.5, 0.1):
    ensemble.add(net.init(rng), alpha)

q = np.zeros((ROOMS, 2))
for theta, alpha in zip(ensemble.theta, ensemble.alpha, strict=True):
    q += alpha * net.forward(theta, rooms)[0]
assert np.allclose(q, ensemble.q(rooms), atol=1e-6)

first, second, _ = ensemble.staged_q(rooms)  # Q_1, Q_2, Q_3
assert np.allclose(second - first, ensemble.terms(rooms)[1], atol=1e-6)  # α_2 h_2

# %% [markdown]
# > **Predict.** What does an ensemble without boosters say about room 5?

# %% tags=["predicted"]
print(Ensemble(net).q(rooms)[5])

# %% [markdown]
# An empty sum is zero. If boosting starts there, it costs something (notebook 7).
#
# ## Eqs. 2–3 · The residual is the direction in which the loss falls
#
# $$L = \tfrac12 \sum_i w_i\,(y_i - Q_i)^2, \qquad
#   -\frac{\partial L}{\partial Q_i} = w_i\,(y_i - Q_i) \tag{2, 3}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $y_i - Q_i$ | `error` | (B,) | residual of sample i |
# | $w_i$ | `weight` | (B,) | its **importance weight**, from notebook 6 (M5); Eq. 2 has all 1 |
# | $L$ | `weighted_loss(error, weight)` | scalar | a mean in the code (D2) |
# | $\partial L/\partial Q$ | `loss_gradient(error, weight, a, n_actions)` | (B, A) | 0 for actions not taken |
#
# An importance weight makes up for drawing some samples more often than others. Read
# the answers $Q_i = Q(s_i, a_i)$ as free numbers. The steepest way down adds to each
# its own weighted residual. Gradient boosting takes this step with a function: it fits
# a learner h to the residuals and adds a multiple of it.

# %%
source(weighted_loss)

# %% [markdown]
# By hand: nudge each $Q_i$ and see how much the loss falls.

# %%
y, Q, w = np.array([1.0, -2.0, 0.5]), np.array([0.2, -1.0, 0.5]), np.array([1, 0.5, 2])
a, nudge = np.array([0, 1, 0]), 1e-6

slopes = []
for i in range(3):
    up, down = Q.copy(), Q.copy()
    up[i], down[i] = Q[i] + nudge, Q[i] - nudge
    slopes.append(weighted_loss(y - up, w) - weighted_loss(y - down, w))
slopes = np.array(slopes) / (2 * nudge)

gradient = loss_gradient(y - Q, w, a, n_actions=2)
assert np.allclose(slopes, gradient[np.arange(3), a])
assert np.allclose(slopes, -w * (y - Q) / 3)  # a mean over three samples

# %% [markdown]
# So the weighted residual is the negative gradient, *as long as y is held fixed* (M3,
# M4). In **regression**, the fit of a function to given data, y is fixed and is called
# the **label**. Here y contains Q itself; Theorem 1 turns on that.
#
# ## Eq. 4 · What the next booster has to learn
#
# $$r_{i,m} = y_i - Q_{m-1}(s_i, a_i), \qquad
#   y_i = r_i + \gamma \max_{a'} Q_{m-1}(s'_i, a') \tag{4}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $r_i$, $\gamma$ | `r`, `gamma` | (B,), scalar | reward, discount |
# | $Q_{m-1}(s_i, \cdot)$, $Q_{m-1}(s'_i, \cdot)$ | `q_frozen`, `q_frozen_next` | (B, A) | frozen answers here and at the next state |
# | $y_i$ | `y` | (B,) | target; only $r_i$ where the episode ends (D1) |
# | $r_{i,m}$ | result | (B,) | the residual; not the reward $r_i$ |
#
# **Exercise 1.** Write Eq. 4, with the end of an episode.


# %%
def residual(r, terminated, a, q_frozen, q_frozen_next, gamma):
    """y − Q_{m−1}(s, a); everything per sample is (B,), Q is (B, A)."""
    ...  # yours


residual = check("residual", residual)
solution("residual")

# %% [markdown]
# Three steps in the ten rooms. The frozen ensemble knows the way to room 9; the goal
# has moved to room 0.
#
# > **Predict.** The steps are: 5 → 6, 9 → 8, and 1 → 0, which is now the end. Which of
# > them has a residual?

# %% tags=["predicted"]
old, new = corridor(9), corridor(0)
q_old, q_new = old.q_star(), new.q_star()
here, action, there = np.array([5, 9, 1]), np.array([1, 0, 0]), np.array([6, 8, 0])
reward, ends = np.full(3, -1.0), there == 0

left_to_learn = residual(reward, ends, action, q_old[here], q_old[there], 0.9)
y = td_target(reward, ends, q_old[there], 0.9)
assert np.allclose(left_to_learn, y - q_old[here, action])
print(left_to_learn.round(3))

# %% [markdown]
# Keep the 0 of room 5 in mind. Its value is wrong, and so is its action.
#
# ## Regression: a residual that tells the truth
#
# First the case for which boosting was made. The world is a curve; it drifts on the
# right, at x > 0.2. $h_1$ has learnt the old curve and is frozen. $h_2$ learns the
# residual.

# %%
x = np.linspace(-1, 1, 200, dtype=np.float32)[:, None]
right = x[:, 0] > 0.2
before = np.sin(4 * x[:, 0])
after = before + 1.5 * np.maximum(0, x[:, 0] - 0.2)
curve = MLP((1, 64, 1))


def fit(x, wanted, zero_output, steps=1500):
    """The function that a network has become after training at x towards `wanted`."""
    theta = curve.init(np.random.default_rng(1), zero_output=zero_output)
    adam, ones = Adam(curve.size, 1e-2), np.ones(len(x), np.float32)
    for _ in range(steps):
        h, cache = curve.forward(theta, x)
        dq = loss_gradient(wanted - h[:, 0], ones, np.zeros(len(x), int), 1)
        adam.step(theta, curve.backward(theta, cache, dq))
    return lambda x: curve.forward(theta, x)[0][:, 0]


h_1 = fit(x, before, zero_output=False)
h_2 = fit(x, after - h_1(x), zero_output=True)
assert np.abs(after - h_1(x) - h_2(x)).max() < 0.2

show(
    pictures.curves(x[:, 0], before, after, h_1(x), h_2(x)),
    alt="Three panels: the first network fits the old curve; the residual is zero on "
    "the left and grows on the right; their sum fits the new curve.",
)

# %% [markdown]
# `zero_output=True` starts the booster as the zero function, so that adding it changes
# no answer before it has learnt something (D11). Where the label has not changed, the
# residual is near zero, and the booster has nothing to do.
#
# > **Predict.** $h_2$ saw all of x. Let a second one learn from x > 0.2 only. How far
# > does each move the answer on the left, where nothing has changed?

# %% tags=["predicted"]
half = fit(x[right], (after - h_1(x))[right], zero_output=True)
everywhere, elsewhere = np.abs(h_2(x)[~right]).max(), np.abs(half(x)[~right]).max()
print(f"learnt from all of x: {everywhere:.3f}, from the right only: {elsewhere:.3f}")
assert elsewhere > 3 * everywhere > 0

# %% [markdown]
# On the left nothing held the second one still. Data with a residual of zero keep a
# booster local; the method does not (T4-b).
#
# ## The corridor: a residual of zero that hides a wrong value
#
# The paper says: “Each new learner focuses only on correcting the discrepancies of the
# existing ensemble” (section Gradient Boosted DQN). In regression that is all there is
# to correct. Now take the ten rooms. Q is frozen on the day the goal moves from room 9
# to room 0, and every step from every room is in the data.
#
# > **Predict.** The best action changes in eight rooms. (In room 9 walks used to end,
# > so there was none to change.) In how many rooms is there a residual?

# %% tags=["predicted"]
q_old[0] = 0  # room 0 is now the end: nothing comes after it (D1)
g = new.residual(q_old)[1:]  # rooms 1 to 9
seen = 1 + np.flatnonzero(np.abs(g).max(1) > 1e-9)
wrong = 1 + np.flatnonzero(np.abs(q_new.max(1) - q_old.max(1))[1:] > 1e-9)
turn = 1 + np.flatnonzero(q_old[1:9].argmax(1) != q_new[1:9].argmax(1))
print("residual in rooms ", seen)
print("wrong value in    ", wrong)
print("wrong action in   ", turn)
assert (len(seen), len(wrong), len(turn)) == (2, 9, 8)

show(
    pictures.hidden(q_old, q_new, new.residual(q_old)),
    alt="Above: the frozen value rises to the right, the new value to the left; all "
    "nine differ and eight arrows turn. Below: only rooms 1 and 9 have a "
    "residual.",
)

# %% [markdown]
# The residual looks one step ahead. In room 5 it compares the value of room 5 with that
# of room 6. Both are wrong in the same way, so they agree. **A residual of zero means
# that Q agrees with itself, not that it is right.**
#
# So one booster is not enough, however well it fits:

# %%
Q = q_old
for boosters in range(1, 4):
    Q = Q + new.residual(Q)  # a perfect booster, α = 1
    residual_in = 1 + np.flatnonzero(np.abs(new.residual(Q))[1:].max(1) > 1e-9)
    right_way = int((Q[1:, 0] > Q[1:, 1] + 1e-9).sum())
    print(boosters, "boosters: residual in", residual_in, "– right way in", right_way)
assert right_way < 9

# %% [markdown]
# Each booster leaves the next one something to do, a room further. So it takes many
# boosters, or a y that contains the booster while it learns (the package's
# `target="live"`). Notebook 7 compares both.
#
# ## Eqs. 5–6 · What the booster is fitted to
#
# $$\begin{aligned}
# J_m &= \tfrac12 \sum_i \bigl(r_{i,m} - \alpha_m h_m(s_i, a_i)\bigr)^2 &(5)\\
# \tfrac12 \sum_i w_i \bigl(r_{i,m} - \alpha_m h_m\bigr)^2
#  &= \tfrac12 \sum_i \bigl(\sqrt{w_i}\,r_{i,m} - \alpha_m \sqrt{w_i}\,h_m\bigr)^2 &(6)
# \end{aligned}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $r_{i,m}$ | `residual` | (B,) | what the booster has to learn |
# | $\alpha_m h_m(s_i, a_i)$ | `factor * h` | (B,) | what it says; `factor` is α or 1 |
# | $w_i$ | `batch.weight` | (B,) | importance weight |
# | $J_m$ | `weighted_loss(residual - factor * h, weight)` | scalar | as in Eq. 3 |
#
# The paper calls both $J_m$, one without weights and one with (M7). A weight may move
# into the square as its root, *if it moves onto both terms* (M8):

# %%
r, h, w = rng.normal(size=4), rng.normal(size=4), np.array([0.1, 1.0, 0.5, 0.0])
outside = inside = 0.0
for i in range(4):
    outside += w[i] * (r[i] - 0.7 * h[i]) ** 2 / 2
    inside += (np.sqrt(w[i]) * r[i] - 0.7 * np.sqrt(w[i]) * h[i]) ** 2 / 2
assert np.isclose(outside, inside)
assert np.isclose(outside / 4, weighted_loss(r - 0.7 * h, w))  # a mean over four

# %% [markdown]
# The paper concludes: “for simplicity, we use the residual” r instead of w r (after Eq.
# 6). That does not follow (M9). The smallest example has two samples and a learner that
# can only be a constant.
#
# **Exercise 2.** Fit the constant h that minimises $\sum_i w_i (r_i - h)^2$.


# %%
def constant(r, w):
    """The h with the least weighted squared error; r and w are (B,)."""
    ...  # yours


constant = check("constant", constant)
solution("constant")

# %% [markdown]
# > **Predict.** Take r = (3, −1) and w = (¼, 1). Four readings of that sentence: fit r
# > without weights; fit r with the weights in the loss; fit w r, or √w r, without
# > weights in the loss. Each gives another constant. Multiply both weights by 9. Which
# > of the four constants stay the same?

# %% tags=["predicted"]
r, w, one = np.array([3.0, -1.0]), np.array([0.25, 1.0]), np.ones(2)


def readings(w):
    return {
        "r, no weights in the loss": constant(r, one),
        "r, weights in the loss": constant(r, w),
        "w r": constant(w * r, one),
        "√w r": constant(np.sqrt(w) * r, one),
    }


once, scaled = readings(w), readings(9 * w)
for name in once:
    print(f"fitted to {name:26} h = {once[name]:+.3f}, then {scaled[name]:+.3f}")
assert len(set(once.values())) == 4
assert [round(scaled[name] / once[name]) for name in once] == [1, 1, 9, 3]

# %% [markdown]
# Only the size of the weights *relative to each other* should matter. The first two
# readings pass, but the first has no weights. The package takes the second: weights in
# the loss, residual as it is.
#
# Eq. 5 hides one more choice. With $\alpha_m$ *inside* the square, a learner that can
# represent anything becomes $h = r/\alpha$, so $\alpha h = r$: however small α is, the
# step is a whole one (M13, B2). Algorithm 1 leaves α out of its loss; then the step is
# αr. The package has both: `loss_on="alpha_h"` and `loss_on="h"`.
#
# ## Eqs. 7–8 · How long a step
#
# $$\alpha_m = \arg\min_\alpha \sum_i \bigl(r_{i,m} - \alpha\,h_m(s_i, a_i)\bigr)^2
#  = \frac{\sum_i r_{i,m}\,h_m(s_i, a_i)}{\sum_i h_m(s_i, a_i)^2} = \frac AB
#  \tag{7, 8}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $r_{i,m}$, $h_m(s_i, a_i)$ | `residual`, `h` | (n,) | what was to be fitted, what the booster says |
# | – | `weights` | (n,) | the weights of the loss; Eq. 8 forgets them (D7) |
#
# (Eq. 7 prints min; the *place* of the minimum is meant, M10.) Expand the square: $\sum
# r^2 - 2\alpha A + \alpha^2 B$, a parabola in α. It is lowest at $A/B$, where its
# height is $\sum r^2 - A^2/B$ (M11). **That height is all of Theorem 1.** With fixed
# labels no such step raises the loss (M14, T1-k). Yet the loss need not end at zero,
# since steps may help less and less (M15).
#
# **Exercise 3.** Write the α that minimises the *weighted* loss $\sum w (r - \alpha
# h)^2$.


# %%
def step_size(r, h, w):
    """α; r, h and w are (n,)."""
    ...  # yours


step_size = check("step_size", step_size)
solution("step_size")

# %%
h_m = rng.normal(size=6)
r_m = 0.6 * h_m + 0.5 * rng.normal(size=6)  # the booster has learnt a part of it
A, B = r_m @ h_m, h_m @ h_m
assert np.isclose(A / B, step_size(r_m, h_m, np.ones(6)))
assert np.isclose(A / B, closed_form_alpha(r_m, h_m))
for eta in (1, 0.1):
    loss = ((r_m - eta * A / B * h_m) ** 2).sum()
    assert np.isclose(loss, r_m @ r_m - (2 * eta - eta**2) * A**2 / B)

show(
    pictures.parabola(r_m, h_m, chosen=2 * A / B),
    alt="The loss over α is a parabola. Its lowest point is at A/B; a tenth of that α "
    "is high on its left arm; twice that α is as high as no booster.",
)

# %% [markdown]
# **Shrinkage** takes only a part η of the best step. The loss then falls by $(2\eta -
# \eta^2) A^2/B$ (T1-d): at η = 0.1 by 19 % of the largest fall. At twice the best α
# the loss is what it was without the booster. Move α:

# %% tags=["slider", "live:parabola"]
from ipywidgets import FloatSlider, interact

_ = interact(
    lambda chosen: show(pictures.parabola(r_m, h_m, chosen), alt="the parabola"),
    chosen=FloatSlider(value=2 * A / B, min=-0.4, max=1.6, step=0.05, description="α"),
)

# %% [markdown]
# > **Predict.** The paper has $\alpha_i > 0$ (Eq. 1). Can the α of Eq. 8 be negative?
# > And if the booster's squared error is no larger than that of the zero function?

# %% tags=["predicted"]
print("r = −1, h = 1: α =", closed_form_alpha(np.array([-1.0]), np.array([1.0])))
smallest = 1.0
for _ in range(1000):
    r, h = rng.normal(size=(2, 5))
    alpha = closed_form_alpha(r, h)
    worse = ((r - h) ** 2).sum() - r @ r
    assert np.isclose(worse, (1 - 2 * alpha) * (h @ h))  # −2A + B
    smallest = min(smallest, alpha if worse <= 0 else 1.0)
print(f"fits no worse than zero, smallest α of 1,000: {smallest:.3f}")
assert smallest >= 0.5

# %% [markdown]
# A booster that points the wrong way gets a negative weight. One that fits no worse
# than the zero function has α ≥ ½ (M2).
#
# That holds if the fit and Eq. 8 use the same weights. Take the two samples from above
# and their best constant, h = −1/5. Eq. 8 gives it an α of −5:

# %%
r, w = np.array([3.0, -1.0]), np.array([0.25, 1.0])
h = np.full(2, constant(r, w))
plain, weighted = step_size(r, h, np.ones(2)), step_size(r, h, w)
for name, alpha in (("none", 0.0), ("of Eq. 8", plain), ("weighted", weighted)):
    loss = (w * (r - alpha * h) ** 2).sum()
    print(f"α {name:8} = {alpha:+.0f}   weighted loss {loss:.2f}")
assert np.isclose(plain, -5) and np.isclose(weighted, 1)
assert (w * (r - plain * h) ** 2).sum() > (w * r**2).sum()

# %% [markdown]
# Eq. 8 turns the best fit around, and so raises the very loss that this fit minimised
# (M12). With the weights in both sums it cannot (T1-e). The package does so (D7), over
# all stored transitions: the α of one batch may raise the loss of the rest (T1-j).
#
# ## Eq. 9 · Folding the booster in
#
# $$Q_m = Q_{m-1} + \alpha_m h_m \tag{9}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\alpha_m$ | `agent.alpha` | scalar | a number, or Eq. 8's |
# | $Q_{m-1}(s_i, a_i)$ | `agent.q_frozen` | (N,) | kept beside every transition |
# | $Q_{m-1}(s'_i, \cdot)$ | `agent.q_frozen_next` | (N, A) | likewise |
#
# At the next drift $h_m$ is frozen and joins $Q_{m-1}$. For each of the N stored
# transitions the package keeps the frozen answers, and adds the booster's share to them.
#
# From here on `q_frozen` holds the action taken only.
#
# **Exercise 4.** Bring the kept $Q_{m-1}(s_i, a_i)$ up to date.


# %%
def fold_in(q_frozen, a, h, alpha):
    """A new array, Q_m(s_i, a_i): q_frozen (B,), actions a (B,), h_m(s_i, ·) (B, A)."""
    ...  # yours


fold_in = check("fold_in", fold_in)
solution("fold_in")

# %% [markdown]
# The package's agent, after three boosters, against its ensemble and yours:

# %%
config = Config(hidden=[16], capacity=50, alpha=0.5)
agent = GBDQN(ROOMS, 2, config, np.random.default_rng(0))
for room, action in zip(
    rng.integers(1, ROOMS, 50), rng.integers(2, size=50), strict=True
):
    agent.observe(rooms[room], int(action), -1.0, rooms[room - 1], bool(room == 1))
s, a, yours = agent.replay.s, agent.replay.a, agent.q_frozen
for _ in range(3):
    yours = fold_in(yours, a, agent.net.forward(agent.theta, s)[0], agent.alpha)
    asked = agent.q(rooms)
    agent.on_drift("drift")
    assert np.allclose(agent.q(rooms), asked, atol=1e-6)
    agent.theta = agent.net.init(rng)  # as if it had learnt something

assert np.allclose(yours, agent.q_frozen, atol=1e-5)
assert np.allclose(agent.ensemble.q(s)[np.arange(50), a], agent.q_frozen, atol=1e-5)

# %% [markdown]
# So an update asks no frozen network, however many there are (M17, M19). Each booster
# is as large as the first, though; “lightweight” is not the word (M18). And with a live
# target and a fixed α a drift changes no answer: the next booster starts as the zero
# function.

# %% [markdown]
# ## Summary
#
# The ensemble is a sum, and the residual is the direction in which its loss falls, with
# y held fixed. In regression a zero residual means that nothing is left to learn. In
# the corridor it means only that Q agrees with itself: after the goal moved, two rooms
# have a residual, nine have a wrong value. The best step is $A/B$, with the weights of
# the loss in both sums; α inside the loss shrinks nothing.
#
# [← 3](03_forgetting.ipynb) · [contents](README.md) · [5 →](05_dqn.ipynb)

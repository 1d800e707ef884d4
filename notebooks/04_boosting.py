# %% [markdown]
# # 4 · Boosting the residual
#
# **Eqs. 1–9.** DQN has one network, and when the world changes that network must unlearn before it can learn. GB-DQN
# freezes it and lets a *second* network learn only what the first one now gets wrong. This is gradient boosting, with
# the Bellman residual in the place of the label's. After this notebook you can derive each step of it, and you know
# the three places where the printed equations do not give what the text says.
#
# *Before:* notebook 3 (targets). *Needs:* sums, derivatives. *Time:* a quarter of an hour.

# %%
import numpy as np
from lesson import BLUE, GREEN, ORANGE, VERMILLION, plt, source

from gbdqn_ref.bellman import loss_gradient, td_target, weighted_loss
from gbdqn_ref.boosting import Ensemble, closed_form_alpha
from gbdqn_ref.nn import MLP

rng = np.random.default_rng(0)

# %% [markdown]
# ## Eq. 1 · The ensemble is a sum
#
# $$Q_m(s, a) \;=\; \sum_{j=1}^{m} \alpha_j\, h_j(s, a) \;=\; Q_{m-1}(s, a) + \alpha_m h_m(s, a) \tag{1}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $h_j$ | `net.forward(theta, x)` | (B, A) | booster number j, a network like DQN's |
# | $\alpha_j$ | `ensemble.alpha[j]` | (m,) | its weight |
# | $\theta_j$ | `ensemble.theta[j]` | (m, P) | its parameters, one row of a stack |
# | $Q_m$ | `ensemble.q(x)` | (B, A) | the answer |
#
# All boosters are frozen: the only thing one can do with an ensemble is ask it, or add one more, which adds its term
# (claim M1).

# %%
source(Ensemble)

# %% [markdown]
# The same, naively: one booster after the other, in a loop.

# %%
net = MLP((2, 16, 3))  # two numbers in, three actions out
ensemble = Ensemble(net)
for alpha in (1.0, 0.5, 0.1):
    ensemble.add(net.init(rng), alpha)
x = rng.normal(size=(4, 2)).astype(np.float32)

q = np.zeros((4, 3))
for theta, alpha in zip(ensemble.theta, ensemble.alpha, strict=True):
    h, _ = net.forward(theta, x)
    q = q + alpha * h

assert np.allclose(q, ensemble.q(x), atol=1e-6)
q.round(3)

# %% [markdown]
# > **Predict, then run.** What does an ensemble without any booster answer? Write the number down before you run the
# > next cell.

# %%
Ensemble(net).q(x)[0]

# %% [markdown]
# Zero, for every action in every state: an empty sum. Algorithm 1 starts there, and notebook 6 shows what that costs.
#
# **Exercise 1.** `staged_q` gives $Q_1, Q_2, \dots, Q_m$ at once. Recover $\alpha_2 h_2(x)$ from it, without asking
# any network.

# %% tags=["solution"] jupyter={"source_hidden": true}
stages = ensemble.staged_q(x)
second = stages[1] - stages[0]
assert np.allclose(second, ensemble.terms(x)[1], atol=1e-6)

# %% [markdown]
# ## Eqs. 2–3 · Why the residual: it is the direction in which the loss falls
#
# $$L(Q) = \tfrac12 \sum_i w_i\,(y_i - Q_i)^2, \qquad -\frac{\partial L}{\partial Q_i} = w_i\,(y_i - Q_i)
# \tag{2, 3}$$
#
# Think of the answers $Q_i = Q(s_i, a_i)$ on the sample as free numbers. Then the steepest way down is to add to each
# of them its own weighted residual. Gradient boosting takes this step with a *function*: it fits a learner $h$ to the
# residuals and adds a multiple of it. (Eq. 2 is Eq. 3 with all $w_i = 1$.)
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $y_i - Q_i$ | `error` | (B,) | residual |
# | $w_i$ | `weight` | (B,) | importance weight, from notebook 5 (claim M5) |
# | $L$ | `weighted_loss(error, weight)` | scalar | a mean instead of a sum, so that it does not scale with B (D2) |
# | $\partial L/\partial Q$ | `loss_gradient(error, weight, a, n_actions)` | (B, A) | 0 at actions that were not taken |

# %%
source(weighted_loss, loss_gradient)

# %% [markdown]
# Naively: nudge each $Q_i$ by a hair and see how much the loss falls.

# %%
y, Q, w = np.array([1.0, -2.0, 0.5]), np.array([0.2, -1.0, 0.5]), np.array([1.0, 0.5, 2.0])
a, step = np.array([0, 1, 0]), 1e-6

slopes = []
for i in range(3):
    up, down = Q.copy(), Q.copy()
    up[i], down[i] = up[i] + step, down[i] - step
    slopes.append((weighted_loss(y - up, w) - weighted_loss(y - down, w)) / (2 * step))

gradient = loss_gradient(y - Q, w, a, n_actions=2)
assert np.allclose(slopes, gradient[np.arange(3), a], atol=1e-8)
assert np.allclose(slopes, -w * (y - Q) / 3)
gradient

# %% [markdown]
# The gradient is minus the weighted residual, as long as $y$ is held fixed (claims M3, M4). Whether it *is* fixed is the
# question on which Theorem 1 turns, since in reinforcement learning $y$ contains $Q$ itself: notebook 7.
#
# ## Eq. 4 · The residual that is left to learn
#
# $$y_i = r_i + \gamma \max_{a'} \bar Q_{m-1}(s'_i, a'), \qquad r_{i,m} = y_i - Q_{m-1}(s_i, a_i) \tag{4}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $r_i$, $\gamma$ | `r`, `gamma` | (B,), scalar | reward, discount |
# | $\bar Q_{m-1}(s'_i, \cdot)$ | `q_next` | (B, A) | the target network's answer at the next state |
# | $y_i$ | `td_target(r, terminated, q_next, gamma)` | (B,) | what $Q$ should have been |
# | $r_{i,m}$ | `residual` | (B,) | what booster m has to learn |
#
# The paper uses $r_i$ for the reward and $r_{i,m}$ for the residual; the code says `r` and `residual`. It also writes
# $Q_{m-1}$ in one place and $\bar Q_{m-1}$ in another (claim M6). Frozen networks make the two the same: a network that
# does not move is its own target network (D3).

# %%
source(td_target)

# %%
reward, terminated = np.array([-1.0, -1.0, 0.0]), np.array([False, False, True])
q_next = np.array([[-3.0, -2.0], [-5.0, -9.0], [7.0, 7.0]])

target = []
for i in range(3):
    future = 0.0 if terminated[i] else max(q_next[i])
    target.append(reward[i] + 0.9 * future)

assert np.allclose(target, td_target(reward, terminated, q_next, 0.9))
residual = np.array(target) - np.array([-2.0, -4.0, 0.0])  # minus Q_{m−1}(s_i, a_i)
residual

# %% [markdown]
# Where the physics have not changed the residual is near zero, and a new booster has nothing to do there. Where they
# have, it is what the drift left behind. That is the whole idea. Let us watch it on a function of one variable, where
# the *physics* are a curve, with the package's own network and optimiser.

# %%
from gbdqn_ref.optim import Adam

x1 = np.linspace(-1, 1, 200, dtype=np.float32)[:, None]
old = np.sin(4 * x1[:, 0])
new = old + 1.5 * np.maximum(0, x1[:, 0] - 0.2)  # it drifts on the right


def fit(net, theta, x, wanted, steps=1500):
    """Train θ towards `wanted` at x, by the loss and the gradient shown above."""
    adam, zeros, ones = Adam(net.size, 1e-2), np.zeros(len(x), int), np.ones(len(x), np.float32)
    for _ in range(steps):
        h, cache = net.forward(theta, x)
        adam.step(
            theta, net.backward(theta, cache, loss_gradient(wanted - h[:, 0], ones, zeros, 1))
        )
    return theta


curve = MLP((1, 64, 1))
staged = Ensemble(curve)
staged.add(fit(curve, curve.init(rng), x1, old), 1.0)  # h_1 learns the old world, and is frozen
left_behind = new - staged.q(x1)[:, 0]  # the residual after the drift
staged.add(
    fit(curve, curve.init(rng, zero_output=True), x1, left_behind), 1.0
)  # h_2 learns the residual alone

figure, axes = plt.subplots(1, 3, sharey=True, figsize=(9, 3.2))
axes[0].plot(x1, old, color="0.6", linewidth=5, alpha=0.5, label="old world")
axes[0].plot(x1, staged.staged_q(x1)[0], color=BLUE, label="$Q_1 = h_1$")
axes[0].set_title("before the drift")
axes[1].plot(x1, left_behind, color="0.6", linewidth=5, alpha=0.5, label="residual")
axes[1].plot(x1, staged.terms(x1)[1], color=VERMILLION, linestyle="--", label=r"$\alpha_2 h_2$")
axes[1].set_title("what the drift left behind")
axes[2].plot(x1, new, color="0.6", linewidth=5, alpha=0.5, label="new world")
axes[2].plot(x1, staged.staged_q(x1)[1], color=GREEN, linestyle="-.", label="$Q_2 = Q_1 + α_2 h_2$")
axes[2].set_title("after one booster")
for panel in axes:
    panel.set_xlabel("state x")
    panel.legend(loc="upper left", fontsize=9)
axes[0].set_ylabel("value")
assert np.abs(new - staged.q(x1)[:, 0]).max() < 0.2
plt.show()

# %% [markdown]
# `zero_output=True` starts the booster as the zero function (D11), so that adding it changes no answer before it has
# learnt something.
#
# > **Predict, then run.** The world changed only at x > 0.2. Where did the answers change?

# %%
moved = np.abs(staged.terms(x1)[1][:, 0])
print(f"on the right, x > 0.2: at most {moved[x1[:, 0] > 0.2].max():.1f}")
print(
    f"on the left:          at most {moved[x1[:, 0] <= 0.2].max():.3f}, and not 0: {bool(moved[0] > 0)}"
)

# %% [markdown]
# Nearly only on the right, here, because the left was in the data too, with a residual of about 0. Nothing in the
# method keeps a booster still where there is *no* data; the paper's claim that updates stay local fails (claim T4-b).
#
# **Exercise 2.** Freeze $h_1$ after the drift and let $h_2$ learn only from x > 0.2. How far does the answer on the left
# now move at most?

# %% tags=["solution"] jupyter={"source_hidden": true}
right = x1[:, 0] > 0.2
half = fit(
    curve, curve.init(np.random.default_rng(1), zero_output=True), x1[right], left_behind[right]
)
elsewhere = np.abs(curve.forward(half, x1)[0][~right, 0]).max()
assert elsewhere > 3 * moved[~right].max()  # several times as far: nothing held it
round(float(elsewhere), 2)

# %% [markdown]
# ## Eqs. 5–6 · What the booster is fitted to
#
# $$J_m = \sum_i \bigl(r_{i,m} - \alpha_m h_m(s_i, a_i)\bigr)^2 \tag{5}$$
#
# $$J_m = \sum_i w_i \bigl(r_{i,m} - \alpha_m h_m\bigr)^2
#      = \sum_i \bigl(\sqrt{w_i}\, r_{i,m} - \alpha_m \sqrt{w_i}\, h_m\bigr)^2 \tag{6}$$
#
# Both are called $J_m$, one without weights and one with them (claim M7). The second equality holds whenever $w_i \ge 0$
# (claim M8): a weight may be moved inside a square as its root, *if it is moved onto both terms*.
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $r_{i,m}$ | `residual` | (B,) | what booster m has to learn |
# | $\alpha_m h_m(s_i, a_i)$ | `factor * h` | (B,) | what it says; `factor` is α or 1, of which more below |
# | $w_i$ | `batch.weight` | (B,) | importance weight |
# | $J_m$ | `weighted_loss(residual - factor * h, weight)` | scalar | the same function as in Eq. 3 |

# %%
r, h, w = rng.normal(size=4), rng.normal(size=4), np.array([0.1, 1.0, 0.5, 0.0])
alpha = 0.7

outside = inside = 0.0
for i in range(4):
    outside += w[i] * (r[i] - alpha * h[i]) ** 2
    inside += (np.sqrt(w[i]) * r[i] - alpha * np.sqrt(w[i]) * h[i]) ** 2

assert np.isclose(outside, inside)
assert np.isclose(
    outside, 2 * 4 * weighted_loss(r - alpha * h, w)
)  # the code's loss: ½, and a mean over B = 4

# %% [markdown]
# From this the paper concludes that one may use $r$ in the place of $w\,r$. That does not follow (claim M9). The smallest
# example has two samples and a learner that can only say one constant:

# %%
r, w, one = np.array([2.0, -1.0]), np.array([0.25, 1.0]), np.ones(2)
readings = {
    "fitted to r, without weights": closed_form_alpha(r, one),
    "fitted to r, with weights w": closed_form_alpha(r, one, w),
    "fitted to w r": closed_form_alpha(w * r, one),
    "fitted to √w r": closed_form_alpha(np.sqrt(w) * r, one),
}
for name, constant in readings.items():
    print(f"{name:30} h = {constant:+.2f}")
assert len(set(readings.values())) == 4

# %% [markdown]
# Four readings, four learners. The code takes the second: the weights multiply the squared error, and the residual stays
# as it is.
#
# **Exercise 3.** Only the sizes of the weights *relative to one another* should matter. Multiply w by 9. Which of the four
# constants stay?

# %% tags=["solution"] jupyter={"source_hidden": true}
many = 9 * w
assert np.isclose(
    closed_form_alpha(r, one, many), readings["fitted to r, with weights w"]
)  # stays, as does the first
assert np.isclose(closed_form_alpha(many * r, one), 9 * readings["fitted to w r"])
uneven = np.array(
    [0.25, 4.0]
)  # √w r is 0 on average for the w above; with these weights it is −1/2
assert np.isclose(
    closed_form_alpha(np.sqrt(9 * uneven) * r, one), 3 * closed_form_alpha(np.sqrt(uneven) * r, one)
)

# %% [markdown]
# There is a fifth choice hidden in Eq. 5. With $\alpha_m$ *inside* the square, a learner that can represent anything
# becomes $h = r/\alpha$, so that $\alpha h = r$: whatever the shrinkage, the step is a whole one (claims M13, B2). Algorithm
# 1 leaves $\alpha$ out of the loss, and then the step is $\alpha\, r$. The code has both, `loss_on="alpha_h"` and
# `loss_on="h"`; notebook 6 shows what a run makes of each.
#
# ## Eqs. 7–8 · How long a step: the closed-form α
#
# $$\alpha_m = \arg\min_\alpha \sum_i \bigl(r_{i,m} - \alpha\, h_m(s_i, a_i)\bigr)^2 \tag{7}$$
# $$\alpha_m = \frac{\sum_i r_{i,m} h_m(s_i, a_i)}{\sum_i h_m(s_i, a_i)^2} = \frac{A}{B} \tag{8}$$
#
# (Eq. 7 is printed with min; the least *value* is not the best *α*: for r = h = 1 one is 0 and the other 1, claim M10.)
# To derive it, expand the square: $\sum r^2 - 2\alpha A + \alpha^2 B$, a parabola in $\alpha$. Its slope
# $-2A + 2\alpha B$ is zero at $A/B$, where its height is $\sum r^2 - A^2/B$ (claim M11). **That last sentence is all of
# Theorem 1.** In supervised learning, where targets stand still, it says that no step ever raises the training loss
# (claims M14, T1-k); it does not say that the loss ends at 0, since steps may help less and less (claim M15).
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $r_{i,m}$ | `residual` | (n,) | what was to be fitted |
# | $h_m(s_i, a_i)$ | `h` | (n,) | what the booster says |
# | – | `weights` | (n,) | the weights of the loss; the paper forgets them here (D7) |

# %%
source(closed_form_alpha)

# %%
h = rng.normal(size=6)
residual = 0.6 * h + 0.5 * rng.normal(size=6)  # a booster that has learnt something

A = B = 0.0
for i in range(6):
    A += residual[i] * h[i]
    B += h[i] ** 2

assert np.isclose(A / B, closed_form_alpha(residual, h))
before, after = (residual**2).sum(), ((residual - A / B * h) ** 2).sum()
assert np.isclose(before - after, A**2 / B)

# %% [markdown]
# Seen: the parabola, its lowest point, and what shrinkage does. With $\eta\,\alpha$ in the place of $\alpha$ the loss
# falls by $(2\eta - \eta^2)\,A^2/B$ (claim T1-d): at $\eta = 0.1$ by 19 % of what was to be had.


# %%
def parabola(chosen):
    """The frozen loss over α, with one α picked out."""
    _, axes = plt.subplots(figsize=(7, 3.2))
    alphas = np.linspace(-0.4, 2.4, 200) * A / B
    axes.plot(alphas, [((residual - each * h) ** 2).sum() for each in alphas], color=BLUE)
    axes.axhline(before, color="0.6", linestyle=":")
    for each, colour, mark, name in (
        (A / B, GREEN, "o", "A/B (Eq. 8)"),
        (0.1 * A / B, ORANGE, "s", "0.1 · A/B (shrunk)"),
        (chosen, VERMILLION, "^", f"α = {chosen:.2f}"),
    ):
        axes.plot(
            each, ((residual - each * h) ** 2).sum(), mark, color=colour, markersize=9, label=name
        )
    axes.set(
        xlabel="α",
        ylabel="Σ (r − α h)²",
        title="The loss is a parabola in α; dotted: without the booster",
    )
    axes.legend()
    plt.show()


parabola(2 * A / B)
assert np.isclose(((residual - 0.1 * A / B * h) ** 2).sum(), before - 0.19 * A**2 / B)

# %% [markdown]
# The triangle stands at twice the best α: there the loss is what it was without the booster. Any α between 0 and that
# point is an improvement, any other makes things worse. Move it:

# %% tags=["slider"]
from ipywidgets import FloatSlider, interact

_ = interact(
    parabola, chosen=FloatSlider(value=2 * A / B, min=-0.4, max=1.6, step=0.05, description="α")
)

# %% [markdown]
# > **Predict, then run.** Can α be negative? The paper says that all $\alpha_i$ are positive.

# %%
closed_form_alpha(np.array([-1.0]), np.array([1.0]))

# %% [markdown]
# A booster that points the wrong way gets a negative weight (claim M2). It can even happen to the *best possible*
# booster, when training weighs the samples and Eq. 8 does not (claim M12). Take the two samples from above and the
# exact weighted fit h = −2/5:

# %%
r, w = np.array([2.0, -1.0]), np.array([0.25, 1.0])
h = np.full(2, closed_form_alpha(r, np.ones(2), w))
unweighted, weighted = closed_form_alpha(r, h), closed_form_alpha(r, h, w)
for name, alpha in (("no booster", 0.0), ("α of Eq. 8", unweighted), ("weighted α", weighted)):
    print(
        f"{name:12} α = {alpha:+.2f}   weighted loss Σ w (r − αh)² = {(w * (r - alpha * h) ** 2).sum():.4f}"
    )
assert np.isclose(unweighted, -5 / 4) and np.isclose((w * (r - unweighted * h) ** 2).sum(), 45 / 16)

# %% [markdown]
# Eq. 8 turns the exact fit around and raises the very loss that it was fitted to, from 2 to 45/16. With the weights in
# its sums it cannot: the weighted loss falls by $A_w^2/B_w$ (claim T1-e). The code uses those (D7), and takes them over
# the whole buffer: the α of a minibatch may raise the loss of the rest (claim T1-j).
#
# **Exercise 4.** Show on random numbers that a booster which fits no worse than 0 does, $\sum (r - h)^2 \le \sum r^2$, has
# α ≥ ½. (Expand the square.)

# %% tags=["solution"] jupyter={"source_hidden": true}
for _ in range(1000):
    r, h = rng.normal(size=(2, 5))
    change = ((r - h) ** 2).sum() - (r**2).sum()  # = −2A + B = (1 − 2α) B
    alpha = closed_form_alpha(r, h)
    assert np.isclose(change, (1 - 2 * alpha) * (h @ h))
    assert (change <= 0) == (alpha >= 0.5)

# %% [markdown]
# ## Eq. 9 · Folding the booster in
#
# $$Q_m = Q_{m-1} + \alpha_m h_m \tag{9}$$
#
# When the next drift comes, $h_m$ is frozen with its weight and becomes part of $Q_{m-1}$. In the agent this is one
# function. Besides `ensemble.add` it does the trick that makes boosting cheap: the frozen predictions
# $Q_{m-1}(s_i, a_i)$ and $Q_{m-1}(s'_i, \cdot)$ of every stored transition are kept in two arrays, and folding in adds
# one booster's share to them. A training step then touches only the newest network, however many there are (claims M17,
# M19); each of them is as large as the first, so that "lightweight" is not the word (claim M18).
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\alpha_m$ | `agent.alpha` | scalar | a number, or Eq. 8's |
# | $Q_{m-1}(s_i, a_i)$ | `agent.q_frozen` | (N,) | kept beside every transition |
# | $Q_{m-1}(s'_i, \cdot)$ | `agent.q_frozen_next` | (N, A) | likewise |

# %%
from gbdqn_ref.gbdqn import GBDQN

source(GBDQN.fold_in)

# %% [markdown]
# Once more, naively: fill a buffer, fold in three boosters, and ask the whole ensemble about every transition.

# %%
from gbdqn_ref.config import Config

agent = GBDQN(2, 3, Config(hidden=[16], capacity=50, alpha=0.5), np.random.default_rng(0))
for _ in range(50):
    s, s2 = rng.normal(size=(2, 2)).astype(np.float32)
    agent.observe(s, int(rng.integers(3)), -1.0, s2, False)
for _ in range(3):
    agent.fold_in()

for i in range(50):
    q = sum(
        alpha * agent.net.forward(theta, agent.replay.s[i][None])[0][0, agent.replay.a[i]]
        for theta, alpha in zip(agent.ensemble.theta, agent.ensemble.alpha, strict=True)
    )
    assert np.isclose(q, agent.q_frozen[i], atol=1e-5)

# %% [markdown]
# **Exercise 5.** After `fold_in` the agent goes on with the same θ, which would count twice. What does `on_drift` do about
# it? Read its source, then check that right after a drift no answer has changed.

# %% tags=["solution"] jupyter={"source_hidden": true}
agent = GBDQN(2, 3, Config(hidden=[16], alpha=0.5), np.random.default_rng(0))
somewhere = rng.normal(size=(9, 2)).astype(np.float32)
asked = agent.q(somewhere)
agent.on_drift("drift")  # folds in, then starts h_{m+1} as the zero function
assert np.allclose(agent.q(somewhere), asked, atol=1e-6) and len(agent.ensemble) == 1

# %% [markdown]
# ## What to take along
#
# | | as printed | in truth |
# |---|---|---|
# | Eqs. 2–3 | the residual is the negative gradient | yes, with $y$ held fixed |
# | Eq. 6 and after | so use $r$ for $w\,r$ | four different learners |
# | Eq. 7 | min | argmin |
# | Eq. 8 | α > 0, for the weighted loss too | any sign; only with the weights in it does it lower the weighted loss |
# | Eq. 5 | α shrinks the step | not where α is inside the loss: it cancels |
#
# **Next:** notebook 5, where the samples come from.

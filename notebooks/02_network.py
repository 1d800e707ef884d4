# %% [markdown]
# # 2 · The network: an MLP, backprop and Adam
#
# Everything that learns in this package is a multilayer perceptron of some ninety lines. After this notebook you can write one
# without a framework, check its gradient to ten digits, and say in one line each what Adam, clipping and the target network do.
#
# *Needs:* the chain rule, matrix products. *Time:* a quarter of an hour.

# %%
import numpy as np
from lesson import BLACK, BLUE, GREEN, ORANGE, VERMILLION, plt, source

from gbdqn_ref.bellman import loss_gradient, weighted_loss
from gbdqn_ref.nn import MLP
from gbdqn_ref.optim import Adam, clip_by_norm, polyak

rng = np.random.default_rng(0)

# %% [markdown]
# ## The network $h(s, a; \theta)$
#
# A layer multiplies by a matrix and adds a bias; between layers stands the ReLU, $\max(0, \cdot)$. A bias is nothing but the
# weight of an input that is always 1, so a layer needs one matrix $V_l$, whose last row is the bias:
#
# $$h_0 = [x, 1], \qquad h_{l} = [\max(0,\, h_{l-1} V_{l}),\, 1], \qquad q = h_{L-1} V_L .$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $s$ | `x` | (B, d) | states, a batch of them |
# | $\theta$ | `theta` | (P,) | all parameters, one flat vector |
# | – | `V` | (n_in + 1, n_out) | one layer's block of θ, as a view |
# | $h(s, \cdot\,; \theta)$ | `q` | (B, A) | one number per action |
#
# The paper's learners are such networks with two hidden layers. That θ is *flat* will pay off at every turn: Adam, clipping,
# averaging, freezing and saving are each a line on one array.

# %%
source(MLP)

# %%
net = MLP((2, 3, 2))
theta = net.init(rng).astype(np.float64)
(W1, b1), (W2, b2) = net.unpack(theta)
x = np.array([0.5, -1.0])

hidden, q = [0, 0, 0], [0, 0]
for j in range(3):
    hidden[j] = max(0, sum(x[i] * W1[i, j] for i in range(2)) + b1[j])
for k in range(2):
    q[k] = sum(hidden[j] * W2[j, k] for j in range(3)) + b2[k]

answer, cache = net.forward(theta, x[None])
assert np.allclose(q, answer[0])

# %% [markdown]
# Of one input and one output, such a network is a line with bends: each hidden unit is bent where its $w x + b$ changes sign.

# %%
line = MLP((1, 8, 1))
grid = np.linspace(-2, 2, 401)[:, None]
for seed, colour, style in ((0, BLUE, "-"), (1, VERMILLION, "--"), (2, GREEN, "-.")):
    random_theta = line.init(np.random.default_rng(seed))
    (W, b), _ = line.unpack(random_theta)
    bends = -b / W[0]
    bends = bends[np.abs(bends) < 2][:, None]
    plt.plot(grid, line.forward(random_theta, grid)[0], style, color=colour, label=f"seed {seed}")
    plt.plot(bends, line.forward(random_theta, bends)[0], "o", color=colour, markersize=5)
plt.gca().set(
    xlabel="x",
    ylabel="q",
    title="Three random networks of 8 hidden units; dots: where a unit changes sign",
)
plt.legend()
plt.show()

# %% [markdown]
# **Exercise 1.** How many parameters has the network of the Acrobot experiment, 6 inputs, twice 128 hidden units, 3 actions?
# Count by hand, then ask the code.

# %% tags=["solution"] jupyter={"source_hidden": true}
assert MLP((6, 128, 128, 3)).size == (6 + 1) * 128 + (128 + 1) * 128 + (128 + 1) * 3 == 17_795

# %% [markdown]
# ## Backprop · How the loss changes with each parameter
#
# Let $dz_l$ be the derivative of the loss by what layer $l$ puts out, before the ReLU. The chain rule, from the last layer to the
# first, is two lines: a parameter's derivative is what came in times what goes out, and what goes out of one layer came in to the
# next.
#
# $$\frac{\partial L}{\partial V_l} = h_{l-1}^{\top}\, dz_l, \qquad dz_{l-1} = (dz_l\, W_l^{\top}) \cdot \mathbb 1\{h_{l-1} > 0\}$$
#
# | | code | shape | what it is |
# |---|---|---|---|
# | $dz_L = \partial L / \partial q$ | `dq` | (B, A) | where it starts: from the loss (notebook 3) |
# | $\partial L / \partial \theta$ | result of `backward` | (P,) | flat as θ is |

# %%
source(MLP.backward)

# %%
dq = np.array([1.0, -2.0])  # say the loss is q₀ − 2 q₁
grad = net.backward(theta, cache, dq[None])
(d_w1, d_b1), (d_w2, d_b2) = net.unpack(grad)

for j in range(3):
    dz = sum(dq[k] * W2[j, k] for k in range(2)) * (
        hidden[j] > 0
    )  # what unit j's input does to the loss
    assert np.isclose(d_b1[j], dz) and np.allclose(d_w1[:, j], x * dz)
    assert np.allclose(d_w2[j], hidden[j] * dq)
assert np.allclose(d_b2, dq)

# %% [markdown]
# ### Do not believe it: measure it
#
# A derivative is a ratio of small differences, and no program needs to be believed about it. Move one parameter by ±ε, divide.
#
# > **Predict, then run.** With ε = 10⁻², 10⁻⁴, …, 10⁻¹⁴: is a smaller ε always better? And what if the numbers are float32?


# %%
def loss(theta, x, dq):
    return (net.forward(theta, x)[0] * dq).sum()


def worst_error(theta, x, dq, step):
    """Largest difference between backprop and central differences, over all parameters."""
    grad, measured = net.backward(theta, net.forward(theta, x)[1], dq), np.zeros(net.size)
    for i in range(net.size):
        up, down = theta.copy(), theta.copy()
        up[i] += step
        down[i] -= step
        measured[i] = (loss(up, x, dq) - loss(down, x, dq)) / (float(up[i]) - float(down[i]))
    return np.abs(measured - grad).max()


steps = 10.0 ** -np.arange(1, 13)
for dtype, colour, mark in ((np.float64, BLUE, "o-"), (np.float32, VERMILLION, "s--")):
    with np.errstate(
        divide="ignore", invalid="ignore"
    ):  # in float32 a tiny step may not move θ at all
        errors = [
            worst_error(theta.astype(dtype), x[None].astype(dtype), dq.astype(dtype)[None], s)
            for s in steps
        ]
    plt.loglog(steps, errors, mark, color=colour, label=dtype.__name__)
plt.gca().invert_xaxis()
plt.gca().set(xlabel="step ε, smaller to the right", ylabel="backprop against measurement")
plt.title("A measured gradient is ruined by rounding if ε is too small")
plt.legend()
plt.show()
assert worst_error(theta, x[None], dq[None], 1e-5) < 1e-9

# %% [markdown]
# The network is made of straight lines, so only rounding is in the way: about $10^{-16}/\varepsilon$ in float64, $10^{-7}/\varepsilon$
# in float32. This is why the package's tests run in float64, and why training, which needs no ten digits, runs in float32 at
# half the memory.
#
# One trap is left: at a *bend* there is no derivative, and the two sides are averaged. A check that draws its points at random has
# to keep away from bends, or it will fail once in a while for no reason.

# %%
bend = MLP((1, 1, 1))
kinked = np.array([1.0, 0.0, 1.0, 0.0])  # q = max(0, x)
x0 = np.zeros((1, 1))  # just at the bend
difference = (bend.forward(kinked, x0 + 1e-6)[0] - bend.forward(kinked, x0 - 1e-6)[0]).item() / 2e-6
print(
    "measured slope at the bend:",
    round(difference, 6),
    " backprop's:",
    bend.backward(kinked, bend.forward(kinked, x0)[1], np.ones((1, 1)))[1],
)

# %% [markdown]
# **Exercise 2.** Forget the factor $\mathbb 1\{h > 0\}$. Write this wrong gradient for the network above, and let the measurement
# find it out.

# %% tags=["solution"] jupyter={"source_hidden": true}
wrong = [
    sum(dq[k] * W2[j, k] for k in range(2)) for j in range(3)
]  # of the biases of the first layer
measured = []
for j in range(3):
    up = theta.copy()
    net.unpack(up)[0][1][j] += 1e-6
    measured.append((loss(up, x[None], dq[None]) - loss(theta, x[None], dq[None])) / 1e-6)
assert np.allclose(measured, d_b1, atol=1e-6) and not np.allclose(measured, wrong, atol=1e-3)

# %% [markdown]
# ## A booster starts at zero
#
# A new booster h is added to a sum that already works; so h should be 0 at first. Its last layer is set to zero, the others
# are random (deviation D11).
#
# > **Predict, then run.** A network whose last layer is zero: is its gradient zero too? And one whose layers are *all* zero: what can
# > it learn?

# %%
x_all, wanted = np.linspace(-1, 1, 64)[:, None], np.abs(np.linspace(-1, 1, 64))[:, None]
fits = MLP((1, 32, 1))
starts = {
    "last layer 0": fits.init(np.random.default_rng(0), zero_output=True),
    "all 0": np.zeros(fits.size, np.float32),
}
for (name, start), colour, style in zip(
    starts.items(), (BLUE, VERMILLION), ("-", "--"), strict=True
):
    assert (fits.forward(start, x_all)[0] == 0).all()
    adam = Adam(fits.size, lr=0.01)
    for _ in range(500):
        out, cache = fits.forward(start, x_all)
        adam.step(start, fits.backward(start, cache, (out - wanted) / len(x_all)))
    plt.plot(
        x_all, fits.forward(start, x_all)[0], style, color=colour, label=f"{name}, after 500 steps"
    )
plt.plot(x_all, wanted, ":", color=BLACK, label="what it should learn")
plt.gca().set(
    xlabel="x", ylabel="q", title="Both start as the zero function; one of them can leave it"
)
plt.legend()
plt.show()
assert (
    np.ptp(fits.forward(starts["all 0"], x_all)[0]) == 0
)  # a constant: only the last bias ever had a gradient

# %% [markdown]
# ## Adam · How far to step
#
# The gradient says where down is, not how far. Adam keeps a running mean of the gradient and of its square, and moves every
# coordinate by their ratio, about `lr` each time, whatever the gradient's size:
#
# $$m \leftarrow \beta_1 m + (1 - \beta_1) g, \qquad v \leftarrow \beta_2 v + (1 - \beta_2) g^2, \qquad
# \theta \leftarrow \theta - \text{lr} \cdot \frac{m / (1 - \beta_1^t)}{\sqrt{v / (1 - \beta_2^t)} + \epsilon}$$
#
# | | code | shape | what it is |
# |---|---|---|---|
# | $g$ | `grad` | (P,) | gradient of this batch |
# | $m, v$ | `m`, `v` | (P,) | running means of $g$ and $g^2$, from 0 |
# | $1 - \beta^t$ | `correction1`, `correction2` | scalar | makes up for the start at 0 |

# %%
source(Adam.step)

# %% [markdown]
# Three steps by hand, of one number, with the gradients 4, 4 and −2 and lr = 0.1:

# %%
adam, by_package = Adam(1, lr=0.1), np.zeros(1)
m = v = by_hand = 0.0
for t, g in enumerate((4.0, 4.0, -2.0), start=1):
    m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
    by_hand -= 0.1 * (m / (1 - 0.9**t)) / ((v / (1 - 0.999**t)) ** 0.5 + 1e-8)
    adam.step(by_package, np.array([g]))
    print(f"t = {t}: g = {g:+.0f}, m = {m:.4f}, v = {v:.6f}, θ = {by_hand:.6f}")
    assert np.isclose(by_hand, by_package[0])

# %% [markdown]
# The first two steps are 0.1 each: the same gradient twice is all signal. The third gradient points back, the mean still does not,
# and the step becomes shorter.
#
# > **Predict, then run.** Multiply the loss by 1000. What does plain gradient descent do, and what Adam?
#
# The paths below go down into a narrow valley, $\tfrac12 (x^2 + 50 y^2)$.

# %%
scales = np.array([1.0, 50.0])
figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), sharey=True)
for panel, factor in zip(axes, (1, 1000), strict=True):
    descent, adaptive = np.array([-2.0, 0.6]), np.array([-2.0, 0.6])
    paths, adam = (
        {"gradient descent, lr 0.03": [descent.copy()], "Adam, lr 0.03": [adaptive.copy()]},
        Adam(2, lr=0.03),
    )
    for _ in range(150):
        if np.abs(descent).max() < 100:
            descent = descent - 0.03 * factor * scales * descent
        adam.step(adaptive, factor * scales * adaptive)
        paths["gradient descent, lr 0.03"].append(descent)
        paths["Adam, lr 0.03"].append(adaptive.copy())
    for (name, path), colour, mark in zip(paths.items(), (ORANGE, BLUE), ("^-", "o-"), strict=True):
        panel.plot(*np.transpose(path), mark, color=colour, markersize=3, linewidth=0.8, label=name)
    panel.plot(0, 0, "+", color=BLACK, markersize=14)
    panel.set(xlim=(-2.4, 0.6), ylim=(-1, 1), xlabel="x", title=f"loss × {factor}")
    assert np.hypot(*adaptive) < 0.1
axes[0].set_ylabel("y")
axes[0].legend(loc="lower left")
plt.show()
assert np.abs(descent).max() > 100  # on the right it is out of the picture after one step

# %% [markdown]
# Adam's path is the same on both sides. For DQN this matters: nobody knows beforehand how large Q, and so the loss, will be.
#
# **Exercise 3.** How far does Adam get in 100 steps with lr = 0.01, if the gradient is 1 each time? And if it is 1, −1, 1, −1, …?

# %% tags=["solution"] jupyter={"source_hidden": true}
reached = []
for gradients in (np.ones(100), np.resize([1.0, -1.0], 100)):
    adam, place = Adam(1, lr=0.01), np.zeros(1)
    for g in gradients:
        adam.step(place, np.array([g]))
    reached.append(place[0])
assert np.isclose(reached[0], -1, atol=1e-6)  # 100 whole steps: all signal
assert abs(reached[1]) < 0.03  # all noise: m is a mean of what cancels, v is not

# %% [markdown]
# ### Clipping
#
# One exploded TD error should not throw θ far away, so that a gradient longer than `max_norm` is
# shortened to it: $g \cdot \min(1, c / \lVert g \rVert)$.

# %%
source(clip_by_norm)

# %%
g = np.array([3.0, 4.0])
length = sum(value**2 for value in g) ** 0.5
assert length == 5 and np.allclose(clip_by_norm(g, 2.0), [value * 2 / length for value in g])

# %% [markdown]
# ## Polyak averaging · The network that the targets come from
#
# $$\bar\theta \leftarrow (1 - \tau)\,\bar\theta + \tau\,\theta$$
#
# | paper | code | what it is |
# |---|---|---|
# | $\bar\theta$ | `theta_target` | the target network's parameters |
# | τ | `tau` | 0.005 here: how much of the way it goes at each update |

# %%
source(polyak)

# %% [markdown]
# It is a running average with exponential weights: of θ's value $k$ updates ago, $\bar\theta$ has the part $\tau(1-\tau)^k$
# (claim P1). If θ jumps, half of the way is gone after $\ln 2 / \tau$ updates, about 139 at τ = 0.005.

# %%
history = rng.normal(size=30)
averaged = np.zeros(1)
for value in history:
    polyak(averaged, value, 0.1)

assert np.isclose(averaged[0], sum(0.1 * 0.9**k * history[29 - k] for k in range(30)))

updates = np.arange(1200)
for tau, colour, style in ((0.05, GREEN, "-."), (0.005, BLUE, "-"), (0.001, VERMILLION, "--")):
    plt.plot(
        updates,
        1 - (1 - tau) ** updates,
        style,
        color=colour,
        label=f"τ = {tau}: half after {np.log(2) / tau:.0f}",
    )
plt.axhline(0.5, color="0.6", linewidth=0.8)
plt.gca().set(
    xlabel="updates after θ has jumped from 0 to 1",
    ylabel="θ̄",
    title="How the target network follows",
)
plt.legend()
plt.show()

# %% [markdown]
# **Exercise 4.** Averaging the parameters sounds like averaging what the networks say. Take two networks of the same shape: is the
# network of their mean parameters the mean of the two functions? When would it be?

# %% tags=["solution"] jupyter={"source_hidden": true}
one, two = net.init(np.random.default_rng(1)), net.init(np.random.default_rng(2))
mean_of_functions = (net.forward(one, x[None])[0] + net.forward(two, x[None])[0]) / 2
assert not np.allclose(net.forward((one + two) / 2, x[None])[0], mean_of_functions)
linear = MLP((2, 2))  # without a hidden layer q is linear in θ
one, two = linear.init(np.random.default_rng(1)), linear.init(np.random.default_rng(2))
mean_of_functions = (linear.forward(one, x[None])[0] + linear.forward(two, x[None])[0]) / 2
assert np.allclose(linear.forward((one + two) / 2, x[None])[0], mean_of_functions)

# %% [markdown]
# ## A stack of networks
#
# The leading axes of θ are free: θ of shape (K, P) is K networks, which answer, and learn, in one call. An ensemble of frozen
# boosters is such a stack.

# %%
stack = net.init(rng, k=4)
x_many = rng.normal(size=(5, 2)).astype(np.float32)

one_by_one = [net.forward(stack[k], x_many)[0] for k in range(4)]

assert np.allclose(net.forward(stack, x_many)[0], one_by_one, atol=1e-6)
print("θ", stack.shape, "→ q", net.forward(stack, x_many)[0].shape)

# %% [markdown]
# ## All of it together
#
# Predict, compare, go back, step: the loop that every notebook from here on has somewhere inside. The functions of the loss are
# those of DQN, with one "action" and all weights 1.

# %%
curve = MLP((1, 64, 64, 1))
theta, adam = curve.init(np.random.default_rng(3)), Adam(curve.size, lr=0.003)
x = np.linspace(-3, 3, 128, dtype=np.float32)[:, None]
y = np.sin(2 * x[:, 0]) + 0.3 * x[:, 0]
always, ones = np.zeros(128, int), np.ones(128)

losses, shown = [], {0: "0.75", 30: ORANGE, 600: BLUE}
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4))
for update in range(601):
    q, cache = curve.forward(theta, x)
    error = y - q[:, 0]
    losses.append(weighted_loss(error, ones))
    if update in shown:
        left.plot(x, q, color=shown[update], label=f"after {update} updates")
    adam.step(
        theta,
        clip_by_norm(curve.backward(theta, cache, loss_gradient(error, ones, always, 1)), 10.0),
    )
left.plot(x, y, ":", color=BLACK, label="wanted")
left.set(xlabel="x", ylabel="q", ylim=(-2.6, 2.2))
left.legend(fontsize=8)
right.semilogy(losses, color=BLUE)
right.set(xlabel="update", ylabel="loss, log scale", title="4,353 parameters, 601 updates")
plt.show()
assert losses[-1] < 0.003 and curve.size == 4353

# %% [markdown]
# ## What to take along
#
# | | one might think | in truth |
# |---|---|---|
# | backprop | needs a framework | is two lines per layer, and can be checked by measuring |
# | a network that is 0 | has gradient 0 | not if only its last layer is 0: boosters start so (D11) |
# | Adam | follows the gradient's size | moves each coordinate by about `lr`, whatever the loss is multiplied by |
# | target network | an average of networks | an average of parameters: of functions only where q is linear in θ |
#
# **Next:** notebook 3, where $y$ is no longer given but made of Q itself.

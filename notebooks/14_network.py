# %% [markdown]
# # 14 · The network by hand
#
# After this appendix you can write the network, its gradient and its optimizer in
# NumPy, and you can check each of them without trusting anyone.
#
# *Time: 30 minutes. Needs: matrix products and the chain rule; no other notebook. With
# the paper open: $h(s, a; \theta)$ in Eq. 5, and section "Ensemble Target Networks".*
#
# **How to read this with the paper open.** For Acrobot and for Hopper the paper
# describes its network in one sentence, for MountainCar not at all (D13): "fully
# connected Q-network architecture with two hidden layers of size $(128,128)$ and ReLU
# activations, optimized using Adam" (section Acrobot). This page says what each of
# these words does. The lesson uses networks from notebook 3 on; read this page when you
# want to see inside.

# %%
import numpy as np
from exercises import check, solution
from lesson import show, source
from pictures import network as pictures

from gbdqn_ref.bellman import loss_gradient, weighted_loss
from gbdqn_ref.config import Config
from gbdqn_ref.nn import MLP
from gbdqn_ref.optim import TINY, Adam, clip_by_norm, polyak

rng = np.random.default_rng(0)

# %% [markdown]
# ## The network $h(s, a; \theta)$
#
# A **network** here is a **multilayer perceptron**: layers, one after another. A layer
# multiplies its input by a matrix of **weights** and adds a **bias**. Between two
# layers stands the **ReLU**, $\max(0, \cdot)$. Its outputs are the **activations** of
# the layer's **hidden units**. The last layer has no ReLU; it puts out one number for
# each action.
#
# A bias is the weight of an input that is always 1. So each layer $l$ needs only one
# matrix $V_l$: the weights $W_l$ with the bias $b_l$ as one more row. For $L$ layers,
# with $h_l$ for what enters layer l (not booster l, as elsewhere):
#
# $$V_l = \begin{bmatrix} W_l \\ b_l \end{bmatrix}, \qquad h_1 = [x, 1], \qquad
# h_{l+1} = [\max(0,\, h_l V_l),\, 1], \qquad q = h_L V_L .$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $s$ | `x` | (B, d) | B states at once, a **batch** |
# | $\theta$ | `theta` | (P,) | all **parameters**, in one flat vector |
# | – | `V` | (n_in + 1, n_out) | one layer's block of θ, as a view |
# | – | `h` | (B, n_in + 1) | what enters a layer, with a last column of ones |
# | $h(s, \cdot\,; \theta)$ | `q` | (B, A) | one number per action |
#
# Because θ is flat, the optimizer, clipping, averaging, freezing and saving each take
# one line.

# %%
source(MLP.init, MLP.forward)

# %% [markdown]
# Two inputs, three hidden units, two actions, in plain loops:

# %%
net = MLP((2, 3, 2))
theta = net.init(rng).astype(np.float64)
(W1, b1), (W2, b2) = net.unpack(theta)
x = np.array([0.5, -1.0])

hidden = [max(0, sum(x[i] * W1[i, j] for i in range(2)) + b1[j]) for j in range(3)]
q = [sum(hidden[j] * W2[j, k] for j in range(3)) + b2[k] for k in range(2)]

answer, cache = net.forward(theta, x[None])
assert np.allclose(q, answer[0])

# %% [markdown]
# With one input and one output, such a network is a line with bends. Each hidden unit
# bends it at one place, where its $w x + b$ changes sign.
#
# **Exercise 1.** How many parameters does the network of the Acrobot experiment have: 6
# inputs, twice 128 hidden units, 3 actions?


# %%
def parameters(widths):
    """How many numbers θ has, for widths like (6, 128, 128, 3)."""
    ...  # yours


parameters = check("parameters", parameters)
assert parameters((6, 128, 128, 3)) == MLP((6, 128, 128, 3)).size
solution("parameters")

# %% [markdown]
# ## Backpropagation: the gradient
#
# A **loss** $L$ is a number that says how wrong $q$ is. The **gradient** holds its
# derivative with respect to every parameter. Let $z_l = h_l V_l$ be what layer $l$ puts
# out before the ReLU, and $dz_l$ the derivative of the loss with respect to it.
# **Backpropagation** is the chain rule, from the last layer to the first:
#
# $$\frac{\partial L}{\partial V_l} = h_l^{\top}\, dz_l, \qquad
# dz_{l-1} = (dz_l\, W_l^{\top}) \cdot \mathbb 1\{h_l > 0\} .$$
#
# In words: a parameter's derivative is its input times the derivative of its output.
# And one layer's output is the next layer's input, so the derivative goes back through
# $W_l$, the rows of $V_l$ without the bias. Where the ReLU put out 0, nothing goes
# back.
#
# | | code | shape | what it is |
# |---|---|---|---|
# | $dz_L = \partial L / \partial q$ | `dq` | (B, A) | where it starts (notebook 5) |
# | $\partial L / \partial \theta$ | result of `nn.MLP.backward` | (P,) | flat, like θ |

# %%
source(MLP.backward)

# %% [markdown]
# By hand, for the loss $q_0 - 2 q_1$:

# %%
dq = np.array([1.0, -2.0])
grad = net.backward(theta, cache, dq[None])
(of_w1, of_b1), (of_w2, of_b2) = net.unpack(grad)

for j in range(3):
    dz = sum(dq[k] * W2[j, k] for k in range(2)) * (hidden[j] > 0)
    assert np.isclose(of_b1[j], dz) and np.allclose(of_w1[:, j], x * dz)
    assert np.allclose(of_w2[j], hidden[j] * dq)
assert np.allclose(of_b2, dq)

# %% [markdown]
# **Exercise 2.** Write one layer's step back.


# %%
def backward(h, V, dz):
    """(∂L/∂V, dz of the layer before) from h (B, n + 1), V (n + 1, m) and dz (B, m)."""
    ...  # yours


backward = check("backward", backward)
solution("backward")

# %% [markdown]
# ### Do not trust it: measure it
#
# A derivative is a ratio of small differences. Move one parameter by ±ε, and divide.
#
# > **Predict.** Let ε be 10⁻¹, 10⁻², …, 10⁻¹². Is a smaller ε always better? And if all
# > numbers are float32?


# %% tags=["predicted"]
def loss(theta):
    return (net.forward(theta, x[None])[0] * dq).sum()


def worst_error(theta, step):
    """The largest difference between backpropagation and measurement."""
    dtype, measured = theta.dtype, np.zeros(net.size)
    exact = net.backward(theta, net.forward(theta, x[None])[1], dq[None].astype(dtype))
    for i in range(net.size):
        up, down = theta.copy(), theta.copy()
        up[i] += step
        down[i] -= step
        measured[i] = (loss(up) - loss(down)) / max(float(up[i]) - float(down[i]), TINY)
    return np.abs(measured - exact).max()


for power in range(1, 13):
    errors = [worst_error(theta.astype(dtype), 10.0**-power) for dtype in ("f8", "f4")]
    print("ε = 1e-{:02}   float64 {:.0e}   float32 {:.0e}".format(power, *errors))
assert worst_error(theta, 1e-5) < 1e-9

# %% [markdown]
# The network is made of straight lines, so the only error is rounding: about 10⁻¹⁶/ε in
# float64, 10⁻⁷/ε in float32. At 10⁻⁸ most float32 parameters do not move. This is
# why the package's tests run in float64. Training does not need ten digits. It runs in
# float32, in half the memory.
#
# One trap remains. At a bend there is no derivative, and measuring averages the two
# sides. For $q = \max(0, x)$ at $x = 0$:

# %%
bend, kinked = MLP((1, 1, 1)), np.array([1.0, 0.0, 1.0, 0.0])
left, at, right = (np.array([[shift]]) for shift in (-1e-6, 0.0, 1e-6))
rise = bend.forward(kinked, right)[0] - bend.forward(kinked, left)[0]
slope = bend.backward(kinked, bend.forward(kinked, at)[1], np.ones((1, 1)))[1]  # of b
print(f"measured {rise.item() / 2e-6:.3f}, by backpropagation {slope:.3f}")
assert np.isclose(rise.item() / 2e-6, 0.5) and slope == 0

# %% [markdown]
# ## A booster starts at zero
#
# A new booster is added to a sum that already works. So it should be 0 at first. Its
# last layer is set to zero, and the others are random (D11).
#
# > **Predict.** The last layer of a network is zero. Is its gradient zero, too? And if
# > all layers are zero, what can it learn?

# %% tags=["predicted"]
inputs = np.linspace(-1, 1, 64)[:, None]
wanted, fits = np.abs(inputs), MLP((1, 32, 1))
starts = {
    "last layer 0": fits.init(np.random.default_rng(0), zero_output=True),
    "all layers 0": np.zeros(fits.size, np.float32),
}
left = {}
for name, start in starts.items():
    assert (fits.forward(start, inputs)[0] == 0).all()  # both are the zero function
    adam = Adam(fits.size, lr=0.01)
    for _ in range(500):
        out, cache = fits.forward(start, inputs)
        adam.step(start, fits.backward(start, cache, (out - wanted) / len(inputs)))
    out, _ = fits.forward(start, inputs)
    left[name] = np.abs(out - wanted).max()
    print(f"{name}: largest error {left[name]:.3f} after 500 steps towards |x|")
assert left["last layer 0"] < 0.1 and np.ptp(out) == 0

# %% [markdown]
# The gradient of the last layer is $h_L^\top dz_L$, and $h_L$ is not zero. After one
# step the last layer is not zero either, and the others follow. If all layers are zero,
# only the last bias ever has a gradient: the network stays a constant.
#
# ## Adam: how far to step
#
# The gradient says which way is down. It does not say how far to go. **Adam** keeps a
# running mean $m$ of the gradient and $v$ of its square, and moves each parameter by
# lr times $m/\sqrt v$. Early on it divides out the start at 0:
#
# $$m \leftarrow \beta_1 m + (1 - \beta_1) g, \qquad
# v \leftarrow \beta_2 v + (1 - \beta_2) g^2, \qquad
# \theta \leftarrow \theta - \text{lr} \cdot
# \frac{m / (1 - \beta_1^t)}{\sqrt{v / (1 - \beta_2^t)} + \epsilon}$$
#
# | | code | shape | what it is |
# |---|---|---|---|
# | $g$ | `grad` | (P,) | gradient of this batch |
# | $m, v$ | `m`, `v` | (P,) | running means of $g$ and $g^2$, the **moments** |
# | lr | `lr` | scalar | the learning rate: how far a step goes |
# | $1 - \beta^t$ | `correction1`, `correction2` | scalar | undoes the start at 0 |

# %%
source(Adam.step)

# %% [markdown]
# Three steps of one number, with gradients 4, 4 and −2:

# %%
adam, by_package = Adam(1, lr=0.1), np.zeros(1)
m = v = by_hand = 0.0
for t, g in enumerate((4.0, 4.0, -2.0), start=1):
    m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
    by_hand -= 0.1 * (m / (1 - 0.9**t)) / ((v / (1 - 0.999**t)) ** 0.5 + 1e-8)
    adam.step(by_package, np.array([g]))
    print(f"t = {t}: g = {g:+.0f}, m = {m:.4f}, v = {v:.6f}, θ = {by_hand:.4f}")
    assert np.isclose(by_hand, by_package[0])

# %% [markdown]
# The first two steps have length 0.1, the learning rate, since the gradient is its own
# mean. The third gradient points back. The mean does not yet, and the step is shorter.
#
# **What is `TINY`?** A hidden unit that is off for every state has gradient 0. Then its
# $m$ shrinks by a factor 0.9 at each step. After some 830 steps it is below the
# smallest normal float32. With such **denormal** numbers many processors are slow. So
# every hundred steps the package sets moments below `TINY` to 0. A moment of that size
# moves a parameter by less than float32 can show:

# %%
steps = next(k for k in range(2000) if 0.9**k < np.finfo(np.float32).tiny)
print(f"1 becomes denormal after {steps} steps; TINY = {TINY:g}")
assert TINY / 1e-8 < 1e-20  # m / (√v + ε) with m = TINY and v = 0

# %% [markdown]
# > **Predict.** Multiply the loss by 1000. What does plain **gradient descent** do,
# > which moves by lr times the gradient? And Adam?

# %% tags=["predicted"]
ends = {}
for factor in (1, 1000):
    descent, adaptive, adam = (
        np.array([-2.0, 0.6]),
        np.array([-2.0, 0.6]),
        Adam(2, 0.03),
    )
    for _ in range(150):  # down into the narrow valley (x² + 50 y²)/2
        if np.abs(descent).max() < 100:
            descent = descent - 0.03 * factor * np.array([1.0, 50.0]) * descent
        adam.step(adaptive, factor * np.array([1.0, 50.0]) * adaptive)
    ends[factor] = np.abs(descent).max(), np.abs(adaptive).max()
    print(
        "loss × {:4}: descent ends {:.3g}, Adam {:.3g} from 0".format(
            factor, *ends[factor]
        )
    )
assert ends[1][0] < 0.1 < 100 < ends[1000][0]
assert np.isclose(ends[1][1], ends[1000][1], atol=1e-6)

# %% [markdown]
# Gradient descent leaves the valley at its first step. Adam's path does not change,
# because $m / \sqrt v$ does not. That helps DQN, where nobody knows in advance how
# large Q will be. It helps GB-DQN half-way. If a booster counts with α = 0.1, its
# gradient is ten times smaller, which Adam undoes; its output also counts ten times
# less, which Adam cannot undo. So an update moves Q ten times less, and with plain
# gradient descent it would be a hundred times.
#
# **Exercise 3.** Write Adam.


# %%
def adam_step(theta, m, v, t, g, lr):
    """(θ, m, v) after step t = 1, 2, …; β₁ = 0.9, β₂ = 0.999, ε = 1e-8."""
    ...  # yours


adam_step = check("adam_step", adam_step)
solution("adam_step")

# %% [markdown]
# ### Clipping
#
# One huge error should not throw θ far away. So a gradient longer than $c$ is shortened
# to length $c$. Its direction stays:
#
# $$g \cdot \min(1,\, c / \lVert g \rVert)$$

# %%
source(clip_by_norm)

# %%
g = np.array([3.0, 4.0])
length = sum(value**2 for value in g) ** 0.5
by_hand = [value * min(1, 2 / length) for value in g]
assert length == 5 and np.allclose(clip_by_norm(g, 2.0), by_hand)

# %% [markdown]
# **Exercise 4.** Write it. What must not happen to a short gradient?


# %%
def clip(g, c):
    """g, shortened to length c if it is longer."""
    ...  # yours


clip = check("clip", clip)
solution("clip")

# %% [markdown]
# ## Polyak averaging: the target network
#
# DQN computes its targets with a second set of parameters, which follows the first
# slowly (notebook 5). The paper: "All target networks are updated softly via Polyak
# averaging" (section "Ensemble Target Networks").
#
# $$\bar\theta \leftarrow (1 - \tau)\,\bar\theta + \tau\,\theta$$
#
# | paper | code | what it is |
# |---|---|---|
# | $\bar\theta$ | `theta_target` | the target network's parameters |
# | τ | `tau` | how much of the way it goes at each update |

# %%
source(polyak)

# %% [markdown]
# It is a running average (claim P1): the parameters of $k$ updates ago have the weight
# $\tau (1 - \tau)^k$. If θ jumps, half of the way is done after about $\ln 2 / \tau$
# updates.

# %%
history, averaged = rng.normal(size=30), np.zeros(1)
for value in history:
    polyak(averaged, value, 0.1)
assert np.isclose(averaged[0], sum(0.1 * 0.9**k * history[29 - k] for k in range(30)))

tau = Config().tau
print(f"the package's τ = {tau}: half of the way after {np.log(2) / tau:.0f} updates")

# %% [markdown]
# The mean of two networks' parameters is not the mean of the two functions. It is, if
# $q$ is linear in θ, as without a hidden layer:

# %%
for name, shape in (("one hidden layer", (2, 3, 2)), ("no hidden layer", (2, 2))):
    pair = MLP(shape)
    both = pair.init(np.random.default_rng(1), k=2)
    mean = pair.forward(both, x[None])[0].mean(0)
    gap = np.abs(pair.forward(both.mean(0), x[None])[0] - mean).max()
    print(f"{name}: they differ by {gap:.3f}")
assert gap < 1e-6

# %% [markdown]
# ## A stack of networks
#
# θ may have leading axes. With shape (K, P) it is K networks, which answer in one call.
# An ensemble of frozen boosters is such a stack.

# %%
stack, states = net.init(rng, k=4), rng.normal(size=(5, 2)).astype(np.float32)
one_by_one = [net.forward(stack[k], states)[0] for k in range(4)]
assert np.allclose(net.forward(stack, states)[0], one_by_one, atol=1e-6)

# %% [markdown]
# ## All of it together
#
# Predict, compare, go back, step. This loop is inside every agent of the lesson. Here
# it fits a curve, with the loss of DQN, one "action" and all weights 1.

# %%
curve = MLP((1, 64, 64, 1))
xs = np.linspace(-3, 3, 128, dtype=np.float32)[:, None]
ys = np.sin(2 * xs[:, 0]) + 0.3 * xs[:, 0]
only, ones = np.zeros(128, int), np.ones(128)


def fit(falling, updates=601):
    """The losses and {update: fit}; the learning rate falls, or it does not."""
    theta, adam = curve.init(np.random.default_rng(3)), Adam(curve.size, lr=0.003)
    losses, fits = [], {}
    for update in range(updates):
        if falling:
            adam.lr = 0.003 * (1 - update / updates)
        q, cache = curve.forward(theta, xs)
        error = ys - q[:, 0]
        losses.append(weighted_loss(error, ones))
        fits[update] = q[:, 0]
        gradient = curve.backward(theta, cache, loss_gradient(error, ones, only, 1))
        adam.step(theta, clip_by_norm(gradient, 10.0))
    return np.array(losses), fits


(constant, fits), (falling, _) = fit(False), fit(True)
show(
    pictures.fitted(xs, ys, fits, constant, falling),
    "Left: the network's curve before training, after 30 updates and after 600, when "
    "it lies on the wanted curve. Right: the loss on a log scale. It falls to about "
    "0.0001, with spikes if the learning rate is constant and without if it falls.",
)

# %% [markdown]
# **Why does the loss jump?** Near the minimum the gradients become small. Then √v
# becomes small, too, and Adam divides by it: the steps relative to the gradient grow.
# At some point they are too long for the steepest direction and overshoot it, further
# each time. The gradients grow with the loss, √v grows with them, and the steps become
# shorter again. A learning rate that falls to 0 ends this:

# %%
worst = {}
for name, losses in (("constant", constant), ("falling", falling)):
    worst[name] = (losses / np.minimum.accumulate(losses)).max()
    print(f"{name} learning rate: at most {worst[name]:.1f} × the best loss so far")
assert worst["constant"] > 5 and worst["falling"] < 1.5
assert max(constant[-1], falling[-1]) < 0.003

# %% [markdown]
# DQN keeps a constant learning rate all the same. Its targets move, and after a drift
# it has to learn again.

# %% [markdown]
# ## Summary
#
# Backpropagation is two lines for each layer, and you can check it by measuring. A
# network whose last layer is zero is the zero function and can still learn: boosters
# start this way. Adam moves each parameter by about its learning rate, whatever the
# loss is multiplied by. The target network averages parameters, not functions.
#
# [← 13](13_what_to_keep.ipynb) · [contents](README.md)

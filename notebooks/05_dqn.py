# %% [markdown]
# # 5 · DQN
#
# You will be able to write a DQN: its target, its loss, its target network and its
# policy; and you will have seen what each is good for on the ten rooms.
#
# *Time: 25 minutes. Needs: notebooks 1, 3. With the paper open: Eqs. 2–4, section
# Ensemble Target Networks.*
#
# **How to read this with the paper open.** Put a factor for the end of an episode into
# every target: into Eq. 4, and into lines 9 and 16 of Algorithm 1. Eqs. 2–3 have a sum;
# a mean makes the step independent of the batch's size. And one letter means two things:
# τ is the temperature of the policy, and the speed of the target network.

# %%
import numpy as np
from exercises import check, solution
from lesson import FAST, GAMMA, ROOMS, corridor, show, source, step
from pictures import dqn as pictures

from gbdqn_ref import bellman
from gbdqn_ref.config import Config
from gbdqn_ref.dqn import DQN
from gbdqn_ref.train import run

rng = np.random.default_rng(0)
q_star = corridor(goal=9).q_star()

# %% [markdown]
# GB-DQN is a sum of **DQNs** (deep Q-networks): Q-learning with a network in place of
# the table. Two things are added: a **target network**, which follows the network
# slowly, and a **replay**, which stores past steps and draws each batch from them
# (notebook 6).
#
# ## Eq. 4, second half · The target
#
# $$y_i = r_i + \gamma\,(1 - \text{terminated}_i)\,\max_{a'} \bar Q(s'_i, a') \tag{4}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $r_i$ | `r` | (B,) | reward |
# | – | `terminated` | (B,) | whether $s'_i$ is the end; the paper has no such factor (D1) |
# | $\bar Q(s'_i, \cdot)$ | `q_next` | (B, A) | the target network's answer at the next state; Eq. 4 prints $Q_{m-1}$, the section on target networks $\bar Q$ |
# | $\gamma$ | `gamma` | scalar | discount |
# | $y_i$ | result | (B,) | the target |
#
# The target bootstraps with $\bar Q$. (The statistician's bootstrap, drawing samples
# from a sample, is another thing.)
#
# **Exercise 1.** Write the target.


# %%
def td_target(r, terminated, q_next, gamma):
    """y = r + γ max_a′ Q(s′, a′); what changes at the end of an episode?"""
    ...  # yours


td_target = check("td_target", td_target)
solution("td_target")

# %%
source(bellman.td_target)

# %% [markdown]
# > **Predict.** From room 8 you step into room 9, the goal. No step ever starts there,
# > so the network has never been trained on room 9. It happens to say −50 and −60. What
# > is y with the factor, and what is y as the paper prints it?

# %% tags=["predicted"]
room, reward, end = step(8, 1, goal=9)
said = np.array([[-50.0, -60.0]])
y = td_target(np.array([reward]), np.array([end]), said, GAMMA)
printed = td_target(np.array([reward]), np.array([False]), said, GAMMA)
assert y == bellman.td_target(np.array([reward]), np.array([end]), said, GAMMA)
print("with the factor:", y[0], "  as printed:", printed[0])

# %% [markdown]
# As printed, a number that nothing ever corrects gets into Q(8, right). Here it goes no
# further, since walking for ever costs only 10: the best Q of every room becomes −10,
# and no room has a reason to go to the goal. A number above −10 would spread to all
# rooms (P4).
#
# The opposite mistake is as common. A **time limit** is not an end: if a walk is cut
# off after some steps, it could have gone on, and the target must bootstrap. The paper
# says that *done* means “the agent reached the goal state”; on Hopper, a robot on one
# leg, it means that the agent fell (R15). The package has two flags, `terminated` and
# `truncated`.
#
# > **Predict.** Every third step is the last before a cut. Treat cuts as ends. Does
# > room 0 look better than it is, or worse?

# %% tags=["predicted"]
true, Q = q_star[0].max(), np.zeros((ROOMS, 2))
for _ in range(200):  # a third of the targets is r, the others r + γ max Q
    Q = (corridor(9, gamma=0).bellman(Q) + 2 * corridor(9).bellman(Q)) / 3
print(f"room 0: {true:.2f} in truth, {Q[0].max():.2f} with cuts as ends")
assert np.allclose(Q, corridor(9, gamma=GAMMA * 2 / 3).q_star())

# %% [markdown]
# Better: a cut taken for an end is a discount that nobody set, here 0.6 in place of
# 0.9.
#
# ## Eqs. 2–3 · The loss
#
# $$L = \frac1{2B} \sum_i w_i\,\delta_i^2, \qquad \delta_i = y_i - Q(s_i, a_i), \qquad
#   \frac{\partial L}{\partial Q(s_i, a_i)} = -\frac{w_i\,\delta_i}{B} \tag{2, 3}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $y_i - Q(s_i, a_i)$ | `error` | (B,) | TD error δ |
# | $w_i$ | `weight` | (B,) | importance weight; Eq. 2 has all 1 |
# | $L$ | `weighted_loss(error, weight)` | scalar | a mean in the code, a sum in the paper (D2) |
# | $\partial L / \partial Q(s_i, \cdot)$ | `loss_gradient(error, weight, a, n_actions)` | (B, A) | 0 for other actions |
#
# **Exercise 2.** Write the gradient with respect to Q, with y held fixed.


# %%
def td_gradient(error, weight, a, n_actions):
    """∂L/∂Q (B, A), from the TD errors, weights and actions (B,)."""
    ...  # yours


td_gradient = check("td_gradient", td_gradient)
solution("td_gradient")

# %% [markdown]
# By hand: nudge Q and see how the loss moves. Then a bug that NumPy lets
# pass.
#
# > **Predict.** `error` has shape (4,). Somebody reads `weight` as a column, (4, 1).
# > NumPy multiplies them without a word. What is the shape, and what becomes of the
# > weights?

# %% tags=["predicted"]
error, weight, a = rng.normal(size=4), rng.uniform(0.2, 1, 4), np.array([0, 2, 1, 2])
gradient = td_gradient(error, weight, a, 3)
assert np.allclose(gradient, bellman.loss_gradient(error, weight, a, 3))
for i in range(4):
    loss = bellman.weighted_loss(
        error - 1e-6 * (np.arange(4) == i), weight
    )  # Q_i rises
    slope = (loss - bellman.weighted_loss(error, weight)) / 1e-6
    assert np.isclose(slope, gradient[i, a[i]], atol=1e-5)

column = weight[:, None]
wrong = 0.5 * np.mean(column * error**2)
print("shape:", (column * error**2).shape)
assert np.isclose(wrong, weight.mean() * 0.5 * np.mean(error**2))
assert np.isclose(
    wrong, 0.5 * np.mean(column[::-1] * error**2)
)  # whose is whose is lost
try:
    bellman.weighted_loss(error, column)
except AssertionError as refusal:
    print("the package refuses it:", refusal)

# %% [markdown]
# Every weight multiplied every error, and the mean averaged the weights away: no
# importance weights, and no error message.
#
# ## One update, whole

# %%
source(DQN.learn)

# %% [markdown]
# Batch, target, error, gradient, Adam, target network; finally the replay is told
# the TD errors. Adam and the network are in notebook 14, the replay in notebook 6.
#
# ## The target network
#
# $$\bar\theta \leftarrow (1 - \tau)\,\bar\theta + \tau\,\theta$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $\theta$ | `theta` | (P,) | the parameters that learn |
# | $\bar\theta$ | `theta_target` | (P,) | those of the target network |
# | $\tau$ | `tau` | scalar | 0.01 in the package, at each update (D9) |
#
# The target network is a copy that follows slowly (P1), by an average named after
# Polyak. It is there because y is made of Q: each update moves the target of the next.
# The paper hopes for “a slowly varying bootstrap target”.
#
# **Exercise 3.** Write it.


# %%
def polyak(target, online, tau):
    """The target network's new parameters, as a new array."""
    ...  # yours


polyak = check("polyak", polyak)
solution("polyak")

# %% [markdown]
# What is it good for? Take it away: with τ = 1 the copy is the network itself. We
# measure on the ten rooms, where Q* is known. The replay holds all 18 possible steps,
# so exploration plays no part. Q is first a table, plus a constant for each action that
# all rooms share; then a network whose input is the room as one number, and whose
# weights all rooms share.
#
# > **Predict.** τ = 1, 0.1, 0.01 and 0. Which is fastest on the table? Which ends
# > nearest to Q* with the network? Where does τ = 0 end?

# %% tags=["predicted"]
LIVED_IN, UPDATES, EVERY = range(9), 2500, 25  # room 9 is the end
STATES = {
    "a table": np.eye(ROOMS, dtype=np.float32),
    "a network": np.linspace(-1, 1, ROOMS, dtype=np.float32)[:, None],
}
SETTINGS = {
    "a table": dict(hidden=(), lr=0.02),
    "a network": dict(hidden=(32, 32), lr=0.01),
}


def track(world, tau, seed):
    """The largest error of Q after every 25 updates; and Q before and after."""
    config = Config(
        replay="uniform", capacity=18, gamma=GAMMA, tau=tau, **SETTINGS[world]
    )
    rooms = STATES[world]
    agent = DQN(rooms.shape[1], 2, config, np.random.default_rng(seed))
    for room, action in np.ndindex(9, 2):
        room2, reward, end = step(room, action, goal=9)
        agent.observe(rooms[room], action, reward, rooms[room2], end)
    errors, first = [], agent.q(rooms)
    for k in range(UPDATES):
        agent.learn()
        if k % EVERY == EVERY - 1:
            errors.append(np.abs(agent.q(rooms) - q_star)[LIVED_IN].max())
    return errors, first, agent.q(rooms)


seeds = range(1 if FAST else 3)
errors = {
    world: {
        tau: np.median([track(world, tau, seed)[0] for seed in seeds], axis=0)
        for tau in (1.0, 0.1, 0.01, 0.0)
    }
    for world in STATES
}
late = {}
for world, curves in errors.items():
    for tau, values in curves.items():
        late[world, tau] = values[-20:].max()
        print(
            f"{world:9} τ = {tau:4g}: error after 200 updates {values[7]:.2f}, ", end=""
        )
        print(f"at worst in the last 500 {late[world, tau]:.3f}")
assert errors["a table"][1.0][7] < errors["a table"][0.01][7] / 2
assert late["a network", 1.0] > 3 * late["a network", 0.01]

show(
    pictures.target_networks(errors, EVERY),
    alt="Largest error over updates for four τ. On the table τ = 1 falls first. With "
    "a network τ = 1 stays near 1 and jitters; τ = 0.01 falls late, and far below "
    "it.",
)

# %% [markdown]
# On the table τ = 0.01 only costs time, and τ = 0.1 is almost as fast as no target
# network. With the network, τ = 1 moves the targets of all rooms at each update: Q
# jitters far from Q*. With τ = 0.01 it arrives late, and much nearer. So τ trades speed
# for calm. What is best depends on the task; 0.1 has both here.
#
# With τ = 0 the target never moves. Q ends one step ahead of the copy that it started
# with, and stays there, however long it learns:

# %%
_, first, last = track("a table", 0.0, seed=0)
first[9] = 0  # the end
assert np.allclose(last[LIVED_IN], corridor(9).bellman(first)[LIVED_IN], atol=0.01)

# %% [markdown]
# Remember it: under Algorithm 1 to the letter a booster's target never moves either
# (notebook 7).
#
# ## From values to actions
#
# $$\pi(a|s) = \frac{e^{Q(s, a)/\tau}}{\sum_{a'} e^{Q(s, a')/\tau}}$$
#
# | paper | code | what it is |
# |---|---|---|
# | $\tau$ | `temperature` | the **temperature**; not the τ of the target network |
# | π | `softmax_policy(q, temperature)` | the **softmax** policy: probabilities of the actions, (A,) |
# | – | `epsilon_greedy(q, epsilon, rng)` | what the experiments use instead (D10, X13) |

# %%
q = np.array([1.0, 1.5, 0.0])
weights = np.array([np.exp(value / 0.5) for value in q])
assert np.allclose(weights / weights.sum(), bellman.softmax_policy(q, 0.5))
assert np.isfinite(bellman.softmax_policy(1000 * q, 0.5)).all()  # e^3000 would overflow

for _ in range(1000):  # it gives away at most τ ln |A| of the best value
    q, temperature = rng.normal(size=4), rng.uniform(0.05, 3)
    policy = bellman.softmax_policy(q, temperature)
    assert policy @ q >= q.max() - temperature * np.log(4) - 1e-9

# %% [markdown]
# The package subtracts the largest Q first, which changes nothing but the overflow
# (M16).
#
# > **Predict.** Multiply every reward by 10. Which of the two explores differently?

# %% tags=["predicted"]
gaps = np.linspace(0, 3, 100)
softmax = {
    temperature: [
        bellman.softmax_policy(np.array([0, gap]), temperature)[1] for gap in gaps
    ]
    for temperature in (0.1, 1.0, 10.0)
}
greedy = np.where(
    gaps > 0, 0.95, 0.5
)  # ε = 0.1, and half of the random actions are good
assert np.isclose(
    bellman.softmax_policy(np.array([0.0, 2.0]), 1.0)[1],
    bellman.softmax_policy(np.array([0.0, 20.0]), 10.0)[1],
)

show(
    pictures.explorers(gaps, softmax, greedy),
    alt="How often the better of two actions is taken. ε-greedy jumps to 95 % at "
    "once; softmax rises with the gap, steeply at a low temperature.",
)

# %% [markdown]
# Softmax does. ε-greedy asks only which Q is larger; for softmax ten times the reward
# is a tenth of the temperature.
#
# ## On CartPole
#
# The same class with two hidden layers keeps a pole upright, for 500 steps at most. Two
# runs without a target network, and two with τ = 0.01.
#
# > **Predict.** Which runs are better? Do they keep what they learn?

# %% tags=["predicted"]
episodes, seeds = (12, [0]) if FAST else (220, [0, 1])
returns = {1.0: [], 0.01: []}
for tau, seed in [(tau, seed) for tau in returns for seed in seeds]:
    settings = dict(agent="dqn", seed=seed, episodes=episodes, schedule=[], tau=tau)
    records = run(Config.preset("cartpole", "fast", **settings))
    returns[tau].append([record["return"] for record in records])

for tau, runs in returns.items():
    for seed, totals in zip(seeds, runs, strict=True):
        means = np.convolve(totals, np.full(10, 0.1), "valid")
        print(
            f"τ = {tau:4g}, seed {seed}: at best {means.max():3.0f},",
            f"at the end {means[-1]:3.0f}",
        )

show(
    pictures.cartpole(returns),
    alt="Returns of DQN on CartPole over episodes, two runs without and two with a "
    "target network: all rise far above the start, and all go up and down.",
)

# %% [markdown]
# The plot of the return over the episodes is called a **learning curve**. All four runs
# learn. In the printed output those without a target network rise higher; two runs of
# each do not show why. None of them climbs steadily. A curve may end at its peak or far
# below it, and on another machine the same seed draws another curve. So one run says
# nothing about *keeping* what was learnt; notebook 12 counts it over many.

# %% [markdown]
# ## Summary
#
# The target is r at the end of an episode and bootstraps everywhere else, a time limit
# included. The loss is a mean over the batch, of the errors at the actions taken, with
# arrays of one shape. A target network trades speed for calm: it slows a table down,
# calms a network, and with τ = 0 stops learning after one step ahead. Softmax depends
# on the size of Q, ε-greedy does not.
#
# [← 4](04_boosting.ipynb) · [contents](README.md) · [6 →](06_replay.ipynb)

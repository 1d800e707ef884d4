# %% [markdown]
# # 3 · DQN: targets, terminal states, and how a value becomes an action
#
# **Eqs. 2–4, the softmax policy, the target network.** GB-DQN is DQN with more than one network; its first learner *is* a DQN.
# After this notebook you can write one, you know the two bugs that most such programs once had, and you have seen it
# reach the exact $Q^*$ of a small world.
#
# *Before:* notebooks 1 (Q*) and 2 (the network). *Time:* a quarter of an hour.

# %%
import numpy as np
from lesson import BLUE, FAST, GREEN, ORANGE, VERMILLION, plt, source

from gbdqn_ref import bellman
from gbdqn_ref.config import Config
from gbdqn_ref.dqn import DQN
from gbdqn_ref.stats import trailing_mean
from gbdqn_ref.tabular import MDP
from gbdqn_ref.train import run

rng = np.random.default_rng(0)

# %% [markdown]
# ## The target of Eq. 4 · What Q should have been
#
# $$y_i = r_i + \gamma\,(1 - \text{terminated}_i)\,\max_{a'} \bar Q(s'_i, a') \tag{4, first half}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $r_i$ | `r` | (B,) | reward |
# | – | `terminated` | (B,) | whether $s'_i$ is the end; the paper has no such factor (D1) |
# | $\bar Q(s'_i, \cdot)$ | `q_next` | (B, A) | the target network at the next state |
# | $\gamma$ | `gamma` | scalar | discount |
# | $y_i$ | result | (B,) | the regression target |

# %%
source(bellman.td_target)

# %%
r, terminated = np.array([-1.0, -1.0, 0.0]), np.array([False, True, False])
q_next, gamma = rng.normal(size=(3, 2)), 0.99

y = np.zeros(3)
for i in range(3):
    y[i] = r[i]
    if not terminated[i]:
        y[i] += gamma * max(q_next[i])

assert np.allclose(y, bellman.td_target(r, terminated, q_next, gamma))

# %% [markdown]
# ### The first classic bug: what comes after the end
#
# > **Predict, then run.** The last step of an episode costs 1. The network, which was never trained on a terminal state,
# > happens to say −50 and −60 there. What is the value of that last step with the factor, and without?

# %%
last, said = np.array([-1.0]), np.array([[-50.0, -60.0]])
print("with the factor:", bellman.td_target(last, np.array([True]), said, 0.99)[0])
print("as printed:     ", bellman.td_target(last, np.array([False]), said, 0.99)[0])

# %% [markdown]
# A value that nothing ever corrects leaks into everything before it (claim P4). The mirror image of the bug: a **time limit** is
# no end. When Gymnasium cuts MountainCar off after 200 steps (`truncated`), the car could have driven on, and the target
# must bootstrap. This is why the code never has a single flag for both. The paper says that *done* means "the goal was
# reached"; on CartPole and Hopper it means that the agent fell (claim R15).
#
# **Exercise 1.** One state loops on itself with reward −1, γ = 0.9, and the episode is cut off after every third step. Iterate
# $Q \leftarrow$ mean target of the three transitions, once treating the cut as an end and once not. Which of the two is
# $Q^* = -1/(1 - \gamma)$?

# %% tags=["solution"] jupyter={"source_hidden": true}
answers = {}
for name, cut in (("an end", True), ("no end", False)):
    Q = 0.0
    for _ in range(300):
        ends = np.array([False, False, cut])
        Q = bellman.td_target(np.full(3, -1.0), ends, np.full((3, 1), Q), 0.9).mean()
    answers[name] = round(float(Q), 6)
assert (
    answers["no end"] == -10 and answers["an end"] == -2.5
)  # −1 / (1 − ⅔ · 0.9): it looks four times as good as it is
answers

# %% [markdown]
# ## Eqs. 2–3 · The loss
#
# $$L = \tfrac12 \sum_i (y_i - Q(s_i, a_i))^2 \tag{2}$$
# $$L_w = \tfrac12 \sum_i w_i\,(y_i - Q(s_i, a_i))^2 \tag{3}$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $y_i - Q(s_i, a_i)$ | `error` | (B,) | TD error δ |
# | $w_i$ | `weight` | (B,) | importance weight (notebook 5); Eq. 2 has all 1 |
# | $L$ | `weighted_loss(error, weight)` | scalar | as a mean over the batch (D2) |
# | $\partial L / \partial Q(s_i, \cdot)$ | `loss_gradient(error, weight, a, n_actions)` | (B, A) | only the action that was taken |

# %%
source(bellman.weighted_loss, bellman.loss_gradient)

# %%
error, weight, a = rng.normal(size=4), rng.uniform(0.2, 1, 4), np.array([0, 2, 1, 2])

loss, dq = 0.0, np.zeros((4, 3))
for i in range(4):
    loss += 0.5 * weight[i] * error[i] ** 2 / 4
    dq[i, a[i]] = -weight[i] * error[i] / 4

assert np.isclose(loss, bellman.weighted_loss(error, weight))
assert np.allclose(dq, bellman.loss_gradient(error, weight, a, 3))

# %% [markdown]
# ### The second classic bug: (B, 1) where (B,) is meant
#
# > **Predict, then run.** `error` has shape (4,). Somebody reads `weight` as a column, shape (4, 1). NumPy multiplies them
# > without a word. What is the shape of the product, and what has become of the weights?

# %%
column = weight[:, None]
wrong = 0.5 * np.mean(column * error**2)
print("shape of column * error²:", (column * error**2).shape)
print(
    "the loss:",
    round(wrong, 4),
    " mean weight × mean loss:",
    round(weight.mean() * 0.5 * np.mean(error**2), 4),
)
assert np.isclose(wrong, weight.mean() * 0.5 * np.mean(error**2))
permuted = weight[[3, 2, 1, 0]]
assert np.isclose(
    0.5 * np.mean(permuted[:, None] * error**2), wrong
)  # whose weight is whose no longer matters
assert not np.isclose(bellman.weighted_loss(error, permuted), bellman.weighted_loss(error, weight))

# %% [markdown]
# Every weight met every error, and the mean took all of it apart again: prioritized replay without its correction, and nothing
# looks wrong. The package's functions refuse it, in one line:

# %%
try:
    bellman.weighted_loss(error, column)
except AssertionError as refusal:
    print("refused:", refusal)

# %% [markdown]
# ## From values to actions
#
# $$\pi(a|s) = \frac{e^{Q(s, a)/\tau}}{\sum_{a'} e^{Q(s, a')/\tau}}$$
#
# | paper | code | what it is |
# |---|---|---|
# | $\tau$ | `temperature` | not the τ of the target network |
# | π | `softmax_policy(q, temperature)` | a distribution over actions, (A,) |
# | – | `epsilon_greedy(q, epsilon, rng)` | what the experiments use instead (D10, claim X13) |

# %%
source(bellman.softmax_policy, bellman.epsilon_schedule, bellman.epsilon_greedy)

# %%
q = np.array([1.0, 1.5, 0.0])
weights = []
for value in q:
    weights.append(np.exp(value / 0.5))
assert np.allclose(np.array(weights) / sum(weights), bellman.softmax_policy(q, 0.5))

# %% [markdown]
# Written like this loop, $e^{1000}$ overflows; the package subtracts the largest value first, which changes nothing
# (claim M16). How differently the two policies explore is a matter of *scale*: ε-greedy does not care how large Q is, softmax
# cares about nothing else.

# %%
gaps = np.linspace(0, 3, 200)
for temperature, colour, line in ((0.1, BLUE, "-"), (1.0, VERMILLION, "--"), (10.0, GREEN, "-.")):
    better = [bellman.softmax_policy(np.array([0.0, gap]), temperature)[1] for gap in gaps]
    plt.plot(gaps, better, line, color=colour, label=f"softmax, τ = {temperature:g}")
plt.plot(
    gaps, np.where(gaps > 0, 0.95, 0.5), ":", color=ORANGE, linewidth=2.5, label="ε-greedy, ε = 0.1"
)
plt.gca().set(
    xlabel="Q of the better action minus Q of the other",
    ylabel="probability of the better action",
    title="Two actions: ε-greedy sees who is ahead, softmax by how much",
)
plt.legend()
plt.show()

# %% [markdown]
# **Exercise 2.** The softmax policy gives away at most $\tau \ln |A|$ of the best value. Check it on a thousand random Q with
# four actions.

# %% tags=["solution"] jupyter={"source_hidden": true}
for _ in range(1000):
    q, temperature = rng.normal(size=4), rng.uniform(0.05, 3)
    policy = bellman.softmax_policy(q, temperature)
    assert policy @ q >= q.max() - temperature * np.log(4) - 1e-9

# %% [markdown]
# ## One update, whole
#
# Batch, target, error, gradient, Adam, target network, priorities. Everything in it you know by now, or will after
# notebook 5.

# %%
source(DQN.learn)

# %% [markdown]
# The **target network** $\bar\theta \leftarrow (1 - \tau)\bar\theta + \tau\theta$ follows at a distance (claim P1). It is
# there because $y$ is made of Q itself: without it, each update would move its own goal.
#
# Does the whole machine find $Q^*$? A network without hidden layers on one-hot states is a *table*, so that on a finite MDP
# there is an exact answer to compare with: three states, two actions, deterministic.

# %%
STATES, ACTIONS = 3, 2
next_state = np.array([[1, 2], [2, 0], [0, 1]])
rewards = np.array([[0.0, 1.0], [0.5, 0.0], [-1.0, 0.2]])
mdp = MDP(np.eye(STATES)[next_state], rewards, 0.8)

config = Config(agent="dqn", replay="uniform", hidden=(), capacity=6, lr=0.02, tau=0.1, gamma=0.8)
agent = DQN(STATES, ACTIONS, config, np.random.default_rng(0))
one_hot = np.eye(STATES, dtype=np.float32)
for s, a in np.ndindex(STATES, ACTIONS):
    agent.observe(one_hot[s], a, rewards[s, a], one_hot[next_state[s, a]], False)

errors = []
for _ in range(2000):
    agent.learn()
    errors.append(np.abs(agent.q(one_hot) - mdp.q_star()).max())

plt.semilogy(errors, color=BLUE)
plt.gca().set(
    xlabel="update",
    ylabel="largest error, log scale",
    title="DQN on a table: it finds the exact Q*",
)
plt.show()
assert errors[-1] < 0.01
print("DQN:\n", agent.q(one_hot).round(3), "\nvalue iteration:\n", mdp.q_star().round(3))

# %% [markdown]
# **Exercise 3.** Set τ = 0, so that the target network never moves. To what does the table converge now? (One backup of the
# initial values: $\mathcal T \bar Q$. Remember it; notebook 6 is about an algorithm that does just this.)

# %% tags=["solution"] jupyter={"source_hidden": true}
config = Config(agent="dqn", replay="uniform", hidden=(), capacity=6, lr=0.02, tau=0.0, gamma=0.8)
still = DQN(STATES, ACTIONS, config, np.random.default_rng(0))
start = still.q(one_hot)
for s, a in np.ndindex(STATES, ACTIONS):
    still.observe(one_hot[s], a, rewards[s, a], one_hot[next_state[s, a]], False)
for _ in range(2000):
    still.learn()
assert np.allclose(still.q(one_hot), mdp.bellman(start), atol=0.01)
assert np.abs(still.q(one_hot) - mdp.q_star()).max() > 0.3

# %% [markdown]
# ## On CartPole
#
# The same class with two hidden layers, and a loop around it. A run is a generator of episodes.

# %%
source(run)

# %%
settings = dict(episodes=20, schedule=[]) if FAST else dict(episodes=220, schedule=[])
config = Config.preset("cartpole", "fast", agent="dqn", seed=0, **settings)
returns = np.array([episode["return"] for episode in run(config)])

plt.plot(returns, ".", color=BLUE, alpha=0.4, markersize=4)
plt.plot(np.arange(9, len(returns)), trailing_mean(returns, 10), color=BLUE)
plt.gca().set(
    xlabel="episode",
    ylabel="return (500 is the most)",
    title="One run of DQN on CartPole, without any drift",
)
plt.show()

# %% [markdown]
# It learns; and it does not keep what it learnt, as one run of many would show you too (the README has a table). When the
# physics change below it, DQN does nothing special: it goes on. GB-DQN does something, and that is notebook 4.
#
# ## What to take along
#
# | | as printed | in truth |
# |---|---|---|
# | Eq. 4 | $y = r + \gamma \max \bar Q(s', \cdot)$ for every transition | not where $s'$ is the end: there $y = r$ (D1) |
# | Eqs. 2–3 | a sum | a mean, or the step depends on the batch's size (D2) |
# | policy | softmax in the text and in Algorithm 1, ε-greedy in the experiments | two different explorers; the code has both (D10) |
#
# **Next:** notebook 4.

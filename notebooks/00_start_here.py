# %% [markdown]
# # 0 · Start here: the whole idea on one plane
#
# The paper beside which these notebooks are read is *GB-DQN: Gradient Boosted DQN Models for Non-stationary
# Reinforcement Learning* (arXiv 2512.17034). Its question: an agent has learnt to act in a world, and then the world
# changes. What should it do with what it knows?
#
# Its answer, in one line: **keep it, freeze it, and train one new network on what it now gets wrong.**
#
# $$Q_m \;=\; \underbrace{\alpha_1 h_1 + \dots + \alpha_{m-1} h_{m-1}}_{Q_{m-1},\ \text{frozen}} \;+\;
#   \underbrace{\alpha_m h_m}_{\text{learns}}$$
#
# This notebook shows it once, on a world whose states are a plane, so that a Q-function is a picture. *Time:* five
# minutes. Nothing is proved here; the last cell says where everything is.

# %%
import numpy as np
from lesson import BLUE, FAST, VERMILLION, plt

from gbdqn_ref import drift, plots, watch
from gbdqn_ref.config import Config
from gbdqn_ref.stats import trailing_mean
from gbdqn_ref.train import make_agent, run

# %% [markdown]
# ## The world, and how it changes
#
# MountainCar: a car in a valley, too weak to drive straight up. Its state is two numbers, position and velocity; its
# actions are push left, coast, push right; every step costs 1 until it reaches the flag at position 0.5, or 200 steps
# are over. After 300 episodes **gravity grows by half**. The engine stays as it is.

# %%
DRIFT = 30 if FAST else 300  # in tests the runs are short, and the pictures not worth looking at
config = Config.preset(
    "mountaincar",
    "fast",
    episodes=3 * DRIFT // 2,
    schedule=[{"episode": DRIFT, "gravity": 1.5}],
    seed=0,
)
agent = make_agent(config)
records = list(run(config, agent))

returns = np.array([record["return"] for record in records])
plt.plot(returns, ".", color=BLUE, alpha=0.3, markersize=4)
plt.plot(np.arange(14, len(returns)), trailing_mean(returns, 15), color=BLUE)
plt.axvline(DRIFT, color="0.25", linestyle="--")
plt.gca().set(
    xlabel="episode",
    ylabel="return",
    title="One run of GB-DQN; at the dashed line gravity grows by half",
)
plt.show()

# %% [markdown]
# A return of −200 means that the car never arrived. First it learns to swing itself up; then the hill becomes harder.
#
# ## What it knows, before and after
#
# Until the drift GB-DQN is an ordinary DQN with one network, $Q_1 = \alpha_1 h_1$. At the drift that network is frozen, and a
# second one, $h_2$, starts as the zero function and learns the *residual*: the difference between what $Q$ should now
# be, $y = r + \gamma \max_{a'} Q(s', a')$, and what it is. All three as maps over the plane:

# %%
stages = agent.staged_q(watch.plane(31 if FAST else 61))
figure = plots.value_maps(stages[0], stages[-1], m=2)
figure.set_dpi(80)
figure

# %% [markdown]
# **How to read it.** Above, left: $\max_a Q_1$, minus the number of steps that the car thinks it still needs (discounted).
# The dark spiral is where it must first drive *away* from the flag. Above, middle: what the booster added. It is not
# zero far from the drift's cause, since a heavier world is heavier everywhere; and it is large where the frozen network
# was wrong already, because a residual does not say *why* it is there. Below: the actions. Most stay; at the black cells
# the booster changed the agent's mind.
#
# > **Predict, then run.** The old network, without the booster, drives in the new world. Does it still arrive?


# %%
def drive(q, gravity, seed):
    """The states (steps, 2) of one greedy episode."""
    env = drift.make("mountaincar", [{"episode": 0, "gravity": gravity}])
    s, _ = env.reset(seed=seed, options={"episode": 0})
    states, ends = [s], False
    while not ends:
        s, _, terminated, truncated, _ = env.step(int(q(s[None])[0].argmax()))
        states, ends = [*states, s], terminated or truncated
    return np.array(states)


def first(x):
    """Q_1, the network that was frozen at the drift."""
    return agent.staged_q(x)[0]


figure, axes = plt.subplots(1, 3, sharex=True, sharey=True, figsize=(9, 3.2))
rides = (
    ("$Q_1$, old world", first, 1.0),
    ("$Q_1$, new world", first, 1.5),
    ("$Q_2$, new world", agent.q, 1.5),
)
for panel, (title, q, gravity) in zip(axes, rides, strict=True):
    paths = sorted((drive(q, gravity, seed) for seed in range(3 if FAST else 21)), key=len)
    position, velocity = paths[len(paths) // 2].T
    panel.plot(
        position,
        velocity,
        ".-",
        color=BLUE if gravity == 1 else VERMILLION,
        markersize=3,
        linewidth=0.8,
    )
    panel.axvline(0.5, color="0.5", linestyle=":")
    arrived = sum(path[-1, 0] >= 0.5 for path in paths)
    panel.set_title(
        f"{title}: {arrived} of {len(paths)} arrive,\nmean {np.mean([len(p) - 1 for p in paths]):.0f} steps"
    )
    panel.set_xlabel("position")
axes[0].set_ylabel("velocity, per step")
plt.show()

# %% [markdown]
# Drawn is the ride of median length. Each turn of the spiral is one swing through the valley; the dotted line is the flag.
# In the heavier world the old policy takes longer than in the old one, and the agent with its booster swings differently.
# This is one run. Whether boosting is *better* than going on with one network is a question for many runs and honest
# controls: notebook 8.
#
# ## What is true of it
#
# The paper states four theorems and three tables of results. We made each statement a test that decides it
# ([`paper_checks`](../paper_checks/README.md)). In short:
#
# | the paper says | what comes out | where |
# |---|---|---|
# | Theorem 1: each booster strictly lowers the squared Bellman residual | true of a *frozen* target, by exactly A²/B; the Bellman residual itself can rise, since its target moves with Q | notebooks 4, 7 |
# | Theorem 2: the Bellman error falls to 0 | a strict fall may stop anywhere; with exact fits and data on every pair it does go to 0, though not monotonically | 7 |
# | Theorem 3: the mixed priority samples in proportion to error × recency | no: a sum is not a product, for whatever mixing coefficient | 5, 7 |
# | Theorem 4: it adapts after a drift | the proof's stability bound holds for *any* update; adaptation needs data on every pair and small errors everywhere | 7 |
# | Algorithm 1 adapts with one booster per drift | to the letter, one booster is one Bellman backup; with a target that includes the learner it does reach the new Q* | 6 |
# | the experiments show the advantage | five runs cannot tell the methods apart; where runs can, the replay is what helps, and boosting is not | 8 |
#
# ## The map
#
# | notebook | the paper | you will be able to |
# |---|---|---|
# | [1 · Drift](01_drift.ipynb) | introduction, drift | say what a change of physics does to Q, and measure adaptation |
# | [2 · The network](02_network.ipynb) | $h_m(s, a; \theta)$ | write backprop and Adam by hand |
# | [3 · DQN](03_dqn.ipynb) | Eqs. 2–4 | build targets that are right at terminal states |
# | [4 · Boosting](04_boosting.ipynb) | Eqs. 1–9 | fit, weigh and fold in a booster |
# | [5 · The replay](05_replay.ipynb) | Eqs. 10–11 | sample by error and recency, exactly, and correct for it |
# | [6 · Algorithm 1](06_algorithm.ipynb) | Algorithm 1 | read it line by line, in all its readings |
# | [7 · The theorems](07_theorems.ipynb) | Theorems 1–4 | say which hold, and break the others |
# | [8 · The experiments](08_experiments.ipynb) | the tables | judge what the numbers can carry |
#
# Each equation is met in the same way: as printed, in symbols, as the package's own source, once more in a naive loop,
# by an assertion that both agree, and in a picture or a number done by hand. Solutions to the exercises are folded, and
# they are executed with everything else, so none of them can be wrong.

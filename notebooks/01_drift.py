# %% [markdown]
# # 1 · Drift, and what it does to Q
#
# The world changes, and what was learnt of it does not. After this notebook you can say exactly how far a change of
# physics moves $Q^*$, why one drift leaves a trace in the TD errors and another none, why value and policy are two things, and
# how adaptation is measured in the experiments.
#
# *Before:* notebook 0. *Needs:* maximum, expectation, geometric series. *Time:* a quarter of an hour.

# %%
import numpy as np
from lesson import BLUE, FAST, GREEN, VERMILLION, plt, source

from gbdqn_ref import drift, physics, stats
from gbdqn_ref.tabular import MDP

rng = np.random.default_rng(0)

# %% [markdown]
# ## Q* where it can be computed
#
# In a world with finitely many states the best values are exact. The **Bellman operator** makes of any Q the Q that is one
# step wiser, and $Q^*$ is the one that it leaves alone:
#
# $$(\mathcal T^* Q)(s, a) = r(s, a) + \gamma \sum_{s'} P(s'|s, a) \max_{a'} Q(s', a'), \qquad \mathcal T^* Q^* = Q^* .$$
#
# | paper | code | shape | what it is |
# |---|---|---|---|
# | $P(s' \mid s, a)$ | `mdp.P` | (S, A, S) | where the world leads |
# | $r(s, a)$ | `mdp.r` | (S, A) | expected reward |
# | $\mathcal T^* Q$ | `mdp.bellman(Q)` | (S, A) | one backup |
# | $\mathcal T^* Q - Q$ | `mdp.residual(Q)` | (S, A) | the Bellman residual: what is left to learn |

# %%
source(MDP)

# %%
mdp = MDP(rng.dirichlet(np.ones(4), size=(4, 2)), rng.normal(size=(4, 2)), gamma=0.9)
Q = rng.normal(size=(4, 2))

naive = np.zeros((4, 2))
for s, a in np.ndindex(4, 2):
    naive[s, a] = mdp.r[s, a]
    for s2 in range(4):
        naive[s, a] += 0.9 * mdp.P[s, a, s2] * max(Q[s2])

assert np.allclose(naive, mdp.bellman(Q))
assert np.allclose(mdp.residual(mdp.q_star()), 0, atol=1e-9)

# %% [markdown]
# Each backup brings every Q nearer to $Q^*$: the largest error shrinks by γ at least, since $\max$ and averages never stretch
# a distance. At γ = 0.99, which the paper uses, that is slow:

# %%
for gamma, colour, line in ((0.9, BLUE, "-"), (0.99, VERMILLION, "--")):
    loop = MDP(
        np.ones((1, 1, 1)), np.ones((1, 1)), gamma
    )  # one state, reward 1 for ever: Q* = 1 / (1 − γ)
    Q, errors = np.zeros((1, 1)), []
    for _ in range(300):
        errors.append((loop.q_star() - Q).max() * (1 - gamma))
        Q = loop.bellman(Q)
    plt.plot(errors, line, color=colour, label=f"γ = {gamma}")
plt.gca().set(
    xlabel="backups",
    ylabel="error, as part of Q*",
    title="How many backups a change of reward takes",
)
plt.legend()
plt.show()
assert np.isclose(errors[69], 0.5, atol=0.01)

# %% [markdown]
# Remember the 69 backups to halve an error at γ = 0.99. In notebook 6 one booster will turn out to be one backup.
#
# ## A drift, and where it shows
#
# One state, two actions, both stay in it. The rewards were (0, 0); now they are (0, 1). Whoever knew the old world has
# $Q^*_{old} = (0, 0)$.

# %%
P = np.ones((1, 2, 1))
old, new = MDP(P, np.array([[0.0, 0.0]]), 0.9), MDP(P, np.array([[0.0, 1.0]]), 0.9)
print("Q* old  ", old.q_star()[0].round(6))
print("Q* new  ", new.q_star()[0].round(6))
print("residual", new.residual(old.q_star())[0])

# %% [markdown]
# $Q^*$ moved by 9 and 10. The residual is 0 and 1: it shows *where* something changed, and of how much only a tenth.
#
# > **Predict, then run.** The paper says that drift always gives a positive TD error. Find a change of the world, with one state
# > and one action, that leaves none. (The episode may end.)

# %%
loops_for_ever = MDP(
    np.array([[[1.0, 0.0]], [[0.0, 1.0]]]), np.array([[1.0], [0.0]]), 0.5
)  # state 1 is the end
ends_at_once = MDP(np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), np.array([[2.0], [0.0]]), 0.5)
unnoticed = ends_at_once.residual(loops_for_ever.q_star())[0, 0]
print("Q* of r = 1 for ever:     ", loops_for_ever.q_star()[0, 0].round(6))
print("Q* of r = 2 and the end:  ", ends_at_once.q_star()[0, 0].round(6))
print("residual after the change:", unnoticed.round(6))
assert np.isclose(unnoticed, 0)

# %% [markdown]
# Reward 1 for ever at γ = ½ is worth 2, and so is reward 2 once: another world, and nothing to notice (claim C1). A drift can
# also make δ *negative*, or lower an error that was there. What does hold is a bound in both directions (claim C2): for
# $Q = Q^*_{old}$ and with data on every pair,
#
# $$(1 - \gamma)\,\|\Delta Q^*\|_\infty \;\le\; \|\mathcal T_{new} Q^*_{old} - Q^*_{old}\|_\infty \;\le\; (1 + \gamma)\,\|\Delta Q^*\|_\infty .$$
#
# The proof is one line each way: $\mathcal T_{new} Q^*_{old} - Q^*_{old} = (\mathcal T_{new} Q^*_{old} - \mathcal T_{new} Q^*_{new}) +
# (Q^*_{new} - Q^*_{old})$, and the first bracket is at most γ times the second. Seen, on 300 pairs of random worlds:


# %%
def world(gamma):
    return MDP(rng.dirichlet(np.ones(3), size=(3, 2)), rng.normal(size=(3, 2)), gamma)


moved, seen = [], []
for _ in range(60 if FAST else 300):
    before, after = world(0.9), world(0.9)
    moved.append(np.abs(after.q_star() - before.q_star()).max())
    seen.append(np.abs(after.residual(before.q_star())).max())
moved, seen = np.array(moved), np.array(seen)

plt.plot(moved, seen, ".", color=BLUE, alpha=0.5)
reach = np.array([0, moved.max()])
plt.plot(reach, 0.1 * reach, "--", color=VERMILLION, label="(1 − γ) ‖ΔQ*‖")
plt.plot(reach, 1.9 * reach, "-.", color=GREEN, label="(1 + γ) ‖ΔQ*‖")
plt.gca().set(
    xlabel="how far Q* moved, ‖ΔQ*‖", ylabel="largest residual", ylim=(0, 1.1 * seen.max())
)
plt.title("Each dot a drift, γ = 0.9: the residual tells how far Q* moved, within a factor")
plt.legend()
plt.show()
assert (seen >= 0.1 * moved - 1e-9).all() and (seen <= 1.9 * moved + 1e-9).all()

# %% [markdown]
# **Exercise 1.** The lower bound is reached when the reward changes by the same amount everywhere. Show it: add 1 to every
# reward of a random world and compare both sides.

# %% tags=["solution"] jupyter={"source_hidden": true}
before = world(0.9)
after = MDP(before.P, before.r + 1, 0.9)
change = np.abs(after.q_star() - before.q_star()).max()
assert np.isclose(change, 10) and np.isclose(
    np.abs(after.residual(before.q_star())).max(), (1 - 0.9) * change
)

# %% [markdown]
# ## Value and policy are two things
#
# That exercise moved Q by 10, and no action: what is added everywhere is no reason to act differently. The other extreme is
# a corridor whose goal moves to the other end. Ten rooms, left and right, −1 for each step, and the goal is an end with
# reward 0.


# %%
def corridor(goal):
    P = np.zeros((10, 2, 10))
    for room in range(10):
        P[room, 0, max(room - 1, 0)] = P[room, 1, min(room + 1, 9)] = 1
    P[goal] = np.eye(10)[goal]
    return MDP(P, np.where(np.arange(10)[:, None] == goal, 0.0, -1.0) * np.ones((10, 2)), 0.9)


right, left = corridor(9), corridor(0)
shifted = MDP(
    right.P, right.r - 1 * (np.arange(10)[:, None] != 9), 0.9
)  # every step costs twice as much
figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), sharey=True)
for panel, changed, title in (
    (axes[0], shifted, "every step costs 2: all values, no action"),
    (axes[1], left, "the goal moves to room 0"),
):
    panel.plot(right.q_star().max(1), "o-", color=BLUE, label="V* before")
    panel.plot(changed.q_star().max(1), "s--", color=VERMILLION, label="V* after")
    flips = (right.q_star()[1:9].argmax(1) != changed.q_star()[1:9].argmax(1)).sum()
    panel.set(xlabel="room", title=f"{title}:\n{flips} of 8 actions change")
axes[0].set_ylabel("value, in steps' cost")
axes[0].legend()
plt.show()

# %% [markdown]
# Both are "drift". On the left a frozen policy loses nothing, and a method that adapts quickly has nothing to show for it. Keep
# this picture: on Acrobot, gravity and mass × 1.5 turn out to be drifts of the left kind (notebook 8).
#
# **Exercise 2.** At $Q = Q^*$ of the first world, in which rooms does the residual show that the goal has moved? Explain why so few.

# %% tags=["solution"] jupyter={"source_hidden": true}
residual = left.residual(right.q_star())
rooms = np.flatnonzero(np.abs(residual).max(1) > 1e-9)
assert list(rooms) == [
    0,
    9,
]  # a residual looks one step ahead: only at the two goals is anything different
rooms

# %% [markdown]
# ## The same on CartPole
#
# In the experiments the physics drift: gravity, masses, lengths, forces, by factors on the stock constants, between two
# episodes, as a schedule says.

# %%
schedule = [{"episode": 2, "length": 2.0}, {"episode": 3, "reset": True}]
env = drift.make("cartpole", schedule)
for episode in range(4):
    _, info = env.reset(seed=episode)
    print(
        f"episode {episode}: regime {info['regime']}, event {info['event']}, length {env.unwrapped.length:g} m (half)"
    )

# %% [markdown]
# Changing a constant is easy to get wrong. CartPole's step uses `total_mass` and `polemass_length`, which are computed once
# when the environment is made: whoever sets `length` alone changes a pole that is half new. The setter keeps them together:

# %%
source(physics.set_cartpole)

# %%
env.unwrapped.reset()
physics.set_cartpole(env.unwrapped, length=2.0, pole_mass=3.0)
assert np.isclose(env.unwrapped.polemass_length, env.unwrapped.masspole * env.unwrapped.length)
assert np.isclose(env.unwrapped.total_mass, env.unwrapped.masspole + env.unwrapped.masscart)

# %% [markdown]
# > **Predict, then run.** A simple controller balances the stock pole: push to the side to which the pole falls, angle plus half
# > its speed, with a small pull to the middle. It does not learn. Which changes hurt it: a pole twice as long, or a tenth as
# > long? Gravity times three, or ten? A push of a tenth of the force? A push to the other side?


# %%
def balance(schedule, episodes=5 if FAST else 20):
    """Mean steps that the controller keeps the pole up, in the regime of episode 0."""
    env, lengths = drift.make("cartpole", schedule), []
    for seed in range(episodes):
        s, _ = env.reset(seed=seed, options={"episode": 0})
        steps, ends = 0, False
        while not ends:
            position, speed, angle, turn = s
            s, _, terminated, truncated, _ = env.step(
                int(angle + 0.5 * turn + 0.02 * position + 0.05 * speed > 0)
            )
            steps, ends = steps + 1, terminated or truncated
        lengths.append(steps)
    return np.mean(lengths)


changes = [
    {},
    {"length": 2.0},
    {"length": 0.1},
    {"gravity": 3.0},
    {"gravity": 10.0},
    {"force": 0.1},
    {"force": -1.0},
]
names = [
    " ".join(f"{name} × {factor:g}" for name, factor in change.items()) or "stock"
    for change in changes
]
kept = [balance([{"episode": 0} | change] if change else []) for change in changes]
bars = plt.barh(names, kept, color=[BLUE if steps > 450 else VERMILLION for steps in kept])
plt.bar_label(bars, [f"{steps:.0f}" for steps in kept], padding=3)
plt.gca().invert_yaxis()
plt.gca().set(xlabel="steps kept up (500 is the most)", xlim=(0, 550))
plt.title("The same policy in other physics: some changes cost it everything, some nothing")
plt.show()

# %% [markdown]
# A drift is a number in a schedule; what it costs is a property of the *policy*. So before one compares methods under a drift, one
# has to measure that it costs something, and that it can be learnt: `python -m gbdqn_ref drift-effect`. The README has its tables.
#
# ## How adaptation is measured
#
# Returns of different regimes cannot be compared as they are: after a drift the best possible return is another one. The package
# puts them on one scale, separately for each drift:
#
# $$\text{level} = \frac{\text{return} - \text{random}}{\text{reference} - \text{random}},$$
#
# where *reference* is the mean of the 20 episodes before the drift.
#
# | name | what it is |
# |---|---|
# | drop | 1 − mean level of the first 20 episodes after the drift |
# | recovery | episodes until a mean of 10 levels is back at 0.9; none: censored |
# | area | mean level of the whole regime |

# %%
source(stats.regime_table, stats.recovery)

# %% [markdown]
# By hand, on a made-up curve: 100 before the drift, then 20, then climbing back by 5 an episode; a random policy gets 20.

# %%
returns = np.concatenate([np.full(40, 100.0), np.minimum(100, 20 + 5 * np.arange(40.0))])
records = [
    {"episode": k, "regime": int(k >= 40), "event": "drift" if k == 40 else "", "return": value}
    for k, value in enumerate(returns)
]
row = stats.regime_table(records, random_return=20.0)[1]

levels = [(value - 20) / (100 - 20) for value in returns[40:]]
drop = 1 - sum(levels[:20]) / 20
recovered = next(k for k in range(10, 41) if sum(levels[k - 10 : k]) / 10 >= 0.9)

assert (
    np.isclose(drop, row["drop"])
    and recovered == row["recovery"]
    and np.isclose(np.mean(levels), row["area"])
)
plt.plot(returns, ".-", color=BLUE)
plt.axvline(40, color="0.3", linestyle="--")
plt.axvline(
    40 + recovered, color=GREEN, linestyle=":", label=f"recovered after {recovered} episodes"
)
plt.gca().set(xlabel="episode", ylabel="return", title=f"drop {drop:.0%}, area {row['area']:.2f}")
plt.legend()
plt.show()

# %% [markdown]
# **Exercise 3.** What do drop, recovery and area become for an agent that never comes back, and for one that had learnt nothing before
# the drift (20 all along)? Why is the second answer the honest one?

# %% tags=["solution"] jupyter={"source_hidden": true}
never = [record | {"return": 100.0 if record["episode"] < 40 else 20.0} for record in records]
row = stats.regime_table(never, random_return=20.0)[1]
assert (row["drop"], row["recovery"], row["area"]) == (1.0, None, 0.0)
nothing = [record | {"return": 20.0} for record in records]
row = stats.regime_table(nothing, random_return=20.0)[1]
assert (row["drop"], row["recovery"], row["area"]) == (
    None,
    None,
    None,
)  # there was nothing to lose

# %% [markdown]
# ## What to take along
#
# | | one might think | in truth |
# |---|---|---|
# | drift and TD error | drift always shows as a positive error | it can be silent, negative, or lower an error (claim C1) |
# | size | the residual is how far Q is off | within a factor: between 1 − γ and 1 + γ of it (claim C2) |
# | value and policy | if Q* moves, the agent must act differently | all of Q* can move and no action with it |
# | an experiment with drift | tests adaptation | only if the drift costs a policy that stays put something |
#
# **Next:** notebook 2, the network.

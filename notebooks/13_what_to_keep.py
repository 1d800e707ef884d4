# %% [markdown]
# # 13 · What to keep when the physics drift
#
# After this notebook you can say which parts of an agent to keep when the world
# changes, and write a detector of the change.
#
# *Time: 30 minutes. Needs: notebooks 2, 6 and 12. With the paper open: section
# “Conclusions”, last paragraph but one.*
#
# **How to read this with the paper open.** In the paper everything is kept: the network
# is frozen, the data stay, a booster is added, and the schedule says when. Its
# Conclusions name what is missing: “fully autonomous drift detection mechanisms” (claim
# X24) and “reweighting under reversible drift” (claim X26). This page takes both up,
# first in the ten rooms, then in a study.

# %%
import json
import re

import numpy as np
from exercises import check, solution
from exercises.ten_rooms import target
from forty_lines import train
from IPython.display import Markdown
from lesson import FAST, GAMMA, ROOMS, ROOT, correct_rooms, corridor, show, step
from pictures import keep as pictures

from gbdqn_ref import detect, stats

SEEDS = range(2 if FAST else 10)

# %% [markdown]
# ## What there is to keep
#
# | an agent has | after a drift it is | in the ten rooms |
# |---|---|---|
# | its data, the replay | partly about a world that is gone | the list `data` |
# | its network, Q | wrong in some states, correct in others | the table `Q` |
# | Adam's running means | about gradients that are gone | none |
# | older stages, stored | correct, if their world returns | the list `shelf` |
# | exploration, ε | too low to find new ways, perhaps | always 0.2 |
#
# And somebody must *notice* the drift. In the first half of this page the agent is
# told.
#
# The agent is a table that learns as DQN does, from uniform draws of a replay. `keep`
# says what survives a drift.


# %%
class Keeper:
    """A table that learns from its data; at a drift it keeps what it is told to."""

    def __init__(self, seed, keep=("Q", "data")):
        self.rng, self.keep = np.random.default_rng(seed), keep
        self.Q, self.data, self.shelf = np.zeros((ROOMS, 2)), [], []

    def q(self):
        return self.Q

    def learn(self, *transition):
        """Store a transition, then learn from four that are drawn."""
        self.data.append(transition)
        for k in self.rng.integers(len(self.data), size=4):
            room, action, reward, room2, terminated = self.data[k]
            y = target(reward, terminated, self.Q[room2], GAMMA)
            self.Q[room, action] += 0.1 * (y - self.Q[room, action])

    def drift(self):
        if "data" not in self.keep:
            self.data = []
        if "Q" not in self.keep:
            self.Q = np.zeros((ROOMS, 2))


EPISODES = 150  # with each goal


def lives(goals, keep, seed):
    """How many rooms are correct after each episode; the goal moves every 150."""
    agent, rng, found = Keeper(seed, keep), np.random.default_rng(100 + seed), []
    for k, goal in enumerate(goals):
        if k:
            agent.drift()
        if k and "stages" in keep:
            found += compete(agent, goal, rng)
        while len(found) < EPISODES * (k + 1):
            train(agent, goal, 1, rng)
            found.append(correct_rooms(agent.Q, goal))
    return np.array(found)


def until_correct(found):
    """The last episode after which a room is still wrong; 0 if there is none."""
    return np.flatnonzero(np.append(9, found) < 9).max(initial=0)


# %% [markdown]
# ## Data or network?
#
# The goal is in room 9 for 150 episodes. Then it moves to room 0, where everything is
# wrong, or to room 7, where only rooms 8 and 9 must turn.
#
# > **Predict.** Four agents: keep Q or begin with a new one, keep the data or drop them.
# > Which of the two matters more? Is the old Q ever a handicap, and when does it help?

# %% tags=["predicted"]
ARMS = {
    "keep all": ("Q", "data"),
    "drop Q": ("data",),
    "drop data": ("Q",),
    "drop both": (),
}
needed = {}
for goal in (0, 7):
    print(f"goal 9 → {goal}: last episode after which a room is wrong")
    for name, keep in ARMS.items():
        runs = [lives((9, goal), keep, seed)[EPISODES:] for seed in SEEDS]
        needed[goal, name] = np.array([until_correct(found) for found in runs])
        print(f"   {name:10} median {np.median(needed[goal, name]):5.1f}")

# %% [markdown]
# **The data matter most.** As long as old transitions are drawn, "room 8, right: the
# end" is one of them, and no Q can be true to both worlds. With the old data the median
# run is right for good only in the last dozen of 150 episodes, or never. A new Q is
# nearer at first, partly because zeros go left at a tie, and room 0 is on the left. But
# it is soon taught the old world again.
#
# **What Q is worth depends on how far the world has moved.** When the goal goes two
# rooms back, most arrows of the old Q are correct, and a new Q is far behind. When it
# goes to the other end, every arrow is wrong, and still the old Q costs no more
# episodes: a failed episode still gives 100 transitions to learn from. A network has
# one more reason to stay: what its layers have learnt of the states can serve another
# goal.
#
# ## The old world returns
#
# Now let the goal move to room 0 and *back* to room 9. An agent that stored its Q when
# the first drift came has the answer on its shelf. GB-DQN stores it too, but buried
# under a booster: only the sum acts (notebook 12). A stored Q is what a stage ended
# with, so we call it a stage, and the present Q too. Which one knows this world?
#
# Let them show it. In a **trial episode** a stage plays alone, and the stage with the
# best return goes on. The newest plays first, and wins if returns are equal: what was
# right last is the better guess.
#
# **Exercise 1.** Which stage goes on?


# %%
def choose(returns):
    """The place of the stage that goes on; returns are the newest stage's first."""
    ...  # yours


choose = check("choose", choose)
solution("choose")


# %%
def play(Q, goal, rng):
    """The return of one episode, of at most 100 steps, in which Q plays alone."""
    room, total = rng.choice([r for r in range(ROOMS) if r != goal]), 0
    while room != goal and total > -100:
        room, reward, _ = step(room, Q[room].argmax(), goal)
        total += reward
    return total


def compete(agent, goal, rng):
    """Store the present Q; the best stage goes on. The correct rooms of each."""
    agent.shelf.append(agent.Q)
    stages = agent.shelf[::-1]
    best = choose([play(Q, goal, rng) for Q in stages])
    agent.Q = stages[best].copy()
    return [correct_rooms(Q, goal) for Q in stages]


# %% [markdown]
# > **Predict.** Goal 9, goal 0, goal 9 again. After how many episodes is each of four
# > agents correct again on the return? How many of them are trials?

# %% tags=["predicted"]
GOALS = (9, 0, 9)
arms = {name: ARMS[name] for name in ("keep all", "drop Q", "drop data")}
arms["drop data, store stages"] = ("Q", "stages")
paths = {
    name: np.array([lives(GOALS, keep, seed) for seed in SEEDS])
    for name, keep in arms.items()
}
print("on the return, last episode after which a room is wrong:")
for name, found in paths.items():
    back = [until_correct(each) for each in found[:, 2 * EPISODES :]]
    needed["back", name] = np.array(back)
    print(f"   {name:24} median {np.median(back):5.1f}")

# %% tags=["predicted"]
show(
    pictures.there_and_back(
        {name: found.mean(0) for name, found in paths.items()}, GOALS, EPISODES
    ),
    alt="Correct rooms over 450 episodes; the goal is in room 9, 0 and 9 again. "
    "With the old data no curve gets all nine rooms right for long after both drifts; "
    "a new Q is nearer after the first one. Dropping the data is back within some "
    "thirty episodes, with stored stages room 9 is found again at once.",
)

# %% [markdown]
# One episode is lost, a trial of the stage of goal 0. In the second, also a trial, the
# stage of goal 9 arrives, and goes on. The agent that only dropped its data has to learn
# again what it once knew.
#
# Nothing is boosted here. Storing and choosing is *reuse*, and a network can be stored as
# well as an ensemble. A gain counts for boosting only where the agent's twin, a DQN
# that reuses its networks, gains less.
#
# What do trials cost where no stage is correct? The goal moves to room 4, which none of
# them has seen:

# %%
for name in ("drop data", "drop data, store stages"):
    runs = [lives((9, 0, 4), arms[name], seed)[2 * EPISODES :] for seed in SEEDS]
    needed["new", name] = np.median([until_correct(found) for found in runs])
    print(f"{name:24} median {needed['new', name]:4.1f} episodes")

# %% [markdown]
# Some episodes. A trial says which stage is best, not that it is good. And one episode is
# luck: started in room 2, the stage of goal 9 arrives in room 4, started in room 7 it
# does not.
#
# ## Who notices?
#
# From here on nobody tells the agent. It sees its returns. They vary with starts and
# random actions. One bad return means nothing. Several in a row do.
#
# Let $z$ say how many standard deviations a return lies *below* the usual. Add the $z$
# up, subtract a slack κ each time, and never go below 0. This is the **CUSUM** chart
# (cumulative sum; Page 1954):
#
# $$S \;\leftarrow\; \max(0,\; S + z - \kappa)$$
#
# While all is well, $z$ is 0 on average, and the slack pulls S back to 0. After a fall
# $z$ is larger than κ, and S climbs. When S exceeds a level, there is an alarm. κ is
# half of the shift that is to be found. We cap each $z$ at 3, so that no single episode
# raises an alarm, and look for a shift of 3: κ = 1.5.
#
# **Exercise 2.** Write the chart.


# %%
def cusum(z, slack):
    """S after each z, as a list; S is 0 before the first."""
    ...  # yours


cusum = check("cusum", cusum)
solution("cusum")

# %% [markdown]
# The recursion hides what S is: the largest sum over all stretches that end now.
#
# $$S_t = \max_{i \le t} \; \sum_{j = i + 1}^{t} (z_j - \kappa)$$
#
# (For $i = t$ the sum is empty, and 0.) The best stretch that ends at $t$ is the best
# that ended at $t - 1$ and one more value, or the empty one. So S also knows *when* the
# change began, if there was one: after the last 0. That is the estimated **change
# point**.
#
# **Exercise 3.** Find both in an array of S.


# %%
def change_point(S, level):
    """(change, alarm): where S last left 0 before it exceeded the level, and the
    first place where it exceeds it."""
    ...  # yours


change_point = check("change_point", change_point)
solution("change_point")

# %% [markdown]
# The agent that keeps everything, and does not know of the drift at episode 150:


# %%
def watch(goals, lengths, seed):
    """Returns, and the share of each episode's steps that a model has wrong."""
    agent, rng = Keeper(seed), np.random.default_rng(100 + seed)
    returns, wrong, model = [], [], {}
    for goal, length in zip(goals, lengths, strict=True):
        for _ in range(length):
            before = len(agent.data)
            train(agent, goal, 1, rng)
            steps = [(s[:2], s[3:]) for s in agent.data[before:]]
            returns.append(-len(steps))
            wrong.append(np.mean([model.get(at, to) != to for at, to in steps]))
            model.update(steps)
    return np.array(returns), np.array(wrong)


LEVEL, SLACK, FIRST = 5.0, 1.5, 100
returns, _ = watch((9, 0), (150, 20), seed=1)
calm = returns[FIRST:150]
z = np.minimum((calm.mean() - returns[FIRST:]) / calm.std(), 3)
S = np.array(cusum(z, SLACK))
for t in range(len(z)):  # the definition
    assert np.isclose(S[t], max((z[i : t + 1] - SLACK).sum() for i in range(t + 2)))
change, alarm = np.add(FIRST, change_point(S, LEVEL))
print(f"the goal moves before episode 150; change point {change}, alarm {alarm}")

show(
    pictures.chart(FIRST, returns[FIRST:], S, LEVEL, 150, change, alarm),
    alt="Above, returns from episode 100 on, around minus 7, then minus 100 after the "
    "goal moves at episode 150. Below, S, near 0 before, climbs from 150 on and "
    "exceeds the level of 5 at episode 153, where the alarm is.",
)

# %% [markdown]
# How high should the level be? An alarm where nothing changed is a **false alarm**. A
# lower level gives more of them, a higher one comes later.
#
# > **Predict.** Normal numbers, κ = ½, 650 episodes in which nothing changes. In which
# > share of such runs is there a false alarm at level 5? Does it matter that real
# > returns are *correlated*, a bad one often followed by a bad one?

# %% tags=["predicted"]
rng = np.random.default_rng(0)
noise = rng.normal(size=(100 if FAST else 400, 650))
linked = noise.copy()
for t in range(1, 650):  # correlation 0.3 from one to the next, variance 1
    linked[:, t] = 0.3 * linked[:, t - 1] + np.sqrt(1 - 0.3**2) * noise[:, t]
charts = {
    name: np.array([cusum(stream, 0.5) for stream in z])
    for name, z in (("calm", noise), ("linked", linked), ("shifted", noise[:, :60] + 2))
}
false = {}
for level in (2, 5, 8, 10):
    for name in ("calm", "linked"):
        false[name, level] = (charts[name].max(1) > level).mean()
    delay = np.median((charts["shifted"] > level).argmax(1)) + 1
    print(
        f"level {level:2}: false alarms in {false['calm', level]:4.0%} of the runs, "
        f"{false['linked', level]:4.0%} if linked; a shift of 2 found after {delay:.0f}"
    )

# %% [markdown]
# So no level suits every environment. Set it on the environment's own quiet runs,
# and state false alarms and delay together. ([The study's
# detectors](../benchmarks/keep/README.md) were set like this.)
#
# **What a chart of falls does not see.** An agent at the floor cannot fall.
#
# > **Predict.** The goal moves to room 0, the returns go to −100, and 30 episodes later
# > it moves to room 4. Does S rise? What else could be charted?

# %% tags=["predicted"]
risen, first = [], []
for seed in SEEDS:
    returns, wrong = watch((9, 0, 4), (150, 30, 30), seed)
    usual, now = returns[150:180], returns[180:]
    z_now = np.minimum((usual.mean() - now) / (usual.std() + 1e-9), 3)
    risen.append(max(cusum(z_now, SLACK)))
    first.append(180 + np.flatnonzero(wrong[180:])[0])
print(f"largest S after the second drift: {max(risen):.1f}")
print("the model is first wrong in episode", *first)

# %% [markdown]
# S is silent, and rightly so: nothing got worse. A model of the world does react. Here
# it remembers where each action last led, and whether the episode ended there; when the
# goal moves, only that is wrong. It does not care how well the agent does. It sees only
# where the agent goes, and where physics are random it errs without a drift.
#
# **Why not the TD error?** The paper takes it for the sign of a drift (claim X18). Put
# ten old transitions for one new into the buffer, as in notebook 6, and let Q go in a
# straight line from the old Q* to the new one.


# %%
def mean_error(Q, goal):
    """The mean of |δ| over all steps in the world with this goal."""
    Q = np.where(np.arange(ROOMS)[:, None] == goal, 0, Q)  # nothing comes after it
    return np.abs(np.delete(corridor(goal).residual(Q), goal, axis=0)).mean()


# %% [markdown]
# > **Predict.** When is the mean of |δ| smallest: at the drift, half-way, or when Q has
# > learnt the new world?

# %% tags=["predicted"]
q_old, q_new = corridor(9).q_star(), corridor(0).q_star()
charted = []
for learnt in (0, 0.25, 0.5, 0.75, 1):
    Q = (1 - learnt) * q_old + learnt * q_new
    charted.append((10 * mean_error(Q, 9) + mean_error(Q, 0)) / 11)
    print(f"{learnt:4.0%} of the way: mean of |δ| {charted[-1]:.2f}")

# %% [markdown]
# At the drift. It is learning that moves |δ| (R4), so a chart of |δ| hears the learner
# rather than the world. Dropping the old data cures this, but for that one must know
# when.
#
# ## Which data survive an alarm
#
# The alarm comes some episodes after the drift. The agent has met the new world since.
#
# **Exercise 4.** Each transition has the step at which it was added. The chart's
# estimate of the first new step is `change`; the next transition is number `now`.


# %%
def keep(added, change, now):
    """Which transitions survive the alarm: True or False for each of `added`."""
    ...  # yours


keep = check("keep", keep)
solution("keep")

# %% [markdown]
# The package's chart follows the returns as they come: it skips 30 episodes, takes the
# next 30 as its reference, and then updates it slowly. With it nobody needs to tell
# the agent.


# %%
def untold(survive, slack, seed):
    """The last episode after which a room is wrong; nobody tells of the drift."""
    agent, rng, now, found = Keeper(seed), np.random.default_rng(100 + seed), 0, []
    chart = detect.Chart(LEVEL, slack)
    for episode in range(2 * EPISODES):
        goal, start, length = 9 if episode < EPISODES else 0, now, len(agent.data)
        train(agent, goal, 1, rng)
        now += len(agent.data) - length
        change = chart.update(now - start, start)  # x = −return, the number of steps
        if change is not None:
            added = np.arange(now - len(agent.data), now)
            kept = np.flatnonzero(survive(added, change, now))
            agent.data = [agent.data[k] for k in kept]
        found.append(correct_rooms(agent.Q, goal))
    return until_correct(found[EPISODES:])


def since_alarm(added, change, now):
    return added >= now


# %% [markdown]
# > **Predict.** What is lost by not being told? Does it matter whether the data since the
# > alarm survive or those since the change point? And with κ = ½, at which S climbs at
# > the slightest fall?

# %% tags=["predicted"]
waits = {
    "told": needed[0, "drop data"],
    "since the alarm": [untold(since_alarm, 1.5, seed) for seed in SEEDS],
    "since the change point": [untold(keep, 1.5, seed) for seed in SEEDS],
    "the same, κ = ½": [untold(keep, 0.5, seed) for seed in SEEDS],
    "never": needed[0, "keep all"],
}
for name, each in waits.items():
    print(f"{name:23}", *(f"{wait:3}" for wait in sorted(each)))

# %% [markdown]
# (Each number is one run.) Not much is lost. Between alarm and change point these ten
# runs show no difference: new data are cheap here; where they are expensive, the change
# point saves them. But it is an estimate. With κ = ½ S may have left 0 at an ordinary
# bad episode before the drift, and then transitions of the old world stay. A few can
# hold a run up: "room 8, right: the end" is drawn until it is diluted. Too early keeps
# what is stale, too late throws away what is new.
#
# The package's `dqn-reuse` and `gbdqn-reuse` put the pieces together (D22): a chart, the
# data since the change point, stored stages and trial episodes, and a second trial where
# the returns do not recover, because there the chart is blind.

# %% tags=["checks"]
for goal in (0, 7):
    assert np.median(needed[goal, "drop data"]) < np.median(needed[goal, "drop both"])
assert min(needed[0, "keep all"]) > 100 and min(needed[0, "drop Q"]) > 100
assert max(needed[0, "drop data"]) < 60 and max(needed[0, "drop both"]) < 60
assert (needed["back", "drop data, store stages"] == 1).all()
relearnt, kept = (np.median(needed["back", name]) for name in ("drop data", "keep all"))
assert 5 < relearnt < 40 < 100 < kept
extra = needed["new", "drop data, store stages"] - needed["new", "drop data"]
assert 0 < extra < 15
assert np.isclose(S[-1], detect.cusum(S[-2], z[-1], SLACK))
assert change == 150 and alarm == 153
assert false["calm", 5] > 0.3 and false["calm", 10] < 0.03 < 0.1 < false["linked", 10]
assert max(risen) < 1 and max(first) < 185
assert min(charted[1:]) > 5 * charted[0]
told, by_alarm, by_change, loose, _ = map(max, waits.values())
assert max(told, by_alarm, by_change) < 60 < loose

# %% [markdown]
# ## What the study found
#
# Does it hold with networks, on MountainCar, Acrobot and CartPole?
# [The study](../benchmarks/keep/README.md) asks this. Its
# [protocol](../benchmarks/keep/protocol.toml) was committed before the first reported
# run: eight hypotheses, one measure (the mean return after the first event), equal
# tuning, and 20 to 40 seeds that no setting was chosen on. (`dqn` has the settings
# chosen for `dqn-drop`.) Where a task ends in `null` nothing changes; a `held-out`
# schedule is one that nothing was chosen on.
#
# | arm | what it keeps; how it learns of a change: told, or by its own chart |
# |---|---|
# | `dqn`, `gbdqn` (as in the paper) | everything; told |
# | `sliding` | network, newest data |
# | `dqn-drop`, `dqn-detected` | network; told, chart |
# | `gb-drop` | network, with a booster each time the motor is reversed; told |
# | `twin-told-adam`, `twin-adam` | network and stored ones, Adam restarted; told, chart |
# | `reuse-told`, `reuse` | the same, with a booster at each change; told, chart |

# %%
path = ROOT / "paper_checks/results/keep/rows.jsonl"
stored = {}  # (task, arm): the mean returns after the first event
for row in map(json.loads, path.read_text(encoding="utf-8").splitlines()):
    stored.setdefault((row["task"], row["arm"]), []).append(row["value"])

arms = ("dqn", "gbdqn", "sliding", "dqn-drop", "gb-drop", "twin-told-adam")
arms += ("reuse-told", "dqn-detected", "twin-adam", "reuse")
level = {}
for task in dict.fromkeys(task for task, _ in stored):
    print(f"{task}: IQM of the mean return after the first event (runs)")
    for arm in arms:
        if values := stored.get((task, arm)):
            level[task, arm] = stats.iqm(values)
            print(f"   {arm:15} {level[task, arm]:7.1f} ({len(values)})")

# %% [markdown]
# A motor is reversed and put right again. Agents that keep all their data stay behind.
# On Acrobot and MountainCar dropping them gains most, and a booster adds to it; on
# CartPole stored networks add most, and a booster takes from them. `reuse`, which
# nobody tells of the drifts, is ahead of `dqn-drop`, which is told, on MountainCar. On
# Acrobot it is behind: an alarm comes some five episodes late, at 500 steps each.
#
# Which differences are more than chance? The table has what each choice gains, by what
# you know: differences on the same seeds, with 95 % intervals. One that contains 0
# shows neither a difference nor that there is none. They are not corrected for their
# number; the hypotheses are.

# %%
page = (ROOT / "docs/what_to_keep.md").read_text(encoding="utf-8")
page = re.sub(r"`again.py \S+ (\S+) (\S+)`", r"`\1` − `\2`", page)
choices = page.partition("What each choice brings")[2]
held = re.search(r"Hypotheses that hold:.*?\n\n", choices, re.DOTALL)[0]
table = [line for line in choices.splitlines() if line.startswith("|")]
Markdown(held + "\n".join(table))

# %% [markdown]
# [The answer](../docs/what_to_keep.md) has the command for each figure, and
# [the results](../paper_checks/results/keep/README.md) have all the rest.
#
# No part of the recipe is new: storing policies, dropping stale data, a new network on
# a frozen one. What is new: each is switched by itself, and boosting has a twin.

# %% tags=["checks"]
for task, ahead in (("acrobot", False), ("mountaincar", True)):
    keeps_all = max(level[task, arm] for arm in ("dqn", "gbdqn"))
    drops, stores, boosts, both, not_told = (
        level[task, arm]
        for arm in ("dqn-drop", "twin-told-adam", "gb-drop", "reuse-told", "reuse")
    )
    assert keeps_all + 10 < drops < boosts < both and (drops < not_told) == ahead
    assert drops - keeps_all > both - drops and stores < boosts
rising = ("gb-drop", "dqn-drop", "reuse-told", "twin-told-adam")
on_cartpole = [level["cartpole", arm] for arm in rising]
assert on_cartpole == sorted(on_cartpole)

# %% [markdown]
# ## Summary
#
# When the world changes, stale data cost the most: drop those from before the change.
# What the old Q is worth depends on how far the world has moved. If old worlds return,
# stored stages know them at once, and trial episodes find them. A CUSUM chart notices
# what hurts and says since when; its level belongs to the environment, and at the floor
# it is blind. In the study dropping stale data gains on all three tasks, stored
# networks (with Adam kept) on two, and a booster on two; on the third it takes from
# what stored networks bring.
#
# [← 12](12_experiments.ipynb) · [contents](README.md) · [14 →](14_network.ipynb)

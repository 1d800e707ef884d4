"""Notebook 7: Algorithm 1's lines beside the source, arrows after a drift, readings."""

import inspect
from textwrap import dedent

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown, display
from lesson import FROZEN, LEARNER
from matplotlib.colors import ListedColormap

from gbdqn_ref.dqn import DQN
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.replay import ProportionalReplay
from gbdqn_ref.train import run, train_episode
from pictures.rooms import draw
from pictures.tones import INDIGO, ROSE, TEAL

# Algorithm 1: the printed lines, in our words, and where a line of code begins thus
LINES = (
    ("1", "the network that learns", GBDQN._new_booster, "self.theta = self.net.init("),
    ("2", "the frozen sum", GBDQN.__init__, "self.ensemble = Ensemble(self.net)"),
    ("3, 4", "episodes", run, "for episode in range("),
    ("5", "a start state", train_episode, "s, info = env.reset("),
    ("6", "steps", train_episode, "while not ends:"),
    ("7", "softmax (D6, D10)", DQN.act, "return bellman.softmax_sample(self.q(s),"),
    ("8", "act", train_episode, "s2, r, terminated, truncated, info = env.step(a)"),
    ("9, 16", "the target (D1, D6)", GBDQN.learn, "y = bellman.td_target("),
    ("10, 17", "the residual", GBDQN.learn, "residual = y - self.q_frozen["),
    ("11", "priority (D4)", ProportionalReplay.add, "self.tree.set(slot, self.max_"),
    ("12", "keep it", GBDQN.observe, "slot = self.replay.add("),
    ("13", "draw a batch, Eq. 11", GBDQN.learn, "batch = self.replay.sample("),
    ("14", "weights", ProportionalReplay.sample, "weight = importance_weights("),
    ("15, 20", "for each sample", GBDQN.learn, "h = h_all[np.arange(len(y)), batch.a]"),
    ("18", "new priority", GBDQN.learn, "self.replay.update_priorities("),
    ("19", "the loss (D2)", GBDQN.learn, "dq = factor * bellman.loss_gradient("),
    ("21", "a gradient step", GBDQN.learn, "self.adam.step(self.theta, grad)"),
    ("22–25", "go on, or leave", train_episode, "s, ends, length, total = s2,"),
    ("26", "target network (D9)", GBDQN.learn, "polyak(self.theta_target,"),
    ("27, 28", "end of an episode", run, "yield record"),
    ("29", "add the booster, Eq. 9", GBDQN.fold_in, "self.ensemble.add(self.theta,"),
)
NAMES = {
    1: "1 frozen, a whole backup",
    2: "2 frozen, loss on h",
    3: "3 live, loss on αh",
    4: "4 live, loss on h",
    5: "5 live, η at the end",
}
STYLES = {
    1: (FROZEN, "-"),
    2: (FROZEN, "--"),
    3: (LEARNER, "-"),
    4: (INDIGO, "-."),
    5: (TEAL, ":"),
}


def place(where, code):
    """The number of the one line of a function that begins with this code."""
    lines = inspect.getsource(where).splitlines()
    (found,) = (k for k, line in enumerate(lines) if line.strip().startswith(code))
    return found


def table():
    """Printed lines, in our words, and where each stands."""
    text = "| printed | in words | where | the line begins |\n|---|---|---|---|\n"
    for printed, words, where, code in LINES:
        place(where, code)
        name = f"{where.__module__.removeprefix('gbdqn_ref.')}.{where.__qualname__}"
        text += f"| {printed} | {words} | `{name}` | `{code}` |\n"
    return Markdown(text)


def beside(*functions):
    """The source of functions, with the numbers of Algorithm 1's lines at its left."""
    for function in functions:
        source = dedent(inspect.getsource(function)).rstrip().splitlines()
        marks = {place(at, code): mark for mark, _, at, code in LINES if at is function}
        text = "\n".join(
            f"{marks.get(k, ''):>7}  {line}".rstrip() for k, line in enumerate(source)
        )
        name = f"{function.__module__}.{function.__qualname__}"
        display(Markdown(f"`{name}`\n```python\n{text}\n```"))


def turned(Q):
    """In how many of the nine rooms Q goes left."""
    return int((Q[1:, 0] > Q[1:, 1] + 1e-6).sum())


def switch(frozen, live, every):
    """Which way each room points, one row for every second snapshot."""
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.9), sharey=True)
    for axis, track, name in zip(axes, (frozen, live), ("frozen", "live"), strict=True):
        ways = np.array([Q[1:, 0] > Q[1:, 1] + 1e-6 for Q in track[::2]])
        colours = ListedColormap(["#e4e4e4", LEARNER])
        axis.imshow(ways, cmap=colours, vmin=0, vmax=1, aspect="auto", alpha=0.75)
        for k, room in np.ndindex(ways.shape):
            left = ways[k, room]
            text = "←" if left else "→"
            axis.text(
                room, k, text, ha="center", va="center", color="w" if left else "k"
            )
        axis.set(xticks=range(9), xticklabels=range(1, 10), xlabel="room")
        axis.set_title(f'target="{name}"')
        axis.tick_params(length=0)
    rows = range(0, len(frozen[::2]), 2)
    axes[0].set(yticks=rows, yticklabels=[2 * every * k for k in rows])
    axes[0].set_ylabel("updates after the drift")
    return figure


def corridors(track, every):
    """The rooms at the drift, and after a third, two thirds and all of the updates."""
    places = np.linspace(0, len(track) - 1, 4).astype(int)
    figure, axes = plt.subplots(4, 1, figsize=(7, 5))
    for axis, k in zip(axes, places, strict=True):
        policy = (track[k][:, 0] < track[k][:, 1]).astype(int)
        draw(axis, track[k].max(1), 0, policy, span=7)
        axis.set_title(f"after {k * every} updates")
    return figure


def stage(tracks, q_new, every):
    """The error and the rooms that turned, over the updates of one stage."""
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.6))
    for reading, track in tracks.items():
        x = np.minimum(np.arange(len(track)) * every, (len(track) - 1) * every)
        colour, style = STYLES[reading]
        values = [np.abs(Q - q_new).max() for Q in track], [turned(Q) for Q in track]
        for axis, y in zip(axes, values, strict=True):
            axis.plot(x, y, style, color=colour, label=NAMES[reading])
            axis.plot(x[-1], y[-1], "o", color=colour, ms=4)
    axes[0].set(ylabel="largest error of Q", ylim=(-0.3, 7.2))
    axes[1].set(ylabel="rooms that go left", ylim=(-0.4, 9.4))
    for axis in axes:
        axis.set_xlabel("updates after the drift (dot: line 29)")
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=2)
    return figure


def boosts(errors, rooms):
    """Value and policy over the boosts."""
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.8))
    for axis, found in zip(axes, (errors, rooms), strict=True):
        for reading, values in found.items():
            colour, style = STYLES[reading]
            axis.plot(values, style, color=colour, label=NAMES[reading])
        axis.axvline(3, color=ROSE, lw=1)
        axis.set_xscale("symlog", linthresh=1)
        axis.set(xlim=(0, 200), xticks=[0, 1, 10, 100], xlabel="boosts")
        axis.set_xticklabels(["0", "1", "10", "100"])
    axes[0].text(3.3, 8, "three drifts", color=ROSE)
    axes[0].set(ylabel="largest error", title="one room that leads back")
    axes[1].set(ylabel="rooms with the right action", title="ten rooms")
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=3)
    return figure

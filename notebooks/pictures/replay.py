"""The pictures of 06_replay, and the random walk that fills its buffers."""

import matplotlib.pyplot as plt
import numpy as np
from lesson import COLOUR, FROZEN, LEARNER, ROOMS, step

LOOKS = {  # of each replay: the agents' own in their colours
    "even draws": ("black", ":"),
    "error alone": (COLOUR["dqn"], "--"),
    "β = 0.5, α = 0.01": (COLOUR["gbdqn"], "--"),
    "the defaults": (COLOUR["gbdqn"], "-"),
    "β = 0.01, α = 0.001": (COLOUR["gbdqn"], ":"),
    "old data dropped": (LEARNER, "-."),
}


def walk(steps, goal, rng):
    """The transitions of a random walk; it begins again in any room but the goal."""
    room, found = goal, []
    for _ in range(steps):
        if room == goal:
            room = int(rng.choice(np.delete(np.arange(ROOMS), goal)))
        action = int(rng.integers(2))
        room2, reward, end = step(room, action, goal)
        found.append((room, action, reward, room2, end))
        room = room2
    return found


def filled(replay, transitions):
    """The replay, with the transitions added."""
    for transition in transitions:
        replay.add(*transition)
    return replay


def mass(moments):
    """Probability over age; moments are (title, age, P, whether it is old)."""
    figure, axes = plt.subplots(1, len(moments), figsize=(8.8, 3.4), sharey=True)
    longest = max(age.max() for _, age, _, _ in moments)
    edges = np.unique(np.round(np.logspace(0, np.log10(longest + 2), 19))) - 1
    for panel, (title, age, P, old) in zip(axes, moments, strict=True):
        bottom = 0.0
        for name, colour, hatch, part in (
            ("old world", FROZEN, "///", old),
            ("new world", LEARNER, "", ~old),
        ):
            height, _ = np.histogram(age[part], edges, weights=P[part])
            look = dict(color=colour, hatch=hatch, edgecolor="white", linewidth=0)
            width = np.diff(edges)
            look |= dict(align="edge", label=name, bottom=bottom)
            panel.bar(edges[:-1] + 1, height, width, **look)
            bottom = bottom + height
        panel.set(xscale="log", xlabel="age + 1 (transitions)")
        panel.minorticks_off()
        panel.set_title(f"{title}\n{P[old].sum():.0%} of the draws are old")
    axes[0].set_ylabel("share of the draws, by age")
    axes[1].legend(loc="upper left")
    return figure


def ageing(tracks, every):
    """Old draws and rooms with the right way, as new transitions come in."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.8, 3.9))
    for name, (old, ways) in tracks.items():
        colour, line = LOOKS[name]
        x = every * np.arange(1, len(old) + 1)
        left.plot(x, old, line, color=colour, label=name, linewidth=2)
        right.plot(x, ways, line, color=colour, linewidth=2)
    xlabel = "transitions since the drift"
    left.set(xlabel=xlabel, ylim=(-0.02, 1.02), title="share of the draws that are old")
    right.set(
        xlabel=xlabel, ylim=(-0.2, 9.2), title="rooms with the right way, of nine"
    )
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center", ncols=3
    )
    return figure


def tree(levels, u):
    """The levels of a sum tree, laid end to end, and the boxes that hold u."""
    figure, axes = plt.subplots(figsize=(8, 2.6))
    for row, level in enumerate(levels):
        ends = level.cumsum()
        for number, end in zip(level, ends, strict=True):
            hit = end - number <= u < end
            box = dict(color=LEARNER if hit else "0.93", edgecolor="0.4", height=0.8)
            axes.barh(row, number, left=end - number, **box)
            colour = "white" if hit else "black"
            place = end - number / 2 + (0.5 if hit else 0), row
            axes.text(*place, f"{number:g}", ha="center", va="center", color=colour)
    axes.axvline(u, color="black", linestyle="--")
    axes.set(xlabel=f"all priorities, end to end (dashed: u = {u:g})", yticks=range(3))
    axes.set(xlim=(0, levels[0].sum()))
    axes.set_yticklabels(["priorities", "sums of 2", "sums of 4"])
    axes.set_title("From top to bottom, one box a level holds u")
    return figure


def weights(sizes, ratio, exponents, old_part):
    """What dividing by the batch's largest does, and what the weights undo."""
    figure, axes = plt.subplots(1, 2, figsize=(8.5, 3.2))
    axes[0].plot(sizes, ratio, "o-", color=LEARNER, label="divided by the largest")
    axes[0].axhline(1, color="black", linestyle="--", label="not divided")
    axes[0].set(ylim=(0, 4.3), xlabel="size of the batch")
    axes[0].set(ylabel="first counts … times the second")
    axes[0].set_title("P = (0.8, 0.2), exponent 1:\ndividing brings the bias back")
    axes[0].legend()
    axes[1].plot(exponents, old_part, "s-", color=LEARNER)
    axes[1].axhline(0.9, color="black", linestyle=":")
    axes[1].text(0, 0.92, "even draws")
    axes[1].set(ylim=(0, 1.02), xlabel="exponent of the weights")
    axes[1].set_ylabel("share of the update")
    axes[1].set_title("Recency alone, α = 0.01:\nthe 900 older of 1,000 in the update")
    return figure

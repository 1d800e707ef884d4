"""Notebook 2."""

import numpy as np
from lesson import COLOUR, FROZEN, LEARNER, plt

from . import rooms


def two_parts(frozen, h):
    """Q as the sum of a frozen part and h, for each room and action."""
    size = dict(figsize=(7, 3), sharex=True, sharey=True)
    figure, axes = plt.subplots(1, 2, **size)
    places = np.arange(rooms.ROOMS)
    for action, axis in enumerate(axes):
        axis.plot(frozen[:, action], "o", color=FROZEN, label="frozen")
        for room in places:
            start, end = frozen[room, action], frozen[room, action] + h[room, action]
            if abs(end - start) > 0.2:
                style = dict(arrowstyle="-|>", color=LEARNER, linewidth=1.5)
                axis.annotate("", (room, end), (room, start), arrowprops=style)
        total = frozen[:, action] + h[:, action]
        axis.plot(total, "_", color=LEARNER, markersize=13, label="frozen + h")
        axis.set(xlabel="room", title=f"Q(s, {('left', 'right')[action]})")
        axis.set_xticks(places)
    axes[0].plot([], [], color=LEARNER, label="h")
    axes[0].set_ylabel("Q")
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3
    )
    return figure


def turning(episodes, on, frozen, letter):
    """How many rooms are correct after the drift, for three agents."""
    figure, axis = plt.subplots(figsize=(7, 2.9))
    axis.plot(episodes, on, color=COLOUR["dqn"], linewidth=6, alpha=0.4, label="go on")
    axis.plot(episodes, frozen, color=COLOUR["gbdqn"], label="freeze")
    letter_line = dict(color=COLOUR["gbdqn"], linestyle="--")
    axis.plot(episodes, letter, **letter_line, label="freeze, to the letter")
    scale = "episodes after the drift (from 0 to 1 evenly, then by factors of 10)"
    axis.set(xlabel=scale, ylabel="correct rooms")
    axis.set_xscale("symlog", linthresh=1)
    axis.set(ylim=(-0.3, 9.3), yticks=[0, 3, 6, 9], xlim=(0, None))
    axis.set(xticks=[0, 1, 10, 100], xticklabels=["0", "1", "10", "100"])
    axis.legend(loc="center right")
    return figure


def boosters(counts):
    """How many rooms are correct after each perfect booster: {label: counts}."""
    figure, axis = plt.subplots(figsize=(7, 2.9))
    for (label, found), line in zip(counts.items(), ("-", "--"), strict=True):
        last = len(found) - 1
        axis.step(range(last + 1), found, line, where="post", color=COLOUR["gbdqn"])
        axis.plot(last, found[-1], "o", color=COLOUR["gbdqn"])
        axis.text(last, 9.5, f"{last} at {label}", ha="center")
    axis.set(xlabel="perfect boosters, one for each drift", ylabel="correct rooms")
    axis.set(ylim=(-0.3, 10.5), yticks=[0, 3, 6, 9], xlim=(-1, 90))
    return figure

"""Notebook 3."""

import numpy as np
from lesson import COLOUR, FROZEN, plt

from . import rooms

LOOKS = {  # of each agent
    "go on": dict(color=COLOUR["dqn"], linestyle="-"),
    "go on, new Adam": dict(color=COLOUR["dqn"], linestyle=":"),
    "freeze": dict(color=COLOUR["gbdqn"], linestyle="--"),
    "begin anew": dict(color=COLOUR["reset"], linestyle="-."),
}


def one_update(table, network):
    """How much Q(s, left) changes in each room when it is moved in room 1."""
    figure, axis = plt.subplots(figsize=(7, 2.8))
    axis.bar(range(rooms.ROOMS), table, 0.6, color="0.75", label="table")
    axis.plot(network, "o-", color="0.15", label="network")
    axis.axhline(0, color="0.15", linewidth=0.8)
    axis.set(xlabel="room", ylabel="change of Q(s, left)", xticks=range(rooms.ROOMS))
    axis.set_title("Learning in room 1 alone, until its Q has moved by 2.75")
    axis.legend()
    return figure


def unvisited(changes):
    """How far Q has moved: {name: changes (seeds, rooms)}, mean and range."""
    figure, axis = plt.subplots(figsize=(7, 3))
    places = np.arange(rooms.ROOMS)
    axis.axvspan(0.5, 3.5, color="0.92")
    for name, moved in changes.items():
        axis.plot(places, moved.mean(0), marker="o", label=f"{name}: Q", **LOOKS[name])
        ends = dict(color=LOOKS[name]["color"], alpha=0.15)
        axis.fill_between(places, moved.min(0), moved.max(0), **ends)
    axis.plot(places, 0 * places, color=FROZEN, linewidth=3, label="the frozen part")
    axis.set(xlabel="room", ylabel="change of Q", xticks=places, ylim=(-0.15, None))
    axis.set_title("It learns in rooms 1 to 3 only (grey), and Q moves everywhere")
    axis.legend(loc="upper center")
    return figure


def recoveries(errors):
    """The largest error of Q after each drift: {name: (seeds, drifts, updates)}."""
    figure, axes = plt.subplots(1, 2, figsize=(7, 3), sharey=True)
    titles = "The goal moves from 9 to 0", "… and back to 9"
    for drift, (axis, title) in enumerate(zip(axes, titles, strict=True)):
        for name, error in errors.items():
            axis.plot(error[:, drift, :300].mean(0), label=name, **LOOKS[name])
        axis.axhline(0.5, color="0.5", linewidth=0.8)
        axis.set(xlabel="updates after the drift", title=title, ylim=(0, None))
    axes[0].set_ylabel("largest error of Q")
    axes[1].legend(loc="upper right")
    return figure

"""Notebook 1."""

import numpy as np
from lesson import plt

from . import rooms

ACTIONS = ("left", "0.6"), ("right", "0.15")  # colours are for agents


def q_and_policy(Q, goal):
    """Q of both actions in each room, and below it the rooms with the greedy policy."""
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(7, 3.6), sharex=True, height_ratios=[2, 1]
    )
    others = np.arange(rooms.ROOMS) != goal
    for action, (name, colour) in enumerate(ACTIONS):
        values = np.where(others, Q[:, action], np.nan)
        above.plot(values, "<>"[action] + "-", color=colour, label=f"Q(s, {name})")
    above.set(ylabel="Q", title="What each action is worth")
    above.legend(loc="lower right" if goal == 0 else "upper left")
    rooms.draw(below, Q.max(1), goal, Q.argmax(1))
    below.set(xlabel="room", title="The larger of the two, and the action that has it")
    above.tick_params(labelbottom=False)
    return figure


def errors_and_policies(delta, old, new, goal):
    """The TD errors of an old Q in the new world, and where its policy is wrong."""
    size = dict(figsize=(7, 3.4), sharex=True, height_ratios=[2, 1.3])
    figure, (above, below) = plt.subplots(2, 1, **size)
    heights = np.where(np.arange(rooms.ROOMS)[:, None] == goal, 0, delta)
    for action, (name, colour) in enumerate(ACTIONS):
        places = np.arange(rooms.ROOMS) + 0.34 * action - 0.17
        above.bar(places, heights[:, action], 0.3, color=colour, label=name)
    above.axhline(0, color="0.15", linewidth=0.8)
    above.set(ylabel="TD error", title="Where a TD error shows that the goal has moved")
    above.legend(loc="upper right", ncols=2)
    above.tick_params(labelbottom=False)
    for y, policy, label in ((0.5, old, "before"), (-0.5, new, "after")):
        for room, action in enumerate(policy):
            if action is not None:
                rooms.arrow(below, room, action, y)
        below.text(-0.75, y, label, ha="right", va="center")
    below.set(ylim=(-1, 1), yticks=[], xticks=range(rooms.ROOMS), xlabel="room")
    below.set_title("Where the best action has changed")
    below.tick_params(length=0)
    below.spines[:].set_visible(False)
    return figure

"""The ten rooms: values as shades, policies as arrows, the goal in a thick frame."""

import numpy as np
from matplotlib.patches import Rectangle

ROOMS = 10


def draw(axis, values, goal, policy=None, colour="0.3", span=None, text="{:.1f}"):
    """A row of rooms, each with its value, and shaded by its size as a part of `span`.

    `policy` has an action for each room, 0 left and 1 right, drawn as an arrow below;
    None is no arrow. Below the goal there is none: there the episode is over.
    """
    span = span or max(np.abs(values).max(), 1e-9)
    for room, value in enumerate(values):
        shade = min(abs(value) / span, 1)
        box = dict(facecolor=colour, alpha=0.55 * shade, linewidth=0)
        axis.add_patch(Rectangle((room - 0.48, -0.48), 0.96, 0.96, **box))
        wide = 2.5 if room == goal else 0.8
        frame = dict(fill=False, edgecolor="0.15", linewidth=wide)
        axis.add_patch(Rectangle((room - 0.48, -0.48), 0.96, 0.96, **frame))
        label = "goal" if room == goal else text.format(value).replace("-", "−")
        axis.text(room, 0, label, ha="center", va="center", fontsize=9)
    for room, action in enumerate(policy if policy is not None else ()):
        if room != goal and action is not None:
            arrow(axis, room, action)
    axis.set(xlim=(-0.6, ROOMS - 0.4), ylim=(-1.0 if policy is not None else -0.6, 0.6))
    axis.set(xticks=range(ROOMS), yticks=[])
    axis.tick_params(length=0)
    axis.spines[:].set_visible(False)


def arrow(axis, room, action, y=-0.75, colour="0.15"):
    """An arrow below a room: 0 points left, 1 right."""
    ahead = 0.3 if action == 1 else -0.3
    style = dict(arrowstyle="-|>", color=colour, linewidth=1.2)
    axis.annotate("", (room + ahead, y), (room - ahead, y), arrowprops=style)

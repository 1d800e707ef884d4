"""The pictures of 04_boosting."""

import matplotlib.pyplot as plt
import numpy as np
from lesson import COLOUR, FROZEN, LEARNER

from .rooms import arrow as rooms_arrow

SUM = COLOUR["gbdqn"]


def curves(x, old, new, first, booster):
    """A drift in one dimension: before, what it left behind, after one booster."""
    figure, axes = plt.subplots(1, 3, sharey=True, figsize=(8.5, 3))
    panels = (
        ("before the drift", old, "old curve", first, "$Q_1 = h_1$", FROZEN, "-"),
        (
            "what the drift left behind",
            new - first,
            "residual",
            booster,
            "$h_2$",
            LEARNER,
            "--",
        ),
        ("after one booster", new, "new curve", first + booster, "$Q_2$", SUM, "-."),
    )
    for panel, (title, wanted, goal, got, name, colour, line) in zip(
        axes, panels, strict=True
    ):
        panel.plot(x, wanted, color="0.8", linewidth=6, label=goal)
        panel.plot(x, got, line, color=colour, label=name)
        panel.set(title=title, xlabel="x")
        panel.legend(loc="upper left")
    axes[0].set_ylabel("value")
    return figure


def hidden(q_old, q_new, residual):
    """The rooms after the goal has moved: value, way and residual of the frozen Q."""
    rooms = np.arange(1, len(q_old))
    figure, axes = plt.subplots(
        2, 1, sharex=True, figsize=(7, 4.4), height_ratios=(3, 2)
    )
    top, below = axes
    top.plot(rooms, q_old.max(1)[1:], "o-", color=FROZEN, label="frozen $Q_{m-1}$")
    top.plot(rooms, q_new.max(1)[1:], "ks:", label="new $Q^*$")
    for y, q, colour in ((-8.5, q_old, FROZEN), (-10.2, q_new, "black")):
        top.text(0, y, "way", color=colour, ha="center", va="center")
        for room in rooms:
            if q[room, 0] != q[room, 1]:
                rooms_arrow(top, room, int(q[room].argmax()), y, colour)
    top.set(xlim=(-0.6, 9.6), ylim=(-11, 0.6), ylabel="value")
    top.set_title("Every value is wrong, and so is the way in eight rooms")
    top.legend(loc="lower center", bbox_to_anchor=(0.5, 0.27), ncols=2)
    below.bar(rooms, np.abs(residual).max(1)[1:], color=LEARNER, width=0.6)
    below.set(xlabel="room (room 0 is the new goal)", ylabel="largest |residual|")
    below.set(title="The residual is zero in seven of nine rooms", xticks=range(10))
    return figure


def parabola(r, h, chosen):
    """The loss over α, at its lowest point, shrunken, and at a chosen α."""
    figure, axes = plt.subplots()
    best, before = (r @ h) / (h @ h), r @ r
    alphas = np.linspace(-0.4, 2.4, 200) * best
    axes.plot(alphas, [_loss(r, h, alpha) for alpha in alphas], color="0.3")
    axes.axhline(before, color="0.6", linestyle=":")
    for alpha, colour, mark, name in (
        (best, LEARNER, "o", "A/B (Eq. 8)"),
        (0.1 * best, FROZEN, "s", "0.1 · A/B (shrunk)"),
        (chosen, "black", "^", f"α = {chosen:.2f}"),
    ):
        axes.plot(
            alpha, _loss(r, h, alpha), mark, color=colour, markersize=9, label=name
        )
    axes.set(xlabel="α", ylabel="Σ (r − α h)²")
    axes.set_title("The loss is a parabola in α (dotted: without the booster)")
    axes.legend()
    return figure


def _loss(r, h, alpha):
    return float(((r - alpha * h) ** 2).sum())

"""Pictures of notebook 8: where a residual goes, and two meanings of its square."""

from fractions import Fraction as F

import matplotlib.pyplot as plt
import numpy as np
from lesson import FROZEN, GREEN, LEARNER

from gbdqn_ref.tabular import MDP
from pictures.tones import INDIGO, ROSE

WORLDS = INDIGO, ROSE  # γ = 0.9, γ = 0.99


def wave(residuals):
    """The largest residual of each room, one row for each boost."""
    names = ["before", *(f"boost {m}" for m in range(1, len(residuals)))]
    figure, axes = plt.subplots(
        len(residuals), 1, figsize=(7, 4.6), sharex=True, sharey=True
    )
    for axis, name, g in zip(axes, names, residuals, strict=True):
        largest = np.take_along_axis(g, np.abs(g).argmax(1)[:, None], 1)[:, 0]
        axis.bar(range(len(g)), largest, 0.7, color=LEARNER)
        axis.axhline(0, color="black", lw=0.6)
        axis.set_ylabel(name, rotation=0, ha="right", va="center")
        axis.set_title(f"sum of squares {(g**2).sum():.1f}", loc="right", y=0.72)
    axes[0].set_title("largest residual in each room")
    axes[-1].set_xticks(range(10), ["0\ngoal", *"12345678", "9\nold goal"])
    return figure


def two_meanings(drifted, slow, start, steps, ratios, tight):
    """Σ g² along the residual, the same enlarged, and the largest residual."""
    figure, axes = plt.subplots(1, 3, figsize=(8.8, 3.6))
    for axis, top in zip(axes, (1.3, 0.3), strict=False):
        alphas = np.linspace(0, top, 27)
        axis.plot(alphas, (1 - alphas) ** 2, "--", color=FROZEN)
        for loop, colour in zip((drifted, slow), WORLDS, strict=True):
            g = loop.residual(start)
            sums = [(loop.residual(start + F(a) * g) ** 2).sum() for a in alphas]
            axis.plot(alphas, sums, color=colour)
        axis.axhline(1, color="black", lw=0.6, ls=":")
        axis.set(xlabel="step α along the residual", xlim=(0, top))
    whole, near, largest = axes
    whole.set(ylim=(-0.05, 3.1), title="sum of squared residuals")
    whole.plot([1, 1], [0, 1.62], "o", color="black", ms=4)
    whole.annotate("2γ² = 1.62", (1, 1.62), (0.97, 1.1), ha="center")
    whole.annotate("frozen\ntarget", (0.5, 0.25), (0.12, 0.05))
    whole.annotate("own target,\nγ = 0.9", (0.86, 1.4), (0.1, 1.6), color=WORLDS[0])
    whole.annotate("own target,\nγ = 0.99", (1, 1.95), (0.28, 2.4), color=WORLDS[1])
    near.set(ylim=(0.96, 1.06), title="the same, enlarged")
    near.annotate("γ = 0.9", (0.25, 1), (0.2, 0.983), color=WORLDS[0])
    near.annotate("γ = 0.99", (0.2, 1.03), (0.08, 1.035), color=WORLDS[1])

    alphas = np.linspace(0, 2, 81)
    largest.plot(steps, ratios, ".", color=FROZEN, ms=4)
    largest.plot(alphas, np.abs(1 - alphas) + 0.9 * alphas, color="black")
    for points, marker, colour in zip(tight.values(), "Ds", WORLDS, strict=True):
        largest.plot(*np.transpose(points), marker, color=colour)
    largest.text(0.1, 1.35, "bound\n|1 − α| + αγ", va="center")
    for name, place, colour in zip(
        tight, ((0.1, 1.75), (0.1, 2.15)), WORLDS, strict=True
    ):
        largest.text(*place, name, color=colour)
    largest.text(0.9, 0.1, "200 random MDPs", color=FROZEN)
    largest.set(xlabel="step α along the residual", ylim=(0, 3))
    largest.set_title("largest residual, after / before")
    return figure


def boosted(gamma, alpha, boosts):
    """The drifted loop's residuals before and after each perfect booster: against the
    targets of the start, and against Q's own; at both doors, (boosts + 1, 2, 2).
    """
    loop = MDP(np.ones((1, 2, 1)), [[0.0, 1.0]], gamma)
    Q, learner, path = np.zeros((1, 2)), np.zeros((1, 2)), []
    y = loop.bellman(Q)
    for _ in range(boosts + 1):
        r, g = y - learner, loop.residual(Q)
        path.append([r[0], g[0]])
        learner, Q = learner + alpha * r, Q + alpha * g
    return np.array(path)


def boosts(gamma, alpha, chosen, most=40):
    """Both sums of squares and the largest residual, boost by boost."""
    figure, axis = plt.subplots(figsize=(7, 3))
    fixed, own = boosted(gamma, alpha, most).transpose(1, 0, 2)
    for values, colour, line, name in (
        ((fixed**2).sum(1), FROZEN, "--", "squares, target fixed"),
        ((own**2).sum(1), LEARNER, "-", "squares, its own target"),
        (np.abs(own).max(1), GREEN, "-.", "largest, its own target"),
    ):
        axis.plot(values, line, color=colour, linewidth=2, label=name)
        axis.plot(chosen, values[chosen], "o", color=colour)
    axis.axhline(1, color="black", lw=0.6, ls=":")
    axis.set(xlabel="boosters", ylabel="residuals", xlim=(-0.5, most), ylim=(0, 2))
    figure.legend(loc="outside right")
    axis.set_title(f"γ = {gamma:g}, α = {alpha:g}")
    return figure

"""Pictures of notebook 9: a residual along a level line, and two ways of an error."""

from fractions import Fraction as F

import matplotlib.pyplot as plt
import numpy as np
from lesson import FROZEN, LEARNER

from pictures.tones import INDIGO, ROSE


def level_lines(mdp, Q, mu, g, gradient, semi):
    """E over the plane of Q, and E along the residual."""
    figure, (plane, along) = plt.subplots(1, 2, figsize=(8.4, 3.8))
    x, y = np.meshgrid(np.linspace(-1.2, 1.7, 59), np.linspace(-0.2, 2.7, 59))
    E = np.array(
        [float_error(mdp, np.array([q]), mu) for q in zip(x.flat, y.flat, strict=True)]
    )
    levels = [1, 2, 3, 4, 5, 6]
    lines = plane.contour(x, y, E.reshape(x.shape), levels, colors=FROZEN)
    plane.clabel(lines, fmt="E = %g", fontsize=9)
    here = Q[0].astype(float)
    for vector, name, colour, place in (
        (g / 2, "residual g", LEARNER, (0.25, 2.15)),
        (-gradient, "downhill", INDIGO, (0.72, 0.72)),
        (-semi / 3, "downhill, if\nthe target\nis frozen", ROSE, (-1.15, 0)),
    ):
        tip = here + vector.astype(float)
        arrow = dict(arrowstyle="-|>", color=colour, lw=2, shrinkA=0, shrinkB=0)
        plane.annotate("", tip, here, arrowprops=arrow)
        plane.text(*place, name, color=colour, backgroundcolor="#ffffffcc")
    plane.plot(*here, "o", color="black")
    plane.set(xlabel="Q(first door)", ylabel="Q(second door)", aspect="equal")
    plane.set_title("level lines of E")

    alphas = np.linspace(-0.9, 1.2, 43)
    own = [mdp.bellman_error(Q + F(a) * g, mu) for a in alphas]
    along.plot(alphas, own, color=LEARNER)
    along.plot(alphas, 3 * (1 - alphas) ** 2, "--", color=FROZEN)
    along.plot(0, 3, "o", color="black")
    along.text(0.5, 3.3, "own target", color=LEARNER)
    along.text(0.35, 0.25, "frozen\ntarget", color=FROZEN, ha="right")
    along.set(xlabel="step α along the residual", ylabel="E", ylim=(0, 6))
    along.set_title("E along the residual")
    return figure


def float_error(mdp, Q, mu):
    """E_μ in ordinary numbers."""
    target = mdp.r.astype(float) + float(mdp.gamma) * Q.max()
    return (mu.astype(float) * (target - Q) ** 2).sum()


def two_ends(falling, fixed_part, exact_fit):
    """E that falls and stops; E that rises and vanishes."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.2), sharey=True)
    left.plot(falling[:13], "o-", color=LEARNER, ms=4)
    left.plot(fixed_part, "s--", color=INDIGO, ms=4)
    left.axhline(0.25, color="black", lw=0.8, ls=":")
    left.text(12, 0.17, "¼", ha="right")
    left.text(4, 0.42, "steps 2/(m + 1)²", color=LEARNER)
    left.text(3.3, 0.07, "steps of 1", color=INDIGO)
    left.set(xlabel="boosts", ylabel="E", ylim=(-0.03, 1.08))
    left.set_title("falls at each boost, and stops")

    bound = 0.81 ** np.arange(len(exact_fit))
    right.plot(exact_fit, "o-", color=LEARNER, ms=4)
    right.plot(bound, "--", color="black", lw=1)
    right.text(4.5, 0.5, "bound $γ^{2m} E_0/\\min μ$")
    right.text(1.5, 0.12, "exact fits,\ndrifted loop", color=LEARNER)
    right.set(xlabel="boosts", title="rises first, and ends at 0")
    return figure

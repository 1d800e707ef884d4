"""The instrument of the ten rooms: Q, residual and policy after each boost, as a
picture and with sliders.

The goal has moved from room 9 to room 0. A boost is one whole stage: a booster that
fits its target perfectly in every room joins the frozen sum. The live figure of the
site shows the same numbers.
"""

import matplotlib.pyplot as plt
import numpy as np
from lesson import FROZEN, GAMMA, LEARNER, ROOMS, corridor

from gbdqn_ref.tabular import MDP

TIE = 1e-9  # values that differ by no more are the same
RIGHT_WAY = "#117733"  # of a room whose action is right; no agent has it
SHOWN = 11  # boosts, at most, whose policy is drawn


# The numbers


def moved(gamma=GAMMA):
    """(the world after the drift, the Q that was right before it).

    A finished episode is worth 0, so Q is 0 in the new goal, whatever was learnt there.
    """
    Q = corridor(ROOMS - 1, gamma).q_star()
    Q[0] = 0
    return corridor(0, gamma), Q


def boost(mdp, Q, target="frozen", loss_on="h", alpha=1.0):
    """Q + α h with a perfect booster h, fitted to y − Q.

    `target`: y comes from Q (frozen), or from the sum with h in it (live). `loss_on`:
    what is fitted, h or α h. Live, the result is a fixed point: Q′ = 𝒯Q′, or, if h is
    fitted, Q′ = (1 − α) Q + α 𝒯Q′.
    """
    step = alpha if loss_on == "h" else 1.0  # fitted to α h, the booster cancels α
    if target == "frozen":
        return Q + step * mdp.residual(Q)
    rewards = (1 - step) * Q + step * mdp.r
    return MDP(mdp.P, rewards, step * mdp.gamma).q_star()


def boosted(boosts, target="frozen", loss_on="h", alpha=1.0, gamma=GAMMA):
    """(the world after the drift, [Q after 0, 1, …, `boosts` boosters])."""
    mdp, Q = moved(gamma)
    path = [Q]
    for _ in range(boosts):
        path.append(boost(mdp, path[-1], target, loss_on, alpha))
    return mdp, path


def ways(Q):
    """What is greedy in each room: −1 left, 1 right, 0 both."""
    gap = Q[:, 1] - Q[:, 0]
    return np.where(np.abs(gap) <= TIE, 0, np.sign(gap)).astype(int)


def right_rooms(mdp, Q):
    """How many of the nine rooms go the right way, and only that."""
    return int((ways(Q) == ways(mdp.q_star()))[ways(mdp.q_star()) != 0].sum())


# The pictures


def instrument(boosts=5, target="frozen", loss_on="h", alpha=1.0, gamma=GAMMA):
    """Q, residual and policy after so many boosts."""
    mdp, path = boosted(boosts, target, loss_on, alpha, gamma)
    heights = 3, 0.6 + 0.25 * len(path[-SHOWN:])
    figure, axes = plt.subplots(
        2, 1, figsize=(7, 4.6), sharex=True, height_ratios=heights
    )
    bars(axes[0], mdp, path[-1])
    history(axes[1], path)
    axes[0].set_title(
        f"target {target}, fitted {loss_on.replace('alpha_h', 'αh')}, α = {alpha:g},"
        f" γ = {gamma:g}: after {boosts} boost{'s' * (boosts != 1)},"
        f" {right_rooms(mdp, path[-1])} of {ROOMS - 1} rooms are right"
    )
    return figure


def bars(axis, mdp, Q):
    """Q of both actions, hanging from 0, and the residual at the end of each bar."""
    rooms, residual = np.arange(1, ROOMS), mdp.residual(Q)
    hatched = dict(facecolor="none", edgecolor=LEARNER, hatch="/////", linewidth=1)
    for action, shift in ((0, -0.2), (1, 0.2)):
        q, rest = Q[1:, action], residual[1:, action]
        axis.bar(rooms + shift, q, 0.34, color=FROZEN)
        left = np.abs(rest) > TIE
        axis.bar((rooms + shift)[left], rest[left], 0.34, q[left], **hatched)
        for room in rooms:
            style = dict(ha="center", va="bottom", fontsize=9)
            axis.text(room + shift, 0.15, "←→"[action], **style)
    axis.text(0, -0.3, "goal", ha="center", va="top")
    axis.axhline(0, color="black", linewidth=0.8)
    axis.set(ylim=(-11, 1.2), yticks=(0, -5, -10), ylabel="Q(s, a)")
    kinds = [
        plt.Rectangle((0, 0), 1, 1, **look) for look in (dict(color=FROZEN), hatched)
    ]
    axis.legend(kinds, ["Q", "residual, y − Q"], loc="lower left", ncols=2)


def history(axis, path):
    """The policy after each boost: filled where it is right."""
    first = max(len(path) - SHOWN, 0)
    for boosts, Q in enumerate(path[first:], first):
        for room, way in enumerate(ways(Q)[1:], 1):
            colour, ink = (RIGHT_WAY, "white") if way == -1 else ("0.88", "black")
            corner = room - 0.47, boosts - 0.44
            box = plt.Rectangle(corner, 0.94, 0.88, facecolor=colour, linewidth=0)
            axis.add_patch(box)
            style = dict(ha="center", va="center", color=ink, fontsize=9)
            axis.text(room, boosts, "←=→"[way + 1], **style)
    axis.set(xlim=(-0.6, ROOMS - 0.4), ylim=(len(path) - 0.5, first - 0.5))
    axis.set(xticks=range(ROOMS), yticks=range(first, len(path)))
    axis.set(xlabel="room", ylabel="boosts")
    axis.tick_params(length=0)
    axis.spines[:].set_visible(False)


def slider(boosts=5, target="frozen", loss_on="h", alpha=1.0, gamma=GAMMA):
    """The instrument, by hand: in Jupyter."""
    from ipywidgets import Dropdown, FloatSlider, IntSlider, interact

    def draw(boosts, target, loss_on, alpha, gamma):
        instrument(boosts, target, loss_on, alpha, gamma)
        plt.show()

    options = [("h", "h"), ("αh", "alpha_h")]
    interact(
        draw,
        boosts=IntSlider(value=boosts, min=0, max=100, description="boosts"),
        target=Dropdown(value=target, options=["frozen", "live"], description="target"),
        loss_on=Dropdown(value=loss_on, options=options, description="loss on"),
        alpha=FloatSlider(value=alpha, min=0.1, max=1, step=0.1, description="α"),
        gamma=FloatSlider(value=gamma, min=0.5, max=0.99, step=0.01, description="γ"),
    )

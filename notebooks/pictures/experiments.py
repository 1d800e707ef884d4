"""The pictures of notebook 12."""

import matplotlib.pyplot as plt
import numpy as np
from records import INGREDIENTS, final, label

from gbdqn_ref.agents import AGENTS, BLACK
from gbdqn_ref.schedule import describe
from gbdqn_ref.stats import iqm

EXTENT = (-1.2, 0.6, -0.07, 0.07)  # MountainCar's plane
FLAG = 0.5
SHADE = dict(color="0.93", zorder=0)
NEVER = "0.85"  # where no car has been
WINDOW = 10  # episodes of a running mean


def plane(titles, values, visited, rides):
    """Maps (n, n) of values where a car has been, each with the ride above and below.

    Below, [(title, ride (steps, 2))] as positions, with time running down.
    """
    figure, axes = plt.subplots(2, 3, figsize=(8, 5.2), sharex=True, sharey="row")
    shown = [np.where(*each, np.nan) for each in zip(visited, values, strict=True)]
    ends = dict(vmin=min(map(np.nanmin, shown)), vmax=max(map(np.nanmax, shown)))
    place = dict(origin="lower", extent=EXTENT, aspect="auto", interpolation="nearest")
    columns = zip(axes.T, titles, shown, rides, strict=True)
    for (above, below), title, picture, (ending, ride) in columns:
        above.set_facecolor(NEVER)
        image = above.imshow(picture, cmap="viridis", **ends, **place)
        above.plot(*ride.T, color="white", linewidth=2.4)
        above.plot(*ride.T, color=BLACK, linewidth=1)
        above.set_title(title)
        below.plot(ride[:, 0], np.arange(len(ride)), color=BLACK, linewidth=1.4)
        below.plot(ride[-1, 0], len(ride) - 1, "o", color=BLACK, markersize=5)
        below.axvline(FLAG, color="0.5", linestyle=":")
        below.set(xlabel="position, flag at 0.5", xlim=EXTENT[:2], title=ending)
    figure.colorbar(image, ax=axes[0], label="largest Q", pad=0.01)
    axes[0, 0].set_ylabel("velocity per step")
    axes[1, 0].set_ylabel("step")
    axes[1, 0].invert_yaxis()
    return figure


def cars(rides, step):
    """The valley and each ride's car at this step."""
    figure, axes = plt.subplots(1, len(rides), figsize=(9, 2.2), sharey=True)
    x = np.linspace(*EXTENT[:2], 100)
    for panel, (title, ride) in zip(axes, rides, strict=True):
        at = ride[min(step, len(ride) - 1), 0]
        panel.plot(x, np.sin(3 * x), color="0.5")
        panel.plot(at, np.sin(3 * at) + 0.12, "o", color=BLACK, markersize=9)
        panel.plot(
            [FLAG, FLAG], [np.sin(3 * FLAG), np.sin(3 * FLAG) + 0.5], color=BLACK
        )
        panel.set(title=title.split(",")[0], xticks=[], yticks=[])
    return figure


def controller(kept_up, most):
    """For how many steps a controller keeps the pole up, per change of the physics."""
    figure, axis = plt.subplots(figsize=(7, 2.6))
    shades = ["0.75" if steps > 0.9 * most else "0.35" for steps in kept_up.values()]
    names = [name.replace("-", "−") for name in kept_up]
    bars = axis.barh(names, list(kept_up.values()), color=shades)
    axis.bar_label(bars, [f"{steps:.0f}" for steps in kept_up.values()], padding=3)
    axis.invert_yaxis()
    axis.set(
        xlabel=f"steps for which it stays up, at most {most}", xlim=(0, 1.1 * most)
    )
    return figure


def around_drifts(returns, config, first):
    """A row per agent of {agent: (seeds, episodes)}: running means, and their mean."""
    figure, axes = plt.subplots(
        len(returns), 1, figsize=(7.6, 5.4), sharex=True, sharey=True
    )
    for panel, (agent, rows) in zip(axes, returns.items(), strict=True):
        look = AGENTS[agent]
        for regime in config.regimes:
            episode = np.arange(max(regime.start, first), regime.end)
            if regime.drifted:
                panel.axvspan(regime.start, regime.end, **SHADE)
            if regime.start:
                panel.axvline(regime.start, color="0.25", linewidth=0.8, linestyle="--")
            smooth = np.array(
                [_running(row[regime.start : regime.end]) for row in rows]
            )
            smooth = smooth[:, -len(episode) :]
            panel.plot(episode, smooth.T, color=look.colour, linewidth=0.8, alpha=0.6)
            panel.plot(episode, smooth.mean(0), color=look.colour, linewidth=2.6)
        panel.set(
            xlim=(first, config.episodes),
            ylim=(0, 610),
            yticks=(0, 250, 500),
            ylabel="steps",
        )
        place = dict(transform=panel.transAxes, va="top", fontweight="bold")
        panel.text(0.01, 0.98, look.label, color=look.colour, **place)
    place = dict(transform=axes[0].get_xaxis_transform(), ha="center", va="bottom")
    for regime in config.regimes:
        middle, name = (max(regime.start, first) + regime.end) / 2, regime.factors
        axes[0].text(middle, 1.02, describe(name, "\n"), fontsize=9, **place)
    axes[-1].set_xlabel("episode")
    return figure


def _running(returns):
    """The mean of the last ten returns, or of fewer just after a drift."""
    sums = np.cumsum(np.concatenate([[0.0], returns]))
    ends = np.arange(1, len(sums))
    starts = np.maximum(ends - WINDOW, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)


def first_regime(evaluations):
    """Of {agent: (seeds, regimes)}: the greedy return in the first regime's physics."""
    figure, axes = plt.subplots(1, len(evaluations), figsize=(8, 2.9), sharey=True)
    for panel, (agent, rows) in zip(axes, evaluations.items(), strict=True):
        look, x = AGENTS[agent], np.arange(rows.shape[1])
        panel.plot(x, rows.T, color=look.colour, linewidth=0.8, alpha=0.6)
        panel.plot(x, rows.mean(0), marker=look.mark, color=look.colour, linewidth=2.6)
        panel.axvspan(0.5, 3.5, **SHADE)
        panel.set_title(look.label, color=look.colour)
        panel.set_xticks(x, ["stock", "1", "2", "3", "stock\nagain"])
        panel.set_xlabel("at the end of regime")
    axes[0].set(ylabel="greedy return, stock physics", ylim=(0, 515))
    return figure


def forest(studies, split):
    """Differences to DQN of {title: {agent: (pairs, middle, low, high)}}.

    All on the left, those near 0, up to split[title], on the right.
    """
    rows = [len(study) for study in studies.values()]
    options = dict(figsize=(8, 6.6), height_ratios=rows, width_ratios=(2, 3))
    figure, axes = plt.subplots(len(studies), 2, **options)
    for panels, (title, study) in zip(axes, studies.items(), strict=True):
        for y, (agent, (pairs, middle, low, high)) in enumerate(
            reversed(study.items())
        ):
            look = AGENTS[agent]
            fill = look.colour if look.line == "-" else "white"
            for panel in panels:
                panel.plot(
                    pairs,
                    np.full(len(pairs), y),
                    "o",
                    color=look.colour,
                    alpha=0.35,
                    markersize=3,
                )
                panel.plot(
                    [low, high], [y, y], look.line, color=look.colour, linewidth=2
                )
                panel.plot(
                    middle,
                    y,
                    look.mark,
                    color=look.colour,
                    markerfacecolor=fill,
                    markersize=7,
                )
        for panel in panels:
            panel.axvline(0, color=BLACK, linewidth=0.8)
            panel.set_ylim(-0.6, len(study) - 0.4)
        names = [AGENTS[agent].label for agent in reversed(study)]
        panels[0].set_yticks(range(len(study)), names)
        panels[0].set_title(title)
        panels[1].set(xlim=(-split[title], split[title]), yticks=[])
        panels[1].set_title("the same, near 0")
    for panel in axes[-1]:
        panel.set_xlabel("final return minus DQN's")
    return figure


def ingredients(effects):
    """What each ingredient adds, {study: four (middle, low, high)} as in INGREDIENTS.

    The unit is the span from the random policy to the best of the four methods.
    """
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 4), sharex=True, sharey=True)
    for y, (study, found) in enumerate(reversed(effects.items())):
        ours = final(study)
        best = max(iqm(ours[agent]) for pair in INGREDIENTS.values() for agent in pair)
        span = best - iqm(ours["random"])
        looks = [
            ("alone", 0.15, "-", "o", "0.25"),
            ("beside the other", -0.15, "--", "s", "white"),
        ]
        for k, each in enumerate(found):
            panel, (name, shift, line, mark, fill) = axes[k // 2], looks[k % 2]
            middle, low, high = np.array(each) / span
            panel.plot([low, high], [y + shift] * 2, line, color="0.25", linewidth=1.8)
            options = dict(
                color="0.25", markerfacecolor=fill, label=None if y else name
            )
            panel.plot(middle, y + shift, mark, **options)
    for panel, what in zip(axes, ("the replay", "boosting"), strict=True):
        panel.axvline(0, color=BLACK, linewidth=0.8)
        panel.set(
            title=f"What {what} adds", xlabel="part of the span from random to best"
        )
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=2)
    axes[0].set_yticks(
        range(len(effects)), [label(study) for study in reversed(effects)]
    )
    return figure

"""Every picture. Nothing here computes more than it shows."""

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from . import stats
from .agents import AGENTS, BLUE, ORANGE
from .files import write_atomically
from .schedule import LABELS, describe

SMOOTHING = 15


def learning_curves(runs, config, random_return, path):
    """Return per episode of each agent in {agent: records}, as points and trailing means, with the
    drifts marked.
    """
    figure = Figure(figsize=(10, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for agent, records in runs.items():
        episode, returns = np.array([(record["episode"], record["return"]) for record in records]).T
        axes.plot(
            episode,
            returns,
            AGENTS[agent].mark,
            color=AGENTS[agent].colour,
            markersize=3,
            alpha=0.35,
            markeredgewidth=0,
        )
        smooth = stats.trailing_mean(returns, SMOOTHING)
        look = dict(color=AGENTS[agent].colour, linestyle=AGENTS[agent].line, linewidth=2.2)
        axes.plot(episode[SMOOTHING - 1 :], smooth, **look, label=AGENTS[agent].label)
    axes.axhline(random_return, color="0.45", linewidth=1.2, linestyle=":", label="random policy")
    _mark_regimes(axes, config)
    axes.set(
        xlabel="episode", ylabel=f"return (points: episodes, lines: mean of the last {SMOOTHING})"
    )
    title = f"{LABELS[config.env]}, seed {config.seed}: the physics change at the dashed lines"
    axes.set_title(title, loc="left", pad=34)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    save(figure, path)


def study_curves(runs, config, random_return, path):
    """A panel per agent of {agent: [records per seed]}: every seed, their mean, and its bootstrap
    interval.
    """
    rows, columns = -(-len(runs) // 3), min(3, len(runs))
    figure = Figure(figsize=(12, 0.9 + 2.7 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    smooth = {agent: _smoothed(records) for agent, records in runs.items()}
    episode, rng = np.arange(SMOOTHING - 1, config.episodes), np.random.default_rng(0)
    for axes, (agent, curves) in zip(panels, smooth.items(), strict=False):
        colour, middle = AGENTS[agent].colour, curves.mean(0)
        axes.plot(episode, curves.T, color=colour, linewidth=0.6, alpha=0.5)
        draws = curves[rng.integers(len(curves), size=(500, len(curves)))].mean(1)
        axes.fill_between(
            episode,
            *np.quantile(draws, [0.025, 0.975], axis=0),
            color=colour,
            alpha=0.25,
            linewidth=0,
        )
        axes.plot(episode, middle, color=colour, linewidth=2)
        if "dqn" in smooth and agent != "dqn":
            axes.plot(episode, smooth["dqn"].mean(0), color="0.2", linewidth=1, linestyle=":")
        axes.axhline(random_return, color="0.45", linewidth=1, linestyle="--")
        for regime in config.regimes[1:]:
            axes.axvline(regime.start, color="0.6", linewidth=0.8)
        axes.set_title(AGENTS[agent].label, loc="left", fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[len(runs) :]:
        axes.set_visible(False)
    for axes in panels[max(0, len(runs) - columns) : len(runs)]:
        axes.tick_params(labelbottom=True)
    figure.supxlabel("episode; the physics change at the upright lines", fontsize=10)
    figure.supylabel(f"return, mean of the last {SMOOTHING}", fontsize=10)
    what = (
        "thin: seeds, thick: their mean, band: 95 % bootstrap; dotted: DQN's mean, dashed: random"
        " policy"
    )
    figure.suptitle(f"{LABELS[config.env]} — {what}", fontsize=10, x=0.01, ha="left")
    save(figure, path)


def adaptation(summaries, config, path):
    """Recovery and area after each drift of {agent: [summary per seed]}: every seed, and the median
    of each agent.
    """
    regimes = config.regimes[1:]
    agents = [agent for agent in summaries if agent != "random"]
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True)
    never = 1.15 * max(regime.end - regime.start for regime in regimes)
    for k, agent in enumerate(agents):
        rows = list(zip(*(run["regimes"][1:] for run in summaries[agent]), strict=True))
        for axes, key, censored in ((above, "recovery", never), (below, "area", np.nan)):
            values = np.array(
                [[censored if run[key] is None else run[key] for run in regime] for regime in rows]
            )
            x = np.arange(len(rows)) + (k + 0.5) / len(agents) * 0.8 - 0.4
            axes.plot(
                x,
                values,
                ".",
                color=AGENTS[agent].colour,
                alpha=0.4,
                markersize=6,
                markeredgewidth=0,
            )
            axes.plot(
                x,
                np.median(values, 1),
                AGENTS[agent].mark,
                color=AGENTS[agent].colour,
                markersize=7,
                label=AGENTS[agent].label,
            )
    above.axhline(never, color="0.7", linewidth=0.8, zorder=0)
    above.text(len(regimes) - 0.5, never, "never ", ha="right", va="bottom", color="0.4")
    above.set(ylabel="recovery, episodes", ylim=(0, 1.1 * never))
    below.axhline(1, color="0.7", linewidth=0.8, zorder=0)
    below.set(ylabel="area (0: random, 1: as before)", xlim=(-0.5, len(regimes) - 0.5))
    labels = [
        ("reset: " if regime.event == "reset" else "") + describe(regime.factors, "\n")
        for regime in regimes
    ]
    below.set_xticks(range(len(regimes)), labels)
    for axes in (above, below):
        axes.spines[["top", "right"]].set_visible(False)
    above.set_title(
        f"{LABELS[config.env]}, after each drift: dots are seeds, marks their medians", loc="left"
    )
    handles, names = above.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    save(figure, path)


def value_maps(before, after, m):
    """Q_{m−1} (n, n, 3), what the booster adds, and Q_m over MountainCar's plane (watch.plane),
    above their policies.

    Above: the values max_a Q, and what is added to the action that Q_m prefers. Below: the greedy
    actions, and where the booster changed them. Returns the figure.
    """
    figure = Figure(figsize=(10, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    (top, bottom), greedy = figure.subplots(2, 3, sharex=True, sharey=True), after.argmax(-1)
    added = np.take_along_axis(after - before, greedy[..., None], -1)[..., 0]
    low, high = min(before.max(-1).min(), after.max(-1).min()), max(before.max(), after.max())
    size = np.abs(added).max()
    look = dict(
        origin="lower", extent=(-1.2, 0.6, -0.07, 0.07), aspect="auto", interpolation="nearest"
    )
    value = dict(cmap="viridis", vmin=low, vmax=high)
    change = dict(cmap="PuOr", vmin=-size, vmax=size)
    titles = (
        f"$\\max_a\\, Q_{m - 1}$",
        f"$\\alpha\\, h_{m}$, at $Q_{m}$'s action",
        f"$\\max_a\\, Q_{m}$",
    )
    pictures = zip(
        top, titles, (before.max(-1), added, after.max(-1)), (value, change, value), strict=True
    )
    for axes, title, picture, colours in pictures:
        figure.colorbar(axes.imshow(picture, **look, **colours), ax=axes)
        axes.set_title(title, loc="left")
    actions = dict(cmap=ListedColormap([BLUE, "0.9", ORANGE]), vmin=0, vmax=2)
    bottom[0].imshow(before.argmax(-1), **look, **actions)
    bottom[1].imshow(greedy != before.argmax(-1), **look, cmap="Greys", vmin=0, vmax=1)
    bottom[2].imshow(greedy, **look, **actions)
    what = (f"greedy in $Q_{m - 1}$", "where that changed (black)", f"greedy in $Q_{m}$")
    for axes, title in zip(bottom, what, strict=True):
        axes.set_title(title, loc="left")
        axes.set_xlabel("position")
    for row in (top, bottom):
        row[0].set_ylabel("velocity, per step")
    handles = [
        Patch(color=actions["cmap"](i), label=name)
        for i, name in enumerate(("left", "coast", "right"))
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _smoothed(records):
    """Trailing means of the returns (seeds, episodes − SMOOTHING + 1)."""
    return np.array(
        [
            stats.trailing_mean(np.array([each["return"] for each in run]), SMOOTHING)
            for run in records
        ]
    )


def forest(final, path):
    """Final returns minus DQN's on the same seeds, {agent: (seeds,)}: every pair, their IQM and its
    interval.
    """
    others = [agent for agent in final if agent != "dqn"]
    figure = Figure(figsize=(8, 1.2 + 0.45 * len(others)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.axvline(0, color="0.25", linewidth=1)
    for y, agent in enumerate(reversed(others)):
        middle, low, high = stats.paired_difference(
            final[agent], final["dqn"], np.random.default_rng(0)
        )
        difference = np.asarray(final[agent]) - final["dqn"]
        axes.plot(
            difference,
            np.full(len(difference), y),
            "o",
            color=AGENTS[agent].colour,
            alpha=0.5,
            markersize=4,
        )
        axes.plot([low, high], [y, y], color=AGENTS[agent].colour, linewidth=2)
        axes.plot(middle, y, AGENTS[agent].mark, color=AGENTS[agent].colour, markersize=8)
    axes.set_yticks(range(len(others)), [AGENTS[agent].label for agent in reversed(others)])
    axes.set_xlabel(
        "final return minus DQN's (dots: seeds; mark and bar: IQM and 95 % bootstrap interval)"
    )
    axes.spines[["top", "right"]].set_visible(False)
    save(figure, path)


def save(figure, path):
    """Write a figure as a PNG, atomically."""
    picture = io.BytesIO()
    figure.savefig(picture, dpi=120, format="png")
    write_atomically(path, lambda file: file.write(picture.getvalue()))


def _mark_regimes(axes, config):
    """Shade the regimes in turn, and say above each what is not as in the stock physics."""
    axes.set_xlim(0, config.episodes)
    for start, end, factors, event in config.regimes:
        if any(factor != 1 for factor in factors.values()):
            axes.axvspan(start, end, color="0.93", zorder=0)
        if start:
            axes.axvline(start, color="0.25", linewidth=1, linestyle="--")
        label = ("reset:\n" if event == "reset" else "") + describe(factors, "\n")
        middle, above = (start + end) / 2, axes.get_xaxis_transform()
        axes.text(middle, 1.01, label, transform=above, ha="center", va="bottom", fontsize=9)

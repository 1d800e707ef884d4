"""Every figure, drawn from stored rows. Nothing here computes more than it shows.

Figures look the same everywhere: they use Matplotlib's defaults, not the user's matplotlibrc. No
window is opened.
"""

import io
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from . import stats
from .agents import AGENTS, BLUE, ORANGE
from .config import Config
from .files import check_picture, write_atomically
from .schedule import LABELS, Regime, describe
from .stats import Rows


@contextmanager
def _any_backend() -> Iterator[None]:
    """Import Matplotlib even if MPLBACKEND names an unknown backend; a known one still applies."""
    name = os.environ.pop("MPLBACKEND", None)
    first = "matplotlib" not in sys.modules
    yield
    if name is not None:
        os.environ["MPLBACKEND"] = name
        with suppress(ValueError):
            matplotlib.rcParams.update({"backend": name} if first else {})


with _any_backend():
    import matplotlib
    from matplotlib import style
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

SMOOTHING = 15  # episodes in the trailing mean
FONT = Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")

Look = dict[str, Any]

# Looks: sizes in inches, points and fractions of the axes; greys and opacities.
plain = partial(style.context, "default")
CURVES, PANEL, AFTER, FOREST, MAPS = (10.0, 5.0), (4.0, 2.6), (10.0, 6.5), (8.0, 0.45), (10.0, 5.2)
NARROW, LINE_HEIGHT, ABOVE, BESIDE = 0.11, 0.055, 1.015, 1.01
LANE, WIDTH = 0.12, 0.8  # of the longest regime; of the room for a regime
GREY, DPI = "0.45", 120
EPISODES: Look = dict(linestyle="", markersize=3, alpha=0.35, markeredgewidth=0)
SEEDS: Look = dict(linestyle="", marker="o", markersize=6, alpha=0.45, markeredgewidth=0)
MEDIANS: Look = dict(linestyle="", markersize=8, markeredgecolor="white", markeredgewidth=0.8)
THICK: Look = dict(linewidth=2.2)
THIN: Look = dict(linewidth=0.6, alpha=0.5)
BAND: Look = dict(alpha=0.25, linewidth=0)
CHANCE: Look = dict(color=GREY, linewidth=1.2, linestyle=":")
RIVAL: Look = dict(color="0.25", linewidth=1.0, linestyle="--")
LEVEL: Look = dict(color="0.7", linewidth=0.8, zorder=0)
START: Look = dict(color="0.25", linewidth=0.8, linestyle="--")
SHADE: Look = dict(color="0.93", zorder=0)
TITLE: Look = dict(fontsize=11)
LABEL: Look = dict(fontsize=10)
REGIME: Look = dict(ha="center", va="bottom", fontsize=9)
COUNT: Look = dict(ha="center", va="bottom", fontsize=9)
END: Look = dict(va="center", fontsize=10)
LEGEND: Look = dict(loc="outside lower center", frameon=False)
PLANE: Look = dict(
    origin="lower", extent=(-1.2, 0.6, -0.07, 0.07), aspect="auto", interpolation="nearest"
)


def learning_curves(runs: Mapping[str, Rows], config: Config, random_return: float) -> Figure:
    """The returns of {agent: records}, as points and trailing means, with the regimes marked."""
    with plain():
        figure = Figure(CURVES, layout="constrained")
        axes = figure.subplots()
        ends = [("random policy", GREY, random_return)]
        for agent, records in runs.items():
            look = AGENTS[agent]
            episode = np.array([record["episode"] for record in records])
            returns = np.array([record["return"] for record in records])
            smooth = stats.trailing_mean(returns, SMOOTHING)
            axes.plot(episode, returns, marker=look.mark, color=look.colour, **EPISODES)
            axes.plot(episode[SMOOTHING - 1 :], smooth, look.line, color=look.colour, **THICK)
            ends.append((look.label, look.colour, [*returns, *smooth][-1]))
        axes.axhline(random_return, **CHANCE)
        axes.set_xlim(0, config.episodes)
        _label_ends(axes, ends)
        _mark_regimes(axes, config)
        _name_regimes(axes, config)
        axes.set(xlabel="episode", ylabel="return")
        figure.suptitle(
            f"{LABELS[config.env]}, seed {config.seed}: episodes, and means of the last"
            f" {SMOOTHING}; grey: drifted physics",
            **TITLE,
        )
    return figure


def study_curves(
    runs: Mapping[str, Sequence[Rows]], config: Config, random_return: float
) -> Figure:
    """A panel per agent of {agent: [records per seed]}: the seeds, their mean and its interval."""
    columns = min(3, len(runs))
    rows = -(-len(runs) // columns)
    smooth = {agent: _smoothed(records) for agent, records in runs.items()}
    episode = np.arange(SMOOTHING - 1, config.episodes)
    with plain():
        figure = Figure((PANEL[0] * columns, PANEL[1] * rows + 1), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for axes, (agent, curves) in zip(panels, smooth.items(), strict=False):
            _seeds_and_mean(axes, episode, curves, AGENTS[agent].colour)
            if "dqn" in smooth and agent != "dqn":
                axes.plot(episode, smooth["dqn"].mean(0), **RIVAL)
            axes.axhline(random_return, **CHANCE)
            axes.set_xlim(0, config.episodes)
            axes.set_title(AGENTS[agent].label, loc="left", color=AGENTS[agent].colour)
            _mark_regimes(axes, config)
        for axes in panels[len(runs) :]:
            axes.set_visible(False)
        for axes in panels[len(runs) - columns : len(runs)]:
            axes.tick_params(labelbottom=True)
        figure.supxlabel("episode (grey: drifted physics)", **LABEL)
        figure.supylabel(f"return, mean of the last {SMOOTHING}", **LABEL)
        figure.suptitle(
            f"{LABELS[config.env]}: seeds (thin), their mean (thick), its 95 % bootstrap interval"
            " (band);\nDQN's mean (dashed), the random policy (dotted)",
            **TITLE,
        )
    return figure


def adaptation(summaries: Mapping[str, Rows], config: Config) -> Figure:
    """Recovery and area after each drift of {agent: summaries}: every seed, and the medians.

    A seed that never recovers is drawn above all others. A seed with nothing to lose is not drawn:
    the number of such seeds stands at the top, and the median is over the others.
    """
    agents = [agent for agent in summaries if agent != "random"]
    longest = max(regime.end - regime.start for regime in config.regimes[1:])
    never = (1 + LANE) * longest
    with plain():
        figure = Figure(AFTER, layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(5, 4))
        for k, agent in enumerate(agents):
            for drift in range(1, len(config.regimes)):
                x = drift + ((k + 0.5) / len(agents) - 0.5) * WIDTH
                rows = [run["regimes"][drift] for run in summaries[agent]]
                _after_drift(above, below, x, agent, rows, never)
        above.axhline(never, **LEVEL)
        below.axhline(1, **LEVEL)
        below.axhline(0, **LEVEL)
        above.set(ylabel="recovery (episodes)", ylim=(0, (1 + 2 * LANE) * longest))
        ticks = [tick for tick in above.get_yticks() if tick <= longest]
        above.set_yticks([*ticks, never], [*(f"{tick:g}" for tick in ticks), "never"])
        below.set(ylabel="area (0: random, 1: as before)", xlim=(0.5, len(config.regimes) - 0.5))
        names = [_name(regime) for regime in config.regimes[1:]]
        below.set_xticks(range(1, len(config.regimes)), names)
        for axes in (above, below):
            axes.spines[["top", "right"]].set_visible(False)
        figure.suptitle(
            f"{LABELS[config.env]}, after each drift: seeds (dots) and their medians (marks);\n"
            "numbers at the top: seeds with nothing to lose, whose recovery is undefined",
            **TITLE,
        )
        marks = [_mark(agent) for agent in agents]
        figure.legend(handles=marks, ncols=min(5, len(agents)), **LEGEND)
    return figure


def forest(summaries: Mapping[str, Rows], config: Config) -> Figure:
    """Final returns minus DQN's on the same seeds: every pair, their IQM and its interval."""
    others = [agent for agent in reversed(list(summaries)) if agent != "dqn"]
    with plain():
        figure = Figure((FOREST[0], FOREST[1] * (len(others) + 3)), layout="constrained")
        axes = figure.subplots()
        axes.axvline(0, **LEVEL)
        for y, agent in enumerate(others):
            ours, theirs = stats.same_seeds(summaries[agent], summaries["dqn"])
            difference, look = ours - theirs, AGENTS[agent]
            middle, low, high = stats.paired_difference(ours, theirs, np.random.default_rng(0))
            axes.plot(difference, [y] * len(difference), color=look.colour, **SEEDS)
            if len(difference) > 1:
                axes.plot([low, high], [y, y], color=look.colour, **THICK)
            axes.plot([middle], [y], marker=look.mark, color=look.colour, **MEDIANS)
        axes.set_yticks(range(len(others)), [AGENTS[agent].label for agent in others])
        axes.set(xlabel="final return minus DQN's", ylim=(-0.6, len(others) - 0.4))
        axes.spines[["top", "right"]].set_visible(False)
        figure.suptitle(
            f"{LABELS[config.env]}: seeds (dots), their IQM (mark), its 95 % bootstrap interval"
            " (bar)",
            **TITLE,
        )
    return figure


def value_maps(before: np.ndarray, after: np.ndarray, m: int) -> Figure:
    """Q_{m−1} and Q_m (n, n, 3) over MountainCar's plane (watch.plane), and what the booster adds.

    Top row: the values max_a Q, and what the booster adds to the greedy action of Q_m. Bottom row:
    the greedy actions, and where the booster changes them.
    """
    greedy = after.argmax(-1)
    added = np.take_along_axis(after - before, greedy[..., None], -1)[..., 0]
    low, high = min(before.max(-1).min(), after.max(-1).min()), max(before.max(), after.max())
    size = np.abs(added).max()
    value: Look = dict(cmap="viridis", vmin=low, vmax=high)
    change: Look = dict(cmap="PuOr", vmin=-size, vmax=size)
    actions: Look = dict(cmap=ListedColormap([BLUE, "0.9", ORANGE]), vmin=0, vmax=2)
    changed: Look = dict(cmap="Greys", vmin=0, vmax=1)
    pictures = [
        (f"$\\mathrm{{max}}_a\\, Q_{{{m - 1}}}$", before.max(-1), value),
        (f"$\\alpha\\, h_{{{m}}}$, at $Q_{{{m}}}$'s greedy action", added, change),
        (f"$\\mathrm{{max}}_a\\, Q_{{{m}}}$", after.max(-1), value),
        (f"greedy action of $Q_{{{m - 1}}}$", before.argmax(-1), actions),
        ("changed (black)", greedy != before.argmax(-1), changed),
        (f"greedy action of $Q_{{{m}}}$", greedy, actions),
    ]
    with plain():
        figure = Figure(MAPS, layout="constrained")
        panels = figure.subplots(2, 3, sharex=True, sharey=True)
        for axes, (title, picture, colours) in zip(panels.flat, pictures, strict=True):
            image = axes.imshow(picture, **PLANE, **colours)
            axes.set_title(title, loc="left")
            if axes in panels[0]:
                figure.colorbar(image, ax=axes)
        for axes in panels[1]:
            axes.set_xlabel("position")
        for axes in panels[:, 0]:
            axes.set_ylabel("velocity per step")
        named = zip(actions["cmap"].colors, ("left", "coast", "right"), strict=True)
        handles = [Patch(color=colour, label=name) for colour, name in named]
        figure.legend(handles=handles, ncols=3, **LEGEND)
    return figure


def save(figure: Figure, path: Path | str) -> None:
    """Write a figure as a PNG, atomically; a missing folder is made."""
    check_picture(path, ".png")
    picture = io.BytesIO()
    with plain():
        figure.savefig(picture, dpi=DPI, format="png")
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: file.write(picture.getvalue()))


def _smoothed(runs: Sequence[Rows]) -> np.ndarray:
    """The trailing means of the returns, (seeds, episodes − SMOOTHING + 1)."""
    returns = np.array([[record["return"] for record in records] for records in runs])
    return np.array([stats.trailing_mean(each, SMOOTHING) for each in returns])


def _seeds_and_mean(axes: Axes, episode: np.ndarray, curves: np.ndarray, colour: str) -> None:
    """Each curve of (seeds, episodes), their mean, and its interval if there are several."""
    axes.plot(episode, curves.T, color=colour, **THIN)
    axes.plot(episode, curves.mean(0), color=colour, **THICK)
    if len(curves) > 1:
        rng = np.random.default_rng(0)
        means = curves[rng.integers(len(curves), size=(500, len(curves)))].mean(1)
        low, high = np.quantile(means, [0.025, 0.975], axis=0)
        axes.fill_between(episode, low, high, color=colour, **BAND)


def _after_drift(above: Axes, below: Axes, x: float, agent: str, rows: Rows, never: float) -> None:
    """One agent's recoveries and areas after one drift, at x."""
    colour, mark = AGENTS[agent].colour, AGENTS[agent].mark
    defined = [row for row in rows if row["area"] is not None]
    medians = stats.regime_medians(rows)
    if medians["undefined"]:
        place, count = above.get_xaxis_transform(), str(medians["undefined"])
        above.text(x, 1, count, transform=place, color=colour, **COUNT)
    for axes, key in ((above, "recovery"), (below, "area")):
        heights = [never if row[key] is None else row[key] for row in defined]
        axes.plot([x] * len(heights), heights, color=colour, **SEEDS)
        if defined:
            middle = never if medians[key] is None else medians[key]
            axes.plot([x], [middle], marker=mark, color=colour, **MEDIANS)


def _mark(agent: str) -> Line2D:
    """An agent's entry in a legend."""
    look = AGENTS[agent]
    return Line2D([], [], marker=look.mark, color=look.colour, label=look.label, **MEDIANS)


def _mark_regimes(axes: Axes, config: Config) -> None:
    """Shade the drifted regimes, and draw a line where a regime begins."""
    for regime in config.regimes:
        if regime.drifted:
            axes.axvspan(regime.start, regime.end, **SHADE)
        if regime.start:
            axes.axvline(regime.start, **START)
    axes.spines[["top", "right"]].set_visible(False)


def _name_regimes(axes: Axes, config: Config) -> None:
    """Write above each regime how its physics differ from the stock ones."""
    narrowest = min(regime.end - regime.start for regime in config.regimes) / config.episodes
    turned = 90 if narrowest < NARROW else 0
    place = axes.get_xaxis_transform()
    for regime in config.regimes:
        middle = (regime.start + regime.end) / 2
        axes.text(middle, ABOVE, _name(regime), transform=place, rotation=turned, **REGIME)


def _name(regime: Regime) -> str:
    return ("reset:\n" if regime.event == "reset" else "") + describe(regime.factors, "\n")


def _label_ends(axes: Axes, ends: Sequence[tuple[str, str, float]]) -> None:
    """Write names beside the right ends of curves, (name, colour, height) each, moved apart."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high)
    heights = (np.array([height for _, _, height in ends]) - low) / (high - low)
    for (name, colour, _), height in zip(ends, apart(heights), strict=True):
        axes.text(BESIDE, height, name, color=colour, transform=axes.transAxes, **END)


def apart(heights: np.ndarray, line: float = LINE_HEIGHT) -> np.ndarray:
    """The heights, with overlapping neighbours moved apart equally until a line of text fits."""
    placed, order = heights.copy(), np.argsort(heights, kind="stable")
    for _ in range(100):
        for below, above in pairwise(order):
            overlap = max(0.0, placed[below] + line - placed[above])
            placed[below] -= overlap / 2
            placed[above] += overlap / 2
    return placed

"""The pictures of the study: whole runs, and the episodes around each reversal of a motor."""

import io
from functools import partial

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from gbdqn_ref import files, plots, stats
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.schedule import LABELS
from gbdqn_ref.stats import EDGE, WINDOW

LINE = 0.075  # the height of a name in the picture, as a share of its panel's
NAME = {"va": "center", "fontsize": 9}
COLOURS = 32  # of the picture, which so takes a quarter of the bytes
DRAWN = {  # arm: its name in the picture, and its line
    "dqn": ("DQN", "-"),
    "gbdqn": ("GB-DQN (paper)", "-"),
    "sliding": ("Sliding-DQN", ":"),
    "dqn-detected": ("DQN, data dropped", "--"),
    "twin": ("DQN-reuse, Adam kept", "-."),
    "reuse": ("GB-DQN-reuse", "-."),
}


def drawn(study):
    """{task: arms that can be drawn} of the tasks that have most of them.

    An exploratory protocol, without hypotheses, has no pictures.
    """
    if not study.protocol.hypotheses:
        return {}
    found = {
        task: [arm for arm in DRAWN if study.curves(task, arm)] for task in study.tasks("oracle")
    }
    most = max(map(len, found.values()), default=0)
    return {task: arms for task, arms in found.items() if most and len(arms) == most}


def picture(study):
    """A row per task with drifts: learning curves, and the share of runs above each return."""
    tasks = drawn(study)
    with plots.plain():
        figure = Figure((10.0, 2.8 * len(tasks)), layout="constrained")
        panels = figure.subplots(len(tasks), 2, width_ratios=(4, 1), squeeze=False)
        for task, (left, right) in zip(tasks, panels, strict=True):
            arms = tasks[task]
            config = study.config(task, arms[0])
            for regime in config.regimes:
                if regime.drifted:
                    left.axvspan(regime.start, regime.end, **plots.SHADE)
            ends = [curves(study, task, arm, left, right) for arm in arms]
            low, high = left.get_ylim()
            left.set(xlim=(0, config.episodes), ylim=(low, high), ylabel="return")
            heights = plots.apart((np.array(ends) - low) / (high - low), LINE)
            for arm, height in zip(arms, heights, strict=True):
                name, place = DRAWN[arm][0], {"transform": left.transAxes}
                sample = look(study, arm) | {"clip_on": False}
                left.plot([1.01, 1.045], [height, height], **sample, **place)
                left.text(1.055, height, name, color=colour(study, arm), **NAME, **place)
            left.set_title(LABELS[config.env], loc="left", fontsize=11)
            right.set_title("runs above", loc="left", fontsize=10)
            right.set(ylim=(0, 1))
            right.yaxis.set_major_formatter("{x:.0%}")
            for axes in (left, right):
                axes.spines[["top", "right"]].set_visible(False)
        left.set_xlabel(f"episode (grey: drifted physics); means of the last {WINDOW}")
        right.set_xlabel("mean return")
    return figure


def around(study):
    """A row per task, a panel per arm: every seed's returns around the reversals, and their IQM."""
    tasks = drawn(study)
    width = max(map(len, tasks.values()))
    with plots.plain():
        figure = Figure((11.0, 2.2 * len(tasks)), layout="constrained")
        rows = figure.subplots(len(tasks), width, sharex=True, sharey="row", squeeze=False)
        for (task, arms), row in zip(tasks.items(), rows, strict=True):
            for arm, axes in zip(arms, row, strict=True):
                episode, returns = aligned(study, task, arm)
                axes.plot(episode, returns.T, color=colour(study, arm), linewidth=0.5, alpha=0.4)
                axes.plot(episode, stats.iqm(returns, axis=0), color="black", linewidth=1.5)
                axes.axvline(0, color="0.5", linewidth=0.8)
                axes.spines[["top", "right"]].set_visible(False)
                if task == next(iter(tasks)):
                    axes.set_title(DRAWN[arm][0], loc="left", fontsize=10)
            row[0].set_ylabel(f"{LABELS[study.config(task, arms[0]).env]}: return")
        figure.supxlabel("episodes since the motor was reversed", fontsize=10)
    return figure


def aligned(study, task, arm):
    """(episodes since a reversal, each seed's mean return over its reversals (seeds, episodes))."""
    config = study.config(task, arm)
    starts = [regime.start for regime in config.regimes[1:] if regime.drifted]
    episode = np.arange(-EDGE, min(3 * EDGE, config.episodes - max(starts)))
    returns = [
        np.mean([x[start + episode] for start in starts], axis=0)
        for x in study.curves(task, arm).values()
    ]
    return episode, np.array(returns)


def curves(study, task, arm, left, right):
    """Draw an arm: every seed and their IQM, and its performance profile; the height of its end."""
    smooth = np.array([stats.trailing_mean(x, WINDOW) for x in study.curves(task, arm).values()])
    thick = stats.iqm(smooth, axis=0)
    episode = np.arange(WINDOW - 1, WINDOW - 1 + len(thick))
    left.plot(episode, smooth.T, color=colour(study, arm), linewidth=0.4, alpha=0.12)
    left.plot(episode, thick, **look(study, arm), **plots.THICK)
    values = np.sort(study.values(task, arm)[0])
    above = 1 - np.arange(len(values) + 1) / len(values)
    right.step([*values, values[-1]], above, where="pre", **look(study, arm))
    return thick[-1]


def look(study, arm):
    """The colour and the line of an arm."""
    return {"color": colour(study, arm), "linestyle": DRAWN[arm][1]}


def colour(study, arm):
    """The colour of an arm's agent."""
    return AGENTS[study.protocol.arms[arm]["agent"]].colour


PICTURES = {"keep": picture, "drifts": around}


def write(study, folder):
    """Write the pictures, if an arm can be drawn."""
    for name, draw in PICTURES.items() if drawn(study) else ():
        drawing = io.BytesIO()
        with plots.plain():
            draw(study).savefig(drawing, dpi=plots.DPI)
        few = Image.open(drawing).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        save = partial(few.save, format="png", optimize=True)
        files.write_atomically(folder / f"{name}.png", save)

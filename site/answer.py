"""The start page's picture: what GB-DQN's replay and its boosting bring in each study."""

import io

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import reruns

from gbdqn_ref.agents import BLUE, VERMILION

LEFT = -6  # a dot further left is a triangle here
LOOK = {"replay": (BLUE, 0.15), "boosting": (VERMILION, -0.15)}  # colour, height in the row


def clear(difference, low, high):
    """A difference in units of its interval's half on the side of 0: beyond ±1 it leaves 0 out.

    >>> clear(4.0, 2.0, 9.0), clear(-1.0, -5.0, 1.0), clear(0.0, 0.0, 3.0)
    (2.0, -0.5, 0.0)
    """
    half = difference - low if difference > 0 else high - difference
    return difference / max(half, 1e-9)


def effects():
    """{study: {ingredient: clear difference}} of the studies of five seeds or more."""
    found = {}
    for study in reruns.STUDIES:
        if len(reruns.stored(study)["seeds"]) >= 5:
            found[reruns.label(study)] = {
                name: clear(*reruns.paired(study, *pair))
                for name, pair in reruns.INGREDIENTS.items()
            }
    return found


def draw():
    """The picture, as SVG."""
    style = {"svg.hashsalt": "gbdqn_ref", "svg.fonttype": "path", "font.size": 11}
    with plt.rc_context(style):
        figure, axes = plt.subplots(figsize=(7.2, 4.2), layout="constrained")
        rows = effects()
        axes.axvspan(-1, 1, color="0.9")
        axes.axvline(0, color="0.5", linewidth=1)
        for k, study in enumerate(rows):
            for name, x in rows[study].items():
                colour, above = LOOK[name.split(",")[0]]
                own = "GB-DQN" in name or "own" in name
                look = dict(color=colour, mfc=colour if own else "white", ms=9, mew=2)
                axes.plot(max(x, LEFT), above - k, "<" if x < LEFT else "o", **look)
        for word, (colour, _) in LOOK.items():
            axes.plot([], [], "o", color=colour, ms=9, label=word)
        axes.plot([], [], "o", color="black", mfc="white", ms=9, mew=2, label="added to DQN")
        axes.plot([], [], "o", color="black", ms=9, label="added beside the other")
        axes.set_yticks(range(0, -len(rows), -1), rows)
        axes.set_xlim(LEFT - 0.5, 4)
        words = ["detectably worse", "no difference\ndetected", "detectably better"]
        axes.set_xticks([-3.5, 0, 2.5], words)
        axes.tick_params(length=0)
        axes.spines[["top", "right", "left"]].set_visible(False)
        figure.legend(
            loc="outside upper center", ncols=4, frameon=False, handletextpad=0, columnspacing=1
        )
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
        plt.close(figure)
    return text.getvalue().encode()

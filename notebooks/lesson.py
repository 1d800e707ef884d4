"""What all notebooks share: the corridor, the source, pictures and reading times."""

import inspect
import io
import os
import re
from html import escape
from math import ceil
from pathlib import Path
from textwrap import dedent

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import Markdown, display
from matplotlib.text import Text

from gbdqn_ref.agents import AGENTS, OKABE_ITO
from gbdqn_ref.tabular import MDP

ROOT = Path(__file__).parent.parent
FAST = os.environ.get("NOTEBOOKS") == "fast"  # in tests: shorter runs, the same cells
BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK = OKABE_ITO
COLOUR = {name: agent.colour for name, agent in AGENTS.items()}
FROZEN, LEARNER = (
    "#767676",
    "#882255",
)  # what is kept, and what learns; no agent has these
SMALLEST_TEXT = 9  # pt
LARGEST_SVG = 100_000  # bytes
ROOMS, GAMMA = 10, 0.9
LEFT, RIGHT = 0, 1

plt.rcParams.update(
    {
        "figure.figsize": (7, 3),
        "figure.dpi": 100,
        "figure.facecolor": "white",
        "figure.constrained_layout.use": True,
        "font.size": 10,
        "axes.titlesize": 10,
        "axes.labelsize": 10,
        "xtick.labelsize": 9,
        "ytick.labelsize": 9,
        "legend.fontsize": 9,
        "axes.prop_cycle": plt.cycler(color=OKABE_ITO),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlelocation": "left",
        "legend.frameon": False,
        "svg.hashsalt": "gbdqn_ref",
    }
)


# The world


def step(room, action, goal):
    """Walk one room: (next room, reward, terminated).

    Every step costs 1; reaching the goal ends the episode.

    >>> step(8, RIGHT, goal=9), step(0, LEFT, goal=9)
    ((9, -1.0, True), (0, -1.0, False))
    """
    room2 = min(max(room + (1 if action == RIGHT else -1), 0), ROOMS - 1)
    return room2, -1.0, room2 == goal


def corridor(goal, gamma=GAMMA):
    """The same world as an MDP. The goal is terminal: its row of Q is 0.

    A Q that was learnt for another goal needs Q[goal] = 0 before a backup, or the old
    value of that room stands for the end.

    >>> corridor(9).q_star()[8].round(2).tolist()
    [-2.71, -1.0]
    """
    P, r = np.zeros((ROOMS, 2, ROOMS)), np.zeros((ROOMS, 2))
    for room, action in np.ndindex(ROOMS, 2):
        room2, reward = (room, 0.0) if room == goal else step(room, action, goal)[:2]
        P[room, action, room2], r[room, action] = 1, reward
    return MDP(P, r, gamma)


def correct_rooms(Q, goal):
    """In how many of the nine other rooms the way to the goal has the larger Q.

    >>> correct_rooms(corridor(9).q_star(), 9), correct_rooms(corridor(9).q_star(), 0)
    (9, 0)
    """
    rooms = np.delete(np.arange(ROOMS), goal)
    way = np.where(rooms < goal, RIGHT, LEFT)
    return int((Q[rooms, way] > Q[rooms, 1 - way]).sum())


# What a page shows


def source(*things):
    """Show the source of functions, methods or classes, as the package has it."""
    for thing in things:
        name = f"{thing.__module__}.{thing.__qualname__}"
        display(
            Markdown(
                f"`{name}`\n```python\n{dedent(inspect.getsource(thing)).rstrip()}\n```"
            )
        )


def show(figure, alt, png=False):
    """Show a picture with its alt text, as SVG or, if that is too large, as PNG."""
    for text in figure.findobj(Text):
        if (
            text.get_text()
            and text.get_visible()
            and text.get_fontsize() < SMALLEST_TEXT
        ):
            raise ValueError(f"text of {text.get_fontsize():g} pt: {text.get_text()!r}")
    kind, data = (
        ("image/png", png_bytes(figure)) if png else ("image/svg+xml", svg(figure, alt))
    )
    plt.close(figure)
    if len(data) > LARGEST_SVG and not png:
        raise ValueError(f"an SVG of {len(data):,} bytes: show(..., png=True)")
    display({kind: data, "text/plain": alt}, raw=True, metadata={kind: {"alt": alt}})


def svg(figure, alt):
    """The figure as an SVG element; the same figure gives the same bytes."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    text = text[text.index("<svg") :].replace(
        ">", f">\n <title>{escape(alt)}</title>", 1
    )
    return text.replace("<svg", '<svg role="img"', 1)


def png_bytes(figure):
    """The figure as a PNG with twice the pixels."""
    file = io.BytesIO()
    figure.savefig(
        file,
        format="png",
        dpi=2 * plt.rcParams["figure.dpi"],
        metadata={"Software": None},
    )
    return file.getvalue()


# How long a page takes


def minutes(notebook):
    """The reading time of a rendered notebook, in whole minutes.

    200 words or 15 lines of code a minute, and a minute for each displayed equation
    and each picture. What is folded or printed does not count. The code of an answer
    does, since it is there to be opened.
    """
    words = lines = shown = 0
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            found = _reading(cell.source)
        elif "checks" in cell.metadata.get("tags", []):
            continue
        else:
            outputs = [output.get("data", {}) for output in cell.get("outputs", ())]
            listings = [_reading(data.get("text/markdown", "")) for data in outputs]
            pictures = sum(
                any(kind.startswith("image/") for kind in data) for data in outputs
            )
            found = np.sum([*listings, (0, _filled(cell.source), pictures)], axis=0)
        words, lines, shown = np.add((words, lines, shown), found)
    return ceil(words / 200 + lines / 15 + shown)


def _reading(text):
    """(words, lines of code, displayed equations) of Markdown that lies open."""
    text = re.sub(r"<details>.*?</details>", "", text, flags=re.S)
    blocks = re.findall(r"```\w*\n(.*?)```", text, flags=re.S)
    text = re.sub(r"```.*?```", "", text, flags=re.S)
    equations = len(re.findall(r"\$\$.*?\$\$", text, flags=re.S))
    text = re.sub(r"\$\$.*?\$\$", "", text, flags=re.S)
    return len(re.findall(r"\w[^\s|]*", text)), sum(map(_filled, blocks)), equations


def _filled(text):
    """How many lines are not empty."""
    return sum(bool(line.strip()) for line in text.splitlines())

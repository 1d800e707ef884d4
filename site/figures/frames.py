"""The live figures as HTML: numbers and pictures from the package, without a running script.

    python site/figures/frames.py FOLDER    writes a page for each, to be opened from the disk

Letters: N capacity, Q the value of the one state in the replay's figure.
"""

import json
import re
import shutil
import sys
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parents[1] / "notebooks"))  # where lesson and pictures are
sys.path.insert(0, str(FOLDER))

import learning_curves  # noqa: E402
from lesson import FROZEN, GAMMA, LEARNER, svg  # noqa: E402
from pictures import theorem_1  # noqa: E402
from pictures.instrument import RIGHT_WAY, boosted, instrument, right_rooms  # noqa: E402

from gbdqn_ref.__main__ import Parser, program  # noqa: E402
from gbdqn_ref.bellman import td_target  # noqa: E402
from gbdqn_ref.boosting import closed_form_alpha  # noqa: E402
from gbdqn_ref.config import Config  # noqa: E402
from gbdqn_ref.files import write_atomically  # noqa: E402
from gbdqn_ref.replay import RecencyReplay  # noqa: E402

FIGURES = "rooms", "parabola", "replay", "curves", "theorem"
FILES = "figures.css", "live.js", *(f"{name}.js" for name in FIGURES)
CLAIM = re.compile(r"\{([A-Z]\d*(?:-[a-z])?\d*|Eq\. \d+)\}")
OLD, NEW = "#B35900", "#0060A0"  # data of the two worlds


def percent(share):
    return f"{100 * share:.0f}\u00a0%"


def slider(key, values, value):
    """What a slider of these values needs in the HTML."""
    listed = " ".join(f"{each:g}" for each in values)
    return {
        f"{key}_values": listed,
        f"last_{key}": len(values) - 1,
        f"open_{key}": values.index(value),
    }


# Ten rooms

GAMMAS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)


def boosts_needed(**reading):
    """How many perfect boosters turn all nine rooms."""
    mdp, path = boosted(30, **reading)
    return [right_rooms(mdp, Q) for Q in path].index(9)


def rooms():
    """(what the text needs, what the script needs, the pictures)."""
    slow, fast = boosts_needed(target="frozen"), boosts_needed(target="live")
    pictures = [
        (instrument(5), "Five boosts with a frozen target: four of nine rooms go the right way."),
        (instrument(1, target="live"), "One boost with a live target: all nine do."),
    ]
    text = dict(letter=slow, live={1: "one"}[fast]) | slider("gamma", GAMMAS, GAMMA)
    return text, None, pictures


# The parabola


def booster(angle, length):
    """h on two samples, at an angle (in degrees) to the residual (1, 0)."""
    turn = angle * np.pi / 180
    return length * np.array([np.cos(turn), np.sin(turn)])


def squared(alpha, h):
    """Σ (r − α h)² with the residual (1, 0), for one α or for many."""
    return ((np.array([1.0, 0.0]) - np.multiply.outer(alpha, h)) ** 2).sum(-1)


def parabola():
    """(what the text needs, what the script needs, the pictures)."""
    h = booster(60, 1)
    best = closed_form_alpha(np.array([1.0, 0.0]), h)
    assert np.isclose(squared(1, h), 1)  # the text: α = 1 gains nothing
    figure, axes = plt.subplots(figsize=(6, 3))
    alpha = np.linspace(-1, 2, 61)
    axes.plot(alpha, squared(alpha, h), color=FROZEN, linewidth=2)
    axes.axvspan(0, 2 * best, color=RIGHT_WAY, alpha=0.15)
    axes.axhline(1, color="black", linewidth=0.8, linestyle=":")
    axes.plot(best, squared(best, h), "o", color=RIGHT_WAY, markersize=9)
    axes.annotate("A/B", (best, squared(best, h)), (0, 9), textcoords="offset points", ha="center")
    axes.plot(1, squared(1, h), "o", color=LEARNER, markersize=9)
    axes.annotate("2A/B", (1, squared(1, h)), (8, -12), textcoords="offset points")
    axes.set(xlabel="α", ylabel="Σ (r − αh)²", ylim=(0, 3))
    alt = "The squared residual is a parabola in α, lowest at A/B, and 1 again at 2A/B."
    text = dict(best=f"{best:.1f}", gain=percent(1 - squared(best, h)))
    return text, None, [(figure, alt)]


# The replay

N = 10_000
SLIDERS = dict(
    fresh=(0, 10, 30, 100, 300, 1_000, 3_000, 10_000),
    q=(0, 2, 4, 6, 8, 10),
    mix=(0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1),
    rate=(1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2),
    exponent=(0, 0.3, 0.6, 1),
)
EDGES = (0, 1, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 150, 200, 300, 500, 700)
EDGES += (1_000, 1_500, 2_000, 3_000, 5_000, 7_000, 10_000)
TICKS = (0, 10, 100, 1_000, 10_000)


@cache
def buffer():
    """A full ring of N transitions of the one state."""
    replay = RecencyReplay(N, 1)
    for _ in range(N):
        replay.add(0.0, 0, 0.0, 0.0, False)
    return replay


def aged(exponent, fresh, q):
    """The ring after `fresh` transitions with the new reward, 1, and the priorities of Q = q."""
    replay, slots = buffer(), np.arange(N)
    replay.priority_exponent = exponent
    r = (replay.age(slots) < fresh).astype(float)
    delta = td_target(r, np.zeros(N, bool), np.full((N, 1), float(q)), GAMMA) - q
    replay.update_priorities(slots, delta)
    return replay


def probabilities(replay, mix, rate):
    """P of each transition by age, newest first."""
    replay.mix, replay.recency_rate = mix, rate
    return replay.probabilities()[::-1]


def stale(fresh, q, mix, rate, exponent):
    """The share of the draws that is from before the drift."""
    return float(probabilities(aged(exponent, fresh, q), mix, rate)[fresh:].sum())


def replay():
    """(what the text needs, what the script needs, the pictures)."""
    config, fresh = Config(), 1_000
    settings = dict(mix=0.5, rate=1e-2, exponent=0.6)
    keys = dict(mix="mix", rate="recency_rate", exponent="priority_exponent")
    frames = dict(capacity=N, gamma=GAMMA, offset=config.priority_offset, edges=EDGES)
    frames |= dict(
        ticks=[(EDGES.index(age), age) for age in TICKS],
        rates=SLIDERS["rate"],
        defaults={key: getattr(config, name) for key, name in keys.items()},
        opening=dict(fresh=fresh, q=10, **settings),
    )
    before, after = (percent(stale(fresh, q=q, **settings)) for q in (0, 10))
    text = dict(mix="½", rate=settings["rate"], fresh=f"{fresh:,}", before=before, after=after)
    for key, values in SLIDERS.items():
        text |= slider(key, values, frames["opening"][key])
    alt = f"Old data get {before} of the draws while Q is old, {after} once it is new."
    return text, frames, [(ageing(fresh, **settings), alt)]


def ageing(fresh, mix, rate, exponent):
    """The mass by age, for the old Q and for the new one."""
    figure, axes = plt.subplots(1, 2, figsize=(7, 3), sharey=True)
    for axis, q in zip(axes, (0, 10), strict=True):
        mass = probabilities(aged(exponent, fresh, q), mix, rate)
        place, bottom = np.arange(len(EDGES) - 1), 0
        age = np.arange(N)
        for part, colour, name in ((age >= fresh, OLD, "old"), (age < fresh, NEW, "new")):
            height = np.histogram(age[part], np.array(EDGES), weights=mass[part])[0]
            axis.bar(place, height, 0.9, bottom, color=colour, label=f"{name} world")
            bottom = bottom + height
        axis.set_title(f"Q = {q}: {percent(mass[fresh:].sum())} of the draws are old")
        axis.set(xticks=[EDGES.index(age) - 0.5 for age in TICKS], xlabel="age in transitions")
        axis.set_xticklabels([f"{age:,}" for age in TICKS])
    axes[0].set_ylabel("probability, by bin")
    axes[0].legend()
    return figure


# Theorem 1

BOOSTS, ASKED, PAPER = 40, 20, dict(gamma=0.99, alpha=0.1)


def squares(gamma, alpha, boosts):
    """Σ of the squared residuals after so many boosters: target fixed, and its own."""
    return (theorem_1.boosted(gamma, alpha, boosts)[-1] ** 2).sum(1)


def theorem():
    """(what the text needs, what the script needs, the pictures)."""
    pictures = []
    for constants in (dict(gamma=GAMMA, alpha=1.0), PAPER):
        fixed, own = squares(**constants, boosts=1)
        alt = "γ = {gamma}, α = {alpha}, one booster: ".format(**constants)
        alt += f"the squared residual goes from 1 to {fixed:.2f} if the target is fixed, "
        alt += f"to {own:.2f} with its own target."
        pictures.append((theorem_1.boosts(**constants, chosen=1), alt))
    fixed, own = squares(GAMMA, 1, 1)
    text = dict(fixed=f"{fixed:.0f}", own=f"{own:.2f}", shown=GAMMA, boosts=BOOSTS, asked=ASKED)
    text |= slider("gamma", GAMMAS, GAMMA) | {f"paper_{k}": x for k, x in PAPER.items()}
    frames = dict(
        boosts=BOOSTS,
        opening=dict(gamma=GAMMA, alpha=1, boosts=1),
        paper=PAPER,
        asked=PAPER | dict(boosts=ASKED),
    )
    return text, frames, pictures


# HTML


def picture(figure, alt):
    """The figure as SVG, the same bytes each time."""
    with plt.rc_context({"svg.hashsalt": "gbdqn_ref"}):
        text = svg(figure, alt)
    plt.close(figure)
    return text


@cache
def parts(name):
    """The figure's HTML with places for claims, with all else filled in."""
    ours = dict(rooms=rooms, parabola=parabola, replay=replay, theorem=theorem)
    return filled(name, *(ours | dict(curves=learning_curves.figure))[name]())


def filled(name, text, frames, pictures):
    """The HTML of a figure with what its text and its script need, and its pictures."""
    html = (FOLDER / f"{name}.html").read_text(encoding="utf-8")
    shown = dict(
        picture="".join(picture(*each) for each in pictures),
        frames=json.dumps(frames, separators=(",", ":")),
    )
    for key, value in (text | shown).items():
        html = html.replace(f"{{{key}}}", str(value))
    return html


def html(name, link=None):
    """A figure to be put into a page; link(name) is the address of a claim or an equation."""
    a = '<a href="{}">{}</a>'
    return CLAIM.sub(lambda m: a.format(link(m[1]), m[1]) if link else m[1], parts(name))


PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{name}</title><link rel="stylesheet" href="figures.css">
<script defer src="live.js"></script><script defer src="{name}.js"></script></head>
<body>{html}</body></html>
"""


def write(folder):
    """Write each figure as a page of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in FILES:
        shutil.copy(FOLDER / file, folder)
    for name in FIGURES:
        page = PAGE.format(name=name, html=html(name)).encode()
        write_atomically(folder / f"{name}.html", lambda file, page=page: file.write(page))


def main(arguments=None):
    """Write the figures into a folder."""
    parser = Parser(description="Write each live figure as a page of its own.")
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where the pages go")
    write(parser.parse_args(arguments).folder)


if __name__ == "__main__":
    program(main)

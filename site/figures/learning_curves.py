"""The learning curves of the study of what to keep, from its stored runs, for the live figure.

Whatever says who is ahead is made here from the runs, so that new runs cannot make it false.
"""

import sys
from functools import cache
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator

sys.path.append(str(Path(__file__).parents[2] / "benchmarks" / "keep"))

import evidence
from drawings import DRAWN, colour
from evidence import interval, signed, words

from gbdqn_ref import stats
from gbdqn_ref.schedule import LABELS
from gbdqn_ref.stats import WINDOW

EVERY = 5  # episodes from point to point
OPENING = "reuse", "gbdqn", "dqn"
_, TWINS = evidence.TWINS  # that detect: reuse without boosters
NAMED = DRAWN | {"twin-adam": ("DQN-reuse", ":")}
ARMS = {arm: NAMED[arm] for arm in (*OPENING, *TWINS, "dqn-detected", "sliding")}
DASHES = {"-": "none", "--": "7 4", "-.": "9 3 2 3", ":": "2 3"}  # of a line's style, as SVG has it
ANSWERS = "with", "without", "undecided"  # which twin may be ahead


@cache
def stored():
    """The study as it is stored."""
    return evidence.stored()


def arms(study):
    """{task: its arms that can be drawn}, where reuse and a twin are complete."""
    found = {
        task: [arm for arm in ARMS if study.curves(task, arm)] for task in study.tasks("oracle")
    }
    return {
        task: there
        for task, there in found.items()
        if any(len(study.complete(task, "reuse", twin)) for twin in TWINS)
    }


def curve(study, task, arm):
    """IQM of the trailing means, and the ends of the middle half of the runs: (3, points)."""
    smooth = [stats.trailing_mean(x, WINDOW)[::EVERY] for x in study.curves(task, arm).values()]
    return np.array([stats.iqm(smooth, axis=0), *np.quantile(smooth, [0.25, 0.75], axis=0)])


def steps(curve):
    """Whole numbers, each as its difference to the one before: short to write, exact to add up.

    >>> steps(np.array([[-200.0, -199.6, -180.2]]))
    [[-200, 0, 20]]
    """
    return np.diff(np.rint(curve).astype(int), prepend=0).tolist()


def drifted(config):
    """[first, last + 1] episode of each stretch under a reversed motor; nothing else drifts."""
    found = [regime for regime in config.regimes if regime.drifted]
    assert {f for regime in found for f in regime.factors.values()} == {1, -1}
    return [[regime.start, regime.end] for regime in found]


def level(study, task, arm):
    """The mean return from the first event on: one number per run."""
    return study.values(task, arm)[0]


def amount(study, task, arm):
    """An arm's level in words."""
    x = level(study, task, arm)
    return signed(f"{ARMS[arm][0]} {stats.iqm(x):.1f} ({len(x)} runs)")


def ranking(study, task, there):
    """The arms that open the figure, the one with the highest level first."""
    known = [arm for arm in OPENING if arm in there]
    return sorted(known, key=lambda arm: -stats.iqm(level(study, task, arm)))


def listed(names):
    """Names in a sentence.

    >>> listed(["A"]), listed(["A", "B", "C"])
    ('A', 'A, B and C')
    """
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def claim(study, tasks):
    """(who earns most where, the levels of each task) in words."""
    ranks = {task: ranking(study, task, there) for task, there in tasks.items()}
    best = {}
    for task, (first, *_) in ranks.items():
        best.setdefault(ARMS[first][0], []).append(LABELS[task])
    levels = [
        f"{LABELS[task]}: {', '.join(amount(study, task, arm) for arm in rank)}."
        for task, rank in ranks.items()
    ]
    leads = "; ".join(f"{name} on {listed(where)}" for name, where in best.items())
    return leads, " ".join(levels)


def answer(study, task, there):
    """What reuse's boosters bring over the better of its twins, and what may be said of it."""
    leads = {arm: study.complete(task, "reuse", arm) for arm in TWINS if arm in there}
    leads = {arm: lead for arm, lead in leads.items() if len(lead)}
    twin, lead = min(leads.items(), key=lambda each: stats.iqm(each[1]))
    low, high = interval(lead)
    right = ANSWERS[0 if low > 0 else 1 if high < 0 else 2]
    end = {
        "with": "The boosters add something.",
        "without": "The boosters cost something.",
        "undecided": "The interval contains 0: no difference is detected.",
    }[right]
    better = "the better twin, " if len(leads) > 1 else ""
    brought = f"Boosters bring {words(lead)} over {better}{ARMS[twin][0]}."
    return dict(right=right, why=f"{brought} {end}")


def frame(study, task, there):
    """What the script needs of a task."""
    config = study.config(task, there[0])
    found = {arm: curve(study, task, arm) for arm in there}
    ends = [extreme(x) for x in found.values() for extreme in (np.min, np.max)]
    return dict(
        episodes=config.episodes,
        drifted=drifted(config),
        ticks=MaxNLocator(4).tick_values(min(ends), max(ends)).tolist(),
        arms={arm: steps(x) for arm, x in found.items()},
        answer=answer(study, task, there),
    )


def buttons(study, there):
    """A switch for each of these arms, with the line that it is drawn with."""
    html = (
        '<button type="button" data-press="{}" aria-pressed="{}" style="--agent: {}; --dashes: {}">'
        '<svg class="sample" viewBox="0 0 34 10" aria-hidden="true"><path d="M0,5H34"/></svg> {}'
        "</button>"
    )
    return " ".join(
        html.format(arm, str(arm in OPENING).lower(), colour(study, arm), DASHES[line], name)
        for arm, (name, line) in ARMS.items()
        if arm in there
    )


def chooser(tasks):
    """A choice of the task, if there is more than one."""
    if len(tasks) == 1:
        return ""
    inputs = "\n".join(
        f'<label><input type="radio" name="live-curves-task" data-key="task" value="{task}"'
        f"{' checked' * (k == 0)}> {LABELS[task]}</label>"
        for k, task in enumerate(tasks)
    )
    return f'<fieldset class="choice"><legend>Task</legend>\n{inputs}</fieldset>'


def picture(study, tasks):
    """The arms that open the figure, a panel for each task."""
    figure, panels = plt.subplots(len(tasks), figsize=(7, 2.6 * len(tasks)), squeeze=False)
    for (task, there), axes in zip(tasks.items(), panels[:, 0], strict=True):
        config = study.config(task, there[0])
        for start, end in drifted(config):
            axes.axvspan(start, end, color="0.9")
        for arm in ranking(study, task, there):
            name, line = ARMS[arm]
            look = dict(color=colour(study, arm), linewidth=2)
            middle, *ends = curve(study, task, arm)
            episode = WINDOW - 1 + EVERY * np.arange(len(middle))
            axes.fill_between(episode, *ends, color=look["color"], alpha=0.15, linewidth=0)
            axes.plot(episode, middle, line, label=name, **look)
        axes.set(title=LABELS[task], ylabel="return", xlim=(0, config.episodes))
        axes.legend(loc="upper left", ncols=3)
    axes.set_xlabel("episode; grey: the motor is reversed")
    return figure


def figure(study=None):
    """(what the text needs, what the script needs, the pictures)."""
    study = study or stored()
    tasks = arms(study)
    first, *_ = tasks
    leads, levels = claim(study, tasks)
    start = drifted(study.config(first, tasks[first][0]))[0][1]
    text = dict(
        leads=leads,
        levels=levels,
        chooser=chooser(tasks),
        buttons=buttons(study, {arm for there in tasks.values() for arm in there}),
        episode=(start - WINDOW) // EVERY,
    )
    frames = dict(
        first=WINDOW - 1,
        every=EVERY,
        opening=OPENING,
        twins=("reuse", *TWINS),
        tasks={task: frame(study, task, there) for task, there in tasks.items()},
    )
    alt = f"Learning curves. Highest return from the first drift on: {leads}. {levels}"
    return text, frames, [(picture(study, tasks), alt)]

"""The pictures of notebook 13."""

import numpy as np
from lesson import COLOUR, FROZEN, LEARNER, plt

from .tones import ROSE, TEAL

LOOKS = {
    "keep all": (COLOUR["dqn"], "-"),
    "drop Q": (COLOUR["reset"], ":"),
    "drop data": (TEAL, "--"),
    "drop data, store stages": (ROSE, "-."),
}


def there_and_back(arms, goals, episodes):
    """Correct rooms, {arm: means over seeds}, with a goal for each stretch."""
    figure, axis = plt.subplots(figsize=(7.6, 3.5))
    for name, found in arms.items():
        colour, line = LOOKS[name]
        axis.plot(found, line, color=colour, linewidth=2, label=name)
    for k, goal in enumerate(goals):
        if k:
            axis.axvline(k * episodes, color="0.25", linewidth=0.8, linestyle="--")
        axis.text((k + 0.5) * episodes, 9.4, f"goal in room {goal}", ha="center")
    axis.set(xlabel="episode", ylabel="correct rooms", yticks=[0, 3, 6, 9])
    axis.set(xlim=(0, len(goals) * episodes), ylim=(-0.3, 10.2))
    figure.legend(
        *axis.get_legend_handles_labels(), loc="outside lower center", ncols=4
    )
    return figure


def chart(first, returns, S, level, drift, change, alarm):
    """Returns above, S below, from episode `first` on, with its level and its alarm."""
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(7.6, 3.9), sharex=True, height_ratios=(1, 1.3)
    )
    episode = first + np.arange(len(S))
    above.plot(episode, returns, "o-", color="0.35", markersize=3, linewidth=0.8)
    above.set(ylabel="return", ylim=(-108, 8))
    below.plot(episode, S, "o-", color=LEARNER, markersize=3)
    below.axhline(level, color="0.25", linestyle=":")
    below.text(first, level + 0.4, f"level {level:g}")
    below.set(xlabel="episode", ylabel="S", xlim=(first - 1, episode[-1] + 1))
    for axis in (above, below):
        axis.axvline(drift - 0.5, color="0.25", linewidth=0.8, linestyle="--")
        axis.axvspan(change - 0.5, alarm + 0.5, color=FROZEN, alpha=0.18, linewidth=0)
    below.plot(change, S[change - first], "s", color="black", zorder=3)
    below.plot(alarm, S[alarm - first], "*", color="black", markersize=11, zorder=3)
    style = dict(arrowstyle="-", color="0.35", linewidth=0.8)
    for name, at, place in (
        ("change point", change, (change - 3, S.max() * 0.72)),
        ("alarm", alarm, (alarm - 5, S.max() * 0.93)),
    ):
        options = dict(ha="right", va="center", arrowprops=style)
        below.annotate(name, (at, S[at - first]), place, **options)
    above.text(drift - 1, -60, "the goal moves", ha="right")
    return figure

"""The pictures of 05_dqn."""

import matplotlib.pyplot as plt
import numpy as np
from lesson import COLOUR

from gbdqn_ref.stats import trailing_mean

STYLES = {  # of each τ of the target network
    1.0: ("black", "-"),
    0.1: ("0.5", "--"),
    0.01: (COLOUR["dqn"], "-"),
    0.0: ("black", ":"),
}


def target_networks(errors, every):
    """The largest error of Q over the updates, by τ; errors is {title: {τ: values}}."""
    figure, axes = plt.subplots(1, len(errors), sharey=True, figsize=(8.5, 3.4))
    for panel, (title, curves) in zip(axes, errors.items(), strict=True):
        for tau, values in curves.items():
            colour, line = STYLES[tau]
            updates = every * np.arange(1, len(values) + 1)
            panel.semilogy(updates, values, line, color=colour, label=f"τ = {tau:g}")
        panel.set(title=title, xlabel="update")
    axes[0].set(ylabel="largest error of Q, log scale", ylim=(3e-3, 12))
    axes[0].legend(loc="center right", bbox_to_anchor=(1.02, 0.55))
    return figure


def explorers(gaps, softmax, greedy):
    """How often the better action is taken; softmax is {temperature: values}."""
    figure, axes = plt.subplots()
    for (temperature, values), line in zip(
        softmax.items(), ("-", "--", "-."), strict=True
    ):
        axes.plot(
            gaps, values, line, color="black", label=f"softmax, τ = {temperature:g}"
        )
    axes.plot(
        gaps, greedy, ":", color=COLOUR["dqn"], linewidth=3, label="ε-greedy, ε = 0.1"
    )
    axes.set(xlabel="Q of the better action minus Q of the other", ylim=(0.45, 1.03))
    axes.set(ylabel="how often it is taken")
    axes.set_title("ε-greedy sees which action is ahead, softmax by how much")
    axes.legend(loc="center right", bbox_to_anchor=(1, 0.42))
    return figure


def cartpole(returns):
    """Means of 10 episodes of several runs; returns is {τ: [returns of a run, …]}."""
    figure, axes = plt.subplots(1, len(returns), sharey=True, figsize=(8.5, 3))
    for panel, (tau, runs) in zip(axes, returns.items(), strict=True):
        colour, _ = STYLES[tau]
        for run, line in zip(runs, ("-", "--", ":"), strict=False):
            means = trailing_mean(np.array(run), 10)
            panel.plot(np.arange(9, len(run)), means, line, color=colour)
        panel.set(title=f"τ = {tau:g}", xlabel="episode", ylim=(0, 510))
    axes[0].set_ylabel("return, mean of 10")
    return figure

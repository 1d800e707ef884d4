"""What the command line prints. Nothing here computes more than it shows."""

import numpy as np

from . import stats
from .agents import AGENTS
from .effect import HURTS
from .schedule import LABELS, describe

RANDOM = "random policy, stock physics"


def regimes(summaries, config):
    """Per regime and agent the mean return, the drop and the recovery; then the final return."""
    names = [AGENTS[agent].label for agent in summaries]
    print(f"\n{LABELS[config.env]}, seed {config.seed}: mean return, drop and recovery per regime")
    tables = [summary["regimes"] for summary in summaries.values()]
    labels = [_label(row, config) for row in tables[0]]
    width = max(len(label) for label in (*labels, RANDOM)) + 1
    print(
        f"\n{'regime':{width}}"
        + "".join(f"{name:>14}{'drop':>7}{'recovery':>10}" for name in names)
    )
    for label, *rows in zip(labels, *tables, strict=True):
        cells = [f"{row['mean_return']:14.1f}{_drop(row):>7}{_recovery(row):>10}" for row in rows]
        print(f"{label:{width}}" + "".join(cells))
    final = "".join(f"{summary['final_return']:14.1f}{'':17}" for summary in summaries.values())
    print(f"{'final (last 50 episodes)':{width}}{final.rstrip()}")
    level = next(iter(summaries.values()))["random_return"]
    print(f"{RANDOM:{width}}{level:14.1f}")
    for agent, summary in summaries.items():
        if "recency_share_of_replay" in summary:
            print(
                f"\n{AGENTS[agent].label} ended with "
                f"{summary['recency_share_of_replay']:.0%} of its samples by recency"
            )
    print(
        "\ndrop: part of the level before the drift lost in the first 20 episodes after it (random"
        " policy = 0)"
    )
    print(
        "recovery: episodes until a mean of 10 is back at 90 % of that level; never: not within the"
        " regime"
    )


def study(summaries, config):
    """Per agent the mean return in each regime; of the final return mean ± std, IQM, and the
    difference to DQN.
    """
    count = len(next(iter(summaries.values())))
    final = {
        agent: np.array([row["final_return"] for row in rows]) for agent, rows in summaries.items()
    }
    print(f"\n{LABELS[config.env]}, {count} runs each: mean return per regime; final return")
    for row in next(iter(summaries.values()))[0]["regimes"]:
        print(f"  {_label(row, config)}")
    print(f"\n{'':14}{'regimes':35}{'mean ± std':>20}{'IQM':>9}   minus DQN's [95 %]")
    for agent, rows in summaries.items():
        means = np.mean(
            [[regime["mean_return"] for regime in row["regimes"]] for row in rows], axis=0
        )
        cells = "".join(f"{mean:8.1f}" for mean in means)
        mean, std = stats.mean_std(final[agent])
        line = (
            f"{AGENTS[agent].label:14}{cells:44}{mean:8.1f} ±"
            f" {std or 0:5.1f}{stats.iqm(final[agent]):9.1f}"
        )
        if "dqn" in final and agent != "dqn":
            paired = stats.paired_difference(final[agent], final["dqn"], np.random.default_rng(0))
            line += "   {:+.1f} [{:+.1f}, {:+.1f}]".format(*paired)
        print(line)
    print(
        "\nIQM: interquartile mean; minus DQN's: IQM over paired seeds, bootstrap interval (too"
        " narrow at 5 runs)"
    )


def drift_effect(rows, config):
    """What effect.drift_effect() found, a line per regime."""
    width = max(len(row["regime"]) for row in rows) + 1
    print(f"\n{LABELS[config.env]}: mean greedy return, {config.agent}, seed {config.seed}\n")
    print(f"{'regime':{width}}{'random':>9}{'frozen':>9}{'trained':>9}{'lost':>8}")
    for row in rows:
        lost = "–" if row["lost"] is None else f"{row['lost']:.0%}"
        print(
            f"{row['regime']:{width}}{row['random']:9.1f}{row['frozen']:9.1f}{row['trained']:9.1f}{lost:>8}"
        )
    hurt = sum(row["lost"] is not None and row["lost"] >= HURTS for row in rows[1:])
    print(
        "\nfrozen: trained in the stock physics, without learning; trained: in this regime from the"
        " start"
    )
    print(
        "lost: part of the span from random to trained that frozen falls short of; –: trained"
        " learnt nothing there"
    )
    print(f"{hurt} of {len(rows) - 1} drifts cost at least a fifth of the span")


def _label(row, config):
    return f"{row['regime']}  {describe(config.regimes[row['regime']].factors)}"


def _drop(row):
    return "–" if row["drop"] is None else f"{row['drop']:.0%}"


def _recovery(row):
    return "–" if row["drop"] is None else str(row["recovery"] or "never")

"""Every picture. Nothing here computes more than it shows."""

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from . import drift, stats
from .checkpoint import write_atomically

NAMES = {
    "gbdqn": "GB-DQN",
    "dqn": "DQN",
    "ensemble": "Ensemble-DQN",
    "reset": "Reset-DQN",
    "sliding": "Sliding-DQN",
    "frozen": "Frozen DQN",
    "random": "Random",
    "dqn-recency": "DQN-recency",
    "gbdqn-per": "GB-DQN-PER",
    "cartpole": "CartPole",
    "mountaincar": "MountainCar",
    "acrobot": "Acrobot",
    "hopper": "Hopper",
}
# Okabe and Ito's colours, that every eye tells apart: blue, vermillion, green, purple, orange, sky blue, black
OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
COLOURS = {
    "gbdqn": OKABE_ITO[0],
    "dqn": OKABE_ITO[1],
    "ensemble": OKABE_ITO[2],
    "reset": OKABE_ITO[3],
    "sliding": OKABE_ITO[4],
    "frozen": OKABE_ITO[5],
    "random": OKABE_ITO[6],
    "dqn-recency": OKABE_ITO[1],  # the same agent with another replay: the same colour, dashed
    "gbdqn-per": OKABE_ITO[0],
}
MARKS = {"gbdqn": "o", "dqn": "^", "ensemble": "s", "reset": "v", "sliding": "D", "frozen": "P", "random": "X"}
MARKS |= {"dqn-recency": "<", "gbdqn-per": ">"}
LINES = {"dqn-recency": "--", "gbdqn-per": "--"}
SMOOTHING = 15


def costs(replay, boosters, path):
    """How cost grows with the buffer, {sampler: (N, µs)}, and with boosters, {what: (m, ratio to none)}."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for axes, lines in ((left, replay), (right, boosters)):
        for (name, (x, y)), colour, mark in zip(lines.items(), OKABE_ITO, "o^s", strict=False):
            axes.plot(x, y, color=colour, marker=mark, label=name)
        axes.set_ylim(0, 1.3 * max(max(y) for _, y in lines.values()))
        axes.legend(frameon=False, loc="upper left")
        axes.spines[["top", "right"]].set_visible(False)
    left.set(xscale="log", xlabel="transitions in the buffer", ylabel="µs")
    left.set_title("drawing 64 and updating their priorities", loc="left")
    right.set(xlabel="frozen boosters", ylabel="time, as a multiple of that without any")
    right.set_title("GB-DQN on Acrobot", loc="left")
    _save(figure, path)


def learning_curves(runs, config, random_return, path):
    """Return per episode of each agent in {agent: records}, as points and trailing means, with the drifts marked."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for agent, records in runs.items():
        episode, returns = np.array([(record["episode"], record["return"]) for record in records]).T
        axes.plot(episode, returns, MARKS[agent], color=COLOURS[agent], markersize=3, alpha=0.35, markeredgewidth=0)
        smooth = stats.trailing_mean(returns, SMOOTHING)
        look = dict(color=COLOURS[agent], linestyle=LINES.get(agent, "-"), linewidth=2.2)
        axes.plot(episode[SMOOTHING - 1 :], smooth, **look, label=NAMES[agent])
    axes.axhline(random_return, color="0.45", linewidth=1.2, linestyle=":", label="random policy")
    _mark_regimes(axes, config)
    axes.set(xlabel="episode", ylabel=f"return (points: episodes, lines: mean of the last {SMOOTHING})")
    title = f"{NAMES[config.env]}, seed {config.seed}: the physics change at the dashed lines"
    axes.set_title(title, loc="left", pad=34)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    _save(figure, path)


def study_curves(runs, config, random_return, path):
    """A panel per agent of {agent: [records per seed]}: every seed, their mean, and its bootstrap interval."""
    rows, columns = -(-len(runs) // 3), min(3, len(runs))
    figure = Figure(figsize=(12, 0.9 + 2.7 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    smooth = {agent: _smoothed(records) for agent, records in runs.items()}
    episode, rng = np.arange(SMOOTHING - 1, config.episodes), np.random.default_rng(0)
    for axes, (agent, curves) in zip(panels, smooth.items(), strict=False):
        colour, middle = COLOURS[agent], curves.mean(0)
        axes.plot(episode, curves.T, color=colour, linewidth=0.6, alpha=0.5)
        draws = curves[rng.integers(len(curves), size=(500, len(curves)))].mean(1)
        axes.fill_between(episode, *np.quantile(draws, [0.025, 0.975], axis=0), color=colour, alpha=0.25, linewidth=0)
        axes.plot(episode, middle, color=colour, linewidth=2)
        if "dqn" in smooth and agent != "dqn":
            axes.plot(episode, smooth["dqn"].mean(0), color="0.2", linewidth=1, linestyle=":")
        axes.axhline(random_return, color="0.45", linewidth=1, linestyle="--")
        for start, _, _ in drift.check_schedule(config.env, config.schedule)[1:]:
            axes.axvline(start, color="0.6", linewidth=0.8)
        axes.set_title(NAMES[agent], loc="left", fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[len(runs) :]:
        axes.set_visible(False)
    for axes in panels[max(0, len(runs) - columns) : len(runs)]:
        axes.tick_params(labelbottom=True)
    figure.supxlabel("episode; the physics change at the upright lines", fontsize=10)
    figure.supylabel(f"return, mean of the last {SMOOTHING}", fontsize=10)
    what = "thin: seeds, thick: their mean, band: 95 % bootstrap; dotted: DQN's mean, dashed: random policy"
    figure.suptitle(f"{NAMES[config.env]} — {what}", fontsize=10, x=0.01, ha="left")
    _save(figure, path)


def _smoothed(records):
    """Trailing means of the returns (seeds, episodes − SMOOTHING + 1)."""
    return np.array([stats.trailing_mean(np.array([each["return"] for each in run]), SMOOTHING) for run in records])


def forest(final, path):
    """Final returns minus DQN's on the same seeds, {agent: (seeds,)}: every pair, their IQM and its interval."""
    others = [agent for agent in final if agent != "dqn"]
    figure = Figure(figsize=(8, 1.2 + 0.45 * len(others)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.axvline(0, color="0.25", linewidth=1)
    for y, agent in enumerate(reversed(others)):
        middle, low, high = stats.paired_difference(final[agent], final["dqn"], np.random.default_rng(0))
        difference = np.asarray(final[agent]) - final["dqn"]
        axes.plot(difference, np.full(len(difference), y), "o", color=COLOURS[agent], alpha=0.5, markersize=4)
        axes.plot([low, high], [y, y], color=COLOURS[agent], linewidth=2)
        axes.plot(middle, y, MARKS[agent], color=COLOURS[agent], markersize=8)
    axes.set_yticks(range(len(others)), [NAMES[agent] for agent in reversed(others)])
    axes.set_xlabel("final return minus DQN's (dots: seeds; mark and bar: IQM and 95 % bootstrap interval)")
    axes.spines[["top", "right"]].set_visible(False)
    _save(figure, path)


def _save(figure, path):
    picture = io.BytesIO()
    figure.savefig(picture, dpi=120, format="png")
    write_atomically(path, lambda file: file.write(picture.getvalue()))


def _mark_regimes(axes, config):
    """Shade the regimes in turn, and say above each what is not as in the stock physics."""
    regimes = [regime for regime in drift.check_schedule(config.env, config.schedule) if regime[0] < config.episodes]
    starts = [start for start, _, _ in regimes]
    axes.set_xlim(0, config.episodes)
    for (start, factors, event), end in zip(regimes, [*starts[1:], config.episodes], strict=True):
        if any(factor != 1 for factor in factors.values()):
            axes.axvspan(start, end, color="0.93", zorder=0)
        if start:
            axes.axvline(start, color="0.25", linewidth=1, linestyle="--")
        changed = [f"{name.replace('_', ' ')} × {value:g}" for name, value in factors.items() if value != 1]
        label = "\n".join(changed) or ("reset:\nstock physics" if event == "reset" else "stock physics")
        middle, above = (start + end) / 2, axes.get_xaxis_transform()
        axes.text(middle, 1.01, label, transform=above, ha="center", va="bottom", fontsize=9)

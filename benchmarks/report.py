"""What the benchmark prints and draws. Nothing here measures."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gbdqn_ref.agents import OKABE_ITO
from gbdqn_ref.plots import save


def table(title, columns, rows):
    """One section of the benchmark."""
    widths = [max(10, len(column) + 2) for column in columns]
    print(
        f"\n{title}\n"
        + "".join(f"{column:>{width}}" for column, width in zip(columns, widths, strict=True))
    )
    for label, numbers in rows.items():
        print(
            "".join(
                f"{x:{width},.{_decimals(x)}f}" for x, width in zip(numbers, widths, strict=True)
            ),
            "",
            label,
        )


def _decimals(x):
    """How many decimals make three digits."""
    return max(0, 2 - int(max(1, x) >= 10) - int(x >= 100))


def picture(replay, boosters, path):
    """How cost grows with the buffer, {sampler: (N, µs)}, and with boosters, {what: (m, ratio to
    none)}.
    """
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
    save(figure, path)

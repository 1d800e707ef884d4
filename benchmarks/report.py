"""What the benchmark prints and draws. Nothing here measures."""

from math import isnan

from gbdqn_ref.agents import OKABE_ITO
from gbdqn_ref.plots import Figure, plain

LOOKS = tuple(zip(OKABE_ITO, "o^s", strict=False))  # of the first line, the second …
PANELS = (  # title, x, y
    ("drawing 64 and updating their priorities", "transitions in the buffer", "µs"),
    ("GB-DQN on Acrobot", "frozen boosters", "time, as a multiple of that without any"),
)


def table(title, columns, rows):
    """Print one Section of the benchmark."""
    widths = [max(10, len(column) + 2) for column in columns]
    print(f"\n{title}")
    print("".join(f"{column:>{width}}" for column, width in zip(columns, widths, strict=True)))
    for label, numbers in rows.items():
        print("".join(map(cell, numbers, widths)), "", label)


def cell(x, width):
    """A number with three digits, or – where there is none."""
    return f"{'–':>{width}}" if isnan(x) else f"{x:{width},.{decimals(x)}f}"


def decimals(x):
    """How many decimals make three digits."""
    return max(0, 2 - int(max(1, x) >= 10) - int(x >= 100))


def picture(panels):
    """How cost grows: a panel for each of PANELS, {label: (x, y)}; the figure."""
    with plain():
        figure = Figure(figsize=(10, 4), layout="constrained")
        all_axes = figure.subplots(1, len(PANELS))
        for axes, lines, (title, x_label, y_label) in zip(all_axes, panels, PANELS, strict=True):
            for (label, (x, y)), (colour, mark) in zip(lines.items(), LOOKS, strict=False):
                axes.plot(x, y, color=colour, marker=mark, label=label)
            axes.set(xlabel=x_label, ylabel=y_label)
            axes.set_ylim(0, 1.3 * max(max(y) for _, y in lines.values()))
            axes.set_title(title, loc="left")
            axes.legend(frameon=False, loc="upper left")
            axes.spines[["top", "right"]].set_visible(False)
        all_axes[0].set_xscale("log")
    return figure

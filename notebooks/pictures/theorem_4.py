"""Pictures of notebook 11: adaptation as printed, and fits that miss."""

import matplotlib.pyplot as plt
from lesson import FROZEN

from pictures.tones import INDIGO, ROSE, TEAL


def adaptation(case_a, case_b, both):
    """The error of the first door in three cases."""
    figure, axis = plt.subplots(figsize=(7, 3.2))
    axis.semilogy([float(q) for q in case_a], "o-", color=ROSE)
    axis.plot(range(1, len(case_b)), [float(q) for q in case_b[1:]], "s-", color=INDIGO)
    axis.semilogy([float(q) for q in both], "D--", color=TEAL)
    axis.text(5.6, 60, "A: first door only, it diverges", color=ROSE, ha="right")
    axis.text(8, 5, "B: first door only, 9 off", color=INDIGO, ha="right")
    axis.text(8, 0.45, "A with both doors in the data", color=TEAL, ha="right")
    axis.set(xlabel="boosts after the drift", ylabel="|Q − Q*| of the first door")
    axis.set(ylim=(0.3, 200), title="exact fits")
    return figure


def misses(tracks, worst, bound):
    """The largest error over the boosts, for misses in one direction and by chance."""
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.4), sharey=True)
    for axis, name in zip(axes, ("always upwards", "by chance"), strict=True):
        for alpha, colour in zip((1.0, 0.3, 0.1), (ROSE, INDIGO, TEAL), strict=True):
            axis.semilogy(tracks[name, alpha], color=colour)
        axis.axhline(bound, color="black", ls=":", lw=1)
        axis.set(xlabel="boosts after the drift", title=f"misses {name}")
    one_way = axes[0]
    one_way.semilogy(worst, "--", color=FROZEN)
    one_way.set(ylabel="largest error of Q", ylim=(0.02, 9))
    one_way.text(200, 1.15, "one room: the bound ε/(1 − γ)", color=FROZEN, ha="right")
    one_way.text(200, 0.4, "ten rooms, every step", ha="right")
    for axis in axes:
        for alpha, y, colour in ((1, 5.5, ROSE), (0.3, 3.6, INDIGO), (0.1, 2.4, TEAL)):
            axis.text(200, y, f"steps of {alpha}", color=colour, ha="right")
    return figure

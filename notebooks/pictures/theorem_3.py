"""Pictures of notebook 10: sums that miss their products, and a buffer that grows."""

import matplotlib.pyplot as plt
import numpy as np

from gbdqn_ref.replay import mixed_priority
from pictures.tones import INDIGO, ROSE, TEAL


def ratios(pairs):
    """P₁ : P₂ by the rule for every β, and by the product."""
    figure, axis = plt.subplots(figsize=(7, 3.6))
    mixes = np.linspace(0, 1, 101)
    for (name, (td, time)), colour in zip(
        pairs.items(), (ROSE, INDIGO, TEAL), strict=True
    ):
        newer, older = (
            mixed_priority(d, t, mixes) for d, t in zip(td, time, strict=True)
        )
        axis.plot(mixes, newer / older, color=colour)
        product = td[0] * time[0] / (td[1] * time[1])
        axis.plot(1.04, product, "D", color=colour, clip_on=False)
        text = f"{name}, recency (1, {time[1]:g})\nproduct {product:g} : 1"
        axis.text(1.08, product, text, va="center", color=colour)
    axis.plot(1 / 7, 2, "o", color="black", mfc="none", ms=9)
    axis.text(0.17, 2.55, "β = 1/7", ha="left")
    axis.set(xlabel="mixing coefficient β", ylabel="$P_1 : P_2$", ylim=(0, 6.4))
    axis.set(xlim=(0, 1), title="lines: the rule; diamonds: the ideal")
    return figure


def growth(sizes, from_ideal, from_per):
    """How far the rule is from the ideal and from |δ| alone."""
    figure, axis = plt.subplots(figsize=(7, 3.2))
    axis.semilogx(sizes, from_ideal, "o-", color=ROSE)
    axis.semilogx(sizes, from_per, "s--", color=INDIGO)
    axis.text(2e4, 0.85, "from the ideal, |δ| · recency", color=ROSE)
    axis.text(2e4, 0.08, "from |δ| alone", color=INDIGO)
    axis.set(xlabel="transitions in the buffer", ylim=(-0.03, 1.05))
    axis.set(ylabel="total variation distance", title="how far the rule is")
    return figure

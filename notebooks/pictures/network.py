"""The picture of notebook 14."""

import matplotlib.pyplot as plt

from gbdqn_ref.agents import BLACK, BLUE, GREEN, ORANGE


def fitted(x, y, fits, constant, falling):
    """The curve at three stages, and the losses of two learning rates."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.2))
    looks = ((0, "0.7", "-"), (30, ORANGE, "--"), (600, BLUE, "-"))
    for update, colour, style in looks:
        name = "before" if not update else f"after {update} updates"
        left.plot(x, fits[update], style, color=colour, label=name)
    left.plot(x, y, ":", color=BLACK, linewidth=2, label="wanted")
    left.set(xlabel="x", ylabel="q", ylim=(-2.9, 2), title="The fit")
    left.legend(loc="lower right", ncols=2)
    right.semilogy(constant, color=BLUE, label="constant learning rate")
    right.semilogy(falling, "--", color=GREEN, label="falling to 0")
    right.set(xlabel="update", ylabel="loss", title="Its loss")
    right.legend()
    return figure

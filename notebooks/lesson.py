"""What every notebook has from here: the package's own source, shown live, and one look for all
pictures.
"""

import inspect
import os
from textwrap import dedent

import matplotlib.pyplot as plt
from IPython.display import Markdown, display

from gbdqn_ref.agents import OKABE_ITO

FAST = (
    os.environ.get("NOTEBOOKS") == "fast"
)  # in tests: shorter runs, coarser pictures, the same cells
BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK = OKABE_ITO

plt.rcParams.update(
    {
        "figure.figsize": (8, 3.6),
        "figure.dpi": 90,
        "figure.constrained_layout.use": True,
        "axes.prop_cycle": plt.cycler(color=OKABE_ITO),
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlelocation": "left",
        "axes.titlesize": 11,
        "legend.frameon": False,
    }
)


def source(*things):
    """Show the source of functions, methods or classes, as the installed package has it."""
    for thing in things:
        name = f"{thing.__module__}.{thing.__qualname__}"
        display(Markdown(f"`{name}`\n```python\n{dedent(inspect.getsource(thing)).rstrip()}\n```"))

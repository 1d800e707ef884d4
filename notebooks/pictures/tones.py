"""Colours of curves that are no agents, after Paul Tol's muted scheme: a colour-blind
reader can tell them apart, and each is dark enough for text.
"""

INDIGO, TEAL, ROSE = "#332288", "#117766", "#AA4455"

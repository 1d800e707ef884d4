"""The smallest world of the theorems: one room whose doors all lead back into it."""

from fractions import Fraction as F

import numpy as np

from gbdqn_ref.tabular import MDP


def row(*values):
    """Q, r or μ of the room in exact fractions, one for each door: (1, A)."""
    return np.array([[F(value) for value in values]])


def loops(*rewards, gamma):
    """The room, with one door for each reward."""
    return MDP(np.full((1, len(rewards), 1), F(1)), row(*rewards), gamma)

"""Strategies for the property tests; extreme values have their own tests."""

import numpy as np
from hypothesis import strategies as st

from gbdqn_ref.nn import MLP
from gbdqn_ref.tabular import MDP


def rngs():
    """Generators in a known state; a failing example shows the seed."""
    return st.builds(np.random.default_rng, st.integers(0, 2**32 - 1))


def sizes(largest=4):
    """Counts: of networks, samples, inputs or actions."""
    return st.integers(1, largest)


def reals():
    """Multiples of 0.001 from −100 to 100, so that only 0 is tiny."""
    return st.integers(-100_000, 100_000).map(lambda i: i / 1000)


def positives():
    """Multiples of 0.001 from 0.001 to 100."""
    return st.integers(1, 100_000).map(lambda i: i / 1000)


def vectors(n, elements=None):
    """Arrays (n,) of reals, or of other elements, in float64."""
    return st.lists(reals() if elements is None else elements, min_size=n, max_size=n).map(np.array)


def matrices(rows, columns):
    """Arrays (rows, columns) of reals."""
    return vectors(rows * columns).map(lambda x: x.reshape(rows, columns))


def weighted_samples():
    """(residual (n,), h (n,), positive weights (n,))."""
    return sizes(8).flatmap(lambda n: st.tuples(vectors(n), vectors(n), vectors(n, positives())))


def nets():
    """Networks with up to two hidden layers."""
    return st.lists(sizes(), min_size=2, max_size=4).map(MLP)


@st.composite
def mdps(draw):
    """MDPs of up to four states and three actions."""
    rng, S, A = draw(rngs()), draw(sizes(4)), draw(sizes(3))
    P, r = rng.dirichlet(np.ones(S), size=(S, A)), rng.normal(size=(S, A))
    return MDP(P, r, draw(st.floats(0, 0.95)))

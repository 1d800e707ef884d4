"""The vocabulary of the property tests. Values are plain on purpose: what is extreme is tested by
name.
"""

import numpy as np
from hypothesis import strategies as st

from gbdqn_ref.nn import MLP
from gbdqn_ref.tabular import MDP


def rngs():
    """Generators in a known state; a failing example shows the seed."""
    return st.builds(np.random.default_rng, st.integers(0, 2**32 - 1))


def sizes(largest=4):
    """How many there are of something: networks, samples, inputs, actions."""
    return st.integers(1, largest)


def reals():
    """Thousandths from −100 to 100, so that nothing but 0 is tiny."""
    return st.integers(-100_000, 100_000).map(lambda i: i / 1000)


def positives():
    """Thousandths from 0.001 to 100."""
    return st.integers(1, 100_000).map(lambda i: i / 1000)


def vectors(n, elements=None):
    """Arrays (n,) of reals, or of what is given, in float64."""
    return st.lists(reals() if elements is None else elements, min_size=n, max_size=n).map(np.array)


def matrices(rows, columns):
    """Arrays (rows, columns) of reals."""
    return vectors(rows * columns).map(lambda x: x.reshape(rows, columns))


def weighted_samples():
    """(residual (n,), h (n,), weights (n,)), the weights positive."""
    return sizes(8).flatmap(lambda n: st.tuples(vectors(n), vectors(n), vectors(n, positives())))


def nets():
    """Networks with none, one or two hidden layers."""
    return st.lists(sizes(), min_size=2, max_size=4).map(MLP)


@st.composite
def mdps(draw):
    """MDPs of up to four states and three actions."""
    rng, S, A = draw(rngs()), draw(sizes(4)), draw(sizes(3))
    return MDP(
        rng.dirichlet(np.ones(S), size=(S, A)), rng.normal(size=(S, A)), draw(st.floats(0, 0.95))
    )

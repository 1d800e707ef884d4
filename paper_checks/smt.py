"""Proofs for every instance of a stated size, by the SMT solver z3: exact reals, nothing sampled.

An arbitrary MDP is one whose P, r, γ are unknowns. The solver is asked for values that break a
statement. If there are none, the statement is proved, for every MDP of that size; if there are, it
returns them. The package's own functions run on unknowns as they do on numbers. Where a test calls
one, what is proved is proved of the code; elsewhere of the formula that the test writes down.
"""

from fractions import Fraction

import numpy as np
import z3

from gbdqn_ref.tabular import MDP

SECONDS = 10  # what the solver cannot decide in this time is not claimed


def proved(statement, *assumptions):
    """True if no values of the unknowns meet the assumptions and break the statement.

    Some values must meet the assumptions: of nothing everything is true.
    """
    assert _solve(assumptions) is not None, "nothing meets the assumptions"
    return _solve([*assumptions, z3.Not(statement)]) is None


def counterexample(statement, *assumptions):
    """Values that meet the assumptions and break the statement, as a function of unknowns that
    returns Fractions.
    """
    model = _solve([*assumptions, z3.Not(statement)])
    assert model is not None, "the statement holds after all"
    return lambda unknown: _fractions(model, unknown)


def _solve(facts):
    solver = z3.SolverFor("QF_NRA")
    solver.set("timeout", SECONDS * 1000)
    solver.add(*_flat(facts))
    answer = solver.check()
    assert answer != z3.unknown, f"undecided after {SECONDS} s"
    return solver.model() if answer == z3.sat else None


def _flat(facts):
    return [each for fact in facts for each in (fact if isinstance(fact, list) else [fact])]


def _fractions(model, unknown):
    terms = np.asarray(unknown, dtype=object)
    found = [model.eval(z3.RealVal(0) + x, model_completion=True) for x in terms.ravel()]
    numbers = np.array([Fraction(x.as_fraction()) for x in found], dtype=object)
    return numbers.reshape(terms.shape) if terms.shape else numbers.item()


class Symbols(np.ndarray):
    """An array of unknowns and of terms in them, whose max is a case distinction."""

    def __array_wrap__(self, array, context=None, return_scalar=False):
        return array.view(Symbols) if array.shape else array.item()

    def max(self, axis=None):
        if axis is None:
            return maximum(self.ravel())
        rows = np.moveaxis(self, axis, -1)
        found = [maximum(rows[place]) for place in np.ndindex(rows.shape[:-1])]
        return symbols(found).reshape(rows.shape[:-1])


def symbols(values):
    """An array of these terms."""
    return np.array(values, dtype=object).view(Symbols)


def unknowns(name, *shape):
    """An array of arbitrary reals."""
    names = ["_".join([name, *map(str, place)]) for place in np.ndindex(shape)]
    return symbols(list(map(z3.Real, names))).reshape(shape)


def maximum(values):
    """The largest of some terms."""
    largest, *others = values
    for other in others:
        largest = z3.If(other > largest, other, largest)
    return largest


def size(x):
    """|x|."""
    return z3.If(x < 0, -x, x)


def both(*statements):
    """All of some statements, or lists of them."""
    return z3.And(*_flat(statements))


def equal(left, right):
    """Two arrays are the same, element by element."""
    return both([a == b for a, b in zip(np.ravel(left), np.ravel(right), strict=True)])


def within(x, bound):
    """‖x‖∞ ≤ bound."""
    return both([z3.And(-bound <= each, each <= bound) for each in np.ravel(x)])


class AnyMDP(MDP):
    """Every MDP with these numbers of states and actions at once, `lawful` provided.

    Its rewards are those under which Q has this residual: for every r there is one residual, and
    for every residual one r, so nothing is lost, and the solver has less to multiply.
    """

    def __init__(self, Q, residual, name=""):
        states, actions = Q.shape
        free = unknowns("P" + name, states, actions, states - 1)
        self.P = symbols(np.concatenate([free, 1 - free.sum(-1, keepdims=True)], -1))
        self.gamma = unknowns("gamma")  # one discount for all; an array, which NumPy can multiply
        self.r = 0
        self.r = residual - self.residual(Q)

    @property
    def discount(self):
        """γ."""
        return self.gamma.item()

    @property
    def lawful(self):
        """What makes it an MDP: P ≥ 0, which sums to 1 by construction, and 0 ≤ γ < 1."""
        return [p >= 0 for p in self.P.ravel()] + [self.discount >= 0, self.discount < 1]

    def instance(self, found):
        """The MDP of a counterexample, in Fractions."""
        return MDP(found(self.P), found(self.r), found(self.discount))

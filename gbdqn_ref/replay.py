"""Replay buffers: uniform, by TD error (Schaul et al. 2016), by TD error and recency (Eqs. 10–11).

Letters: N stored transitions, B batch, p priority, P = p / Σp probability, age = transitions added
since (newest 0), slot = place in the ring. Everything per sample is (B,).
"""

from math import expm1, inf
from typing import NamedTuple

import numpy as np


class Batch(NamedTuple):
    """B sampled transitions; s and s2 are (B, d), everything else (B,). index holds their slots."""

    index: np.ndarray
    s: np.ndarray
    a: np.ndarray
    r: np.ndarray
    s2: np.ndarray
    terminated: np.ndarray
    weight: np.ndarray


def td_priority(delta, priority_offset, priority_exponent):
    """p^TD = (|δ| + ε)^γ, the paper's ε and γ (section "Recency and TD-error …")."""
    return (np.abs(delta) + priority_offset) ** priority_exponent


def time_priority(age, recency_rate):
    """p^time = exp(−α · age), with age in transitions added since (D5): 1 for the newest."""
    return np.exp(-recency_rate * np.asarray(age, np.float64))


def mixed_priority(p_td, p_time, mix):
    """p = β p^TD + (1 − β) p^time  (Eq. 10), with β = mix."""
    return mix * p_td + (1 - mix) * p_time


def importance_weights(probabilities, n, is_exponent, normalise="batch"):
    """w = (1 / (N P))^β, divided by the batch's largest weight if normalise is "batch".

    (B,) → (B,). "batch" is the paper's; None leaves them as they are. Only exponent 1 without
    normalisation makes the weighted mean unbiased.

    >>> importance_weights(np.array([0.8, 0.2]), 2, 1.0).tolist()
    [0.25, 1.0]
    """
    if normalise not in ("batch", None):
        raise ValueError(f'normalise must be "batch" or None, not {normalise!r}')
    weight = (n * probabilities) ** -is_exponent
    return weight / weight.max() if normalise else weight


class UniformReplay:
    """A ring of the last `capacity` transitions, drawn uniformly.

    slot:   0    1    2    3    4          capacity 5 after 7 transitions (0 … 6):
          | t5 | t6 | t2 | t3 | t4 |       the next one goes to slot 2,
                  ↑ newest, age 0          where the oldest is, age 4
    """

    def __init__(self, capacity, state_dim):
        self.capacity, self.added, self.first = int(capacity), 0, 0  # first: the oldest that counts
        self.s, self.s2 = np.zeros((2, self.capacity, state_dim), np.float32)
        self.a = np.zeros(self.capacity, np.int64)
        self.r = np.zeros(self.capacity, np.float32)
        self.terminated = np.zeros(self.capacity, bool)

    def __len__(self):
        return min(self.added - self.first, self.capacity)

    def slots(self):
        """The slots (N,) of the stored transitions."""
        return (self.first + np.arange(len(self))) % self.capacity

    def keep(self, n):
        """Drop all but the newest n: they are never drawn again and no longer count in N."""
        self.first = max(self.first, self.added - n)

    def add(self, s, a, r, s2, terminated):
        """Store a transition, in place of the oldest if the ring is full; returns its slot."""
        if a < 0:  # as an index it would select one of the last actions
            raise ValueError(f"an action must be a non-negative whole number, not {a}")
        slot = self.added % self.capacity
        self.s[slot], self.a[slot], self.r[slot] = s, a, r
        self.s2[slot], self.terminated[slot] = s2, terminated
        self.added += 1
        return slot

    def age(self, slot):
        """Transitions added since the one in this slot (or slots): 0 … N − 1."""
        return (self.added - 1 - slot) % self.capacity

    def sample(self, batch_size, rng):
        """A Batch of independent draws with replacement, P(i) = 1/N."""
        index = (self.first + rng.integers(self._total(), size=batch_size)) % self.capacity
        return self._batch(index, np.ones(batch_size, np.float32))

    def _batch(self, index, weight):
        arrays = self.s, self.a, self.r, self.s2, self.terminated
        return Batch(index, *(array.take(index, axis=0) for array in arrays), weight)

    def probabilities(self):
        """P (N,) by slot, from which sample() draws."""
        return np.full(len(self), 1 / self._total())

    def _total(self):
        """Σp, where each p is 1."""
        return _divisor(len(self), len(self))

    def update_priorities(self, index, delta):
        """Take the TD errors (B,) of the transitions in these slots; uniform replay needs none."""

    def check_valid(self):
        """Raise AssertionError unless the ring is consistent."""
        assert 0 <= len(self) <= self.capacity and self.added >= len(self)
        assert sorted(self.age(self.slots())) == list(range(len(self)))
        for array in (self.s, self.a, self.r, self.s2, self.terminated):
            assert not array[self.added :].any(), "an empty slot holds something"


class SumTree:
    """Non-negative numbers, whose sum and a draw in proportion to them cost O(log N).

    Each number of a level is the sum of FAN numbers below it. The last level has at most TOP
    numbers. The levels are few and wide, since the cost is NumPy's cost per call. The picture has
    FAN = TOP = 4; the code has 32 and 2,048:

        levels[1]      10           26
        levels[0]   1 2 3 4      5 6 7 8     u = 17: 17 ≥ 10, so right, 7 left: 5 ≤ 7 < 11, leaf 5
    """

    FAN, TOP = 32, 2048

    def __init__(self, size):
        self.levels = [self._level(size)]
        while len(self.levels[-1]) > self.TOP:
            self.levels.append(self._level(len(self.levels[-1]) // self.FAN))

    def _level(self, size):
        return np.zeros(-(-size // self.FAN) * self.FAN)  # whole groups

    @property
    def leaves(self):
        return self.levels[0]

    def total(self):
        return float(self.levels[-1].sum())

    def set(self, index, value):
        """Set leaves and recompute the sums above them.

        Adding differences would let rounding errors build up.
        """
        self.leaves[index] = value
        for below, above in zip(self.levels, self.levels[1:], strict=False):
            index = index // self.FAN
            above[index] = below.reshape(-1, self.FAN)[index].sum(-1)

    def find(self, u):
        """The leaf into which each u (B,) in [0, total) falls, with the leaves laid end to end.

        An empty leaf is never found.
        """
        *lower, top = self.levels
        edges = np.zeros(len(top) + 1)  # where each number begins, and where the last one ends
        top.cumsum(out=edges[1:])
        # rounding must not carry u past the last leaf
        u = np.minimum(u, np.nextafter(edges[-1], 0))
        index = (edges.searchsorted(u, "right") - 1) % len(top)  # where all are 0, the first
        u = u - edges[index]
        rows, edges = np.arange(len(u)), np.zeros((len(u), self.FAN + 1))
        for level in reversed(lower):
            level.reshape(-1, self.FAN)[index].cumsum(-1, out=edges[:, 1:])
            u = np.minimum(u, np.nextafter(edges[:, -1], 0))
            child = (edges[:, 1:] > u[:, None]).argmax(-1)  # the first that ends beyond u
            u = u - edges[rows, child]
            index = index * self.FAN + child
        return index


class ProportionalReplay(UniformReplay):
    """Proportional prioritized replay: P(i) = p^TD_i / Σ p^TD, w_i = (N P(i))^−is_exponent.

    A new transition gets the largest priority so far, so it is drawn soon (D4).
    """

    def __init__(
        self,
        capacity,
        state_dim,
        priority_offset=0.01,
        priority_exponent=0.6,
        is_exponent=0.4,
        normalise="batch",
    ):
        super().__init__(capacity, state_dim)
        self.priority_offset, self.priority_exponent = priority_offset, priority_exponent
        self.is_exponent, self.normalise = is_exponent, normalise
        self.tree, self.max_priority = SumTree(self.capacity), 1.0

    def add(self, s, a, r, s2, terminated):
        slot = super().add(s, a, r, s2, terminated)
        self.tree.set(slot, self.max_priority)
        return slot

    def keep(self, n):
        dropped = np.arange(self.added - len(self), self.added - n) % self.capacity
        super().keep(n)
        self.tree.set(dropped, 0.0)

    def sample(self, batch_size, rng):
        """A Batch of independent draws with replacement from probabilities()."""
        index = self._draw(batch_size, rng)
        weight = importance_weights(
            self._probability(index), len(self), self.is_exponent, self.normalise
        )
        return self._batch(index, weight.astype(np.float32))

    def probabilities(self):
        return self._probability(self.slots())

    def update_priorities(self, index, delta):
        priority = td_priority(
            np.asarray(delta, np.float64), self.priority_offset, self.priority_exponent
        )
        largest = float(priority.max())
        if not largest < inf:
            raise FloatingPointError(f"a priority is {largest}: the TD errors have diverged")
        self.tree.set(index, priority)
        self.max_priority = max(self.max_priority, largest)

    def _probability(self, index):
        return self._priority(index) / self._total()

    def _draw(self, batch_size, rng):
        return self.tree.find(rng.random(batch_size) * self._total())

    def _priority(self, index):
        return self.tree.leaves[index]

    def _total(self):
        return _divisor(self.tree.total(), len(self))

    def check_valid(self):
        super().check_valid()
        others = np.delete(self.tree.leaves, self.slots())
        assert (self.tree.leaves >= 0).all() and not others.any()
        for below, above in zip(self.tree.levels, self.tree.levels[1:], strict=False):
            sums = below.reshape(-1, SumTree.FAN).sum(-1)
            assert (above[: len(sums)] == sums).all() and not above[len(sums) :].any()
        assert self.tree.leaves.max() <= self.max_priority


def _divisor(total, n):
    """Σp of n priorities, or an error if P = p / Σp is undefined."""
    if not n:
        raise ValueError("the buffer is empty: store a transition before drawing one")
    if total == 0:
        raise ValueError(
            "every priority is 0, so P = p / Σp is undefined; priority_offset must be positive"
        )
    if not total < inf:
        raise FloatingPointError(f"the priorities add up to {total}: the TD errors have diverged")
    return total


class RecencyReplay(ProportionalReplay):
    """GB-DQN's replay: P(i) = p_i / Σp, p_i = β p^TD_i + (1 − β) exp(−α age_i)  (Eqs. 10–11).

    Eq. 10 is a mixture, so a draw has two stages. With probability λ it is proportional to p^TD.
    Otherwise an age is drawn, in closed form, from the truncated geometric distribution:

        λ = β S_TD / (β S_TD + (1 − β) S_time)      S_time = (1 − e^{−αN}) / (1 − e^{−α})
        age = ⌊−log(1 − u (1 − e^{−αN})) / α⌋       u uniform in [0, 1)

    No age-dependent priority is ever stored, so none goes stale, as the paper's p_i does between
    two visits (D5). Rate 0 makes recency uniform.
    """

    def __init__(self, capacity, state_dim, mix=0.5, recency_rate=1e-3, **proportional):
        super().__init__(capacity, state_dim, **proportional)
        self.mix, self.recency_rate = mix, recency_rate

    def time_total(self):
        """S_time = Σ exp(−α age) over the N stored transitions."""
        if self.recency_rate == 0:
            return float(len(self))
        return expm1(-self.recency_rate * len(self)) / expm1(-self.recency_rate)

    def td_share(self):
        """λ, the share of draws by TD error; 1 − λ is the share by recency."""
        return self.mix * self.tree.total() / self._total()

    def _draw(self, batch_size, rng):
        by_td = rng.random(batch_size) < self.td_share()
        u = rng.random(batch_size)
        newest = (self.added - 1) % self.capacity
        by_time = (newest - self._age_at(u)) % self.capacity
        return np.where(by_td, self.tree.find(u * self.tree.total()), by_time)

    def _age_at(self, u):
        n, rate = len(self), self.recency_rate
        age = u * n if rate == 0 else -np.log1p(u * expm1(-rate * n)) / rate
        return np.minimum(age.astype(np.int64), n - 1)

    def _priority(self, index):
        return mixed_priority(
            self.tree.leaves[index], time_priority(self.age(index), self.recency_rate), self.mix
        )

    def _total(self):
        total = mixed_priority(self.tree.total(), self.time_total(), self.mix)
        return _divisor(total, len(self))

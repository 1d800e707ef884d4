"""The three buffers, compared with a slow Python list; their draws, with a χ² test."""

import tracemalloc
from math import exp

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from strategies import positives, rngs, sizes, vectors

from gbdqn_ref.config import Config
from gbdqn_ref.replay import (
    ProportionalReplay,
    RecencyReplay,
    SumTree,
    UniformReplay,
    importance_weights,
)

D = 2
RATES = [0.0, 1e-3, 0.5, 5.0]
OFFSET = 0.1


@pytest.fixture(autouse=True, scope="module")
def small_trees():
    """Trees that already have several levels with a few transitions."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SumTree, "FAN", 4)
        patch.setattr(SumTree, "TOP", 8)
        yield


def transition(number):
    """(s, a, r, s2, terminated), different for each number."""
    s, s2 = np.array([number, 0.5]), np.array([number + 1, -0.5])
    return s, number % 3, -0.25 * number, s2, number % 4 == 3


def fill(replay, n, rng=None):
    """Add n transitions; given a generator, draw their TD errors, a few of them large."""
    for number in range(n):
        replay.add(*transition(number))
    if rng:
        replay.update_priorities(np.arange(len(replay)), rng.standard_t(2, len(replay)))
    return replay


# --- against a list -------------------------------------------------------------------------------


class UniformAgainstAList(RuleBasedStateMachine):
    """The model is a list of [slot, transition, priority], oldest first."""

    kind = UniformReplay

    @initialize(
        capacity=st.sampled_from([5, 18, 1]),  # 18 leaves make a tree of two levels
        exponent=st.sampled_from([0.6, 2.0]),
        is_exponent=st.sampled_from([0.4, 1.0]),
        normalise=st.sampled_from([None, "batch"]),
        mix=st.sampled_from([0.3, 0.0, 1.0]),
        rate=st.sampled_from([0.5, *RATES]),
        n=sizes(20),
    )
    def start(self, capacity, exponent, is_exponent, normalise, mix, rate, n):
        proportional = dict(
            priority_offset=OFFSET,
            priority_exponent=exponent,
            is_exponent=is_exponent,
            normalise=normalise,
        )
        # Uniform is recency alone (mix 0) with rate 0; proportional is mix 1.
        options, self.mix, self.rate = {
            UniformReplay: ({}, 0.0, 0.0),
            ProportionalReplay: (proportional, 1.0, 0.0),
            RecencyReplay: (proportional | dict(mix=mix, recency_rate=rate), mix, rate),
        }[self.kind]
        self.replay = self.kind(capacity, D, **options)
        self.capacity, self.exponent = capacity, exponent
        self.is_exponent, self.normalise = is_exponent, normalise
        self.added, self.stored, self.largest = 0, [], 1.0
        self.replay.check_valid()
        self.add(n)

    def probability(self):
        """Eqs. 10–11: {slot: P}."""
        p = {
            slot: self.mix * priority + (1 - self.mix) * exp(-self.rate * age)
            for age, (slot, _, priority) in enumerate(reversed(self.stored))
        }
        return {slot: p[slot] / sum(p.values()) for slot in p}

    @rule(n=sizes(7))
    def add(self, n):
        for _ in range(n):
            slot = self.replay.add(*transition(self.added))
            assert slot == self.added % self.capacity
            self.stored.append([slot, transition(self.added), self.largest])
            self.stored = self.stored[-self.capacity :]
            self.added += 1

    @rule(n=st.integers(0, 20))
    def keep(self, n):
        self.replay.keep(n)
        self.stored = self.stored[max(0, len(self.stored) - n) :]

    @precondition(lambda self: self.stored)
    @rule(rng=rngs(), errors=sizes(8).flatmap(vectors))
    def learn(self, rng, errors):
        """Learn as an agent does; a slot drawn twice keeps its last TD error."""
        batch, P = self.replay.sample(len(errors), rng), self.probability()
        place = {slot: i for i, (slot, _, _) in enumerate(self.stored)}
        weight = np.array([(len(P) * P[slot]) ** -self.is_exponent for slot in batch.index])
        weight /= weight.max() if self.normalise else 1
        np.testing.assert_allclose(batch.weight, weight, rtol=1e-6)
        self.replay.update_priorities(batch.index, errors)
        for i, slot in enumerate(batch.index):
            entry = self.stored[place[slot]]
            for drawn, added in zip(batch[1:6], entry[1], strict=True):
                assert np.array_equal(drawn[i], added)
            entry[2] = (abs(errors[i]) + OFFSET) ** self.exponent
            self.largest = max(self.largest, entry[2])

    @invariant()
    def the_buffer_is_the_list(self):
        self.replay.check_valid()
        assert len(self.replay) == len(self.stored)
        for age, (slot, (s, a, r, s2, terminated), _) in enumerate(reversed(self.stored)):
            assert self.replay.age(slot) == age
            assert self.replay.s[slot].tolist() == s.tolist()
            assert self.replay.s2[slot].tolist() == s2.tolist()
            assert (self.replay.a[slot], self.replay.r[slot]) == (a, r)
            assert self.replay.terminated[slot] == terminated
        P, slots = self.probability(), self.replay.slots()
        assert sorted(slots) == sorted(P)
        if self.stored:
            expected = [P[slot] for slot in slots]
            np.testing.assert_allclose(self.replay.probabilities(), expected, rtol=1e-12)


class ProportionalAgainstAList(UniformAgainstAList):
    kind = ProportionalReplay


class RecencyAgainstAList(UniformAgainstAList):
    kind = RecencyReplay


def case(machine):
    """Its test; explaining a failure would take a minute, so it is only shrunk."""
    case, phases = machine.TestCase, set(Phase) - {Phase.explain}
    case.settings = settings(case.settings, stateful_step_count=20, phases=phases)
    return case


TestUniform, TestProportional, TestRecency = map(
    case, (UniformAgainstAList, ProportionalAgainstAList, RecencyAgainstAList)
)


# --- draws ----------------------------------------------------------------------------------------


def assert_drawn_from_probabilities(replay, rng, n=100_000):
    """χ² is below its 99.9 % quantile.

    Slots expected fewer than 5 times are merged with the rarest of the others.
    """
    size = len(replay)
    expected = n * replay.probabilities()
    observed = np.bincount(replay.sample(n, rng).index, minlength=size)
    often = expected >= 5
    cell = np.where(often, np.arange(size), np.where(often, expected, np.inf).argmin())
    observed = np.bincount(cell, observed, minlength=size)[often]
    expected = np.bincount(cell, expected, minlength=size)[often]
    dof = often.sum() - 1
    quantile = dof * (1 - 2 / (9 * dof) + 3.0902 * np.sqrt(2 / (9 * dof))) ** 3
    assert ((observed - expected) ** 2 / expected).sum() < quantile  # Wilson–Hilferty: 39 → 72.06


REPLAYS = {"uniform": (UniformReplay, {}), "proportional": (ProportionalReplay, {})} | {
    f"recency-{mix}-{rate}": (RecencyReplay, dict(mix=mix, recency_rate=rate))
    for mix in (0.0, 0.3, 1.0)
    for rate in RATES
}
kinds = pytest.mark.parametrize(("kind", "options"), REPLAYS.values(), ids=REPLAYS)


@kinds
@pytest.mark.parametrize("added", [33, 40, 97], ids=["filling", "full", "wrapped"])
def test_draws_follow_the_probabilities(kind, options, added):
    """Catches ages counted from slot 0, floor(+1), swapped stages, a tree searched backwards."""
    rng = np.random.default_rng(added)
    assert_drawn_from_probabilities(fill(kind(40, D, **options), added, rng), rng)


@kinds
def test_a_batch_has_one_row_per_draw(kind, options):
    batch = fill(kind(5, D, **options), 7).sample(3, np.random.default_rng(0))
    expected = dict(
        index=((3,), np.int64),
        s=((3, D), np.float32),
        a=((3,), np.int64),
        r=((3,), np.float32),
        s2=((3, D), np.float32),
        terminated=((3,), bool),
        weight=((3,), np.float32),
    )
    assert {name: (x.shape, x.dtype) for name, x in batch._asdict().items()} == expected


@kinds
def test_the_same_seed_draws_the_same_batch_and_leaves_the_buffer_alone(kind, options):
    replay = fill(kind(40, D, **options), 97, np.random.default_rng(0))
    before = replay.probabilities().tobytes()
    one, other = (replay.sample(64, np.random.default_rng(1)) for _ in range(2))
    assert all(x.tobytes() == y.tobytes() for x, y in zip(one, other, strict=True))
    assert replay.probabilities().tobytes() == before


def test_ages_count_from_the_newest_without_gaps():
    """The drawing in the docstring: capacity 5 after 7 transitions."""
    assert fill(UniformReplay(5, D), 7).age(np.arange(5)).tolist() == [1, 0, 4, 3, 2]
    assert fill(UniformReplay(5, D), 3).age(np.arange(3)).tolist() == [2, 1, 0]


def test_a_new_transition_gets_the_largest_priority_so_far():
    """The largest ever, not the largest still stored; 1 before there was any."""
    replay = ProportionalReplay(2, D, priority_offset=0.5, priority_exponent=2.0)
    seen = []
    for error in (0.0, 1.5, 0.0, 0.0):
        slot = replay.add(*transition(0))
        seen.append(replay.tree.leaves[slot])
        replay.update_priorities(np.array([slot]), np.array([error]))
    assert seen == [1.0, 1.0, 4.0, 4.0]  # (1.5 + 0.5)² = 4


@pytest.mark.parametrize(
    ("array", "place", "value"),
    [
        (lambda replay: replay.s, 35, 1.0),  # data in an empty slot
        (lambda replay: replay.tree.leaves, 35, 1.0),  # an empty slot that may be drawn
        (lambda replay: replay.tree.leaves, 3, -1.0),
        (lambda replay: replay.tree.leaves, 3, 0.5),  # a leaf missing from its sum
        (lambda replay: replay.tree.levels[1], 9, 1.0),  # a sum without leaves
    ],
)
def test_check_valid_finds_damage(array, place, value):
    replay = fill(ProportionalReplay(40, D), 30)
    replay.check_valid()
    array(replay)[place] = value
    with pytest.raises(AssertionError):
        replay.check_valid()


def test_check_valid_finds_a_negative_priority_even_with_consistent_sums():
    replay = fill(ProportionalReplay(40, D), 30)
    replay.tree.set(np.array([3]), -1.0)
    with pytest.raises(AssertionError):
        replay.check_valid()


def test_a_buffer_and_a_config_have_the_same_defaults():
    config, proportional, recency = Config(), ProportionalReplay(1, D), RecencyReplay(1, D)
    for name in ("priority_offset", "priority_exponent", "is_exponent", "normalise"):
        assert getattr(config, name) == getattr(proportional, name) == getattr(recency, name)


# --- importance weights ---------------------------------------------------------------------------


@given(st.lists(positives(), min_size=2, max_size=6), st.data())
def test_with_exponent_1_the_weights_cancel_the_probabilities(p, data):
    """E_P[w f] = mean f for every f, summed over all transitions."""
    P, f = np.array(p) / sum(p), data.draw(vectors(len(p)))
    w = importance_weights(P, len(P), 1.0, normalise=None)
    assert (P * w * f).sum() == pytest.approx(f.mean(), abs=1e-10)


def test_importance_weights_by_hand():
    P = np.array([0.8, 0.2])  # N P = 1.6 and 0.4
    np.testing.assert_allclose(importance_weights(P, 2, 1.0, None), [0.625, 2.5])
    np.testing.assert_allclose(importance_weights(P, 2, 0.5, None), [0.4**0.5 * 1.25, 2.5**0.5])
    np.testing.assert_allclose(importance_weights(P, 2, 1.0), [0.25, 1.0])
    np.testing.assert_allclose(importance_weights(P, 2, 0.5), [0.5, 1.0])
    assert importance_weights(P, 2, 0.0).tolist() == [1.0, 1.0]


@pytest.mark.parametrize("normalise", ["max", "buffer", True, False, ""])
def test_an_unknown_normalisation_is_refused(normalise):
    with pytest.raises(ValueError, match='normalise must be "batch" or None'):
        importance_weights(np.array([1.0]), 1, 1.0, normalise)


@kinds
def test_sampled_weights_are_at_most_1_and_the_largest_is_1(kind, options):
    rng = np.random.default_rng(0)
    replay = fill(kind(40, D, **options), 97, rng)
    for _ in range(20):
        weight = replay.sample(16, rng).weight
        assert weight.max() == 1 and (weight > 0).all()
        assert kind is not UniformReplay or (weight == 1).all()


# --- the parts ------------------------------------------------------------------------------------


@given(rngs(), sizes(600), st.sampled_from([0.01, 0.3, 1.0]), st.sampled_from([0, 1, 8]))
def test_the_tree_finds_the_same_slots_as_a_cumulative_sum(rng, size, density, spread):
    """With many empty leaves and very different magnitudes, up to rounding at the edges."""
    tree, leaves = SumTree(size), rng.random(size) * 10 ** rng.uniform(-spread, spread, size)
    leaves[rng.random(size) >= density] = 0
    leaves[rng.integers(size)] = 1
    tree.set(np.arange(size), leaves)
    u = np.concatenate([[0, np.nextafter(tree.total(), 0)], rng.random(50) * tree.total()])
    found, edges = tree.find(u), np.concatenate([[0], leaves.cumsum()])
    assert (leaves[found] > 0).all()  # catches ≤ for <, and a u rounded past the last leaf
    slack = 1e-12 * tree.total()
    assert (edges[found] <= u + slack).all() and (u - slack <= edges[found + 1]).all()


@given(rngs(), sizes(600), st.integers(1, 4))
def test_the_tree_is_exact_on_whole_numbers(rng, size, largest):
    """Even at the edges between leaves."""
    tree, leaves = SumTree(size), rng.integers(largest + 1, size=size)
    leaves[rng.integers(size)] = 1
    for slot in rng.permutation(size):  # one by one, in any order
        tree.set(slot, leaves[slot])
    assert tree.total() == leaves.sum()
    u = np.arange(0, leaves.sum(), 0.5)
    assert tree.find(u).tolist() == leaves.cumsum().searchsorted(u, side="right").tolist()


@pytest.mark.parametrize("size", [1, 2048, 2049, 65_536, 65_537, 100_000])
def test_the_tree_is_exact_at_its_real_size(monkeypatch, size):
    """Around the sizes at which it gains a level."""
    monkeypatch.setattr(SumTree, "FAN", 32)
    monkeypatch.setattr(SumTree, "TOP", 2048)
    tree, leaves = SumTree(size), np.random.default_rng(size).integers(1, 4, size)
    tree.set(np.arange(size), leaves)
    u = np.linspace(0, leaves.sum(), 500, endpoint=False)
    assert tree.find(u).tolist() == leaves.cumsum().searchsorted(u, side="right").tolist()
    assert len(tree.levels) == 1 + (size > 2048) + (size > 65_536)


@kinds
def test_adding_a_transition_allocates_nothing(kind, options):
    """Views and scalars take a few hundred bytes; half a state, 8 kB, is too much."""
    replay, s = kind(5_000, 4_096, **options), np.ones(4_096, np.float32)
    replay.add(s, 0, 1.0, s, False)
    tracemalloc.start()
    for _ in range(100):
        replay.add(s, 0, 1.0, s, False)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8_000


def test_the_tree_does_not_accumulate_rounding_errors():
    """Catches sums updated by differences: 1e16 + 1 − 1e16 is 0."""
    tree = SumTree(300)
    tree.set(np.arange(300), np.ones(300))
    tree.set(7, 1e16)
    tree.set(np.array([7, 299, 7]), np.array([3.0, 0.5, 1.0]))  # of two values the last counts
    assert tree.total() == 299.5


@pytest.mark.parametrize("rate", [0.0, 1e-12, 1e-3, 10.0])
@pytest.mark.parametrize("added", [1, 33, 97])
def test_the_closed_form_of_the_time_priorities_equals_their_sum(rate, added):
    """Catches 1 − e^{−α}, which cancels at a small rate."""
    replay = fill(RecencyReplay(40, D, recency_rate=rate), added)
    total = sum(exp(-rate * age) for age in range(min(added, 40)))
    assert replay.time_total() == pytest.approx(total, rel=1e-13)


@given(rngs(), st.floats(0, 1), st.sampled_from(RATES), sizes(60))
def test_the_td_share_is_the_td_part_of_the_total_priority(rng, mix, rate, added):
    replay = fill(RecencyReplay(40, D, mix=mix, recency_rate=rate), added, rng)
    td, time = sum(replay.tree.leaves), sum(exp(-rate * age) for age in range(len(replay)))
    assert replay.td_share() == pytest.approx(mix * td / (mix * td + (1 - mix) * time), rel=1e-12)
    assert 0 <= replay.td_share() <= 1


def test_with_rate_0_recency_is_uniform_and_a_high_rate_draws_only_the_newest():
    even, newest = (RecencyReplay(40, D, mix=0.0, recency_rate=rate) for rate in (0.0, 100.0))
    np.testing.assert_allclose(fill(even, 97).probabilities(), 1 / 40)
    drawn = fill(newest, 97).sample(1000, np.random.default_rng(0)).index
    assert set(drawn) == {96 % 40}


# --- what is refused ------------------------------------------------------------------------------


@kinds
@pytest.mark.parametrize(
    "ask",
    [lambda replay: replay.sample(3, np.random.default_rng(0)), lambda r: r.probabilities()],
    ids=["sample", "probabilities"],
)
def test_an_empty_buffer_cannot_be_sampled(kind, options, ask):
    with pytest.raises(ValueError, match=r"^the buffer is empty"):
        ask(kind(5, D, **options))


@kinds
def test_a_negative_action_is_not_stored(kind, options):
    """Catches −1: as an index it means the last action."""
    replay = kind(5, D, **options)
    with pytest.raises(ValueError, match="not -1"):
        replay.add(np.zeros(D), -1, 0.0, np.zeros(D), False)
    assert len(replay) == 0


@pytest.mark.parametrize("kind", [ProportionalReplay, RecencyReplay])
@pytest.mark.parametrize("error", [np.nan, np.inf, -np.inf])
def test_a_non_finite_td_error_is_refused_and_changes_nothing(kind, error):
    replay = fill(kind(5, D), 5)
    before = replay.probabilities().tolist()
    with pytest.raises(FloatingPointError, match=f"a priority is {abs(error)}: .* diverged"):
        replay.update_priorities(np.array([1, 2]), np.array([0.5, error]))
    assert replay.probabilities().tolist() == before and replay.max_priority == 1.0


@pytest.mark.parametrize("kind", [ProportionalReplay, RecencyReplay])
@pytest.mark.parametrize("priority", [np.nan, np.inf])
def test_a_non_finite_sum_of_priorities_is_reported_as_such(kind, priority):
    replay = fill(kind(5, D), 5)
    replay.tree.set(np.array([3]), priority)
    with pytest.raises(FloatingPointError, match=f"the priorities add up to {priority}"):
        replay.sample(3, np.random.default_rng(0))


# --- if all TD priorities are 0 -------------------------------------------------------------------


def all_zero(kind, n, **options):
    replay = kind(n, 1, priority_offset=0.0, **options)
    for _ in range(n):
        replay.add(0.0, 0, 0.0, 0.0, False)
    replay.update_priorities(np.arange(n), np.zeros(n))
    return replay


@pytest.mark.parametrize("n", [10, 40, 300])
@pytest.mark.parametrize(
    ("kind", "options"), [(ProportionalReplay, {}), (RecencyReplay, {"mix": 1.0})]
)
def test_if_every_priority_is_0_nothing_can_be_drawn(kind, options, n):
    with pytest.raises(ValueError, match="priority_offset must be positive"):
        all_zero(kind, n, **options).sample(3, np.random.default_rng(0))
    with pytest.raises(ValueError, match="priority_offset must be positive"):
        all_zero(kind, n, **options).probabilities()


@pytest.mark.parametrize("n", [10, 40, 300])
@pytest.mark.parametrize("mix", [0.0, 0.5])
def test_without_td_priority_recency_alone_decides_the_draws(mix, n):
    replay = all_zero(RecencyReplay, n, mix=mix, recency_rate=100.0)
    assert set(replay.sample(100, np.random.default_rng(0)).index) == {n - 1}

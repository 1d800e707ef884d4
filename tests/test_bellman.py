"""The TD target, the loss and its gradient, ε-greedy and softmax."""

import numpy as np
import pytest
from helpers import finite_differences
from hypothesis import given
from hypothesis import strategies as st
from strategies import matrices, positives, reals, rngs, sizes, vectors

from gbdqn_ref.bellman import (
    epsilon_greedy,
    epsilon_schedule,
    loss_gradient,
    softmax_policy,
    softmax_sample,
    td_target,
    weighted_loss,
)

qs = sizes(5).flatmap(vectors)
temperatures = positives()


def test_td_targets_by_hand():
    r, terminated = np.array([1.0, -1.0, 0.0]), np.array([False, False, True])
    q_next = np.array([[2.0, 10.0], [-3.0, -7.0], [50.0, 60.0]])
    y = td_target(r, terminated, q_next, 0.5)
    assert y.tolist() == [1 + 10 / 2, -1 - 3 / 2, 0]


@pytest.mark.parametrize("value", [1e30, np.inf, np.nan])
def test_a_terminal_transition_does_not_bootstrap(value):
    """Catches (1 − terminated) · q: 0 · ∞ is NaN."""
    r, terminated = np.array([-1.0, 2.0]), np.array([True, True])
    assert td_target(r, terminated, np.full((2, 3), value), 0.99).tolist() == r.tolist()


@given(rngs(), sizes(6), sizes(3))
def test_the_gradient_matches_finite_differences_of_the_loss(rng, B, A):
    q, y = rng.normal(size=(B, A)), rng.normal(size=B)
    weight, a = rng.random(B), rng.integers(A, size=B)

    def loss(q):
        return weighted_loss(y - q[np.arange(B), a], weight)

    expected = finite_differences(loss, q, step=1e-4)  # quadratic: any step is exact
    grad = loss_gradient(y - q[np.arange(B), a], weight, a, A)
    np.testing.assert_allclose(grad, expected, rtol=1e-6, atol=1e-10)


def test_each_member_of_a_stack_gets_its_own_gradient():
    error, weight = np.array([[1.0, -2.0], [3.0, 4.0]]), np.array([[0.5, 1.0], [0.0, 1.0]])
    a = np.array([1, 0])
    assert loss_gradient(error, weight, a, 2).tolist() == [[[0, -0.25], [1, 0]], [[0, 0], [-2, 0]]]


def test_the_loss_by_hand():
    """(½ · 1 · 4 + ½ · ½ · 16) / 2 = 3."""
    assert weighted_loss(np.array([2.0, -4.0]), np.array([1.0, 0.5])) == 3.0


def test_each_weight_stays_with_its_sample():
    """Catches weights that are normalised away or broadcast to (B, B)."""
    error, weight, a = np.array([1.0, -2.0, 4.0]), np.array([0.25, 0.5, 1.0]), np.array([0, 1, 0])
    one, other = loss_gradient(error, weight, a, 2), loss_gradient(error, weight[::-1], a, 2)
    assert one.tolist() == (np.array([[-0.25, 0], [0, 1], [-4, 0]]) / 3).tolist()
    assert other.tolist() == (np.array([[-1, 0], [0, 1], [-1, 0]]) / 3).tolist()
    assert weighted_loss(error, weight) != weighted_loss(error, weight[::-1])


COLUMN, ROW, ACTIONS = np.ones((3, 1)), np.ones(3), np.zeros(3, int)


@pytest.mark.parametrize(
    "call",
    [
        lambda: weighted_loss(COLUMN, ROW),
        lambda: weighted_loss(ROW, COLUMN),
        lambda: loss_gradient(COLUMN, ROW, ACTIONS, 2),
        lambda: loss_gradient(ROW, COLUMN, ACTIONS, 2),
        lambda: loss_gradient(ROW, ROW, ACTIONS[:, None], 2),
        lambda: loss_gradient(COLUMN, COLUMN, ACTIONS, 2),
        lambda: td_target(COLUMN, ROW > 0, np.ones((3, 2)), 0.9),
        lambda: td_target(ROW, COLUMN > 0, np.ones((3, 2)), 0.9),
        lambda: td_target(ROW, ROW > 0, np.ones((1, 2)), 0.9),
    ],
)
def test_a_column_among_rows_is_refused_instead_of_broadcast(call):
    with pytest.raises(AssertionError, match="3"):
        call()


def test_float32_stays_float32():
    x, a = np.ones(3, np.float32), np.zeros(3, int)
    y = td_target(x, x > 1, np.ones((3, 2), np.float32), 0.99)
    results = [y, weighted_loss(y, x), loss_gradient(y, x, a, 2), softmax_policy(y, 0.5)]
    assert {(result.dtype, np.shape(result)) for result in results} == {
        (np.dtype(np.float32), shape) for shape in [(3,), (), (3, 2)]
    }


@given(qs, temperatures, reals(), positives())
def test_softmax_depends_only_on_differences_of_q_over_the_temperature(
    q, temperature, shift, factor
):
    policy = softmax_policy(q, temperature)
    np.testing.assert_allclose(policy.sum(), 1)
    shifted = softmax_policy(q + shift, temperature)
    scaled = softmax_policy(factor * q, factor * temperature)
    np.testing.assert_allclose(shifted, policy, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(scaled, policy, rtol=1e-7, atol=1e-12)


@given(qs, temperatures)
def test_softmax_keeps_the_order_and_loses_at_most_its_entropy(q, temperature):
    """E_π Q ≥ max Q − τ ln |A|: the price of exploring."""
    policy = softmax_policy(q, temperature)
    assert (np.diff(policy[np.argsort(q)]) >= 0).all()
    assert policy @ q >= q.max() - temperature * np.log(len(q)) - 1e-9


@given(matrices(3, 2), temperatures)
def test_softmax_is_over_the_last_axis(q, temperature):
    rows = [softmax_policy(row, temperature) for row in q]
    np.testing.assert_allclose(softmax_policy(q, temperature), rows)


@pytest.mark.parametrize("temperature", [1e-3, 1e-9, 1e-100])
def test_a_cold_softmax_is_uniform_over_the_best_actions(temperature):
    assert softmax_policy(np.array([1e3, 0.0, 1e3, -1e3]), temperature).tolist() == [0.5, 0, 0.5, 0]


@pytest.mark.parametrize("temperature", [0.0, -1.0, np.nan])
def test_a_temperature_that_is_not_positive_is_refused(temperature):
    with pytest.raises(ValueError, match="temperature must be positive"):
        softmax_policy(np.zeros(2), temperature)


@given(st.floats(0, 1), st.floats(0, 1), sizes(1000))
def test_epsilon_falls_linearly_from_start_to_end_and_stays_there(start, end, decay_steps):
    epsilons = [epsilon_schedule(step, start, end, decay_steps) for step in range(decay_steps + 3)]
    assert epsilons[0] == start
    assert epsilons[-3] == epsilons[-2] == epsilons[-1] == pytest.approx(end, abs=1e-12)
    np.testing.assert_allclose(np.diff(epsilons[:-2]), (end - start) / decay_steps, atol=1e-12)
    assert epsilons == sorted(epsilons, reverse=start > end)


def chi_square(draw, probabilities, n=20_000):
    """Σ (observed − expected)² / expected of n draws."""
    observed = np.bincount([draw() for _ in range(n)], minlength=len(probabilities))
    expected = n * probabilities
    return ((observed - expected) ** 2 / expected).sum()


CHI_SQUARE_3_DOF = 16.266  # 99.9 % quantile; four actions have three degrees of freedom
Q = np.array([0.5, 2.0, -1.0, 0.0], np.float32)


def test_epsilon_greedy_explores_all_actions_uniformly():
    rng = np.random.default_rng(0)
    expected = np.array([0.1, 0.7, 0.1, 0.1])  # ε = 0.4 over all four, and 0.6 for the best
    assert chi_square(lambda: epsilon_greedy(Q, 0.4, rng), expected) < CHI_SQUARE_3_DOF


def test_with_epsilon_0_the_first_best_action_is_taken():
    rng = np.random.default_rng(0)
    assert {epsilon_greedy(np.array([0.0, 1.0, 1.0]), 0.0, rng) for _ in range(100)} == {1}


@pytest.mark.parametrize("temperature", [0.5, 1.0, 10.0])
def test_softmax_actions_are_drawn_from_the_policy(temperature):
    rng, weights = np.random.default_rng(0), np.exp(Q / temperature)
    draws = chi_square(lambda: softmax_sample(Q, temperature, rng), weights / weights.sum())
    assert draws < CHI_SQUARE_3_DOF


def test_columns_among_columns_are_refused():
    with pytest.raises(AssertionError, match="1"):
        loss_gradient(np.ones((3, 1)), np.ones((3, 1)), np.zeros((3, 1), int), 2)

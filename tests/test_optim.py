"""Adam by hand; the properties of clipping and of Polyak averaging."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import positives, reals, rngs, sizes, vectors

from gbdqn_ref.optim import Adam, clip_by_norm, polyak


def test_three_steps_of_adam_by_hand():
    """A large eps shows its place: outside the root, added after the correction."""
    theta, adam = np.array([1.0]), Adam(1, lr=0.1, betas=(0.5, 0.75), eps=0.5)
    # g =  4:  m = 0/2 + 4/2 =  2,  m̂ =  2 / (1/2) = 4
    #          v = 0 + 16/4 =  4,   v̂ =  4 / (1/4) = 16
    # g =  2:  m = 2/2 + 2/2 =  2,  m̂ =  2 / (3/4) = 8/3
    #          v = 3 +  4/4 =  4,   v̂ =  4 / (7/16) = 64/7
    # g = −6:  m = 2/2 − 6/2 = −2,  m̂ = −2 / (7/8) = −16/7
    #          v = 3 + 36/4 = 12,   v̂ = 12 / (37/64) = 768/37
    first = 1 - 0.1 * 4 / (4 + 0.5)
    second = first - 0.1 * (8 / 3) / ((64 / 7) ** 0.5 + 0.5)
    third = second + 0.1 * (16 / 7) / ((768 / 37) ** 0.5 + 0.5)
    for g, expected in [(4.0, first), (2.0, second), (-6.0, third)]:
        adam.step(theta, np.array([g]))
        np.testing.assert_allclose(theta, expected, rtol=1e-14)


def test_adams_constants_are_those_of_its_paper():
    assert (Adam(1, lr=1).betas, Adam(1, lr=1).eps) == ((0.9, 0.999), 1e-8)


@given(rngs(), sizes(3), sizes(5))
def test_adam_treats_a_stack_like_each_member_alone(rng, k, n):
    stack = rng.normal(size=(k, n)).astype(np.float32)
    gradients = rng.normal(size=(4, k, n)).astype(np.float32)
    members, together, alone = stack.copy(), Adam((k, n), 0.01), [Adam(n, 0.01) for _ in range(k)]
    for gradient in gradients:
        together.step(stack, gradient)
        for j in range(k):
            alone[j].step(members[j], gradient[j])
    np.testing.assert_array_equal(stack, members)


@given(vectors(4, reals().filter(bool)), positives())
def test_adams_first_step_is_lr_against_the_sign(g, lr):
    theta = np.zeros(4)
    Adam(4, lr).step(theta, g)  # catches moments without their correction
    np.testing.assert_allclose(theta, -lr * np.sign(g), rtol=1e-4)


def test_adam_works_in_place_and_leaves_the_gradient_alone():
    whole, grad = np.ones((2, 3), np.float32), np.ones(3, np.float32)
    Adam(3, 0.1).step(whole[1], grad)  # a view into something larger
    assert (whole[0] == 1).all() and (whole[1] < 1).all() and whole.dtype == np.float32
    assert (grad == 1).all()


def test_adams_moments_never_become_denormal_and_zero_gradients_move_nothing():
    theta, adam = np.array([1, 1, -1, 1], np.float32), Adam(4, lr=1e-3)
    for g in ([1, -1, 1e-3, 0], [-1, -1, 1e-9, 0]):
        adam.step(theta, np.array(g, np.float32))
    for step in range(2000):
        if step == 1500:
            late = theta.copy()
        adam.step(theta, np.zeros(4, np.float32))
        for moment in (adam.m, adam.v):
            assert (np.abs(moment[moment != 0]) > np.finfo(np.float32).tiny).all()
    assert not adam.m.any() and adam.v[:2].all()
    assert theta.tobytes() == late.tobytes() and theta[3] == 1


@given(vectors(3), vectors(3), positives())
def test_clipping_shortens_only_gradients_that_are_too_long(first, second, max_norm):
    stack = np.array([first, second])
    for grad, clipped in zip(stack, clip_by_norm(stack, max_norm), strict=True):
        norm, clipped_norm = np.linalg.norm(grad), np.linalg.norm(clipped)
        assert clipped_norm <= max_norm * (1 + 1e-6)
        # the direction is the same
        np.testing.assert_allclose(clipped * norm, grad * clipped_norm, rtol=1e-9, atol=1e-9)
        if norm < max_norm * (1 - 1e-9):
            assert clipped.tolist() == grad.tolist()
        # catches a norm over the whole stack
        np.testing.assert_array_equal(clipped, clip_by_norm(grad, max_norm))


def test_clipping_accepts_a_zero_gradient_and_keeps_the_precision():
    """Catches max_norm / ‖grad‖, which warns at 0; warnings are errors here."""
    clipped = clip_by_norm(np.zeros((2, 3), np.float32), 10.0)
    assert not clipped.any() and clipped.dtype == np.float32


@pytest.mark.filterwarnings("ignore:overflow encountered in vecdot")
@pytest.mark.parametrize(("dtype", "size"), [(np.float32, 1e19), (np.float64, 1e200)])
def test_a_norm_that_overflows_is_clipped_too(dtype, size):
    """3² + 4² = 5² in any unit, but float32 cannot hold the square of 1e19."""
    grad = np.array([3, 4], dtype) * dtype(size)
    np.testing.assert_allclose(clip_by_norm(grad, 10.0), [6, 8], rtol=1e-6)
    np.testing.assert_allclose(clip_by_norm(grad, 20 * size), grad, rtol=1e-6)
    assert clip_by_norm(grad, 10.0).dtype == dtype


@pytest.mark.filterwarnings("ignore:overflow encountered in vecdot")
def test_a_norm_that_overflows_leaves_the_rest_of_the_stack_alone():
    huge = np.finfo(np.float32).max
    usual = np.array([[0.3, -0.4], [30.0, 0.1], [0.0, 0.0]], np.float32)
    stack = np.concatenate([usual, np.array([[huge, -huge]])]).astype(np.float32)
    clipped = clip_by_norm(stack, 10.0)
    assert clipped[:3].tobytes() == clip_by_norm(usual, 10.0).tobytes()
    np.testing.assert_allclose(clipped[3], [50**0.5, -(50**0.5)], rtol=1e-6)


@given(vectors(3), vectors(3))
def test_polyak_with_0_does_nothing_and_with_1_copies(target, theta):
    same, copy = target.copy(), target.copy()
    polyak(same, theta, 0)
    polyak(copy, theta, 1)
    assert same.tolist() == target.tolist() and copy.tolist() == theta.tolist()


@given(vectors(3), vectors(3), st.floats(0, 1), st.integers(0, 50))
def test_polyak_closes_the_gap_geometrically(start, theta, tau, k):
    target = start.copy()
    for _ in range(k):
        polyak(target, theta, tau)
    left = (1 - tau) ** k
    np.testing.assert_allclose(target, left * start + (1 - left) * theta, atol=1e-10)


def test_with_tau_one_percent_half_of_the_gap_is_closed_in_69_updates():
    target, gaps = np.ones(1, np.float32), []
    for _ in range(69):
        polyak(target, np.zeros(1, np.float32), 0.01)
        gaps.append(target[0])
    assert gaps[67] > 0.5 > gaps[68]
    assert target.dtype == np.float32


@pytest.mark.parametrize("shape", [(3,), (2, 3)])
def test_polyak_works_in_place(shape):
    target, theta = np.zeros(shape), np.ones(shape)
    assert polyak(target, theta, 0.5) is None
    assert (target == 0.5).all() and (theta == 1).all()

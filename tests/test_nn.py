"""The network, compared with loops, with single members and with finite differences."""

import numpy as np
import pytest
from helpers import finite_differences
from hypothesis import assume, given
from strategies import nets, rngs, sizes

from gbdqn_ref.nn import MLP

hidden_layers = pytest.mark.parametrize("hidden", [(), (4,), (4, 3)], ids=["linear", "one", "two"])


def loops(net, theta, x):
    """q (A,) of one θ (P,) and one x (d,) by loops, and the smallest |z| before a ReLU."""
    *hidden, last = net.unpack(theta.astype(np.float64))
    kink = np.inf

    def affine(x, W, b):
        return [b[j] + sum(x[i] * W[i, j] for i in range(len(x))) for j in range(len(b))]

    for W, b in hidden:
        z = affine(x, W, b)
        kink = min(kink, *np.abs(z))
        x = [max(z_j, 0.0) for z_j in z]
    return np.array(affine(x, *last)), kink


def test_a_block_holds_the_weights_then_the_bias():
    net = MLP((2, 3, 1))
    (W1, b1), (W2, b2) = net.unpack(np.arange(13))
    assert W1.tolist() == [[0, 1, 2], [3, 4, 5]] and b1.tolist() == [6, 7, 8]
    assert W2.tolist() == [[9], [10], [11]] and b2.tolist() == [12]


@given(nets())
def test_unpack_gives_views_that_cover_all_of_theta(net):
    for theta in (np.zeros(net.size), np.zeros((2, net.size))):
        for W, b in net.unpack(theta):
            W += 1
            b += 1
        assert (theta == 1).all()


@given(nets(), rngs(), sizes())
def test_forward_matches_the_loops(net, rng, B):
    theta, x = net.init(rng).astype(np.float64), rng.normal(size=(B, net.widths[0]))
    expected = [loops(net, theta, row)[0] for row in x]
    np.testing.assert_allclose(net.forward(theta, x)[0], expected, atol=1e-12)


@given(nets(), rngs(), sizes(3), sizes())
def test_a_stack_computes_the_same_as_each_member_alone(net, rng, k, B):
    """Catches a reshape that mixes members but keeps the shapes."""
    theta, dq = net.init(rng, k), rng.normal(size=(k, B, net.widths[-1])).astype(np.float32)
    for x in (rng.normal(size=(B, net.widths[0])), rng.normal(size=(k, B, net.widths[0]))):
        q, cache = net.forward(theta, x)
        grad = net.backward(theta, cache, dq)
        assert q.shape == dq.shape and grad.shape == theta.shape
        for j, x_j in enumerate(np.broadcast_to(x, (k, *x.shape[-2:]))):
            q_j, cache_j = net.forward(theta[j], x_j)
            grad_j = net.backward(theta[j], cache_j, dq[j])
            np.testing.assert_allclose(q[j], q_j, rtol=1e-4, atol=1e-5)
            np.testing.assert_allclose(grad[j], grad_j, rtol=1e-4, atol=1e-5)


@given(nets(), rngs(), sizes(3), sizes())
def test_one_network_takes_any_leading_axes(net, rng, T, B):
    theta, x = net.init(rng), rng.normal(size=(T, B, net.widths[0]))
    q, _ = net.forward(theta, x)
    assert q.shape == (T, B, net.widths[-1])
    for t in range(T):
        np.testing.assert_allclose(q[t], net.forward(theta, x[t])[0], rtol=1e-4, atol=1e-5)


@hidden_layers
@given(rng=rngs(), k=sizes(2), B=sizes(3))
def test_backward_matches_finite_differences(hidden, rng, k, B):
    net = MLP((3, *hidden, 2))
    theta, x = net.init(rng, k).astype(np.float64), rng.normal(size=(B, 3))
    dq = rng.normal(size=(k, B, 2))
    assume(min(loops(net, member, row)[1] for member in theta for row in x) > 1e-3)
    grad = net.backward(theta, net.forward(theta, x)[1], dq)

    def f(theta):
        return (dq * net.forward(theta, x)[0]).sum()

    # between two kinks f is linear in each parameter, so only rounding errors remain
    expected = finite_differences(f, theta, step=1e-5)
    np.testing.assert_allclose(grad, expected, rtol=1e-6, atol=1e-8)


@given(nets(), rngs(), sizes())
def test_backward_is_pure(net, rng, B):
    """Catches `dz = dq; dz *= …` and gradients that accumulate."""
    theta, x = net.init(rng), rng.normal(size=(B, net.widths[0]))
    dq = rng.normal(size=(B, net.widths[-1])).astype(np.float32)
    _, cache = net.forward(theta, x)
    before = [array.tobytes() for array in (theta, dq, *cache)]
    first, second = net.backward(theta, cache, dq), net.backward(theta, cache, dq)
    assert first.tobytes() == second.tobytes() and not np.shares_memory(first, second)
    assert [array.tobytes() for array in (theta, dq, *cache)] == before


@pytest.mark.parametrize("of_theta", [np.float32, np.float64])
@pytest.mark.parametrize("of_x", [np.float32, np.float64])
def test_the_arithmetic_has_the_precision_of_theta(of_theta, of_x):
    net = MLP((2, 3, 1))
    theta = net.init(np.random.default_rng(0)).astype(of_theta)
    q, cache = net.forward(theta, np.ones((4, 2), of_x))
    arrays = (q, *cache, net.backward(theta, cache, q))
    assert {array.dtype for array in arrays} == {np.dtype(of_theta)}


def test_init_is_uniform_within_one_over_the_root_of_the_inputs():
    """Catches 1/n_in, and the bias counted as an input: √10 instead of √9."""
    net = MLP((9, 1000, 1000))
    theta = net.init(np.random.default_rng(0))
    assert theta.dtype == np.float32
    for (W, b), n_in in zip(net.unpack(theta), net.widths, strict=False):
        for part in (W, b):
            scaled = part.ravel() * np.sqrt(n_in)
            assert 0.99 < np.abs(scaled).max() <= 1 + 1e-6
            assert abs(scaled.mean()) < 0.1 and abs(scaled.var() - 1 / 3) < 0.05


@given(nets(), rngs())
def test_the_members_of_a_stack_start_apart(net, rng):
    theta = net.init(rng, 3)
    assert theta.shape == (3, net.size) and theta.dtype == np.float32
    assert not ((theta[0] == theta[1]) | (theta[1] == theta[2]) | (theta[2] == theta[0])).any()


@given(nets(), rngs(), sizes())
def test_with_zero_output_the_network_is_0_and_still_learns(net, rng, B):
    theta, x = net.init(rng, zero_output=True), rng.normal(size=(B, net.widths[0]))
    q, cache = net.forward(theta, x)
    assert not q.any()
    assert net.backward(theta, cache, np.ones_like(q)).any()
    assert all(W.any() and b.any() for W, b in net.unpack(theta)[:-1])


@pytest.mark.parametrize("widths", [(), (3,), (0, 1), (2, 0, 1), (2, -3, 1), (2, 3, 0)], ids=str)
def test_invalid_widths_are_refused(widths):
    with pytest.raises(ValueError, match="widths must be two or more positive integers"):
        MLP(widths)

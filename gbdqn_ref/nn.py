"""The Q-network: a multilayer perceptron whose parameters are one flat vector θ.

    θ (P,):  | W₁ b₁ | W₂ b₂ | … | W_L b_L |   each block (n_in + 1, n_out), its last row the bias

A bias is the weight of an input that is always 1. So a layer is one matrix product forward, and
the gradients of its weights and bias are one matrix product backward. Because θ is flat, Adam,
clipping, Polyak averaging, freezing and saving take one line each. Leading axes broadcast: a stack
θ (K, P) is K networks, evaluated together.

Letters: x input, h activations with the constant 1 appended, z = h V before the ReLU, q output, V
one layer's block, B batch, d inputs, A outputs (actions).
"""

from itertools import accumulate, pairwise

import numpy as np


class MLP:
    """Fully connected network with ReLU inside and a linear output.

    h_{l+1} = [max(0, h_l V_l), 1],  q = h_L V_L

    >>> net = MLP((2, 3, 1))
    >>> net.size                                                      # (2 + 1) · 3 + (3 + 1) · 1
    13
    >>> theta = net.init(np.random.default_rng(0))
    >>> [(W.shape, b.shape) for W, b in net.unpack(theta)]
    [((2, 3), (3,)), ((3, 1), (1,))]
    """

    def __init__(self, widths):
        self.widths = tuple(int(width) for width in widths)
        if len(self.widths) < 2 or min(self.widths) < 1:
            raise ValueError(f"widths must be two or more positive integers, not {widths}")
        shapes = [(n_in + 1, n_out) for n_in, n_out in pairwise(self.widths)]
        ends = [0, *accumulate(rows * columns for rows, columns in shapes)]
        spans = [slice(*span) for span in pairwise(ends)]
        self.blocks = list(zip(spans, shapes, strict=True))  # where V_l lies in θ, and its shape
        self.size = ends[-1]

    def init(self, rng, k=None, zero_output=False):
        """Random parameters θ (P,), or k independent ones (k, P), from U(±1/√n_in), in float32.

        zero_output sets the last layer to 0. The network is then the zero function, but its
        gradient is not zero.
        """
        theta = np.empty(self.size if k is None else (k, self.size), np.float32)
        for V, n_in in zip(self.layers(theta), self.widths, strict=False):
            V[...] = rng.uniform(-1, 1, V.shape) / np.sqrt(n_in)
        if zero_output:
            self.layers(theta)[-1][...] = 0
        return theta

    def layers(self, theta):
        """The blocks V_l (…, n_in + 1, n_out) of θ (…, P), as views."""
        lead = theta.shape[:-1]
        return [theta[..., span].reshape(lead + shape) for span, shape in self.blocks]

    def unpack(self, theta):
        """[(W (…, n_in, n_out), b (…, n_out)), …] of θ (…, P), as views into θ."""
        return [(V[..., :-1, :], V[..., -1, :]) for V in self.layers(theta)]

    def forward(self, theta, x):
        """q (…, B, A) for x (…, B, d), and the activations of every layer for backward().

        The leading axes of θ (…, P) and of x broadcast; the arithmetic has θ's precision.
        """
        *hidden, last = self.layers(theta)
        h = _with_ones(x.shape, theta.dtype)  # (…, B, d + 1)
        h[..., :-1] = x
        cache = [h]
        for V in hidden:
            z = h @ V  # (…, B, n_out)
            h = _with_ones(z.shape, theta.dtype)
            # an array of zeros takes half the time of a scalar 0
            np.maximum(z, np.zeros(z.shape[-1], z.dtype), out=h[..., :-1])
            cache.append(h)
        return h @ last, cache

    def backward(self, theta, cache, dq):
        """∂L/∂θ, shaped like θ, from ∂L/∂q (…, B, A).

        ∂L/∂V_l = h_lᵀ dz_l,  dz_{l−1} = (dz_l W_lᵀ) · 1{h_l > 0}. Nothing accumulates: the same
        call gives the same result.
        """
        grad, dz = np.empty_like(theta), dq
        layers = zip(cache, self.layers(theta), self.layers(grad), strict=True)
        for depth, (h, V, dV) in reversed(list(enumerate(layers))):
            np.matmul(h.swapaxes(-1, -2), dz, out=dV)
            if depth:
                dz = dz @ V[..., :-1, :].swapaxes(-1, -2)  # (…, B, n_in)
                dz *= h[..., :-1] > 0
        return grad


def _with_ones(shape, dtype):
    """An uninitialised array with a last column of ones: shape (…, n) becomes (…, n + 1)."""
    h = np.empty((*shape[:-1], shape[-1] + 1), dtype)
    h[..., -1] = 1
    return h

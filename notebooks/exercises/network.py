"""The exercises of notebook 14: the network, its gradient and its optimizer."""

import numpy as np

from . import Exercise

# Parameters


def parameters(widths):
    """Each layer has a weight for each of its inputs and one for the constant 1."""
    return sum((widths[k] + 1) * widths[k + 1] for k in range(len(widths) - 1))


def no_bias(widths):
    return sum(widths[k] * widths[k + 1] for k in range(len(widths) - 1))


def one_bias_a_layer(widths):
    return no_bias(widths) + len(widths) - 1


def units(widths):
    return sum(widths)


def bias_of_inputs(widths):
    return no_bias(widths) + sum(widths)


def first_layer(widths):
    return (widths[0] + 1) * widths[1]


# Backward


def backward(h, V, dz):
    """The weights' derivatives, and the way back through the weights and the ReLU."""
    return h.T @ dz, (dz @ V[:-1].T) * (h[:, :-1] > 0)


def no_relu(h, V, dz):
    return h.T @ dz, dz @ V[:-1].T


def with_bias(h, V, dz):
    return h.T @ dz, (dz @ V.T) * (h > 0)


def first_row_as_bias(h, V, dz):
    return h.T @ dz, (dz @ V[1:].T) * (h[:, :-1] > 0)


def scaled_by_h(h, V, dz):
    return h.T @ dz, (dz @ V[:-1].T) * h[:, :-1]


def averaged(h, V, dz):
    return h.T @ dz / len(h), (dz @ V[:-1].T) * (h[:, :-1] > 0)


def transposed(h, V, dz):
    return dz.T @ h, (dz @ V[:-1].T) * (h[:, :-1] > 0)


def layer(batch, inputs, outputs):
    """A case: some activations, about half of them 0, a block and a derivative."""
    rng = np.random.default_rng(batch)
    h = np.maximum(0, rng.normal(size=(batch, inputs))).round(1)
    V, dz = rng.normal(size=(inputs + 1, outputs)), rng.normal(size=(batch, outputs))
    return np.hstack([h, np.ones((batch, 1))]), V.round(1), dz.round(1)


SMALL = np.array([[2.0, 0.0, 1.0]]), np.array([[3.0], [5.0], [7.0]]), np.array([[1.0]])


# Adam


def adam_step(theta, m, v, t, g, lr):
    """Both means are corrected for their start at 0."""
    m = 0.9 * m + 0.1 * g
    v = 0.999 * v + 0.001 * g**2
    step = lr * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
    return theta - step, m, v


def uphill(theta, m, v, t, g, lr):
    stepped, m, v = adam_step(theta, m, v, t, g, lr)
    return 2 * theta - stepped, m, v


def uncorrected(theta, m, v, t, g, lr):
    m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
    return theta - lr * m / (np.sqrt(v) + 1e-8), m, v


def without_root(theta, m, v, t, g, lr):
    m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
    return theta - lr * (m / (1 - 0.9**t)) / (v / (1 - 0.999**t) + 1e-8), m, v


def without_square(theta, m, v, t, g, lr):
    m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * np.abs(g)
    step = lr * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
    return theta - step, m, v


def swapped_rates(theta, m, v, t, g, lr):
    m, v = 0.1 * m + 0.9 * g, 0.001 * v + 0.999 * g**2
    step = lr * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
    return theta - step, m, v


def corrected_kept(theta, m, v, t, g, lr):
    theta, m, v = adam_step(theta, m, v, t, g, lr)
    return theta, m / (1 - 0.9**t), v / (1 - 0.999**t)


def without_epsilon(theta, m, v, t, g, lr):
    m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
    return theta - lr * (m / (1 - 0.9**t)) / np.sqrt(v / (1 - 0.999**t)), m, v


def epsilon_in_the_root(theta, m, v, t, g, lr):
    m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
    root = np.sqrt(v / (1 - 0.999**t) + 1e-8)
    return theta - lr * (m / (1 - 0.9**t)) / root, m, v


# Clipping


def clip(g, c):
    """A factor of at most 1 for all coordinates."""
    return g * min(1, c / np.linalg.norm(g))


def always_scaled(g, c):
    return g * c / np.linalg.norm(g)


def each_coordinate(g, c):
    return np.clip(g, -c, c)


def squared_length(g, c):
    return g * min(1, c / (g**2).sum())


def largest_coordinate(g, c):
    return g * min(1, c / np.abs(g).max())


def only_lengthened(g, c):
    return g * max(1, c / np.linalg.norm(g))


EXERCISES = [
    Exercise(
        "parameters",
        "for each of its outputs a layer has a weight for each input and a bias.",
        parameters,
        {
            "The biases are missing.": no_bias,
            "Each unit has a bias, not each layer.": one_bias_a_layer,
            "That counts units; a parameter belongs to a pair of units.": units,
            "The inputs have no bias: nothing comes before them.": bias_of_inputs,
            "That is the first layer only.": first_layer,
        },
        [((2, 1),), ((2, 3, 1),), ((6, 128, 128, 3),)],
    ),
    Exercise(
        "backward",
        "hᵀ dz for the block; for the way back leave out the bias row, V[:-1], and let"
        " nothing through where the ReLU gave 0.",
        backward,
        {
            "The ReLU is missing: where it gave 0, nothing goes back.": no_relu,
            "The bias row goes back, too; its input is the constant 1.": with_bias,
            "The bias is the last row of V, not the first.": first_row_as_bias,
            "The ReLU's derivative is 1 or 0, not the activation.": scaled_by_h,
            "A sum over the batch, not a mean: dz has the factor.": averaged,
            "∂L/∂V is transposed: it has V's shape.": transposed,
        },
        [SMALL, layer(2, 3, 2), layer(5, 4, 3)],
    ),
    Exercise(
        "adam_step",
        "m and v first, both divided by 1 − βᵗ only inside the step.",
        adam_step,
        {
            "That goes uphill: the step is subtracted.": uphill,
            "The start at 0 is not corrected: divide by 1 − βᵗ.": uncorrected,
            "The root of v is missing.": without_root,
            "v is a mean of squares, g².": without_square,
            "β weighs the old mean, 1 − β the new gradient.": swapped_rates,
            "Keep the plain means, not the corrected ones.": corrected_kept,
            "ε is missing: add it to the root.": without_epsilon,
            "ε stands outside the root.": epsilon_in_the_root,
        },
        [
            (0.0, 0.0, 0.0, 1, 4.0, 0.1),
            (1.0, 0.5, 0.25, 3, -2.0, 0.01),
            (0.0, 0.0, 0.0, 1, 1e-8, 0.1),
            (np.zeros(2), np.array([0.1, -0.1]), np.full(2, 0.01), 10, np.ones(2), 0.1),
        ],
    ),
    Exercise(
        "clip",
        "the factor is c / ‖g‖, but never more than 1.",
        clip,
        {
            "A short gradient is lengthened: the factor is at most 1.": always_scaled,
            "Each coordinate is clipped, which turns the gradient.": each_coordinate,
            "That divides by ‖g‖²: the root is missing.": squared_length,
            "The length is not the largest coordinate.": largest_coordinate,
            "The smaller of 1 and c / ‖g‖ is wanted, not the larger.": only_lengthened,
        },
        [
            (np.array([3.0, 4.0]), 10.0),
            (np.array([3.0, 4.0]), 2.0),
            (np.array([6.0, 8.0]), 7.0),
        ],
    ),
]

"""The closed-form step against exact fractions, and the ensemble against its sum."""

import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import nets, rngs, sizes, vectors, weighted_samples

from gbdqn_ref.boosting import Ensemble, closed_form_alpha
from gbdqn_ref.config import Config
from gbdqn_ref.gbdqn import GBDQN
from gbdqn_ref.nn import MLP

EXACT = 1e-13  # relative to Σ |w r h|, since terms of A cancel; the fractions do not round


def inner(weights, x, y):
    """Σ w x y, exactly."""
    terms = zip(weights, x, y, strict=True)
    return sum(Fraction(w) * Fraction(x_i) * Fraction(y_i) for w, x_i, y_i in terms)


@given(weighted_samples(), st.booleans(), st.sampled_from([1e-6, -0.5, 3.0, 1e6]))
def test_alpha_is_the_minimum_of_its_parabola(sample, weighted, d):
    """f(α + d) − f(α) = d² B for both signs of d, where f(α) = Σ w (r − α h)², in fractions."""
    residual, h, weights = sample
    assume(h.any())
    alpha = closed_form_alpha(residual, h, weights if weighted else None)
    weights = weights if weighted else np.ones_like(h)

    def f(alpha):
        e = [Fraction(r_i) - alpha * Fraction(h_i) for r_i, h_i in zip(residual, h, strict=True)]
        return inner(weights, e, e)

    alpha, d = Fraction(alpha), Fraction(d)
    slack = 2 * abs(d) * inner(weights, abs(residual), abs(h)) * Fraction(EXACT)
    assert abs(f(alpha + d) - f(alpha) - d**2 * inner(weights, h, h)) <= slack


@given(weighted_samples())
def test_the_new_residual_is_orthogonal_to_the_booster(sample):
    residual, h, weights = sample
    alpha = Fraction(closed_form_alpha(residual, h, weights))
    left = [Fraction(r) - alpha * Fraction(h_i) for r, h_i in zip(residual, h, strict=True)]
    assert abs(inner(weights, left, h)) <= inner(weights, abs(residual), abs(h)) * Fraction(EXACT)


@given(weighted_samples())
def test_weighting_is_the_same_as_scaling_both_vectors_by_the_root(sample):
    residual, h, weights = sample
    assume(h.any())
    root = np.sqrt(weights)
    scale = np.abs(weights * residual * h).sum() / (weights * h**2).sum()
    unweighted = closed_form_alpha(root * residual, root * h)
    assert closed_form_alpha(residual, h, weights) == pytest.approx(unweighted, abs=1e-12 * scale)


@given(weighted_samples(), st.sampled_from([-565, -332, -1, 332, 565]))
def test_a_boosters_contribution_does_not_depend_on_its_scale(sample, exponent):
    """Scales from 1e-170 to 1e170; powers of two do not round. Catches h² under- or overflow."""
    residual, h, weights = sample
    scaled = -(2.0**exponent) * h
    contribution = closed_form_alpha(residual, scaled, weights) * scaled
    assert contribution.tolist() == (closed_form_alpha(residual, h, weights) * h).tolist()


@given(sizes(8).flatmap(vectors))
def test_a_zero_booster_gets_alpha_0(residual):
    assert closed_form_alpha(residual, np.zeros_like(residual)) == 0.0


def test_a_booster_that_is_0_wherever_it_counts_gets_alpha_0():
    assert closed_form_alpha(np.ones(2), np.array([0.0, 5.0]), np.array([1.0, 0.0])) == 0.0


@given(vectors(3), vectors(3))
def test_alpha_is_a_python_float_computed_in_double_precision(residual, h):
    residual, h = residual.astype(np.float32), h.astype(np.float32)
    alpha = closed_form_alpha(residual, h)
    assert type(alpha) is float
    assert alpha == closed_form_alpha(residual.astype(float), h.astype(float))


def test_mismatched_vectors_are_refused_and_not_broadcast():
    with pytest.raises(AssertionError, match="1"):
        closed_form_alpha(np.ones(3), np.ones((3, 1)))
    with pytest.raises(AssertionError, match="1"):
        closed_form_alpha(np.ones(3), np.ones(3), np.ones((3, 1)))


@st.composite
def ensembles(draw):
    """(ensemble, [(θ, α), …]) of up to four boosters."""
    net, rng = draw(nets()), draw(rngs())
    members = [(net.init(rng), float(rng.normal())) for _ in range(draw(st.integers(0, 4)))]
    ensemble = Ensemble(net)
    for theta, alpha in members:
        ensemble.add(theta, alpha)
    return ensemble, members


@given(ensembles(), rngs(), st.sampled_from([(), (1,), (5,), (2, 3)]))
def test_q_is_the_sum_of_its_boosters_for_one_state_or_many(both, rng, lead):
    (ensemble, members), net = both, both[0].net
    x, shape = rng.normal(size=(*lead, net.widths[0])), (*lead, net.widths[-1])
    expected, stages = np.zeros(shape), []
    for theta, alpha in members:
        h, _ = net.forward(theta, x.reshape(-1, net.widths[0]))
        expected = expected + alpha * h.reshape(shape)
        stages.append(expected)
    assert len(ensemble) == len(members)
    np.testing.assert_allclose(ensemble.q(x), expected, rtol=1e-4, atol=1e-5)
    assert ensemble.q(x).shape == shape and ensemble.q(x).dtype == np.float32
    stages = np.reshape(stages, (len(members), *shape))
    np.testing.assert_allclose(ensemble.staged_q(x), stages, rtol=1e-4, atol=1e-5)


@given(ensembles(), rngs())
def test_consecutive_stages_differ_by_one_term(both, rng):
    """The last stage is q, and each stage adds its booster's term."""
    ensemble, members = both
    assume(members)
    x = rng.normal(size=(3, ensemble.net.widths[0]))
    stages, terms = ensemble.staged_q(x), ensemble.terms(x)
    np.testing.assert_allclose(stages[-1], ensemble.q(x), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(np.diff(stages, axis=0, prepend=0), terms, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shape", [(2,), (5, 2), (4, 5, 2)], ids=str)
def test_the_empty_ensemble_is_the_zero_function(shape):
    ensemble, expected = Ensemble(MLP((2, 4, 3))), np.zeros((*shape[:-1], 3))
    assert ensemble.q(np.ones(shape)).tolist() == expected.tolist()
    assert ensemble.staged_q(np.ones(shape)).shape == (0, *expected.shape)


def test_a_frozen_booster_keeps_its_own_copy():
    """Catches a view of the θ that continues to learn."""
    net, x = MLP((2, 4, 3)), np.ones((5, 2))
    first, second = net.init(np.random.default_rng(0), 2)
    ensemble = Ensemble(net)
    ensemble.add(first, 0.5)
    before = ensemble.q(x).tobytes()
    first += 1
    assert ensemble.q(x).tobytes() == before
    ensemble.add(second, 2.0)
    second += 1
    assert ensemble.staged_q(x)[0].tobytes() == before
    assert ensemble.theta.shape == (2, net.size) and ensemble.alpha.tolist() == [0.5, 2.0]


def test_a_booster_with_nan_gets_alpha_nan():
    assert np.isnan(closed_form_alpha(np.ones(2), np.array([np.nan, 1.0])))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_alpha_too_large_for_a_float_becomes_the_largest_float(sign):
    """The parabola falls all the way to its minimum, so a shorter step still helps."""
    alpha = closed_form_alpha(np.ones(2), np.full(2, sign * 5e-324))
    assert alpha == sign * np.finfo(float).max


@pytest.mark.parametrize("alpha", [1e39, -1e39, np.inf, np.nan])
def test_an_alpha_that_float32_cannot_hold_is_refused(alpha):
    """In float32 it is infinite, but the cached predictions would use the number itself."""
    ensemble = Ensemble(MLP((2, 3)))
    with pytest.raises(FloatingPointError, match=re.escape(f"booster: {alpha}")):
        ensemble.add(ensemble.net.init(np.random.default_rng(0)), alpha)
    assert len(ensemble) == len(ensemble.theta) == 0


def test_without_data_closed_form_alpha_is_1():
    """Two drifts before the first step: no data decide α."""
    config = Config(env="cartpole", alpha="closed-form", hidden=(4,), capacity=10)
    agent = GBDQN(2, 3, config, np.random.default_rng(0))
    for _ in range(2):
        agent.on_drift("drift")
    assert agent.ensemble.alpha.tolist() == [1.0, 1.0]

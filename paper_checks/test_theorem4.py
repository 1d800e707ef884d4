"""Theorem 4 and what the paper says of drift: stability, adaptation, and the signal that a drift
gives.

Part 1 is an identity, true of every update and so no guarantee. Part 2 fails under either reading
of its hypothesis.
"""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ledger import claim, control, shows

from gbdqn_ref.boosting import Ensemble, closed_form_alpha
from gbdqn_ref.nn import MLP
from gbdqn_ref.tabular import MDP


def loops(rewards, gamma):
    """One state whose actions all stay in it, for these rewards."""
    return MDP(
        np.full((1, len(rewards), 1), F(1)), np.array([[F(reward) for reward in rewards]]), gamma
    )


def row(*values):
    return np.array([[F(value) for value in values]])


def identity(k):
    return np.array([[F(int(i == j)) for j in range(k)] for i in range(k)])


@claim(
    "T4-a",
    place="Theorem 4, part 1",
    says="a booster changes Q(s, a) by α |h(s, a)|, hence by at most α ‖h‖∞",
    verdict="holds if α ≥ 0, and with |α| always",
    uses="boosting.Ensemble",
)
@given(st.integers(0, 10**6), st.floats(-3, 3))
def test_a_booster_moves_q_by_alpha_h(seed, alpha):
    """Float32 sums cancel, so the tolerance is relative to Σ |α_j h_j|."""
    rng, net = np.random.default_rng(seed), MLP((2, 4, 3))
    ensemble, x = Ensemble(net), rng.normal(size=(5, 2)).astype(np.float32)
    ensemble.add(net.init(rng), 1.0)
    before = ensemble.q(x)
    ensemble.add(net.init(rng), alpha)
    terms = ensemble.terms(x)
    scale = np.abs(terms).sum(0).max()
    h = np.abs(net.forward(ensemble.theta[-1], x)[0])
    change = np.abs(ensemble.q(x) - before)
    np.testing.assert_allclose(change, abs(np.float32(alpha)) * h, atol=1e-6 * scale)
    assert change.max() <= abs(alpha) * h.max() + 1e-6 * scale
    shows(
        "|Q_m − Q_{m−1}| = |α| |h| on random ensembles; Eq. 8 can give α < 0, where the printed"
        " bound is negative"
    )


@control("T4-a")
def test_control_with_a_negative_alpha_the_printed_bound_is_negative():
    """r = (1, −3), h = (1, 1): Eq. 8 gives α = −1, and no change is at most −1."""
    alpha, h = closed_form_alpha(np.array([1.0, -3.0]), np.ones(2)), np.ones(2)
    assert alpha == -1
    assert not (np.abs(alpha * h) <= alpha * np.abs(h).max()).all()


@claim(
    "T4-b",
    place="Theorem 4, part 1",
    says=(
        "this bound is a stability that single networks do not have: updates stay bounded and local"
    ),
    verdict=(
        "fails: every update satisfies it with h = (Q' − Q)/α, and one residual can move Q anywhere"
        " else"
    ),
    uses="boosting.closed_form_alpha, tabular.MDP",
)
def test_a_residual_of_1_moves_an_unsampled_pair_by_1000():
    """φ = (1, 1000), one sample with residual 1: the exact fit is h = φ, and the pair never sampled
    moves by 1000.
    """
    phi, sampled = np.array([1.0, 1000.0]), np.array([0])
    residual = np.array([1.0])
    w = closed_form_alpha(residual, phi[sampled])
    change = w * phi
    assert change.tolist() == [1.0, 1000.0]
    shows(
        "φ = (1, 1000), sampled only at 0 with residual 1: Q moves by 1 there and by 1000 at the"
        " other pair"
    )


@control("T4-b")
@given(st.lists(st.floats(-9, 9), min_size=1, max_size=6), st.integers(0, 99))
def test_control_on_the_sample_it_is_bounded(residual, seed):
    """Negative control: on the sample itself ‖α h‖₂ ≤ ‖r‖₂, by Cauchy–Schwarz, so it is what is
    unseen that moves.
    """
    residual = np.array(residual)
    h = np.random.default_rng(seed).normal(size=len(residual))
    step = closed_form_alpha(residual, h) * h
    assert np.linalg.norm(step) <= np.linalg.norm(residual) * (1 + 1e-12)


def read_literally(boosts):
    """Reading A: each α is Theorem 1's on the sample D = {a₀}, h the exact fit in span{(1, 2)}, y
    the frozen target.
    """
    mdp, Q, values = loops((0, 0), F(9, 10)), row(1, 2), []  # Q*_old of r = (−0.8, 0.2)
    for _ in range(boosts):
        Q = Q + mdp.residual(Q)[0, 0] * row(1, 2)
        values.append(Q[0, 0])
    return Q, values


@claim(
    "T4-c",
    place="Theorem 4, part 2",
    says=(
        "after a drift, boosting whose residual falls at each step converges to the new Q* in L2 of"
        " the data"
    ),
    verdict=(
        "fails: if the frozen residual is meant it diverges, if the true one, it ends at a wrong Q"
    ),
    uses="tabular.MDP",
)
def test_adaptation_fails_under_either_reading():
    old = loops((F(-8, 10), F(2, 10)), F(9, 10))
    assert (old.residual(row(1, 2)) == 0).all()
    _, values = read_literally(4)
    assert values == [
        F(9, 5) ** k for k in (1, 2, 3, 4)
    ]  # 1.8, 3.24, 5.832, 10.4976 where Q*_new = 0

    old, new = loops((-9, 1), F(9, 10)), loops((0, 0), F(9, 10))
    Q = row(0, 10)
    assert (old.residual(Q) == 0).all()
    on_data = np.array([[F(1), F(0)]])  # only a₀ is in the data
    after = Q + on_data * new.residual(Q)
    assert [new.bellman_error(q, on_data) for q in (Q, after)] == [81, 0]
    assert after.tolist() == [
        [9, 10]
    ]  # and Q*_new = (0, 0): wrong by 9 on the data itself, where it was right
    shows(
        "frozen: 1.8, 3.24, 5.83, 10.5, … for Q* = 0; true: error 81 → 0 in one boost, at (9, 10)"
        " for (0, 0)"
    )


@claim(
    "T4-d",
    place="Theorem 4, part 2",
    says=(
        "what takes its place: with ‖h_m − g‖∞ ≤ ε, α ∈ (0, 1] and data on every pair, limsup ‖Q_m"
        " − Q*‖∞ ≤ ε/(1 − γ)"
    ),
    verdict="holds",
    uses="tabular.MDP",
)
@given(st.integers(0, 10**6), st.floats(0, 0.9), st.floats(0.05, 1), st.floats(0, 0.5))
def test_with_sup_norm_errors_and_full_support_it_adapts(seed, gamma, alpha, error):
    """e_m ≤ (1 − α(1 − γ)) e_{m−1} + α ε: Q_m − Q* = (1 − α)(Q − Q*) + α(𝒯Q − 𝒯Q*) + α(h − g), and
    𝒯 contracts.
    """
    rng = np.random.default_rng(seed)
    mdp = MDP(rng.dirichlet(np.ones(3), size=(3, 2)), rng.normal(size=(3, 2)), gamma)
    Q, q_star = rng.normal(size=(3, 2)), mdp.q_star()
    for _ in range(20):
        before = np.abs(Q - q_star).max()
        Q = Q + alpha * (mdp.residual(Q) + rng.uniform(-error, error, Q.shape))
        assert np.abs(Q - q_star).max() <= (1 - alpha * (1 - gamma)) * before + alpha * error + 1e-9
    shows("e_m ≤ (1 − α(1 − γ)) e_{m−1} + α ε at every step, on random MDPs")


@control("T4-c", "T4-d")
def test_control_with_every_pair_in_the_data_both_examples_adapt():
    """Negative control: fit all pairs, and the wrong answers above turn into the contraction."""
    mdp = loops((0, 0), F(9, 10))
    for Q in (row(1, 2), row(0, 10)):
        largest = abs(Q).max()
        for _ in range(5):
            Q = Q + mdp.residual(Q)
        assert abs(Q).max() <= F(9, 10) ** 5 * largest


@claim(
    "C1",
    place="section Conclusions",
    says="non-trivial drift always gives a positive TD error",
    verdict="fails: drift can leave δ at 0, make it negative, or lower it",
    uses="tabular.MDP",
)
def test_a_drift_can_be_silent():
    half = F(1, 2)
    old = loops((1,), half)
    q_old = row(2)
    assert (old.residual(q_old) == 0).all()
    stop = MDP(  # the new action pays 2 and ends the episode in a second state, worth 0
        np.array([[[F(0), F(1)]], [[F(0), F(1)]]]), np.array([[F(2)], [F(0)]]), half
    )
    assert (stop.residual(np.array([[F(2)], [F(0)]])) == 0).all()

    minus_one = -np.ones((2, 1))
    before = MDP(np.array([[[1.0, 0.0]], [[0.0, 1.0]]]), minus_one, 0.9)
    after = MDP(
        np.array([[[0.0, 1.0]], [[1.0, 0.0]]]), minus_one, 0.9
    )  # any other transitions will do
    assert np.abs(after.residual(before.q_star())).max() < 1e-9

    falls = loops((-1,), F(9, 10)).residual(row(0))
    assert falls.tolist() == [[-1]]
    assert [abs(loops((r,), F(9, 10)).residual(row(10))[0, 0]) for r in (0, 1)] == [
        1,
        0,
    ]  # Q = 10 was not right before
    shows(
        "(r = 1, loop) → (r = 2, end) at γ = ½ has Q* = 2 and δ = 0; r = −1 everywhere: any new"
        " transitions, δ = 0"
    )


@control("C1")
def test_control_a_change_of_reward_alone_is_seen():
    """Negative control: with transitions as they were and data on the pair, δ is exactly the change
    of the reward.
    """
    assert loops((2,), F(1, 2)).residual(row(2)).tolist() == [[1]]


@claim(
    "C2",
    place="section Conclusions",
    says="what takes its place: (1 − γ) ‖ΔQ*‖∞ ≤ ‖𝒯_new Q*_old − Q*_old‖∞ ≤ (1 + γ) ‖ΔQ*‖∞",
    verdict="holds",
    uses="tabular.MDP",
)
@given(st.integers(0, 10**6), st.floats(0, 0.95))
def test_the_largest_td_error_tells_how_far_q_star_has_moved(seed, gamma):
    """𝒯_new Q*_old − Q*_old = (𝒯_new Q*_old − 𝒯_new Q*_new) + (Q*_new − Q*_old), the first part at
    most γ ‖ΔQ*‖.
    """
    rng = np.random.default_rng(seed)
    old, new = (
        MDP(rng.dirichlet(np.ones(3), size=(3, 2)), rng.normal(size=(3, 2)), gamma)
        for _ in range(2)
    )
    signal = np.abs(new.residual(old.q_star())).max()
    moved = np.abs(new.q_star() - old.q_star()).max()
    assert (1 - gamma) * moved - 1e-9 <= signal <= (1 + gamma) * moved + 1e-9
    shows("on random pairs of MDPs; it takes Q = Q*_old and data on every pair")


@control("C2")
def test_control_a_pair_without_data_hides_the_drift():
    """Negative control: the reward of a₁ alone drifts; at a₀, all that is sampled, δ is 0 and Q*
    has moved by ½.
    """
    new, q_old = loops((1, F(1, 2)), F(0)), row(1, 0)
    assert new.residual(q_old)[0].tolist() == [0, F(1, 2)]


@claim(
    "C3",
    place="section Related Work",
    says="averaging an ensemble lowers the variance of Q",
    verdict=(
        "holds if errors are not all alike: σ²(ρ + (1 − ρ)/k), which leaves a common error; a sum"
        " raises it"
    ),
    uses="boosting.Ensemble",
)
def test_averaging_keeps_what_the_members_share():
    """k = 5 members with variance 2 and correlation 0.6: the mean has 1.36, the additive sum (α =
    1) has 34.
    """
    k, variance, correlation = 5, F(2), F(6, 10)
    covariance = variance * (correlation + (1 - correlation) * identity(k))
    weights = {name: np.full(k, weight) for name, weight in (("mean", F(1, k)), ("sum", F(1)))}
    assert {name: w @ covariance @ w for name, w in weights.items()} == {
        "mean": F(136, 100),
        "sum": F(34),
    }
    net = MLP((1, 1))
    ensemble = Ensemble(net)
    for _ in range(k):
        ensemble.add(net.init(np.random.default_rng(0)), 1.0)
    x = np.ones((1, 1), np.float32)
    np.testing.assert_allclose(
        ensemble.q(x), k * ensemble.terms(x)[0], rtol=1e-6
    )  # GB-DQN adds, it does not average
    shows("k = 5, σ² = 2, ρ = 0.6: the mean 1.36, the additive sum 34")


@control("C3")
def test_control_without_correlation_the_mean_has_a_kth_of_the_variance():
    """Negative control: take the common error away and nothing of the floor is left."""
    k, variance = 5, F(2)
    w = np.full(k, F(1, k))
    assert w @ (variance * identity(k)) @ w == variance / k


@pytest.mark.parametrize("boosts", [1, 10])
def test_control_the_literal_reading_needs_a_slope_above_1_over_gamma(boosts):
    """T4-c in general: with φ = (1, c) the error is multiplied by γc at each boost, so c < 1/γ
    would have converged.
    """
    _, values = read_literally(boosts)
    assert values[-1] == (F(9, 10) * 2) ** boosts

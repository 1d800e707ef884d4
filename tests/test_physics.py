"""A drifted environment equals a freshly built one with other constants."""

from fractions import Fraction
from itertools import product

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.classic_control import AcrobotEnv, CartPoleEnv, MountainCarEnv
from gymnasium.envs.classic_control.acrobot import wrap as stock_wrap
from gymnasium.error import ResetNeeded
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import cos, pi, sin

from gbdqn_ref import UsageError, drift, schedule
from gbdqn_ref.physics import Acrobot, set_acrobot, set_cartpole, wrap

LINKS = [f"LINK_{what}_{i}" for what in ("MASS", "LENGTH", "COM_POS") for i in (1, 2)]
DERIVED = ["total_mass", "polemass_length"]
CONSTANTS = {
    "cartpole": ["gravity", "masscart", "masspole", "length", "force_mag", *DERIVED],
    "mountaincar": ["gravity", "force"],
    "acrobot": ["gravity", "LINK_MOI", "AVAIL_TORQUE", *LINKS],
}
STATES = {  # (low, high): beyond the end of an episode, and for Acrobot up to full speed
    "cartpole": ([-3, -4, -0.4, -5], [3, 4, 0.4, 5]),
    "mountaincar": ([-1.2, -0.07], [0.6, 0.07]),
    "acrobot": ([-pi, -pi, -4 * pi, -9 * pi], [pi, pi, 4 * pi, 9 * pi]),
}
PARAMETERS = [(name, key) for name in CONSTANTS for key in schedule.stock(name)]
factor = st.floats(0.1, 10)


def factors_for(name):
    return st.dictionaries(st.sampled_from(sorted(schedule.stock(name))), factor)


class OracleAcrobot(AcrobotEnv):
    """Gymnasium's Acrobot, which uses Gymnasium's rk4, with `g` read from the instance."""

    gravity = 9.8

    def _dsdt(self, s_augmented):
        m1, m2, l1 = self.LINK_MASS_1, self.LINK_MASS_2, self.LINK_LENGTH_1
        lc1, lc2 = self.LINK_COM_POS_1, self.LINK_COM_POS_2
        I1, I2, g = self.LINK_MOI, self.LINK_MOI, self.gravity
        theta1, theta2, dtheta1, dtheta2, a = s_augmented
        d1 = m1 * lc1**2 + m2 * (l1**2 + lc2**2 + 2 * l1 * lc2 * cos(theta2)) + I1 + I2
        d2 = m2 * (lc2**2 + l1 * lc2 * cos(theta2)) + I2
        phi2 = m2 * lc2 * g * cos(theta1 + theta2 - pi / 2.0)
        phi1 = (
            -m2 * l1 * lc2 * dtheta2**2 * sin(theta2)
            - 2 * m2 * l1 * lc2 * dtheta2 * dtheta1 * sin(theta2)
            + (m1 * lc1 + m2 * l1) * g * cos(theta1 - pi / 2)
            + phi2
        )
        ddtheta2 = (a + d2 / d1 * phi1 - m2 * l1 * lc2 * dtheta1**2 * sin(theta2) - phi2) / (
            m2 * lc2**2 + I2 - d2**2 / d1
        )
        ddtheta1 = -(d2 * ddtheta2 + phi1) / d1
        return dtheta1, dtheta2, ddtheta1, ddtheta2, 0.0


def fresh_cartpole(gravity=1.0, cart_mass=1.0, pole_mass=1.0, length=1.0, force=1.0):
    env = CartPoleEnv()
    env.gravity, env.masscart, env.masspole = 9.8 * gravity, 1.0 * cart_mass, 0.1 * pole_mass
    env.length, env.force_mag = 0.5 * length, 10.0 * force
    env.total_mass = 0.1 * pole_mass + 1.0 * cart_mass
    env.polemass_length = 0.1 * pole_mass * (0.5 * length)
    return env


def fresh_mountaincar(gravity=1.0, force=1.0):
    env = MountainCarEnv()
    env.gravity, env.force = 0.0025 * gravity, 0.001 * force
    return env


def fresh_acrobot(gravity=1.0, mass=1.0, length=1.0, torque=1.0):
    env = OracleAcrobot()
    env.AVAIL_TORQUE = [-torque, 0.0, torque]
    env.gravity, env.LINK_MOI = 9.8 * gravity, 1.0 * mass * length**2
    env.LINK_MASS_1 = env.LINK_MASS_2 = 1.0 * mass
    env.LINK_LENGTH_1 = env.LINK_LENGTH_2 = 1.0 * length
    env.LINK_COM_POS_1 = env.LINK_COM_POS_2 = 0.5 * length
    return env


FRESH = {"cartpole": fresh_cartpole, "mountaincar": fresh_mountaincar, "acrobot": fresh_acrobot}


def drifted(name, **factors):
    """The environment as DriftWrapper makes it, unwrapped."""
    env = drift.make(name, [{"episode": 0, **factors}] if factors else [])
    env.reset(seed=0)
    return env.unwrapped


def after(env, state, action):
    """(next state, observation, reward, terminated) of one step from a given state."""
    env.state, env.steps_beyond_terminated = np.array(state), None
    observation, reward, terminated, *_ = env.step(action)
    return np.array(env.state, np.float64), observation, reward, terminated


def transitions(name, n=40, seed=0):
    """Every action in each of n random states."""
    low, high = STATES[name]
    for state in np.random.default_rng(seed).uniform(low, high, (n, len(low))):
        for action in range(2 if name == "cartpole" else 3):
            yield state, action


def apart(name, x, y):
    """The largest difference of two states; Acrobot's angles are compared modulo a turn."""
    gap = np.abs(x - y)
    if name == "acrobot":
        gap[:2] = np.minimum(gap[:2], 2 * pi - gap[:2])
    return gap.max()


def same_transitions(name, env, other):
    """Equal to the bit; Acrobot's Runge-Kutta steps round differently."""
    tolerance = 1e-12 if name == "acrobot" else 0
    for state, action in transitions(name):
        x, observation, *outcome = after(env, state, action)
        y, other_observation, *other_outcome = after(other, state, action)
        assert apart(name, x, y) <= tolerance, (state, action)
        assert observation.dtype == other_observation.dtype == np.float32
        np.testing.assert_allclose(observation, other_observation, rtol=0, atol=tolerance and 1e-5)
        assert outcome == other_outcome, (state, action)


def constants(name, env):
    return {key: getattr(env, key) for key in CONSTANTS[name]}


def test_every_environment_but_hopper_is_checked_here():
    assert [*CONSTANTS, "hopper"] == list(drift.ENVIRONMENTS)


@pytest.mark.parametrize("by", [0.5, 1.7])
@pytest.mark.parametrize(("name", "key"), PARAMETERS)
def test_a_drifted_environment_is_a_freshly_built_one(name, key, by):
    """Catches a derived constant that is not updated: polemass_length, LINK_COM_POS, LINK_MOI …"""
    same_transitions(name, drifted(name, **{key: by}), FRESH[name](**{key: by}))


@pytest.mark.parametrize("name", CONSTANTS)
def test_all_factors_together_are_a_freshly_built_environment(name):
    factors = {key: 0.6 + 0.3 * i for i, key in enumerate(schedule.stock(name))}
    same_transitions(name, drifted(name, **factors), FRESH[name](**factors))


@pytest.mark.parametrize(("name", "key"), PARAMETERS)
def test_each_factor_has_an_effect(name, key):
    stock, changed = drifted(name), drifted(name, **{key: 1.5})
    pairs = [(after(stock, *each)[0], after(changed, *each)[0]) for each in transitions(name, 10)]
    assert max(apart(name, x, y) for x, y in pairs) > 1e-5


@pytest.mark.parametrize("by", [-1.0, -0.5])
@pytest.mark.parametrize("name", ["cartpole", "mountaincar"])
def test_a_push_can_be_reversed(name, by):
    same_transitions(name, drifted(name, force=by), FRESH[name](force=by))


@pytest.mark.parametrize("name", CONSTANTS)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_without_factors_a_setter_restores_the_stock_constants(name, data):
    setter, env = drift.ENVIRONMENTS[name][1], drifted(name)
    for earlier in data.draw(st.lists(factors_for(name), max_size=4)):
        setter(env, **earlier)
    setter(env)
    assert constants(name, env) == constants(name, FRESH[name]())


@pytest.mark.parametrize("name", CONSTANTS)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_a_setter_call_ignores_earlier_ones(name, data):
    setter, used, unused = drift.ENVIRONMENTS[name][1], drifted(name), drifted(name)
    earlier, last = data.draw(factors_for(name)), data.draw(factors_for(name))
    setter(used, **earlier)  # catches *= in place of =
    setter(used, **last)
    setter(unused, **last)
    assert constants(name, used) == constants(name, unused) == constants(name, FRESH[name](**last))


@pytest.mark.parametrize("name", CONSTANTS)
def test_only_the_instance_drifts_not_the_class(name):
    env = drifted(name, **dict.fromkeys(schedule.stock(name), 3.0))
    later = drifted(name)
    assert constants(name, env) != constants(name, later) == constants(name, FRESH[name]())


@pytest.mark.parametrize("name", CONSTANTS)
def test_a_setter_changes_exactly_the_constants_compared_here(name):
    stock, env = drifted(name), drifted(name, **dict.fromkeys(schedule.stock(name), 3.0))
    numbers = {key for key in dir(stock) if isinstance(getattr(stock, key), (float, list))}
    changed = {key for key in numbers if getattr(stock, key) != getattr(env, key)}
    assert changed == set(CONSTANTS[name])


def test_acrobot_at_nominal_constants_is_the_stock_acrobot():
    ours, stock = Acrobot(), AcrobotEnv()
    rng = np.random.default_rng(0)
    for state in rng.uniform(*STATES["acrobot"], (4000, 4)):
        action = int(rng.integers(3))
        x, observation, *outcome = after(ours, state, action)
        y, stock_observation, *stock_outcome = after(stock, state, action)
        assert apart("acrobot", x, y) <= 1e-12
        np.testing.assert_allclose(observation, stock_observation, atol=1e-6)
        assert outcome == stock_outcome


@pytest.mark.parametrize("seed", range(4))
def test_acrobot_episodes_are_the_stock_episodes(seed):
    ours, stock = drift.make("acrobot"), gymnasium.make("Acrobot-v1")
    s, _ = ours.reset(seed=seed)
    assert np.array_equal(s, stock.reset(seed=seed)[0])
    rng, ends = np.random.default_rng(seed), False
    while not ends:  # at the stock registration's time limit of 500 steps
        action = int(rng.integers(3))
        s, *outcome, _ = ours.step(action)
        stock_s, *stock_outcome, _ = stock.step(action)
        np.testing.assert_allclose(s, stock_s, atol=1e-4)
        assert outcome == stock_outcome
        ends = outcome[1] or outcome[2]


def test_acrobot_is_registered_like_the_stock_one():
    ours, stock = gymnasium.spec("gbdqn_ref/Acrobot-v1"), gymnasium.spec("Acrobot-v1")
    assert ours.max_episode_steps == stock.max_episode_steps
    assert ours.reward_threshold == stock.reward_threshold
    assert drift.make("acrobot").observation_space == gymnasium.make("Acrobot-v1").observation_space


@pytest.mark.parametrize(("option", "value"), [("torque_noise_max", 0.5), ("book_or_nips", "nips")])
def test_acrobot_has_the_options_of_the_stock_acrobot(option, value):
    ours, stock, plain = Acrobot(), AcrobotEnv(), Acrobot()
    for env in (ours, stock):
        env.reset(seed=0)  # the noise is drawn from the environment's own generator
        setattr(env, option, value)
    gaps = []
    for state, action in transitions("acrobot"):
        x, y = after(ours, state, action)[0], after(stock, state, action)[0]
        assert apart("acrobot", x, y) <= 1e-12
        gaps.append(apart("acrobot", x, after(plain, state, action)[0]))
    assert max(gaps) > 1e-3, "the option has an effect"


def test_acrobot_asks_to_be_reset_first():
    with pytest.raises(ResetNeeded, match="reset"):
        Acrobot().step(0)


@pytest.mark.parametrize("name", drift.ENVIRONMENTS)
def test_a_step_before_the_first_reset_is_refused(name):
    with pytest.raises(ResetNeeded, match=r"before calling env.reset\(\)"):
        drift.make(name).step(0)


@pytest.mark.parametrize("name", drift.ENVIRONMENTS)
def test_actions_out_of_range_are_refused(name):
    """Catches −1 as the index of the last action."""
    env = drift.make(name)
    env.reset(seed=0)
    for action in (-1, int(env.action_space.n), "left", None):
        with pytest.raises((UsageError, AssertionError), match=f"{action!r}"):
            env.step(action)
    for action in (np.int64(1), np.array(1), 1):
        env.step(action)


def test_acrobot_names_the_valid_actions_when_it_refuses_one():
    env = Acrobot()
    env.reset(seed=0)
    with pytest.raises(UsageError, match=r"^action must be a whole number from 0 to 2, not -1$"):
        env.step(-1)


@given(st.floats(-60, 60) | st.integers(-19, 19).map(lambda k: k * pi) | st.just(-0.0))
@settings(max_examples=2000)
def test_an_angle_is_wrapped_as_gymnasium_does_to_the_bit(angle):
    for near in (angle, np.nextafter(angle, -np.inf).item(), np.nextafter(angle, np.inf).item()):
        assert wrap(near).hex() == stock_wrap(near, -pi, pi).hex()


@pytest.mark.parametrize("angle", [1e5, 1e17, 1e300, -1e300])
def test_no_angle_is_too_large_to_be_wrapped(angle):
    """Catches subtracting turns one by one, which does not change 1e17."""
    turns = (Fraction(angle) - Fraction(wrap(angle))) / Fraction(2 * pi)
    assert abs(wrap(angle)) <= pi and turns.denominator == 1


@pytest.mark.parametrize("name", CONSTANTS)
def test_every_corner_of_the_factors_can_be_stepped(name):
    """At 0.01 and 100 times each constant nothing overflows, divides by 0 or hangs."""
    names, rng = list(schedule.stock(name)), np.random.default_rng(0)
    for corner in product((0.01, 100.0), repeat=len(names)):
        env = drifted(name, **dict(zip(names, corner, strict=True)))
        for state, action in transitions(name, 10, seed=int(rng.integers(99))):
            assert np.isfinite(after(env, state, action)[0]).all()


def alike(env, other):
    for each in transitions("acrobot"):
        assert apart("acrobot", after(env, *each)[0], after(other, *each)[0]) < 1e-9


@pytest.mark.parametrize("k", [0.5, 1.5, 4.0])
def test_heavier_links_act_like_weaker_motors(k):
    heavy, weak = Acrobot(), Acrobot()
    set_acrobot(heavy, mass=k)  # catches a moment of inertia that ignores the mass
    weak.AVAIL_TORQUE = [torque / k for torque in Acrobot.AVAIL_TORQUE]
    alike(heavy, weak)


@pytest.mark.parametrize("k", [0.5, 1.5, 4.0])
def test_longer_links_act_like_weaker_gravity_and_even_weaker_motors(k):
    long, weak = Acrobot(), Acrobot()
    set_acrobot(long, length=k)  # catches a moment of inertia that scales with k instead of k²
    set_acrobot(weak, gravity=1 / k)
    weak.AVAIL_TORQUE = [torque / k**2 for torque in Acrobot.AVAIL_TORQUE]
    alike(long, weak)


def lagrangian_acceleration(state, push, g, cart, pole, half_length):
    """d²θ/dt² from the equations of motion of cart and pole, a linear system."""
    _, _, theta, speed = state
    lever = pole * half_length
    masses = [[cart + pole, lever * cos(theta)], [lever * cos(theta), 4 / 3 * lever * half_length]]
    forces = [push + lever * speed**2 * sin(theta), lever * g * sin(theta)]
    return np.linalg.solve(masses, forces)[1]


CARTPOLE = sorted(schedule.stock("cartpole"))


@given(st.sampled_from(CARTPOLE), factor, st.integers(0, 1), st.integers(0, 99))
@settings(max_examples=60, deadline=None)
def test_cartpole_accelerates_as_its_equations_of_motion_say(key, by, action, seed):
    env = CartPoleEnv()
    set_cartpole(env, **{key: by})
    state = np.random.default_rng(seed).uniform(*STATES["cartpole"])
    f = dict.fromkeys(CARTPOLE, 1.0) | {key: by}
    push, g = (20 * action - 10) * f["force"], 9.8 * f["gravity"]
    bodies = f["cart_mass"], 0.1 * f["pole_mass"], 0.5 * f["length"]
    expected = lagrangian_acceleration(state, push, g, *bodies)
    observed = (after(env, state, action)[0][3] - state[3]) / env.tau
    assert observed == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_pole_ten_times_as_heavy_accelerates_correctly():
    env, state = CartPoleEnv(), (0.0, 0.0, 0.0, 0.0)
    set_cartpole(env, pole_mass=10.0)
    # Upright and at rest: −F / ((M + m) l (4/3 − m/(M + m))) = −10 / (2 · ½ · 5/6) = −12.
    # With a stale total_mass it is −42.9.
    assert after(env, state, 1)[0][3] / env.tau == pytest.approx(-12.0)

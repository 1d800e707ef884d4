"""A drifted Hopper equals one compiled with other constants; a reset restores everything."""

import copy
import subprocess
import sys
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.mujoco.hopper_v5 import HopperEnv
from hypothesis import given, settings
from hypothesis import strategies as st

from gbdqn_ref import drift
from gbdqn_ref.config import Config
from gbdqn_ref.physics import SevenActions, set_hopper
from gbdqn_ref.train import run

FACTORS = ("gravity", "mass", "friction")
ALL = {"gravity": 1.3, "mass": 1.7, "friction": 0.6}
factors = st.dictionaries(st.sampled_from(FACTORS), st.floats(0.1, 10))


def numbers(env):
    """Every number of the compiled model, options included, as {name: array}."""
    model = env.unwrapped.model
    found = {}
    for at, part in {"": model, "opt.": model.opt, "stat.": model.stat}.items():
        values = {key: getattr(part, key) for key in dir(part) if key[0] != "_"}
        for key, value in values.items():
            if isinstance(value, (int, float, np.ndarray)):
                found[at + key] = np.array(value)
    return found


def differing(env, other):
    """The names of the numbers that differ by a bit or more."""
    mine, others = numbers(env), numbers(other)
    return {key for key in mine if not np.array_equal(mine[key], others[key])}


def recompiled(folder, gravity=1.0, mass=1.0, friction=1.0):
    """Gymnasium's Hopper-v5 from an XML with other constants; density scales the mass.

    The XML leaves MuJoCo's defaults out: density 1000 and friction 1.
    """
    tree = ElementTree.parse(HopperEnv().fullpath)
    tree.find("option").set("gravity", f"0 0 {-9.81 * gravity!r}")
    tree.find("default/geom").set("density", repr(1000 * mass))
    for geom in tree.iter("geom"):
        if geom.get("name"):
            geom.set("friction", repr(float(geom.get("friction", "1")) * friction))
    tree.write(folder / "hopper.xml")
    return HopperEnv(xml_file=str(folder / "hopper.xml"))


def drifted(**by):
    """Gymnasium's Hopper-v5 after set_hopper."""
    env = HopperEnv()
    set_hopper(env, **by)
    return env


def trajectory(env, n=1000, seed=0):
    """Positions and velocities (n, 12) under random actions, even after a fall."""
    env.reset(seed=seed)
    states = np.empty((n, 12))
    for state, action in zip(states, np.random.default_rng(seed).integers(7, size=n), strict=True):
        env.step(SevenActions.TORQUES[action])
        state[:] = *env.data.qpos, *env.data.qvel
    return states


@pytest.fixture(scope="module")
def stock_trajectory():
    return trajectory(HopperEnv())


@pytest.mark.parametrize(
    "by", [{"gravity": 1.3}, {"mass": 2.0}, {"friction": 0.7}, ALL | {"mass": 0.5}], ids=str
)
def test_a_drifted_hopper_moves_like_one_compiled_with_its_constants(
    tmp_path, by, stock_trajectory
):
    """For 1,000 steps to the bit; masses scale by powers of two, which do not round."""
    states = trajectory(drifted(**by))
    assert np.array_equal(states, trajectory(recompiled(tmp_path, **by)))
    assert not np.array_equal(states, stock_trajectory)


def test_every_number_of_a_drifted_model_equals_a_compiled_ones(tmp_path):
    """Catches masses without their inertias, subtree masses, inverse weights or M0."""
    mine, others = numbers(drifted(**ALL)), numbers(recompiled(tmp_path, **ALL))
    assert mine.keys() == others.keys()
    for key in mine:
        np.testing.assert_allclose(mine[key], others[key], rtol=1e-12, atol=1e-15, err_msg=key)


@pytest.mark.parametrize("key", FACTORS)
@pytest.mark.parametrize("by", [0.7, 1.3])
def test_each_factor_has_an_effect(key, by, stock_trajectory):
    """Floor friction alone would have none: it is below the foot's."""
    assert np.abs(trajectory(drifted(**{key: by}), 200) - stock_trajectory[:200]).max() > 1e-3


def test_gravity_stays_vertical():
    assert drifted(gravity=2.0).model.opt.gravity.tolist() == [0, 0, 2 * -9.81]


def test_sliding_friction_alone_drifts_on_every_surface():
    stock, model = HopperEnv().model, drifted(friction=0.5).model
    assert model.geom_friction[:, 0].tolist() == (0.5 * stock.geom_friction[:, 0]).tolist()
    assert model.geom_friction[:, 1:].tolist() == stock.geom_friction[:, 1:].tolist()


@settings(max_examples=25, deadline=None)
@given(st.lists(factors, max_size=3), factors)
def test_a_setter_call_ignores_earlier_ones(earlier, last):
    env = HopperEnv()
    for by in [*earlier, last]:
        set_hopper(env, **by)
    assert not differing(env, drifted(**last))
    set_hopper(env)
    assert not differing(env, HopperEnv()), "without factors it is the stock hopper to the bit"


def test_setting_factors_in_mid_episode_does_not_move_the_hopper():
    env = HopperEnv()
    env.reset(seed=0)
    state = [*env.data.qpos, *env.data.qvel]
    set_hopper(env, **ALL)  # catches mj_setConst on env.data
    assert [*env.data.qpos, *env.data.qvel] == state


def test_only_the_instance_drifts():
    drifted(**ALL)
    assert not differing(HopperEnv(), gymnasium.make("Hopper-v5"))


def test_after_a_reset_of_the_physics_episodes_equal_a_new_environments():
    """Anything left from an earlier episode would change a resumed run."""
    env = drift.make("hopper", [{"episode": 1, **ALL}, {"episode": 2, "reset": True}])
    for _ in range(2):
        env.reset(seed=5)
        for action in (1, 5, 2, 0, 3):
            env.step(action)
    env.reset(seed=5)
    assert np.array_equal(trajectory(env.unwrapped, 100), trajectory(HopperEnv(), 100))


def test_a_copy_of_a_drifted_hopper_has_the_same_drift():
    env = drift.make("hopper", [{"episode": 0, **ALL}])
    env.reset(seed=0)
    copied = copy.deepcopy(env)  # Gymnasium rebuilds it from its arguments: the stock one
    assert not differing(copied, drifted(**ALL))
    (s, info), (copied_s, copied_info) = env.reset(seed=1), copied.reset(seed=1)
    assert info == copied_info and s.tolist() == copied_s.tolist()
    assert env.step(1)[0].tolist() == copied.step(1)[0].tolist()


def test_every_corner_of_the_factors_can_be_stepped():
    """At 0.01 and 100 times each constant every state stays finite."""
    for corner in product((0.01, 100.0), repeat=len(FACTORS)):
        states = trajectory(drifted(**dict(zip(FACTORS, corner, strict=True))), 50)
        assert np.isfinite(states).all(), corner


def test_the_seven_actions_are_no_torque_or_full_torque_on_one_motor():
    env = drift.make("hopper")
    assert env.action_space == gymnasium.spaces.Discrete(7)
    one = np.eye(3).tolist()
    for action, torques in enumerate([[0, 0, 0], *one, *(-np.eye(3)).tolist()]):
        env.reset(seed=0)
        env.step(action)
        assert env.unwrapped.data.ctrl.tolist() == torques
        assert env.unwrapped.action_space.contains(env.env.action(action))


def test_the_motors_are_thigh_leg_and_foot():
    model = HopperEnv().model
    names = [model.joint(joint).name for joint, _ in model.actuator_trnid]
    assert names == ["thigh_joint", "leg_joint", "foot_joint"]


def test_the_hopper_is_registered_like_the_stock_one():
    ours, stock = gymnasium.spec("gbdqn_ref/Hopper-v5"), gymnasium.spec("Hopper-v5")
    envs = [gymnasium.make(spec).unwrapped for spec in (ours, stock)]
    assert type(envs[0]) is type(envs[1]) and ours.kwargs == stock.kwargs
    assert ours.max_episode_steps == stock.max_episode_steps == 1000
    assert ours.reward_threshold == stock.reward_threshold


def test_mujoco_is_not_imported_before_it_is_needed():
    code = "import gbdqn_ref.__main__, sys; sys.exit('mujoco' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parent.parent)


@pytest.mark.parametrize("agent", ["dqn", "gbdqn"])
def test_training_crosses_a_drift(agent):
    settings = dict(episodes=2, learning_starts=8, hidden=(8,), capacity=500, seed=1)
    config = Config.preset("hopper", agent=agent, schedule=[{"episode": 1, **ALL}], **settings)
    records = list(run(config))
    assert [record["event"] for record in records] == ["", "drift"]
    assert all(np.isfinite(record["td_error"]) and record["length"] > 5 for record in records)
    assert records == list(run(config))

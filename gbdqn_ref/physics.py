"""What drifts: one setter per environment for its constants and all that depends on them.

Every argument of a setter is a factor on the stock constant. 1 is the stock value, so a setter
without arguments restores the stock environment. A setter writes every constant it governs, always
from the stock value, so no call builds on an earlier one. It takes the unwrapped environment (an
attribute set on a wrapper has no effect) and writes to the instance, never to the class.
"""

import os
from functools import cache
from math import copysign, cos, fmod, pi, sin

import gymnasium
import numpy as np
from gymnasium.envs.classic_control import AcrobotEnv, CartPoleEnv, MountainCarEnv
from gymnasium.error import ResetNeeded
from gymnasium.utils import RecordConstructorArgs

from . import UsageError

CARTPOLE, MOUNTAINCAR = CartPoleEnv(), MountainCarEnv()  # the stock constants, read only


class Acrobot(AcrobotEnv):
    """Acrobot-v1 with a gravity that can change; the stock class hard-codes 9.8 in a function.

    The equations of motion and the fourth-order Runge-Kutta step are the stock ones. Plain floats
    take a fraction of the time. A step equals the stock step to 1e-12, and bit for bit where
    numpy.cos is the C library's cosine, as in common builds.
    """

    gravity = 9.8  # m/s²

    def step(self, a):
        if self.state is None:
            raise ResetNeeded("call reset() before step()")
        torque, dt = _chosen(self.AVAIL_TORQUE, a), self.dt
        if self.torque_noise_max > 0:
            torque += self.np_random.uniform(-self.torque_noise_max, self.torque_noise_max)
        y = tuple(map(float, self.state))
        k1 = self._derivative(*y, torque)
        k2 = self._derivative(*(yi + dt / 2 * ki for yi, ki in zip(y, k1, strict=True)), torque)
        k3 = self._derivative(*(yi + dt / 2 * ki for yi, ki in zip(y, k2, strict=True)), torque)
        k4 = self._derivative(*(yi + dt * ki for yi, ki in zip(y, k3, strict=True)), torque)
        theta1, theta2, speed1, speed2 = (
            yi + dt / 6 * (a + 2 * b + 2 * c + d)
            for yi, a, b, c, d in zip(y, k1, k2, k3, k4, strict=True)
        )
        speed1 = min(max(speed1, -self.MAX_VEL_1), self.MAX_VEL_1)
        speed2 = min(max(speed2, -self.MAX_VEL_2), self.MAX_VEL_2)
        self.state = wrap(theta1), wrap(theta2), speed1, speed2
        terminated = self._terminal()
        if self.render_mode == "human":
            self.render()
        return self._get_ob(), 0.0 if terminated else -1.0, terminated, False, {}

    def _derivative(self, theta1, theta2, speed1, speed2, torque):
        """(dθ₁/dt, dθ₂/dt, d²θ₁/dt², d²θ₂/dt²); angles in rad, torque on joint 2 in N m."""
        m1, m2, l1 = self.LINK_MASS_1, self.LINK_MASS_2, self.LINK_LENGTH_1
        lc1, lc2 = self.LINK_COM_POS_1, self.LINK_COM_POS_2
        g, moi, cos2, sin2 = self.gravity, self.LINK_MOI, cos(theta2), sin(theta2)
        d1 = m1 * lc1**2 + m2 * (l1**2 + lc2**2 + 2 * l1 * lc2 * cos2) + moi + moi
        d2 = m2 * (lc2**2 + l1 * lc2 * cos2) + moi
        phi2 = m2 * lc2 * g * cos(theta1 + theta2 - pi / 2)
        phi1 = (
            -m2 * l1 * lc2 * speed2**2 * sin2
            - 2 * m2 * l1 * lc2 * speed2 * speed1 * sin2
            + (m1 * lc1 + m2 * l1) * g * cos(theta1 - pi / 2)
            + phi2
        )
        swing = 0.0 if self.book_or_nips == "nips" else m2 * l1 * lc2 * speed1**2 * sin2
        acceleration2 = (torque + d2 / d1 * phi1 - swing - phi2) / (m2 * lc2**2 + moi - d2**2 / d1)
        return speed1, speed2, -(d2 * acceleration2 + phi1) / d1, acceleration2

    def _get_ob(self):
        theta1, theta2, speed1, speed2 = self.state
        return np.array(
            [cos(theta1), sin(theta1), cos(theta2), sin(theta2), speed1, speed2], np.float32
        )

    def _terminal(self):
        return -cos(self.state[0]) - cos(self.state[1] + self.state[0]) > 1


def wrap(angle):
    """The same angle in [−π, π], in one step for any number of turns."""
    if -pi <= angle <= pi:
        return angle
    # fmod is exact; subtracting turns one by one gives the same bits, but 1e17 − 2π is 1e17
    rest = fmod(angle, 2 * pi)
    return rest - copysign(2 * pi, rest) if abs(rest) > pi else rest + 0.0  # −2π goes to 0, not −0


def _chosen(options, action):
    """The option with the number of the action; UsageError if there is none."""
    if action not in range(len(options)):  # options[−1] would be the last one
        raise UsageError(
            f"action must be a whole number from 0 to {len(options) - 1}, not {action!r}"
        )
    return options[int(action)]


gymnasium.register(
    "gbdqn_ref/Acrobot-v1", f"{__name__}:Acrobot", max_episode_steps=500, reward_threshold=-100.0
)


class SevenActions(gymnasium.ActionWrapper, RecordConstructorArgs):
    """Seven actions for Hopper's three motors; the paper does not say which seven (D16).

    0: no torque. 1, 2, 3: full positive torque on the thigh, leg or foot alone. 4, 5, 6: full
    negative torque on one of them.

    >>> env = gymnasium.make("gbdqn_ref/Hopper-v5")
    >>> [env.action(a).tolist() for a in (0, 3, 4)]
    [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]
    """

    TORQUES = np.array(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], np.float32
    )

    def __init__(self, env):
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self.action_space = gymnasium.spaces.Discrete(7)

    def action(self, action):
        """The torques (3,) of an action."""
        return _chosen(self.TORQUES, action).copy()


gymnasium.register(
    "gbdqn_ref/Hopper-v5",
    "gbdqn_ref.physics:hopper",
    max_episode_steps=1000,
    reward_threshold=3800.0,
    additional_wrappers=(SevenActions.wrapper_spec(),),
)


def set_cartpole(env, gravity=1.0, cart_mass=1.0, pole_mass=1.0, length=1.0, force=1.0):
    """Gravity, masses of cart and pole, length of the pole, force of a push.

    total_mass and polemass_length follow from them.
    """
    env.gravity = CARTPOLE.gravity * gravity
    env.masscart = CARTPOLE.masscart * cart_mass
    env.masspole = CARTPOLE.masspole * pole_mass
    env.length = CARTPOLE.length * length  # half the pole's length, in m
    env.force_mag = CARTPOLE.force_mag * force
    env.total_mass = env.masscart + env.masspole
    env.polemass_length = env.masspole * env.length


def set_mountaincar(env, gravity=1.0, force=1.0):
    """Gravity and engine force, both in position units per step²."""
    env.gravity = MOUNTAINCAR.gravity * gravity
    env.force = MOUNTAINCAR.force * force


def set_acrobot(env, gravity=1.0, mass=1.0, length=1.0, torque=1.0):
    """Gravity, mass of both links, length of both links, torque of the motor.

    A moment of inertia is a mass times a squared length, so it scales with mass · length². The
    centre of mass stays at the same fraction of a link. The goal lies one link length above the
    pivot. It is stated in angles, so it scales with the links.
    """
    env.gravity = Acrobot.gravity * gravity
    env.LINK_MASS_1 = Acrobot.LINK_MASS_1 * mass
    env.LINK_MASS_2 = Acrobot.LINK_MASS_2 * mass
    env.LINK_LENGTH_1 = Acrobot.LINK_LENGTH_1 * length
    env.LINK_LENGTH_2 = Acrobot.LINK_LENGTH_2 * length
    env.LINK_COM_POS_1 = Acrobot.LINK_COM_POS_1 * length
    env.LINK_COM_POS_2 = Acrobot.LINK_COM_POS_2 * length
    env.LINK_MOI = Acrobot.LINK_MOI * mass * length**2
    env.AVAIL_TORQUE = [stock * torque for stock in Acrobot.AVAIL_TORQUE]


def set_hopper(env, gravity=1.0, mass=1.0, friction=1.0):
    """Gravity, mass of every body, sliding friction of every surface.

    Inertia scales with mass, as it would with density. What MuJoCo derives from them is updated.
    A contact uses the larger friction of its two surfaces. The foot has twice the floor's, so a
    change of the floor's alone would have no effect.
    """
    import mujoco

    model, stock = env.model, _stock_hopper(env.fullpath)
    model.opt.gravity[2] = stock.opt.gravity[2] * gravity  # gravity[:] would set all three axes
    model.body_mass[:] = stock.body_mass * mass
    model.body_inertia[:] = stock.body_inertia * mass
    model.geom_friction[:, 0] = stock.geom_friction[:, 0] * friction
    # on scratch data: with env.data it would move the hopper
    mujoco.mj_setConst(model, mujoco.MjData(model))
    # MuJoCo computes these two only when it compiles; the solver's tolerance scales with the last
    model.stat.meanmass = stock.stat.meanmass * mass
    model.stat.meaninertia = model.dof_M0.mean()


def hopper(**options):
    """Gymnasium's Hopper; unless it is rendered, MUJOCO_GL may name a missing renderer.

    MuJoCo is imported here: only Hopper needs it, and it takes as long as all other imports.
    """
    renderer = os.environ.get("MUJOCO_GL", "")
    try:
        import mujoco
    except Exception:  # its type depends on the renderer
        if options.get("render_mode"):
            raise
        os.environ["MUJOCO_GL"] = "off"
        import mujoco  # noqa: F401

        os.environ["MUJOCO_GL"] = renderer
    from gymnasium.envs.mujoco.hopper_v5 import HopperEnv

    return HopperEnv(**options)


@cache
def _stock_hopper(path):
    """The stock model of an XML file, compiled when first needed and never changed."""
    import mujoco

    return mujoco.MjModel.from_xml_path(path)

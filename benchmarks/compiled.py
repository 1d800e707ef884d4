"""DQN compiled by JAX: its update, and the whole of its training on CartPole, physics included."""

from math import pi
from typing import NamedTuple

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_cpu_enable_async_dispatch", False)  # faster, where each call is waited for


class Learner(NamedTuple):
    """What an update changes: θ, θ̄ and Adam's moments, each (P,), and Adam's count."""

    theta: jax.Array
    target: jax.Array
    m: jax.Array
    v: jax.Array
    t: jax.Array


def learner(agent):
    """The Learner of a DQN that has not learnt yet."""
    theta, target, m, v = map(
        jnp.array, (agent.theta, agent.theta_target, agent.adam.m, agent.adam.v)
    )
    return Learner(theta, target, m, v, jnp.zeros((), jnp.int32))


def forward(net, theta, x):
    """q (…, A) of an nn.MLP with flat θ (P,), as nn has it, for x (…, d)."""
    *hidden, last = net.layers(theta)
    for V in hidden:
        x = jax.nn.relu(x @ V[:-1] + V[-1])
    return x @ last[:-1] + last[-1]


def update(agent, old, s, a, r, s2, terminated, weight):
    """A DQN's learn() without its sampling: (Learner, δ (B,))."""
    c, net = agent.config, agent.net
    y = r + c.gamma * ~terminated * forward(net, old.target, s2).max(-1)

    def loss(theta):
        delta = y - jnp.take_along_axis(forward(net, theta, s), a[:, None], 1)[:, 0]
        return 0.5 * (weight * delta**2).mean(), delta

    grad, delta = jax.grad(loss, has_aux=True)(old.theta)
    grad *= c.max_grad_norm / jnp.maximum(jnp.sqrt(grad @ grad), c.max_grad_norm)
    t, m, v = old.t + 1, 0.9 * old.m + 0.1 * grad, 0.999 * old.v + 0.001 * grad**2
    step = c.lr / (1 - 0.9**t) * m / (jnp.sqrt(v / (1 - 0.999**t)) + 1e-8)
    theta = old.theta - step
    return Learner(theta, (1 - c.tau) * old.target + c.tau * theta, m, v, t), delta


def jax_update(agent, batch):
    """As peers.torch_update: the compiled update, NumPy in and out, and what reads its θ."""
    state = learner(agent)
    compiled = jax.jit(lambda *given: update(agent, *given), donate_argnums=0)

    def learn():
        nonlocal state
        state, delta = compiled(state, *batch[1:])
        return np.asarray(delta)

    return learn, lambda: np.asarray(state.theta)


def cartpole(s, a):
    """Gymnasium's CartPole, one Euler step of s (4,) under the action a: (s', terminated)."""
    _, x_dot, angle, angle_dot = s
    force, sin, cos = jnp.where(a == 1, 10.0, -10.0), jnp.sin(angle), jnp.cos(angle)
    push = (force + 0.05 * angle_dot**2 * sin) / 1.1
    angle_acc = (9.8 * sin - cos * push) / (0.5 * (4 / 3 - 0.1 * cos**2 / 1.1))
    x_acc = push - 0.05 * angle_acc * cos / 1.1
    s2 = s + 0.02 * jnp.stack([x_dot, x_acc, angle_dot, angle_acc])
    return s2, (jnp.abs(s2[0]) > 2.4) | (jnp.abs(s2[2]) > 12 * 2 * pi / 360)


def check_cartpole():
    """AssertionError unless a step of cartpole() is Gymnasium's, also where an episode ends."""
    env, rng = gymnasium.make("CartPole-v1").unwrapped, np.random.default_rng(0)
    env.reset()
    for s in rng.uniform(-1, 1, (100, 4)) * (2.5, 3, 0.25, 3):
        for a in (0, 1):
            env.state, env.steps_beyond_terminated = tuple(s), None
            expected, _, expected_end, _, _ = env.step(a)
            s2, terminated = cartpole(jnp.array(s), a)
            np.testing.assert_allclose(s2, expected, rtol=1e-4, atol=1e-5)
            assert bool(terminated) == expected_end


class World(NamedTuple):
    """Everything that training goes on with."""

    learner: Learner
    ring: tuple  # the last transitions: s, a, r, s', terminated
    added: jax.Array  # how many there have been
    s: jax.Array
    length: jax.Array  # steps in this episode
    episodes: jax.Array  # how many have ended
    key: jax.Array


def begin(agent):
    """A World before its first step, at CartPole's middle."""
    n = agent.config.capacity
    s, a, r = jnp.zeros((n, 4)), jnp.zeros(n, jnp.int32), jnp.ones(n)
    ring = s, a, r, s.copy(), jnp.zeros(n, bool)
    added, length, episodes = (jnp.zeros((), jnp.int32) for _ in range(3))
    key = jax.random.key(0, impl="rbg")
    return World(learner(agent), ring, added, jnp.zeros(4), length, episodes, key)


def step(agent, world, draw):
    """Act, step, store, and begin anew where the episode ends; draw (6,) is uniform in [0, 1)."""
    c = agent.config
    best = forward(agent.net, world.learner.theta, world.s).argmax()
    a = jnp.where(draw[0] < c.epsilon_end, draw[1] >= 0.5, best).astype(jnp.int32)
    s2, terminated = cartpole(world.s, a)
    slot = world.added % c.capacity
    ring = tuple(
        old.at[slot].set(new)
        for old, new in zip(world.ring, (world.s, a, 1.0, s2, terminated), strict=True)
    )
    ends = terminated | (world.length + 1 == 500)
    s = jnp.where(ends, 0.1 * draw[2:] - 0.05, s2)
    length, episodes = jnp.where(ends, 0, world.length + 1), world.episodes + ends
    added = world.added + 1
    return world._replace(ring=ring, added=added, s=s, length=length, episodes=episodes)


def round_of_training(agent, world):
    """As many steps as lie between two updates, and an update from a uniform replay."""
    c = agent.config
    key, acting, sampling = jax.random.split(world.key, 3)
    for draw in jax.random.uniform(acting, (c.update_every, 6)):
        world = step(agent, world, draw)
    stored = jnp.minimum(world.added, c.capacity)
    index = jax.random.randint(sampling, (c.batch_size,), 0, stored)
    batch = [x[index] for x in world.ring]
    new, _ = update(agent, world.learner, *batch, jnp.ones(c.batch_size))
    return world._replace(learner=new, key=key)


def training(agent, steps):
    """Train as many steps at a time as one compiled call; records like train.run()'s."""

    def train(world):
        rounds = steps // agent.config.update_every
        return jax.lax.fori_loop(0, rounds, lambda _, w: round_of_training(agent, w), world)

    compiled, world = jax.jit(train, donate_argnums=0), begin(agent)
    while True:
        world = jax.block_until_ready(compiled(world))
        yield {
            "length": steps,
            "episodes": int(world.episodes),
            "updates": int(world.learner.t),
            "parameters": world.learner.theta.size,
        }

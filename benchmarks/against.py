"""Our update and our whole training against the same work elsewhere."""

from functools import partial
from itertools import islice
from time import process_time
from types import SimpleNamespace

import gymnasium
import numpy as np
import peers
from measure import REPLAYS, STOCK, Section, compare, measure, noise, repeat, settled, train_on
from parts import products, traffic

from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import Config
from gbdqn_ref.dqn import DQN
from gbdqn_ref.train import make_agent, run

UPDATES = ((32, (4, 64, 64, 2)), (64, (6, 128, 128, 3)), (128, (11, 256, 256, 7)))
OURS = "gbdqn_ref"
PRODUCTS, TRAFFIC = "its matrix products alone", "its memory traffic alone"
BASE = "dqn, uniform replay"
LOOP = "the whole loop compiled by JAX, uniform replay"


def update(scale, batch_size, widths, absent):
    """One update of DQN without its sampling."""
    agent, batch = learner(batch_size, widths)
    calls = {OURS: agent.learn, PRODUCTS: products(batch_size, widths, backward=True)}
    calls[TRAFFIC] = traffic(agent.net.size)
    for name, (learn, theta) in peer_updates(agent, batch, absent).items():
        check_same_update(learner(batch_size, widths)[0], learn, theta)
        calls[name] = learn
    times = measure(scale, {name: repeat(scale, call) for name, call in calls.items()})
    title = f"update without sampling: batch {batch_size}, network {'-'.join(map(str, widths))}"
    return Section(title, ("÷ ours", "µs"), compare(times, OURS))


def learner(batch_size, widths):
    """A DQN that draws one and the same Batch each time, and that Batch."""
    state_dim, *hidden, n_actions = widths
    config = Config(agent="dqn", hidden=hidden, batch_size=batch_size)
    agent = DQN(state_dim, n_actions, config, np.random.default_rng(0))
    batch = noise(batch_size, state_dim, n_actions)
    agent.replay = SimpleNamespace(sample=lambda *_: batch, update_priorities=lambda *_: None)
    return agent, batch


def peer_updates(agent, batch, absent):
    """{label: (update, what reads its θ)} of each library that is here."""
    updates = {}
    if "jax" not in absent:
        from compiled import jax_update

        updates["JAX, one compiled function"] = jax_update(agent, batch)
    if "torch" not in absent:
        updates["PyTorch, eager"] = peers.torch_update(agent, batch)
    return updates


def check_same_update(agent, learn, theta, updates=3):
    """AssertionError unless an update of a peer gives our TD errors, and all of them our θ."""
    for _ in range(updates):
        np.testing.assert_allclose(learn(), agent.learn(), rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(theta(), agent.theta, rtol=1e-3, atol=1e-4)


def training(scale, env, absent):
    """The whole of training, with an update every 4 steps.

    DQN and GB-DQN with every replay, the other agents with their own.
    """
    records = {}
    for agent in AGENTS:
        for kind in REPLAYS if agent in ("dqn", "gbdqn") else (None,):
            name = f"{agent}, {kind} replay" if kind else agent
            records[name] = run(settled(env=env, agent=agent, replay=kind))
    records |= peer_trainings(scale, env, absent)
    times = measure(scale, {name: train_on(scale, each) for name, each in records.items()})
    rows = {name: (ratio, µs, 1e6 / µs) for name, (ratio, µs) in compare(times, BASE).items()}
    return Section(f"training on {env}, per environment step", ("ratio", "µs", "steps/s"), rows)


def peer_trainings(scale, env, absent):
    """{label: records} of each library that is here."""
    config, trainings = settled(env=env, agent="dqn", replay="uniform"), {}
    agent = make_agent(config)
    if env == "cartpole" and "jax" not in absent:
        import compiled

        compiled.check_cartpole()
        trainings[LOOP] = compiled.training(agent, scale.steps)
    for library, name in (("sbx", "SBX's DQN"), ("stable_baselines3", "Stable-Baselines3's DQN")):
        if library not in absent:
            stock = gymnasium.make(STOCK[env])
            records = peers.train(library, config, stock, scale.steps)
            trainings[f"{name}, uniform replay"] = records
    for records in trainings.values():
        check_same_training(agent, records, scale.steps)
    return trainings


def check_same_training(agent, records, steps):
    """AssertionError unless a peer's network has our size, and is updated as often as ours."""
    begun = (record for record in islice(records, 10) if record["updates"])
    first, second = next(begun), next(begun)
    assert second["parameters"] == agent.net.size, (second, agent.net.size)
    assert second["updates"] - first["updates"] == steps // agent.config.update_every, second


def compiling():
    """What JAX's peers take before they start: the first call."""
    import compiled

    calls = {}
    for batch_size, widths in UPDATES:
        learn, _ = compiled.jax_update(*learner(batch_size, widths))
        calls[f"update, network {'-'.join(map(str, widths))}"] = learn
    agent = make_agent(settled(agent="dqn", replay="uniform"))
    calls[LOOP] = partial(next, compiled.training(agent, agent.config.update_every))
    rows = {name: (first(call),) for name, call in calls.items()}
    return Section("compiling, once per process", ("s",), rows)


def first(call):
    """The processor's seconds for one call."""
    start = process_time()
    call()
    return process_time() - start

"""The same work elsewhere: PyTorch, Stable-Baselines3 and SBX. JAX has a module of its own."""

import importlib

import numpy as np

LIBRARIES = ("torch", "stable_baselines3", "jax", "sbx")
PACKAGES = {"sbx": "sbx-rl"}  # where a library is not called as its package is


def missing():
    """{library: why} of those that do not import here, or not beside the others."""
    reasons = {}
    for name in LIBRARIES:
        try:
            importlib.import_module(name)
        except Exception as error:  # a clash of libraries can raise anything
            reasons[name] = f"{type(error).__name__}: {error}"
    return reasons


def torch_update(agent, batch):
    """A DQN's learn() on one Batch in eager PyTorch, from the agent's networks as they are.

    Two functions: the update, which like ours goes from NumPy to TD errors in NumPy, and what reads
    its θ.
    """
    import torch

    torch.set_num_threads(1)
    c, net = agent.config, torch_network(agent.net, agent.theta)
    target = torch_network(agent.net, agent.theta_target)
    adam = torch.optim.Adam(net.parameters(), lr=c.lr)

    def update():
        _, s, a, r, s2, terminated, weight = (torch.as_tensor(x) for x in batch)
        with torch.no_grad():
            y = r + c.gamma * ~terminated * target(s2).max(1).values
        delta = y - net(s).gather(1, a[:, None])[:, 0]
        loss = 0.5 * (weight * delta**2).mean()
        adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), c.max_grad_norm)
        adam.step()
        with torch.no_grad():
            for theta_target, theta in zip(target.parameters(), net.parameters(), strict=True):
                theta_target.lerp_(theta, c.tau)
        return delta.detach().numpy()

    return update, lambda: read_network(net)


def torch_network(net, theta):
    """An nn.MLP and its θ as PyTorch's layers."""
    import torch

    layers = []
    for W, b in net.unpack(theta):
        layer = torch.nn.Linear(*W.shape)
        with torch.no_grad():
            layer.weight[...], layer.bias[...] = torch.tensor(W.T), torch.tensor(b)
        layers += [layer, torch.nn.ReLU()]
    return torch.nn.Sequential(*layers[:-1])


def read_network(network):
    """The θ (P,) of PyTorch's layers, laid out as in nn."""
    with_bias = [np.vstack([x.weight.T.detach(), x.bias.detach()]) for x in list(network)[::2]]
    return np.concatenate([V.ravel() for V in with_bias])


def train(library, config, env, steps):
    """Train the DQN of "stable_baselines3" or "sbx" under a config whose ε is constant.

    A record every so many steps. Both have Huber's loss; SBX clips no gradient.
    """
    import torch

    torch.set_num_threads(1)  # SBX's replay buffer is PyTorch's as well
    c = config
    own = {"max_grad_norm": c.max_grad_norm} if library == "stable_baselines3" else {}
    model = importlib.import_module(library).DQN(
        "MlpPolicy",
        env,
        learning_rate=c.lr,
        buffer_size=c.capacity,
        learning_starts=c.learning_starts,
        batch_size=c.batch_size,
        tau=c.tau,
        gamma=c.gamma,
        train_freq=c.update_every,
        gradient_steps=c.gradient_steps,
        target_update_interval=c.update_every,
        exploration_initial_eps=c.epsilon_end,
        exploration_final_eps=c.epsilon_end,
        policy_kwargs={"net_arch": list(c.hidden)},
        device="cpu",
        seed=c.seed,
        **own,
    )
    while True:
        model.learn(steps, reset_num_timesteps=False)
        yield {"length": steps, "updates": model._n_updates, "parameters": parameters(model)}


def parameters(model):
    """How many numbers the network of a model of Stable-Baselines3 or SBX has."""
    if hasattr(model, "q_net"):
        return sum(parameter.numel() for parameter in model.q_net.parameters())
    import jax

    return sum(leaf.size for leaf in jax.tree.leaves(model.policy.qf_state.params))

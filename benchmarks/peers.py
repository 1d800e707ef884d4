"""The same work in PyTorch and in Stable-Baselines3, for the benchmark only. Nothing else here
imports them.
"""

import importlib.util

import numpy as np


def installed():
    """Whether the optional extra `peers` is there."""
    return all(importlib.util.find_spec(name) for name in ("torch", "stable_baselines3"))


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


def sb3(config, env, steps):
    """Train Stable-Baselines3's DQN with the settings of a config whose ε is constant; a record
    every so many steps.
    """
    import stable_baselines3
    import torch

    torch.set_num_threads(1)
    model = stable_baselines3.DQN(
        "MlpPolicy",
        env,
        learning_rate=config.lr,
        buffer_size=config.capacity,
        learning_starts=config.learning_starts,
        batch_size=config.batch_size,
        tau=config.tau,
        gamma=config.gamma,
        train_freq=config.update_every,
        gradient_steps=config.gradient_steps,
        target_update_interval=config.update_every,
        exploration_initial_eps=config.epsilon_start,
        exploration_final_eps=config.epsilon_end,
        max_grad_norm=config.max_grad_norm,
        policy_kwargs={"net_arch": list(config.hidden)},
        device="cpu",
        seed=config.seed,
    )
    while True:
        model.learn(steps, reset_num_timesteps=False)
        yield {"length": steps}

"""The same work in PyTorch and in Stable-Baselines3, for the benchmark only. Nothing else here
imports them.
"""

import importlib.util
from itertools import pairwise


def installed():
    """Whether the optional extra `peers` is there."""
    return all(importlib.util.find_spec(name) for name in ("torch", "stable_baselines3"))


def torch_update(batch, widths, config):
    """dqn.DQN.learn in eager PyTorch: a function that, like it, goes from a Batch in NumPy to TD
    errors in NumPy.
    """
    import torch

    torch.set_num_threads(1)
    net, target = (_torch_network(widths) for _ in range(2))
    adam = torch.optim.Adam(net.parameters(), lr=config.lr)

    def update():
        _, s, a, r, s2, terminated, weight = (torch.as_tensor(x) for x in batch)
        with torch.no_grad():
            y = r + config.gamma * ~terminated * target(s2).max(1).values
        delta = y - net(s).gather(1, a[:, None])[:, 0]
        loss = 0.5 * (weight * delta**2).mean()
        adam.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), config.max_grad_norm)
        adam.step()
        with torch.no_grad():
            for theta_target, theta in zip(target.parameters(), net.parameters(), strict=True):
                theta_target.lerp_(theta, config.tau)
        return delta.detach().numpy()

    return update


def _torch_network(widths):
    from torch import nn

    layers = [
        layer for n_in, n_out in pairwise(widths) for layer in (nn.Linear(n_in, n_out), nn.ReLU())
    ]
    return nn.Sequential(*layers[:-1])


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

"""The training loop, as a generator of episodes. The algorithms are in dqn, gbdqn and baselines.

This is the part that all share.
"""

import numpy as np

from . import drift
from .baselines import EnsembleDQN, FrozenDQN, Random, ResetDQN, sliding_dqn
from .config import Config
from .dqn import DQN
from .gbdqn import GBDQN

__all__ = ["Config", "evaluate", "evaluate_regimes", "make_agent", "run"]

AGENTS = {
    "gbdqn": GBDQN,
    "dqn": DQN,
    "ensemble": EnsembleDQN,
    "reset": ResetDQN,
    "sliding": sliding_dqn,
    "frozen": FrozenDQN,
    "random": Random,
    "dqn-recency": DQN,
    "gbdqn-per": GBDQN,
}


def make_agent(config):
    """A new agent for the environment of the config, with its own generator, seeded by
    config.seed.
    """
    env = drift.make(config.env)
    return AGENTS[config.agent](
        env.observation_space.shape[0],
        int(env.action_space.n),
        config,
        np.random.default_rng(config.seed),
    )


def run(config, agent=None, first_episode=0):
    """Train, and yield one record per episode: a dict of what the episode was and came to.

    Hand in an agent to keep hold of it; with one that has seen first_episode episodes, the run goes
    on from there exactly as if it had not been interrupted. The last record of a regime has an
    evaluation in every regime.

    >>> config = Config(env="cartpole", episodes=2, learning_starts=10)
    >>> [(record["episode"], record["return"]) for record in run(config)]
    [(0, 10.0), (1, 36.0)]
    """
    agent = make_agent(config) if agent is None else agent
    env = drift.make(config.env, config.schedule)
    starts = {start for start, _, _ in drift.check_schedule(config.env, config.schedule)}
    for episode in range(first_episode, config.episodes):
        s, info = env.reset(seed=episode_seed(config.seed, episode), options={"episode": episode})
        if info["event"]:
            agent.on_drift(info["event"])
        length, total, deltas, ends = 0, 0.0, [], False
        while not ends:
            a = agent.act(s)
            s2, r, terminated, truncated, info = env.step(a)
            agent.observe(s, a, r, s2, terminated)
            if agent.steps >= config.learning_starts and agent.steps % config.update_every == 0:
                deltas += [agent.learn() for _ in range(config.gradient_steps)]
            s, ends, length, total = s2, terminated or truncated, length + 1, total + float(r)
        yield {
            "episode": episode,
            "regime": info["regime"],
            "event": info["event"] or "",
            "return": total,
            "length": length,
            "steps": agent.steps,
            "epsilon": agent.epsilon,
            "td_error": float(np.abs(deltas).mean()) if deltas else float("nan"),
            "evaluation": (
                evaluate_regimes(agent, config) if episode + 1 in {*starts, config.episodes} else []
            ),
        }
    agent.on_drift("end")


def episode_seed(seed, episode):
    """The seed of an episode's reset: independent of the agent, so that agents with one seed meet
    the same starts.
    """
    return int(np.random.SeedSequence([seed, episode]).generate_state(1)[0])


def evaluate_regimes(agent, config, episodes=5):
    """Mean return of the greedy policy in each regime of the run, without learning: what is known
    of each by now.
    """
    regimes = drift.check_schedule(config.env, config.schedule)
    schedules = [
        [{"episode": 0, **factors}] for start, factors, _ in regimes if start < config.episodes
    ]
    envs = [drift.make(config.env, schedule) for schedule in schedules]
    return [float(evaluate(agent, env, episodes, config.seed).mean()) for env in envs]


def evaluate(agent, env, episodes, seed):
    """Returns (episodes,) of the greedy policy, without learning, in the regime of the
    environment's episode 0.

    Start a later regime by giving `env` a schedule that begins with it at episode 0.
    """
    returns = np.zeros(episodes)
    for k in range(episodes):
        s, _ = env.reset(seed=episode_seed(seed, k), options={"episode": 0})
        ends = False
        while not ends:
            s, r, terminated, truncated, _ = env.step(agent.act(s, greedy=True))
            ends, returns[k] = terminated or truncated, returns[k] + float(r)
    return returns

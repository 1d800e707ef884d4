"""The training loop that all agents share, as a generator of episodes."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from . import DivergenceError, drift
from .agents import AGENTS
from .config import Config

__all__ = ["Config", "evaluate", "evaluate_regimes", "make_agent", "run"]

THREADS = ThreadpoolController()  # of the libraries that NumPy has loaded by now


def make_agent(config: Config) -> Any:
    """A new agent for the environment of the config; its generator is seeded by config.seed."""
    env = drift.make(config.env)
    state_dim, n_actions = env.observation_space.shape[0], int(env.action_space.n)  # type: ignore
    rng = np.random.default_rng(config.seed)
    return AGENTS[config.agent].make(state_dim, n_actions, config, rng)


def run(config: Config, agent: Any = None, first_episode: int = 0) -> Iterator[dict[str, Any]]:
    """Train and yield one record per episode, as a pure function of the config.

    Pass an agent to keep it. An agent that has seen first_episode episodes continues as if it had
    never stopped. The last record of a regime has an evaluation in every regime. The last one of
    the run evaluates the finished agent.

    >>> config = Config(env="cartpole", episodes=2, learning_starts=10)
    >>> [(record["episode"], record["return"]) for record in run(config)]
    [(0, 10.0), (1, 36.0)]
    """
    agent = make_agent(config) if agent is None else agent
    env = drift.make(config.env, config.schedule)
    last = {regime.end - 1 for regime in config.regimes}
    for episode in range(first_episode, config.episodes):
        # more threads are slower on matrices this small; overflow is checked for below
        with THREADS.limit(limits=1), np.errstate(over="ignore", invalid="ignore"):
            try:
                record = _train_episode(agent, env, config, episode)
            except FloatingPointError as e:
                raise DivergenceError(
                    f"training diverged in episode {episode}, step {agent.steps}: {e}; the likely "
                    f"cause is lr={config.lr:g}, so try a smaller one"
                ) from e
            if episode in last:
                judged = agent.finish() if episode + 1 == config.episodes else agent
                record["evaluation"] = evaluate_regimes(judged, env, config)
        yield record


def _train_episode(agent: Any, env: drift.DriftWrapper, config: Config, episode: int) -> dict:
    """The record of one episode of training."""
    seed = episode_seed(config.seed, episode)
    s, info = env.reset(seed=seed, options={"episode": episode})
    if event := announced(agent.config.drift_signal, episode, info["event"]):
        agent.on_drift(event)
    length, total, deltas, ends = 0, 0.0, [], False
    while not ends:
        a = agent.act(s)
        s2, r, terminated, truncated, info = env.step(a)
        agent.observe(s, a, r, s2, terminated)
        if agent.steps >= agent.learning_starts and agent.steps % config.update_every == 0:
            for _ in range(config.gradient_steps):
                deltas.append(agent.learn())
                _check_finite(deltas[-1], "TD error")
        s, ends, length, total = s2, terminated or truncated, length + 1, total + float(r)
    _check_finite(getattr(agent, "theta", np.empty(0)), "parameter")
    td_errors = np.abs(np.concatenate(deltas)) if deltas else np.empty(0)
    td_error = float(td_errors.mean()) if len(td_errors) else float("nan")
    agent.end_episode(total, td_error)
    return {
        "episode": episode,
        "regime": info["regime"],
        "event": info["event"] or "",
        "return": total,
        "length": length,
        "steps": agent.steps,
        "epsilon": agent.epsilon,
        "td_error": td_error,
        "evaluation": [],
    }


def announced(signal: str | list, episode: int, event: str | None) -> str | None:
    """The event that an agent is told of as an episode begins, or None.

    The signal is the schedule, or a list of episodes with drifts. An agent that detects drifts
    itself is told of none.
    """
    if signal == "schedule":
        return event
    return "drift" if isinstance(signal, list) and episode in signal else None


def _check_finite(values: np.ndarray, what: str) -> None:
    if not np.isfinite(values).all():
        raise FloatingPointError(f"a {what} is not finite")


def episode_seed(seed: int, episode: int) -> int:
    """The seed of an episode's reset, the same for every agent, so all meet the same starts."""
    return int(np.random.SeedSequence([seed, episode]).generate_state(1)[0])


def evaluate_regimes(
    agent: Any, env: drift.DriftWrapper, config: Config, episodes: int = 5
) -> list[float]:
    """Mean greedy return in each regime of the run: how well the agent now does in each.

    `env` has the schedule of the config; nothing is learnt.
    """
    return [
        float(evaluate(agent, env, episodes, config.seed, regime.start).mean())
        for regime in config.regimes
    ]


def evaluate(
    agent: Any, env: drift.DriftWrapper, episodes: int, seed: int, start: int = 0
) -> np.ndarray:
    """Greedy returns (episodes,) in the physics of the environment's episode `start`.

    Nothing is learnt.
    """
    returns = np.zeros(episodes)
    for k in range(episodes):
        s, _ = env.reset(seed=episode_seed(seed, k), options={"episode": start})
        ends = False
        while not ends:
            s, r, terminated, truncated, _ = env.step(agent.act(s, greedy=True))
            ends, returns[k] = terminated or truncated, returns[k] + float(r)
    return returns

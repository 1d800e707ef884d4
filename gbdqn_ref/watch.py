"""Films of a trained agent before and after a drift, and maps of its Q over a plane of states."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from . import UsageError, drift, plots, runs
from .agents import AGENTS
from .files import check_picture, write_atomically
from .gbdqn import GBDQN
from .schedule import describe
from .train import episode_seed

WIDTH, CAPTION, MARGIN = 320, 40, (6, 3)  # pixels: of one episode, above it, around its caption
FRAMES, LAST, SHORTEST = 150, 10, 20  # frames at most, repeats of the last one, ms of a frame
FONT = ImageFont.truetype(plots.FONT, 13)  # Pillow's own has no ×


class Episode(NamedTuple):
    """A filmed episode: its pictures, the return so far at each, and how long a step takes in s."""

    title: str
    pictures: list[Image.Image]
    returns: list[float]
    pace: float

    def caption(self, step: int) -> str:
        """The text above the picture of this step."""
        return f"{self.title}\nstep {step}, return {self.returns[step]:z.0f}"


def film(run: Path | str, regime: int = 1, seed: int = 0) -> list[Episode]:
    """Two greedy episodes of the run in a folder, in the physics before and after a drift.

    Both use the agent at the end of the run and the same start. Nothing is learnt.
    """
    config = runs.read_config(run)
    drifts = len(config.regimes) - 1
    if not 1 <= regime <= drifts:
        had = f"it has {_range(1, drifts)}" if drifts else "its physics never change"
        raise UsageError(f"there is no drift {regime} in the run in {run}; {had}")
    shown = config.regimes[regime - 1 : regime + 1]
    envs = [_drawn(config.env, each.factors) for each in shown]  # before MuJoCo is imported
    _, agent = runs.read_agent(run)
    named = zip(("before", "after"), shown, strict=True)
    titles = [f"{when}: {describe(each.factors)}" for when, each in named]
    start = episode_seed(seed, 0)
    return [episode(agent, env, start, title) for env, title in zip(envs, titles, strict=True)]


def episode(agent: Any, env: drift.DriftWrapper, seed: int, title: str) -> Episode:
    """One greedy episode, filmed."""
    s, _ = env.reset(seed=seed, options={"episode": 0})
    pictures, returns, ends = [_picture(env)], [0.0], False
    while not ends:
        s, r, terminated, truncated, _ = env.step(agent.act(s, greedy=True))
        ends = terminated or truncated
        pictures.append(_picture(env))
        returns.append(returns[-1] + float(r))
    env.close()
    return Episode(title, pictures, returns, 1 / env.metadata["render_fps"])


def frames(episodes: Sequence[Episode]) -> tuple[list[Image.Image], int]:
    """The frames of a film that shows episodes side by side, and how long each lasts, in ms.

    If there are too many steps, some are left out evenly. An episode that has ended stands still.
    """
    length = max(len(each.pictures) for each in episodes)
    every = -(-length // FRAMES)
    steps = [*range(0, length, every), *[length - 1] * LAST]
    duration = max(SHORTEST, round(1000 * every * episodes[0].pace))
    return [_side_by_side(episodes, step) for step in steps], duration


def save(episodes: Sequence[Episode], path: Path | str) -> None:
    """Write the film of some episodes as a GIF, atomically; a missing folder is made."""
    check_picture(path, ".gif")
    (first, *others), duration = frames(episodes)
    options: dict[str, Any] = dict(save_all=True, append_images=others, duration=duration, loop=0)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: first.save(file, format="GIF", **options))


def plane(n: int = 61) -> np.ndarray:
    """MountainCar's states as a grid (n, n, 2): velocity rises along axis 0, position along 1."""
    position, velocity = np.meshgrid(np.linspace(-1.2, 0.6, n), np.linspace(-0.07, 0.07, n))
    return np.stack([position, velocity], axis=-1).astype(np.float32)


def maps(run: Path | str, booster: int | None = None) -> plots.Figure:
    """Q_{m−1}, α_m h_m and Q_m over MountainCar's plane; booster m is the last one by default."""
    config, agent = runs.read_agent(run)
    own = config.resolved()
    adds_up = AGENTS[own.agent].make is GBDQN and (own.zero_output or not own.warm_start)
    if own.env != "mountaincar" or not adds_up:
        wanted = "a run of GB-DQN on MountainCar whose boosters begin anew"
        raise UsageError(f"maps need {wanted}; {run} has another run")
    stages = agent.staged_q(plane())
    m = len(stages) if booster is None else booster
    if not 2 <= m <= len(stages):
        had = _range(2, len(stages)) if len(stages) > 1 else "only the first, before any drift"
        raise UsageError(f"there is no booster {m} to map in the run in {run}; it has {had}")
    return plots.value_maps(stages[m - 2], stages[m - 1], m)


def _range(first: int, last: int) -> str:
    return f"{first} to {last}" if first < last else f"only {first}"


def _drawn(name: str, factors: dict[str, float]) -> drift.DriftWrapper:
    """The environment with these physics, rendered in memory.

    By default pygame and MuJoCo need a screen. MuJoCo reads its variable when it is imported.
    """
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        env = drift.make(name, [{"episode": 0, **factors}], render_mode="rgb_array")
        env.reset()
        env.render()
    except Exception as e:  # each platform and each driver fails in its own way
        raise UsageError(
            f"cannot draw without a screen here ({type(e).__name__}); MuJoCo needs EGL or OSMesa"
            " (Debian: libegl1 or libosmesa6, then MUJOCO_GL=egl or osmesa), the other"
            " environments pygame"
        ) from e
    return env


def _picture(env: drift.DriftWrapper) -> Image.Image:
    picture = Image.fromarray(np.asarray(env.render()))
    return picture.resize((WIDTH, WIDTH * picture.height // picture.width))


def _side_by_side(episodes: Sequence[Episode], step: int) -> Image.Image:
    """One frame: each episode at this step, or at its end, below its caption."""
    height = episodes[0].pictures[0].height + CAPTION
    frame = Image.new("RGB", (WIDTH * len(episodes), height), "white")
    for k, shown in enumerate(episodes):
        at, left = min(step, len(shown.pictures) - 1), WIDTH * k
        frame.paste(shown.pictures[at], (left, CAPTION))
        corner = (left + MARGIN[0], MARGIN[1])
        ImageDraw.Draw(frame).text(corner, shown.caption(at), "black", FONT)
    return frame

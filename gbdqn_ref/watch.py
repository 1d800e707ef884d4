"""Looking at a trained agent: its greedy episodes before and after a drift, and what a booster
changed on a plane.
"""

import os
import sys

import numpy as np
from matplotlib.font_manager import findfont
from PIL import Image, ImageDraw, ImageFont

from . import UsageError, drift, plots, runs
from .files import write_atomically
from .schedule import describe
from .train import episode_seed

WIDTH, CAPTION, FRAMES = 320, 40, 150  # pixels, pixels, the most that a film has
FONT = ImageFont.truetype(
    findfont("DejaVu Sans"), 13
)  # Matplotlib brings it, and Pillow's own has no ×


def film(out, path, regime=1, seed=0):
    """One greedy episode of the run in `out` in the physics before this drift and one in those
    after it, as a GIF.

    Side by side, from the same start, without learning, as the agent is at the end of its run.
    Returns the two returns.
    """
    config = runs.read_config(out)
    regimes = [each.factors for each in config.regimes]
    if not 1 <= regime < len(regimes):
        had = f"it has 1 to {len(regimes) - 1}" if len(regimes) > 1 else "its physics never change"
        raise UsageError(f"there is no drift {regime} in the run in {out}; {had}")
    shown = {"before": regimes[regime - 1], "after": regimes[regime]}
    envs = [
        _drawn(config.env, factors) for factors in shown.values()
    ]  # first: MuJoCo is told once where to draw
    _, agent = runs.read_agent(out)
    films = [
        (f"{when}: {describe(factors)}", *_episode(agent, env, episode_seed(seed, 0)))
        for (when, factors), env in zip(shown.items(), envs, strict=True)
    ]
    length = max(len(pictures) for _, pictures, _ in films)
    every = -(-length // FRAMES)
    frames = [_side_by_side(films, step) for step in [*range(0, length, every), *[length - 1] * 10]]
    duration = max(
        20, 1000 * every // envs[0].metadata["render_fps"]
    )  # in ms; a viewer shows no frame for less than 20
    options = dict(format="GIF", save_all=True, append_images=frames[1:], duration=duration, loop=0)
    write_atomically(path, lambda file: frames[0].save(file, **options))
    return [float(returns[-1]) for _, _, returns in films]


def _drawn(name, factors):
    """The environment with these physics, drawing in memory: without being told, pygame and MuJoCo
    want a screen.
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


def _episode(agent, env, seed):
    """(pictures, return so far at each) of one greedy episode."""
    s, _ = env.reset(seed=seed, options={"episode": 0})
    pictures, returns, ends = [_picture(env)], [0.0], False
    while not ends:
        s, r, terminated, truncated, _ = env.step(agent.act(s, greedy=True))
        ends = terminated or truncated
        pictures.append(_picture(env))
        returns.append(returns[-1] + float(r))
    env.close()
    return pictures, returns


def _picture(env):
    picture = Image.fromarray(env.render())
    return picture.resize((WIDTH, WIDTH * picture.height // picture.width))


def _side_by_side(films, step):
    """One frame: what each film shows at this step, or at its end, below its title and the return
    so far.
    """
    frame = Image.new("RGB", (WIDTH * len(films), films[0][1][0].height + CAPTION), "white")
    for k, (title, pictures, returns) in enumerate(films):
        at = min(step, len(pictures) - 1)
        frame.paste(pictures[at], (WIDTH * k, CAPTION))
        caption = f"{title}\nstep {at}, return {returns[at]:.0f}"
        ImageDraw.Draw(frame).text((WIDTH * k + 6, 3), caption, "black", FONT)
    return frame


def plane(n=61):
    """MountainCar's states as a grid (n, n, 2): velocity grows along the first axis, position along
    the second.
    """
    position, velocity = np.meshgrid(np.linspace(-1.2, 0.6, n), np.linspace(-0.07, 0.07, n))
    return np.stack([position, velocity], axis=-1).astype(np.float32)


def maps(out, path, booster=None):
    """Q_{m−1}, α_m h_m and Q_m over MountainCar's plane, with the greedy actions; by default of the
    last booster m.
    """
    config, agent = runs.read_agent(out)
    if config.env != "mountaincar" or not hasattr(agent, "staged_q"):
        raise UsageError(
            f"maps are of GB-DQN on MountainCar, whose state is a plane; {out} has another run"
        )
    stages = agent.staged_q(plane())
    m = len(stages) if booster is None else booster
    if not 2 <= m <= len(stages):
        had = f"2 to {len(stages)}" if len(stages) > 1 else "one that follows no drift"
        raise UsageError(f"there is no booster {m} in the run in {out}; it has {had}")
    plots.save(plots.value_maps(stages[m - 2], stages[m - 1], m), path)

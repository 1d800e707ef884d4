"""Films and value maps show what the agent does; what cannot be shown is refused in one line."""

import os
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from helpers import SMALL, contents, refused
from PIL import Image

from gbdqn_ref import UsageError, drift, runs, train, watch
from gbdqn_ref.__main__ import main
from gbdqn_ref.config import Config
from gbdqn_ref.train import evaluate

SCHEDULE = [
    {"episode": 2, "gravity": 1.3},
    {"episode": 3, "force": 0.8},
    {"episode": 4, "gravity": 0.7},  # after the end of the run
]
DRIFTING = SMALL | dict(episodes=4, update_every=16, schedule=SCHEDULE)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of GB-DQN on MountainCar with two drifts: three boosters."""
    out = tmp_path_factory.mktemp("watch") / "run"
    runs.train(Config(env="mountaincar", **DRIFTING), out, quiet=True)
    return out


def test_the_agent_is_read_in_its_final_state(run):
    config, agent = runs.read_agent(run)
    env = drift.make(config.env, [{"episode": 0, "force": 0.8}])
    last = runs.read_summary(run)["evaluation"][-1]
    assert last[2] == evaluate(agent, env, 5, config.seed).mean()


# --- the film -------------------------------------------------------------------------------------


def grey(level):
    """A frame of one grey."""
    return np.full((6, 9, 3), level, np.uint8)


class World:
    """An episode of three steps with reward −1.5; its frame brightens with each step."""

    metadata = {"render_fps": 25}

    def __init__(self, truncated=False):
        self.truncated, self.calls = truncated, []

    def reset(self, **options):
        self.calls.append(options)
        self.steps = 0
        return np.zeros(1), {}

    def step(self, a):
        self.calls.append(a)
        self.steps += 1
        ends = self.steps == 3
        terminated, truncated = ends and not self.truncated, ends and self.truncated
        return np.full(1, self.steps), -1.5, terminated, truncated, {}

    def render(self):
        return grey(10 * self.steps)

    def close(self):
        self.calls.append("close")


def agent(act=lambda s, greedy: (int(s[0]), greedy)):
    return SimpleNamespace(act=act)


@pytest.mark.parametrize("truncated", [False, True])
def test_an_episode_is_filmed_from_its_start_to_its_end(truncated):
    world = World(truncated)
    shown = watch.episode(agent(), world, 5, "a title")
    start = {"seed": 5, "options": {"episode": 0}}
    assert world.calls == [start, (0, True), (1, True), (2, True), "close"]
    assert [picture.getpixel((0, 0))[0] for picture in shown.pictures] == [0, 10, 20, 30]
    assert {picture.size for picture in shown.pictures} == {(320, 213)}, "9 by 6, made wider"
    assert shown.returns == [0, -1.5, -3, -4.5]
    assert (shown.title, shown.pace) == ("a title", 0.04)


def episode(length, title="", pace=0.04, first=0):
    """A filmed episode whose frames are numbered by their brightness."""
    pictures = [Image.fromarray(grey(first + k)) for k in range(length)]
    return watch.Episode(title, pictures, [-2.0 * k for k in range(length)], pace)


def steps(frames, k=0):
    """The number of the k-th episode's step that each frame shows."""
    return [frame.getpixel((watch.WIDTH * k, watch.CAPTION))[0] for frame in frames]


def test_a_caption_has_the_title_the_step_and_the_return():
    assert episode(4, "after: gravity × 2").caption(3) == "after: gravity × 2\nstep 3, return -6"


def test_the_shorter_episode_freezes_and_the_end_is_held():
    frames, duration = watch.frames([episode(3), episode(5, first=100)])
    last = [4] * watch.LAST
    assert steps(frames) == [0, 1, 2, 2, 2, *[2] * watch.LAST]
    assert steps(frames, 1) == [100 + k for k in [0, 1, 2, 3, 4, *last]]
    assert duration == 40
    assert {frame.size for frame in frames} == {(2 * watch.WIDTH, 6 + watch.CAPTION)}


@pytest.mark.parametrize(
    ("length", "every", "shown"), [(150, 1, 150), (151, 2, 76), (201, 2, 101), (250, 2, 125)]
)
def test_a_long_episode_skips_steps_evenly(length, every, shown):
    frames, duration = watch.frames([episode(length)])
    assert steps(frames) == [*range(0, length, every), *[length - 1] * watch.LAST]
    assert (len(frames), duration) == (shown + watch.LAST, 40 * every)


@pytest.mark.parametrize(("pace", "duration"), [(1 / 30, 33), (0.0199, 20), (0.008, 20)])
def test_a_step_lasts_as_long_as_in_its_environment_but_at_least_20_ms(pace, duration):
    assert watch.frames([episode(2, pace=pace)])[1] == duration


def test_each_caption_stands_above_its_episode(monkeypatch):
    """The caption of the shorter episode stays at its last step."""
    texts = []
    drawing = SimpleNamespace(text=lambda *args: texts.append(args))
    monkeypatch.setattr(watch.ImageDraw, "Draw", lambda frame: drawing)
    watch.frames([episode(1, "before: x"), episode(2, "after: y")])
    left, right, *_ = texts
    assert left == ((6, 3), "before: x\nstep 0, return 0", "black", watch.FONT)
    assert right == ((326, 3), "after: y\nstep 0, return 0", "black", watch.FONT)
    shown = [text for _, text, _, _ in texts[2:4]]
    assert shown == ["before: x\nstep 0, return 0", "after: y\nstep 1, return -2"]


def test_captions_are_black_on_white_and_do_not_reach_the_frames():
    frame = np.asarray(watch.frames([episode(1, "gravity × 2"), episode(1, "×")])[0][0])
    above = frame[: watch.CAPTION]
    assert above.min() < 50 and (above[:3] == 255).all() and (above[-2:] == 255).all()
    assert (frame[watch.CAPTION :, :9] == 0).all()


def test_a_film_is_a_looping_gif(tmp_path):
    path = tmp_path / "a" / "new" / "film.gif"
    for _ in range(2):
        watch.save([episode(3), episode(5)], path)
    assert set(contents(tmp_path)) == {"a", "a/new", "a/new/film.gif"}
    with Image.open(path) as film:
        assert (film.format, film.info["loop"], film.info["duration"]) == ("GIF", 0, 40)
        assert film.size == (2 * watch.WIDTH, 6 + watch.CAPTION)
        frames = []
        for k in range(film.n_frames):
            film.seek(k)
            frames.append(film.convert("RGB").getpixel((0, watch.CAPTION))[0])
    assert frames[:3] == [0, 1, 2] and frames[-1] == 2
    with pytest.raises(UsageError, match=r"is a \.gif file"):
        watch.save([episode(3)], tmp_path / "film.mp4")


# --- the film of a run ----------------------------------------------------------------------------


def test_the_command_films_the_same_start_in_both_physics(run, tmp_path, capsys):
    path = tmp_path / "films" / "episode.gif"
    assert main(["watch", str(run), "--drift", "2", "--out", str(path)]) == 0
    with Image.open(path) as film:
        assert film.size[0] == 2 * watch.WIDTH and 50 < film.n_frames <= watch.FRAMES + watch.LAST
        first = np.asarray(film.convert("RGB"))[watch.CAPTION :]
    assert (first[:, : watch.WIDTH] == first[:, watch.WIDTH :]).all() and first.std() > 0
    assert capsys.readouterr().out == (
        f"return before the drift -200.0, after it -200.0; film: {path}\n"
    )


@pytest.mark.parametrize(
    ("regime", "titles", "physics"),
    [
        (1, ["before: stock physics", "after: gravity × 1.3"], [(1, 1), (1.3, 1)]),
        (2, ["before: gravity × 1.3", "after: force × 0.8"], [(1.3, 1), (1, 0.8)]),
    ],
)
def test_each_episode_has_the_physics_in_its_title(run, monkeypatch, regime, titles, physics):
    seen = []
    monkeypatch.setattr(watch, "episode", lambda *args: seen.append(args) or args)
    watch.film(run, regime, seed=3)
    for _, env, _, _ in seen:
        env.reset()
    worlds = [env.unwrapped for _, env, _, _ in seen]
    factors = [(world.gravity / 0.0025, world.force / 0.001) for world in worlds]
    assert np.ravel(factors) == pytest.approx(np.ravel(physics))
    assert [title for *_, title in seen] == titles
    assert {seed for _, _, seed, _ in seen} == {train.episode_seed(3, 0)}


def test_by_default_the_first_drift_is_filmed_from_the_first_start(run, monkeypatch):
    monkeypatch.setattr(watch, "episode", lambda *args: args)
    (*_, seed, title), _ = watch.film(run)
    assert (seed, title) == (train.episode_seed(0, 0), "before: stock physics")


def test_the_film_has_the_returns_of_the_greedy_policy(run):
    _, agent = runs.read_agent(run)
    schedules = [], [{"episode": 0, "gravity": 1.3}]
    worlds = [drift.make("mountaincar", schedule) for schedule in schedules]
    returns = [shown.returns[-1] for shown in watch.film(run, seed=3)]
    assert returns == [evaluate(agent, world, 1, 3)[0] for world in worlds]


def test_a_drift_after_the_end_of_the_run_has_no_film(run):
    with pytest.raises(UsageError, match=r"there is no drift 3 in the run in .*; it has 1 to 2"):
        watch.film(run, 3)


def test_a_run_with_one_drift_offers_only_that(tmp_path):
    config = Config(env="mountaincar", **DRIFTING | dict(episodes=3))
    runs.write_json(tmp_path / "config.json", {"config": config.to_dict()})
    with pytest.raises(UsageError, match=r"; it has only 1$"):
        watch.film(tmp_path, 2)


def test_a_machine_that_cannot_draw_is_told_in_one_line(run, tmp_path, monkeypatch, capsys):
    def fail(self):
        raise RuntimeError("no display")

    monkeypatch.setattr(gymnasium.Wrapper, "render", fail)
    said = (
        "cannot draw without a screen here (RuntimeError); MuJoCo needs EGL or OSMesa (Debian:"
        " libegl1 or libosmesa6, then MUJOCO_GL=egl or osmesa), the other environments pygame\n"
    )
    refused(capsys, tmp_path, ["watch", str(run), "--out", str(tmp_path / "x.gif")], said)


@pytest.mark.parametrize(
    ("command", "keyword"),
    [
        (["watch", "RUN", "--drift", "3"], "there is no drift 3 in the run"),
        (["watch", "RUN", "--drift", "0"], "it has 1 to 2"),
        (["watch", "RUN", "--seed", "-1"], "--seed must be"),
        (["watch", "RUN", "--out", "."], "is a folder"),
        (["watch", "RUN", "--out", "new/film.mp4"], "is a .gif file"),
        (["watch", "NOTHING", "--out", "new/film.gif"], "there is no run"),
        (["maps", "RUN", "--out", "new/maps.pdf"], "is a .png file"),
        (["maps", "NOTHING", "--out", "new/maps.png"], "there is no run"),
        (["watch", "NOTHING"], "there is no run"),
        (["maps", "RUN", "--booster", "1"], "it has 2 to 3"),
        (["maps", "RUN", "--booster", "4"], "there is no booster 4 to map"),
        (["maps", "NOTHING"], "there is no run"),
    ],
)
def test_a_missing_run_drift_or_booster_is_refused(
    run, tmp_path, monkeypatch, capsys, command, keyword
):
    monkeypatch.chdir(tmp_path)
    arguments = [{"RUN": str(run)}.get(word, word) for word in command]
    refused(capsys, tmp_path, arguments, keyword)


@pytest.mark.parametrize("platform", ["linux", "darwin"])
def test_pygame_and_mujoco_draw_in_memory(run, monkeypatch, platform):
    """The variables are set before an environment is made, unless the user has set them."""
    seen, make = [], drift.make

    def spy(*args, **options):
        if options:
            names = ("SDL_VIDEODRIVER", "MUJOCO_GL")
            seen.append([options["render_mode"], *(os.environ.get(name) for name in names)])
        return make(*args, **options)

    monkeypatch.setattr(drift, "make", spy)
    monkeypatch.setattr(watch, "episode", lambda *_: None)
    monkeypatch.setattr(watch.sys, "platform", platform)
    monkeypatch.setenv("SDL_VIDEODRIVER", "x11")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gymnasium.Wrapper, "render", lambda self: None)
    watch.film(run)
    monkeypatch.delenv("SDL_VIDEODRIVER")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    watch.film(run)
    first, second = seen[::2]
    assert first == ["rgb_array", "x11", {"linux": "egl"}.get(platform)]
    assert second == ["rgb_array", "dummy", "osmesa"]
    monkeypatch.setenv("SDL_VIDEODRIVER", "")  # so that undo restores it


# --- maps -----------------------------------------------------------------------------------------


@pytest.fixture
def four_boosters(monkeypatch):
    """An agent on MountainCar with Q_m = 10 m everywhere, m = 1, …, 4."""
    seen = []

    def staged_q(plane):
        seen.append(plane)
        return np.stack([np.full((*plane.shape[:-1], 3), 10.0 * m) for m in range(1, 5)])

    agent = SimpleNamespace(staged_q=staged_q)
    monkeypatch.setattr(runs, "read_agent", lambda run: (Config(env="mountaincar"), agent))
    return seen


@pytest.mark.parametrize(("booster", "m"), [(2, 2), (3, 3), (4, 4), (None, 4)])
def test_the_maps_show_the_booster_that_is_asked_for(four_boosters, booster, m):
    figure = watch.maps("run", booster)
    before, added, after = (float(axes.images[0].get_array().max()) for axes in figure.axes[:3])
    assert (before, added, after) == (10 * (m - 1), 10, 10 * m)
    assert f"h_{{{m}}}" in figure.axes[1].get_title(loc="left")
    np.testing.assert_array_equal(four_boosters[0], watch.plane())


@pytest.mark.parametrize("booster", [1, 5, 0, -1])
def test_other_boosters_are_refused(four_boosters, booster):
    with pytest.raises(
        UsageError, match=rf"no booster {booster} to map in the run in here; .*2 to 4"
    ):
        watch.maps("here", booster)


@pytest.mark.parametrize(
    ("count", "words"), [(1, "it has only the first, before any drift$"), (2, "it has only 2$")]
)
def test_the_refusal_names_the_boosters_that_can_be_mapped(monkeypatch, count, words):
    agent = SimpleNamespace(staged_q=lambda plane: np.zeros((count, 61, 61, 3)))
    monkeypatch.setattr(runs, "read_agent", lambda run: (Config(env="mountaincar"), agent))
    with pytest.raises(UsageError, match=words):
        watch.maps("run", 9)


@pytest.mark.parametrize(
    "settings",
    [
        dict(env="cartpole"),
        dict(env="mountaincar", agent="dqn"),
        dict(env="mountaincar", agent="gbdqn-reuse"),  # its stages do not add up
        dict(env="mountaincar", warm_start=True, zero_output=False),  # nor do these
    ],
)
def test_maps_are_only_for_gbdqn_on_mountaincar(tmp_path, settings):
    runs.train(Config(episodes=1, capacity=300, **settings), tmp_path / "run", quiet=True)
    with pytest.raises(UsageError, match="has another run"):
        watch.maps(tmp_path / "run")
    with pytest.raises(UsageError, match="its physics never change"):
        watch.film(tmp_path / "run")


def test_a_run_without_a_checkpoint_is_refused(run, tmp_path):
    (tmp_path / "config.json").write_bytes((run / "config.json").read_bytes())
    with pytest.raises(UsageError, match=r"no checkpoint\.npz; continue it: train --resume"):
        watch.maps(tmp_path)
    (tmp_path / "summary.json").touch()
    with pytest.raises(UsageError, match=r"no checkpoint\.npz; train it anew in another folder"):
        watch.maps(tmp_path)


def test_the_command_writes_the_maps(run, tmp_path, capsys):
    path = tmp_path / "new" / "maps.png"
    assert main(["maps", str(run), "--out", str(path)]) == 0
    assert path.read_bytes().startswith(b"\x89PNG")
    assert capsys.readouterr().out == f"picture: {path}\n"


def test_the_plane_is_mountaincars():
    grid = watch.plane(3)
    assert grid.dtype == np.float32 and watch.plane().shape == (61, 61, 2)
    np.testing.assert_allclose(grid[0, :, 0], [-1.2, -0.3, 0.6], atol=1e-6)
    np.testing.assert_allclose(grid[:, 0, 1], [-0.07, 0, 0.07], atol=1e-6)
    space = drift.make("mountaincar").observation_space
    np.testing.assert_allclose([grid[0, 0], grid[-1, -1]], [space.low, space.high])

"""Films and maps: they show what the agent does, and what cannot be shown is said in one line."""

import gymnasium
import numpy as np
import pytest
from helpers import SMALL, refused
from PIL import Image

from gbdqn_ref import UsageError, drift, plots, runs, watch
from gbdqn_ref.__main__ import main
from gbdqn_ref.config import Config
from gbdqn_ref.train import evaluate

DRIFTING = SMALL | dict(
    episodes=4,
    update_every=16,
    schedule=[{"episode": 2, "gravity": 1.3}, {"episode": 3, "force": 0.8}],
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of GB-DQN on MountainCar with two drifts: three boosters."""
    out = tmp_path_factory.mktemp("watch") / "run"
    runs.train(Config(env="mountaincar", **DRIFTING), out, quiet=True)
    return out


def test_the_agent_is_read_as_it_was_at_the_end(run):
    config, agent = runs.read_agent(run)
    env = drift.make(config.env, [{"episode": 0, "force": 0.8}])
    assert (
        runs.read_summary(run)["evaluation"][-1][2] == evaluate(agent, env, 5, config.seed).mean()
    )


def test_a_film_shows_the_same_start_in_both_physics(run, tmp_path, capsys):
    path = tmp_path / "films" / "episode.gif"
    assert main(["watch", str(run), "--drift", "2", "--out", str(path)]) == 0
    with Image.open(path) as film:
        assert film.size[0] == 2 * watch.WIDTH and 50 < film.n_frames <= watch.FRAMES + 11
        first = np.asarray(film.convert("RGB"))[watch.CAPTION :]
    assert (first[:, : watch.WIDTH] == first[:, watch.WIDTH :]).all() and first.std() > 0
    assert "before the drift -200.0, after it -200.0" in capsys.readouterr().out


def test_the_film_has_the_returns_of_the_greedy_policy(run, tmp_path):
    _, agent = runs.read_agent(run)
    returns = watch.film(run, tmp_path / "x.gif", regime=1, seed=3)
    schedules = [], [{"episode": 0, "gravity": 1.3}]
    assert returns == [
        evaluate(agent, drift.make("mountaincar", each), 1, 3)[0] for each in schedules
    ]


def test_each_half_has_the_physics_that_it_names(run, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(
        watch,
        "_episode",
        lambda agent, env, seed: seen.append(env) or ([Image.new("RGB", (9, 9))], [0]),
    )
    watch.film(run, tmp_path / "x.gif", regime=2)
    for env in seen:
        env.reset()
    before, after = (env.unwrapped for env in seen)
    assert (before.gravity, before.force) == (0.0025 * 1.3, 0.001)
    assert (after.gravity, after.force) == (0.0025, 0.001 * 0.8)


def test_where_nothing_can_be_drawn_one_line_says_so(run, tmp_path, monkeypatch, capsys):
    def fail(self):
        raise RuntimeError("no display")

    monkeypatch.setattr(gymnasium.Wrapper, "render", fail)
    arguments = ["watch", str(run), "--out", str(tmp_path / "x.gif")]
    for keyword in ("cannot draw without a screen", "libegl1"):
        refused(capsys, tmp_path, arguments, keyword)


@pytest.mark.parametrize(
    ("command", "keyword"),
    [
        (["watch", "RUN", "--drift", "3"], "there is no drift 3"),
        (["watch", "RUN", "--drift", "0"], "it has 1 to 2"),
        (["watch", "RUN", "--seed", "-1"], "--seed must be"),
        (["watch", "RUN", "--out", "."], "is a folder"),
        (["watch", "NOTHING"], "there is no run"),
        (["maps", "RUN", "--booster", "1"], "it has 2 to 3"),
        (["maps", "RUN", "--booster", "4"], "no booster 4"),
        (["maps", "NOTHING"], "there is no run"),
    ],
)
def test_what_is_not_there_is_not_shown(run, tmp_path, monkeypatch, capsys, command, keyword):
    monkeypatch.chdir(tmp_path)
    arguments = [{"RUN": str(run)}.get(word, word) for word in command]
    refused(capsys, tmp_path, arguments, keyword)


@pytest.mark.parametrize("settings", [dict(env="cartpole"), dict(env="mountaincar", agent="dqn")])
def test_maps_are_of_gb_dqn_on_mountaincar(tmp_path, settings):
    runs.train(Config(episodes=1, capacity=300, **settings), tmp_path / "run", quiet=True)
    with pytest.raises(UsageError, match="has another run"):
        watch.maps(tmp_path / "run", tmp_path / "maps.png")
    with pytest.raises(UsageError, match="its physics never change"):
        watch.film(tmp_path / "run", tmp_path / "x.gif")


def test_a_run_without_a_checkpoint_is_refused(run, tmp_path):
    (tmp_path / "config.json").write_bytes((run / "config.json").read_bytes())
    with pytest.raises(UsageError, match=r"no checkpoint\.npz yet"):
        watch.maps(tmp_path, tmp_path / "maps.png")


def test_the_maps_are_written(run, tmp_path, capsys):
    assert main(["maps", str(run), "--out", str(tmp_path / "maps.png")]) == 0
    assert (tmp_path / "maps.png").read_bytes().startswith(
        b"\x89PNG"
    ) and "maps.png" in capsys.readouterr().out


def test_the_maps_show_what_the_booster_added():
    """Two actions' values change hands in one corner: that corner is black below, and coloured
    above.
    """
    before = np.zeros((5, 5, 3))
    before[..., 0] = 1.0
    after = before.copy()
    after[4, 4] = [0.0, 0.0, 3.0]
    figure = plots.value_maps(before, after, 2)
    pictures = [axes.images[0].get_array() for axes in figure.axes if axes.images][:6]
    assert pictures[1][4, 4] == 3 and np.count_nonzero(pictures[1]) == 1
    assert pictures[2][4, 4] == 3 and pictures[0][4, 4] == 1
    assert pictures[4].sum() == 1 and pictures[4][4, 4] == 1
    assert pictures[3][4, 4] == 0 and pictures[5][4, 4] == 2
    assert "Q_1" in figure.axes[0].get_title(loc="left")


def test_the_plane_is_mountaincars():
    grid = watch.plane(3)
    np.testing.assert_allclose(grid[0, :, 0], [-1.2, -0.3, 0.6], atol=1e-6)
    np.testing.assert_allclose(grid[:, 0, 1], [-0.07, 0, 0.07], atol=1e-6)
    low, high = (
        drift.make("mountaincar").observation_space.low,
        drift.make("mountaincar").observation_space.high,
    )
    np.testing.assert_allclose([grid[0, 0], grid[-1, -1]], [low, high])

"""The returns and networks that a notebook shows are those of the runs that are stored."""

import json

import curves
import numpy as np
import pytest
from reruns import stored

from gbdqn_ref import UsageError
from gbdqn_ref.config import Config
from gbdqn_ref.runs import read_episodes, train
from gbdqn_ref.stats import final_return, regime_table


def rows(run, returns):
    """Records like those of the run, with these returns."""
    starts = {regime["first_episode"]: regime for regime in run["regimes"]}
    regime = None
    for episode, value in enumerate(returns):
        regime = starts.get(episode, regime)
        event = regime["event"] if episode in starts else ""
        yield {"episode": episode, "regime": regime["regime"], "event": event, "return": value}


def fits(run, returns):
    """Whether the summary of a run is that of these returns."""
    return run["final_return"] == final_return(returns) and run["regimes"] == regime_table(
        list(rows(run, returns)), run["random_return"]
    )


@pytest.mark.parametrize("agent", curves.returns("cartpole"))
def test_the_returns_are_those_of_the_stored_study(agent):
    """Final return, and every measure of every regime, to the last bit."""
    runs = [run for run in stored("cartpole")["runs"] if run["agent"] == agent]
    for run, returns in zip(runs, curves.returns("cartpole")[agent], strict=True):
        assert fits(run, returns)


def test_control_another_return_does_not_fit():
    run = next(run for run in stored("cartpole")["runs"] if run["agent"] == "dqn")
    returns = curves.returns("cartpole")["dqn"][0].copy()
    assert fits(run, returns)
    returns[310] += 1
    assert not fits(run, returns)


def test_the_plane_has_what_two_agents_learnt_and_where_they_were():
    kept = np.load(curves.PLANE, allow_pickle=False)
    for agent in ("gbdqn", "dqn"):
        before, after = kept[f"{agent}_before"], kept[f"{agent}_after"]
        assert before.shape == after.shape and (before != after).any()
        assert np.isfinite([before, after]).all()
        assert kept[f"{agent}_visited_after"][kept[f"{agent}_visited_before"]].all()
        assert 0.5 < kept[f"{agent}_visited_after"].mean() < 0.9


def test_both_are_stored_as_they_are_read(tmp_path, monkeypatch):
    """A study's returns, and a short run on the plane."""
    study = {"seeds": [3], "agents": ["dqn"]}
    monkeypatch.setattr(curves, "RESULTS", tmp_path)
    monkeypatch.setattr(curves, "stored", lambda _: study)
    monkeypatch.setattr(curves, "PLANE", tmp_path / "plane.npz")
    monkeypatch.setattr(curves, "DRIFT", 2)
    (tmp_path / "results.json").write_text(json.dumps(study))
    train(Config(agent="dqn", seed=3, episodes=2, capacity=50), tmp_path / "dqn-3", quiet=True)
    curves.store_returns("short", tmp_path)
    (first, second) = (record["return"] for record in read_episodes(tmp_path / "dqn-3"))
    text = f'{{"dqn":[[{first:.0f},{second:.0f}]]}}\n'
    assert (tmp_path / "short-returns.json").read_text() == text
    assert curves.returns("short")["dqn"].tolist() == [[first, second]]
    monkeypatch.setattr(curves, "stored", lambda _: study | {"seeds": [4]})
    with pytest.raises(UsageError, match="not that of the stored study short"):
        curves.store_returns("short", tmp_path)
    assert (tmp_path / "short-returns.json").read_text() == text
    curves.store_plane(agents=("dqn",))
    kept = np.load(curves.PLANE, allow_pickle=False)
    assert set(kept) == {f"dqn_{name}" for name in ("before", "after")} | {
        f"dqn_visited_{name}" for name in ("before", "after")
    }
    assert 0 < kept["dqn_visited_before"].sum() <= kept["dqn_visited_after"].sum() < 600


def test_a_state_is_in_its_cell():
    assert curves.cell([[-1.2, -0.07], [0.6, 0.07], [-0.3, 0.0]]).tolist() == [
        [0, 0],
        [60, 60],
        [30, 30],
    ]

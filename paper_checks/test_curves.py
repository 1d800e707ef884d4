"""The returns and networks that a notebook shows are those of the runs that are stored."""

import json

import curves
import numpy as np
import pytest
from reruns import stored

from gbdqn_ref.runs import HEADER
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
    monkeypatch.setattr(curves, "RESULTS", tmp_path)
    monkeypatch.setattr(curves, "PLANE", tmp_path / "plane.npz")
    monkeypatch.setattr(curves, "DRIFT", 2)
    (tmp_path / "results.json").write_text(json.dumps({"seeds": [3], "agents": ["dqn"]}))
    (tmp_path / "dqn-3").mkdir()
    lines = [HEADER.decode(), "0,0,start,-1.5,2,2,1.0,nan,", "1,0,,7.0,7,9,1.0,nan,"]
    (tmp_path / "dqn-3/episodes.csv").write_text("\n".join(lines) + "\n")
    curves.store_returns("short", tmp_path)
    assert (tmp_path / "short-returns.json").read_text() == '{"dqn":[[-1.5,7]]}\n'
    assert curves.returns("short")["dqn"].tolist() == [[-1.5, 7.0]]
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

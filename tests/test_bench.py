"""The benchmark: what it prints and draws, and that it compares the same work.

No test asserts a speed.
"""

import importlib
import os
import platform
import subprocess
import sys
from itertools import count, pairwise
from math import nan
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from helpers import agent_of
from threadpoolctl import threadpool_info

from gbdqn_ref import UsageError
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import Config

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
import against
import bench
import growth
import measure
import parts
import peers
import report
import several

# --- what is printed and drawn --------------------------------------------------------------------


def test_the_command_prints_every_table_and_draws_the_plot(tmp_path, capsys, monkeypatch):
    """Without the processes of the last two tables, which are tested below."""
    monkeypatch.setattr(several, "study_seconds", lambda episodes, runs, jobs, dask=False: runs)
    monkeypatch.setattr(several, "two_at_once", lambda code, limit: 1.0)
    out = tmp_path / "new" / "bench.png"
    bench.main(["--tiny", "--out", str(out)])
    printed = capsys.readouterr().out
    labels = [f"{agent}, {kind} replay" for agent in ("gbdqn", "dqn") for kind in measure.REPLAYS]
    for label in [*labels, *(set(AGENTS) - {"gbdqn", "dqn"})]:
        assert printed.count(f"  {label}\n") == len(measure.STOCK)
    assert printed.count(f"  {against.OURS}\n") == len(against.UPDATES)
    for label in (*parts.PARTS, "all"):
        assert printed.count(f" {label}\n") == 3
    labels = "m = 1", "recency, N = 1,000", "acrobot, stock", "α = closed-form", "1 at a time"
    for label in labels:
        assert f" {label}\n" in printed
    assert "numpy before gbdqn_ref\n" in printed
    assert ("pip install -e '.[peers]'" in printed) == bool(peers.missing())
    assert out.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in out.parent.iterdir()] == ["bench.png"]


@pytest.mark.parametrize(
    ("out", "says"), [("", "is a folder"), ("bench.jpg", "a .png file"), ("file/bench.png", "file")]
)
def test_an_impossible_output_path_is_refused_before_measuring(out, says, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setattr(bench, "one_core", lambda: pytest.fail("measured"))
    with pytest.raises((UsageError, OSError), match=says):
        bench.main(["--tiny", "--out", str(tmp_path / out)])


def test_a_table_shows_three_digits_and_a_dash_for_nan(capsys):
    rows = {"one": (1.234, 12.34), "two": (123.4, nan), "three": (1234.5, 0.123)}
    report.table("title", ("µs", "a longer heading"), rows)
    assert capsys.readouterr().out.splitlines() == [
        "",
        "title",
        "        µs  a longer heading",
        "      1.23              12.3  one",
        "       123                 –  two",
        "     1,234              0.12  three",
    ]


def drawn(axes):
    """{label: (x, y)} of every line."""
    return {line.get_label(): tuple(map(list, line.get_data())) for line in axes.lines}


def test_the_plot_has_the_numbers_of_the_tables():
    scale = measure.Scale(sizes=(10, 100), boosters=(0, 2))
    replay = {
        f"{kind}, N = {n}": (nan, n + k, nan, nan, nan)
        for k, kind in enumerate(measure.REPLAYS)
        for n in scale.sizes
    }
    boosters = {"m = 0": (1.0, 5, 1.1, 6), "m = 2": (1.5, 7, 2.5, 8)}
    curves = bench.curves(scale, {growth.REPLAY: replay, growth.BOOSTERS: boosters})
    above, below = report.picture(curves).axes
    assert drawn(above) == {
        "uniform": ([10, 100], [10, 100]),
        "proportional": ([10, 100], [11, 101]),
        "recency": ([10, 100], [12, 102]),
    }
    assert drawn(below) == {
        "training per environment step": ([0, 2], [1.1, 2.5]),
        "update": ([0, 2], [1.0, 1.5]),
    }


def test_a_library_that_does_not_import_is_named_with_its_reason(monkeypatch):
    monkeypatch.setattr(peers, "LIBRARIES", ("numpy", "no_such_library"))
    absent = peers.missing()
    assert list(absent) == ["no_such_library"]
    first, second, third = bench.versions(absent).splitlines()
    assert f"numpy {np.__version__}" in first and "no_such_library" not in first
    assert second.startswith("without no_such_library (ModuleNotFoundError")
    assert "'.[peers]'" in third


# --- how time is taken ----------------------------------------------------------------------------


def test_ratios_are_taken_within_a_turn_and_the_base_is_1():
    times = {"base": [1.0, 10.0, 1.0], "twice": [2.0, 20.0, 2.0], "slow once": [1.0, 10.0, 9.0]}
    rows = measure.compare({name: np.array(values) for name, values in times.items()}, "base")
    assert rows == {"base": (1, 1), "twice": (2, 2), "slow once": (1, 9)}


def test_measuring_warms_up_and_takes_turns():
    order = []
    timers = {name: lambda name=name: order.append(name) or len(order) for name in "ab"}
    times = measure.measure(measure.Scale(turns=2), timers)
    assert order == list("ababab")
    assert {name: values.tolist() for name, values in times.items()} == {"a": [3, 5], "b": [4, 6]}


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="about Linux")
def test_one_core_is_used_and_all_are_given_back():
    before = os.sched_getaffinity(0)
    with bench.one_core():
        assert len(os.sched_getaffinity(0)) == 1
        assert {pool["num_threads"] for pool in threadpool_info()} == {1}
    assert os.sched_getaffinity(0) == before


def test_the_parts_of_a_step_are_measured_apart_and_add_up():
    """The clock ticks when it is read, so each part takes one tick each time it starts."""
    ticks = count()
    replay = SimpleNamespace(sample=lambda: None, update_priorities=lambda: None)
    agent = SimpleNamespace(act=lambda: None, observe=lambda: None, replay=replay)
    agent.learn = lambda: (replay.sample(), replay.update_priorities())
    spent, _ = parts.stopwatch(agent, lambda: next(ticks))
    for call in (agent.act, agent.observe, agent.learn):
        call()
    assert spent == {
        "the rest": 2,  # before acting, and between storing and learning
        "acting": 1,
        "environment": 1,
        "storing": 1,
        "sampling": 2,
        "update": 3,  # before, between and after the two calls of the replay
    }
    assert sum(spent.values()) == next(ticks) - 1


def test_the_parts_add_up_to_the_whole_step():
    scale = measure.TINY
    agent = agent_of("dqn", episodes=1_000_000)
    timers = parts.part_timers(scale, agent.config, agent)
    times = [{name: timer() for name, timer in timers.items()} for _ in range(3)]
    for each in times:
        assert sum(each[part] for part in parts.PARTS) == pytest.approx(each["all"], rel=0.05)


# --- floors ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("widths", "number"), [((6, 128, 128, 3), 11), ((4, 5, 2), 7), ((4, 2), 3)]
)
def test_the_floor_counts_exactly_the_matrix_products_of_an_update(monkeypatch, widths, number):
    """Two forward passes, dW and dh: their multiplications must add up to an update's."""
    multiply, cost = parts.products(8, widths, backward=True), []

    def matmul(x, y, out):
        cost.append(len(x) * x.shape[1] * y.shape[1])

    monkeypatch.setattr(np, "matmul", matmul)
    multiply()
    layers = [8 * n_in * n_out for n_in, n_out in pairwise(widths)]
    assert len(cost) == number
    assert sum(cost) == 2 * sum(layers) + sum(layers) + sum(layers[1:])  # two forward, dW, dh


def test_the_memory_counts_every_array():
    """Acrobot: two states of 6 float32, an int64, a float32, a bool; then the tree's leaves."""
    rows = growth.memory(measure.TINY._replace(rows=3200)).rows
    assert rows["uniform replay"][0] == pytest.approx(2 * 6 * 4 + 8 + 4 + 1, abs=0.1)
    assert rows["recency replay"][0] == pytest.approx(61 + 8 + 8 / 32, abs=0.1)


# --- equal work -----------------------------------------------------------------------------------


def updates(**values):
    """learn() of a small DQN and a function that reads its θ, as for a peer."""
    agent, _ = against.learner(16, (4, 8, 2))
    agent.config = Config(**agent.config.to_dict() | values).resolved()
    return agent.learn, lambda: agent.theta


def test_the_same_update_passes_the_check():
    against.check_same_update(against.learner(16, (4, 8, 2))[0], *updates())


@pytest.mark.parametrize("values", [{"gamma": 0.9}, {"tau": 0.5}])
def test_another_update_fails_the_check(values):
    agent, _ = against.learner(16, (4, 8, 2))
    with pytest.raises(AssertionError):
        against.check_same_update(agent, *updates(**values), updates=10)


def test_the_same_errors_from_another_network_fail_the_check():
    agent, _ = against.learner(16, (4, 8, 2))
    learn, theta = updates()
    with pytest.raises(AssertionError):
        against.check_same_update(agent, learn, lambda: theta() + 0.01)


@pytest.mark.parametrize("library", ["jax", "torch"])
def test_a_peer_makes_the_same_update(library):
    pytest.importorskip(library)
    agent, batch = against.learner(16, (4, 8, 2))
    absent = dict.fromkeys(set(peers.LIBRARIES) - {library}, "not asked for")
    [(learn, theta)] = against.peer_updates(agent, batch, absent).values()
    against.check_same_update(agent, learn, theta, updates=20)


def test_training_with_another_network_size_or_update_frequency_is_refused():
    agent = agent_of("dqn", update_every=4)

    def records(parameters, updates):
        return iter([{"parameters": parameters, "updates": k * updates} for k in range(3)])

    against.check_same_training(agent, records(agent.net.size, 5), 20)
    for wrong in (records(agent.net.size + 1, 5), records(agent.net.size, 6)):
        with pytest.raises(AssertionError):
            against.check_same_training(agent, wrong, 20)


@pytest.mark.parametrize("library", ["sbx", "stable_baselines3"])
def test_a_peer_trains_a_network_of_the_same_size_as_often(library):
    pytest.importorskip(library)
    agent = agent_of("dqn", hidden=[8, 8], learning_starts=8, batch_size=8)
    records = peers.train(library, agent.config, gymnasium.make("CartPole-v1"), 40)
    against.check_same_training(agent, records, 40)


def test_the_compiled_loop_has_gymnasiums_physics_and_learns():
    """After 20,000 steps an episode is longer than the 20 steps of a random policy."""
    pytest.importorskip("jax")
    compiled = importlib.import_module("compiled")
    compiled.check_cartpole()
    config = measure.settled(agent="dqn", replay="uniform", hidden=[32, 32], capacity=10_000)
    agent = against.make_agent(config)
    against.check_same_training(agent, compiled.training(agent, 400), 400)
    records = compiled.training(agent, 10_000)
    before, after = (next(records)["episodes"] for _ in range(2))
    assert after - before < 10_000 / 60


# --- several processes ----------------------------------------------------------------------------


def test_two_processes_get_only_the_given_thread_limit(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    code = "import os; print(sum(int(v) for k, v in os.environ.items() if 'NUM_THREADS' in k))"
    assert several.two_at_once(code, {"MKL_NUM_THREADS": "3"}) == 3


def test_two_training_processes_and_a_study_are_timed():
    code = "import numpy, gbdqn_ref" + several.TRAINING.format(steps=20)
    assert several.two_at_once(code, {}) > 0
    assert several.study_seconds(episodes=1, runs=1, jobs=1) > 0


def test_the_computed_time_is_the_start_plus_the_longest_queue_of_runs(monkeypatch):
    """A study takes 3 s and 2 s per run; two runs at a time, for two cores."""
    monkeypatch.setattr(several, "find_spec", lambda name: name)
    asked = []

    def seconds(episodes, runs, jobs, dask=False):
        asked.append((episodes, runs, jobs, dask))
        return 3.0 + 2.0 * runs / min(2, jobs) + 0.5 * dask

    table = several.jobs(measure.Scale(jobs=(1, 2, 4), episodes=9), seconds)
    assert table.columns == ("s", "computed s")
    assert table.rows["1 at a time"] == (19, 19)
    assert table.rows["2 at a time"] == (11, 11)
    assert table.rows["4 at a time"] == (11, 7)
    assert table.rows["2 workers of a Dask cluster"] == (11.5, 11)
    assert table.rows["8 workers, a core each"][1] == 5
    here = [(9, 8, jobs, False) for jobs in (1, 2, 4)]
    assert asked == [*here, (9, 1, 1, False), (9, 8, 2, True)]


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="about glibc's malloc")
def test_freed_memory_is_reused_by_the_next_update():
    """Without the setting in __init__, the system maps the pages of such arrays every time."""
    code = """
import resource, gbdqn_ref, numpy as np
faults = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_minflt
def work():
    arrays = [np.ones(75_000, np.float32) for _ in range(6)]
work()
before = faults()
for _ in range(100):
    work()
print(faults() - before)
"""
    printed = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert int(printed) < 1_000  # of 44,000 pages

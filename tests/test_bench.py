"""The benchmark runs, and what it compares is comparable. No test asserts a speed."""

import platform
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gbdqn_ref.config import Config
from gbdqn_ref.dqn import DQN
from gbdqn_ref.train import AGENTS

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
import bench
import peers


def test_the_command_prints_every_table_and_draws_the_plot(tmp_path, capsys):
    out = tmp_path / "new" / "bench.png"
    bench.main(["--tiny", "--out", str(out)])
    printed = capsys.readouterr().out
    labels = [f"{agent}, {kind} replay" for agent in ("gbdqn", "dqn") for kind in bench.REPLAYS]
    for label in [*labels, *(set(AGENTS) - {"gbdqn", "dqn"})]:
        assert printed.count(f"  {label}\n") == len(bench.STOCK)
    for label in ("m = 0", "m = 1", "recency, N = 1,000", "acrobot, stock"):
        assert f"  {label}" in printed
    for label in ("α = closed-form", "ε-greedy", "gbdqn_ref"):
        assert f"  {label}" in printed
    assert ("pip install -e '.[peers]'" in printed) == (not peers.installed())
    assert out.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in out.parent.iterdir()] == ["bench.png"]


@pytest.mark.parametrize(("out", "says"), [("", "is a folder"), ("file/bench.png", "file")])
def test_an_impossible_output_path_is_refused_before_measuring(
    out, says, tmp_path, capsys, monkeypatch
):
    (tmp_path / "file").touch()
    monkeypatch.setattr(bench, "sections", lambda scale: pytest.fail("measured"))
    with pytest.raises(SystemExit) as exit:
        bench.main(["--tiny", "--out", str(tmp_path / out)])
    assert exit.value.code == 2
    assert says in capsys.readouterr().err


def test_ratios_are_taken_within_a_turn_and_the_base_is_1():
    times = {"base": [1.0, 10.0, 1.0], "twice": [2.0, 20.0, 2.0], "slow once": [1.0, 10.0, 9.0]}
    rows = bench.compare({name: np.array(values) for name, values in times.items()}, "base")
    ratios = {name: ratio for name, (ratio, _) in rows.items()}
    assert ratios == {"base": 1, "twice": 2, "slow once": 1}


def test_measuring_warms_up_and_takes_turns():
    order = []
    timers = {name: lambda name=name: order.append(name) or len(order) for name in "ab"}
    times = bench.measure(bench.Scale(turns=2), timers)
    assert order == list("ababab")
    assert {name: values.tolist() for name, values in times.items()} == {"a": [3, 5], "b": [4, 6]}


@pytest.mark.parametrize(
    ("widths", "products"), [((6, 128, 128, 3), 11), ((4, 5, 2), 7), ((4, 2), 3)]
)
def test_the_floor_counts_exactly_the_matrix_products_of_an_update(monkeypatch, widths, products):
    """Two forward passes, dW and dh: their multiplications must add up to an update's."""
    multiply, cost = bench.products(8, widths, backward=True), []

    def count(x, y, out):
        cost.append(len(x) * x.shape[1] * y.shape[1])

    monkeypatch.setattr(np, "matmul", count)
    multiply()
    layers = [8 * n_in * n_out for n_in, n_out in pairwise(widths)]
    assert len(cost) == products
    assert sum(cost) == 2 * sum(layers) + sum(layers) + sum(layers[1:])  # two forward, dW, dh


def test_the_memory_counts_every_array():
    """Acrobot: two states of 6 float32, an int64, a float32, a bool; then the tree's leaves."""
    rows = bench.memory(bench.TINY._replace(rows=3200)).rows
    assert rows["uniform replay"][0] == pytest.approx(2 * 6 * 4 + 8 + 4 + 1, abs=0.1)
    assert rows["recency replay"][0] == pytest.approx(61 + 8 + 8 / 32, abs=0.1)


def test_pytorch_computes_the_same_errors_and_the_same_network():
    pytest.importorskip("torch")
    batch = bench.noise(16, 4, 2)
    agent = DQN(4, 2, Config(agent="dqn", hidden=[8], lr=0.01), np.random.default_rng(0))
    agent.replay.sample = lambda *_: batch
    agent.replay.update_priorities = lambda *_: None
    update, theta = peers.torch_update(agent, batch)
    for _ in range(20):
        np.testing.assert_allclose(agent.learn(), update(), rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(agent.theta, theta(), rtol=1e-3, atol=1e-4)


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

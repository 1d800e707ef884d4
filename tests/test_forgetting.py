"""Local forgetting, the control that needs no drift signal."""

import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from gymnasium.spaces import Box

sys.path.append(str(Path(__file__).parents[1] / "benchmarks" / "keep"))
import forgetting


@pytest.fixture
def replay():
    space = Box(np.zeros(1, np.float32), np.ones(1, np.float32))
    return forgetting.LocalReplay(8, space, bins=2, local=2)


def add(replay, s, a):
    replay.add([s], a, 0.0, [s], False)


def test_only_the_newest_of_each_cell_and_action_are_drawn(replay):
    for s, a in ((0.1, 0), (0.2, 0), (0.3, 0), (0.9, 0), (0.1, 1)):
        add(replay, s, a)
    assert np.flatnonzero(replay.drawn).tolist() == [1, 2, 3, 4]
    index = replay.sample(400, np.random.default_rng(0)).index
    assert np.bincount(index, minlength=8)[1:5].min() > 60 and set(index) == {1, 2, 3, 4}


def test_what_the_ring_overwrites_leaves_its_cell(replay):
    rng = np.random.default_rng(0)
    for _ in range(200):
        add(replay, rng.random(), int(rng.integers(2)))
        held = sorted(slot for slots in replay.cells.values() for slot in slots)
        assert held == np.flatnonzero(replay.drawn).tolist()
        assert all(len(slots) <= 2 for slots in replay.cells.values())
        assert all(replay.cell(k) == cell for cell, slots in replay.cells.items() for k in slots)


def test_the_table_pairs_by_seed_and_counts_what_is_drawn(tmp_path):
    for env, arm, seed in product(forgetting.BINS, forgetting.ARMS, (3, 20)):
        value = -150.0 + (arm == "told") * (5.0 + seed) - seed
        content = f'{{"value": {value}, "drawn": {1000 + seed}}}'
        (tmp_path / f"{env}-{arm}-{seed}.json").write_text(content, encoding="utf-8")
    *_, local, told = forgetting.table(tmp_path)
    lead = "+16.5 [+8.0, +25.0]"
    assert told == f"| told{2 * f' | -145.0 | {lead} |  | 1,012'} |"
    assert local == f"| local-80{2 * f' | -161.5 | +0.0 [+0.0, +0.0] | {lead} | 1,012'} |"


@pytest.mark.parametrize("arm", forgetting.ARMS)
def test_every_arm_runs(arm):
    schedule = [{"episode": 2, "force": -1.0}]
    short = dict(episodes=4, schedule=schedule, learning_starts=64)
    measured = forgetting.measure("mountaincar", arm, 0, **short)
    assert measured["value"] == -200.0 and 0 < measured["drawn"] <= 800

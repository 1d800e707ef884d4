"""A checkpoint restores its agent to the bit; anything else is refused and changes nothing."""

import json
import os
import zipfile
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from helpers import SMALL, Crash, drifts_at, exact_state

from gbdqn_ref import UsageError, checkpoint, files
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.train import Config, make_agent, run

DRIFTING = SMALL | dict(episodes=10, schedule=drifts_at(3, 5, 8))
FROZEN = dict(target="frozen", alpha="closed-form", loss_on="h")
CONFIGS = [
    Config(agent="dqn", **DRIFTING),
    Config(agent="dqn", replay="uniform", behaviour="softmax", **DRIFTING),
    Config(agent="gbdqn", **DRIFTING),
    Config(agent="gbdqn", replay="proportional", **FROZEN, **DRIFTING),
    Config(agent="gbdqn", alpha=1, **DRIFTING),  # an int, but freezing makes it a float
]
every_config = pytest.mark.parametrize(
    "config", CONFIGS, ids=lambda c: f"{c.agent}-{c.replay}-{c.target}-{c.alpha}"
)


@pytest.fixture
def saved(tmp_path):
    """A checkpoint after 6 episodes, with two drifts behind it: (its path, the agent)."""
    agent = make_agent(CONFIGS[2])
    for record in run(CONFIGS[2], agent):
        if record["episode"] == 5:
            break
    checkpoint.save(tmp_path / "checkpoint.npz", agent, 6)
    return tmp_path / "checkpoint.npz", agent


def assert_not_loaded(path, config=CONFIGS[2], match="."):
    """load() raises a one-line UsageError that names the file, and does not change the agent."""
    agent = make_agent(config)
    before = exact_state(agent)
    with pytest.raises(UsageError, match=match) as caught:
        checkpoint.load(path, agent)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    assert exact_state(agent) == before


@every_config
def test_a_restored_agent_is_identical_and_continues_identically(tmp_path, config):
    original, states, records = make_agent(config), {}, []
    for record in run(config, original):
        records.append(repr(record))
        # before learning; before, at and after a drift; at the end
        if record["episode"] in (0, 2, 3, 6, 9):
            checkpoint.save(tmp_path / str(len(records)), original, len(records))
            states[len(records)] = exact_state(original)
    for episodes, state in states.items():
        again = make_agent(config)
        assert checkpoint.load(tmp_path / str(episodes), again) == episodes
        assert exact_state(again) == state
        assert [repr(record) for record in run(config, again, episodes)] == records[episodes:]
        assert exact_state(again) == exact_state(original)


@every_config
def test_a_run_that_was_over_and_is_given_more_episodes_is_one_that_never_stopped(tmp_path, config):
    """If finish() changes the agent, it returns a copy, so that training can continue."""
    straight, stopped = make_agent(config), make_agent(config)
    records = [repr(record) for record in run(config, straight)]
    list(run(replace(config, episodes=6), stopped))
    checkpoint.save(tmp_path / "stopped", stopped, 6)
    again = make_agent(config)
    for agent in (stopped, again):
        if agent is again:
            checkpoint.load(tmp_path / "stopped", again)
        assert [repr(record) for record in run(config, agent, 6)] == records[6:]
        assert exact_state(agent) == exact_state(straight)
    assert exact_state(again.finish()) == exact_state(straight.finish())


@every_config
def test_the_same_agent_is_saved_as_the_same_bytes(tmp_path, config):
    agents = [make_agent(config), make_agent(config)]
    for i, agent in enumerate(agents):
        list(run(config, agent))
        checkpoint.save(tmp_path / str(i), agent, 10)
    again = make_agent(config)
    checkpoint.load(tmp_path / "0", again)
    checkpoint.save(tmp_path / "2", again, 10)
    assert len({(tmp_path / name).read_bytes() for name in "012"}) == 1


def test_the_state_holds_everything_an_agent_learns_with(saved):
    parts = {
        "": "theta theta_target steps alpha rng q_frozen q_frozen_next",
        "adam.": "m v t",
        "ensemble.": "theta alpha",
        "replay.": "s a r s2 terminated added max_priority tree.levels.0",
    }
    names = {f"{part}{name}" for part, held in parts.items() for name in held.split()}
    assert names <= set(checkpoint.state(saved[1]))


def test_a_loaded_agent_shares_no_memory_with_the_original(saved):
    path, original = saved
    before = exact_state(original)
    again = make_agent(CONFIGS[2])
    checkpoint.load(path, again)
    list(run(CONFIGS[2], again, 6))
    assert exact_state(original) == before


def test_a_checkpoint_contains_no_pickle(saved):
    with np.load(saved[0], allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)


# --- damaged and foreign files --------------------------------------------------------------------


class Bomb:
    """Unpickling one makes a folder."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return os.mkdir, (self.path,)


@pytest.mark.parametrize("kept", [0.0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(saved, kept):
    path, _ = saved
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * kept)])
    assert_not_loaded(path, match="damaged")


@pytest.mark.parametrize(
    "content", [b"hello\n", b"\x00" * 5000, b"PK\x03\x04", b"\x80\x04N.", b"\x93NUMPY\x01\x00"]
)
def test_a_file_of_another_kind_is_refused(saved, content):
    saved[0].write_bytes(content)
    assert_not_loaded(saved[0], match="damaged or not a checkpoint")


def test_a_single_array_is_refused(saved):
    with open(saved[0], "wb") as file:
        np.save(file, np.zeros(3))
    assert_not_loaded(saved[0], match="damaged or not a checkpoint")


@pytest.mark.parametrize(
    "arrays",
    [
        {"x": np.zeros(3)},
        {"header": np.zeros(3)},
        {"header": np.array(3.0)},
        {"header": np.array("not JSON")},
        {"header": np.array("[]")},
        {"header": np.array("{}")},
    ],
    ids=lambda arrays: repr(arrays)[:40],
)
def test_an_archive_of_other_arrays_is_refused(saved, arrays):
    np.savez(saved[0], **arrays)
    assert_not_loaded(saved[0], match="damaged or not a checkpoint")


def test_a_pickle_in_a_checkpoint_is_refused_and_not_run(saved):
    path, agent = saved
    header = json.dumps({"format": 1, "episodes": 6, "config": agent.config.to_dict()})
    bomb = np.array([Bomb(path.parent / "exploded")], object)
    np.savez(path, header=np.array(header), **checkpoint.state(agent) | {"theta": bomb})
    assert_not_loaded(path)
    path.write_bytes(bomb.dumps())
    assert_not_loaded(path)
    assert not (path.parent / "exploded").exists()  # catches allow_pickle=True


def test_a_folder_in_place_of_a_file_is_refused(tmp_path):
    with pytest.raises((UsageError, OSError)):
        checkpoint.load(tmp_path, make_agent(CONFIGS[2]))


def rewritten(path, header=None, drop=(), **arrays):
    """The checkpoint at path with another header or other arrays."""
    with np.load(path, allow_pickle=False) as file:
        old = dict(file)
    old_header = json.loads(old.pop("header").item())
    new = {name: array for name, array in old.items() if name not in drop} | arrays
    np.savez(path, header=np.array(json.dumps(old_header | (header or {}))), **new)


def test_a_rewritten_checkpoint_still_loads(saved):
    rewritten(saved[0])
    assert checkpoint.load(saved[0], make_agent(CONFIGS[2])) == 6


def test_another_format_version_is_refused(saved):
    rewritten(saved[0], {"format": 99})
    assert_not_loaded(saved[0], match="99")


@pytest.mark.parametrize(
    "other", [dict(seed=1), dict(lr=0.5), dict(agent="dqn"), dict(hidden=(5, 5))], ids=repr
)
def test_a_checkpoint_with_other_settings_is_refused(saved, other):
    config = Config.from_dict(CONFIGS[2].to_dict() | other)
    assert_not_loaded(saved[0], config, match="other settings")


def test_the_checkpoint_of_another_class_is_refused(saved, monkeypatch):
    """A class with the same attributes is still another algorithm."""
    path, agent = saved
    other = type("Other", (type(agent),), {})
    monkeypatch.setitem(AGENTS, "gbdqn", AGENTS["gbdqn"]._replace(make=other))
    assert_not_loaded(path, match="other settings")


def test_a_checkpoint_from_before_the_class_was_recorded_is_loaded(saved):
    path, agent = saved
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    header = json.loads(arrays.pop("header").item())
    del header["agent"]
    np.savez(path, header=np.array(json.dumps(header)), **arrays)
    again = make_agent(CONFIGS[2])
    assert checkpoint.load(path, again) == 6
    assert exact_state(again) == exact_state(agent)


@pytest.mark.parametrize(
    "header",
    [
        {"episodes": "6"},
        {"episodes": 6.0},
        {"episodes": None},
        {"episodes": -1},
        {"episodes": 11},
        {"format": "1"},
        {"config": None},
        {"config": []},
        {"config": {"hidden": {}}},
    ],
    ids=repr,
)
def test_an_invalid_header_is_refused(saved, header):
    rewritten(saved[0], header)
    assert_not_loaded(saved[0], match="damaged or not a checkpoint")


@pytest.mark.parametrize("text", ["many", "[]", "{}", '{"bit_generator": "PCG64"}', "state"])
def test_an_invalid_generator_state_is_refused(saved, text):
    if text == "state":  # a number that no generator can hold
        state = json.loads(checkpoint.state(saved[1])["rng"].item())
        state["state"]["state"] = -1
        text = json.dumps(state)
    rewritten(saved[0], rng=np.array(text))
    assert_not_loaded(saved[0], match="damaged or not a checkpoint")


@pytest.mark.parametrize(
    ("drop", "arrays"),
    [
        (["theta"], {}),
        (["replay.tree.levels.0"], {}),
        ([], {"new": np.zeros(1)}),
        ([], {"theta": np.zeros(3, np.float32)}),
        ([], {"theta": np.zeros(58, np.float64)}),
        ([], {"steps": np.array(7.0)}),
        ([], {"replay.s": np.zeros((9, 4), np.float32)}),
        ([], {"ensemble.theta": np.zeros((2, 3), np.float32)}),
    ],
    ids=lambda part: str(list(part)),
)
def test_arrays_that_do_not_fit_are_refused(saved, drop, arrays):
    rewritten(saved[0], None, drop, **arrays)
    assert_not_loaded(saved[0], match="does not fit")


def spots(data):
    """(byte, bit): some at random, and all that no checksum covers.

    These are the last directory entry of the archive and its end record.
    """
    rng = np.random.default_rng(0)
    anywhere = rng.integers([len(data), 8], size=(150, 2)).tolist()
    return [*anywhere, *product(range(data.rindex(b"PK\1\2"), len(data)), range(8))]


def test_a_flipped_bit_is_refused_or_harmless(saved):
    path, original = saved
    data, agent, refusals, wrong = path.read_bytes(), make_agent(CONFIGS[2]), 0, []
    expected, fresh = exact_state(original), exact_state(agent)
    for byte, bit in spots(data):
        damaged = bytearray(data)
        damaged[byte] ^= 1 << bit
        path.write_bytes(damaged)
        try:
            checkpoint.load(path, agent)
        except UsageError as e:
            refusals += 1
            if "\n" in str(e) or exact_state(agent) != fresh:
                wrong.append((byte, bit, "half restored"))
        except Exception as e:
            wrong.append((byte, bit, repr(e)))
        else:
            if exact_state(agent) != expected:
                wrong.append((byte, bit, "not the same agent"))
            agent = make_agent(CONFIGS[2])
    assert refusals > 150 and not wrong, wrong[:5]


@pytest.mark.skipif(
    not os.path.exists("/proc/self/fd"), reason="counts the open files of this process"
)
def test_a_damaged_file_is_closed(saved):
    path, _ = saved
    path.write_bytes(path.read_bytes()[:-100])
    before, errors = len(os.listdir("/proc/self/fd")), []
    for _ in range(3):
        with pytest.raises(UsageError) as caught:
            checkpoint.load(path, make_agent(CONFIGS[2]))
        errors.append(caught.value)  # its traceback would keep alive what load() left open
    assert len(os.listdir("/proc/self/fd")) == before


# --- writing --------------------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_an_incomplete_save_leaves_the_previous_checkpoint(saved, monkeypatch, call):
    path, agent = saved
    old = path.read_bytes()
    list(run(CONFIGS[2], agent, 6))

    def stop(*_):
        raise Crash

    monkeypatch.setattr(files.os, call, stop)
    with pytest.raises(Crash):
        checkpoint.save(path, agent, 10)
    monkeypatch.undo()
    assert path.read_bytes() == old and checkpoint.load(path, make_agent(CONFIGS[2])) == 6


def test_a_checkpoint_is_a_valid_zip_archive(saved):
    with zipfile.ZipFile(saved[0]) as archive:
        assert archive.testzip() is None

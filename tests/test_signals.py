"""A signal to any process of a command stops all of it, soon and quietly, and it can go on."""

import os
import signal
import subprocess
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest
from helpers import SMALL, command, contents, environ, flags

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads Linux's /proc")

START = ["--env", "cartpole", "--set", "schedule=[{'episode': 9, 'length': 2}]".replace("'", '"')]
COMMANDS = {
    "train": ["train", "--agent", "dqn", *START],
    "compare": ["compare", "--agents", "dqn,reset", *START],
    "study": ["study", "--agents", "dqn", "--seeds", "3", *START],
    "drift-effect": ["drift-effect", *START],
}
WITH_WORKERS = [name for name in COMMANDS if name != "train"]
SIGNALS = [signal.SIGINT, signal.SIGTERM]
ENDLESS = flags(**SMALL | dict(episodes=1_000_000))
SHORT = flags(**SMALL | dict(episodes=60))


def started(name, out, *settings):
    """The command at work in a folder, in a process group of its own."""
    return subprocess.Popen(
        command(*COMMANDS[name], *settings, "--out", out),
        env=environ(),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def start():
    """started(), for processes that do not outlive the test."""
    processes = []

    def begin(*arguments):
        processes.append(started(*arguments))
        return processes[-1]

    yield begin
    for process in processes:
        with process, suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@pytest.fixture(scope="module")
def left_alone(tmp_path_factory):
    """What a short command writes that no signal disturbs."""

    @cache
    def files(name):
        out = tmp_path_factory.mktemp(name) / "out"
        with started(name, out, *SHORT) as process:
            assert (process.wait(), process.stderr.read()) == (0, "")
        return contents(out)

    return files


def children(pid):
    """The ids of the processes that a process has started, in the order of their age."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state, parent = (path / "stat").read_text().rpartition(")")[2].split()[:2]
            if (
                int(parent) == pid
                and state != "Z"
                and b"tracker" not in (path / "cmdline").read_bytes()
            ):
                found.append(int(path.name))
    return sorted(found)


def wait_for(condition):
    latest = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < latest, "it takes too long"
        time.sleep(0.01)


def begun(out, episodes=3):
    """The folders below in which a run has seen some episodes."""
    files = [*out.glob("episodes.csv"), *out.glob("*/episodes.csv")]
    return [path.parent for path in files if path.read_bytes().count(b"\n") > episodes]


def stop(process, target, number):
    """Send the signal to a process of the command; its status and stderr within two seconds."""
    workers = children(process.pid)
    os.kill(process.pid if target == "parent" else workers[0], number)
    sent = time.monotonic()
    _, stderr = process.communicate(timeout=10)
    assert time.monotonic() - sent < 2
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()], "a worker goes on"
    return process.returncode, stderr


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(
    ("name", "target"),
    [(name, "parent") for name in COMMANDS] + [(name, "worker") for name in WITH_WORKERS],
)
def test_a_signal_stops_every_process_with_one_line(tmp_path, start, name, target, number):
    process = start(name, tmp_path / "out", *ENDLESS)
    wait_for(lambda: begun(tmp_path / "out"))
    status, stderr = stop(process, target, number)
    assert status == 130
    assert stderr.startswith("gbdqn_ref: stopped. To continue: ") and stderr.count("\n") == 1
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_was_stopped_goes_on_to_the_same_bytes(tmp_path, start, left_alone, name):
    process = start(name, tmp_path / "stopped", *SHORT)
    wait_for(lambda: begun(tmp_path / "stopped"))
    assert stop(process, "parent", signal.SIGINT)[0] == 130
    more = ["--resume"] if name == "train" else []
    assert start(name, tmp_path / "stopped", *SHORT, *more).communicate()[1] == ""
    assert contents(tmp_path / "stopped") == left_alone(name)


def test_ctrl_c_which_every_process_hears_leaves_one_line(tmp_path, start):
    process = start("study", tmp_path / "out", *ENDLESS)
    wait_for(lambda: len(begun(tmp_path / "out")) == 2)
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=2)
    assert process.returncode == 130 and stderr.count("\n") == 1


def test_a_signal_in_the_first_moment_leaves_no_traceback(tmp_path, start):
    process = start("study", tmp_path / "out", *ENDLESS)
    wait_for(lambda: len(children(process.pid)) == 2)  # which are still importing
    time.sleep(0.1)  # the second has been told what to train
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=2)
    assert process.returncode == 130 and stderr.count("\n") == 1


@pytest.mark.parametrize("name", WITH_WORKERS)
def test_a_killed_worker_costs_one_retry(tmp_path, start, left_alone, name):
    process = start(name, tmp_path / "killed", *SHORT)
    wait_for(lambda: begun(tmp_path / "killed"))
    os.kill(children(process.pid)[0], signal.SIGKILL)
    assert process.communicate(timeout=60)[1] == "" and process.returncode == 0
    assert contents(tmp_path / "killed") == left_alone(name)


def test_a_run_whose_worker_is_killed_twice_fails(tmp_path, start):
    one = ["--agents", "dqn", "--jobs", "1", "--set", "episodes=1000000"]
    process = start("compare", tmp_path / "out", *SHORT, *one)
    wait_for(lambda: begun(tmp_path / "out"))
    first = children(process.pid)
    os.kill(first[0], signal.SIGKILL)
    wait_for(lambda: children(process.pid) not in (first, []))
    os.kill(children(process.pid)[0], signal.SIGKILL)
    _, stderr = process.communicate(timeout=10)
    assert process.returncode == 1
    assert stderr == "gbdqn_ref: dqn failed: its process ended with status -9\n"


def test_workers_end_with_a_parent_that_is_killed(tmp_path, start):
    process = start("study", tmp_path / "out", *ENDLESS)
    wait_for(lambda: len(begun(tmp_path / "out")) == 2)
    workers = children(process.pid)
    process.kill()
    process.wait()
    wait_for(lambda: not [pid for pid in workers if Path(f"/proc/{pid}").exists()])

"""A signal to any process of a command stops all its processes, and the command can continue."""

import os
import signal
import subprocess
import time
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

import pytest
from helpers import PATIENCE, SMALL, command, contents, environ, flags, wait_for

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads Linux's /proc")

START = ["--env", "cartpole", "--set", "schedule=[{'episode': 9, 'length': 2}]".replace("'", '"')]
COMMANDS = {
    "train": ["train", "--agent", "dqn", *START],
    "compare": ["compare", "--agents", "dqn,reset", *START],
    "study": ["study", "--agents", "dqn", "--seeds", "3", *START],
    "drift-effect": ["drift-effect", *START],
}
WITH_WORKERS = [name for name in COMMANDS if name != "train"]
INT, TERM = signal.SIGINT, signal.SIGTERM
TARGETS = [  # main() handles signals for every command; one of each kind hears both
    ("train", "parent", INT),
    ("train", "parent", TERM),
    ("study", "parent", INT),
    ("study", "parent", TERM),
    ("study", "worker", INT),
    ("study", "worker", TERM),
    ("compare", "parent", TERM),
    ("compare", "worker", INT),
    ("drift-effect", "parent", INT),
    ("drift-effect", "worker", TERM),
]
ENDLESS = flags(**SMALL | dict(episodes=1_000_000))
SHORT = flags(**SMALL | dict(episodes=60))


def started(name, out, *settings):
    """Start the command in its own process group.

    A signal between a file's open() and its `with` leaves the file to Python, which closes it and
    then warns of it, unless told otherwise as it is for users.
    """
    start = "-W", "ignore::ResourceWarning", "-m", "gbdqn_ref"
    return subprocess.Popen(
        command(*COMMANDS[name], *settings, "--out", out, start=start),
        env=environ(),
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def start():
    """started(), but no process outlives the test."""
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
    """The files of a short command without any signal."""

    @cache
    def files(name):
        out = tmp_path_factory.mktemp(name) / "out"
        with started(name, out, *SHORT) as process:
            assert (process.wait(), process.stderr.read()) == (0, "")
        return contents(out)

    return files


def children(pid):
    """The ids of the processes that a process has started, in ascending order."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state, parent = (path / "stat").read_text().rpartition(")")[2].split()[:2]
            if int(parent) == pid and state != "Z":
                found.append(int(path.name))
    return sorted(found)


def exist(pids):
    """Those of the processes that have not ended."""
    return [pid for pid in pids if Path(f"/proc/{pid}").exists()]


def begun(out, episodes=3):
    """The folders in which a run has finished more than some episodes."""
    files = [*out.glob("episodes.csv"), *out.glob("*/episodes.csv")]
    return [path.parent for path in files if path.read_bytes().count(b"\n") > episodes]


def stop(process, target, number):
    """Signal one process of the command; its exit status and stderr, within two seconds.

    On a machine with more ready processes than cores it may take longer in proportion.
    """
    workers = children(process.pid)
    os.kill(process.pid if target == "parent" else workers[0], number)
    sent = time.monotonic()
    _, stderr = process.communicate(timeout=PATIENCE)
    crowd = max(1, os.getloadavg()[0] / os.cpu_count())
    assert time.monotonic() - sent < 2 * crowd
    assert not exist(workers), "a worker continues"
    return process.returncode, stderr


@pytest.mark.parametrize(("name", "target", "number"), TARGETS)
def test_a_signal_stops_every_process_with_one_line(tmp_path, start, name, target, number):
    process = start(name, tmp_path / "out", *ENDLESS)
    wait_for(lambda: begun(tmp_path / "out"))
    status, stderr = stop(process, target, number)
    assert status == 130
    assert stderr.startswith("gbdqn_ref: stopped. To continue: ") and stderr.count("\n") == 1
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_was_stopped_goes_on_to_the_same_bytes(tmp_path, start, left_alone, name):
    for attempt in "12345":  # on a loaded machine the signal may come after the end
        out = tmp_path / attempt
        process = start(name, out, *SHORT)
        wait_for(partial(begun, out))
        status, _ = stop(process, "parent", signal.SIGINT)
        if status == 130:
            break
    assert status == 130
    more = ["--resume"] if name == "train" else []
    assert start(name, out, *SHORT, *more).communicate(timeout=PATIENCE)[1] == ""
    assert contents(out) == left_alone(name)


def test_ctrl_c_to_every_process_leaves_one_line(tmp_path, start):
    process = start("study", tmp_path / "out", *ENDLESS)
    wait_for(lambda: len(begun(tmp_path / "out")) == 2)
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130 and stderr.count("\n") == 1


def test_a_signal_during_startup_leaves_no_traceback(tmp_path, start):
    process = start("study", tmp_path / "out", *ENDLESS)
    wait_for(lambda: len(children(process.pid)) == 2)  # they are still importing
    time.sleep(0.1)  # the second one has been given its task
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130 and stderr.count("\n") == 1


@pytest.mark.parametrize("name", WITH_WORKERS)
def test_a_killed_worker_costs_one_retry(tmp_path, start, left_alone, name):
    process = start(name, tmp_path / "killed", *SHORT)
    wait_for(lambda: begun(tmp_path / "killed"))
    with suppress(IndexError, ProcessLookupError):  # all workers may have ended by now
        os.kill(children(process.pid)[0], signal.SIGKILL)
    assert process.communicate(timeout=PATIENCE)[1] == "" and process.returncode == 0
    assert contents(tmp_path / "killed") == left_alone(name)


def test_a_run_whose_worker_is_killed_twice_fails(tmp_path, start):
    one = ["--agents", "dqn", "--jobs", "1", "--set", "episodes=1000000"]
    process = start("compare", tmp_path / "out", *SHORT, *one)
    wait_for(lambda: begun(tmp_path / "out"))
    first = children(process.pid)
    os.kill(first[0], signal.SIGKILL)
    wait_for(lambda: children(process.pid) not in (first, []))
    os.kill(children(process.pid)[0], signal.SIGKILL)
    _, stderr = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert stderr == "gbdqn_ref: dqn failed: its process ended with status -9\n"


def test_workers_end_with_a_parent_that_is_killed(tmp_path, start):
    process = start("study", tmp_path / "out", *ENDLESS)
    wait_for(lambda: len(begun(tmp_path / "out")) == 2)
    workers = children(process.pid)
    process.kill()
    process.wait()
    wait_for(lambda: not exist(workers))

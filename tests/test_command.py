"""The command line under unusual streams, locales and environment variables."""

import os
import pty
import subprocess
import sys
import termios
from contextlib import suppress
from pathlib import Path

import pytest
from helpers import SMALL, cli, command, contents, environ, flags, refused

from gbdqn_ref import runs
from gbdqn_ref.config import Config

FEW = flags(**SMALL | dict(episodes=3, schedule=[{"episode": 1, "length": 2}]))
RUN = {"config.json", "episodes.csv", "checkpoint.npz", "summary.json", "curve.png"}
ASCII = dict(LC_ALL="C", PYTHONCOERCECLOCALE="0", PYTHONUTF8="0", PYTHONIOENCODING="")
HOPPER = ["--env", "hopper", *flags(**SMALL | dict(episodes=2))]
DIVERGES = flags(lr=1e30, update_every=1, learning_starts=10, hidden=[8], batch_size=8)


def names(folder):
    return {path.name for path in Path(folder).iterdir()}


# --- streams --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "encoding"), [("settings", "latin-1"), ("settings", "ascii"), ("train", "ascii")]
)
def test_characters_that_stdout_cannot_encode_are_replaced(tmp_path, name, encoding):
    more = [*FEW, "--out", tmp_path / "out"] if name == "train" else []
    result = subprocess.run(
        command(name, *more), env=environ(PYTHONIOENCODING=encoding), capture_output=True
    )
    assert (result.returncode, result.stderr) == (0, b"")
    assert b"?" in result.stdout.decode(encoding).encode()


def test_all_our_file_names_are_ascii(tmp_path):
    status, _, stderr = cli("drift-effect", *FEW, "--out", tmp_path / "out", **ASCII)
    assert (status, stderr) == (0, "")
    assert all(str(path.relative_to(tmp_path)).isascii() for path in tmp_path.rglob("*"))


def test_a_folder_whose_name_cannot_be_printed_works(tmp_path):
    more = ["--agents", "dqn", "--out", tmp_path / "résumé"]
    status, _, stderr = cli("compare", *FEW, *more, **ASCII)
    assert (status, stderr) == (0, "")
    assert names(tmp_path / "résumé" / "dqn") == RUN


def test_a_matplotlibrc_costs_no_line(tmp_path):
    (tmp_path / "matplotlibrc").write_text("nosuch: 1\n")
    status, _, stderr = cli("train", "--env", "x", cwd=tmp_path)
    assert status == 2 and stderr.count("\n") == 1


def through_a_closed_pipe(stream, *arguments, **variables):
    """Run a command whose stdout or stderr is a pipe that nobody reads."""
    reader, writer = os.pipe()
    os.close(reader)
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | {stream: writer}
    result = subprocess.run(command(*arguments), env=environ(**variables), text=True, **streams)
    os.close(writer)
    return result


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("name", ["train", "settings", "--help"])
def test_a_closed_stdout_pipe_is_no_error(tmp_path, name, unbuffered):
    more = [*FEW, "--out", tmp_path / "run"] if name == "train" else []
    result = through_a_closed_pipe("stdout", name, *more, PYTHONUNBUFFERED=unbuffered)
    assert (result.returncode, result.stderr) == (0, "")
    assert name != "train" or names(tmp_path / "run") == RUN


@pytest.mark.parametrize(("arguments", "status"), [(FEW, 0), (["--env", "x"], 2)])
def test_a_closed_stderr_pipe_is_no_error(tmp_path, arguments, status):
    result = through_a_closed_pipe("stderr", "train", *arguments, "--out", tmp_path / "run")
    assert result.returncode == status
    assert status or names(tmp_path / "run") == RUN


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_are_no_error(tmp_path, closed):
    line = " ".join(f"'{part}'" for part in command("train", *FEW, "--out", tmp_path / "run"))
    options = dict(shell=True, env=environ(), capture_output=True, text=True)
    result = subprocess.run(f"{line} {closed}", **options)
    assert (result.returncode, result.stderr) == (0, "")
    assert names(tmp_path / "run") == RUN
    assert "Traceback" not in result.stdout and "ep/s" not in result.stdout


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no full device")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_disk_behind_stdout_is_reported_in_one_line(tmp_path, unbuffered):
    with open("/dev/full", "w") as full:
        result = subprocess.run(
            command("train", *FEW, "--out", tmp_path / "run"),
            env=environ(PYTHONUNBUFFERED=unbuffered),
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert result.returncode == 2
    assert result.stderr == "gbdqn_ref: [Errno 28] No space left on device\n"
    assert names(tmp_path / "run") == RUN


def seen_on_a_terminal(*arguments):
    """What a command prints to stderr if that is a terminal."""
    terminal, end = pty.openpty()
    termios.tcsetwinsize(end, (24, 80))
    with subprocess.Popen(
        command(*arguments), env=environ(), stdout=subprocess.DEVNULL, stderr=end
    ) as process:
        os.close(end)
        seen = b""
        with suppress(OSError):  # so Linux says that all writers have closed it
            while part := os.read(terminal, 10_000):
                seen += part
        os.close(terminal)
    assert process.returncode == 0
    return seen.decode()


@pytest.mark.parametrize(("name", "episodes"), [("train", 3), ("compare", 6)])
def test_the_progress_bar_appears_on_a_terminal_but_not_in_a_log(tmp_path, name, episodes):
    seen = seen_on_a_terminal(name, *FEW, "--out", tmp_path / "seen")
    assert f" 0/{episodes} " in seen and f" {episodes}/{episodes} " in seen
    one = ["--agent" if name == "train" else "--agents", "random"]
    assert seen_on_a_terminal(name, *FEW, *one, "--out", tmp_path / "quiet", "--quiet") == ""
    status, _, stderr = cli(name, *FEW, *one, "--out", tmp_path / "logged")
    assert (status, stderr) == (0, "")


# --- environment variables ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["--help", "compare"])
def test_an_invalid_mplbackend_does_not_matter(tmp_path, name):
    more = [] if name == "--help" else ["--agents", "dqn", *FEW, "--out", tmp_path / "run"]
    status, stdout, stderr = cli(name, *more, MPLBACKEND="nonsense")
    assert (status, stderr) == (0, "") and stdout


@pytest.mark.parametrize("renderer", ["nonsense", "osmesa"])
def test_training_needs_no_renderer(tmp_path, renderer):
    more = ["--agent", "random", "--out", tmp_path / "run"]
    status, _, stderr = cli("train", *HOPPER, *more, MUJOCO_GL=renderer)
    assert (status, stderr) == (0, "")


def test_a_film_without_a_renderer_is_refused_in_one_line(tmp_path):
    settings = SMALL | dict(episodes=2, schedule=[{"episode": 1, "mass": 1.3}])
    runs.train(Config(env="hopper", agent="random", **settings), tmp_path / "run", quiet=True)
    before = contents(tmp_path)
    film = tmp_path / "films" / "x.gif"
    status, stdout, stderr = cli("watch", tmp_path / "run", "--out", film, MUJOCO_GL="nonsense")
    assert (status, stdout, stderr.count("\n")) == (2, "", 1) and "MUJOCO_GL" in stderr
    assert contents(tmp_path) == before


# --- errors that are not the user's ---------------------------------------------------------------


def test_too_little_memory_is_reported_in_one_line(tmp_path, monkeypatch, capsys):
    def train(*args, **options):
        raise MemoryError("Unable to allocate 12.0 GiB")

    monkeypatch.setattr(runs, "train", train)
    refused(capsys, tmp_path, ["train", "--out", str(tmp_path / "run")], "12.0 GiB")


def test_divergence_is_reported_in_one_line_with_exit_status_3(tmp_path):
    more = ["--agent", "dqn", "--out", tmp_path / "run", "--quiet"]
    status, stdout, stderr = cli("train", *DIVERGES, *more)
    assert (status, stdout, stderr.count("\n")) == (3, "", 1)
    assert stderr.startswith("gbdqn_ref: training diverged in episode ")
    assert names(tmp_path / "run") == {"config.json", "episodes.csv"}


def test_divergence_as_a_run_ends_is_reported_likewise(tmp_path):
    """The last booster is added after the last episode, and its α may be too large."""
    values = dict(target="frozen", alpha="closed-form", lr=1e-43, episodes=8, learning_starts=20)
    values |= dict(hidden=[8], capacity=100, batch_size=8, update_every=1, gradient_steps=1)
    values |= dict(schedule=[{"episode": 3, "length": 2}])
    status, _, stderr = cli("train", *flags(**values), "--quiet", "--out", tmp_path / "run")
    assert status == 3 and stderr.count("\n") == 1
    assert stderr.startswith("gbdqn_ref: training diverged at its end: float32 cannot hold")


def test_a_run_that_diverges_fails_and_the_others_finish(tmp_path):
    more = ["--agents", "dqn,random", "--set", "episodes=3", "--out", tmp_path / "both"]
    status, _, stderr = cli("compare", *DIVERGES, *more)
    assert (status, stderr.count("\n")) == (1, 1)
    assert "dqn failed: DivergenceError: training diverged in episode " in stderr
    assert names(tmp_path / "both" / "random") == RUN
    assert not (tmp_path / "both" / "results.json").exists()


# --- a script that has no "if __name__" -----------------------------------------------------------

SCRIPT = """
from gbdqn_ref.__main__ import main
from gbdqn_ref.config import SETTINGS, Config
from gbdqn_ref.study import grid, run_study

base = Config(agent="random", episodes=2)
print(run_study(grid({"random": base}, range(2)), "study", jobs=2))
"""


def test_a_script_can_call_run_study_without_a_main_guard(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    result = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=environ(), capture_output=True, text=True
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "{}\n", "")
    assert {"random-0", "random-1", "results.json"} <= names(tmp_path / "study")

"""Wrong uses of the command line: each gets one line that names the mistake; nothing changes."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from helpers import SMALL, cli, command, contents, environ, flags, refused

from gbdqn_ref import files, runs
from gbdqn_ref.__main__ import main
from gbdqn_ref.config import Config

SMALL_RUN = flags(**SMALL | dict(episodes=6))


def settings(pair):
    """--set with a pair as it is typed."""
    return ["--set", pair]


def schedule(*entries):
    """--set schedule=… of these entries."""
    return flags(schedule=entries)


COMMANDS = {
    "no command": ([], "command"),
    "an unknown command": (["learn"], "'train', 'compare'"),
    "an unknown option": (["train", "--episodes", "5"], "--episodes"),
    "a stray word": (["train", "cartpole"], "cartpole"),
    "an option without its value": (["train", "--env"], "--env"),
    "an unknown environment": (
        ["train", "--env", "Hopper-v5"],
        "cartpole, mountaincar, acrobot, hopper",
    ),
    "an unknown agent": (["train", "--agent", "ppo"], "gbdqn, dqn"),
    "an empty agent": (["train", "--agent", ""], "gbdqn, dqn"),
    "an unknown preset": (["train", "--preset", "slow"], "paper, fast"),
    "a preset beside another one": (
        ["train", "--env", "acrobot-hard", "--preset", "fast"],
        "names the preset hard, so it cannot be 'fast'",
    ),
    "an empty environment": (["train", "--env", ""], "--env: must not be empty"),
    "an empty preset": (["compare", "--preset", ""], "--preset: must not be empty"),
    "an empty folder": (["drift-effect", "--out", ""], "--out: must not be empty"),
    "an empty address": (["study", "--dask", ""], "--dask: must not be empty"),
    "an empty run": (["watch", ""], "RUN: must not be empty"),
    "a film as a video": (["watch", "run", "--out", "film.mp4"], ".gif"),
    "maps as a document": (["maps", "run", "--out", "maps.pdf"], ".png"),
    "a film of no run": (["watch", "nowhere", "--out", "new/film.gif"], "no run in nowhere"),
    "maps of no run": (["maps", "nowhere", "--out", "new/maps.png"], "no run in nowhere"),
    "no processes in a comparison": (["compare", "--jobs", "0"], "jobs must be"),
    "settings of an unknown environment": (["settings", "--env", "x"], "unknown environment"),
    "settings of an unknown preset": (["settings", "--preset", "long"], "has no preset 'long'"),
    "a word for a seed": (["train", "--seed", "x"], "--seed"),
    "a fractional seed": (["train", "--seed", "1.5"], "--seed"),
    "a negative seed": (
        ["train", "--seed", "-1"],
        "seed must be a whole number from 0 to 4,294,967,295",
    ),
    "an unknown agent in a comparison": (["compare", "--agents", "gbdqn,ppo"], "'ppo'"),
    "no agent in a comparison": (["compare", "--agents", ""], "one of gbdqn, dqn"),
    "an empty agent in a comparison": (["compare", "--agents", "gbdqn,,dqn"], "one of gbdqn, dqn"),
    "an agent twice in a comparison": (["compare", "--agents", "dqn,dqn"], "twice"),
    "a comparison to be resumed": (["compare", "--resume"], "--resume"),
    "resuming without a folder": (["train", "--resume"], "--out"),
}
SETTINGS = {
    "a setting without a value": (settings("episodes"), "KEY=VALUE"),
    "a setting without a name": (settings("=3"), "no setting ''"),
    "a misspelt setting": (settings("epsiodes=3"), "did you mean 'episodes'"),
    "an unknown setting": (settings("xyzzy=3"), "no setting 'xyzzy'"),
    "the environment as a setting": (settings("env=acrobot"), "--env"),
    "the agent as a setting": (settings("agent=dqn"), "--agent"),
    "the seed as a setting": (settings("seed=3"), "--seed"),
    "a setting named like an argument of ours": (settings("name=paper"), "no setting 'name'"),
    "no episodes": (settings("episodes=0"), "episodes must be"),
    "negative episodes": (settings("episodes=-1"), "episodes must be"),
    "a fractional number of episodes": (
        settings("episodes=1.5"),
        "episodes must be a whole number",
    ),
    "nan for episodes": (settings("episodes=nan"), "episodes must be a whole number"),
    "NaN for episodes": (settings("episodes=NaN"), "episodes must be a whole number"),
    "nothing for episodes": (settings("episodes="), "episodes must be a whole number"),
    "a step size of 0": (settings("lr=0"), "lr must be a positive"),
    "an infinite step size": (settings("lr=Infinity"), "lr must be a positive"),
    "a word for a step size": (settings("lr=abc"), "lr must be a positive finite number"),
    "a step size too large for a float": (settings("lr=" + "9" * 400), "lr must be"),
    "more digits than Python reads": (settings("episodes=" + "9" * 5000), "episodes must be"),
    "endless brackets": (settings("hidden=" + "[" * 100_000), "hidden"),
    "brackets in brackets": (settings("hidden=" + "[" * 700 + "]" * 700), "hidden"),
    "a discount of 1": (settings("gamma=1"), "gamma must be a number in [0, 1)"),
    "a layer of width 0": (settings("hidden=[0]"), "hidden must be a list of widths"),
    "a width instead of a list": (settings("hidden=128"), "hidden must be a list"),
    "no capacity": (settings("capacity=0"), "capacity must be"),
    "a huge capacity": (settings("capacity=1e20"), "capacity must be"),
    "a huge whole capacity": (settings("capacity=100000000000000000000"), "10,000,000"),
    "an empty batch": (settings("batch_size=0"), "batch_size must be"),
    "a negative alpha": (settings("alpha=-1"), '"closed-form"'),
    "a part of closed-form": (settings("alpha=closed"), '"closed-form"'),
    "an unknown target": (settings("target=half"), "live, frozen"),
    "an unknown replay": (settings("replay=none"), "uniform, proportional, recency"),
    "Python's None": (settings("normalise=None"), "null"),
    "yes for true": (settings("zero_output=yes"), "true or false"),
    "a word for a schedule": (settings("schedule=gravity"), "schedule must be a list"),
    "an entry instead of a schedule": (
        settings('schedule={"episode": 3, "gravity": 2}'),
        "schedule must be a list",
    ),
    "a schedule with a missing bracket": (
        settings('schedule=[{"episode": 3, "gravity": 2}'),
        "schedule must be a list",
    ),
    "an unknown factor": (
        schedule({"episode": 3, "wind": 2}),
        "gravity, cart_mass, pole_mass, length, force",
    ),
    "decreasing episodes": (
        schedule({"episode": 3, "force": 2}, {"episode": 2, "force": 3}),
        "must increase",
    ),
    "an entry without an episode": (schedule({"gravity": 2}), "'episode'"),
    "a factor of 0": (
        schedule({"episode": 3, "gravity": 0}),
        "'gravity' must be a number from 0.01",
    ),
    "a factor and a reset": (schedule({"episode": 3, "gravity": 2, "reset": True}), "'reset'"),
    "neither a factor nor a reset": (schedule({"episode": 3}), "'reset'"),
}


@pytest.mark.parametrize(("arguments", "keyword"), COMMANDS.values(), ids=COMMANDS)
def test_a_wrong_command_is_refused(tmp_path, monkeypatch, capsys, arguments, keyword):
    monkeypatch.chdir(tmp_path)
    refused(capsys, tmp_path, arguments, keyword)


@pytest.mark.parametrize("command", ["train", "compare"])
@pytest.mark.parametrize(("arguments", "keyword"), SETTINGS.values(), ids=SETTINGS)
def test_a_wrong_setting_is_refused(tmp_path, capsys, command, arguments, keyword):
    refused(capsys, tmp_path, [command, "--out", str(tmp_path / "run"), *arguments], keyword)


@pytest.mark.parametrize("text", [".5", "+0.5", "5e-1", "0.5", " 0.5", "1.", "+1", " 1"])
def test_a_number_can_be_written_in_any_usual_form(tmp_path, text):
    arguments = ["--agent", "random", "--set", "episodes=1", "--set", f"lr={text}", "--quiet"]
    assert main(["train", *arguments, "--out", str(tmp_path / "run")]) == 0
    assert runs.read_config(tmp_path / "run").lr == float(text)


# --- folders --------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["train", "compare"])
@pytest.mark.parametrize("place", ["file", "file/below", "file/far/below"])
def test_a_file_in_place_of_a_folder_is_refused(tmp_path, capsys, command, place):
    (tmp_path / "file").write_text("mine")
    arguments = [command, "--out", str(tmp_path / place), *SMALL_RUN]
    refused(capsys, tmp_path, arguments, "ot a folder|ot a directory")


def test_a_folder_that_is_not_empty_is_refused(tmp_path, capsys):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    refused(capsys, tmp_path, ["train", "--out", str(tmp_path / "full"), *SMALL_RUN], "not empty")


def test_compare_refuses_a_folder_of_other_files(tmp_path, capsys):
    (tmp_path / "both" / "gbdqn").mkdir(parents=True)
    (tmp_path / "both" / "gbdqn" / "thesis.txt").write_text("mine")
    refused(capsys, tmp_path, ["compare", "--out", str(tmp_path / "both"), *SMALL_RUN], "not empty")


@pytest.mark.parametrize("place", ["nowhere", "empty", "file", "two\nlines"])
def test_resuming_without_a_run_is_refused(tmp_path, capsys, place):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("mine")
    arguments = ["train", "--resume", "--out", str(tmp_path / place)]
    refused(capsys, tmp_path, arguments, "there is no run in")


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A small complete run."""
    folder = tmp_path_factory.mktemp("complete")
    assert main(["train", "--agent", "dqn", "--out", str(folder), "--quiet", *SMALL_RUN]) == 0
    return folder


@pytest.fixture
def run(complete, tmp_path):
    """The same run, as if killed right after its last checkpoint."""
    folder = Path(shutil.copytree(complete, tmp_path / "run"))
    for name in ("summary.json", "curve.png"):
        (folder / name).unlink()
    return folder


def resume(run, capsys, keyword):
    refused(capsys, run.parent, ["train", "--resume", "--out", str(run), "--quiet"], keyword)


def test_the_run_of_these_tests_can_be_resumed(complete, run, capsys):
    assert main(["train", "--resume", "--out", str(run), "--quiet"]) == 0
    assert contents(run) == contents(complete)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"null",
        b"[]",
        b"5",
        b"{}",
        b'{"config": []}',
        b'{"config": 5}',
        b'{"config": "dqn"}',
        b'{"config": {}}',
        b'{"config": {"env": "cartpole", "agent": "dqn", "seed": 0}}',
        b'{"config": {"env": "cartpole", "agent": null, "seed": 0, "episodes": 6}}',
        b"[" * 100_000,
    ],
    ids=lambda content: repr(content)[:40],
)
def test_a_damaged_config_is_refused(run, complete, tmp_path, capsys, content):
    """Even if the run is complete; it must not pass for a run with default settings."""
    (run / "config.json").write_bytes(content)
    resume(run, capsys, "config.json")
    (run / "summary.json").write_bytes((complete / "summary.json").read_bytes())
    resume(run, capsys, "config.json")
    refused(capsys, run, ["watch", str(run), "--out", str(run / "film.gif")], "config.json")
    refused(capsys, run, ["maps", str(run), "--out", str(run / "maps.png")], "config.json")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("own", []),
        ("own", {"xyzzy": 1}),
        ("own", {"replay": 1}),
        ("versions", "1.0"),
        ("versions", None),
        ("code", ["nn"]),
        ("continued", {}),
        ("continued", [5]),
        ("continued", [{}]),
        ("continued", [{"versions": {}, "code": 1}]),
    ],
)
def test_a_record_of_the_wrong_shape_is_refused(run, capsys, name, value):
    content = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps(content | {name: value}))
    resume(run, capsys, "config.json is damaged")


@pytest.mark.parametrize("name", ["env", "agent", "seed", "episodes"])
def test_the_config_of_another_run_is_refused(complete, tmp_path, capsys, name):
    """config.json and summary.json must belong to one run."""
    folder = Path(shutil.copytree(complete, tmp_path / "run"))
    content = json.loads((folder / "config.json").read_text())
    content["config"][name] = {"env": "acrobot", "agent": "gbdqn", "seed": 1, "episodes": 7}[name]
    (folder / "config.json").write_text(json.dumps(content))
    resume(folder, capsys, "summary.json")


@pytest.mark.parametrize(("name", "value"), [("lr", -1), ("episodes", "many"), ("xyzzy", 1)])
def test_a_config_with_an_invalid_value_is_refused(run, capsys, name, value):
    content = json.loads((run / "config.json").read_text())
    content["config"][name] = value
    (run / "config.json").write_text(json.dumps(content))
    resume(run, capsys, name)
    resume(run, capsys, "config.json")  # the file is at fault, not the command line


CHECKPOINTS = {
    "truncated": lambda data: data[: len(data) // 2],
    "empty": lambda data: b"",
    "another beginning": lambda data: b"hello\n" + data[6:],
    "an array whose header is cut": lambda data: b"\x93NUMPY\x01\x00\x10\x00{'shape': (3,    \n",
}


@pytest.mark.parametrize("damage", CHECKPOINTS.values(), ids=CHECKPOINTS)
def test_a_damaged_checkpoint_is_refused(run, capsys, damage):
    path = run / "checkpoint.npz"
    path.write_bytes(damage(path.read_bytes()))
    resume(run, capsys, "checkpoint.npz is damaged")


def test_the_checkpoint_of_another_run_is_refused(run, tmp_path, capsys):
    other = tmp_path / "other"
    runs.train(Config(agent="dqn", seed=1, episodes=2, hidden=(4,), capacity=50), other, quiet=True)
    shutil.copy(other / "checkpoint.npz", run)
    resume(run, capsys, "other settings")


def test_a_checkpoint_of_a_later_format_is_refused(run, capsys):
    with np.load(run / "checkpoint.npz", allow_pickle=False) as file:
        arrays = dict(file)
    arrays["header"] = np.array(json.dumps(json.loads(arrays["header"].item()) | {"format": 99}))
    np.savez(run / "checkpoint.npz", **arrays)
    resume(run, capsys, "99")


def test_a_missing_episodes_csv_is_refused(run, capsys):
    (run / "episodes.csv").unlink()
    resume(run, capsys, "episodes.csv")


EPISODES = {
    "empty": lambda text: "",
    "only a header": lambda text: text.splitlines()[0] + "\n",
    "without its last episode": lambda text: "\n".join(text.splitlines()[:-1]) + "\n",
    "cut in its last line": lambda text: text[: text.rindex("\n") - 30],
    "cut in its last number": lambda text: text[: text.rindex("\n") - 3],
    "another header": lambda text: text.replace("episode,", "epoch,", 1),
    "no header": lambda text: text.split("\n", 1)[1],
    "a word for a number": lambda text: text.replace("\n3,", "\nthree,"),
    "a missing column": lambda text: text.replace("\n3,", "\n"),
    "an episode twice": lambda text: text.replace("\n3,", "\n2,"),
    "not text": lambda text: text.replace("\n3,", "\n\udcff,"),
}


@pytest.mark.parametrize("damage", EPISODES.values(), ids=EPISODES)
def test_a_damaged_episodes_csv_is_refused(run, capsys, damage):
    path = run / "episodes.csv"
    path.write_bytes(damage(path.read_text()).encode(errors="surrogateescape"))
    resume(run, capsys, "episodes.csv")


OTHER_EPISODES = {
    "without its last episode": EPISODES["without its last episode"],
    "only a header": EPISODES["only a header"],
    "another return": lambda text: re.sub(r"(\n3,.*?,.*?,)[^,]*", r"\g<1>-7.0", text),
    "a return that is none": lambda text: re.sub(r"(\n3,.*?,.*?,)[^,]*", r"\g<1>nan", text),
    "other steps": lambda text: re.sub(r"(\n5,.*?,.*?,.*?,.*?,)[^,]*", r"\g<1>7", text),
}


@pytest.mark.parametrize("damage", OTHER_EPISODES.values(), ids=OTHER_EPISODES)
def test_episodes_that_are_not_those_of_the_summary_are_refused(complete, tmp_path, capsys, damage):
    folder = Path(shutil.copytree(complete, tmp_path / "study" / "dqn"))
    path = folder / "episodes.csv"
    before = path.read_text()
    path.write_text(damage(before))
    assert path.read_text() != before
    resume(folder, capsys, "episodes.csv has")
    start = ["compare", "--agents", "dqn", "--quiet", *SMALL_RUN, "--out", str(folder.parent)]
    refused(capsys, tmp_path, start, "episodes.csv has")


@pytest.mark.parametrize("content", [b"", b"{", b"null", b"{}", b"\xff"])
def test_a_damaged_summary_is_refused(complete, tmp_path, capsys, content):
    folder = Path(shutil.copytree(complete, tmp_path / "run"))
    (folder / "summary.json").write_bytes(content)
    resume(folder, capsys, "summary.json")


def row(**changes):
    """Change the row of the first regime."""
    return lambda summary: summary | {"regimes": [summary["regimes"][0] | changes]}


SUMMARIES = {
    "a number for the regimes": lambda summary: summary | {"regimes": 5},
    "a number for a regime": lambda summary: summary | {"regimes": [5]},
    "too few regimes": lambda summary: summary | {"regimes": []},
    "too many regimes": lambda summary: summary | {"regimes": summary["regimes"] * 2},
    "an unknown regime": row(regime=9),
    "a word for a regime": row(regime="0"),
    "a word for a mean": row(mean_return="high"),
    "nothing for a mean": row(mean_return=None),
    "a word for a drop": row(drop="half"),
    "a list for a recovery": row(recovery=[3]),
    "a word for the final return": lambda summary: summary | {"final_return": "high"},
    "yes for the random return": lambda summary: summary | {"random_return": True},
    "numbers for rows of evaluations": lambda summary: summary | {"evaluation": [1, 2]},
    "words for evaluations": lambda summary: summary | {"evaluation": [["high"]]},
    "a word for the share of recency": lambda summary: (
        summary | {"recency_share_of_replay": "half"}
    ),
}


@pytest.mark.parametrize("damage", SUMMARIES.values(), ids=SUMMARIES)
def test_a_summary_of_the_wrong_shape_is_refused(complete, tmp_path, capsys, damage):
    folder = Path(shutil.copytree(complete, tmp_path / "run"))
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(damage(summary)))
    resume(folder, capsys, "summary.json")


def test_compare_refuses_a_damaged_run(complete, tmp_path, capsys):
    folder = Path(shutil.copytree(complete, tmp_path / "both" / "dqn"))
    (folder / "episodes.csv").write_text("no episodes\n")
    arguments = ["compare", "--agents", "dqn", "--out", str(tmp_path / "both"), *SMALL_RUN]
    refused(capsys, tmp_path, [*arguments, "--quiet"], "episodes.csv is damaged")


def test_compare_refuses_runs_with_other_settings(complete, tmp_path, capsys):
    shutil.copytree(complete, tmp_path / "both" / "dqn")
    arguments = ["compare", "--agents", "dqn", "--out", str(tmp_path / "both"), *SMALL_RUN]
    refused(capsys, tmp_path, [*arguments, "--set", "lr=0.5"], "other settings")


BUSY = """
import sys
from gbdqn_ref import __main__, runs

def wait(config):
    print("training", flush=True)
    sys.stdin.readline()
    raise KeyboardInterrupt

runs.make_agent = wait
sys.exit(__main__.main())
"""


@pytest.mark.skipif(files.fcntl is None, reason="no flock on this system")
def test_a_folder_that_another_process_works_in_is_refused(complete, run, capsys):
    with subprocess.Popen(
        command("train", "--resume", "--out", run, start=["-c", BUSY]),
        env=environ(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as other:
        assert other.stdout.readline() == "training\n"
        resume(run, capsys, "in use by another process")
        other.communicate("go\n")
    assert other.returncode == 130
    assert main(["train", "--resume", "--out", str(run), "--quiet"]) == 0
    assert contents(run) == contents(complete)


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["train", "--env", "x"],
        ["train", "--resume", "--out", "nowhere"],
        ["compare", "--set", "lr=0"],
    ],
)
def test_a_process_ends_with_the_same_line_and_status(tmp_path, capsys, arguments, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    expected = capsys.readouterr().err
    assert cli(*arguments) == (2, "", expected)
    assert contents(tmp_path) == {}

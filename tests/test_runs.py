"""A run's folder: the same bytes in every process, also when it was killed on the way and
resumed.
"""

import json
import os
import random
import shutil
import subprocess
import time
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import SMALL, Crash, cli, command, contents, drifts_at, environ, flags, refused

from gbdqn_ref import UsageError, __main__, checkpoint, drift, files, runs, train
from gbdqn_ref.config import Config

FILES = {"config.json", "episodes.csv", "checkpoint.npz", "summary.json", "curve.png"}
DRIFTING = SMALL | dict(  # slow enough to be killed on the way
    episodes=30, capacity=400, batch_size=64, schedule=drifts_at(8, 15, 22)
)
SETTINGS = flags(**DRIFTING)
ALWAYS = [  # a checkpoint at every episode
    "-c",
    (
        "import sys; from gbdqn_ref import runs, __main__ as m; runs.CHECKPOINT_SECONDS = -1;"
        " sys.exit(m.main())"
    ),
]
both = pytest.mark.parametrize("agent", ["dqn", "gbdqn"])


def config_of(agent, seed=0):
    return Config.preset("cartpole", agent=agent, seed=seed, **DRIFTING)


def restore(files, folder):
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """{agent: the files of a run that was left alone}, made in this process."""
    folders = {agent: tmp_path_factory.mktemp(agent) for agent in ("dqn", "gbdqn")}
    for agent, folder in folders.items():
        runs.train(config_of(agent), folder, quiet=True)
    return {agent: contents(folder) for agent, folder in folders.items()}


# --- the same bytes -------------------------------------------------------------------------------


@both
def test_every_process_writes_the_same_bytes(tmp_path, undisturbed, agent):
    for hash_seed in "1", "2":  # catches an order that depends on a set
        out = tmp_path / hash_seed
        status, stdout, stderr = cli(
            "train", "--agent", agent, *SETTINGS, "--out", out, "--quiet", PYTHONHASHSEED=hash_seed
        )
        assert (status, stderr) == (0, "") and str(out) in stdout
        assert contents(out) == undisturbed[agent]
    assert set(undisturbed[agent]) == FILES


@both
def test_another_seed_writes_other_bytes(tmp_path, undisturbed, agent):
    runs.train(config_of(agent, seed=1), tmp_path, quiet=True)
    other = contents(tmp_path)
    assert [name for name in FILES if other[name] == undisturbed[agent][name]] == []


# --- killed and resumed ---------------------------------------------------------------------------


def lines(path):
    try:
        return path.read_bytes().count(b"\n")
    except FileNotFoundError:
        return 0


@both
def test_a_run_that_is_killed_again_and_again_ends_with_the_same_bytes(
    tmp_path, undisturbed, agent
):
    """kill -9 at random moments of a process that writes a checkpoint at every episode."""
    out, rng, kills = tmp_path / "run", random.Random(agent), 0
    arguments = ["train", "--agent", agent, *SETTINGS]
    for attempt in range(12):
        enough = lines(out / "episodes.csv") + rng.randint(2, 6)
        process = subprocess.Popen(
            command(*arguments, "--out", out, "--quiet", start=ALWAYS), env=environ(),
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        )  # fmt: skip
        with process:
            while process.poll() is None and lines(out / "episodes.csv") < enough:
                time.sleep(0.001)
            time.sleep(rng.uniform(0, 0.03))
            process.kill()
            stderr = process.stderr.read()
        assert stderr == b"" and process.returncode in (0, -9), (attempt, stderr)
        kills += process.returncode != 0
        arguments = ["train", "--resume"]
        if process.returncode == 0 or kills == 4:
            break
    assert kills >= 3, "the machine is too fast for this test to say anything"
    assert cli(*arguments, "--out", out, "--quiet")[0] == 0
    assert contents(out) == undisturbed[agent]


def checkpoints_every(episodes, monkeypatch):
    """Let a checkpoint be due every so many episodes, by a clock that ticks once when it is
    read.
    """
    clock = iter(range(10**6))
    monkeypatch.setattr(runs, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    monkeypatch.setattr(runs, "CHECKPOINT_SECONDS", episodes - 1)


def train_until_file(n, out, agent):
    """Let the run crash when the n-th file is complete but has not taken its place."""
    count, replace = [0], os.replace

    def crashing(source, target):
        count[0] += 1
        if count[0] == n:
            raise Crash
        replace(source, target)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files.os, "replace", crashing)
        runs.train(config_of(agent), out, quiet=True)


@pytest.mark.parametrize(
    "n", range(2, 9)
)  # of 8: config, episodes, three checkpoints, the last one, curve, summary
def test_a_crash_at_any_file_is_made_good(tmp_path, undisturbed, monkeypatch, n):
    checkpoints_every(8, monkeypatch)  # so that there are lines to cut
    with pytest.raises(Crash):
        train_until_file(n, tmp_path, "gbdqn")
    runs.train(config_of("gbdqn"), tmp_path, resume=True, quiet=True)
    assert contents(tmp_path) == undisturbed["gbdqn"]


def test_a_run_that_crashed_before_its_config_was_written_can_be_started_again(
    tmp_path, undisturbed
):
    with pytest.raises(Crash):
        train_until_file(1, tmp_path, "dqn")
    runs.train(config_of("dqn"), tmp_path, quiet=True)
    assert contents(tmp_path) == undisturbed["dqn"]


@pytest.fixture
def interrupted(tmp_path):
    """The folder of a GB-DQN that crashed in episode 20, with a checkpoint after 18."""

    def run(*arguments):
        for record in train.run(*arguments):
            yield record
            if record["episode"] == 20:
                raise Crash

    with pytest.MonkeyPatch.context() as patch:
        checkpoints_every(9, patch)
        patch.setattr(runs, "run", run)
        with pytest.raises(Crash):
            runs.train(config_of("gbdqn"), tmp_path / "interrupted", quiet=True)
    assert lines(tmp_path / "interrupted" / "episodes.csv") == 22
    assert set(contents(tmp_path / "interrupted")) == {
        "config.json",
        "episodes.csv",
        "checkpoint.npz",
    }
    return tmp_path / "interrupted"


def test_without_a_checkpoint_a_run_starts_anew(interrupted, undisturbed):
    (interrupted / "checkpoint.npz").unlink()
    runs.train(config_of("gbdqn"), interrupted, resume=True, quiet=True)
    assert contents(interrupted) == undisturbed["gbdqn"]


@pytest.mark.parametrize("tail", [b"21,2,,1", b"21,2,,14.0,14,", b"\n\n", b"\xff\xfe"])
def test_a_line_that_was_half_written_after_the_checkpoint_does_no_harm(
    interrupted, undisturbed, tail
):
    with open(interrupted / "episodes.csv", "ab") as file:
        file.write(tail)
    runs.train(config_of("gbdqn"), interrupted, resume=True, quiet=True)
    assert contents(interrupted) == undisturbed["gbdqn"]


def test_a_half_written_file_from_before_the_crash_does_no_harm(interrupted, undisturbed):
    for name in FILES:
        (interrupted / f"{name}.part").write_bytes(b"half")
    runs.train(config_of("gbdqn"), interrupted, resume=True, quiet=True)
    left = contents(interrupted)
    assert {name: left[name] for name in FILES} == undisturbed["gbdqn"]


@pytest.mark.parametrize(
    "arguments",
    [[], ["--agent", "gbdqn", *SETTINGS], ["--env", "cartpole", "--seed", "0", *SETTINGS]],
)
def test_a_run_is_resumed_with_the_same_flags_or_with_none(
    interrupted, undisturbed, arguments, capsys
):
    assert (
        __main__.main(["train", "--resume", "--out", str(interrupted), "--quiet", *arguments]) == 0
    )
    assert contents(interrupted) == undisturbed["gbdqn"]
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "arguments",
    [
        ["--agent", "dqn", *SETTINGS],
        ["--seed", "1", *SETTINGS],
        [*SETTINGS, "--set", "lr=0.5"],
        ["--env", "acrobot"],
    ],
    ids=lambda arguments: " ".join(arguments[-2:])[:40],
)
def test_a_run_is_not_resumed_with_other_flags(interrupted, arguments, capsys):
    arguments = ["train", "--resume", "--out", str(interrupted), "--quiet", *arguments]
    refused(capsys, interrupted, arguments, "other settings")


def test_a_complete_run_is_only_read(tmp_path, undisturbed):
    restore(undisturbed["dqn"], tmp_path)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    summary = json.loads(undisturbed["dqn"]["summary.json"])
    assert runs.train(config_of("dqn"), tmp_path, resume=True, quiet=True) == summary
    assert __main__.main(["train", "--resume", "--out", str(tmp_path)]) == 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == times
    assert contents(tmp_path) == undisturbed["dqn"]


def test_ctrl_c_is_answered_in_words_and_can_be_resumed(
    interrupted, undisturbed, monkeypatch, capsys
):
    def run(*arguments):
        yield from [next(train.run(*arguments))]
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(runs, "run", run)
        assert __main__.main(["train", "--resume", "--out", str(interrupted), "--quiet"]) == 130
    error = capsys.readouterr().err
    assert "--resume" in error and "Traceback" not in error
    assert __main__.main(["train", "--resume", "--out", str(interrupted), "--quiet"]) == 0
    assert contents(interrupted) == undisturbed["gbdqn"]


# --- what is in the folder ------------------------------------------------------------------------


@both
def test_episodes_csv_holds_what_the_run_yielded(tmp_path, undisturbed, agent):
    (tmp_path / "episodes.csv").write_bytes(undisturbed[agent]["episodes.csv"])
    yielded = list(train.run(config_of(agent)))
    assert [repr(record) for record in runs.read_episodes(tmp_path)] == [
        repr(record) for record in yielded
    ]
    assert [(record["episode"], record["event"]) for record in yielded if record["event"]] == [
        (8, "drift"), (15, "drift"), (22, "reset")
    ]  # fmt: skip
    assert [record["regime"] for record in yielded] == [0] * 8 + [1] * 7 + [2] * 7 + [3] * 8
    assert all(record["return"] == record["length"] for record in yielded), (
        "CartPole pays 1 per step"
    )
    assert np.cumsum([record["length"] for record in yielded]).tolist() == [
        record["steps"] for record in yielded
    ]


@both
def test_config_json_holds_every_setting_and_the_versions(tmp_path, undisturbed, agent):
    (tmp_path / "config.json").write_bytes(undisturbed[agent]["config.json"])
    content = json.loads(undisturbed[agent]["config.json"])
    assert runs.read_config(tmp_path) == config_of(agent)
    assert content["config"] == config_of(agent).to_dict()
    assert content["versions"].keys() == {"gbdqn_ref", "python", "numpy", "gymnasium", "mujoco"}
    assert content["versions"]["numpy"] == np.__version__


@both
def test_summary_json_sums_up_episodes_csv(undisturbed, agent):
    summary = json.loads(undisturbed[agent]["summary.json"])
    records = list(train.run(config_of(agent)))
    returns = [record["return"] for record in records]
    assert summary["final_return"] == pytest.approx(np.mean(returns))
    assert (summary["episodes"], summary["steps"]) == (30, records[-1]["steps"])
    assert [row["mean_return"] for row in summary["regimes"]] == pytest.approx(
        [np.mean(returns[a:b]) for a, b in ((0, 8), (8, 15), (15, 22), (22, 30))]
    )
    assert 15 < summary["random_return"] < 30, "CartPole's random policy"
    assert ("recency_share_of_replay" in summary) == (agent == "gbdqn")


@both
def test_the_last_checkpoint_is_the_agent_at_the_end_of_the_run(tmp_path, undisturbed, agent):
    (tmp_path / "checkpoint.npz").write_bytes(undisturbed[agent]["checkpoint.npz"])
    restored, trained = train.make_agent(config_of(agent)), train.make_agent(config_of(agent))
    list(train.run(config_of(agent), trained))
    assert checkpoint.load(tmp_path / "checkpoint.npz", restored) == 30
    np.testing.assert_array_equal(
        restored.q(np.eye(4, dtype=np.float32)), trained.q(np.eye(4, dtype=np.float32))
    )


def test_the_curve_is_a_picture(undisturbed):
    for written in undisturbed.values():
        assert (
            written["curve.png"].startswith(b"\x89PNG\r\n\x1a\n")
            and len(written["curve.png"]) > 10_000
        )


@pytest.mark.parametrize("env", drift.ENVIRONMENTS)
def test_every_environment_can_be_run_from_the_command_line(tmp_path, env, capsys):
    arguments = [
        "--env",
        env,
        "--agent",
        "gbdqn",
        "--preset",
        "fast",
        "--set",
        "episodes=2",
        "--set",
        "hidden=[4]",
    ]
    schedule = '--set=schedule=[{"episode": 1, "gravity": 1.1}]'
    assert (
        __main__.main(["train", *arguments, schedule, "--out", str(tmp_path / "run"), "--quiet"])
        == 0
    )
    assert set(contents(tmp_path / "run")) == FILES
    assert "gravity × 1.1" in capsys.readouterr().out


# --- the command line -----------------------------------------------------------------------------


def test_compare_trains_both_agents_and_changes_nothing_when_repeated(tmp_path, undisturbed):
    out = tmp_path / "both"
    status, stdout, stderr = cli("compare", *SETTINGS, "--out", out, "--quiet")
    assert (status, stderr) == (0, "")
    first = contents(out)
    assert first.pop("comparison.png").startswith(b"\x89PNG")
    assert first == dict.fromkeys(undisturbed) | {
        f"{agent}/{name}": undisturbed[agent][name] for agent in undisturbed for name in FILES
    }
    first = contents(out)
    assert cli("compare", *SETTINGS, "--out", out, "--quiet") == (0, stdout, "")
    assert contents(out) == first


def test_compare_finishes_what_it_has_begun(tmp_path, interrupted, undisturbed, capsys):
    out = tmp_path / "both"
    shutil.copytree(interrupted, out / "gbdqn")
    assert __main__.main(["compare", *SETTINGS, "--out", str(out), "--quiet"]) == 0
    assert (
        contents(out / "gbdqn") == undisturbed["gbdqn"]
        and contents(out / "dqn") == undisturbed["dqn"]
    )


def test_the_table_has_a_line_per_regime_and_a_column_per_agent(tmp_path, undisturbed, capsys):
    for agent, written in undisturbed.items():
        restore(written, tmp_path / agent)
    assert __main__.main(["compare", *SETTINGS, "--out", str(tmp_path)]) == 0
    table = capsys.readouterr().out
    rows = [line for line in table.splitlines() if line[:3] in ("0  ", "1  ", "2  ", "3  ")]
    assert [row.split("  ")[1] for row in rows] == [
        "stock physics", "length × 2", "gravity × 2, length × 2", "stock physics"
    ]  # fmt: skip
    for agent, shown in (("gbdqn", "GB-DQN"), ("dqn", "DQN")):
        summary = json.loads(undisturbed[agent]["summary.json"])
        assert shown in table and f"{summary['final_return']:.1f}" in table
        for row, regime in zip(rows, summary["regimes"], strict=True):
            assert f"{regime['mean_return']:.1f}" in row
            assert regime["drop"] is None or f"{regime['drop']:.0%}" in row
            assert (
                regime["drop"] is None
                or (str(regime["recovery"]) if regime["recovery"] else "never") in row
            )


def test_the_progress_is_shown_on_stderr_and_the_table_on_stdout(tmp_path):
    status, stdout, stderr = cli("train", *SETTINGS, "--agent", "dqn", cwd=tmp_path)
    assert status == 0 and "30/30" in stderr and "dqn" in stderr and "return=" in stderr
    assert "30/30" not in stdout and "regime" in stdout
    assert set(contents(tmp_path / "runs" / "cartpole-dqn-0")) == FILES, "the default folder"


@pytest.mark.parametrize("arguments", [["--help"], ["train", "--help"], ["compare", "--help"]])
def test_help_is_help(arguments, capsys):
    with pytest.raises(SystemExit, match=r"^0$"):
        __main__.main(arguments)
    assert capsys.readouterr().out.startswith("usage: python -m gbdqn_ref")


def test_a_run_does_not_begin_in_the_folder_of_another(tmp_path, undisturbed):
    restore(undisturbed["dqn"], tmp_path)
    with pytest.raises(UsageError, match="--resume"):
        runs.train(config_of("dqn"), tmp_path, quiet=True)
    assert contents(tmp_path) == undisturbed["dqn"]


# --- evaluation in every regime -------------------------------------------------------------------


@both
def test_after_each_regime_the_agent_is_evaluated_in_every_regime(tmp_path, undisturbed, agent):
    """The last row is what the agent of the checkpoint reaches, in physics that are set by hand."""
    summary = json.loads(undisturbed[agent]["summary.json"])
    assert [len(row) for row in summary["evaluation"]] == [4, 4, 4, 4]
    restore(undisturbed[agent], tmp_path / "run")
    config = config_of(agent)
    learner = train.make_agent(config)
    checkpoint.load(tmp_path / "run" / "checkpoint.npz", learner)
    for (length, gravity), mean in zip(
        [(1, 1), (2, 1), (2, 2), (1, 1)], summary["evaluation"][-1], strict=True
    ):
        env = drift.make("cartpole", [{"episode": 0, "length": length, "gravity": gravity}])
        assert train.evaluate(learner, env, 5, config.seed).mean() == mean


@both
def test_the_evaluation_changes_nothing_of_the_training(monkeypatch, undisturbed, agent):
    monkeypatch.setattr(train, "evaluate_regimes", lambda *_: [])
    without = list(train.run(config_of(agent)))
    monkeypatch.undo()
    with_it = [record | {"evaluation": []} for record in train.run(config_of(agent))]
    assert repr(with_it) == repr(without)  # as text, in which nan is nan


def test_regimes_that_a_short_run_does_not_reach_are_not_evaluated():
    config = Config.preset("cartpole", agent="dqn", **DRIFTING | {"episodes": 10})
    evaluations = {record["episode"]: len(record["evaluation"]) for record in train.run(config)}
    assert {episode: n for episode, n in evaluations.items() if n} == {7: 2, 9: 2}

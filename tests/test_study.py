"""A study leaves the same bytes however its runs were spread, and whatever was killed on the
way.
"""

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import threading
import time
from concurrent.futures import Executor, Future
from pathlib import Path

import pytest
from helpers import SMALL, command, contents, environ, flags, refused

from gbdqn_ref import UsageError, files, plots, study, tables
from gbdqn_ref.__main__ import main
from gbdqn_ref.config import Config

DRIFTING = SMALL | dict(schedule=[{"episode": 6, "length": 2}])
CONFIGS = [
    Config.preset("cartpole", agent=agent, seed=seed, **DRIFTING)
    for seed in (0, 1)
    for agent in ("dqn", "random")
]
NAMES = ["dqn-0", "random-0", "dqn-1", "random-1"]


DISTRIBUTED = importlib.util.find_spec("distributed")


class Here(Executor):
    """Runs what is submitted at once, in this process."""

    def submit(self, call, /, *args):
        future = Future()
        try:
            future.set_result(call(*args))
        except Exception as e:
            future.set_exception(e)
        return future


@pytest.fixture(scope="module")
def sequential(tmp_path_factory):
    """The files of the study, made one run after the other."""
    out = tmp_path_factory.mktemp("study") / "out"
    assert study.run_study(CONFIGS, out, Here(), quiet=True) == {}
    return contents(out)


def study_arguments(out, *more):
    start = ["study", "--env", "cartpole", "--agents", "dqn,random", "--seeds", "2", "--quiet"]
    return [*start, *flags(**DRIFTING), "--out", str(out), *more]


def test_a_study_has_a_folder_per_run_and_the_summaries_of_all(sequential):
    assert {name.split("/")[0] for name in sequential} == {*NAMES, "study.json", "results.json"}
    results = json.loads(sequential["results.json"])
    assert [f"{run['agent']}-{run['seed']}" for run in results["runs"]] == NAMES
    for name, run in zip(NAMES, results["runs"], strict=True):
        assert run == json.loads(sequential[f"{name}/summary.json"])
    assert (results["agents"], results["seeds"]) == (["dqn", "random"], [0, 1])


def test_processes_write_the_same_bytes_and_a_repetition_writes_no_run(
    tmp_path, sequential, capsys
):
    for _ in range(2):
        assert main(study_arguments(tmp_path / "out")) == 0
        names = ("curves.png", "adaptation.png", "forest.png")
        pictures = {name: (tmp_path / "out" / name).read_bytes() for name in names}
        assert contents(tmp_path / "out") == sequential | pictures
        ages = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("*/*")}
    assert ages == {path: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("*/*")}


def test_the_command_shows_what_the_runs_have_stored(tmp_path, sequential, capsys):
    out = tmp_path / "out"
    for name, content in sequential.items():
        if content is not None:
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (out / name).write_bytes(content)
    assert main(study_arguments(out)) == 0
    printed = capsys.readouterr().out
    (summaries, records), config = study.report(out), CONFIGS[0]
    tables.show(tables.study(summaries, config))
    assert printed.startswith(capsys.readouterr().out)
    level = summaries["dqn"][0]["random_return"]
    for name, figure in (
        ("curves.png", plots.study_curves(records, config, level)),
        ("adaptation.png", plots.adaptation(summaries, config)),
        ("forest.png", plots.forest(summaries, config)),
    ):
        plots.save(figure, tmp_path / name)
        assert (out / name).read_bytes() == (tmp_path / name).read_bytes(), name


def test_a_study_that_is_killed_whole_can_be_started_again(tmp_path, sequential):
    out = tmp_path / "out"
    process = subprocess.Popen(
        command(*study_arguments(out)),
        env=environ(),
        start_new_session=True,
        stderr=subprocess.DEVNULL,
    )
    while not list(out.glob("*/episodes.csv")):
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    while not all(map(is_free, [out, *out.glob("*-*")])):  # a worker may take a moment to die
        time.sleep(0.01)
    assert study.run_study(CONFIGS, out, Here(), quiet=True) == {}
    assert contents(out) == sequential


def test_workers_die_with_their_study_and_so_leave_its_runs_to_the_next(tmp_path):
    out = tmp_path / "out"
    process = subprocess.Popen(
        command(*study_arguments(out, "--set", "episodes=1000000")),
        env=environ(),
        start_new_session=True,
    )
    try:
        while len(list(out.glob("*/episodes.csv"))) < 2:
            time.sleep(0.01)
        process.kill()
        process.wait()
        latest = time.monotonic() + 20
        while not all(map(is_free, out.glob("*-*"))):
            assert time.monotonic() < latest, "a worker goes on"
            time.sleep(0.05)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def is_free(folder):
    try:
        with files.locked(folder):
            return True
    except UsageError:
        return False


def kill_once(values, folder):
    """The worker that comes first is killed in the middle of its run."""
    mark = Path(folder).parent.parent / "killed"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    train_one(values, folder)


train_one = study.train_one


def test_what_a_killed_worker_leaves_is_taken_up_once_more(tmp_path, sequential, monkeypatch):
    monkeypatch.setattr(study, "train_one", kill_once)
    assert study.run_study(CONFIGS, tmp_path / "out", jobs=2, quiet=True) == {}
    assert (tmp_path / "killed").exists()
    assert contents(tmp_path / "out") == sequential


def test_a_run_that_fails_is_reported_and_the_others_finish(tmp_path, sequential, capsys):
    (tmp_path / "out").mkdir()
    files.write_json(tmp_path / "out" / "study.json", json.loads(sequential["study.json"]))
    (tmp_path / "out" / "dqn-1").touch()
    assert main(study_arguments(tmp_path / "out")) == 1
    printed = capsys.readouterr()
    assert "dqn-1 failed: UsageError: " in printed.err and "is not a folder" in printed.err
    assert len(printed.err.splitlines()) == 1
    assert all(
        (tmp_path / "out" / name / "summary.json").exists() for name in NAMES if name != "dqn-1"
    )
    assert not (tmp_path / "out" / "results.json").exists()


def test_the_report_sorts_the_runs_by_agent(tmp_path, sequential):
    assert study.run_study(CONFIGS, tmp_path, Here(), quiet=True) == {}
    summaries, records = study.report(tmp_path)
    assert {agent: [row["seed"] for row in rows] for agent, rows in summaries.items()} == {
        "dqn": [0, 1],
        "random": [0, 1],
    }
    assert [len(run) for run in records["dqn"]] == [12, 12]
    assert [run[0]["return"] for run in records["dqn"]] != [
        run[0]["return"] for run in records["random"]
    ]


def test_the_folder_of_another_study_or_of_something_else_is_refused(tmp_path, sequential):
    study.run_study(CONFIGS[:1], tmp_path / "out", Here(), quiet=True)
    others = [Config.preset("cartpole", agent="dqn", **DRIFTING | {"episodes": 13})]
    with pytest.raises(UsageError, match="has other settings"):
        study.run_study(others, tmp_path / "out", Here(), quiet=True)
    with pytest.raises(UsageError, match="holds no study"):
        study.run_study(CONFIGS, tmp_path, Here(), quiet=True)
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="is not a folder"):
        study.run_study(CONFIGS, tmp_path / "file", Here(), quiet=True)


def test_a_study_grows_by_agents_and_seeds(tmp_path, sequential):
    assert study.run_study(CONFIGS[:1], tmp_path, Here(), quiet=True) == {}
    assert study.run_study(CONFIGS, tmp_path, Here(), quiet=True) == {}
    assert contents(tmp_path) == sequential


def test_a_folder_in_which_a_study_is_at_work_is_refused(tmp_path):
    (tmp_path / "out").mkdir()
    with (
        files.locked(tmp_path / "out"),
        pytest.raises(UsageError, match="in use by another process"),
    ):
        study.run_study(CONFIGS, tmp_path / "out", Here(), quiet=True)


@pytest.mark.parametrize(
    ("arguments", "keyword"),
    [
        (["--agents", "dqn,dqn"], "twice"),
        (["--agents", "dqn,sarsa"], "one of gbdqn, dqn"),
        (["--seeds", "3,3"], "twice"),
        (["--seeds", "0"], "--seeds"),
        (["--seeds", "-1"], "--seeds"),
        (["--seeds", "a"], "--seeds"),
        (["--jobs", "0"], "--jobs"),
        (["--seed", "1"], "--seeds"),
        (["--dask", "nowhere"], "tcp://host:8786" if DISTRIBUTED else "cluster"),
    ],
)
def test_a_wrong_command_is_refused(tmp_path, capsys, arguments, keyword):
    start = ["study", "--env", "cartpole", "--out", str(tmp_path / "out")]
    refused(capsys, tmp_path, [*start, *arguments], keyword)


def kill_when(ready, pid):
    while not ready():
        time.sleep(0.01)
    os.kill(pid, signal.SIGKILL)


@pytest.mark.filterwarnings("ignore")  # Dask's own, of processes that are gone
def test_a_dask_cluster_of_which_a_worker_is_killed_writes_the_same_bytes(tmp_path, sequential):
    """Two worker processes, one of which is killed as soon as a run has begun."""
    distributed = pytest.importorskip("distributed")
    options = dict(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        first, _ = client.run(os.getpid).values()
        begun = (lambda: list((tmp_path / "out").glob("*/episodes.csv")), first)
        killer = threading.Thread(target=kill_when, args=begun)
        killer.start()
        assert (
            study.run_study(CONFIGS, tmp_path / "out", client.get_executor(pure=False), quiet=True)
            == {}
        )
        killer.join()
        assert first not in client.run(os.getpid).values()
    assert contents(tmp_path / "out") == sequential

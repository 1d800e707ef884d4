"""A study has the same bytes however its runs are distributed and whatever is killed."""

import importlib.util
import itertools
import json
import os
import signal
import subprocess
import threading
from concurrent.futures import Future
from dataclasses import replace
from unittest import mock

import pytest
from helpers import SMALL, Here, command, contents, environ, flags, refused, train_here, wait_for

from gbdqn_ref import UsageError, files, plots, runs, study, tables
from gbdqn_ref.__main__ import main
from gbdqn_ref.config import Config

DRIFTING = SMALL | dict(schedule=[{"episode": 6, "length": 2}])
AGENTS = {agent: Config.preset("cartpole", agent=agent, **DRIFTING) for agent in ("dqn", "random")}
CONFIGS = study.grid(AGENTS, [0, 1])
NAMES = ["dqn-0", "random-0", "dqn-1", "random-1"]
FIRST = {"dqn-0": CONFIGS["dqn-0"]}

DISTRIBUTED = importlib.util.find_spec("distributed")


@pytest.fixture(scope="module")
def sequential(tmp_path_factory):
    """The files of the study, trained one run after the other."""
    out = tmp_path_factory.mktemp("study") / "out"
    assert study.run_study(CONFIGS, out, Here(), quiet=True) == {}
    return contents(out)


def test_a_damaged_summary_is_refused_before_anything_is_trained(tmp_path):
    study.run_study(FIRST, tmp_path, Here(), quiet=True)
    (tmp_path / "dqn-0" / "summary.json").write_bytes(b"{")
    with pytest.raises(UsageError, match=r"summary\.json"):
        study.run_study(CONFIGS, tmp_path, Here(), quiet=True)
    assert {path.name for path in tmp_path.glob("*-*")} == {"dqn-0"}


@pytest.mark.parametrize("other", [{"seed": 5}, {"agent": "random"}, {"regimes": []}], ids=str)
def test_the_summary_of_another_run_is_refused_before_anything_is_trained(tmp_path, other):
    study.run_study(FIRST, tmp_path, Here(), quiet=True)
    path = tmp_path / "dqn-0" / "summary.json"
    files.write_json(path, files.read_json(path) | other)
    with pytest.raises(UsageError, match=r"dqn-0 is damaged: config\.json has .* summary\.json"):
        study.run_study(CONFIGS, tmp_path, Here(), quiet=True)
    assert {path.name for path in tmp_path.glob("*-*")} == {"dqn-0"}


def study_arguments(out, *more):
    start = ["study", "--env", "cartpole", "--agents", "dqn,random", "--seeds", "2", "--quiet"]
    return [*start, *flags(**DRIFTING), "--out", str(out), *more]


def test_a_study_has_a_folder_per_run_and_the_summaries_of_all(sequential):
    assert {name.split("/")[0] for name in sequential} == {*NAMES, "study.json", "results.json"}
    results = json.loads(sequential["results.json"])
    assert [f"{run['agent']}-{run['seed']}" for run in results["runs"]] == NAMES
    for name, run in zip(NAMES, results["runs"], strict=True):
        agent, seed = name.split("-")
        differs = {"agent": agent, "seed": int(seed), "replay": "proportional"}
        recorded = json.loads(sequential[f"{name}/config.json"])
        made_by = {key: recorded[key] for key in ("versions", "code")}
        summary = json.loads(sequential[f"{name}/summary.json"])
        assert run == {"name": name, "settings": differs} | made_by | summary
        assert "numpy" in run["versions"]
    assert (results["agents"], results["seeds"]) == (["dqn", "random"], [0, 1])


def test_the_description_has_every_setting_of_every_run(sequential, tmp_path):
    """Each setting once, with the agents' defaults filled in and the changes by --set."""
    other = replace(AGENTS["dqn"], replay="uniform", lr=0.5)
    configs = CONFIGS | {"uniform": other}
    study.run_study(configs, tmp_path, Here(), quiet=True)
    description = json.loads((tmp_path / "study.json").read_text())
    assert list(description["runs"]) == [*NAMES, "uniform"]
    for name, config in configs.items():
        shared, differs = description["settings"], description["runs"][name]
        assert set(differs) == {"agent", "seed", "replay", "lr"}
        assert not shared.keys() & differs.keys()
        assert Config.from_dict(shared | differs) == config.resolved()


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


def test_the_command_shows_the_stored_results(tmp_path, sequential, capsys):
    out = tmp_path / "out"
    for name, content in sequential.items():
        if content is not None:
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (out / name).write_bytes(content)
    assert main(study_arguments(out)) == 0
    printed = capsys.readouterr().out
    (summaries, records), config = study.report(out), CONFIGS["dqn-0"]
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
    options = dict(env=environ(), start_new_session=True, stderr=subprocess.DEVNULL)
    with subprocess.Popen(command(*study_arguments(out)), **options) as process:
        try:
            wait_for(lambda: list(out.glob("*/episodes.csv")))
        finally:
            os.killpg(process.pid, signal.SIGKILL)
    wait_for(lambda: all(map(is_free, [out, *out.glob("*-*")])))  # a worker may die a bit later
    assert study.run_study(CONFIGS, out, Here(), quiet=True) == {}
    assert contents(out) == sequential


def is_free(folder):
    try:
        with files.locked(folder):
            return True
    except UsageError:
        return False


def test_a_run_that_fails_is_reported_and_the_others_finish(tmp_path, sequential, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "study.json").write_bytes(sequential["study.json"])
    (tmp_path / "out" / "dqn-1").touch()
    assert main(study_arguments(tmp_path / "out")) == 1
    printed = capsys.readouterr()
    assert "dqn-1 failed: UsageError: " in printed.err and "is not a folder" in printed.err
    assert len(printed.err.splitlines()) == 1
    finished = {path.parent.name for path in (tmp_path / "out").glob("*/summary.json")}
    assert finished == set(NAMES) - {"dqn-1"}
    assert not (tmp_path / "out" / "results.json").exists()


def test_the_report_sorts_the_runs_by_agent_and_seed(tmp_path):
    """In any order of the list, so that runs are paired by seed."""
    order = ["random-1", "dqn-1", "random-0", "dqn-0"]
    configs = {name: CONFIGS[name] for name in order}
    assert study.run_study(configs, tmp_path, Here(), quiet=True) == {}
    summaries, records = study.report(tmp_path)
    seeds = {agent: [row["seed"] for row in rows] for agent, rows in summaries.items()}
    assert seeds == {"dqn": [0, 1], "random": [0, 1]}
    assert [len(run) for run in records["dqn"]] == [12, 12]
    for agent, seed in itertools.product(("dqn", "random"), (0, 1)):
        assert summaries[agent][seed]["name"] == f"{agent}-{seed}"
        episodes = runs.read_episodes(tmp_path / f"{agent}-{seed}")
        assert repr(records[agent][seed]) == repr(episodes)  # as text, since nan != nan


def test_a_study_of_settings_is_reported_by_setting(tmp_path):
    settings = {name: replace(AGENTS["random"], episodes=k) for name, k in (("a", 2), ("b", 3))}
    assert study.run_study(study.grid(settings, [5, 4]), tmp_path, Here(), quiet=True) == {}
    summaries, records = study.report(tmp_path)
    assert [row["name"] for row in summaries["a"] + summaries["b"]] == ["a-4", "a-5", "b-4", "b-5"]
    assert [len(run) for run in records["a"] + records["b"]] == [2, 2, 3, 3]


def test_results_older_than_run_names_are_reported(tmp_path, sequential):
    assert study.run_study(CONFIGS, tmp_path, Here(), quiet=True) == {}
    expected = study.report(tmp_path)
    without(tmp_path / "results.json", "name", *(["runs", k] for k in range(4)))
    summaries, records = study.report(tmp_path)
    assert repr(records) == repr(expected[1]) and list(summaries) == ["dqn", "random"]


def test_the_folder_of_another_study_or_of_something_else_is_refused(tmp_path, sequential):
    study.run_study(FIRST, tmp_path / "out", Here(), quiet=True)
    longer = replace(CONFIGS["dqn-0"], episodes=13)
    for name in ("dqn-0", "dqn-1"):  # an existing run and a new one
        with pytest.raises(UsageError, match=r"has other settings \(episodes\)"):
            study.run_study({name: longer}, tmp_path / "out", Here(), quiet=True)
    with pytest.raises(UsageError, match="holds no study"):
        study.run_study(CONFIGS, tmp_path, Here(), quiet=True)
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="is not a folder"):
        study.run_study(CONFIGS, tmp_path / "file", Here(), quiet=True)


def without(path, key, *places):
    """Remove a key from a JSON file, as if the file were older than the key."""
    content = json.loads(path.read_text())
    for place in places:
        part = content
        for step in place:
            part = part[step]
        del part[key]
    path.write_text(json.dumps(content))


def test_a_study_survives_a_new_setting(tmp_path):
    """A file older than the setting means its default."""
    assert study.run_study(CONFIGS, tmp_path, Here(), quiet=True) == {}
    without(tmp_path / "study.json", "members", ["settings"])
    without(tmp_path / "dqn-0" / "config.json", "members", ["config"])
    assert study.run_study(CONFIGS, tmp_path, Here(), quiet=True) == {}
    without(tmp_path / "study.json", "members", ["settings"])
    changed = {name: replace(config, members=4) for name, config in CONFIGS.items()}
    with pytest.raises(UsageError, match=r"has other settings \(members\)"):
        study.run_study(changed, tmp_path, Here(), quiet=True)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"settings": 5}', '{"settings": null}'])
def test_a_damaged_description_is_refused(tmp_path, content):
    (tmp_path / "study.json").write_text(content)
    with pytest.raises(UsageError, match=r"study\.json is damaged"):
        study.run_study(CONFIGS, tmp_path, Here(), quiet=True)


@pytest.mark.parametrize("name", ["", "a/b", "..", "-a", "a ", "a.", "é", "×", "a" * 201, "x.json"])
def test_a_name_that_some_system_cannot_use_is_refused(tmp_path, name):
    with pytest.raises(UsageError, match="a run needs a name of letters, digits"):
        study.run_study({name: AGENTS["random"]}, tmp_path / "out", Here(), quiet=True)
    assert not (tmp_path / "out").exists()


def test_names_that_differ_only_in_case_are_refused(tmp_path):
    configs = {"lr": AGENTS["dqn"], "LR": AGENTS["random"]}
    with pytest.raises(UsageError, match="only in case"):
        study.run_study(configs, tmp_path, Here(), quiet=True)


def test_a_study_without_runs_is_refused(tmp_path):
    for make in (lambda: study.run_study({}, tmp_path), lambda: study.grid(AGENTS, [])):
        with pytest.raises(UsageError, match="from 1 to 10,000 runs, not 0"):
            make()


def test_a_repeated_seed_is_refused():
    with pytest.raises(UsageError, match="twice"):
        study.grid(AGENTS, [3, 4, 3])


def test_runs_of_two_versions_are_mixed_only_where_that_is_accepted(tmp_path, sequential, capsys):
    """Even if the runs of the other version are complete; a complete study is only read."""
    out = tmp_path / "out"
    assert study.run_study(FIRST, out, Here(), quiet=True) == {}
    recorded = json.loads((out / "dqn-0" / "config.json").read_text())
    numpy = recorded["versions"]["numpy"]
    recorded["versions"]["numpy"] = "1.0"
    files.write_json(out / "dqn-0" / "config.json", recorded)
    assert study.run_study(FIRST, out, Here(), quiet=True) == {}
    said = f"dqn-0 was made with other versions (numpy 1.0 → {numpy})"
    refused(capsys, tmp_path, study_arguments(out), said)
    assert main(study_arguments(out, "--accept-versions")) == 0
    rows = json.loads((out / "results.json").read_text())["runs"]
    assert [row["versions"]["numpy"] for row in rows] == ["1.0", numpy, numpy, numpy]


def test_a_worker_continues_a_run_of_another_version_only_if_accepted(tmp_path):
    out = tmp_path / "out"
    assert study.run_study(FIRST, out, Here(), quiet=True) == {}
    expected = (out / "dqn-0" / "summary.json").read_bytes()
    recorded = json.loads((out / "dqn-0" / "config.json").read_text())
    recorded["code"]["nn"] = "another"
    files.write_json(out / "dqn-0" / "config.json", recorded)
    (out / "dqn-0" / "summary.json").unlink()
    with pytest.raises(UsageError, match="nn another → "):
        study.run_study(FIRST, out, quiet=True)
    assert study.run_study(FIRST, out, quiet=True, accept=True) == {}
    assert (out / "dqn-0" / "summary.json").read_bytes() == expected


def test_a_study_grows_by_agents_and_seeds(tmp_path, sequential):
    assert study.run_study(FIRST, tmp_path, Here(), quiet=True) == {}
    assert study.run_study(CONFIGS, tmp_path, Here(), quiet=True) == {}
    assert contents(tmp_path) == sequential


def test_a_study_grows_by_an_agent_with_settings_of_its_own(tmp_path):
    """GB-DQN-reuse has its own default α, not DQN's."""
    assert study.run_study(FIRST, tmp_path, Here(), quiet=True) == {}
    reuse = {"gbdqn-reuse-0": replace(CONFIGS["dqn-0"], agent="gbdqn-reuse")}
    assert study.run_study(reuse, tmp_path, Here(), quiet=True) == {}


def test_the_folder_of_a_running_study_is_refused(tmp_path):
    busy = pytest.raises(UsageError, match="in use by another process")
    with files.locked(tmp_path / "out"), busy:
        study.run_study(CONFIGS, tmp_path / "out", Here(), quiet=True)


@pytest.mark.parametrize(
    ("arguments", "keyword"),
    [
        (["--agents", "dqn,dqn"], "twice"),
        (["--agents", "dqn,sarsa"], "one of gbdqn, dqn"),
        (["--seeds", "3,3"], "twice"),
        (["--seeds", "3,03"], "twice"),
        (["--seeds", "0"], "--seeds"),
        (["--seeds", "00"], "--seeds"),
        (["--seeds", "3,"], "--seeds"),
        (["--seeds", "999999999"], "a study has from 1 to 10,000 runs"),
        (["--seeds", "1,4294967296"], "seed must be a whole number"),
        (["--seeds", "-1"], "--seeds"),
        (["--seeds", "a"], "--seeds"),
        (["--jobs", "0"], "jobs must be a whole number from 1 to 1,000"),
        (["--jobs", "1001"], "jobs must be a whole number from 1 to 1,000"),
        (["--seed", "1"], "--seeds"),
        (["--dask", "nowhere"], "tcp://host:8786" if DISTRIBUTED else "cluster"),
        (["--dask", "tls://127.0.0.1:9"], "tcp://host:8786" if DISTRIBUTED else "cluster"),
    ],
)
def test_a_wrong_command_is_refused(tmp_path, capsys, arguments, keyword):
    start = ["study", "--env", "cartpole", "--out", str(tmp_path / "out")]
    refused(capsys, tmp_path, [*start, *arguments], keyword)


def test_a_single_seed_has_no_spread(tmp_path, capsys, monkeypatch):
    train_here(monkeypatch)
    arguments = ["study", "--agents", "dqn,random", "--seeds", "1", "--quiet", *flags(**DRIFTING)]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert printed.count("±     –") == 2 and "±   0" not in printed


def compare_arguments(out, *more):
    start = ["compare", "--agents", "dqn,random", "--quiet", *flags(**DRIFTING)]
    return [*start, "--out", str(out), *more]


def test_a_comparison_is_a_study_of_one_seed(tmp_path, sequential, capsys):
    """Each agent's folder has the same bytes as in a study; repeating it writes no run."""
    ages = []
    for jobs in ("1", "2"):
        assert main(compare_arguments(tmp_path / "out", "--jobs", jobs)) == 0
        written = contents(tmp_path / "out")
        for name, content in sequential.items():
            folder, _, file = name.partition("/")
            if file and folder.endswith("-0"):
                assert written.pop(f"{folder.removesuffix('-0')}/{file}") == content
        assert set(written) == {"comparison.png", "dqn", "random", "results.json", "study.json"}
        assert "seed 0: mean return, drop and recovery per regime" in capsys.readouterr().out
        ages = ages or [path.stat().st_mtime_ns for path in sorted((tmp_path / "out").glob("*/*"))]
    assert ages == [path.stat().st_mtime_ns for path in sorted((tmp_path / "out").glob("*/*"))]


def test_a_comparison_without_a_description_is_continued(tmp_path):
    runs.train(AGENTS["dqn"], tmp_path / "out" / "dqn", quiet=True)
    summary = tmp_path / "out" / "dqn" / "summary.json"
    age = summary.stat().st_mtime_ns
    assert main(compare_arguments(tmp_path / "out")) == 0
    assert summary.stat().st_mtime_ns == age


def test_a_run_that_the_cluster_cancels_fails(tmp_path):
    """A scheduler that dies cancels what it has not begun."""

    class Dies(Here):
        def submit(self, *_):
            future = Future()
            future.cancel()
            future.set_running_or_notify_cancel()
            return future

    failed = study.run_study(FIRST, tmp_path, Dies(), quiet=True)
    assert failed == {"dqn-0": "CancelledError: by the cluster"}


def kill_when(ready, pid):
    wait_for(ready)
    os.kill(pid, signal.SIGKILL)


@mock.patch.dict(os.environ)  # Dask sets MALLOC_TRIM_THRESHOLD_ here, among others, and leaves it
@pytest.mark.filterwarnings("ignore")  # and warns of processes that have died
def test_a_dask_cluster_of_which_a_worker_is_killed_writes_the_same_bytes(tmp_path, sequential):
    """Two worker processes, one of which is killed as soon as a run has begun."""
    distributed = pytest.importorskip("distributed")
    options = dict(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        first, _ = client.run(os.getpid).values()
        begun = (lambda: list((tmp_path / "out").glob("*/episodes.csv")), first)
        killer = threading.Thread(target=kill_when, args=begun)
        killer.start()
        executor = client.get_executor(pure=False)
        assert study.run_study(CONFIGS, tmp_path / "out", executor, quiet=True) == {}
        killer.join()
        assert first not in client.run(os.getpid).values()
    assert contents(tmp_path / "out") == sequential

"""A run's folder has the same bytes from every process, even if killed and resumed."""

import json
import random
import re
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pytest
from helpers import (
    PATIENCE,
    SMALL,
    Crash,
    checkpoints_every,
    cli,
    command,
    contents,
    crashing_after,
    drifts_at,
    environ,
    exact_state,
    flags,
    refused,
    train_here,
)
from matplotlib.figure import Figure

from gbdqn_ref import (
    DivergenceError,
    UsageError,
    __main__,
    checkpoint,
    drift,
    plots,
    provenance,
    runs,
    tables,
    train,
)
from gbdqn_ref import config as config_module
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import Config

FILES = {"config.json", "episodes.csv", "checkpoint.npz", "summary.json", "curve.png"}
DRIFTING = SMALL | dict(  # slow enough to be killed before the end
    episodes=30, capacity=400, batch_size=64, schedule=drifts_at(8, 15, 22)
)
SETTINGS = flags(**DRIFTING)
ALWAYS = """
import sys
from gbdqn_ref import __main__, runs
runs.CHECKPOINT_SECONDS = -1  # a checkpoint at every episode
sys.exit(__main__.main())
"""
both = pytest.mark.parametrize("agent", ["dqn", "gbdqn"])


def config_of(agent, seed=0):
    return Config.preset("cartpole", agent=agent, seed=seed, **DRIFTING)


def restore(files, folder):
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """{agent: the files of an uninterrupted run}, made in this process."""
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
def test_another_seed_writes_different_bytes(tmp_path, undisturbed, agent):
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
    """kill -9 at random moments of a process that writes a checkpoint at every episode.

    A process that ends before it is killed ends with the same bytes too, and the run starts over.
    """
    out, rng, kills = tmp_path / "run", random.Random(agent), 0
    streams = dict(stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    for _ in range(12):
        enough = lines(out / "episodes.csv") + rng.randint(2, 6)
        how = ["--resume"] if out.exists() else ["--agent", agent, *SETTINGS]
        arguments = command("train", *how, "--out", out, "--quiet", start=("-c", ALWAYS))
        with subprocess.Popen(arguments, env=environ(), **streams) as process:
            while process.poll() is None and lines(out / "episodes.csv") < enough:
                time.sleep(0.001)
            time.sleep(rng.uniform(0, 0.03))
            process.kill()
            assert process.stderr.read() == b""
        assert process.returncode in (0, -signal.SIGKILL)
        kills += process.returncode != 0
        if kills == 4:
            break
        if process.returncode == 0:
            assert contents(out) == undisturbed[agent]
            shutil.rmtree(out)
    assert kills >= 3, "the machine is too fast for this test"
    assert cli("train", "--resume", "--out", out, "--quiet")[0] == 0
    assert contents(out) == undisturbed[agent]


@pytest.fixture
def interrupted(tmp_path):
    """The folder of a GB-DQN that crashed in episode 20, with a checkpoint after 18."""
    with pytest.MonkeyPatch.context() as patch:
        checkpoints_every(9, patch)
        patch.setattr(runs, "run", crashing_after(20))
        with pytest.raises(Crash):
            runs.train(config_of("gbdqn"), tmp_path / "interrupted", quiet=True)
    assert lines(tmp_path / "interrupted" / "episodes.csv") == 22
    written = {"config.json", "episodes.csv", "checkpoint.npz"}
    assert set(contents(tmp_path / "interrupted")) == written
    return tmp_path / "interrupted"


@pytest.mark.parametrize("agent", AGENTS)
def test_every_agent_goes_on_as_if_it_had_never_stopped(tmp_path, monkeypatch, agent):
    """Random too, whose evaluation has its own generator."""
    config = Config(agent=agent, **SMALL | {"schedule": drifts_at(3, 6, 9)})
    monkeypatch.setattr(Figure, "savefig", lambda self, file, **_: file.write(b"PNG"))
    runs.train(config, tmp_path / "straight", quiet=True)
    checkpoints_every(4, monkeypatch)
    with monkeypatch.context() as patch:
        patch.setattr(runs, "run", crashing_after(10))
        with pytest.raises(Crash):
            runs.train(config, tmp_path / "stopped", quiet=True)
    assert (tmp_path / "stopped" / "checkpoint.npz").exists()
    runs.train(config, tmp_path / "stopped", resume=True, quiet=True)
    assert contents(tmp_path / "stopped") == contents(tmp_path / "straight")


def test_without_a_checkpoint_a_run_starts_over(interrupted, undisturbed):
    (interrupted / "checkpoint.npz").unlink()
    runs.train(config_of("gbdqn"), interrupted, resume=True, quiet=True)
    assert contents(interrupted) == undisturbed["gbdqn"]


@pytest.mark.parametrize("tail", [b"21,2,,1", b"21,2,,14.0,14,", b"\n\n", b"\xff\xfe"])
def test_a_half_written_line_after_the_checkpoint_does_no_harm(interrupted, undisturbed, tail):
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
def test_a_run_resumes_with_the_same_flags_or_none(interrupted, undisturbed, arguments, capsys):
    resume = ["train", "--resume", "--out", str(interrupted), "--quiet"]
    assert __main__.main([*resume, *arguments]) == 0
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


def test_ctrl_c_leaves_a_hint_and_the_run_can_be_resumed(
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
    assert repr(runs.read_episodes(tmp_path)) == repr(yielded)  # as text, since nan != nan
    events = {record["episode"]: record["event"] for record in yielded if record["event"]}
    assert events == {8: "drift", 15: "drift", 22: "reset"}
    assert [record["regime"] for record in yielded] == [0] * 8 + [1] * 7 + [2] * 7 + [3] * 8
    returns, lengths, steps = (
        [record[name] for record in yielded] for name in ("return", "length", "steps")
    )
    assert returns == lengths, "CartPole's reward is 1 per step"
    assert np.cumsum(lengths).tolist() == steps


def test_a_share_that_is_no_number_is_refused_with_its_file(tmp_path, undisturbed):
    summary = json.loads(undisturbed["gbdqn"]["summary.json"]) | {"recency_share_of_replay": "half"}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(UsageError, match=r"summary\.json is damaged"):
        runs.read_summary(tmp_path)


def test_a_line_with_a_value_too_many_is_refused(tmp_path, undisturbed):
    (tmp_path / "episodes.csv").write_bytes(undisturbed["dqn"]["episodes.csv"][:-1] + b",7\n")
    with pytest.raises(UsageError, match="damaged in line 31"):
        runs.read_episodes(tmp_path)


@both
def test_config_json_holds_every_setting_and_what_made_the_run(tmp_path, undisturbed, agent):
    (tmp_path / "config.json").write_bytes(undisturbed[agent]["config.json"])
    content = json.loads(undisturbed[agent]["config.json"])
    assert runs.read_config(tmp_path) == config_of(agent)
    assert content["config"] == config_of(agent).to_dict()
    assert content["config"]["replay"] is None
    assert content["own"]["replay"] == {"gbdqn": "recency", "dqn": "proportional"}[agent]
    assert Config.from_dict(content["config"] | content["own"]) == config_of(agent).resolved()
    made_by = {"versions": content["versions"], "code": content["code"]}
    assert made_by == provenance.of(config_of(agent))
    assert content["versions"]["numpy"] == np.__version__
    assert content.keys() == {"config", "own", "versions", "code"}


@both
def test_summary_json_summarises_episodes_csv(undisturbed, agent):
    summary = json.loads(undisturbed[agent]["summary.json"])
    records = list(train.run(config_of(agent)))
    returns = [record["return"] for record in records]
    assert summary["final_return"] == pytest.approx(np.mean(returns))
    assert (summary["episodes"], summary["steps"]) == (30, records[-1]["steps"])
    means = [np.mean(returns[a:b]) for a, b in ((0, 8), (8, 15), (15, 22), (22, 30))]
    assert [row["mean_return"] for row in summary["regimes"]] == pytest.approx(means)
    assert 15 < summary["random_return"] < 30, "CartPole's random policy"
    assert ("recency_share_of_replay" in summary) == (agent == "gbdqn")


@both
def test_the_last_checkpoint_is_the_agent_at_the_end_of_the_run(tmp_path, undisturbed, agent):
    (tmp_path / "checkpoint.npz").write_bytes(undisturbed[agent]["checkpoint.npz"])
    restored, trained = train.make_agent(config_of(agent)), train.make_agent(config_of(agent))
    list(train.run(config_of(agent), trained))
    assert checkpoint.load(tmp_path / "checkpoint.npz", restored) == 30
    s = np.eye(4, dtype=np.float32)
    np.testing.assert_array_equal(restored.q(s), trained.q(s))


@both
def test_the_curve_shows_the_stored_episodes(tmp_path, undisturbed, agent):
    restore(undisturbed[agent], tmp_path / "run")
    records = {agent: runs.read_episodes(tmp_path / "run")}
    level = runs.read_summary(tmp_path / "run")["random_return"]
    plots.save(plots.learning_curves(records, config_of(agent), level), tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes() == undisturbed[agent]["curve.png"]


@pytest.mark.parametrize("env", drift.ENVIRONMENTS)
def test_every_environment_runs_from_the_command_line(tmp_path, env, capsys):
    settings = flags(episodes=2, hidden=[4], schedule=[{"episode": 1, "gravity": 1.1}])
    arguments = ["--env", env, "--preset", "fast", *settings, "--out", str(tmp_path / "run")]
    assert __main__.main(["train", *arguments, "--quiet"]) == 0
    assert set(contents(tmp_path / "run")) == FILES
    assert "gravity × 1.1" in capsys.readouterr().out


def test_the_summary_has_the_share_of_samples_drawn_by_recency(tmp_path, undisturbed):
    """(1 − β) Σ p^time, as a share of the sum over both kinds of priority (Eq. 10)."""
    restore(undisturbed["gbdqn"], tmp_path)
    config, agent = runs.read_agent(tmp_path)
    by_time = sum(np.exp(-config.recency_rate * age) for age in range(len(agent.replay)))
    by_error = agent.replay.tree.levels[0][: len(agent.replay)].sum()
    share = (1 - config.mix) * by_time / ((1 - config.mix) * by_time + config.mix * by_error)
    assert runs.read_summary(tmp_path)["recency_share_of_replay"] == pytest.approx(share, rel=1e-6)


@pytest.mark.parametrize("alpha", [0.1, "closed-form"])
def test_the_last_checkpoint_and_the_last_evaluation_are_of_the_finished_agent(tmp_path, alpha):
    """With target=frozen the last learner counts only at the end of training."""
    config = Config(**SMALL | {"schedule": drifts_at(3, 6, 9)}, target="frozen", alpha=alpha)
    summary = runs.train(config, tmp_path, quiet=True)
    trained = train.make_agent(config)
    list(train.run(config, trained))
    again, agent = runs.read_agent(tmp_path)
    assert again == config and len(agent.ensemble) == 3 == len(trained.ensemble) + 1
    assert exact_state(agent) == exact_state(trained.finish())
    env = drift.make("cartpole", config.schedule)
    assert train.evaluate_regimes(agent, env, config) == summary["evaluation"][-1]


def test_a_short_run_makes_few_environments(tmp_path, monkeypatch):
    """At most one per episode, though each of 5 regimes is evaluated after every regime."""
    made, make = [], drift.gymnasium.make

    def counted(*args, **options):
        made.append(args)
        return make(*args, **options)

    monkeypatch.setattr(drift.gymnasium, "make", counted)
    schedule = [{"episode": k, "length": 1 + k / 10} for k in (1, 2, 3, 4)]
    config = Config(**SMALL | {"episodes": 6, "schedule": schedule})
    summary = runs.train(config, tmp_path / "run", quiet=True)
    assert len(summary["regimes"]) == 5 and 1 <= len(made) <= 6


# --- going on under other versions ----------------------------------------------------------------


def other_numpy(monkeypatch):
    versions = provenance.versions() | {"numpy": "9.9"}
    monkeypatch.setattr(provenance, "versions", lambda: versions)
    return [f"numpy {np.__version__} → 9.9"]


def other_code(monkeypatch):
    for name in ("optim", "gbdqn"):
        monkeypatch.setitem(provenance.SOURCES, name, provenance.SOURCES[name] + b"x = 1\n")
    code = provenance.code(config_of("gbdqn"))
    return [f"{name} " for name in ("optim", "gbdqn")] + [f" → {code['gbdqn']}"]


@pytest.mark.parametrize("change", [other_numpy, other_code])
def test_a_run_goes_on_under_other_versions_only_where_that_is_accepted(
    interrupted, undisturbed, monkeypatch, capsys, change
):
    first, said = provenance.of(config_of("gbdqn")), change(monkeypatch)
    resume = ["train", "--resume", "--out", str(interrupted), "--quiet"]
    for words in [*said, "--accept-versions"]:
        refused(capsys, interrupted, resume, words)
    summary = runs.train(config_of("gbdqn"), interrupted, resume=True, quiet=True, accept=True)
    left = contents(interrupted)
    content = json.loads(left.pop("config.json"))
    assert {"versions": content["versions"], "code": content["code"]} == first
    assert content["continued"] == [{"episode": 18, **provenance.of(config_of("gbdqn"))}] != [first]
    assert left == {name: undisturbed["gbdqn"][name] for name in left}
    monkeypatch.undo()  # a complete run is read under any versions
    assert runs.train(config_of("gbdqn"), interrupted, resume=True, quiet=True) == summary


def test_what_was_accepted_last_is_what_counts(interrupted, undisturbed, monkeypatch):
    """After another interruption the new version is accepted silently; the old one is not."""

    def accepted(*arguments):
        raise Crash
        yield

    config = config_of("gbdqn")
    with monkeypatch.context() as patch:
        other_numpy(patch)
        patch.setattr(runs, "run", accepted)
        with pytest.raises(Crash):
            runs.train(config, interrupted, resume=True, quiet=True, accept=True)
        with pytest.raises(Crash):
            runs.train(config, interrupted, resume=True, quiet=True)
        assert runs.changes(interrupted) == []
    with pytest.raises(UsageError, match=r"numpy 9\.9 → "):
        runs.train(config, interrupted, resume=True, quiet=True)
    runs.train(config, interrupted, resume=True, quiet=True, accept=True)
    continued = json.loads((interrupted / "config.json").read_bytes())["continued"]
    numpy = [each["versions"]["numpy"] for each in continued]
    assert numpy == ["9.9", np.__version__]
    assert (interrupted / "episodes.csv").read_bytes() == undisturbed["gbdqn"]["episodes.csv"]


def test_comments_and_docstrings_may_change_before_a_resume(interrupted, undisturbed, monkeypatch):
    for name, source in provenance.SOURCES.items():
        monkeypatch.setitem(provenance.SOURCES, name, source + b"\n# a comment\n")
    runs.train(config_of("gbdqn"), interrupted, resume=True, quiet=True)
    assert contents(interrupted) == undisturbed["gbdqn"]


def aged(folder):
    """Rewrite config.json as it was before the code was recorded and settings could be None."""
    content = json.loads((folder / "config.json").read_bytes())
    settings = content["config"] | content["own"]
    old = {"config": settings, "versions": {"numpy": content["versions"]["numpy"]}}
    (folder / "config.json").write_text(json.dumps(old))
    return old


def test_a_run_from_before_the_code_was_on_record_is_read_and_goes_on_where_accepted(
    interrupted, undisturbed
):
    old, config = aged(interrupted), config_of("gbdqn")
    assert runs.read_config(interrupted).resolved() == config.resolved()
    assert runs.read_agent(interrupted)[1].steps > 0
    with pytest.raises(UsageError, match=r"its code is not on record.*--accept-versions"):
        runs.train(config, interrupted, resume=True, quiet=True)
    runs.train(config, interrupted, resume=True, quiet=True, accept=True)
    content = json.loads((interrupted / "config.json").read_bytes())
    assert content | old == content and content["continued"][0]["episode"] == 18
    left = contents(interrupted)
    assert all(left[name] == undisturbed["gbdqn"][name] for name in FILES - {"config.json"})


def test_a_setting_that_an_older_run_does_not_know_has_its_default(
    interrupted, undisturbed, monkeypatch
):
    """A new field of Config leaves unfinished runs and their checkpoints usable."""

    @dataclass(frozen=True)
    class Later(Config):
        novelty: Annotated[float, config_module.POSITIVE] = 0.5

    settings = config_of("gbdqn").to_dict()
    monkeypatch.setitem(config_module.SETTINGS, "novelty", ((float,), config_module.POSITIVE))
    for module in (runs, checkpoint):
        monkeypatch.setattr(module, "Config", Later)
    later = Later.from_dict(settings)
    with pytest.raises(UsageError, match=r"other settings \(novelty=0\.5\)"):
        runs.train(replace(later, novelty=0.25), interrupted, resume=True, quiet=True)
    runs.train(later, interrupted, resume=True, quiet=True)
    for name in ("episodes.csv", "summary.json", "config.json"):
        assert (interrupted / name).read_bytes() == undisturbed["gbdqn"][name]


def test_an_agents_own_setting_of_the_past_holds_for_its_runs(
    interrupted, undisturbed, monkeypatch
):
    """A run keeps the replay it began with even if GB-DQN's default changes."""
    today = AGENTS["gbdqn"]._replace(own={"replay": "uniform"})
    monkeypatch.setitem(AGENTS, "gbdqn", today)
    assert runs.read_config(interrupted).replay == "recency"
    with pytest.raises(UsageError, match=r"other settings \(replay='recency'\)"):
        runs.train(config_of("gbdqn"), interrupted, resume=True, quiet=True)
    runs.train(runs.read_config(interrupted), interrupted, resume=True, quiet=True)
    assert contents(interrupted) == undisturbed["gbdqn"]


# --- what fails costs nothing else ----------------------------------------------------------------


def test_a_picture_that_fails_is_told_in_a_line_and_drawn_the_next_time(
    tmp_path, undisturbed, monkeypatch, capsys
):
    def fail(*arguments):
        raise RuntimeError("latex was not found\non this machine")

    with monkeypatch.context() as patch:
        patch.setattr(runs.plots, "learning_curves", fail)
        summary = runs.train(config_of("dqn"), tmp_path, quiet=True)
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "curve.png" in said and "latex was not found" in said
    left = contents(tmp_path)
    assert left.keys() == FILES - {"curve.png"}
    assert left == {name: undisturbed["dqn"][name] for name in left}
    assert runs.train(config_of("dqn"), tmp_path, resume=True, quiet=True) == summary
    assert contents(tmp_path) == undisturbed["dqn"]


def test_what_a_run_that_diverges_has_written_stays(tmp_path):
    config = Config(agent="dqn", replay="uniform", lr=1e30, **SMALL | {"learning_starts": 60})
    with pytest.raises(DivergenceError) as first:
        runs.train(config, tmp_path / "run", quiet=True)
    left = contents(tmp_path / "run")
    records = runs.read_episodes(tmp_path / "run")
    assert 1 <= len(records) < 12 and f"episode {len(records)}," in str(first.value)
    assert left.keys() == {"config.json", "episodes.csv"}
    with pytest.raises(DivergenceError, match=re.escape(str(first.value))):
        runs.train(config, tmp_path / "run", resume=True, quiet=True)
    assert contents(tmp_path / "run") == left


def test_an_agent_beyond_all_memory_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    def make_agent(config):
        raise MemoryError("Unable to allocate 9. TiB")

    monkeypatch.setattr(runs, "make_agent", make_agent)
    with pytest.raises(UsageError, match=r"does not fit into memory .*9\. TiB.*smaller capacity"):
        runs.train(config_of("dqn"), tmp_path / "a" / "run", quiet=True)
    assert contents(tmp_path) == {}


FULL = """
import resource, sys
from gbdqn_ref import __main__
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
sys.exit(__main__.main())
"""


@pytest.mark.parametrize(("limit", "name"), [(400, "config.json"), (8000, "checkpoint.npz")])
def test_a_disk_that_is_too_small_names_the_file_and_keeps_the_rest(
    tmp_path, undisturbed, limit, name
):
    out = tmp_path / "run"
    arguments = ["train", "--agent", "dqn", *SETTINGS, "--out", out, "--quiet"]
    limited = command(limit, *arguments, start=("-c", FULL))
    full = subprocess.run(limited, env=environ(), capture_output=True, text=True, timeout=PATIENCE)
    assert full.returncode == 2 and full.stderr.count("\n") == 1
    assert f"File too large: {str(out / name)!r}" in full.stderr
    kept = set() if name == "config.json" else {"run", "run/config.json", "run/episodes.csv"}
    assert set(contents(tmp_path)) == kept
    runs.train(config_of("dqn"), out, resume=out.exists(), quiet=True)
    assert contents(out) == undisturbed["dqn"]


# --- the command line -----------------------------------------------------------------------------


def test_compare_trains_both_agents_and_changes_nothing_when_repeated(tmp_path, undisturbed):
    out = tmp_path / "both"
    status, stdout, stderr = cli("compare", *SETTINGS, "--out", out, "--quiet")
    assert (status, stderr) == (0, "")
    first = contents(out)
    assert first.pop("comparison.png")
    assert first.pop("study.json") and first.pop("results.json")
    assert first == dict.fromkeys(undisturbed) | {
        f"{agent}/{name}": undisturbed[agent][name] for agent in undisturbed for name in FILES
    }
    first = contents(out)
    assert cli("compare", *SETTINGS, "--out", out, "--quiet") == (0, stdout, "")
    assert contents(out) == first


def test_compare_finishes_interrupted_runs(tmp_path, interrupted, undisturbed, monkeypatch):
    train_here(monkeypatch)
    out = tmp_path / "both"
    shutil.copytree(interrupted, out / "gbdqn")
    assert __main__.main(["compare", *SETTINGS, "--out", str(out), "--quiet"]) == 0
    for agent, written in undisturbed.items():
        assert contents(out / agent) == written


def test_compare_shows_the_stored_results(tmp_path, undisturbed, capsys):
    for agent, written in undisturbed.items():
        restore(written, tmp_path / agent)
    assert __main__.main(["compare", *SETTINGS, "--out", str(tmp_path)]) == 0
    printed, config = capsys.readouterr().out, config_of("dqn")
    agents = ("gbdqn", "dqn")
    summaries = {agent: json.loads(undisturbed[agent]["summary.json"]) for agent in agents}
    tables.show(tables.regimes(summaries, config))
    assert printed.startswith(capsys.readouterr().out)
    records = {agent: runs.read_episodes(tmp_path / agent) for agent in agents}
    level = summaries["dqn"]["random_return"]
    plots.save(plots.learning_curves(records, config, level), tmp_path / "again.png")
    drawn = (tmp_path / name for name in ("again.png", "comparison.png"))
    assert len({path.read_bytes() for path in drawn}) == 1


def test_the_table_is_printed_and_the_default_folder_has_the_runs_name(tmp_path):
    status, stdout, stderr = cli("train", *SETTINGS, "--agent", "dqn", cwd=tmp_path)
    assert (status, stderr) == (0, "") and "regime" in stdout
    assert set(contents(tmp_path / "runs" / "cartpole-dqn-0")) == FILES


@pytest.mark.parametrize("arguments", [["--help"], ["train", "--help"], ["compare", "--help"]])
def test_help_prints_the_usage(arguments, capsys):
    with pytest.raises(SystemExit, match=r"^0$"):
        __main__.main(arguments)
    assert capsys.readouterr().out.startswith("usage: python -m gbdqn_ref")


def test_a_run_does_not_start_in_the_folder_of_another(tmp_path, undisturbed):
    restore(undisturbed["dqn"], tmp_path)
    with pytest.raises(UsageError, match="--resume"):
        runs.train(config_of("dqn"), tmp_path, quiet=True)
    assert contents(tmp_path) == undisturbed["dqn"]


# --- evaluation in every regime -------------------------------------------------------------------


@both
def test_after_each_regime_the_agent_is_evaluated_in_every_regime(tmp_path, undisturbed, agent):
    """The last row is the return of the checkpoint's agent in physics that are set by hand."""
    summary = json.loads(undisturbed[agent]["summary.json"])
    assert [len(row) for row in summary["evaluation"]] == [4, 4, 4, 4]
    restore(undisturbed[agent], tmp_path / "run")
    config = config_of(agent)
    learner = train.make_agent(config)
    checkpoint.load(tmp_path / "run" / "checkpoint.npz", learner)
    physics = [(1, 1), (2, 1), (2, 2), (1, 1)]
    for (length, gravity), mean in zip(physics, summary["evaluation"][-1], strict=True):
        env = drift.make("cartpole", [{"episode": 0, "length": length, "gravity": gravity}])
        assert train.evaluate(learner, env, 5, config.seed).mean() == mean


@both
def test_the_evaluation_does_not_change_the_training(monkeypatch, undisturbed, agent):
    monkeypatch.setattr(train, "evaluate_regimes", lambda *_: [])
    without = list(train.run(config_of(agent)))
    monkeypatch.undo()
    with_it = [record | {"evaluation": []} for record in train.run(config_of(agent))]
    assert repr(with_it) == repr(without)  # as text, since nan != nan


def test_regimes_beyond_the_end_of_a_run_are_not_evaluated():
    config = Config.preset("cartpole", agent="dqn", **DRIFTING | {"episodes": 10})
    evaluations = {record["episode"]: len(record["evaluation"]) for record in train.run(config)}
    assert {episode: n for episode, n in evaluations.items() if n} == {7: 2, 9: 2}

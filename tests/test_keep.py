"""The study of what to keep at a drift: its program, end to end, and its fast version."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from helpers import own_signals

from gbdqn_ref import UsageError, files, runs, train
from gbdqn_ref import study as studies
from gbdqn_ref.__main__ import program as run_program
from gbdqn_ref.config import Config
from gbdqn_ref.schedule import Regime

KEEP = Path(__file__).parents[1] / "benchmarks" / "keep"
sys.path.append(str(KEEP))
import again  # noqa: E402
import calibrate  # noqa: E402
import cartpole  # noqa: E402
import conclude  # noqa: E402
import decide  # noqa: E402
import evidence  # noqa: E402
import forgetting  # noqa: E402
import study  # noqa: E402
from protocol import Protocol  # noqa: E402

TINY = """
question = "Does detection help?"
decisive = ["drop"]
[seeds]
tune = [1000, 1019]
report = [2000, 2099]
[looks]
seeds = [2]
error = 0.05
[tuning]
settings = 3
first_seeds = [1000]
best = 2
further_seeds = [1001, 1002]
shared = { lr = 4.0 }
epsilon_restart = [0.0, 0.5]
[tuning.methods]
dqn = { on = "drop", arms = ["drop", "detects"] }
[tasks.mini]
preset = "cartpole-fast"
parts = ["all"]
set.episodes = 8
set.hidden = [8]
set.learning_starts = 20
set.schedule = [{ episode = 3, length = 2.0 }, { episode = 6, reset = true }]
[tasks.mini-null]
preset = "cartpole-fast"
parts = ["null"]
tuned_on = "mini"
set.episodes = 6
set.hidden = [8]
set.learning_starts = 20
set.schedule = [{ episode = 3, length = 1.0 }]
[arms.drop]
agent = "dqn"
set = { keep_data = 0.0 }
parts = ["all", "null"]
[arms.detects]
agent = "gbdqn-reuse"
set = { drift_signal = [4, 6] }
parts = ["all"]
[[hypotheses]]
id = "H"
says = "detection helps"
tasks = ["mini"]
arm = "detects"
against = ["drop"]
margin = 0.0
"""


ROW = (study.RESULTS / "rows.jsonl").read_bytes().splitlines()[0]


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """A function that runs the program on the tiny protocol, in a folder and a thread."""
    monkeypatch.setattr(study, "cluster", lambda _: ThreadPoolExecutor(1))
    path = tmp_path / "tiny.toml"
    path.write_text(TINY, encoding="utf-8")
    folders = [f"--out={tmp_path / 'out'}", f"--results={tmp_path / 'results'}"]
    return lambda *words: study.main([*words, f"--protocol={path}", *folders])


def stored(tmp_path):
    lines = (tmp_path / "results" / "rows.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines]


def test_a_figure_of_the_answer_is_run_again(tmp_path, tiny, capsys):
    """Its two arms are trained, and their difference is that of the rows."""
    tiny("tune", "--tasks=mini")
    shutil.copytree(tmp_path / "results", tmp_path / "out" / "results")
    options = [f"--protocol={tmp_path / 'tiny.toml'}", f"--out={tmp_path / 'out'}", "--seeds=2"]
    again.main(["mini", "detects", "drop", *options])
    rows = (tmp_path / "out" / "results" / "rows.jsonl").read_text(encoding="utf-8").splitlines()
    value = {(row["arm"], row["seed"]): row["value"] for row in map(json.loads, rows)}
    leads = np.array([value["detects", k] - value["drop", k] for k in (2000, 2001)])
    said = f"mini: detects minus drop: {evidence.words(leads)}, 2 seeds\n"
    assert capsys.readouterr().out == said


def test_from_tuning_to_rows(tmp_path, tiny, monkeypatch):
    with pytest.raises(UsageError, match="reported after mini is tuned"):
        tiny("report", "--tasks=mini", "--seeds=2")
    tiny("tune", "--tasks=mini")
    tried = json.loads((tmp_path / "results" / "mini-tuned.json").read_text(encoding="utf-8"))
    first, best = (np.array([mean for _, mean in tried["dqn"][part]]) for part in ("first", "best"))
    assert len(first) == 3 and len(best) == 2
    kept = [k for k, _ in tried["dqn"]["best"]]
    assert kept == np.argsort(first)[::-1][:2].tolist()
    factors = tried["dqn"]["first"][kept[int(best.argmax())]][0]
    assert tried["dqn"]["chosen"]["lr"] == pytest.approx(1e-3 * factors["lr"])

    with pytest.raises(UsageError, match="there is no arm 'drops' in the protocol"):
        tiny("report", "--tasks=mini", "--arms=drops", "--seeds=2")
    tiny("report", "--tasks=mini", "--arms=drop", "--seeds=2")
    assert {row["arm"] for row in stored(tmp_path)} == {"drop"}
    tiny("report", "--tasks=mini,mini-null", "--seeds=2")
    rows = stored(tmp_path)
    named = [(row["task"], row["arm"], row["seed"]) for row in rows]
    assert named == [
        *[("mini", arm, seed) for arm in ("drop", "detects") for seed in (2000, 2001)],
        *[("mini-null", "drop", seed) for seed in (2000, 2001)],
    ]
    folder = tmp_path / "out" / "reported" / "mini" / "detects" / "detects-2001"
    config, records = runs.read_config(folder), runs.read_episodes(folder)
    assert config.lr == tried["dqn"]["chosen"]["lr"] and config.drift_signal == [4, 6]
    returns = np.array([record["return"] for record in records])
    assert rows[3]["value"] == pytest.approx(returns[3:].mean(), abs=1e-4)
    assert rows[3]["regimes"] == pytest.approx(
        [returns[:3].mean(), returns[3:6].mean(), returns[6:].mean()], abs=1e-4
    )
    assert rows[3]["final"] == pytest.approx(returns.mean(), abs=1e-4)
    assert len(rows[3]["evaluation"]) == 3
    with np.load(tmp_path / "results" / "mini.npz", allow_pickle=False) as arrays:
        assert sorted(arrays) == ["drop-2000", "drop-2001"], "of the decisive arm only"
        np.testing.assert_allclose(arrays["drop-2001"][3:].mean(), rows[1]["value"], rtol=1e-5)
    assert not list(tmp_path.glob("out/reported/**/checkpoint.npz"))

    before = (tmp_path / "results" / "rows.jsonl").read_bytes()
    monkeypatch.setattr(studies, "run_study", lambda *_, **__: pytest.fail("trained again"))
    tiny("report", "--tasks=mini,mini-null", "--seeds=2")
    tiny("collect")
    assert (tmp_path / "results" / "rows.jsonl").read_bytes() == before


REGIMES = [Regime(20, 60, {}, "drift")]


@pytest.mark.parametrize(
    ("after", "episodes"),
    [
        ([1.0] * 40, 0),
        ([2.0] * 40, 0),
        ([0.0] * 10 + [1.0] * 30, 19),  # nine of the last ten are 1
        ([np.nan] * 2 + [0.0] * 8 + [1.0] * 30, 20),  # interpolated to 0.67, 0.33
        ([0.0] * 15 + [0.8] * 25, None),
        ([1.0] * 5 + [0.0] * 20 + [1.0] * 15, 34),
    ],
)
def test_recovery_is_counted_from_the_start_of_the_regime(after, episodes):
    x = np.array([np.nan] * 5 + [1.0] * 15 + after)
    assert study.recoveries(x, REGIMES) == [episodes]


def test_a_regime_shorter_than_the_mean_has_no_fall():
    assert study.recoveries(np.array([1.0] * 20 + [0.0] * 9), [Regime(20, 29, {}, "drift")]) == [0]


def test_a_row_that_tuning_made_stale_is_refused(tmp_path, tiny):
    tiny("tune", "--tasks=mini")
    tiny("report", "--tasks=mini", "--seeds=1")
    path = tmp_path / "results" / "mini-tuned.json"
    tried = json.loads(path.read_text(encoding="utf-8"))
    tried["dqn"]["chosen"]["lr"] *= 2
    path.write_text(json.dumps(tried), encoding="utf-8")
    with pytest.raises(UsageError, match="made with other settings"):
        tiny("collect")


def test_a_diverged_run_counts_as_the_random_policy(tmp_path, tiny):
    """It has a row, so it is not drawn again; another failure ends the study."""
    tiny("tune", "--tasks=mini")
    path = tmp_path / "results" / "mini-tuned.json"
    tried = json.loads(path.read_text(encoding="utf-8"))
    tried["dqn"]["chosen"]["lr"] = 1e30
    path.write_text(json.dumps(tried), encoding="utf-8")
    tiny("report", "--tasks=mini-null", "--seeds=1")
    (row,) = stored(tmp_path)
    protocol = Protocol(tmp_path / "tiny.toml", study.chosen(tmp_path / "results"))
    config = protocol.reported("mini-null", "drop", 2000)
    assert "DivergenceError" in row["diverged"]
    assert row["value"] == runs.random_return(config) and row["regimes"] == [row["value"]] * 2
    with pytest.raises(UsageError, match="dqn, seed 2000: MemoryError"):
        study.diverged(protocol.reported("mini-null", "drop", 2000), "MemoryError: 9 GiB")


@pytest.mark.parametrize("program", [cartpole, forgetting])
def test_the_page_has_the_table_of_the_stored_files(program):
    lines = (KEEP / "README.md").read_text(encoding="utf-8").splitlines()
    table = program.table(program.RESULTS)
    assert len(table) == len(program.ARMS) and set(table) <= set(lines)


def test_the_stored_runs_take_at_most_3_mb():
    names = "rows.jsonl", *(f"{task}.npz" for task in Protocol().tasks)
    paths = [path for name in names if (path := study.RESULTS / name).exists()]
    assert sum(path.stat().st_size for path in paths) <= 3_000_000


WRONG = {
    "no seeds": (study, ["report", "--seeds=0"], "--seeds: must be a whole number from 1"),
    "a negative count": (
        study,
        ["tune", "--jobs=-1"],
        "from 1 to 1000, not '-1'",
    ),
    "seeds to tune": (study, ["tune", "--seeds=3"], "--arms and --seeds are options of `report`"),
    "tasks to collect": (study, ["collect", "--tasks=acrobot"], "`collect` takes all tasks"),
    "an unknown command": (study, ["reprot"], "invalid choice: 'reprot'"),
    "no task": (study, ["report", "--tasks="], "--tasks: must not be empty"),
    "two tasks": (
        again,
        ["acrobot,cartpole", "dqn", "twin"],
        "there is no task 'acrobot,cartpole'",
    ),
    "an unknown task": (study, ["report", "--tasks=pong"], "there is no task 'pong'"),
    "an unknown arm": (study, ["report", "--tasks=acrobot", "--arms=x"], "there is no arm 'x'"),
    "an empty address": (study, ["report", "--dask="], "--dask: must not be empty"),
    "runs that are nowhere": (study, ["collect", "--out=nowhere"], "nowhere has no folder"),
    "a file for a folder": (study, ["report", "--results=mine"], "mine is not a folder"),
    "no protocol": (study, ["report", "--protocol=nowhere.toml"], "nowhere.toml"),
    "another file as protocol": (conclude, ["--protocol=mine"], "mine is damaged"),
    "a folder as protocol": (decide, ["--protocol=."], "directory"),
    "a misspelt option": (decide, ["--paeg=x"], "unrecognized arguments: --paeg=x"),
    "no processes": (
        calibrate,
        ["record", "--jobs=0"],
        "from 1 to 1000, not '0'",
    ),
    "an empty environment": (calibrate, ["drift", "--envs=acrobot,"], "unknown environment ''"),
    "a study that is nowhere": (calibrate, ["found", "nowhere"], "no complete run in nowhere"),
    "levels of a study": (calibrate, ["levels", "mine"], "`found` takes the folders"),
    "half a seed": (
        cartpole,
        ["run", "--seeds=.5"],
        "from 1 to 1000, not '.5'",
    ),
    "a table of nothing": (cartpole, ["table", "--out=nowhere"], "there is no run in nowhere"),
    "no jobs": (forgetting, ["run", "--jobs=0"], "from 1 to 1000, not '0'"),
    "another table of nothing": (forgetting, ["table", "--out=nowhere"], "-dqn in nowhere"),
}


@pytest.mark.parametrize(("program", "words", "message"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_said_in_one_line(tmp_path, monkeypatch, capsys, program, words, message):
    own_signals(monkeypatch)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text("mine", encoding="utf-8")
    with pytest.raises(SystemExit, match="2"):
        run_program(lambda: program.main(words))
    out, error = capsys.readouterr()
    assert out == "" and error.count("\n") == 1 and message in error
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"mine"]


@pytest.mark.parametrize(
    "line", ["shared = { lr = 4.0 }\n", "settings = 3\n", "tune = [1000, 1019]\n"]
)
def test_a_method_can_only_be_tuned_by_a_whole_plan(tmp_path, line):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY.replace(line, "", 1), encoding="utf-8")
    with pytest.raises(UsageError, match=r"tiny\.toml is damaged"):
        Protocol(path)


def test_a_protocol_without_methods_has_nothing_to_tune(tmp_path):
    options = [f"--protocol={KEEP / 'hopper.toml'}", "--tasks=hopper", f"--results={tmp_path}"]
    with pytest.raises(UsageError, match="no method to tune"):
        study.main(["tune", *options])


STOPPED = """
import sys, time
from gbdqn_ref.__main__ import program
from workers import workers

def main():
    with workers(2) as pool:
        futures = [pool.submit(time.sleep, 60) for _ in range(4)]
        print("begun", flush=True)
        [future.result() for future in futures]

program(main)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_program_that_is_stopped_ends_its_workers(number):
    """Ctrl-C goes to all processes of a terminal, SIGTERM to the first alone."""
    options = dict(cwd=KEEP, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process = subprocess.Popen([sys.executable, "-c", STOPPED], start_new_session=True, **options)
    assert process.stdout.readline() == "begun\n"
    time.sleep(0.5)
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    _, error = process.communicate(timeout=30)
    assert process.returncode == 130 and error.count("\n") == 1 and "stopped" in error
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)


def test_a_folder_in_use_is_refused(tmp_path):
    """Two processes that add rows to one file would each lose the other's."""
    with files.locked(tmp_path), pytest.raises(UsageError, match="in use by another process"):
        study.main(["collect", f"--results={tmp_path}"])


def test_returns_that_could_not_be_written_are_written_the_next_time(tmp_path, tiny, monkeypatch):
    """rows.jsonl is written first; a crash or a full disk may come before the returns."""
    tiny("tune", "--tasks=mini")
    write = files.write_atomically

    def full(path, content):
        if Path(path).name == "mini.npz":
            raise OSError(28, "No space left on device", str(path))
        write(path, content)

    monkeypatch.setattr(files, "write_atomically", full)
    with pytest.raises(OSError, match="No space left"):
        tiny("report", "--tasks=mini", "--arms=drop", "--seeds=2")
    monkeypatch.setattr(files, "write_atomically", write)
    rows = (tmp_path / "results" / "rows.jsonl").read_bytes()
    assert rows and not (tmp_path / "results" / "mini.npz").exists()
    tiny("report", "--tasks=mini", "--arms=drop", "--seeds=2")
    assert (tmp_path / "results" / "rows.jsonl").read_bytes() == rows
    assert set(study.read_arrays(tmp_path / "results" / "mini.npz")) == {"drop-2000", "drop-2001"}


def test_a_run_whose_episodes_were_cut_is_not_stored(tmp_path, tiny):
    tiny("tune", "--tasks=mini")
    folder = tmp_path / "out" / "reported" / "mini" / "drop" / "drop-2000"
    protocol = Protocol(tmp_path / "tiny.toml", study.chosen(tmp_path / "results"))
    runs.train(protocol.reported("mini", "drop", 2000), folder, quiet=True)
    path = folder / "episodes.csv"
    path.write_text("".join(path.read_text().splitlines(True)[:-2]))
    with pytest.raises(UsageError, match=r"episodes.csv has {'episodes': 6}"):
        tiny("collect")
    assert (folder / "checkpoint.npz").exists()
    assert not (tmp_path / "results" / "rows.jsonl").exists()


def test_a_run_that_learns_nothing_has_no_recovery_of_its_td_error():
    assert study.recoveries(np.full(9, np.nan), [Regime(3, 9, {}, "")]) == [None]


def test_what_alarms_found_and_how_many_were_false():
    """Two of three drifts are costly: the level halves at them. The last regime changes nothing."""
    schedule = [{"episode": 100, "force": -1.0}, {"episode": 200, "reset": True}]
    schedule += [{"episode": 300, "force": 0.5}, {"episode": 400, "force": 0.5}]
    config = Config(env="cartpole", episodes=500, schedule=schedule)
    assert calibrate.drifts(config) == [100, 200, 300]
    levels = [500.0, 30.0, 500.0, 400.0, 400.0]
    evaluations = [levels, [30.0, 500.0, 30.0, 9.0, 9.0], [500.0, 30.0, 500.0, 400.0, 400.0]]
    evaluations += [levels[:4] + [100.0], levels]
    near, far = calibrate.WITHIN, calibrate.FAR
    assert calibrate.costly_drifts(config, evaluations) == [100, 200, 400]
    for alarms, expected in {
        (): (2, [], 0),
        (104, 205): (2, [5, 6], 0),
        (104, 108): (2, [5], 1),
        (100 + near, 300): (2, [], 0),
        (50, 100 + far, 350): (2, [], 3),
    }.items():
        assert calibrate.judged(config, evaluations, list(alarms)) == expected, alarms


def test_the_delay_until_a_fall_is_found():
    """At slack ½ and level 9, z = 3 raises an alarm in its fourth episode."""
    calm = CALM + CALM
    assert calibrate.delay(calm, 9.0, 100, 1.0, -50.0) == 4
    assert calibrate.delay(calm, 9.0, 100, 0.0, -50.0) == np.inf, "nothing falls"


def test_what_is_found_is_asked_of_agents_that_hear(tmp_path, capsys):
    """The random policy raises no alarm."""
    few = dict(episodes=8, hidden=[8], schedule=[{"episode": 4, "force": -1.0}])
    configs = {
        f"{agent}-0": Config.preset("cartpole", agent=agent, **few) for agent in ("dqn", "random")
    }
    studies.run_study(configs, tmp_path / "study", ThreadPoolExecutor(1), quiet=True)
    calibrate.main(["found", str(tmp_path / "study")])
    assert capsys.readouterr().out.count("\n") == 1


def test_a_program_ends_as_a_command_does():
    """What it cannot print is a question mark, a closed pipe no error, an error one line."""
    levels = [sys.executable, KEEP / "calibrate.py", "levels", "--envs=acrobot"]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(levels, stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, b"")
    ascii = os.environ | {"PYTHONIOENCODING": "ascii"}
    table = [sys.executable, KEEP / "cartpole.py", "table"]
    done = subprocess.run(table, env=ascii, capture_output=True)
    assert done.returncode == 0 and b"lr ? 5" in done.stdout
    for program, *words in (["study.py", "collect"], ["conclude.py"], ["decide.py"]):
        words = [sys.executable, KEEP / program, *words, "--protocol=nowhere.toml"]
        done = subprocess.run(words, capture_output=True, text=True)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert done.stderr.startswith(f"{program}: ") and "nowhere.toml" in done.stderr


def test_a_copy_of_a_stored_run_does_not_count(tmp_path):
    for path in cartpole.RESULTS.glob("2*.json"):
        shutil.copy(path, tmp_path)
    before = cartpole.table(tmp_path)
    shutil.copy(tmp_path / "20.json", tmp_path / "20 (copy).json")
    assert cartpole.table(tmp_path) == before


def test_a_run_that_is_refused_keeps_its_checkpoint(tmp_path, tiny):
    """Without it nobody would know when its agent raised alarms."""
    tiny("tune", "--tasks=mini")
    folder = tmp_path / "out" / "reported" / "mini" / "drop" / "drop-2000"
    runs.train(Config.preset("cartpole", "fast", seed=2000, episodes=2), folder, quiet=True)
    with pytest.raises(UsageError, match="made with other settings"):
        tiny("collect")
    assert (folder / "checkpoint.npz").exists()
    assert not (tmp_path / "results" / "rows.jsonl").exists()


@pytest.mark.parametrize("program", [study, conclude, decide])
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("rows.jsonl", b"{"),
        ("rows.jsonl", b"{}"),
        ("acrobot.npz", b"{"),
        ("acrobot.npz", (study.RESULTS / "acrobot.npz").read_bytes()[:9_999]),
        ("acrobot-tuned.json", b"{"),
        ("acrobot-tuned.json", b'{"twin": 1}'),
        ("rows.jsonl", ROW.replace(b'"value"', b'"values"')),
        ("rows.jsonl", re.sub(rb'"value":[^,]*', b'"value":NaN', ROW)),
        ("rows.jsonl", re.sub(rb'"value":[^,]*', b'"value":1e400', ROW)),
        ("acrobot-tuned.json", b'{"twin": {"chosen": {}, "first": [], "best": [1]}}'),
        ("rows.jsonl", re.sub(rb'"alarms":[^}]*', b'"alarms":null', ROW)),
        ("acrobot.npz", (study.RESULTS / "acrobot.npz").read_bytes()),  # without its rows
    ],
)
def test_a_damaged_file_is_named_in_one_line(tmp_path, monkeypatch, capsys, program, name, content):
    own_signals(monkeypatch)
    (tmp_path / name).write_bytes(content)
    words = ["collect"] if program is study else []
    with pytest.raises(SystemExit, match="2"):
        run_program(lambda: program.main([*words, f"--results={tmp_path}"]))
    out, error = capsys.readouterr()
    assert out == "" and error.count("\n") == 1 and str(tmp_path / name) in error
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_the_fast_study_sees_the_largest_effects(tmp_path):
    """With two seeds: who keeps the data of other physics falls behind everyone who drops them."""
    folders = [f"--out={tmp_path / 'out'}", f"--results={tmp_path}"]
    fast = [f"--protocol={KEEP / 'fast.toml'}", "--tasks=acrobot", "--seeds=2", *folders]
    own = {"chosen": {}, "first": [], "best": []}
    (tmp_path / "acrobot-tuned.json").write_text(json.dumps({"own": own}), encoding="utf-8")
    study.main(["report", *fast])
    lines = (tmp_path / "rows.jsonl").read_text(encoding="utf-8").splitlines()
    values = {}
    for row in map(json.loads, lines):
        values.setdefault(row["arm"], []).append(row["value"])
    for arm in ("dqn-drop", "twin-told", "reuse-told"):
        assert np.all(np.array(values[arm]) > np.array(values["dqn"]) + 50), values


def test_the_table_of_false_alarms_is_that_of_what_was_charted():
    """As recorded; and as bootstrapped at each preset's level, which meets the target."""
    text = (KEEP / "README.md").read_text(encoding="utf-8")
    rows = [line.split("|")[2:-1] for line in text.splitlines() if re.match(r"\|.* level \d", line)]
    cells = dict(zip(calibrate.DETECTOR, zip(*rows, strict=True), strict=True))
    for env, column in cells.items():
        charted, preset = calibrate.recorded(env, calibrate.RESULTS), Config.preset(env, "null")
        shown = [(s, level) for s, (_, levels) in calibrate.SHOWN.items() for level in levels]
        for (symptom, level), cell in zip(shown, column, strict=True):
            rate = calibrate.false_alarms(symptom, charted[symptom], level)
            assert f"({rate:.2f})" in cell
            chosen = (symptom, level) == (preset.symptom, preset.alarm_level)
            assert ("**" in cell) == chosen
            if chosen:
                series = calibrate.many(env, charted[symptom])
                rate = calibrate.false_alarms(symptom, series, level)
                assert rate <= calibrate.TARGET and f"**{rate:.2f}" in cell


def test_what_is_charted_of_a_run_without_a_drift(monkeypatch, tmp_path):
    """Minus its returns, and the logarithms of its errors where an update gave one."""
    few = Config.preset(
        "cartpole", "null", agent="dqn", seed=3, drift_signal=[], learning_starts=30
    )
    few = Config.from_dict(few.to_dict() | dict(episodes=8, hidden=[8], schedule=[]))
    monkeypatch.setattr(calibrate.Config, "preset", lambda *args, **values: few)
    arrays = calibrate.record("cartpole", "null", 3)
    records = list(train.run(few))
    assert arrays["return-3"].tolist() == [-each["return"] for each in records]
    known = [each["td_error"] for each in records if each["td_error"] > 0]
    np.testing.assert_allclose(arrays["td_error-3"], np.log(known), rtol=1e-6)
    assert 0 < len(known) < len(arrays["model-3"]) == 8
    np.savez(
        tmp_path / "cartpole-charted.npz", **{k.replace("3", "0"): x for k, x in arrays.items()}
    )
    assert calibrate.recorded("cartpole", tmp_path)["return"] == [arrays["return-3"].tolist()]


def test_a_drift_is_recorded_for_twenty_episodes(monkeypatch):
    """The run ends there, and up to the drift it is the run without one."""
    preset = Config.preset
    few = dict(hidden=[8], learning_starts=30)
    schedules = {
        "null": [],
        "recurring": [{"episode": 3, "force": -1.0}, {"episode": 40, "reset": True}],
    }

    def small(env, name, **values):
        given = preset("cartpole", **few, agent="dqn", seed=values["seed"], drift_signal=[])
        return Config.from_dict(given.to_dict() | dict(episodes=60, schedule=schedules[name]))

    monkeypatch.setattr(calibrate.Config, "preset", small)
    calm, drifted = (calibrate.record("cartpole", name, 3)["return-3"] for name in schedules)
    assert len(calm) == 60 and len(drifted) == 3 + calibrate.AFTER
    assert np.array_equal(calm[:3], drifted[:3]) and not np.array_equal(calm[:23], drifted)


CALM = [float(k % 2) for k in range(80)]


@pytest.mark.parametrize(("late", "found"), [(0, 1.0), (8, 1.0), (9, 0.0)])
def test_a_drift_is_found_within_ten_episodes(late, found):
    """At slack ½ and level 5, z = 3 raises an alarm in its second episode."""
    drifted = CALM + CALM[:late] + [9.0] * (calibrate.AFTER - late)
    assert calibrate.found_in_time("return", [drifted], 5.0) == found


def test_an_alarm_before_the_drift_does_not_find_it():
    early = CALM[:75] + [9.0] * (5 + calibrate.AFTER)
    assert calibrate.alarms("return", early, 5.0) == [77]
    assert calibrate.found_in_time("return", [early], 5.0) == 0.0


def test_the_best_quiet_chart_is_sought_among_the_quiet_ones():
    """Noisy runs need a level at which a small rise is not found; quiet ones do not."""
    rng = np.random.default_rng(0)
    drifted = [[*CALM, *(x + 3.0 for x in CALM[:20])]] * 4
    share, slack, level = calibrate.best_quiet("return", [CALM], drifted)
    assert share == 1.0 and (slack, level) == (0.5, 4)
    noisy = [[*CALM, *rng.choice([0.0, 9.0], 400)] for _ in range(20)]
    share, _, level = calibrate.best_quiet("return", noisy, drifted)
    assert share == 0.0 and level > 4


def test_the_table_of_quiet_charts_is_that_of_what_was_charted():
    text = (KEEP / "README.md").read_text(encoding="utf-8")
    table = text.partition("the best found")[2]
    for symptom, (name, _) in calibrate.SHOWN.items():
        best = [
            calibrate.best_stored(env, symptom, calibrate.RESULTS)[0]
            for env in ("cartpole", "mountaincar", "acrobot")
        ]
        assert f"| {name} | {' | '.join(f'{share:.0%}' for share in best)} |" in table


def test_charted_files_that_are_missing_or_damaged(tmp_path):
    """Also a file that is cut off, and one that lacks an array."""
    path = tmp_path / "acrobot-charted.npz"

    def refused(message):
        with pytest.raises(UsageError, match=message):
            calibrate.main(["levels", "--envs=acrobot", f"--results={tmp_path}"])

    refused("there is no")
    for content in (b"x", (calibrate.RESULTS / path.name).read_bytes()[:9_999]):
        path.write_bytes(content)
        refused(f"{path.name} is damaged")
    np.savez(path, **dict.fromkeys(("return-0", "model-0", "model-1"), np.zeros(3)))
    refused(f"{path.name} is damaged")


@pytest.mark.parametrize(
    ("program", "name"), [("cartpole.py", "20.json"), ("forgetting.py", "acrobot-dqn-20.json")]
)
def test_a_damaged_run_is_named_in_one_line(tmp_path, program, name):
    (tmp_path / name).write_text("{", encoding="utf-8")
    words = [sys.executable, KEEP / program, "table", f"--out={tmp_path}"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"{program}: {tmp_path / name} is damaged")

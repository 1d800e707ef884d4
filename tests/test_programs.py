"""The programs beside the package: what they do not know is refused, and nothing is written."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import mutants
import pytest
from helpers import contents, own_signals

from gbdqn_ref import UsageError

sys.path.insert(0, str(Path(__file__).parent.parent / "paper_checks"))
import plant
import reruns

ROOT = Path(__file__).parent.parent
WRITTEN = "notebooks", "paper_checks", "site/figures"  # where the programs write
PROGRAMS = {  # program: {arguments that it refuses: a word of the refusal}
    "notebooks/render.py": {("nosuch",): "'nosuch'", ("",): "''", ("--all",): "--all"},
    "paper_checks/curves.py": {
        (): "WHAT",
        ("planes",): "'planes'",
        ("returns",): "NAME, FOLDER",
        ("returns", "pole", "."): "'pole'",
        ("returns", "cartpole", "nosuch"): "nosuch/results.json",
    },
    "paper_checks/page.py": {("README.md",): "README.md"},
    "paper_checks/plant.py": {("M1", "M99"): "'M99'", ("",): "''", ("X11",): "'X11'"},
    "paper_checks/reruns.py": {
        (): "NAME, FOLDER",
        ("acrobot",): "FOLDER",
        ("../../zz", "."): "'../../zz'",
        ("acrobot", "nosuch"): "nosuch/results.json",
    },
    "site/build.py": {("html",): "html"},
    "site/figures/frames.py": {(): "FOLDER", ("one", "two"): "two", ("/dev/null",): "/dev/null"},
    "tests/mutants.py": {("all",): "'all'"},
}
REFUSED = [
    pytest.param(program, arguments, word, id=" ".join([program, *arguments]))
    for program, refused in PROGRAMS.items()
    for arguments, word in refused.items()
]
STORED = json.dumps(reruns.stored("acrobot"))


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """run(program, arguments): its exit status, stdout and stderr; it must write nothing."""

    def run(program, arguments):
        if program == "site/build.py":
            pytest.importorskip("sphinx", reason="without the extra site")
        own_signals(monkeypatch)
        path, before = ROOT / program, written()
        monkeypatch.chdir(tmp_path)
        monkeypatch.syspath_prepend(path.parent)
        monkeypatch.setattr(sys, "argv", [str(path), *arguments])
        with plt.rc_context(), pytest.raises(SystemExit) as exit:
            runpy.run_path(str(path), run_name="__main__")
        assert written() == before and not contents(tmp_path)
        return exit.value.code, *capsys.readouterr()

    return run


def written():
    """{file: when it was last written} in the folders that the programs write into."""
    paths = (path for folder in WRITTEN for path in (ROOT / folder).rglob("*"))
    return {path: path.stat().st_mtime_ns for path in paths if "__pycache__" not in str(path)}


@pytest.mark.parametrize(("program", "arguments", "word"), REFUSED)
def test_wrong_arguments_are_refused_by_name(program, arguments, word, run):
    status, stdout, stderr = run(program, arguments)
    assert (status, stdout) == (2, "")
    assert stderr.startswith(f"{Path(program).name}: ") and stderr.count("\n") == 1
    assert word in stderr


@pytest.mark.parametrize("program", PROGRAMS)
def test_help_is_all_that_help_does(program, run):
    status, stdout, stderr = run(program, ["--help"])
    assert (status, stderr) == (0, "") and stdout.startswith(f"usage: {Path(program).name}")


@pytest.mark.parametrize(("chosen", "tested"), [([], ["core", "reports"]), (["core"], ["core"])])
def test_the_groups_of_mutants_that_are_named_are_tested_or_all(chosen, tested, monkeypatch):
    calls = []
    monkeypatch.setattr(mutants, "survive", lambda name, group: calls.append(name))
    assert mutants.main(chosen) == 0 and calls == tested


@pytest.mark.parametrize(("chosen", "planted"), [([], set(plant.checks())), (["M1"], {"M1"})])
def test_the_faults_of_the_claims_that_are_named_are_planted_or_all(
    chosen, planted, monkeypatch, capsys
):
    calls = []
    monkeypatch.setattr(plant, "unseen", lambda faults, tests: calls.append((faults, tests)) or [])
    assert plant.main(chosen) == 0 and capsys.readouterr().out == "none\n"
    [(faults, tests)] = calls
    assert set(tests) == planted and all(planted & set(each["ids"]) for each in faults.values())


@pytest.mark.parametrize(
    ("name", "left", "word"),
    [
        ("acrobot", "{}", "'settings'"),
        ("acrobot", "[", "is damaged"),
        ("acrobot", STORED.replace('"final_return"', '"final"', 1), "'final_return'"),
        ("acrobot-hard", STORED, "(schedule)"),
        ("mountaincar", STORED, "(env, "),
    ],
    ids=["empty", "cut off", "no return", "another preset", "another environment"],
)
def test_what_is_no_study_of_this_name_replaces_no_stored_one(
    name, left, word, tmp_path, monkeypatch
):
    monkeypatch.setattr(reruns, "FOLDER", tmp_path)
    (tmp_path / "results.json").write_text(left)
    (tmp_path / f"{name}.json").write_text("as it was")
    with pytest.raises(UsageError, match=re.escape(word)):
        reruns.main([name, str(tmp_path)])
    assert (tmp_path / f"{name}.json").read_text() == "as it was"


def test_a_study_is_stored_compactly(tmp_path, monkeypatch):
    """As the one that is stored."""
    before = (reruns.FOLDER / "acrobot.json").read_bytes()
    monkeypatch.setattr(reruns, "FOLDER", tmp_path)
    (tmp_path / "results.json").write_text(json.dumps(json.loads(STORED), indent=2))
    reruns.main(["acrobot", str(tmp_path)])
    assert (tmp_path / "acrobot.json").read_bytes() == before


def test_the_ledger_shows_the_figures_of_every_process():
    """Of two files that are checked side by side."""
    command = [sys.executable, "-m", "pytest", "-n", "2", "--dist", "loadfile"]
    files = ["paper_checks/test_edges.py", "paper_checks/test_readings.py"]
    done = subprocess.run(command + files, cwd=ROOT, capture_output=True, text=True)
    for id in "T1-h", "M3":
        assert re.search(rf"^{id} .*\n +\S", done.stdout, re.MULTILINE), done.stdout

"""Plant faults, one by one, and see that the checks fail: python paper_checks/plant.py [ID …].

faults.toml holds plausible slips of the package, of a small world or of a definition in a check,
and changed printed numbers. Each is planted in a copy of the project, where the checks and proofs
of its claims run. A check has seen the fault if an assertion of its own has failed: no helper's, no
figure, no control, and no other exception. Reported are the claims that do not see their fault, and
the checks that see none; "none" and exit status 0 if there are none.
"""

import os
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import ledger
from hypothesis import Phase, settings

from gbdqn_ref.__main__ import Parser, program

ROOT = ledger.HERE.resolve().parent
SEEN = ROOT / "seen"  # in a copy: the checks that have seen its fault
FAULTS = tomllib.loads((ledger.HERE / "faults.toml").read_text(encoding="utf-8"))
COPIED = ("gbdqn_ref", "paper_checks", "benchmarks", "conftest.py", "pyproject.toml")
PYTEST = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "plant"]
SECONDS = 120  # a fault may loop for ever
WORKERS = 2


def checks():
    """{id: its checks and proofs, as file::test}."""
    found = {
        row["id"]: {name.replace("::", "::test_") for name in row["checks"] + row["proofs"]}
        for row in ledger.committed().values()
    }
    return {id: tests for id, tests in found.items() if tests}


def seen(fault, tests):
    """Those of the tests that see the fault, run in a copy that has it."""
    with TemporaryDirectory() as name:
        folder = Path(name).resolve()
        for each in COPIED:
            copy = shutil.copytree if (ROOT / each).is_dir() else shutil.copy2
            copy(ROOT / each, folder / each)
        path, found = folder / fault["file"], folder / SEEN.name
        text = path.read_text(encoding="utf-8").replace(fault["old"], fault["new"])
        path.write_text(text, encoding="utf-8")
        found.touch()
        paths = os.pathsep.join([str(folder), str(folder / "paper_checks")])
        with suppress(subprocess.TimeoutExpired):
            subprocess.run(
                PYTEST + [f"paper_checks/{test}" for test in sorted(tests)],
                cwd=folder,
                env=os.environ | {"PYTHONPATH": paths, "HYPOTHESIS_PROFILE": "ci"},
                capture_output=True,
                timeout=SECONDS,
            )
        return set(found.read_text(encoding="utf-8").split())


def seen_by(faults, tests):
    """{fault: the tests of its claims that see it}, given {id: tests}."""

    def red(fault):
        return seen(fault, set().union(*(tests[id] for id in fault["ids"] if id in tests)))

    with ThreadPoolExecutor(WORKERS) as pool:
        return dict(zip(faults, pool.map(red, faults.values()), strict=True))


def unseen(faults, tests):
    """What has not been seen, a line each."""
    red = seen_by(faults, tests)
    for name, fault in faults.items():
        for id in fault["ids"]:
            if id in tests and not tests[id] & red[name]:
                yield f"{id} does not see the fault: {name}"
    for id, own in tests.items():
        for test in sorted(own.difference(*red.values())):
            yield f"{id} sees no fault in {test}"


def main(arguments=None):
    """Exit status 1 if anything has not been seen."""
    parser = Parser(description="Plant faults, and see that the checks fail.")
    parser.add_argument("ids", nargs="*", metavar="ID", help="claims, like T1-j; default all")
    ids, tests = parser.parse_args(arguments).ids, checks()
    for id in ids:
        if id not in tests:
            some = ", ".join(list(tests)[:3])
            parser.error(f"no claim that has a check is called {id!r}; {some}, … are")
    tests = {id: own for id, own in tests.items() if not ids or id in ids}
    faults = {name: fault for name, fault in FAULTS.items() if tests.keys() & fault["ids"]}
    report = list(unseen(faults, tests))
    print("\n".join(report) or "none")
    return int(bool(report))


# In a copy this file is a plugin of pytest


def pytest_configure():
    """The first example that fails is enough."""
    phases = [Phase.explicit, Phase.generate]
    ci = settings.get_profile("ci")
    settings.register_profile("plant", ci, phases=phases, report_multiple_bugs=False)
    settings.load_profile("plant")


def pytest_runtest_makereport(item, call):
    """Take down a test of which an assertion has failed; of a proof, that something is proved."""
    if call.excinfo and call.excinfo.type is AssertionError:
        *_, last = (entry for entry in call.excinfo.traceback if ROOT in Path(entry.path).parents)
        proof = item.path.name == "test_proofs.py"
        own = last.name == item.originalname
        if own and (not proof or "assert proved(" in str(last.statement)):
            with SEEN.open("a", encoding="utf-8") as file:
                file.write(f"{item.path.name}::{item.originalname}\n")


if __name__ == "__main__":
    program(main)

"""Plant one-line bugs and check that the tests fail: make mutants (half an hour).

mutmut makes thousands of mutants in two groups: the learning core and the reports. A fixed random
sample of each group is tested, each mutant with the tests that reach its line. At least 90 % must
be killed, and survivors.md must list every survivor with the reason why no test notices it.
`python tests/mutants.py reports` tests one group alone.
"""

import json
import random
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from gbdqn_ref.__main__ import Parser, program

ROOT = Path(__file__).parent.parent
LEAST = 0.9
EXPLAINED = Path(__file__).with_name("survivors.md").read_text(encoding="utf-8")
PROCESSES = ["process", "killed", "dask", "workers", "backend", "default_folder", "compare_trains"]
COPIED = ["gbdqn_ref", "tests", "paper_checks", "notebooks", "conftest.py", "README.md"]


class Group(NamedTuple):
    """The modules to mutate, the size of the sample, and the tests to run."""

    modules: str
    sample: int
    tests: str
    options: list[str]


GROUPS = {  # without the tests that start processes or read the source
    "core": Group(
        "nn optim bellman boosting replay drift schedule physics gbdqn",
        320,
        "gbdqn_ref paper_checks tests/test_agents.py tests/test_baselines.py tests/test_bellman.py"
        " tests/test_boosting.py tests/test_buffers.py tests/test_checkpoint.py"
        " tests/test_config.py tests/test_drift.py tests/test_hopper.py tests/test_nn.py"
        " tests/test_optim.py tests/test_physics.py tests/test_reuse.py tests/test_schedule.py"
        " tests/test_tabular.py",
        ["--deselect=paper_checks/test_reruns.py"],
    ),
    "reports": Group(
        "tables plots effect stats runs study watch",
        240,
        "gbdqn_ref tests/test_effect.py tests/test_plots.py tests/test_runs.py"
        " tests/test_stats.py tests/test_study.py tests/test_summary.py tests/test_tables.py"
        " tests/test_watch.py",
        ["-k", " and ".join(f"not {word}" for word in PROCESSES)],
    ),
}


def workshop(name, group):
    """A folder with a copy of the project and mutmut's settings for this group."""
    folder = ROOT / "mutants" / name
    shutil.rmtree(folder, ignore_errors=True)
    for each in COPIED:
        source = ROOT / each
        copy = shutil.copytree if source.is_dir() else shutil.copy2
        folder.mkdir(parents=True, exist_ok=True)
        copy(source, folder / each)
    settings = {
        "source_paths": ["gbdqn_ref"],
        "only_mutate": [f"gbdqn_ref/{module}.py" for module in group.modules.split()],
        "also_copy": COPIED[1:],
        "pytest_add_cli_args": ["-p", "no:cacheprovider", *group.options],
        "pytest_add_cli_args_test_selection": group.tests.split(),
    }
    lines = [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (folder / "pyproject.toml").write_text("\n".join([project, "[tool.mutmut]", *lines, ""]))
    return folder


def mutmut(folder, *arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "mutmut", *arguments], cwd=folder, check=False, **options
    )


def exit_codes(folder):
    """{mutant: exit code of its tests, or None if they have not run}."""
    codes = {}
    for path in (folder / "mutants" / "gbdqn_ref").glob("*.meta"):
        codes |= json.loads(path.read_text())["exit_code_by_key"]
    return codes


def change(folder, name):
    """The mutated line."""
    diff = mutmut(folder, "show", name, capture_output=True, text=True).stdout.splitlines()
    added = [line[1:] for line in diff if line.startswith("+") and not line.startswith("+++")]
    return " ".join(line.strip() for line in added)


def survive(name, group):
    """Whether too many mutants of the group survive, or any without a reason."""
    folder = workshop(name, group)
    mutmut(folder, "run", "none of them", capture_output=True)  # makes all mutants, runs no tests
    names = sorted(exit_codes(folder))
    sample = sorted(random.Random(0).sample(names, group.sample))
    mutmut(folder, "run", *sample)
    codes = exit_codes(folder)
    if any(codes[each] is None for each in sample):
        raise SystemExit(f"{name}: the tests fail without any mutant, or were stopped")
    survivors = {each: change(folder, each) for each in sample if codes[each] in (0, 33)}
    unexplained = {each: line for each, line in survivors.items() if f"`{line}`" not in EXPLAINED}
    killed = 1 - len(survivors) / group.sample
    print(f"{name}: {len(names)} mutants, {group.sample} tested, {killed:.1%} killed")
    for each, line in unexplained.items():
        print(f"  no reason in survivors.md: {each}: {line}")
    return killed < LEAST or bool(unexplained)


def main(arguments=None):
    """Exit status 1 if a group has too many survivors, or any without a reason."""
    parser = Parser(description="Plant one-line bugs and check that tests fail.")
    parser.add_argument("groups", nargs="*", metavar="GROUP", help="core or reports; default both")
    chosen = parser.parse_args(arguments).groups
    for name in chosen:
        if name not in GROUPS:
            parser.error(f"no group is called {name!r}; {' and '.join(GROUPS)} are")
    failed = [name for name in chosen or GROUPS if survive(name, GROUPS[name])]
    return int(bool(failed))


if __name__ == "__main__":
    program(main)

"""Plant one-line bugs in the learning core and see that the tests fail: make mutants (a quarter of
an hour).

mutmut makes some 1,600 of them; a fixed random sample is tested, each with the tests that reach its
line. At least nine tenths must be killed, and what a survivor became must stand in survivors.md,
with the reason why no test sees it.
"""

import json
import random
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
SAMPLE, LEAST = 320, 0.9
EXPLAINED = Path(__file__).with_name("survivors.md").read_text(encoding="utf-8")


def mutmut(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "mutmut", *arguments], cwd=ROOT, check=False, **options
    )


def exit_codes():
    """{mutant: exit code of its tests, or None where they have not run}."""
    files = sorted((ROOT / "mutants" / "gbdqn_ref").glob("*.meta"))
    return {
        name: code
        for path in files
        for name, code in json.loads(path.read_text())["exit_code_by_key"].items()
    }


def change(name):
    """What the mutated line has become."""
    diff = mutmut("show", name, capture_output=True, text=True).stdout.splitlines()
    return " ".join(
        line[1:].strip() for line in diff if line.startswith("+") and not line.startswith("+++")
    )


def main():
    """Exit status 1 if too many survive, or one without a reason."""
    mutmut(
        "run", "none of them", capture_output=True
    )  # makes them all, and complains that it ran none
    names = sorted(exit_codes())
    sample = sorted(random.Random(0).sample(names, SAMPLE))
    mutmut("run", *sample)
    codes = exit_codes()
    survivors = {name: change(name) for name in sample if codes[name] == 0}
    unexplained = {name: line for name, line in survivors.items() if f"`{line}`" not in EXPLAINED}
    killed = 1 - len(survivors) / SAMPLE
    print(f"{SAMPLE} of {len(names)} mutants: {killed:.1%} killed, {len(survivors)} survive")
    for name, line in unexplained.items():
        print(f"  no reason in survivors.md: {name}: {line}")
    return int(killed < LEAST or bool(unexplained))


if __name__ == "__main__":
    sys.exit(main())

"""Run one figure of the decision table again: train two arms on a task, and print their difference.

    python benchmarks/keep/again.py mountaincar dqn-drop dqn --seeds 20 --jobs 2

The settings are those that are stored, the runs are new: they and their rows go to --out, and the
same command goes on where it was stopped.
"""

from pathlib import Path

import study
from evidence import stored, words
from protocol import FILE, Protocol, count

from gbdqn_ref.__main__ import Parser, program


def main(arguments=None):
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("task")
    parser.add_argument("arm")
    parser.add_argument("other")
    parser.add_argument("--seeds", type=count, default=20)
    parser.add_argument("--jobs", type=count, default=2)
    parser.add_argument("--protocol", type=Path, default=FILE)
    parser.add_argument("--out", type=Path, default=Path("runs/again"))
    args = parser.parse_args(arguments)
    for arm in (args.arm, args.other):
        Protocol(args.protocol).check(args.task, arm)
    arms, results = f"{args.arm},{args.other}", args.out / "results"
    options = [f"--tasks={args.task}", f"--arms={arms}", f"--seeds={args.seeds}"]
    options += [f"--jobs={args.jobs}", f"--protocol={args.protocol}", f"--out={args.out}"]
    study.main(["report", *options, f"--results={results}"])
    found = stored(results, args.protocol).difference(args.task, args.arm, args.other)
    print(f"{args.task}: {args.arm} minus {args.other}: {words(found)}, {len(found)} seeds")


if __name__ == "__main__":
    program(main)

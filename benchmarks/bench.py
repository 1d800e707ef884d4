"""What everything costs, in one run: ratios, and microseconds on this machine.

    python benchmarks/bench.py [--tiny] [--out runs/bench.png]

All but the last two tables are measured in one thread on one core, in time of the processor. The
peers are optional: pip install -e '.[peers]'.
"""

import os
import platform
import sys
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

import against
import growth
import parts
import peers
import report
import several
from measure import REPLAYS, STOCK, TINY, Scale
from threadpoolctl import threadpool_limits

from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.files import check_picture
from gbdqn_ref.plots import save


def main(arguments=None):
    """Measure all there is, print the tables and draw the picture."""
    parser = Parser(description="What everything costs.")
    parser.add_argument("--out", default="runs/bench.png", help="the picture; default %(default)s")
    parser.add_argument(
        "--tiny", action="store_true", help="a few seconds, only to see that it runs"
    )
    args = parser.parse_args(arguments)
    path, scale = Path(args.out), TINY if args.tiny else Scale()
    check_picture(path, ".png")
    path.parent.mkdir(parents=True, exist_ok=True)
    with one_core():
        absent = peers.missing()
        print(versions(absent))
        tables = show(one_core_tables(scale, absent))
    tables |= show([several.import_order(scale), several.jobs(scale, several.study_seconds)])
    save(report.picture(curves(scale, tables)), path)
    print(f"\nthe picture: {path}")


@contextmanager
def one_core():
    """NumPy in one thread; this thread, and those that it starts, on one core."""
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    if cores:
        os.sched_setaffinity(0, {max(cores)})
    try:
        with threadpool_limits(1):
            yield
    finally:
        if cores:
            os.sched_setaffinity(0, cores)


def versions(absent):
    """What is compared, and which peer is left out for what reason."""
    here = ["numpy", "gymnasium", *(name for name in peers.LIBRARIES if name not in absent)]
    lines = [", ".join([f"Python {platform.python_version()}", *map(named, here)])]
    lines += [f"without {name} ({reason})" for name, reason in absent.items()]
    return "\n".join([*lines, "all peers: pip install -e '.[peers]'"] if absent else lines)


def named(library):
    """A library and its version."""
    return f"{library} {version(peers.PACKAGES.get(library, library))}"


def one_core_tables(scale, absent):
    """The tables that one core measures, without the peers that are absent."""
    for batch_size, widths in against.UPDATES:
        yield against.update(scale, batch_size, widths, absent)
    for env in STOCK:
        yield against.training(scale, env, absent)
    if "jax" not in absent:
        yield against.compiling()
    for agent, kind in (("dqn", "uniform"), ("dqn", "proportional"), ("gbdqn", "recency")):
        yield parts.parts(scale, agent, kind)
    yield parts.environments(scale)
    yield growth.replay(scale)
    yield growth.boosters(scale)
    yield growth.fold_in(scale)
    yield growth.memory(scale)


def show(sections):
    """Print each Section as soon as it is measured; {title: rows}."""
    tables = {}
    for section in sections:
        report.table(*section)
        sys.stdout.flush()  # a table is seen when it is ready, also in a file
        tables[section.title] = section.rows
    return tables


def curves(scale, tables):
    """What report.picture draws: a panel for the replay buffer, and one for boosters."""
    by_size = {
        kind: (scale.sizes, [tables[growth.REPLAY][f"{kind}, N = {n:,}"][1] for n in scale.sizes])
        for kind in REPLAYS
    }
    rows = [tables[growth.BOOSTERS][f"m = {m}"] for m in scale.boosters]
    by_boosters = {
        "training per environment step": (scale.boosters, [row[2] for row in rows]),
        "update": (scale.boosters, [row[0] for row in rows]),
    }
    return by_size, by_boosters


if __name__ == "__main__":
    program(main)

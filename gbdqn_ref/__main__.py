"""The command line. It parses and calls; nothing here trains, measures or draws.

    python -m gbdqn_ref train | compare | study | drift-effect | watch | maps | settings

A command imports what it needs, so --help is fast and Ctrl-C works from the start.
"""

import argparse
import logging
import os
import signal
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from pathlib import Path
from reprlib import repr as short
from typing import IO, Any, NoReturn

from . import DivergenceError, StudyError, UsageError
from .agents import AGENTS
from .config import Config
from .files import parse_json

STOP = "stopped. To continue: train --resume, or the same command again"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status; unless it is 0, lines on stderr say why.

    1: runs of a study failed. 2: the input cannot be used. 3: training diverged. 130: a signal
    stopped it. Without arguments the process's own are used, and its signals are handled.
    """
    if arguments is None:
        _own_process()

    def command() -> None:
        args = _parser().parse_args(arguments)
        args.command(args)

    return _tell("gbdqn_ref", command, arguments is None)


def program(run: Callable[[], int | None]) -> NoReturn:
    """Run a program beside the package and exit as a command does."""
    _own_process()
    sys.exit(_tell(os.path.basename(sys.argv[0]), run, own=True))


def _tell(name: str, run: Callable[[], int | None], own: bool) -> int:
    """Run, say on stderr what was refused, and return the exit status."""
    try:
        status, lines = _answer(run)
        if own:
            _handle_signals(signal.SIG_IGN)
        with suppress(OSError):
            for line in lines:  # each on one line, even if a path has line breaks
                print(f"{name}:", *line.split(), file=sys.stderr, flush=True)
    finally:  # also after --help, which raises SystemExit
        for stream in (sys.stdout, sys.stderr):
            _flush(stream)
    return status


def _answer(run: Callable[[], int | None]) -> tuple[int, list[str]]:
    """(exit status, lines for stderr) of a command."""
    try:
        status = run()
        print(end="", flush=True)
    except BrokenPipeError:  # the reader is gone, but the work is finished
        return 0, []
    except StudyError as e:
        return 1, [f"{name} failed: {error}" for name, error in e.errors.items()]
    except (UsageError, OSError) as e:
        return 2, [str(e)]
    except MemoryError as e:
        return 2, [f"not enough memory ({e}); make capacity, batch_size or hidden smaller"]
    except DivergenceError as e:
        return 3, [str(e)]
    except KeyboardInterrupt:
        return 130, [STOP]
    return status or 0, []


def _own_process() -> None:
    """Make SIGTERM act like Ctrl-C, and make every text printable, perhaps with ? in it.

    Matplotlib must not add lines of its own, on its cache or on a matplotlibrc, which is not used.
    """
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    _handle_signals(signal.default_int_handler)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed: the next file to be opened would take its place
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", closefd=False))
    sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]


def _handle_signals(handler: Any) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _flush(stream: IO[str]) -> None:
    """Flush a stream that may have lost its reader; Python would complain of it at exit."""
    try:
        stream.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class Parser(ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message} (try {self.prog} --help)")


def _parser() -> ArgumentParser:
    parser = Parser(
        prog="python -m gbdqn_ref", description="GB-DQN on drifting environments, in NumPy."
    )
    commands = parser.add_subparsers(required=True, metavar="command")
    settings = Parser(add_help=False)
    settings.add_argument("--env", type=nonempty, help="cartpole, mountaincar, acrobot or hopper")
    settings.add_argument(
        "--preset",
        type=nonempty,
        help="paper (default) or fast; for some environments long, hard, recurring, null, held-out",
    )
    run = Parser(add_help=False, parents=[settings])
    run.add_argument("--seed", type=int, help="default 0")
    run.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="any setting; repeatable"
    )
    run.add_argument("--quiet", action="store_true", help="no progress bar")
    run.add_argument(
        "--accept-versions",
        action="store_true",
        help="continue runs that other libraries or other code made; this is recorded",
    )
    many = Parser(add_help=False, parents=[run])
    many.add_argument("--jobs", type=int, default=2, help="number of processes; default 2")
    _add_training(commands, run, many)
    _add_pictures(commands)
    lists = commands.add_parser("settings", parents=[settings], help="list all settings")
    lists.set_defaults(command=_settings)
    return parser


def _add_training(commands: Any, run: ArgumentParser, many: ArgumentParser) -> None:
    """The commands that train."""
    train = commands.add_parser("train", parents=[run], help="train one agent")
    train.add_argument("--agent", help=f"gbdqn (default), {', '.join(list(AGENTS)[1:])}")
    train.add_argument("--out", type=nonempty, help="folder; default runs/ENV-AGENT-SEED")
    train.add_argument("--resume", action="store_true", help="continue the run in the folder")
    train.set_defaults(command=_train)
    compare = commands.add_parser(
        "compare", parents=[many], help="train several agents on one seed and compare them"
    )
    compare.add_argument("--agents", default="gbdqn,dqn", help="a list; default gbdqn,dqn")
    compare.add_argument("--out", type=nonempty, help="folder; default runs/ENV; its runs are kept")
    compare.set_defaults(command=_compare)
    study = commands.add_parser(
        "study", parents=[many], help="train many agents on many seeds and compare them"
    )
    study.add_argument("--agents", default="all", help="all (default), or a list like gbdqn,dqn")
    study.add_argument(
        "--seeds", default="5", help="a count (default 5: 0 to 4) or a list like 3,7"
    )
    study.add_argument(
        "--dask", type=nonempty, metavar="ADDRESS", help="train on a Dask cluster, tcp://host:8786"
    )
    study.add_argument(
        "--out", type=nonempty, help="folder; default runs/study-ENV; its runs are kept"
    )
    study.set_defaults(command=_study)
    effect = commands.add_parser(
        "drift-effect", parents=[many], help="measure what each drift costs a fixed policy"
    )
    effect.add_argument("--agent", default="dqn", help="the agent that learns; default dqn")
    effect.add_argument(
        "--out", type=nonempty, help="folder; default runs/effect-ENV; its runs are kept"
    )
    effect.set_defaults(command=_drift_effect)


def _add_pictures(commands: Any) -> None:
    """The commands that draw."""
    watch = commands.add_parser("watch", help="film a trained agent before and after a drift")
    watch.add_argument("run", type=nonempty, metavar="RUN", help="the folder of a run")
    watch.add_argument(
        "--out", type=nonempty, default="episode.gif", help="the film; default episode.gif"
    )
    watch.add_argument(
        "--drift", type=int, default=1, metavar="K", help="which drift; default 1, the first"
    )
    watch.add_argument("--seed", type=int, default=0, help="seed of the start; default 0")
    watch.set_defaults(command=_watch)
    maps = commands.add_parser("maps", help="draw what a booster changed on MountainCar")
    maps.add_argument(
        "run", type=nonempty, metavar="RUN", help="the folder of a run of GB-DQN on MountainCar"
    )
    maps.add_argument("--out", type=nonempty, default="maps.png", help="the file; default maps.png")
    maps.add_argument("--booster", type=int, metavar="M", help="2 or later; default the last")
    maps.set_defaults(command=_maps)


def nonempty(text: str) -> str:
    """The value of an option that must not be empty."""
    if not text:
        raise argparse.ArgumentTypeError("must not be empty")
    return text


def _config(args: Namespace, agent: str | None) -> Config:
    """The config that the options describe."""
    values = dict(_setting(text) for text in args.set)
    chosen = {"agent": agent, "seed": args.seed}
    values |= {key: value for key, value in chosen.items() if value is not None}
    return Config.preset(args.env or "cartpole", args.preset, **values)


def _setting(text: str) -> tuple[str, Any]:
    """("lr", 0.001) from "lr=0.001" or "lr=.001"; a value that is neither stays text."""
    key, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--set needs KEY=VALUE, like --set lr=0.001, not {short(text)}")
    if key in ("env", "agent", "seed"):
        raise UsageError(f"set {key} with --{key}, not with --set")
    readers: tuple[Callable[[str], Any], ...] = (parse_json, int, float)
    for read in readers:
        with suppress(ValueError, RecursionError):
            return key, read(value)
    return key, value


def _agents(text: str) -> list[str]:
    """The agents in a list like "gbdqn,dqn"."""
    agents = list(AGENTS) if text == "all" else text.split(",")
    if len(set(agents)) < len(agents):
        raise UsageError(f"--agents names an agent twice: {text}")
    return agents


def _seeds(text: str) -> Sequence[int]:
    """The seeds given by a count or by a list like "3,7"."""
    parts = text.split(",")
    if not all(part.isdecimal() and len(part) <= 10 for part in parts) or not any(map(int, parts)):
        raise UsageError(f"--seeds must be a positive count or a list like 3,7, not {short(text)}")
    return [int(part) for part in parts] if len(parts) > 1 else range(int(text))


def _options(args: Namespace) -> dict[str, Any]:
    """The options of study.run_study()."""
    return {"jobs": args.jobs, "quiet": args.quiet, "accept": args.accept_versions}


def _train(args: Namespace) -> None:
    from . import runs, tables

    options = (args.env, args.agent, args.seed, args.preset, args.set or None)
    if args.resume and not any(option is not None for option in options):
        if not args.out:
            raise UsageError("--resume needs the --out of the run to continue")
        config = runs.read_config(args.out)
    else:
        config = _config(args, args.agent)
    out = Path(args.out or f"runs/{config.env}-{config.agent}-{config.seed}")
    summary = runs.train(config, out, args.resume, args.quiet, args.accept_versions)
    tables.show(tables.regimes({config.agent: summary}, config))
    written = [name for name in runs.FILES if (out / name).exists()]
    print(f"\nwritten to {out}: {', '.join(written)}")


def _compare(args: Namespace) -> None:
    from . import study, tables

    configs = {agent: _config(args, agent) for agent in _agents(args.agents)}
    config = next(iter(configs.values()))
    out = Path(args.out or f"runs/{config.env}")
    study.complete(configs, out, **_options(args))
    tables.show(tables.regimes(study.comparison(out, configs), config))
    print(f"\npicture: {out / 'comparison.png'}; runs: {out}/AGENT/ (delete {out} to repeat them)")


def _study(args: Namespace) -> None:
    from . import study, tables

    if args.seed is not None:
        raise UsageError("study takes --seeds, not --seed")
    agents = {agent: _config(args, agent) for agent in _agents(args.agents)}
    config = next(iter(agents.values()))
    out = Path(args.out or f"runs/study-{config.env}")
    with cluster(args.dask) as executor:
        configs = study.grid(agents, _seeds(args.seeds))
        study.complete(configs, out, executor, **_options(args))
    summaries, records = study.report(out)
    study.draw(out, config, summaries, records)
    tables.show(tables.study(summaries, config))
    print(f"\nresults: {out}/results.json; pictures: {out}/*.png; runs: {out}/AGENT-SEED/")


def _drift_effect(args: Namespace) -> None:
    from . import effect, tables

    config = _config(args, args.agent)
    out = Path(args.out or f"runs/effect-{config.env}")
    rows = effect.drift_effect(config, out, **_options(args))
    tables.show(tables.drift_effect(rows, config))


def _watch(args: Namespace) -> None:
    from . import files, watch

    if args.seed < 0:
        raise UsageError(f"--seed must be a non-negative whole number, not {args.seed}")
    files.check_picture(args.out, ".gif")
    episodes = watch.film(args.run, args.drift, args.seed)
    watch.save(episodes, args.out)
    before, after = (episode.returns[-1] for episode in episodes)
    print(f"return before the drift {before:.1f}, after it {after:.1f}; film: {args.out}")


def _maps(args: Namespace) -> None:
    from . import files, plots, watch

    files.check_picture(args.out, ".png")
    plots.save(watch.maps(args.run, args.booster), args.out)
    print(f"picture: {args.out}")


def _settings(args: Namespace) -> None:
    from . import tables

    tables.show(tables.settings(args.env, args.preset))


@contextmanager
def cluster(address: str | None) -> Iterator[Executor | None]:
    """An executor on a Dask cluster, or None without an address."""
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError as e:
        raise UsageError("--dask needs Dask's scheduler: pip install -e '.[cluster]'") from e
    try:
        client = Client(address)
    except (ValueError, TypeError, RuntimeError, ImportError) as e:
        raise UsageError(
            f"--dask needs the address of a scheduler, like tcp://host:8786: {e}"
        ) from e
    with client:
        yield client.get_executor(pure=False)


if __name__ == "__main__":
    sys.exit(main())

"""The command line: python -m gbdqn_ref train | compare | study | drift-effect | watch | maps."""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from reprlib import repr as short

from . import UsageError, effect, plots, runs, study, tables, watch
from .agents import AGENTS
from .config import Config
from .files import check_picture


def main(arguments=None):
    """Run a command; exit status 0, 2 after one line on what was wrong, 1 if runs of a study
    failed.
    """
    try:
        args = _parser().parse_args(arguments)
        return args.command(args) or 0
    except (UsageError, OSError) as error:
        print("gbdqn_ref:", *str(error).split(), file=sys.stderr)  # one line, whatever is in a path
        return 2
    except KeyboardInterrupt:
        print(
            "\ngbdqn_ref: stopped; train --resume, or the same compare, goes on from the"
            " checkpoint",
            file=sys.stderr,
        )
        return 130


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise UsageError(f"{message} (try {self.prog} --help)")


def _parser():
    parser = _Parser(
        prog="python -m gbdqn_ref", description="GB-DQN on drifting environments, in NumPy."
    )
    commands = parser.add_subparsers(required=True, metavar="command")
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--env", help="cartpole, mountaincar, acrobot or hopper")
    common.add_argument("--seed", type=int, help="default 0")
    common.add_argument(
        "--preset", help="paper (default), fast, and for some environments long or hard"
    )
    common.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="any setting, repeatable"
    )
    common.add_argument("--quiet", action="store_true", help="no progress bar")
    train = commands.add_parser("train", parents=[common], help="train one agent into a folder")
    train.add_argument("--agent", help=f"gbdqn (default), {', '.join(list(AGENTS)[1:])}")
    train.add_argument("--out", help="folder; default runs/ENV-AGENT-SEED")
    train.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    train.set_defaults(command=_train)
    compare = commands.add_parser(
        "compare", parents=[common], help="train several agents and compare them"
    )
    compare.add_argument(
        "--agents", default="gbdqn,dqn", help="with commas between; default gbdqn,dqn"
    )
    compare.add_argument(
        "--out",
        help="folder; default runs/ENV; runs that it has already are finished, not repeated",
    )
    compare.set_defaults(command=_compare)
    many = commands.add_parser(
        "study", parents=[common], help="train many agents on many seeds, side by side"
    )
    many.add_argument("--agents", default="all", help="all (default), or a list like gbdqn,dqn")
    many.add_argument(
        "--seeds", default="5", help="how many (default 5: 0 to 4), or a list like 3,7"
    )
    many.add_argument("--jobs", type=int, default=2, help="processes, default 2")
    many.add_argument(
        "--dask",
        metavar="ADDRESS",
        help="a Dask scheduler, like tcp://host:8786, in place of processes",
    )
    many.add_argument(
        "--out", help="folder; default runs/study-ENV; runs that it has already are not repeated"
    )
    many.set_defaults(command=_study)
    matters = commands.add_parser(
        "drift-effect", parents=[common], help="what each drift costs a policy that stays put"
    )
    matters.add_argument("--agent", default="dqn", help="who learns, default dqn")
    matters.add_argument("--jobs", type=int, default=2, help="processes, default 2")
    matters.add_argument(
        "--out", help="folder; default runs/effect-ENV; runs that it has already are not repeated"
    )
    matters.set_defaults(command=_drift_effect)
    _add_pictures(commands)
    return parser


def _add_pictures(commands):
    """The commands whose outcome is a picture."""
    shows = commands.add_parser("watch", help="film a trained agent before and after a drift")
    shows.add_argument("run", metavar="RUN", help="the folder of a run")
    shows.add_argument("--out", default="episode.gif", help="the film; default episode.gif")
    shows.add_argument(
        "--drift", type=int, default=1, metavar="K", help="which drift; default 1, the first"
    )
    shows.add_argument("--seed", type=int, default=0, help="of the start; default 0")
    shows.set_defaults(command=_watch)
    plane = commands.add_parser("maps", help="what a booster changed, on MountainCar's plane")
    plane.add_argument("run", metavar="RUN", help="the folder of a run of GB-DQN on MountainCar")
    plane.add_argument("--out", default="maps.png", help="the picture; default maps.png")
    plane.add_argument("--booster", type=int, metavar="M", help="from 2 on; default the last")
    plane.set_defaults(command=_maps)


def _config(args, agent):
    """The config that the options describe."""
    values = dict(_setting(text) for text in args.set)
    chosen = {"agent": agent, "seed": args.seed}
    values |= {key: value for key, value in chosen.items() if value is not None}
    return Config.preset("cartpole" if args.env is None else args.env, args.preset, **values)


def _setting(text):
    """("lr", 0.001) from "lr=0.001"; what is no JSON is taken as a word."""
    key, equals, value = text.partition("=")
    if not equals:
        raise UsageError(f"--set needs KEY=VALUE, like --set lr=0.001, not {short(text)}")
    if key in ("env", "agent", "seed"):
        raise UsageError(f"--set is for all else: the {key} has an option of its own, --{key}")
    try:
        return key, json.loads(value)
    except (ValueError, RecursionError):
        return key, value


def _train(args):
    described = any(
        value not in (None, [])
        for value in (args.env, args.agent, args.seed, args.preset, args.set)
    )
    if args.resume and not described:
        if not args.out:
            raise UsageError("--resume needs the --out of the run to go on with")
        config = runs.read_config(args.out)
    else:
        config = _config(args, args.agent)
    out = Path(args.out or f"runs/{config.env}-{config.agent}-{config.seed}")
    summary = runs.train(config, out, args.resume, args.quiet)
    tables.show(tables.regimes({config.agent: summary}, config))
    print(f"\nwritten to {out}: config.json, episodes.csv, summary.json, checkpoint.npz, curve.png")


def _list(option, text):
    """The parts of "a,b,c", no two alike."""
    parts = text.split(",")
    if len(set(parts)) < len(parts):
        raise UsageError(f"{option} names one twice: {text}")
    return parts


def _study(args):
    if args.seed is not None:
        raise UsageError("a study has --seeds, not --seed")
    agents = list(AGENTS) if args.agents == "all" else _list("--agents", args.agents)
    seeds = _list("--seeds", args.seeds)
    if not all(seed.isdecimal() for seed in seeds) or seeds == ["0"] or not 1 <= args.jobs <= 1000:
        raise UsageError(
            f"--seeds is a count or a list like 3,7, --jobs from 1 on, not {args.seeds} and"
            f" {args.jobs}"
        )
    seeds = [int(seed) for seed in seeds] if len(seeds) > 1 else range(int(seeds[0]))
    configs = [replace(_config(args, agent), seed=seed) for seed in seeds for agent in agents]
    out = Path(args.out or f"runs/study-{configs[0].env}")
    failed = study.run_study(
        configs, out, _dask(args.dask) if args.dask else None, args.jobs, args.quiet
    )
    for run, error in failed.items():
        print(f"gbdqn_ref: {run} failed: {error}", file=sys.stderr)
    if failed:
        return 1
    summaries, records = study.report(out)
    level = summaries[agents[0]][0]["random_return"]
    plots.save(plots.study_curves(records, configs[0], level), out / "curves.png")
    if len(configs[0].regimes) > 1 and set(summaries) - {"random"}:
        plots.save(plots.adaptation(summaries, configs[0]), out / "adaptation.png")
    if len(summaries) > 1 and "dqn" in summaries:
        plots.save(plots.forest(summaries, configs[0]), out / "forest.png")
    tables.show(tables.study(summaries, configs[0]))
    print(f"\nall of it: {out}/results.json, {out}/*.png and {out}/AGENT-SEED/")


def _drift_effect(args):
    config = _config(args, args.agent)
    rows = effect.drift_effect(
        config, args.out or f"runs/effect-{config.env}", args.jobs, quiet=args.quiet
    )
    tables.show(tables.drift_effect(rows, config))


def _watch(args):
    if args.seed < 0:
        raise UsageError(f"--seed must be a whole number from 0 on, not {args.seed}")
    check_picture(args.out, ".gif")
    before, after = episodes = watch.film(args.run, args.drift, args.seed)
    watch.save(episodes, args.out)
    print(
        f"before the drift {before.returns[-1]:.1f}, after it {after.returns[-1]:.1f}; the film:"
        f" {args.out}"
    )


def _maps(args):
    check_picture(args.out, ".png")
    plots.save(watch.maps(args.run, args.booster), args.out)
    print(f"the picture: {args.out}")


def _dask(address):
    """An executor on a Dask cluster."""
    try:
        from distributed import Client
    except ImportError as e:
        raise UsageError("--dask needs Dask's scheduler: pip install -e '.[cluster]'") from e
    try:
        return Client(address).get_executor(pure=False)
    except ValueError as e:
        raise UsageError(
            f"--dask needs the address of a scheduler, like tcp://host:8786: {e}"
        ) from e


def _compare(args):
    agents = _list("--agents", args.agents)
    configs = {agent: _config(args, agent) for agent in agents}
    config = next(iter(configs.values()))
    out = Path(args.out or f"runs/{config.env}")
    summaries = {}
    for agent, config in configs.items():
        known = (out / agent / "config.json").exists()
        summaries[agent] = runs.train(config, out / agent, known, args.quiet)
    records = {agent: runs.read_episodes(out / agent) for agent in configs}
    level = summaries[config.agent]["random_return"]
    plots.save(plots.learning_curves(records, config, level), out / "comparison.png")
    tables.show(tables.regimes(summaries, config))
    print(
        f"\nthe picture: {out / 'comparison.png'}; all else: {out}/AGENT/ (delete {out} to train"
        " anew)"
    )


if __name__ == "__main__":
    sys.exit(main())

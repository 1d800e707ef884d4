"""The command line: python -m gbdqn_ref train | compare | study | bench."""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from reprlib import repr as short

import numpy as np

from . import UsageError, bench, peers, plots, runs, stats, study
from .config import CHOICES, Config

RANDOM = "random policy, stock physics"


def main(arguments=None):
    """Run a command; exit status 0, 2 after one line on what was wrong, 1 if runs of a study failed."""
    try:
        args = _parser().parse_args(arguments)
        return args.command(args) or 0
    except (UsageError, OSError) as error:
        print("gbdqn_ref:", *str(error).split(), file=sys.stderr)  # one line, whatever is in a path
        return 2
    except KeyboardInterrupt:
        print("\ngbdqn_ref: stopped; train --resume, or the same compare, goes on from the checkpoint", file=sys.stderr)
        return 130


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise UsageError(f"{message} (try {self.prog} --help)")


def _parser():
    parser = _Parser(prog="python -m gbdqn_ref", description="GB-DQN on drifting environments, in NumPy.")
    commands = parser.add_subparsers(required=True, metavar="command")
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--env", help="cartpole, mountaincar, acrobot or hopper")
    common.add_argument("--seed", type=int, help="default 0")
    common.add_argument("--preset", help="paper (default), fast, or for hopper also long")
    common.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="any setting, repeatable")
    common.add_argument("--quiet", action="store_true", help="no progress bar")
    train = commands.add_parser("train", parents=[common], help="train one agent into a folder")
    train.add_argument("--agent", help=f"gbdqn (default), {', '.join(CHOICES['agent'][1:])}")
    train.add_argument("--out", help="folder; default runs/ENV-AGENT-SEED")
    train.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    train.set_defaults(command=_train)
    compare = commands.add_parser("compare", parents=[common], help="train several agents and compare them")
    compare.add_argument("--agents", default="gbdqn,dqn", help="with commas between; default gbdqn,dqn")
    compare.add_argument("--out", help="folder; default runs/ENV; runs that it has already are finished, not repeated")
    compare.set_defaults(command=_compare)
    many = commands.add_parser("study", parents=[common], help="train many agents on many seeds, side by side")
    many.add_argument("--agents", default="all", help="all (default), or a list like gbdqn,dqn")
    many.add_argument("--seeds", default="5", help="how many (default 5: 0 to 4), or a list like 3,7")
    many.add_argument("--jobs", type=int, default=2, help="processes, default 2")
    many.add_argument("--dask", metavar="ADDRESS", help="a Dask scheduler, like tcp://host:8786, in place of processes")
    many.add_argument("--out", help="folder; default runs/study-ENV; runs that it has already are not repeated")
    many.set_defaults(command=_study)
    costs = commands.add_parser("bench", help="measure what everything costs, in one thread")
    costs.add_argument("--out", default="runs/bench.png", help="the picture; default runs/bench.png")
    costs.add_argument("--tiny", action="store_true", help="a few seconds, only to see that it runs")
    costs.set_defaults(command=_bench)
    return parser


def _config(args, agent):
    """The config that the options describe."""
    values = dict(_setting(text) for text in args.set)
    chosen = {"agent": agent, "seed": args.seed}
    values |= {key: value for key, value in chosen.items() if value is not None}
    return Config.preset(args.env or "cartpole", args.preset or "paper", **values)


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
    described = any(value not in (None, []) for value in (args.env, args.agent, args.seed, args.preset, args.set))
    if args.resume and not described:
        if not args.out:
            raise UsageError("--resume needs the --out of the run to go on with")
        config = runs.read_config(args.out)
    else:
        config = _config(args, args.agent)
    out = Path(args.out or f"runs/{config.env}-{config.agent}-{config.seed}")
    summary = runs.train(config, out, args.resume, args.quiet)
    _print_table({config.agent: summary}, config)
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
    agents = list(CHOICES["agent"]) if args.agents == "all" else _list("--agents", args.agents)
    seeds = _list("--seeds", args.seeds)
    if not all(seed.isdecimal() for seed in seeds) or seeds == ["0"] or not 1 <= args.jobs <= 1000:
        raise UsageError(f"--seeds is a count or a list like 3,7, --jobs from 1 on, not {args.seeds} and {args.jobs}")
    seeds = [int(seed) for seed in seeds] if len(seeds) > 1 else range(int(seeds[0]))
    configs = [replace(_config(args, agent), seed=seed) for seed in seeds for agent in agents]
    out = Path(args.out or f"runs/study-{configs[0].env}")
    failed = study.run_study(configs, out, _dask(args.dask) if args.dask else None, args.jobs, args.quiet)
    for run, error in failed.items():
        print(f"gbdqn_ref: {run} failed: {error}", file=sys.stderr)
    if failed:
        return 1
    summaries, _ = study.report(out)
    _print_study(summaries, configs[0])
    print(f"\nall of it: {out}/results.json and {out}/AGENT-SEED/")


def _print_study(summaries, config):
    """Per agent the mean return in each regime; of the final return mean ± std, IQM, and the difference to DQN."""
    count = len(next(iter(summaries.values())))
    final = {agent: np.array([row["final_return"] for row in rows]) for agent, rows in summaries.items()}
    print(f"\n{plots.NAMES[config.env]}, {count} runs each: mean return per regime; final return")
    for row in next(iter(summaries.values()))[0]["regimes"]:
        print(f"  {_label(row, config)}")
    print(f"\n{'':14}{'regimes':35}{'mean ± std':>20}{'IQM':>9}   minus DQN's [95 %]")
    for agent, rows in summaries.items():
        means = np.mean([[regime["mean_return"] for regime in row["regimes"]] for row in rows], axis=0)
        cells = "".join(f"{mean:8.1f}" for mean in means)
        mean, std = stats.mean_std(final[agent])
        line = f"{plots.NAMES[agent]:14}{cells:44}{mean:8.1f} ± {std or 0:5.1f}{stats.iqm(final[agent]):9.1f}"
        if "dqn" in final and agent != "dqn":
            paired = stats.paired_difference(final[agent], final["dqn"], np.random.default_rng(0))
            line += "   {:+.1f} [{:+.1f}, {:+.1f}]".format(*paired)
        print(line)
    print(
        "\nIQM: interquartile mean; the difference: IQM over seeds, paired, with a bootstrap interval (too narrow at 5)"
    )


def _dask(address):
    """An executor on a Dask cluster."""
    try:
        from distributed import Client
    except ImportError as e:
        raise UsageError("--dask needs Dask's scheduler: pip install -e '.[cluster]'") from e
    try:
        return Client(address).get_executor(pure=False)
    except ValueError as e:
        raise UsageError(f"--dask needs the address of a scheduler, like tcp://host:8786: {e}") from e


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
    plots.learning_curves(records, config, summaries[config.agent]["random_return"], out / "comparison.png")
    _print_table(summaries, config)
    print(f"\nthe picture: {out / 'comparison.png'}; all else: {out}/AGENT/ (delete {out} to train anew)")


def _bench(args):
    path = Path(args.out)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        raise UsageError(f"{path} is a folder; --out is the file that takes the picture, like {path / 'bench.png'}")
    if not peers.installed():
        print("no PyTorch or no Stable-Baselines3 here, so without them: pip install -e '.[peers]' adds both")
    scale, tables = bench.TINY if args.tiny else bench.Scale(), {}
    for title, columns, rows in bench.sections(scale):
        tables[title] = rows
        widths = [max(10, len(column) + 2) for column in columns]
        print(f"\n{title}\n" + "".join(f"{column:>{width}}" for column, width in zip(columns, widths, strict=True)))
        for label, numbers in rows.items():
            print("".join(f"{x:{width},.{_decimals(x)}f}" for x, width in zip(numbers, widths, strict=True)), "", label)
    plots.costs(*bench.curves(scale, tables), path)
    print(f"\nthe picture: {path}")


def _decimals(x):
    """How many decimals make three digits."""
    return max(0, 2 - int(max(1, x) >= 10) - int(x >= 100))


def _print_table(summaries, config):
    """Per regime and agent the mean return, the drop and the recovery; then the final return."""
    names = [plots.NAMES[agent] for agent in summaries]
    print(f"\n{plots.NAMES[config.env]}, seed {config.seed}: mean return, drop and recovery per regime")
    tables = [summary["regimes"] for summary in summaries.values()]
    labels = [_label(row, config) for row in tables[0]]
    width = max(len(label) for label in (*labels, RANDOM)) + 1
    print(f"\n{'regime':{width}}" + "".join(f"{name:>14}{'drop':>7}{'recovery':>10}" for name in names))
    for label, *rows in zip(labels, *tables, strict=True):
        cells = [f"{row['mean_return']:14.1f}{_drop(row):>7}{_recovery(row):>10}" for row in rows]
        print(f"{label:{width}}" + "".join(cells))
    final = "".join(f"{summary['final_return']:14.1f}{'':17}" for summary in summaries.values())
    print(f"{'final (last 50 episodes)':{width}}{final.rstrip()}")
    level = next(iter(summaries.values()))["random_return"]
    print(f"{RANDOM:{width}}{level:14.1f}")
    for agent, summary in summaries.items():
        if "recency_share_of_replay" in summary:
            print(
                f"\n{plots.NAMES[agent]} ended with {summary['recency_share_of_replay']:.0%} of its samples by recency"
            )
    print("\ndrop: part of the level before the drift lost in the first 20 episodes after it (random policy = 0)")
    print("recovery: episodes until a mean of 10 is back at 90 % of that level; never: not within the regime")


def _label(row, config):
    entry = next((entry for entry in config.schedule if entry["episode"] == row["first_episode"]), {})
    changed = [f"{name} × {value:g}" for name, value in entry.items() if name not in ("episode", "reset")]
    return f"{row['regime']}  {', '.join(changed) or 'stock physics'}"


def _drop(row):
    return "–" if row["drop"] is None else f"{row['drop']:.0%}"


def _recovery(row):
    return "–" if row["drop"] is None else str(row["recovery"] or "never")


if __name__ == "__main__":
    sys.exit(main())

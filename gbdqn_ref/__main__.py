"""The command line: python -m gbdqn_ref train | compare | bench."""

import argparse
import json
import sys
from pathlib import Path
from reprlib import repr as short

from . import UsageError, bench, peers, plots, runs
from .config import CHOICES, Config

RANDOM = "random policy, stock physics"


def main(arguments=None):
    """Run a command; exit status 0, or 2 after one line on what was wrong."""
    try:
        args = _parser().parse_args(arguments)
        args.command(args)
    except (UsageError, OSError) as error:
        print("gbdqn_ref:", *str(error).split(), file=sys.stderr)  # one line, whatever is in a path
        return 2
    except KeyboardInterrupt:
        print("\ngbdqn_ref: stopped; train --resume, or the same compare, goes on from the checkpoint", file=sys.stderr)
        return 130
    return 0


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


def _compare(args):
    agents = args.agents.split(",")
    if len(set(agents)) < len(agents):
        raise UsageError(f"--agents names one twice: {args.agents}")
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

"""Write the answer from the stored rows: docs/what_to_keep.md, whose words are in decision.md, and
the README's table.

python benchmarks/keep/decide.py
"""

from pathlib import Path

from conclude import hypotheses
from evidence import (
    TWINS,
    Leads,
    first_sentence,
    interval,
    markdown,
    middle,
    parts,
    side,
    signed,
    stored,
    words,
)
from protocol import FILE
from study import RESULTS

from gbdqn_ref import UsageError, files, stats
from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.schedule import LABELS

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "what_to_keep.md"
TEXT = Path(__file__).with_name("decision.md")
ANSWERING = *TWINS[0], "gb-drop", "reuse-told"
BEFORE, AFTER = "<!-- written by benchmarks/keep/decide.py -->\n", "<!-- end -->"
AGENTS = {  # the README's: arm, what it is, what tells it of a drift
    "dqn": ("DQN", "schedule"),
    "sliding": ("Sliding-window DQN", "schedule"),
    "gbdqn": ("GB-DQN, the paper's", "schedule"),
    "dqn-detected": ("DQN that drops its old data", "own detector"),
    "twin-adam": ("DQN-reuse: it stores its networks, too", "own detector"),
    "twin": ("DQN-reuse, Adam kept", "own detector"),
    "reuse": ("GB-DQN-reuse: the same, with boosters", "own detector"),
}
SITUATIONS = {  # what you know: (what to do, the arm that does it, minus which arm, part)
    "the physics changed": [
        ("drop the data", "dqn-drop", "dqn", "oracle"),
        ("drop them at the change, not by a window", "dqn-drop", "sliding", "oracle"),
        ("restart Adam too", "dqn-drop-adam", "dqn-drop", "oracle"),
        ("keep the data, freeze the network, add a booster", "plasticity", "dqn", "oracle"),
        ("drop the data, freeze the network, add a booster", "gb-drop", "dqn-drop", "oracle"),
    ],
    "old physics may return": [
        ("drop the data, store the network", "twin-told", "dqn-drop", "oracle"),
        ("the same, and restart Adam", "twin-told-adam", "dqn-drop", "oracle"),
        ("drop the data, store the network, add a booster", "reuse-told", "dqn-drop", "oracle"),
        ("the same, against the booster alone", "reuse-told", "gb-drop", "oracle"),
    ],
    "nothing changes (told of a change, or not)": [
        ("drop the data", "dqn-drop", "dqn-untold", "null"),
        ("detect, drop the data", "dqn-detected", "dqn-untold", "null"),
        ("detect, drop, store, restart Adam", "twin-adam", "dqn-untold", "null"),
        ("detect, drop, store, add a booster", "reuse", "dqn-untold", "null"),
    ],
    "you cannot tell": [
        ("detect, drop the data, against being told", "dqn-detected", "dqn-drop", "detected"),
        ("detect, drop, store", "twin", "dqn-detected", "detected"),
        ("detect, drop, store, add a booster", "reuse", "dqn-detected", "detected"),
        ("the same, against dropping when told", "reuse", "dqn-drop", "detected"),
        ("the same, on the held-out schedule", "reuse", "dqn-drop", "held-out"),
    ],
}


def table(study):
    """(header, rows): what each choice brings on each environment, and how to run it again."""
    envs = [task for task, each in study.protocol.tasks.items() if "oracle" in each["parts"]]
    rows = []
    for known, choices in SITUATIONS.items():
        for what, arm, other, part in choices:
            suffix = f"-{part}" if part in ("null", "held-out") else ""
            cells = [words(study.complete(env + suffix, arm, other)) for env in envs]
            rows.append([known, what, *cells, f"`again.py TASK{suffix} {arm} {other}`"])
            known = ""
    header = ["you know that", "choice", *map(LABELS.get, envs), "first arm minus second"]
    return header, rows


def answer(study):
    """What gains on each environment whose runs are complete: a sentence, and a table."""
    found = {
        env: parts(study, env)
        for env in study.tasks("oracle")
        if all(len(study.complete(env, arm, "dqn-drop")) for arm in ANSWERING)
    }
    if not found:
        return "No run is complete yet."
    lines = [
        f"- **{LABELS[env]}.** {verdict(*[*each.values()][:5])}" for env, each in found.items()
    ]

    def cell(x):
        return f"{words(x)}, mean {x.mean():+.1f}" if len(x) else words(x)

    told = "told: DQN that drops its data, its level"
    rows = [[told, *(middle(study.values(env, "dqn-drop")[0]) for env in found)]]
    rows += [
        [what, *(cell(each[what]) for each in found.values())]
        for what in next(iter(found.values()))
    ]
    table = markdown((["", *map(LABELS.get, found)], rows))
    return signed("\n".join(lines) + "\n\n" + table)


def verdict(store, boost, both, on_store, on_boost):
    """What the intervals say: of stored networks, of a booster, and of both, over DQN that drops
    its data; and of both over stored networks alone and over a booster alone.

    >>> import numpy as np
    >>> some, none = np.full(9, 4.0), np.arange(-4.0, 5.0)
    >>> verdict(some, some, some, none, none)
    'Reuse, not boosting, gains here: a booster is not shown to add to it.'
    """
    reuses = 1 in (side(store), side(on_boost))
    if side(on_store) == 1:
        also = ", and reuse to boosting" if reuses else "; that reuse adds to it is not shown"
        return f"Boosting adds to reuse{also}."
    if reuses:
        adds = "takes from it" if side(on_store) == -1 else "is not shown to add to it"
        return f"Reuse, not boosting, gains here: a booster {adds}."
    if side(boost) == 1:
        return "A booster gains; that it adds to reuse, or reuse to it, is not shown."
    if side(both) == 1:
        return "Reuse with boosting gains; neither is shown to gain alone."
    return "Nothing is detected beyond DQN that drops its data."


def levels(study):
    """(header, rows): the README's table, a level and its interval for each agent and task."""
    tasks = [task for task in study.tasks("oracle") if set(AGENTS) <= set(study.arms(task))]
    rows = []
    for arm, names in AGENTS.items():
        found = [study.values(task, arm)[0] for task in tasks]
        cells = [
            "{:.1f} [{:.1f}, {:.1f}], {} runs".format(stats.iqm(x), *interval(x), len(x))
            for x in found
        ]
        rows.append([*names, *cells])
    return ["agent", "drift signal", *(LABELS[task] for task in tasks)], rows


def readme(study, text):
    """The README with its table written anew."""
    if text.count(BEFORE) != 1 or text.partition(BEFORE)[2].count(AFTER) != 1:
        raise UsageError(f"a README has its table between {BEFORE.strip()} and {AFTER}")
    start = text.index(BEFORE) + len(BEFORE)
    end = text.index(AFTER, start)
    return f"{text[:start]}\n{signed(markdown(levels(study)))}\n\n{text[end:]}"


def page(study):
    """The page: decision.md with its table and sentences filled in."""
    text = TEXT.read_text(encoding="utf-8")
    _, tested = hypotheses(study)
    hold = [f"{name} ({says})" for name, says, *_, mark in tested if "holds" in mark]
    rest = {}
    for name, *_, mark in tested:
        if "holds" not in mark:
            rest.setdefault(mark, []).append(name)
    others = "; ".join(f"{', '.join(names)} {mark}" for mark, names in rest.items()) or "none"
    values = {"answer": answer(study), "table": markdown(table(study)), "others": others}
    values |= {"first": first_sentence(study), "lead": Leads(study), "hypotheses": len(tested)}
    return signed(text.format(hold="; ".join(hold) or "none", **values))


def main(arguments=None):
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--protocol", type=Path, default=FILE)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    args = parser.parse_args(arguments)
    study = stored(args.results, args.protocol)
    texts = {
        args.page: page(study),
        args.readme: readme(study, args.readme.read_text(encoding="utf-8")),
    }
    for path, text in texts.items():
        files.write_atomically(path, lambda file, text=text: file.write(text.encode()))


if __name__ == "__main__":
    program(main)

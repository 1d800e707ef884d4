"""Write the answer from the stored rows: docs/what_to_keep.md, whose words are in decision.md, and
the README's table.

python benchmarks/keep/decide.py
"""

import argparse
from pathlib import Path

import numpy as np
from conclude import interval, markdown, signed, stored, words
from protocol import FILE, command
from study import RESULTS

from gbdqn_ref import files, stats
from gbdqn_ref.schedule import LABELS

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "what_to_keep.md"
TEXT = Path(__file__).with_name("decision.md")
AGAIN = "--tasks {} --arms {}"  # of study.py report
TWINS = "twin-told", "twin-told-adam"  # Adam kept, or restarted
BEFORE, AFTER = "<!-- written by benchmarks/keep/decide.py -->\n", "<!-- end -->"
AGENTS = {  # the README's: arm, what it is, who tells it of a drift
    "dqn": ("DQN", "the schedule"),
    "sliding": ("Sliding-window DQN", "nobody"),
    "gbdqn": ("GB-DQN, the paper's", "the schedule"),
    "dqn-detected": ("DQN that drops its old data", "itself"),
    "twin-adam": ("DQN-reuse: it stores its networks, too", "itself"),
    "twin": ("DQN-reuse, Adam kept", "itself"),
    "reuse": ("GB-DQN-reuse: the same, with boosters", "itself"),
}
SITUATIONS = {  # what you know: (what to do, the arm that does it, minus which arm, part)
    "the physics changed for good": [
        ("keep the network, drop the data", "dqn-drop", "dqn", "oracle"),
        ("restart Adam too", "dqn-drop-adam", "dqn-drop", "oracle"),
        ("keep the data, freeze the network, add one", "plasticity", "dqn", "oracle"),
        ("drop the data, freeze the network, add one", "gb-drop", "dqn-drop", "oracle"),
    ],
    "old physics may return": [
        ("store the network at each change, too", "twin-told-adam", "dqn-drop", "oracle"),
        ("store it, and add one", "reuse-told", "dqn-drop", "oracle"),
    ],
    "nothing changed, but you are told so": [
        ("drop the data", "dqn-drop", "dqn-untold", "null"),
    ],
    "you cannot tell": [
        ("detect, drop the data", "dqn-detected", "dqn-drop", "detected"),
        ("detect, drop, store, add one", "reuse", "dqn-detected", "detected"),
        ("the same, against one that is told", "reuse", "dqn-drop", "detected"),
        ("the same, on the held-out schedule", "reuse", "dqn-drop", "held-out"),
        ("the same, where nothing changes", "reuse", "dqn-untold", "null"),
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
            again = AGAIN.format(f"TASK{suffix}", f"{other},{arm}")
            rows.append([known, what, f"{arm} − {other}", *cells, f"`{again}`"])
            known = ""
    return ["you know that", "choice", "", *map(LABELS.get, envs), "to run it again"], rows


def answer(study):
    """A line for each environment whose runs are complete: what gains there."""
    lines = []
    for env in study.tasks("oracle"):
        gains = [study.complete(env, twin, "dqn-drop") for twin in TWINS]
        leads = [study.complete(env, "reuse-told", twin) for twin in TWINS]
        both = study.complete(env, "reuse-told", "dqn-drop")
        alone = study.complete(env, "gb-drop", "dqn-drop")
        if all(map(len, [*gains, *leads, alone])):
            k = int(np.argmax(stats.iqm(gains)))  # the better twin
            lines.append(f"- **{LABELS[env]}.** {verdict(gains[k], leads[k], both, alone)}")
    return "\n".join(lines) or "No run is complete yet."


def verdict(gain, lead, both, alone):
    """What the intervals say: of reuse's gain, boosting's lead over it, both, and boosting's own.

    >>> verdict(np.full(9, 4.0), np.arange(-4.0, 5.0), np.full(9, 4.0), np.full(9, 4.0))[:31]
    'Reuse, not boosting, gains here'
    """
    first = {
        (True, True): "Reuse gains, and boosting adds to it",
        (True, False): "Reuse, not boosting, gains here",
        (False, True): "Reuse gains with boosting only",
        (False, False): "Nothing is detected beyond DQN that drops its data",
    }[interval(gain)[0] > 0, interval(lead)[0] > 0]
    if first.startswith("Nothing") and interval(both)[0] > 0:
        first = "Reuse with boosting gains; what boosting adds to reuse is not shown"
    return (
        f"{first}. Over DQN that drops its data, stored networks bring {words(gain)}, a booster "
        f"with nothing stored {words(alone)}, both together {words(both)}; over the better of two "
        f"twins that store networks, boosters bring {words(lead)}."
    )


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
    return ["agent", "told of drifts by", *(LABELS[task] for task in tasks)], rows


def readme(study, text):
    """The README with its table written anew."""
    start, end = text.index(BEFORE) + len(BEFORE), text.index(AFTER)
    return f"{text[:start]}\n{signed(markdown(levels(study)))}\n\n{text[end:]}"


def page(study):
    """The page: decision.md with its table and sentences filled in."""
    text = TEXT.read_text(encoding="utf-8")
    return text.format(answer=answer(study), table=markdown(table(study)))


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
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
    command(main)

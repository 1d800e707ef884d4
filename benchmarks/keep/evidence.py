"""The stored rows of a study, the differences between its arms, and what their intervals say.

Nothing is trained and nothing is written. The seeds are paired: a difference is that of two arms on
the same seeds, its centre the interquartile mean (IQM), its interval bootstrapped.
"""

import re
from math import comb, inf

import numpy as np
from protocol import FILE, Protocol
from study import RESULTS, Store, chosen

from gbdqn_ref import UsageError, stats
from gbdqn_ref.schedule import LABELS

REFERENCE = {  # part of the study: the arm that the others are compared with
    "oracle": "dqn-drop",
    "detected": "dqn-detected",
    "random": "dqn-detected",
    "null": "dqn-untold",
    "held-out": "dqn-drop",
}
TWINS = ("twin-told", "twin-told-adam"), ("twin", "twin-adam")  # Adam kept, or restarted
STORES = "stored networks, over DQN that drops its data"


class Study:
    """The rows of a study, {(task, arm): {seed: row}}, and the returns of its decisive arms."""

    def __init__(self, store):
        self.protocol, self.returns, self.rows = store.protocol, store.returns, {}
        self.reference = REFERENCE | store.protocol.content.get("reference", {})
        for (task, arm, seed), row in sorted(store.rows.items()):
            self.rows.setdefault((task, arm), {})[seed] = row

    def tasks(self, part):
        """The tasks of a part of the study that have rows."""
        return [task for task in self.protocol.tasks if self.arms(task, part)]

    def arms(self, task, part=None):
        """The arms of a task that have rows, of one part or of all."""
        parts = {each for each in self.protocol.parts(task) if part in (each, None)}
        return [
            arm
            for arm, content in self.protocol.arms.items()
            if (task, arm) in self.rows and parts & set(content["parts"])
        ]

    def runs(self, *parts):
        """Every (task, arm) of some parts of the study that has rows."""
        return [(t, arm) for part in parts for t in self.tasks(part) for arm in self.arms(t, part)]

    def config(self, task, arm):
        """The Config of an arm's first run."""
        return self.protocol.reported(task, arm, min(self.rows[task, arm]))

    def values(self, task, *arms, of="value"):
        """One number per seed that all arms have, (arms, seeds): a function of the row, or the
        mean of what it has under a name.
        """
        measure = of if callable(of) else lambda row: np.mean(row[of])
        rows = [self.rows.get((task, arm), {}) for arm in arms]
        seeds = sorted(set.intersection(*map(set, rows)))
        return np.array([[measure(each[seed]) for seed in seeds] for each in rows])

    def difference(self, task, arm, other, of="value"):
        """Arm minus other on the same seeds."""
        return np.subtract(*self.values(task, arm, other, of=of))

    def complete(self, task, arm, other):
        """Their difference, or nothing before both have the seeds of the first look."""
        x = self.difference(task, arm, other)
        return x if len(x) >= self.protocol.looks["seeds"][0] else x[:0]

    def curves(self, task, arm):
        """{seed: returns (episodes,)} of a decisive arm; a diverged run counts as random."""
        stored, found = self.returns.get(task, {}), {}
        for seed, row in self.rows.get((task, arm), {}).items():
            if f"{arm}-{seed}" in stored:
                found[seed] = stored[f"{arm}-{seed}"].astype(float)
            elif "diverged" in row and arm in self.protocol.content["decisive"]:
                found[seed] = np.full(self.config(task, arm).episodes, row["value"])
        return found


def stored(results=RESULTS, protocol=FILE):
    """The study in a folder; what it has not tuned has the settings that are tuned here."""
    tuned = chosen(RESULTS) | chosen(results)
    store = Store(Protocol(protocol, tuned), results)
    if not store.rows:
        raise UsageError(f"there is no run in {results}; study.py report writes some")
    return Study(store)


def exact_interval(k, n, level=0.95):
    """The exact interval of a share k / n (Clopper and Pearson 1934), by bisection.

    >>> [round(end, 4) for end in exact_interval(1, 2)]  # 1 − √.975, √.975
    [0.0126, 0.9874]
    """

    def solve(least, target):
        """The p at which P(X ≥ least) reaches the target."""
        low, high = 0.0, 1.0
        for _ in range(60):
            p = (low + high) / 2
            tail = sum(comb(n, i) * p**i * (1 - p) ** (n - i) for i in range(least, n + 1))
            low, high = (p, high) if tail < target else (low, p)
        return low

    beyond = (1 - level) / 2
    return (solve(k, beyond) if k else 0.0), (solve(k + 1, 1 - beyond) if k < n else 1.0)


def improvement(x, y):
    """P(X > Y) over all pairs of runs, where a tie counts half (Agarwal et al. 2021).

    >>> improvement([1, 2], [0, 2])
    0.625
    """
    x, y = np.asarray(x)[:, None], np.asarray(y)
    return float(np.mean((x > y) + 0.5 * (x == y)))


def interval(x):
    """The 95 % interval of the IQM."""
    return stats.bootstrap_interval(x, np.random.default_rng(0))


def side(x):
    """1 or −1 if the interval lies above or below 0; 0 if it contains 0, or nothing is there."""
    low, high = interval(x) if len(x) else (0, 0)
    return (low > 0) - (high < 0)


def words(x):
    """IQM of differences and its interval; no interval of a single one."""
    if not len(x):
        return "–"
    ends = " [{:+z.1f}, {:+z.1f}]".format(*interval(x)) if len(x) > 1 else ""
    return signed(f"{stats.iqm(x):+z.1f}{ends}")


class Leads:
    """{lead:TASK ARM OTHER} in a text is what words() says of a difference; with a fourth word, of
    what the rows have under that name.
    """

    def __init__(self, study):
        self.study = study

    def __format__(self, spec):
        return words(self.study.difference(*spec.split()))


def signed(text):
    """A text whose negative numbers have a minus sign in place of a hyphen.

    >>> signed("dqn-2000 -1.5 [-2, +3]")
    'dqn-2000 −1.5 [−2, +3]'
    """
    return re.sub(r"(?<![\w-])-(?=\d)", "−", text)


def middle(x, form="z.1f"):
    """The IQM in words."""
    return format(stats.iqm(x), form) if len(x) else "–"


def parts(study, env):
    """{what it is: difference (seeds,)} of the parts of the recipe, alone and together.

    Of the two agents that store networks, with Adam kept or restarted, the better one counts.
    """

    def level(twin):
        (values,) = study.values(env, twin)
        return stats.iqm(values) if len(values) else -inf

    stores, detects = (max(twins, key=level) for twins in TWINS)
    pairs = {
        f"told: {STORES}": (stores, "dqn-drop"),
        "told: a booster, over the same": ("gb-drop", "dqn-drop"),
        "told: both, over the same": ("reuse-told", "dqn-drop"),
        "told: both, over stored networks": ("reuse-told", stores),
        "told: both, over a booster": ("reuse-told", "gb-drop"),
        f"detecting: {STORES}": (detects, "dqn-detected"),
        "detecting: both, over the same": ("reuse", "dqn-detected"),
        "detecting: both, over stored networks": ("reuse", detects),
    }
    return {what: study.complete(env, *pair) for what, pair in pairs.items()}


def first_sentence(study):
    """What boosting does to reuse on each task, with the drifts told and with them detected."""
    does = {1: "adds to reuse", 0: "is not shown to add to reuse", -1: "takes from reuse"}
    clauses = []
    for env in study.tasks("oracle"):
        found = parts(study, env)
        both, stores = (
            [found[f"{how}: {what}"] for how in ("told", "detecting")]
            for what in ("both, over stored networks", STORES)
        )
        if all(map(len, both)):
            told, detecting = map(side, both)
            clause = f"boosting {does[told]} where the agent is told, and {does[detecting]}"
            clause += " where it detects"
            if told == detecting:
                clause = f"boosting {does[told]}, whether the agent is told or detects"
            if 1 not in (told, detecting) and all(side(x) == 1 for x in stores):
                clause = f"reuse, not boosting, gains: {clause}"
            clauses.append(f"on {LABELS[env]} {clause}")
    text = "; ".join(clauses)
    return f"{text[:1].upper()}{text[1:]}." if text else "No task is complete yet."


def markdown(table):
    """A table in Markdown, or a dash if it has no rows."""
    header, rows = table
    lines = [header, ["---"] * len(header), *rows]
    cells = [" | ".join(str(cell).replace("|", "\\|") for cell in line) for line in lines]
    return "\n".join(f"| {line} |" for line in cells) if rows else "–"

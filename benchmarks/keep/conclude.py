"""Draw the conclusions of the study from its stored rows: one page and two pictures.

    python benchmarks/keep/conclude.py

Everything is computed from rows.jsonl, TASK.npz and TASK-tuned.json in --results, and written to
README.md, keep.png and drifts.png beside them. Nothing is trained. A table has what is there, and
the page says what is missing.
"""

import sys
import tomllib
from functools import partial
from itertools import pairwise, takewhile
from pathlib import Path

import calibrate
import drawings
import numpy as np
from evidence import (
    Leads,
    exact_interval,
    first_sentence,
    improvement,
    interval,
    markdown,
    middle,
    side,
    signed,
    stored,
    words,
)
from protocol import FILE, runs_of
from study import FINAL, RESULTS

from gbdqn_ref import files, stats
from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.stats import EDGE

HERE = Path(__file__).parent
TEXT, EXPLORATORY = HERE / "conclusions.md", HERE / "exploratory.md"
TARGETS = tomllib.loads((HERE / "targets.toml").read_text(encoding="utf-8"))["targets"]
PARTS = {
    "oracle": "told of the drifts",
    "detected": "detecting the drifts",
    "random": "alarms at random episodes",
    "null": "nothing changes",
    "held-out": "the held-out schedule",
}
HEARING = {  # an arm, and the same arm that is told, or gets its alarms at random
    "dqn-detected": ("dqn-drop", "dqn-random"),
    "twin": ("twin-told", None),
    "twin-adam": ("twin-told-adam", None),
    "reuse": ("reuse-told", "reuse-random"),
}
DATA = ("dqn-drop", "dqn")  # P1: what is changed, with and without
NETWORK = [
    ("plasticity", "dqn"),
    ("twin-told", "dqn-drop"),
    ("gb-drop", "dqn-drop"),
    ("reuse-told", "dqn-drop"),
]
ADAM = [("dqn-drop-adam", "dqn-drop"), ("twin-told-adam", "twin-told")]
DECISIVE = [  # (arm, minus which arm): told of the drifts, and detecting them
    ("dqn-drop", "dqn"),
    ("twin-told", "dqn-drop"),
    ("gb-drop", "dqn-drop"),
    ("reuse-told", "dqn-drop"),
    ("reuse-told", "twin-told"),
    ("reuse-told", "twin-told-adam"),
    ("twin", "dqn-detected"),
    ("reuse", "dqn-detected"),
    ("reuse", "twin"),
    ("reuse", "twin-adam"),
    ("reuse", "dqn-drop"),
]
LEADS = [  # looked at once more on the held-out schedule
    ("dqn-drop", "dqn"),
    ("twin-adam", "dqn-drop"),
    ("reuse", "dqn-drop"),
    ("reuse", "twin-adam"),
]
FOUND, COSTS = 0.9, 5.0  # targets: share of costly drifts, percent of the span where none is


# --- the tables: (header, rows) -------------------------------------------------------------------


def mean_of(name, places):
    """A function of a row: the mean of what it has under this name at these places."""
    return lambda row: np.mean(np.take(row[name], places))


def completeness(study):
    """How many runs of the first look are there, and how many are missing of which arm."""
    low, n = study.protocol.seeds["report"][0], study.protocol.looks["seeds"][0]
    table = []
    for task in study.protocol.tasks:
        wanted = study.protocol.arms_of(task)
        rows = [study.rows.get((task, arm), {}) for arm in wanted]
        there = [sum(seed < low + n for seed in each) for each in rows]
        missing = [f"{arm} {n - k}" for arm, k in zip(wanted, there, strict=True) if k < n]
        shown = ", ".join(missing) if any(there) else "all"
        table.append([task, f"{sum(there)} of {n * len(wanted)} runs", shown])
    there = f"stored, of the first look's {n} seeds"
    return ["task", there, "missing"], table


def definitions(protocol):
    """What each arm is: its agent, the settings that define it, and the parts it is in."""
    table = []
    for arm, content in protocol.arms.items():
        settings = ", ".join(f"{name} = {x}" for name, x in content.get("set", {}).items())
        table.append([f"`{arm}`", content["agent"], settings, ", ".join(content["parts"])])
    return ["arm", "agent", "settings", "parts"], table


def targets(study):
    """What was hoped for, the smallest lead that was measured, and whether it is enough."""
    table = []
    for each in TARGETS:
        task, arm, of = each["task"], each["arm"], each.get("of", "value")
        leads = {other: study.difference(task, arm, other, of) for other in each["against"]}
        if all(map(len, leads.values())):
            other, lead = min(leads.items(), key=lambda pair: stats.iqm(pair[1]))
            low, least = "low" in each, each["least"]
            met = (interval(lead)[0] if low else stats.iqm(lead)) >= least
            wanted = f"{'lower end ' if low else ''}≥ {least:g}"
            verdict = "met" if met else f"missed: {each['why']}"
            table.append([task, each["says"], wanted, f"{words(lead)} over {other}", verdict])
    return ["task", "target", "", "measured", ""], table


def pairs(study):
    """The leads that decide: primary metric, first episodes, last ones, per step, P(better)."""
    table, measures = [], ("value", "first", "final")
    for task in study.tasks("oracle"):
        for arm, other in DECISIVE:
            if len(study.complete(task, arm, other)):
                leads = [study.difference(task, arm, other, of) for of in measures]
                leads.append(per_step_lead(study, task, arm, other))
                better = improvement(*study.values(task, arm, other))
                table.append([task, f"{arm} − {other}", *map(words, leads), f"{better:.2f}"])
    names = ["IQM", f"first {EDGE}", f"last {FINAL}", "at equal steps", "better"]
    return ["task", "lead", *names], table


def hypotheses(study):
    """Effect against the strongest opponent, p at the last look reached, and the decision."""
    protocol, table = study.protocol, []
    low, looks = protocol.seeds["report"][0], protocol.looks["seeds"]
    results = {}
    for run, rows in study.rows.items():
        seeds = takewhile(rows.__contains__, range(low, low + looks[-1]))
        results[run] = np.array([rows[seed]["value"] for seed in seeds])
    decided = protocol.decisions(results, np.random.default_rng(0))
    rng = np.random.default_rng(0)  # once more the p of these decisions
    p = {n: protocol.p_values(results, n, rng) for n in looks}
    for each in protocol.hypotheses:
        reached = min(len(results.get(run, ())) for run in runs_of(each))
        look = max((n for n in looks if n <= reached), default=None)
        effect, chance = "–", "–"
        if look:
            leads = [
                (results[task, each["arm"]][:look] - results[task, other][:look], other, task)
                for task in each["tasks"]
                for other in each["against"]
            ]
            lead, other, task = min(leads, key=lambda lead: stats.iqm(lead[0]))
            effect = f"{words(lead)} over {other}, {task}"
            still = [id for id, at in decided.items() if at is None or at >= look]
            adjusted = dict(zip(still, stats.holm([p[look][id] for id in still]), strict=True))
            corrected = f", corrected {adjusted[each['id']]:.4f}" if each["id"] in adjusted else ""
            chance = f"{p[look][each['id']]:.4f}{corrected}, {look} seeds"
        decision = decided[each["id"]]
        rest = "not shown" if look == looks[-1] else "open"
        verdict = f"**holds**, at {decision} seeds" if decision else rest
        says = f"{', '.join(each['tasks'])}: {each['says']}"
        table.append([each["id"], says, effect, each["margin"], chance, verdict])
    return ["", "hypothesis", "effect", "margin", "p", "decision"], table


def arms(study, task, part):
    """Every arm of a task's part: levels, failures, first episodes, difference to the reference."""
    table, reference = [], study.reference[part]
    everyone = study.arms(task)
    ends = {arm: study.values(task, arm, of="final")[0] for arm in everyone}
    lowest = calibrate.random_return(study.config(task, everyone[0]).env)
    bar = (lowest + max(map(stats.iqm, ends.values()))) / 2
    for arm in study.arms(task, part):
        (value,), (first,) = study.values(task, arm), study.values(task, arm, of="first")
        (before,) = study.values(task, arm, of=mean_of("regimes", [0]))
        failed, n = int(np.sum(ends[arm] < bar)), len(value)
        share = "{} of {} [{:.0%}, {:.0%}]".format(failed, n, *exact_interval(failed, n))
        diverged = sum("diverged" in row for row in study.rows[task, arm].values())
        levels = [middle(value), f"{value.mean():z.1f}", f"{value.min():z.1f}"]
        apart = ["", ""]
        if arm != reference and reference in everyone:
            better = improvement(value, study.values(task, reference)[0])
            apart = [words(study.difference(task, arm, reference)), f"{better:.2f}"]
        failures = share + (f", {diverged} diverged" if diverged else "")
        returns = map(middle, (before, first, ends[arm]))
        table.append([arm, *levels, failures, *returns, *apart])
    header = ["arm", "IQM", "mean", "worst", "failed", "before", f"first {EDGE}", f"last {FINAL}"]
    return [*header, f"minus {reference}", "better"], table


def adaptation(study, task):
    """What the drifts cost each arm, and how it comes back."""
    table = []
    for arm in study.arms(task):
        config, rows = study.config(task, arm), study.rows[task, arm].values()
        stock = [k for k, regime in enumerate(config.regimes[1:]) if not regime.drifted]
        losses = [lost(x, config) for x in study.curves(task, arm).values()]
        drop, area = np.array([each for each in losses if each]).reshape(-1, 2).T
        (first,) = study.values(task, arm, of="first")
        again = study.values(task, arm, of=mean_of("first", stock))[0] if stock else []
        every = [row["evaluation"] for row in rows if row["evaluation"]]
        forgotten = middle([np.mean(stats.forgetting(each)) for each in every])
        levels = [middle(drop, "z.0%"), middle(first), middle(area, "z.0%")]
        recovered = "–"
        if fell := [k for row in rows for k in row["recovery"] if k != 0]:
            back = stats.median_recovery(fell)
            recovered = "never" if back is None else f"{back:g}"
        table.append([arm, *levels, recovered, middle(again), forgotten])
    names = ["drop", f"first {EDGE}", "area lost", "recovered after", "back in stock", "forgotten"]
    return ["arm", *names], table


def lost(returns, config):
    """(drop, area lost) of a run, means over its drifts; None if it had nothing to lose."""
    records = [
        {"episode": k, "regime": i, "event": regime.event, "return": returns[k]}
        for i, regime in enumerate(config.regimes)
        for k in range(regime.start, regime.end)
    ]
    table = stats.regime_table(records, calibrate.random_return(config.env))
    known = [
        (row["drop"], 1 - row["area"])
        for row in table
        if row["event"] == "drift" and row["area"] is not None
    ]
    return np.mean(known, axis=0).tolist() if known else None


def hearing(study):
    """What each detecting arm loses to the same arm that is told, and gains over random alarms."""
    table = []
    for task in study.tasks("detected"):
        for arm, (told, chance) in HEARING.items():
            gain = study.difference(task, arm, chance) if chance else []
            table.append([task, arm, words(study.difference(task, arm, told)), words(gain)])
    return ["task", "arm", "minus the same arm, told", "minus it with random alarms"], table


def detection(study):
    """What the alarms of each detecting arm found, and how many were false."""
    table = []
    for task, arm in study.runs("detected", "held-out", "null"):
        config, rows = study.config(task, arm), study.rows[task, arm].values()
        if config.resolved().drift_signal != "detector":
            continue
        each = [calibrate.judged(config, row["evaluation"], row["alarms"]) for row in rows]
        count, false = (sum(row[i] for row in each) for i in (0, 2))
        delays = [delay for _, found, _ in each for delay in found]
        changes = bool(calibrate.drifts(config))
        met = len(delays) >= FOUND * count if changes else false <= calibrate.TARGET * len(rows)
        found = f"{len(delays)} of {count}" if changes else "–"
        median = f"{np.median(delays):g}" if delays else "–"
        rate = f"{false / len(rows):.2f}"
        table.append([task, arm, len(rows), found, median, rate, "met" if met else "missed"])
    names = ["runs", "costly drifts found", "median delay", "false alarms per run", "target"]
    return ["task", "arm", *names], table


def nulls(study):
    """What each arm gains or loses where nothing changes, in percent of the span of its task."""
    table, reference = [], study.reference["null"]
    for task, arm in study.runs("null"):
        x = study.difference(task, arm, reference)
        if arm != reference and len(x):
            best = stats.iqm(study.values(task, reference, of="final")[0])
            x = 100 * x / (best - calibrate.random_return(study.config(task, reference).env))
            small = interval(x)[0] > -COSTS
            table.append([task, arm, len(x), words(x), "yes" if small else "not shown"])
    return [
        "task",
        "arm",
        "runs",
        f"% of the span, minus {reference}",
        f"within {COSTS:g} %",
    ], table


def held_out(study):
    """Leads on the schedule of a task and on its held-out one, and whether they have one sign."""
    table = []
    for task in study.tasks("held-out"):
        own = study.protocol.tasks[task]["tuned_on"]
        for pair in LEADS:
            here, there = (study.complete(each, *pair) for each in (own, task))
            signs = {(1, 1): "ahead on both", (-1, -1): "behind on both"}
            signs |= dict.fromkeys([(1, -1), (-1, 1)], "the opposite")
            sign = signs.get((side(here), side(there)), "open")
            table.append([own, " − ".join(pair), words(here), words(there), sign])
    return ["task", "lead", "its own schedule", "the held-out one", "sign"], table


def idle(study, arm):
    """How many of an arm's runs on MountainCar have learnt nothing just before the first drift."""
    curves = study.curves("mountaincar", arm).values()
    if not curves:
        return "none"
    start = study.config("mountaincar", arm).regimes[1].start
    floor = calibrate.random_return("mountaincar") + 0.5
    return f"{sum(x[start - FINAL : start].mean() <= floor for x in curves)} of {len(curves)}"


def per_step(study):
    """The differences once more, at equal numbers of environment steps."""
    table = []
    for part in ("oracle", "detected", "held-out"):
        for task, arm in study.runs(part):
            x = per_step_lead(study, task, arm, study.reference[part])
            if arm != study.reference[part] and len(x):
                both = words(study.difference(task, arm, study.reference[part])), words(x)
                table.append([task, arm, study.reference[part], *both])
    return ["task", "arm", "minus", "at equal episodes", "at equal steps"], table


def per_step_lead(study, task, arm, other):
    """Arm minus other over equal steps after the first event, on the seeds with stored returns."""
    first = study.config(task, arm).regimes[1].start
    ours, theirs = study.curves(task, arm), study.curves(task, other)
    seeds = sorted(ours.keys() & theirs.keys())
    return [at_equal_steps(ours[seed][first:], theirs[seed][first:]) for seed in seeds]


def at_equal_steps(x, y):
    """The mean return of x minus that of y, over as many steps as the shorter of the two took.

    A step costs or earns 1 on the classic tasks, so that |return| is the number of steps, or one
    less at Acrobot's goal.

    >>> at_equal_steps(np.array([-2.0, -2.0]), np.array([-1.0, -3.0, -9.0]))
    0.0
    """
    steps = [np.abs(each).cumsum() for each in (x, y)]
    budget = min(each[-1] for each in steps)
    ends = [np.searchsorted(each, budget, "right") for each in steps]
    return float(np.mean(x[: ends[0]]) - np.mean(y[: ends[1]]))


def predictions(study):
    """The predictions of mechanism: each says that one figure is larger than another."""
    table, enough = [], study.protocol.looks["seeds"][0]
    for task in study.tasks("oracle") if "predictions" in study.protocol.content else ():
        for id, larger, smaller, x, y in contrasts(study, task):
            verdict = ("open", "holds", "fails")[side(x - y) if len(x) >= enough else 0]
            both = [f"{name}: {words(z)}" for name, z in ((larger, x), (smaller, y))]
            if id == "P2":  # numbers of episodes, and no differences
                both = [each.replace("+", "") for each in both]
            table.append([f"`{id}`", task, *both, words(x - y), verdict])
    return ["", "task", "said to be larger", "than", "difference", "verdict"], table


def contrasts(study, task):
    """(prediction, what is said to be larger, than what, both per seed) of a task."""
    pairs = [DATA, *NETWORK, *ADAM]
    names = sorted({arm for pair in pairs for arm in pair})
    values = dict(zip(names, study.values(task, *names), strict=True))
    gain = {pair: values[pair[0]] - values[pair[1]] for pair in pairs}
    if len(gain[DATA]):
        best = [max(group, key=lambda pair: stats.iqm(gain[pair])) for group in (NETWORK, ADAM)]
        for larger, smaller in pairwise((DATA, *best)):
            yield "P1", " − ".join(larger), " − ".join(smaller), gain[larger], gain[smaller]
    if (task, "reuse") in study.rows:
        lengths = [r.end - r.start for r in study.config(task, "reuse").regimes[1:]]
        back, calm = (
            study.values(task, "reuse", of=partial(episodes, name, lengths))[0]
            for name in ("recovery", "calm")
        )
        yield "P2", "reuse, episodes until the return is back", "until |δ| is back", back, calm
    arms = "reuse-told", "dqn-drop"
    if len(study.difference(task, *arms)):
        factors = [regime.factors for regime in study.config(task, "dqn-drop").regimes]
        again = np.array([each in factors[:k] for k, each in enumerate(factors)])
        later, first = (
            np.subtract(*study.values(task, *arms, of=mean_of("regimes", visits)))
            for visits in (np.flatnonzero(again), np.flatnonzero(~again)[1:])
        )
        yield "P3", " − ".join(arms) + " in later visits", "in first ones", later, first


def episodes(name, lengths, row):
    """The mean of a row's recoveries; one that never comes counts as the regime's length."""
    pairs = zip(row[name], lengths, strict=True)
    return np.mean([length if k is None else k for k, length in pairs])


def verdicts(study):
    """A line per prediction: it holds if all its rows do, on every task, and fails if one does."""
    _, rows = predictions(study)
    tasks = {task for task, each in study.protocol.tasks.items() if "oracle" in each["parts"]}
    lines = []
    for each in study.protocol.content.get("predictions", []):
        name = f"`{each['id']}`"
        marks = {row[-1] for row in rows if row[0] == name}
        everywhere = {row[1] for row in rows if row[0] == name} == tasks
        holds = marks == {"holds"} and everywhere
        verdict = "fails" if "fails" in marks else "holds" if holds else "open"
        lines.append(f"- {name} **{verdict}**: {each['says']}.")
    return "\n".join(lines)


def tuning(results):
    """What was chosen for each method and task, as value and factor on the preset's own."""
    table = []
    for path in sorted(results.glob("*-tuned.json")):
        for method, each in files.read_json(path).items():
            k, mean = max(each["best"], key=lambda pair: pair[1])
            factors = {name: f" (× {f:.2f})" for name, f in each["first"][k][0].items()}
            factors["epsilon_restart"] = ""
            values = {
                name: x if isinstance(x, int) else f"{x:.3g}" for name, x in each["chosen"].items()
            }
            chosen = [f"{name} {x}{factors[name]}" for name, x in values.items()]
            task = path.name.removesuffix("-tuned.json")
            table.append([task, method, ", ".join(chosen), f"{mean:.1f}"])
    return ["task", "method", "chosen", "mean return"], table


# --- the page and the picture ---------------------------------------------------------------------

TABLES = completeness, pairs, targets, hypotheses, predictions, hearing
TABLES += detection, nulls, held_out, per_step
SHOWN = """Around each reversal of the motor. A thin line is a seed, its mean over two or three
reversals; the black line is the IQM of all.

![The returns of six agents around the reversals of a motor, all seeds](drifts.png)

Whole runs.

![Learning curves of six arms, and the share of runs above each return](keep.png)

"""


def page(study, results):
    """The page: conclusions.md with its tables and figures filled in."""
    protocol, looks = study.protocol, study.protocol.looks
    parts = [(task, part) for task in protocol.tasks for part in protocol.tasks[task]["parts"]]
    by_part = {
        f"{task}: {PARTS[part]}": arms(study, task, part)
        for task, part in parts
        if study.arms(task, part)
    }
    by_task = {f"{task}, arm by arm": adaptation(study, task) for task in study.tasks("oracle")}
    template = TEXT if protocol.hypotheses else EXPLORATORY
    text = template.read_text(encoding="utf-8").format(
        here=sys.modules[__name__],
        lead=Leads(study),
        idle={arm: idle(study, arm) for arm in ("reuse-told", "twin-told", "dqn-drop")},
        first=first_sentence(study),
        reference=study.reference["null"],
        question=protocol.content["question"],
        name=protocol.name,
        protocol=f"[`{protocol.name}`](../../../../benchmarks/keep/{protocol.name})",
        picture=SHOWN if drawings.drawn(study) else "",
        looks=", ".join(map(str, looks["seeds"])),
        error=looks["error"] / len(looks["seeds"]),
        verdicts=verdicts(study),
        definitions=markdown(definitions(protocol)),
        arms=sections(by_part),
        adaptation=sections(by_task),
        tuning=markdown(tuning(results)),
        **{table.__name__: markdown(table(study)) for table in TABLES},
    )
    return signed(text)


def sections(tables):
    """Each of {title: table} under its title."""
    return "\n\n".join(f"### {title}\n\n{markdown(each)}" for title, each in tables.items())


def main(arguments=None):
    parser = Parser(description=__doc__.splitlines()[0])
    parser.add_argument("--protocol", type=Path, default=FILE)
    parser.add_argument("--results", type=Path, default=RESULTS)
    args = parser.parse_args(arguments)
    study = stored(args.results, args.protocol)
    text = page(study, args.results).encode()
    drawings.write(study, args.results)
    files.write_atomically(args.results / "README.md", lambda file: file.write(text))


if __name__ == "__main__":
    program(main)

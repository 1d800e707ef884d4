"""The protocol of the study: what may be run, what was run, and what may be concluded.

Protocol("protocol.toml") reads the file and refuses what it does not allow: a seed outside its
range, an arm, a task or a hypothesis that is not in it, a run counted twice, a row made with other
settings or by other code.
"""

import argparse
import hashlib
import json
import tomllib
from pathlib import Path
from reprlib import repr as short

import numpy as np

from gbdqn_ref import UsageError, files, provenance, stats
from gbdqn_ref.config import Config

FILE = Path(__file__).with_name("protocol.toml")
TEXT, NAMES = (str,), [(str,)]
SHAPE = {
    "question": TEXT,
    "decisive": NAMES,
    "seeds": {"report": [(int,)]},
    "looks": {"seeds": [(int,)], "error": files.NUMBER},
    "tuning": {"methods": (dict,)},
    "tasks": (dict,),
    "arms": (dict,),
    "hypotheses": [
        {"id": TEXT, "says": TEXT, "tasks": NAMES, "arm": TEXT, "against": NAMES}
        | {"margin": files.NUMBER}
    ],
}

PLAN = {  # of the tuning, if a method is tuned
    "settings": (int,),
    "first_seeds": [(int,)],
    "best": (int,),
    "further_seeds": [(int,)],
    "shared": (dict,),
    "epsilon_restart": [files.NUMBER],
}


class Protocol:
    """The contents of a protocol, checked: every arm and task that is named exists.

    `tuned` holds the settings that its tuning has chosen, {task: {method: settings}}.
    """

    def __init__(self, path=FILE, tuned=None):
        self.name = Path(path).name
        with files.undamaged(path):
            self.content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
            files.check_shape(self.content, SHAPE, "it")
            methods = self.content["tuning"]["methods"]
            if methods:
                files.check_shape(self.content, {"tuning": PLAN, "seeds": {"tune": [(int,)]}}, "it")
            for named, shape in (
                (self.content["tasks"], {"preset": TEXT, "parts": NAMES}),
                (self.content["arms"], {"agent": TEXT, "parts": NAMES}),
                (methods, {"on": TEXT, "arms": NAMES}),
            ):
                for name, each in named.items():
                    files.check_shape(each, shape, name)
        for name in ("seeds", "looks", "tasks", "arms", "hypotheses"):
            setattr(self, name, self.content[name])
        self.tuned = {} if tuned is None else tuned
        self.method = {arm: name for name, method in methods.items() for arm in method["arms"]}
        check_plan(self.seeds, self.looks["seeds"], self.hypotheses)
        self._check_names(methods)

    def _check_names(self, methods):
        """UsageError unless every arm and task is there that the contents name."""
        tuned = (method["on"] for method in methods.values())
        for arm in (*self.content["decisive"], *self.method, *tuned):
            self.check_arm(arm)
        for name, task in self.tasks.items():
            self.parts(task.get("tuned_on", name))
        for hypothesis in self.hypotheses:
            for run in runs_of(hypothesis):
                self.check(*run)

    def parts(self, task):
        """The parts of the study that a task is in."""
        if task not in self.tasks:
            raise UsageError(f"there is no task {task!r} in the protocol; it has {[*self.tasks]}")
        return set(self.tasks[task]["parts"])

    def check_arm(self, arm):
        """UsageError unless this arm is in the protocol."""
        if arm not in self.arms:
            raise UsageError(f"there is no arm {arm!r} in the protocol; it has {[*self.arms]}")

    def check(self, task, arm, seed=None, purpose="report"):
        """UsageError unless this run is in the protocol."""
        parts = self.parts(task)
        self.check_arm(arm)
        if not parts & set(self.arms[arm]["parts"]):
            raise UsageError(f"the arm {arm} is in no part of the study that {task} is in")
        low, high = self.seeds[purpose]
        if seed is not None and not low <= seed <= high:
            raise UsageError(f"seeds to {purpose} are {low} to {high}, not {seed}")

    def arms_of(self, task):
        """The arms of a task, in the protocol's order."""
        parts = self.parts(task)
        return [arm for arm in self.arms if parts & set(self.arms[arm]["parts"])]

    def reported(self, task, arm, seed):
        """The Config of a run to report, with the settings chosen for its method on its task.

        A task without a drift, or with a held-out schedule, has the settings of its own task. An
        arm of no method that is tuned has the preset's.
        """
        self.check(task, arm, seed)
        if arm not in self.method:
            return self.config(task, arm, seed)
        task_of_tuning = self.tasks[task].get("tuned_on", task)
        tuned, method = self.tuned.get(task_of_tuning, {}), self.method[arm]
        if method not in tuned:
            raise UsageError(f"{task} is reported after {task_of_tuning} is tuned")
        return self.config(task, arm, seed, **tuned[method])

    def config(self, task, arm, seed, purpose="report", **tuned):
        """The Config of one run; `tuned` settings yield to those that define the arm."""
        self.check(task, arm, seed, purpose)
        values = tuned | self.arms[arm].get("set", {})
        given = self.tasks[task].get("set", {}) | tuned
        agent = self.arms[arm]["agent"]
        config = Config.preset(self.tasks[task]["preset"], agent=agent, seed=seed, **given)
        if values.get("drift_signal") == "random":
            values["drift_signal"] = random_alarms(config)
        return Config.from_dict(config.to_dict() | values)

    def check_rows(self, rows):
        """UsageError unless each row is a reported run of the protocol, once, with its settings and
        a figure for each regime, and all runs of an arm were made by the same code.
        """
        seen, codes = set(), {}
        for row in rows:
            run = row["task"], row["arm"], row["seed"]
            self.check(*run)
            if run in seen:
                raise UsageError(f"the run {run} is counted twice")
            config = self.reported(*run)
            if row["settings"] != settings_hash(config):
                raise UsageError(f"the run {run} was made with other settings")
            n = len(config.regimes)
            lengths = [len(row[name]) for name in ("regimes", "first", "recovery", "calm")]
            evaluated = [len(each) for each in row["evaluation"]]
            if lengths != [n, n - 1, n - 1, n - 1] or evaluated not in ([], [n] * n):
                raise UsageError(f"the run {run} has not one figure for each of its {n} regimes")
            first = codes.setdefault(row["arm"], row["code"])
            if row["code"] != first:
                raise UsageError(f"the run {run} was made by code {row['code']}, not {first}")
            seen.add(run)

    def p_values(self, results, n, rng):
        """{hypothesis: p} from the first n seeds of {(task, arm): returns (seeds,)}.

        A hypothesis on several tasks or against several arms asks for all of them at once, so that
        its p is their largest (intersection-union). It is 1 while one of its arms has fewer seeds.
        """
        generators = rng.spawn(len(self.hypotheses))  # so no p depends on which others are there
        return {
            each["id"]: max(
                stats.sign_flip_test(
                    results[task, each["arm"]][:n] - results[task, other][:n],
                    generator,
                    each["margin"],
                )
                for task in each["tasks"]
                for other in each["against"]
            )
            if all(len(results.get(run, ())) >= n for run in runs_of(each))
            else 1.0
            for each, generator in zip(self.hypotheses, generators, strict=True)
        }

    def decisions(self, results, rng):
        """{hypothesis: the look (seeds) at which it was decided for, or None}.

        A hypothesis is not looked at before all its arms have the seeds, but Holm's correction
        counts it from the start.
        """
        looks = self.looks["seeds"]
        decided = dict.fromkeys(each["id"] for each in self.hypotheses)
        error = self.looks["error"] / len(looks)
        for n in looks:
            p = self.p_values(results, n, rng)
            still = [id for id, look in decided.items() if look is None]
            for id, adjusted in zip(still, stats.holm([p[id] for id in still]), strict=True):
                if adjusted <= error:
                    decided[id] = n
        return decided


def check_plan(seeds, looks, hypotheses):
    """UsageError for seeds, looks or hypotheses that decide nothing."""
    if any(len(each) != 2 for each in seeds.values()):
        raise UsageError(f"a protocol's seeds are a first and a last one, not {seeds}")
    if not looks or looks != sorted({*looks}) or looks[0] < 1:
        raise UsageError(f"a protocol looks at more and more seeds, from 1 on, not at {looks}")
    ids = [each["id"] for each in hypotheses]
    if len(set(ids)) < len(ids) or len(ids) > 8:
        raise UsageError(f"a protocol has at most eight hypotheses, each once, not {ids}")
    if not all(each["tasks"] and each["against"] for each in hypotheses):
        raise UsageError("each hypothesis needs a task, and an arm to be ahead of")


def count(text):
    """The value of an option that is a whole number from 1 to a thousand."""
    if not text.isdecimal() or len(text) > 4 or not 1 <= int(text) <= 1000:
        raise argparse.ArgumentTypeError(
            f"must be a whole number from 1 to 1000, not {short(text)}"
        )
    return int(text)


def runs_of(hypothesis):
    """Every (task, arm) that a hypothesis speaks of."""
    arms = [hypothesis["arm"], *hypothesis["against"]]
    return [(task, arm) for task in hypothesis["tasks"] for arm in arms]


def random_alarms(config):
    """As many episodes as the schedule has events, drawn from the seed, in order."""
    rng = np.random.default_rng([config.seed, 1])
    first = config.regimes[1].start
    count = len(config.regimes) - 1
    return sorted(
        int(k) for k in rng.choice(np.arange(first, config.episodes), count, replace=False)
    )


def primary(records, config):
    """The mean return of all episodes from the first event on."""
    return float(np.mean([record["return"] for record in records[config.regimes[1].start :]]))


def settings_hash(config):
    """A hash of every setting of a run."""
    return _hash(config.resolved().to_dict())


def code_hash(config):
    """A hash of the code that makes a run; its schedule belongs to the settings."""
    return _hash(provenance.code(config) | {"schedule": ""})


def _hash(content):
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]

"""The protocol of the study: what may be run, what was run, and what may be concluded.

Protocol("protocol.toml") reads the file and refuses what it does not allow: a seed outside its
range, an arm, a task or a hypothesis that is not in it, a run counted twice, a row made by other
code.
"""

import tomllib
from pathlib import Path

import numpy as np

from gbdqn_ref import UsageError, stats
from gbdqn_ref.config import Config

FILE = Path(__file__).with_name("protocol.toml")


class Protocol:
    """The contents of a protocol, checked: every arm, task and part that is named exists."""

    def __init__(self, path=FILE):
        self.content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        for name in ("seeds", "looks", "tasks", "arms", "hypotheses"):
            setattr(self, name, self.content[name])
        ids = [each["id"] for each in self.hypotheses]
        if len(set(ids)) < len(ids) or len(ids) > 8:
            raise UsageError(f"a protocol has at most eight hypotheses, each once, not {ids}")
        for hypothesis in self.hypotheses:
            for task in hypothesis["tasks"]:
                for arm in [hypothesis["arm"], *hypothesis["against"]]:
                    self.check(task, arm)

    def check(self, task, arm, seed=None, purpose="report"):
        """UsageError unless this run is in the protocol."""
        if task not in self.tasks:
            raise UsageError(f"there is no task {task!r} in the protocol; it has {[*self.tasks]}")
        if arm not in self.arms:
            raise UsageError(f"there is no arm {arm!r} in the protocol; it has {[*self.arms]}")
        if not set(self.tasks[task]["parts"]) & set(self.arms[arm]["parts"]):
            raise UsageError(f"the arm {arm} is in no part of the study that {task} is in")
        low, high = self.seeds[purpose]
        if seed is not None and not low <= seed <= high:
            raise UsageError(f"seeds to {purpose} are {low} to {high}, not {seed}")

    def runs(self, task, purpose, seeds):
        """{"ARM-SEED": Config} of every arm of a task."""
        arms = [
            arm
            for arm in self.arms
            if set(self.arms[arm]["parts"]) & set(self.tasks[task]["parts"])
        ]
        return {
            f"{arm}-{seed}": self.config(task, arm, seed, purpose) for seed in seeds for arm in arms
        }

    def config(self, task, arm, seed, purpose="report", **tuned):
        """The Config of one run; `tuned` settings yield to those that define the arm."""
        self.check(task, arm, seed, purpose)
        values = tuned | self.arms[arm].get("set", {})
        config = Config.preset(
            self.tasks[task]["preset"], agent=self.arms[arm]["agent"], seed=seed, **tuned
        )
        if values.get("drift_signal") == "random":
            values["drift_signal"] = random_alarms(config)
        return Config.from_dict(config.to_dict() | values)

    def check_rows(self, rows):
        """UsageError unless each row is a reported run of the protocol, once, and all runs of an
        arm were made by the same code.
        """
        seen, codes = set(), {}
        for row in rows:
            run = row["task"], row["arm"], row["seed"]
            self.check(*run)
            if run in seen:
                raise UsageError(f"the run {run} is counted twice")
            first = codes.setdefault(row["arm"], row["code"])
            if row["code"] != first:
                raise UsageError(f"the run {run} was made by code {row['code']}, not {first}")
            seen.add(run)

    def p_values(self, results, n, rng):
        """{hypothesis: p} from the first n seeds of {(task, arm): returns (seeds,)}.

        A hypothesis on several tasks or against several arms asks for all of them at once, so that
        its p is their largest (intersection-union).
        """
        return {
            each["id"]: max(
                stats.sign_flip_test(
                    results[task, each["arm"]][:n] - results[task, other][:n], rng, each["margin"]
                )
                for task in each["tasks"]
                for other in each["against"]
            )
            for each in self.hypotheses
        }

    def decisions(self, results, rng):
        """{hypothesis: the look (seeds) at which it was decided for, or None}."""
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

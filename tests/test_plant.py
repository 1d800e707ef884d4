"""Checks of the paper see planted faults: each claim has one, and a sample of them is planted.

All of them: python paper_checks/plant.py.
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "paper_checks"))
import ledger
import plant

TESTS = plant.checks()
SAMPLE = list(plant.FAULTS)[::20]  # a few seconds
ALPHA = {"ids": ["T1-j"], "file": "gbdqn_ref/boosting.py", "old": "alpha = float(A / B)"}


def test_every_claim_that_has_a_check_has_a_fault():
    """And every claim has a check but those whose verdict needs none."""
    planted = {id for fault in plant.FAULTS.values() for id in fault["ids"]}
    assert planted == TESTS.keys()
    checkable = {
        id for id, each in ledger.CLAIMS.items() if each["verdict"] not in ledger.UNCHECKED
    }
    assert checkable <= planted


@pytest.mark.parametrize("name", plant.FAULTS)
def test_a_fault_changes_one_place(name):
    fault = plant.FAULTS[name]
    text = (plant.ROOT / fault["file"]).read_text(encoding="utf-8")
    assert text.count(fault["old"]) == 1 and fault["new"] != fault["old"]


def test_a_sample_of_the_faults_is_seen():
    """By every claim that names them."""
    faults = {name: plant.FAULTS[name] for name in SAMPLE}
    for name, red in plant.seen_by(faults, TESTS).items():
        assert all(TESTS[id] & red for id in faults[name]["ids"]), name


@pytest.mark.parametrize(
    ("fault", "is_seen"),
    [
        (ALPHA | {"new": "alpha = -float(A / B)"}, True),
        (ALPHA | {"new": "alpha = 1.0 * float(A / B)"}, False),  # no fault
        (ALPHA | {"new": "alpha = float(A // 0)"}, False),  # no assertion
        (  # a helper of the check asserts that Q was right before the drift
            {
                "ids": ["T2-d"],
                "file": "gbdqn_ref/tabular.py",
                "old": "self.gamma * (self.P @ Q.max(-1))",
                "new": "(self.P @ Q.max(-1))",
            },
            False,
        ),
        (  # a figure alone: GB-DQN's lead on Acrobot is .43
            {"ids": ["X2"], "file": "paper_checks/paper.py", "old": "(-140.16", "new": "(-149.16"},
            False,
        ),
    ],
    ids=["sign", "nothing", "exception", "helper", "figure"],
)
def test_only_a_failed_assertion_of_the_conclusion_counts(fault, is_seen):
    tests = {id: TESTS[id] for id in fault["ids"]}
    assert (not list(plant.unseen({"slip": fault}, tests))) == is_seen

"""Training an episode uses one BLAS thread; at all other times the number is unchanged."""

import json
import subprocess
import sys

import pytest
from helpers import SMALL, environ

INTERLEAVED = """
import json, sys
import {first}
from threadpoolctl import threadpool_info
from gbdqn_ref import train
from gbdqn_ref.train import Config, run

seen = {{"inside": [], "between": [], "evaluating": []}}
threads = lambda: sorted({{pool["num_threads"] for pool in threadpool_info()}})

def note(where, call):
    return lambda *arguments: (seen[where].append(threads()), call(*arguments))[1]

train._train_episode = note("inside", train._train_episode)
train.evaluate_regimes = note("evaluating", train.evaluate_regimes)
before = threads()
long, short = (
    run(Config(agent=agent, **{small!r} | dict(episodes=episodes)))
    for agent, episodes in (("dqn", 6), ("gbdqn", 3))
)
for _ in range(3):
    for each in (long, short):
        next(each)
        seen["between"].append(threads())
list(short), list(long)
print(json.dumps(seen | {{"before": before, "after": threads()}}))
"""


@pytest.mark.parametrize("first", ["numpy", "gbdqn_ref"])
def test_two_interleaved_runs_train_with_one_thread_and_restore_the_rest(first):
    """Catches a limit held across a yield: the first run to end would lift it for the other."""
    code = INTERLEAVED.format(first=first, small=SMALL)
    variables = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    printed = subprocess.check_output([sys.executable, "-c", code], env=environ(**variables))
    seen = json.loads(printed)
    assert seen["before"] == seen["after"] == [2], "this machine's BLAS has no second thread"
    assert seen["inside"] == [[1]] * 9 and seen["evaluating"] == [[1]] * 2
    assert seen["between"] == [[2]] * 6

"""One BLAS thread while an episode is trained, and as many as before at every other time."""

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
def test_two_runs_in_turn_have_one_thread_each_and_leave_the_rest_alone(first):
    """Held across a yield, the limit of the run that ends first would be lifted for the other."""
    code = INTERLEAVED.format(first=first, small=SMALL)
    variables = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    result = subprocess.run(
        [sys.executable, "-c", code],
        env=environ(**variables),
        capture_output=True,
        text=True,
        check=True,
    )
    seen = json.loads(result.stdout)
    assert seen["before"] == seen["after"] == [2], "this machine's BLAS has no second thread"
    assert seen["inside"] == [[1]] * 9 and seen["evaluating"] == [[1]] * 2
    assert seen["between"] == [[2]] * 6

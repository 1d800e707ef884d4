"""What results/*.json leaves out and the notebook on the experiments shows.

python paper_checks/curves.py returns cartpole FOLDER   the return of each episode of a study
python paper_checks/curves.py plane                     two agents on MountainCar (some minutes)
"""

import json
import sys
from pathlib import Path

import numpy as np

from gbdqn_ref.config import Config
from gbdqn_ref.train import make_agent, run

RESULTS = Path(__file__).with_name("results")
PLANE = RESULTS / "mountaincar-plane.npz"
DRIFT = 300  # the episode in which gravity grows by half
CELLS = 61  # of each axis of the plane of positions and velocities
LOW, HIGH = np.array([-1.2, -0.07]), np.array([0.6, 0.07])  # its corners


def returns(name):
    """{agent: (seeds, episodes)} of a stored study."""
    stored = json.loads((RESULTS / f"{name}-returns.json").read_text(encoding="utf-8"))
    return {agent: np.array(rows) for agent, rows in stored.items()}


def store_returns(name, folder):
    """Keep the returns of a study's runs."""
    study = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    found = {
        agent: [_returns(folder / f"{agent}-{seed}" / "episodes.csv") for seed in study["seeds"]]
        for agent in study["agents"]
    }
    text = json.dumps(found, separators=(",", ":"))
    (RESULTS / f"{name}-returns.json").write_text(f"{text}\n", encoding="utf-8")


def plane_config(agent):
    """One run of the agent on MountainCar: gravity grows by half after two thirds of it."""
    schedule = [{"episode": DRIFT, "gravity": 1.5}]
    changes = dict(agent=agent, episodes=3 * DRIFT // 2, schedule=schedule, seed=0)
    return Config.preset("mountaincar", "fast", **changes)


def cell(states):
    """The cells (…, 2) of states (…, 2): column, row."""
    part = (np.asarray(states) - LOW) / (HIGH - LOW)
    return np.rint(part.clip(0, 1) * (CELLS - 1)).astype(int)


def store_plane(agents=("gbdqn", "dqn")):
    """Each agent's parameters at the drift and at the end, and where it has been until then."""
    kept = {}
    for name in agents:
        agent = make_agent(plane_config(name))
        visits, observe = np.zeros((CELLS, CELLS), int), agent.observe

        def count(s, *others, visits=visits, observe=observe):
            column, row = cell(s)
            visits[row, column] += 1
            observe(s, *others)

        agent.observe = count
        for record in run(plane_config(name), agent):
            if record["episode"] + 1 in (DRIFT, 3 * DRIFT // 2):
                when = "before" if record["episode"] < DRIFT else "after"
                kept[f"{name}_{when}"] = agent.theta.copy()
                kept[f"{name}_visited_{when}"] = visits > 0
    np.savez_compressed(PLANE, **kept)


def _returns(path):
    """The return of each episode, as a whole number where it is one."""
    lines = path.read_text(encoding="utf-8").splitlines()
    place = lines[0].split(",").index("return")
    values = (float(line.split(",")[place]) for line in lines[1:])
    return [int(value) if value.is_integer() else value for value in values]


if __name__ == "__main__":
    what, *others = sys.argv[1:]
    if what == "plane":
        store_plane()
    else:
        store_returns(others[0], Path(others[1]))

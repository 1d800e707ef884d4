"""What results/*.json leaves out and the notebook on the experiments shows.

python paper_checks/curves.py returns cartpole FOLDER   the return of each episode of a study
python paper_checks/curves.py plane                     two agents on MountainCar (some minutes)
"""

import json
from pathlib import Path

import numpy as np
from reruns import STUDIES, stored

from gbdqn_ref import UsageError
from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.config import Config
from gbdqn_ref.files import read_json, write_atomically
from gbdqn_ref.runs import read_config, read_run
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
    path = folder / "results.json"
    study = read_json(path)
    if study != stored(name):
        raise UsageError(f"{path} is not that of the stored study {name}; reruns.py stores it")
    found = {
        agent: [_returns(folder / f"{agent}-{seed}") for seed in study["seeds"]]
        for agent in study["agents"]
    }
    text = json.dumps(found, separators=(",", ":")) + "\n"
    write_atomically(RESULTS / f"{name}-returns.json", lambda file: file.write(text.encode()))


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
    write_atomically(PLANE, lambda file: np.savez_compressed(file, **kept))


def _returns(folder):
    """The return of each episode of a run, as a whole number where it is one."""
    _, records = read_run(read_config(folder), folder)
    values = [record["return"] for record in records]
    return [int(value) if value.is_integer() else value for value in values]


def main(arguments=None):
    """Store the returns of a study, or the plane."""
    parser = Parser(description="Store what the notebook on experiments shows.")
    commands = parser.add_subparsers(dest="what", required=True, metavar="WHAT")
    of_study = commands.add_parser("returns", help="the return of each episode of a study")
    of_study.add_argument("name", choices=STUDIES, metavar="NAME", help="a stored study")
    of_study.add_argument("folder", type=Path, metavar="FOLDER", help="where its runs are")
    commands.add_parser("plane", help="two agents on MountainCar (some minutes)")
    args = parser.parse_args(arguments)
    store_plane() if args.what == "plane" else store_returns(args.name, args.folder)


if __name__ == "__main__":
    program(main)

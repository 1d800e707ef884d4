"""A run resumes to the same bytes from every state in which a crash can leave its folder.

A recorder watches what a run writes. After each step it lists what a disk may hold if the power
fails there: synced data is safe, of later data any part may be lost, and each later rename may be
undone.
"""

import builtins
import os
from itertools import product
from pathlib import Path

import pytest
from helpers import SMALL, Crash, checkpoints_every, contents, crashing_after, drifts_at
from matplotlib.figure import Figure

from gbdqn_ref import files, runs
from gbdqn_ref.config import Config

CONFIG = Config(
    **SMALL | dict(episodes=6, schedule=drifts_at(1, 3, 5)), target="frozen", alpha="closed-form"
)


class Node:
    """The content of a file and the lengths to which a crash may cut it."""

    def __init__(self, content=b""):
        self.content, self.lengths = content, {len(content)}

    def write(self, content):
        before, self.content = len(self.content), content
        self.lengths |= {before + (len(content) - before) * k // 3 for k in (1, 2, 3)}

    def sync(self):
        self.lengths = {len(self.content)}

    def after_a_crash(self):
        return {self.content[:length] for length in self.lengths}


class Recorder:
    """Stands between the package and one folder and knows what a crash would leave in it."""

    def __init__(self, folder, patch):
        self.names = {path.name: {Node(path.read_bytes())} for path in folder.glob("*")}
        self.now = {name: next(iter(nodes)) for name, nodes in self.names.items()}
        self.open_files, self.states = {}, set()
        self.fsync, self.replace = os.fsync, os.replace
        patch.setattr(files, "open", self.opened, raising=False)
        patch.setattr(os, "fsync", self.synced)
        patch.setattr(os, "replace", self.replaced)
        self.note()

    def bind(self, name, node):
        """From now on the name may mean this node, or an older one until the folder is synced."""
        self.names.setdefault(name, {None}).add(node)
        self.now[name] = node
        self.note()

    def opened(self, path, mode):
        file, name = builtins.open(path, mode), Path(path).name  # noqa: SIM115
        if name not in self.now or mode == "wb":
            self.bind(name, Node())
        return Written(file, Path(path), self)

    def synced(self, descriptor):
        if descriptor in self.open_files:
            self.open_files[descriptor].sync()
        else:
            self.names = {name: {node} for name, node in self.now.items()}
        self.note()

    def replaced(self, source, target):
        self.replace(source, target)
        self.bind(Path(target).name, self.now.pop(Path(source).name))
        self.names[Path(source).name].add(None)

    def note(self):
        """Add every {name: content} that a crash may leave now."""
        for nodes in product(*self.names.values()):
            held = {name: node for name, node in zip(self.names, nodes, strict=True) if node}
            choices = {
                name: {b"half"} if name.endswith(".part") else node.after_a_crash()
                for name, node in held.items()
            }
            self.states |= {
                frozenset(zip(choices, content, strict=True))
                for content in product(*choices.values())
            }


class Written:
    """A file open for writing; flushed data may be on disk from then on."""

    def __init__(self, file, path, recorder):
        self.file, self.path, self.recorder = file, path, recorder
        self.node = recorder.open_files[file.fileno()] = recorder.now[path.name]

    def __getattr__(self, name):
        return getattr(self.file, name)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.flush()
        del self.recorder.open_files[self.file.fileno()]
        self.file.close()

    def flush(self):
        self.file.flush()
        content = self.path.read_bytes()
        if content != self.node.content:
            self.node.write(content)
            self.recorder.note()


def go_on(folder):
    """Start or resume a run, as a study does."""
    runs.train(CONFIG, folder, resume=(folder / "config.json").exists(), quiet=True)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A plot of three bytes, and a checkpoint after every other episode."""
    monkeypatch.setattr(Figure, "savefig", lambda self, file, **_: file.write(b"PNG"))
    checkpoints_every(2, monkeypatch)


@pytest.fixture
def undisturbed(tmp_path):
    go_on(tmp_path / "undisturbed")
    return contents(tmp_path / "undisturbed")


def assert_every_crash_is_made_good(tmp_path, undisturbed, monkeypatch, at_least):
    """Record the run in tmp_path / "run", and resume it from every state a crash may leave."""
    with monkeypatch.context() as patch:
        recorder = Recorder(tmp_path / "run", patch)
        go_on(tmp_path / "run")
    assert contents(tmp_path / "run") == undisturbed
    assert len(recorder.states) > at_least, "too few to be meaningful"
    monkeypatch.setattr(os, "fsync", lambda _: None)
    for k, state in enumerate(recorder.states):
        folder = tmp_path / str(k)
        folder.mkdir()
        for name, content in state:
            (folder / name).write_bytes(content)
        go_on(folder)
        left = contents(folder)
        assert {name: left[name] for name in undisturbed} == undisturbed, dict(state).keys()
        assert all(name.endswith(".part") for name in left.keys() - undisturbed.keys())


def test_every_crash_of_a_run_is_made_good(tmp_path, undisturbed, monkeypatch):
    (tmp_path / "run").mkdir()
    assert_every_crash_is_made_good(tmp_path, undisturbed, monkeypatch, at_least=30)


def test_every_crash_of_a_run_that_goes_on_after_a_crash_is_made_good(
    tmp_path, undisturbed, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setattr(runs, "run", crashing_after(3))
        with pytest.raises(Crash):
            go_on(tmp_path / "run")
    assert (tmp_path / "run" / "episodes.csv").read_bytes().count(b"\n") == 5
    assert_every_crash_is_made_good(tmp_path, undisturbed, monkeypatch, at_least=15)

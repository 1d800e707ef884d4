"""Which changes of versions, code and arithmetic count as another run, and which do not."""

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import SMALL

from gbdqn_ref import provenance
from gbdqn_ref.agents import AGENTS
from gbdqn_ref.config import Config
from gbdqn_ref.gbdqn import GBDQN

WORLD = {"agent", "schedule", "train", "drift", "physics"}
DQN = WORLD | {"dqn", "nn", "optim", "bellman", "replay", "detect"}
every_module = pytest.mark.parametrize("name", sorted(provenance.SOURCES))


def code(agent="dqn", **settings):
    return provenance.code(Config(agent=agent, **settings))


def changed(before, now):
    """The names of the changes."""
    return [line.split()[0] for line in provenance.changes(before, now)]


@pytest.mark.parametrize(
    ("agent", "modules"),
    [
        ("dqn", DQN),
        ("dqn-recency", DQN),
        ("gbdqn", DQN | {"gbdqn", "boosting"}),
        ("gbdqn-per", DQN | {"gbdqn", "boosting"}),
        ("ensemble", DQN | {"baselines"}),
        ("random", DQN | {"baselines"}),
    ],
)
def test_the_code_of_a_run_covers_its_agent_and_the_loop(agent, modules):
    assert set(code(agent)) == modules


def test_what_an_editor_leaves_beside_a_module_is_no_source(tmp_path):
    """Emacs marks an unsaved buffer by a link that leads nowhere."""
    package = Path(shutil.copytree(Path(provenance.__file__).parent, tmp_path / "gbdqn_ref"))
    (package / ".#runs.py").symlink_to("user@host.1234:1")
    program = "from gbdqn_ref import provenance; print(*provenance.SOURCES)"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True)
    assert set(done.stdout.decode().split()) == provenance.SOURCES.keys(), done.stderr


@every_module
def test_formatting_comments_and_docstrings_change_nothing(name):
    source = provenance.SOURCES[name]
    plain = ast.unparse(ast.parse(source)).encode()  # without comments and reformatted
    windows = source.replace(b"\n", b"\r\n")
    documented = b'"""Another docstring."""\n' + plain + b"  # and a comment\n"
    assert plain != source
    for same in (plain, windows, documented, b"\xef\xbb\xbf" + source):
        assert provenance.fingerprint(same) == provenance.fingerprint(source)


@pytest.mark.parametrize(
    "other",
    [
        b"def f(x): return x - 1",
        b"def f(x): return x + 2",
        b"def f(x, y=0): return x + 1",
        b"def f(x): return x + 1\nf = abs",
        b"def f(x):\n    print(x)\n    return x + 1",
        b"def f(x): return 'x + 1'",
    ],
)
def test_changed_behaviour_changes_the_fingerprint(other):
    assert provenance.fingerprint(other) != provenance.fingerprint(b"def f(x): return x + 1")


def test_a_returned_string_is_not_taken_for_a_docstring():
    first, second = (f"def f():\n    return {word!r}".encode() for word in ("uniform", "recency"))
    assert provenance.fingerprint(first) != provenance.fingerprint(second)


def test_a_changed_source_is_other_code(monkeypatch):
    before = code()
    monkeypatch.setitem(provenance.SOURCES, "optim", provenance.SOURCES["optim"] + b"x = 1\n")
    assert {name for name in before if code()[name] != before[name]} == {"optim"}


def test_the_looks_of_an_agent_do_not_decide_its_runs_and_its_class_does(monkeypatch):
    before = code()
    look = AGENTS["dqn"]._replace(label="Deep Q", colour="red", mark="x", line=":")
    monkeypatch.setitem(AGENTS, "dqn", look)
    assert code() == before
    monkeypatch.setitem(AGENTS, "dqn", look._replace(make=GBDQN))
    assert code()["agent"] == "GBDQN" != before["agent"]


def test_a_schedule_is_compared_after_it_is_resolved():
    schedule = [{"episode": 3, "gravity": 2.0}]
    written_out = [{"episode": 3, "gravity": 2, "length": 1.0}, {"episode": 99, "reset": True}]
    settings = SMALL | {"schedule": schedule}
    assert code(**settings) == code(**settings | {"schedule": written_out})
    later = settings | {"schedule": [{"episode": 4, "gravity": 2.0}]}
    assert code(**settings)["schedule"] != code(**later)["schedule"]


def test_the_kernels_fingerprint_notices_the_last_bit(monkeypatch):
    before = provenance.kernels()
    assert provenance.kernels() == before
    exp = np.exp
    monkeypatch.setattr(np, "exp", lambda x: np.nextafter(exp(x), np.float32(9)))
    assert provenance.kernels() != before


def test_changes_are_listed_with_old_and_new_values():
    now = provenance.of(Config())
    assert provenance.changes(now, now) == []
    before = {kind: dict(values) for kind, values in now.items()}
    before["versions"]["numpy"] = "1.0"
    before["code"]["optim"] = "0123"
    del before["versions"]["kernels"]
    assert changed(before, now) == ["numpy", "optim", "kernels"]
    numpy, optim, kernels = provenance.changes(before, now)
    assert numpy == f"numpy 1.0 → {np.__version__}"
    assert optim == f"optim 0123 → {now['code']['optim']}"
    assert kernels == f"kernels none → {now['versions']['kernels']}"
    assert provenance.changes(before | {"code": {}}, now) == ["its code is not on record"]

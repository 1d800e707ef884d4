"""What determines a run besides its settings: the libraries, the machine's arithmetic, our code.

    versions = {"numpy": "2.4.6", "kernels": "e84b5f9692afa13e", …}
    code     = {"agent": "GBDQN", "nn": "3fb6e1a25c0d9b74", …}

`code` covers what train and the agent's module import, down to nn. A fingerprint hashes a module's
syntax tree, so formatting, comments and docstrings do not count. Modules that only resolve settings
are left out. Their results are compared instead: for the schedule, the regimes.
"""

import ast
import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

import gymnasium
import numpy as np

from . import __version__
from .agents import AGENTS
from .config import Config
from .train import THREADS

RESOLVED = {"agents", "config", "presets", "schedule"}
# read on import, because a module that is edited later still runs as it was
SOURCES = {
    path.stem: path.read_bytes()
    for path in Path(__file__).parent.glob("*.py")
    if path.stem.isidentifier()  # not .#runs, which an editor leaves
}

Provenance = dict[str, dict[str, str]]


def of(config: Config) -> Provenance:
    """{"versions": …, "code": …} of a run with this config, here and now."""
    return {"versions": versions(), "code": code(config)}


def changes(before: Provenance, now: Provenance) -> list[str]:
    """The differences, like "numpy 2.4.5 → 2.4.6"."""
    if not before["code"]:
        return ["its code is not on record"]
    old, new = ({**each["versions"], **each["code"]} for each in (before, now))
    return [
        f"{name} {old.get(name, 'none')} → {new.get(name, 'none')}"
        for name in old | new
        if old.get(name) != new.get(name)
    ]


def versions() -> dict[str, str]:
    """The versions that determine a run; MuJoCo's is found without importing it, which is slow."""
    return {
        "gbdqn_ref": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "gymnasium": gymnasium.__version__,
        "mujoco": version("mujoco"),
        "kernels": kernels(),
    }


def kernels() -> str:
    """A hash of results of NumPy's kernels, whose last bits depend on the processor."""
    x = np.random.default_rng(0).normal(size=(64, 129)).astype(np.float32)
    with THREADS.limit(limits=1):
        products = [x.T @ x, x[:, :7] @ x[:7, :3], x[:1] @ x.T]
    curves = [np.exp(x), np.log1p(np.abs(x)), np.sqrt(np.abs(x))]
    return _hash(b"".join(result.tobytes() for result in products + curves))


def code(config: Config) -> dict[str, str]:
    """The agent's class, and fingerprints of the regimes and of each module that the run uses."""
    make = AGENTS[config.agent].make
    found, new = set(), {"train", make.__module__.rpartition(".")[2]} & SOURCES.keys()
    while new:
        found |= new
        new = {name for each in new for name in _imports(each)} - found - RESOLVED
    modules = {name: fingerprint(SOURCES[name]) for name in sorted(found)}
    schedule = _hash(repr([tuple(regime) for regime in config.regimes]).encode())
    return {"agent": make.__qualname__, "schedule": schedule} | modules


def fingerprint(source: bytes) -> str:
    """A hash of the source that ignores formatting, comments and docstrings.

    >>> fingerprint(b"def f(x): return x  # as it is") == fingerprint(b"def f( x ):\\r\\n return x")
    True
    """
    return _hash(ast.unparse(_tree(source)).encode())


@cache
def _tree(source: bytes) -> ast.Module:
    """The syntax tree without docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            node.body = [part for part in node.body if not _is_text(part)]
    return tree


def _is_text(statement: ast.stmt) -> bool:
    value = statement.value if isinstance(statement, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def _imports(name: str) -> set[str]:
    """The modules of ours that this one imports."""
    found = set()
    for node in ast.walk(_tree(SOURCES[name])):
        if isinstance(node, ast.ImportFrom) and node.level:
            found |= {node.module} if node.module else {alias.name for alias in node.names}
    return found & SOURCES.keys()


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]

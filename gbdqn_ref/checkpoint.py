"""A whole agent on disk, without pickle: networks, Adam, replay, caches, generator, counters.

A checkpoint is an uncompressed .npz with one array per attribute, named by its path from the agent
("adam.m", "replay.tree.levels.0", …). It walks the agent's attributes, so a new attribute is saved
without further code.
"""

import io
import json
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import numpy as np

from . import UsageError
from .config import Config
from .files import DAMAGED, check_shape, write_atomically

Arrays = dict[str, np.ndarray]

FORMAT = 1
HEADER = {"format": (int,), "episodes": (int,), "config": (dict,)}
REBUILT = {"config", "net", "memo"}  # a new agent has these, or computes them when needed
GROWS = ("ensemble.", "alarms", "shelf", "returns", "recent", "turns")  # in their first axis


def save(path: Path | str, agent: Any, episodes: int) -> None:
    """Write the agent after so many episodes; the same agent gives the same bytes."""
    header = {
        "format": FORMAT,
        "episodes": episodes,
        "agent": type(agent).__name__,
        "config": agent.config.to_dict(),
    }
    arrays = {"header": np.array(json.dumps(header))} | state(agent)
    content = io.BytesIO()  # NumPy's zip file complains twice where a disk is full
    np.savez(content, **arrays)  # type: ignore[arg-type]
    write_atomically(path, lambda file: file.write(content.getbuffer()))


def load(path: Path | str, agent: Any) -> int:
    """Restore what save() wrote into a new agent of the same config; returns its episodes so far.

    UsageError if the file is damaged or of another agent; then nothing is changed.
    """
    content = Path(path).read_bytes()
    try:
        arrays, header, config = _read(content)
    except DAMAGED as e:
        raise UsageError(
            f"{path} is damaged or not a checkpoint ({e}); without it --resume starts an unfinished"
            " run again"
        ) from e
    kind = type(agent).__name__
    if config.resolved() != agent.config.resolved() or header.get("agent", kind) != kind:
        raise UsageError(
            f"{path} belongs to a run with other settings than those in config.json beside it"
        )
    if _outline(arrays) != _outline(state(agent)):
        raise UsageError(
            f"{path} does not fit this version of gbdqn_ref; start a new run in another folder"
        )
    _restore(agent, "", arrays)
    return header["episodes"]


def _read(content: bytes) -> tuple[Arrays, dict[str, Any], Config]:
    """(arrays, header, config) of a checkpoint; raises one of DAMAGED if it is not one."""
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = dict(file)
    header = json.loads(arrays.pop("header").item())
    check_shape(header, HEADER, "its header")
    if header["format"] != FORMAT:
        raise ValueError(f"format {header['format']} instead of {FORMAT}")
    config = Config.from_dict(header["config"])
    if not 0 <= header["episodes"] <= config.episodes:
        raise ValueError(f"{header['episodes']} episodes of {config.episodes}")
    for array in arrays.values():
        if array.dtype.kind == "U":
            _set_state(np.random.default_rng(), array)
    return arrays, header, config


def state(thing: Any, name: str = "") -> Arrays:
    """{path: array} of every array, number and generator in it, at any depth."""
    if isinstance(thing, np.ndarray):
        return {name: thing}
    if isinstance(thing, (bool, int, float)):
        return {name: np.array(thing)}
    if isinstance(thing, np.random.Generator):
        return {name: np.array(json.dumps(thing.bit_generator.state))}
    return {
        path: array
        for key, part in _parts(thing)
        for path, array in state(part, _join(name, key)).items()
    }


def _restore(thing: Any, name: str, arrays: Arrays) -> Any:
    """The inverse of state(); numbers and arrays are new, generators and objects are changed."""
    if isinstance(thing, np.ndarray):
        return arrays[name]
    if isinstance(thing, (bool, int, float)):
        return arrays[name].item()
    if isinstance(thing, np.random.Generator):
        return _set_state(thing, arrays[name])
    for key, part in _parts(thing):
        value = _restore(part, _join(name, key), arrays)
        if isinstance(thing, list):
            thing[key] = value
        elif not isinstance(thing, tuple):
            setattr(thing, key, value)
    return thing


def _set_state(rng: np.random.Generator, array: np.ndarray) -> np.random.Generator:
    """Set the generator to the state in this array, which is JSON, and return it."""
    rng.bit_generator.state = json.loads(array.item())
    return rng


def _parts(thing: Any) -> list[tuple[Any, Any]]:
    """(key, part) of a list, a tuple or one of our objects; strings and None are not saved."""
    if isinstance(thing, (str, type(None))):
        return []
    if isinstance(thing, (list, tuple)):
        return list(enumerate(thing))
    return [(key, part) for key, part in vars(thing).items() if key not in REBUILT]


def _join(name: str, key: Hashable) -> str:
    return f"{name}.{key}" if name else str(key)


def _outline(arrays: Arrays) -> dict[str, tuple]:
    """{name: (type, shape)}, which a file and an agent must share; axes that grow are left out."""
    outline = {}
    for name, array in sorted(arrays.items()):
        shape = array.shape[1:] if name.startswith(GROWS) else array.shape
        outline[name] = "text" if array.dtype.kind == "U" else array.dtype.str, shape
    return outline

"""An agent on disk, whole: networks, Adam, replay, cached predictions, generator, counters. No
pickle.

A checkpoint is an uncompressed .npz with one array per attribute, named by its path from the agent
("adam.m", "replay.tree.levels.0", …). Walking the attributes means that nothing can be forgotten
when an agent grows.
"""

import io
import json
import zipfile
import zlib
from pathlib import Path

import numpy as np

from . import UsageError
from .config import Config
from .files import write_atomically

FORMAT = 1
REBUILT = {"config", "net", "memo"}  # a new agent has these already, or makes them when needed

GROWS = ("ensemble.", "alarms", "shelf", "returns", "recent")  # arrays whose first axis does

DAMAGED = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    EOFError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)


def save(path, agent, episodes):
    """Write the agent as it is after so many episodes; the same agent gives the same bytes."""
    header = {"format": FORMAT, "episodes": episodes, "config": agent.config.to_dict()}
    arrays = {"header": np.array(json.dumps(header))} | state(agent)
    write_atomically(path, lambda file: np.savez(file, **arrays))


def load(path, agent):
    """Restore into a new agent of the same config what save() wrote; returns the number of episodes
    it has seen.
    """
    file = io.BytesIO(Path(path).read_bytes())
    try:
        with np.load(file, allow_pickle=False) as content:
            arrays = dict(content)
        header = json.loads(arrays.pop("header").item())
        config, episodes = Config.from_dict(header["config"]), header["episodes"]
        if header["format"] != FORMAT:
            raise ValueError(f"format {header['format']} instead of {FORMAT}")
    except DAMAGED as e:
        raise UsageError(
            f"{path} is damaged or foreign ({e}); without it --resume starts anew"
        ) from e
    if config != agent.config:
        raise UsageError(
            f"{path} belongs to a run with other settings than the config.json beside it"
        )
    expected = state(agent)
    if _outline(arrays) != _outline(expected):
        raise UsageError(
            f"{path} does not fit this version of gbdqn_ref; start a new run in another folder"
        )
    _restore(agent, "", arrays)
    return episodes


def state(thing, name=""):
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


def _restore(thing, name, arrays):
    """The counterpart of state(): numbers and arrays are returned new, generators and objects
    changed in place.
    """
    if isinstance(thing, np.ndarray):
        return arrays[name]
    if isinstance(thing, (bool, int, float)):
        return arrays[name].item()
    if isinstance(thing, np.random.Generator):
        thing.bit_generator.state = json.loads(arrays[name].item())
        return thing
    for key, part in _parts(thing):
        value = _restore(part, _join(name, key), arrays)
        if isinstance(thing, list):
            thing[key] = value
        elif not isinstance(thing, tuple):
            setattr(thing, key, value)
    return thing


def _parts(thing):
    """(key, part) of what is inside a list, a tuple or one of our objects; text and None hold
    nothing to save.
    """
    if isinstance(thing, (str, type(None))):
        return []
    if isinstance(thing, (list, tuple)):
        return list(enumerate(thing))
    return [(key, part) for key, part in vars(thing).items() if key not in REBUILT]


def _join(name, key):
    return f"{name}.{key}" if name else str(key)


def _outline(arrays):
    """What must agree between a file and an agent: names, kinds and shapes, but for the number of
    frozen boosters.
    """
    outline = {}
    for name, array in sorted(arrays.items()):
        shape = array.shape[1:] if name.startswith(GROWS) else array.shape
        outline[name] = array.dtype.kind, shape
    return outline

"""Files: written atomically, in folders locked against other processes, and checked when read."""

import json
import os
import sys
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from math import isfinite
from pathlib import Path
from reprlib import repr as short
from typing import IO, Any

from . import UsageError

try:
    import fcntl
except ImportError:  # Windows has no flock, so folders are not locked there
    fcntl = None  # type: ignore[assignment]

Shape = Any  # {key: shape}, [shape of each element], or a tuple of types
NUMBER = (int, float)
ANY = (dict, list, str, int, float, bool, type(None))
DAMAGED = (  # what reading a damaged file raises
    ValueError,
    ArithmeticError,
    LookupError,
    TypeError,
    AttributeError,
    EOFError,
    RuntimeError,
    SyntaxError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def write_atomically(path: Path | str, write: Callable[[IO[bytes]], Any]) -> None:
    """Let write(file) fill a temporary file, which replaces path once it is complete and on disk.

    An OSError, for example a full disk, names path and leaves the old file in place.
    """
    path, temporary = Path(path), Path(f"{path}.part")
    with naming(path):
        try:
            with open(temporary, "wb") as file:
                write(file)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
            sync_folder(path.parent)  # otherwise a crash may undo the renaming
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Make a system error name this file; a full disk does not say which file did not fit."""
    try:
        yield
    except OSError as e:
        if not e.errno:
            raise
        raise OSError(e.errno, e.strerror, str(path)) from e


def append(path: Path, content: bytes) -> None:
    """Append to a file; until sync() a crash may lose all or part of it."""
    with naming(path), open(path, "ab") as file:
        file.write(content)


def sync(path: Path) -> None:
    """Wait until everything appended to a file is on disk."""
    with naming(path), open(path, "ab") as file:
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on disk."""
    if not fcntl:
        return
    descriptor = os.open(folder, os.O_RDONLY)
    with suppress(OSError):  # not every file system can
        os.fsync(descriptor)
    os.close(descriptor)


def check_picture(path: Path | str, ending: str) -> None:
    """UsageError if the path cannot be a picture with this ending."""
    path = Path(path)
    if path.is_dir():
        raise UsageError(f"{path} is a folder; --out needs a file, like {path / 'picture'}{ending}")
    if path.suffix.lower() != ending:
        raise UsageError(f"the picture is a {ending} file, so --out cannot be {path}")


def write_json(path: Path | str, content: Any) -> None:
    """Write JSON atomically; the same content gives the same bytes."""
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def read_json(path: Path | str, *keys: str, **shapes: Shape) -> dict[str, Any]:
    """The object in a JSON file; it must have these keys, and values of these shapes."""
    with undamaged(path):
        content = parse_json(Path(path).read_bytes())
        check_shape(content, dict.fromkeys(keys, ANY) | shapes, "it")
    return content


def parse_json(text: str | bytes) -> Any:
    """The value in a JSON text; ValueError if an object has a key twice.

    >>> parse_json('{"seed": 0, "seed": 1}')
    Traceback (most recent call last):
    ValueError: a key occurs twice in {'seed', 'seed'}
    """
    return json.loads(text, object_pairs_hook=_object)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        raise ValueError(f"a key occurs twice in {{{', '.join(repr(key) for key, _ in pairs)}}}")
    return content


@contextmanager
def undamaged(path: Path | str) -> Iterator[None]:
    """Turn an error about the content of a file into a UsageError that names the file."""
    try:
        yield
    except DAMAGED as e:
        raise UsageError(
            f"{path} is damaged ({e}); restore it or start a new run in another folder"
        ) from e


def check_shape(value: Any, shape: Shape, name: str) -> None:
    """ValueError if a JSON value has another shape; it names the part that differs.

    >>> check_shape({"seeds": [1, "2"]}, {"seeds": [NUMBER]}, "it")
    Traceback (most recent call last):
    ValueError: it['seeds'][1] is '2', not int or float
    """
    kinds = (type(shape),) if isinstance(shape, (dict, list)) else shape
    if type(value) not in kinds:
        words = " or ".join(kind.__name__ for kind in kinds)
        raise ValueError(f"{name} is {short(value)}, not {words}")
    if float in kinds and isinstance(value, (int, float)) and not isfinite(value):
        raise ValueError(f"{name} is {value}, not a finite number")
    if isinstance(shape, dict):
        for key in shape:
            if key not in value:
                raise ValueError(f"{name} has no {key!r}")
            check_shape(value[key], shape[key], f"{name}[{key!r}]")
    if isinstance(shape, list):
        for i, each in enumerate(value):
            check_shape(each, shape[0], f"{name}[{i}]")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes; a missing folder is made.

    A killed process leaves no lock behind. A new folder that is still empty at the end is removed.
    """
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder} is not a folder; choose another")
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    for each in made:
        sync_folder(each.parent)
    descriptor = _lock(folder) if fcntl else None
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)
        for each in made:
            with suppress(OSError):  # it is not empty
                each.rmdir()


def _lock(folder: Path) -> int:
    """The descriptor that holds the lock; on a file system without locks, warn and continue."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as e:
        os.close(descriptor)
        raise UsageError(
            f"{folder} is in use by another process; wait for it or choose another"
        ) from e
    except OSError as e:
        print(
            f"gbdqn_ref: {folder} is on a file system without locks ({e.strerror}); make sure that"
            " no other process writes there",
            file=sys.stderr,
        )
    return descriptor

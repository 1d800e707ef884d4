"""Whole files: written atomically, in folders that other processes keep out of, and read back."""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from . import UsageError

try:
    import fcntl
except ImportError:  # Windows has no flock; there nothing keeps two processes from one folder
    fcntl = None  # type: ignore[assignment]


def write_atomically(path: Path | str, write: Callable[[IO[bytes]], Any]) -> None:
    """Call write(file) on a temporary file that takes path's place once it is complete."""
    temporary = Path(f"{path}.part")
    with open(temporary, "wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def check_picture(path: Path | str, ending: str) -> None:
    """UsageError if a picture of this kind cannot be written there."""
    path = Path(path)
    if path.is_dir():
        raise UsageError(
            f"{path} is a folder; --out is the file that takes the picture, like"
            f" {path / 'picture'}{ending}"
        )
    if path.suffix.lower() != ending:
        raise UsageError(f"the picture is written as {ending}, so --out cannot be {path}")


def write_json(path: Path | str, content: Any) -> None:
    """Write plain JSON, atomically, the same bytes for the same content."""
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def read_json(path: Path | str, *keys: str) -> dict[str, Any]:
    """The object in a JSON file, which must have these keys."""
    try:
        content = json.loads(Path(path).read_bytes())
        missing = [key for key in keys if key not in dict(content)]
        if missing:
            raise ValueError(f"no {missing}")
    except (ValueError, TypeError) as e:
        raise UsageError(
            f"{path} is damaged ({e}); restore it or start a new run in another folder"
        ) from e
    return content


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes from this folder; a killed process leaves no lock behind."""
    if not fcntl:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as e:
            raise UsageError(
                f"{folder} is in use by another process; wait for it or choose another --out"
            ) from e
        yield
    finally:
        os.close(descriptor)

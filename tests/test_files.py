"""Files are written whole, synced, and named in errors; a folder is locked by one process."""

import errno
import fcntl
import json
import os
import subprocess
import sys
from math import inf, nan

import pytest
from helpers import PATIENCE, Crash, contents, environ

from gbdqn_ref import UsageError, files


def steps(monkeypatch):
    """The calls of fsync, replace and mkdir from now on, which decide what reaches the disk."""
    order = []

    def spy(name, original):
        def call(*arguments):
            folder = name == "fsync" and os.path.isdir(f"/proc/self/fd/{arguments[0]}")
            order.append("fsync folder" if folder else name)
            return original(*arguments)

        return call

    for name in ("fsync", "replace", "mkdir"):
        monkeypatch.setattr(os, name, spy(name, getattr(os, name)))
    return order


# --- writing --------------------------------------------------------------------------------------


def test_a_file_is_synced_then_renamed_then_its_folder_is_synced(tmp_path, monkeypatch):
    order = steps(monkeypatch)
    files.write_atomically(tmp_path / "file", lambda file: file.write(b"new"))
    assert order == ["fsync", "replace", "fsync folder"]
    assert contents(tmp_path) == {"file": b"new"}


@pytest.mark.parametrize("error", [Crash, OSError(errno.EIO, "broken"), ValueError])
def test_a_failure_while_writing_leaves_the_file_that_was_there(tmp_path, error):
    files.write_atomically(tmp_path / "file", lambda file: file.write(b"old"))

    def half(file):
        file.write(b"new, but only h")
        file.flush()
        assert (tmp_path / "file").read_bytes() == b"old"
        raise error

    with pytest.raises(type(error) if isinstance(error, OSError) else error):
        files.write_atomically(tmp_path / "file", half)
    assert contents(tmp_path) == {"file": b"old"}


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_failing_system_call_leaves_the_old_file(tmp_path, monkeypatch, call):
    files.write_atomically(tmp_path / "file", lambda file: file.write(b"old"))

    def stop(*_):
        raise Crash

    monkeypatch.setattr(os, call, stop)
    with pytest.raises(Crash):
        files.write_atomically(tmp_path / "file", lambda file: file.write(b"new"))
    assert contents(tmp_path) == {"file": b"old"}


def test_append_adds_at_the_end(tmp_path, monkeypatch):
    path = tmp_path / "file"
    order = steps(monkeypatch)
    files.append(path, b"one\n")
    files.append(path, b"two\n")
    assert order == []
    files.sync(path)
    assert order == ["fsync"] and path.read_bytes() == b"one\ntwo\n"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no full disk on this system")
@pytest.mark.parametrize("write", [files.append, files.write_json])
def test_a_full_disk_names_the_file_that_does_not_fit(tmp_path, write):
    for name in ("full", "full.part"):
        (tmp_path / name).symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught:
        write(tmp_path / "full", b"x" if write is files.append else "x")
    assert str(caught.value).endswith(f"{str(tmp_path / 'full')!r}")


def test_a_file_over_the_size_limit_is_named_and_leaves_nothing(tmp_path):
    code = """if 1:
        import resource, sys
        from gbdqn_ref import files
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
        try:
            files.write_json(sys.argv[1], "x" * 2000)
        except OSError as e:
            print(e)
    """
    command = [sys.executable, "-c", code, str(tmp_path / "file")]
    options = dict(env=environ(), capture_output=True, text=True, timeout=PATIENCE)
    result = subprocess.run(command, **options)
    assert result.stdout == f"[Errno 27] File too large: {str(tmp_path / 'file')!r}\n"
    assert contents(tmp_path) == {}


def test_an_oserror_without_errno_keeps_its_message(tmp_path):
    def picture(_):
        raise OSError("cannot write mode RGBA as JPEG")

    with pytest.raises(OSError, match=r"^cannot write mode RGBA as JPEG$"):
        files.write_atomically(tmp_path / "file", picture)


# --- reading --------------------------------------------------------------------------------------

SHAPE = {"seeds": [files.NUMBER], "runs": [{"agent": (str,)}]}
FITTING = {"seeds": [1, 2.5], "runs": [{"agent": "dqn", "more": None}], "more": 1}


def test_json_is_read_back_as_written(tmp_path):
    files.write_json(tmp_path / "file", FITTING)
    assert files.read_json(tmp_path / "file", "more", **SHAPE) == FITTING
    assert (tmp_path / "file").read_bytes().endswith(b"}\n")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (5, "it is 5, not dict"),
        ([], r"it is \[\], not dict"),
        (None, "it is None, not dict"),
        ({"seeds": [1]}, "it has no 'runs'"),
        (FITTING | {"seeds": 1}, r"it\['seeds'\] is 1, not list"),
        (FITTING | {"seeds": [1, True]}, r"it\['seeds'\]\[1\] is True, not int or float"),
        (FITTING | {"seeds": [1, nan]}, r"it\['seeds'\]\[1\] is nan, not a finite number"),
        (FITTING | {"seeds": [-inf]}, r"it\['seeds'\]\[0\] is -inf, not a finite number"),
        (FITTING | {"seeds": [10**400]}, "too large"),
        (FITTING | {"seeds": {}}, r"it\['seeds'\] is {}, not list"),
        (FITTING | {"runs": [{}]}, r"it\['runs'\]\[0\] has no 'agent'"),
        (FITTING | {"runs": [{"agent": None}]}, r"\['agent'\] is None, not str"),
    ],
)
def test_json_of_the_wrong_shape_is_refused_with_the_place_named(tmp_path, content, said):
    (tmp_path / "file").write_text(json.dumps(content))
    with pytest.raises(UsageError, match=f"file is damaged .*{said}"):
        files.read_json(tmp_path / "file", **SHAPE)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b'{"a":1,"a":2}'])
def test_invalid_json_is_refused(tmp_path, content):
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(UsageError, match="file is damaged"):
        files.read_json(tmp_path / "file")


# --- folders --------------------------------------------------------------------------------------


def test_a_new_folder_is_synced_before_anything_is_put_into_it(tmp_path, monkeypatch):
    order = steps(monkeypatch)
    with files.locked(tmp_path / "a" / "b"):
        made = order.copy()
        (tmp_path / "a" / "b" / "file").touch()
    assert made.count("mkdir") >= 2 and made[-2:] == ["fsync folder", "fsync folder"]
    assert contents(tmp_path) == {"a": None, "a/b": None, "a/b/file": b""}


def test_a_new_folder_that_stays_empty_is_removed_and_an_old_one_is_not(tmp_path):
    (tmp_path / "old").mkdir()
    for folder in (tmp_path / "old", tmp_path / "old" / "new" / "below"):
        with pytest.raises(Crash), files.locked(folder):
            raise Crash
    assert contents(tmp_path) == {"old": None}


def test_a_folder_stays_locked_until_the_block_ends(tmp_path):
    with (
        files.locked(tmp_path),
        pytest.raises(UsageError, match="in use by another process"),
        files.locked(tmp_path),
    ):
        pass
    with files.locked(tmp_path):
        pass


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="is not a folder"), files.locked(tmp_path / "file"):
        pass


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EBADF, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_is_told_and_used(tmp_path, monkeypatch, capsys, number):
    """NFS answers EBADF for a folder."""

    def flock(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", flock)
    with files.locked(tmp_path / "run"):
        (tmp_path / "run" / "file").touch()
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "without locks" in said and str(tmp_path / "run") in said
    assert contents(tmp_path) == {"run": None, "run/file": b""}


def test_no_descriptor_is_left_open(tmp_path):
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        with files.locked(tmp_path / "run"):
            files.write_json(tmp_path / "run" / "file", 1)
            with pytest.raises(UsageError), files.locked(tmp_path / "run"):
                pass
    assert len(os.listdir("/proc/self/fd")) == before

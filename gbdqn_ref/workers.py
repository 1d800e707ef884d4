"""Runs in processes of their own: stopped together, and started again if they are killed.

A worker is a new Python that reads from its stdin one line, which says what to train. It is sent
nothing more: its stdin ends when the process that started it is gone, and then it ends too.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Any

from . import runs
from .config import Config

PAUSE, GRACE = 0.1, 0.5  # seconds between two looks at the workers, and for them to stop in
STOPPED = 130  # the exit status of a process that was asked to stop
ASKED_TO_STOP = {STOPPED, -signal.SIGINT, -signal.SIGTERM}
PROGRAM = "from gbdqn_ref import workers; workers.work()"


class Worker(subprocess.Popen):
    """A process that trains one run."""

    def __init__(self, config: Config, folder: Path) -> None:
        self.log = tempfile.TemporaryFile()  # noqa: SIM115
        imports = {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONIOENCODING": "utf-8"}
        super().__init__(
            [sys.executable, "-P", "-c", PROGRAM],
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self.log,
            env=os.environ | imports,
        )
        line = json.dumps([config.to_dict(), str(folder.resolve())]) + "\n"
        with suppress(BrokenPipeError):  # it has been killed already
            self.stdin.write(line.encode())  # type: ignore[union-attr]

    def last_words(self) -> str:
        """The last line of its stderr, when it has ended. Its files are closed."""
        with self, self.log as log:
            log.seek(0)
            lines = log.read().decode(errors="replace").splitlines()
        return lines[-1] if lines else f"its process ended with status {self.returncode}"


def train_all(
    configs: Mapping[Path, Config], jobs: int, show: Callable[[], object]
) -> dict[Path, str]:
    """Train every {folder: config}, `jobs` at a time; {folder: error} of the runs that failed.

    show() is called about ten times a second. A run whose worker is killed starts once more.
    KeyboardInterrupt if this process or a worker is asked to stop; no worker outlives the call.
    """
    waiting, killed, failed = list(configs), set(), {}
    working: dict[Path, Worker] = {}
    try:
        while waiting or working:
            for folder in waiting[: jobs - len(working)]:
                waiting.remove(folder)
                working[folder] = Worker(configs[folder], folder)
            time.sleep(PAUSE)
            show()
            for folder in [each for each, worker in working.items() if worker.poll() is not None]:
                status, error = working[folder].returncode, working.pop(folder).last_words()
                if status in ASKED_TO_STOP:
                    raise KeyboardInterrupt
                if status < 0 and folder not in killed:
                    killed.add(folder)
                    waiting.append(folder)
                elif status:
                    failed[folder] = error
    finally:
        _stop(working.values())
    return failed


def _stop(workers: Collection[Worker]) -> None:
    """Ask workers to stop, and kill those that take too long."""
    latest = time.monotonic() + GRACE
    for worker in workers:
        worker.terminate()
    for worker in workers:
        with suppress(subprocess.TimeoutExpired):
            worker.wait(max(0.0, latest - time.monotonic()))
        worker.kill()
        worker.last_words()


def stop_on_signals() -> None:
    """From now on SIGINT and SIGTERM raise KeyboardInterrupt in this process."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)


def work() -> None:
    """What a worker does: it trains the run that its stdin describes, and ends with its stdin."""
    stop_on_signals()
    values, folder = json.loads(sys.stdin.readline())
    Thread(target=_end_with_stdin, daemon=True).start()
    try:
        train_one(values, folder)
    except KeyboardInterrupt:
        os._exit(STOPPED)  # at once: Python takes its time to end
    except Exception as e:
        sys.exit(in_a_line(e))


def _end_with_stdin() -> None:
    os.read(0, 1)  # sys.stdin.read would hold a lock that Python needs at its end
    os._exit(STOPPED)


def train_one(values: Mapping[str, Any], folder: str) -> None:
    """One run, in whatever process: {name: value} of its Config, and its folder, begun or not."""
    begun = (Path(folder) / "config.json").exists()
    runs.train(Config.from_dict(values), folder, resume=begun, quiet=True)


def in_a_line(error: BaseException) -> str:
    """An error in one line, whatever is in a path."""
    return " ".join(f"{type(error).__name__}: {error}".split())

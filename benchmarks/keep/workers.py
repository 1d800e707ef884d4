"""Processes for the programs beside it."""

import signal
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children


@contextmanager
def workers(jobs):
    """An executor of so many processes. They end at once if the program is stopped."""
    with ProcessPoolExecutor(jobs, initializer=_leave_signals) as pool:
        try:
            yield pool
        except KeyboardInterrupt:
            for process in active_children():
                process.terminate()
            raise


def _leave_signals():
    """Ctrl-C reaches all processes of a program; only the first of them is to answer it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)

"""GB-DQN (arXiv 2512.17034) as an executable paper: NumPy only, hand-written, checked.

Read the modules in this order, which is also the order of their imports: nn, optim, bellman,
boosting, replay, tabular, physics, drift, presets, config, dqn, gbdqn, baselines, stats, train,
checkpoint, plots, runs, study, effect, watch, tables, __main__.
"""

import os

for _library in (
    "OPENBLAS",
    "OMP",
    "MKL",
):  # 64 × 128 matrices are too small to share out: more threads, slower
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

bytes(
    1 << 24
    # freed at once: from then on glibc keeps freed memory for reuse instead of unmapping it
)

__version__ = "0.1.0"


class UsageError(ValueError):
    """The caller gave something that cannot be used; the message says what is wrong and what would
    be right.
    """

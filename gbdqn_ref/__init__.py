"""GB-DQN (arXiv 2512.17034) as an executable paper: NumPy only, hand-written, checked.

Read the modules in this order, which is also the order of their imports: nn, optim, bellman,
boosting, replay, tabular, detect, dqn, gbdqn, reuse, baselines, agents, schedule, physics, drift,
presets, config, stats, train, files, provenance, checkpoint, plots, runs, study, effect, watch,
tables, __main__.
"""

# Once such a block has been freed, glibc reuses freed memory instead of returning it each time.
bytes(1 << 24)

__version__ = "0.1.0"


class UsageError(ValueError):
    """Unusable input; the message says what is wrong and what would be right."""


class DivergenceError(ArithmeticError):
    """A loss or a parameter is not finite; the message says where, and which setting to change."""


class StudyError(RuntimeError):
    """Some runs of a study failed and the others are complete; `errors` is {name: error}."""

    def __init__(self, errors: dict[str, str]) -> None:
        self.errors = errors
        super().__init__("; ".join(f"{name}: {error}" for name, error in errors.items()))

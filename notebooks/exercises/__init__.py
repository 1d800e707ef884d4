"""The exercises: each knows its solution, its likely mistakes by name, and cases that
tell them apart. A module here has those of one notebook, in its list EXERCISES.
"""

import dis
import importlib
import inspect
import pkgutil
from collections.abc import Callable
from copy import deepcopy
from functools import cache
from typing import NamedTuple

import numpy as np
from IPython.display import Markdown, display


def call(attempt, *case):
    """How most exercises are run."""
    return attempt(*case)


def called(name, *case):
    """How most exercises' cases are named."""
    return f"{name}({', '.join(map(plain, case))})"


class Exercise(NamedTuple):
    """One stub, its solution, and `mistakes`: {sentence that names it: function}.

    `cases` are tuples of arguments, from small to large. `run(attempt, *case)` gives
    what is compared. `say(name, *case)` names a case. Only with `in_place` may an
    attempt change its arguments.
    """

    name: str
    hint: str
    solution: Callable
    mistakes: dict[str, Callable]
    cases: list[tuple]
    run: Callable = call
    say: Callable = called
    in_place: bool = False


class Raised(NamedTuple):
    """An attempt's result where it raises."""

    error: str


@cache
def exercises():
    """{name: Exercise} of all modules here."""
    modules = [
        importlib.import_module(f"{__name__}.{m.name}")
        for m in pkgutil.iter_modules(__path__)
    ]
    return {
        exercise.name: exercise for module in modules for exercise in module.EXERCISES
    }


def check(name, attempt):
    """Say what is wrong with an attempt; return it if it is right, else ours."""
    exercise = exercises()[name]
    verdict = judge(exercise, attempt)
    print(f"{name}: {verdict}")
    return attempt if verdict == "right." else exercise.solution


def judge(exercise, attempt):
    """The verdict on an attempt, in words."""
    expected, watched = outcomes(exercise, exercise.solution), Watched(attempt)
    found = outcomes(exercise, watched)
    if all(each is None or each is ... for each in found):
        if written(attempt):
            it = "q()" if isinstance(attempt, type) else "it"  # the only class's
            return f"{it} returns None: return the result."
        return f"not written yet. Hint: {exercise.hint}"
    wrong = [k for k in range(len(expected)) if not same(found[k], expected[k])]
    if not wrong and watched.changed and not exercise.in_place:
        name = watched.changed[0]
        return f"the result is right, but `{name}` has changed: work on a copy."
    if not wrong:
        return "right."
    case = exercise.cases[wrong[0]]
    example = exercise.say(exercise.name, *case)
    if isinstance(found[wrong[0]], Raised):
        example += f" raises {found[wrong[0]].error}."
    else:
        example += f" gives {plain(found[wrong[0]])}, not {plain(expected[wrong[0]])}."
    for sentence, mistake in exercise.mistakes.items():
        if all(map(same, found, outcomes(exercise, mistake))):
            return f"{sentence} {example}"
    return f"not yet. {example}"


class Watched:
    """An attempt, and the names of the arguments that it has changed."""

    def __init__(self, attempt):
        self.attempt, self.changed = attempt, []

    def __call__(self, *arguments):
        before = deepcopy(arguments)
        result = self.attempt(*arguments)
        for k, (old, new) in enumerate(zip(before, arguments, strict=True)):
            if isinstance(new, (np.ndarray, list)) and not same(old, new):
                names = [*inspect.signature(self.attempt).parameters]
                self.changed.append(names[min(k, len(names) - 1)])
        return result


def written(attempt):
    """Whether a function, or a method of a class, does more than return a constant.

    >>> written(lambda x: None), written(lambda x: print(x))
    (False, True)
    """
    if isinstance(attempt, Watched):
        return written(attempt.attempt)
    if isinstance(attempt, type):
        methods = {**vars(attempt), "__init__": None}.values()
        return any(written(each) for each in methods if inspect.isfunction(each))
    if not inspect.isfunction(attempt):
        return attempt is not ...
    idle = "RESUME", "NOP", "LOAD_CONST", "LOAD_COMMON", "RETURN"
    done = {each.opname for each in dis.get_instructions(attempt)}
    return not all(name.startswith(idle) for name in done)


def outcomes(exercise, attempt):
    """What an attempt gives in each case. It may change its arguments, or raise."""

    def outcome(case):
        try:
            return exercise.run(attempt, *deepcopy(case))
        except Exception as error:
            return Raised(f"{type(error).__name__}: {error}")

    return [outcome(case) for case in exercise.cases]


def same(a, b):
    """Whether two results agree, up to rounding. Anything can be compared.

    >>> same((1, [0.1 + 0.2]), (1.0, np.array([0.3])))
    True
    >>> same(None, 0), same([1, 2], [[1], [2]])
    (False, False)
    """
    if isinstance(a, Raised) or isinstance(b, Raised):
        return type(a) is type(b) and a == b
    if a is None or b is None:
        return a is b
    if isinstance(a, (tuple, list)) and isinstance(b, (tuple, list)):
        return len(a) == len(b) and all(map(same, a, b))
    try:
        a, b = np.asarray(a, float), np.asarray(b, float)
        return a.shape == b.shape and np.allclose(a, b, equal_nan=True)
    except (TypeError, ValueError):
        return type(a) is type(b) and str(a) == str(b)


def plain(value):
    """A value as the page prints it.

    >>> plain((np.array([0.1 + 0.2, -1.0]), np.bool_(True)))
    '([0.3, −1], True)'
    """
    value = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    if isinstance(value, float):
        return f"{value:.6g}".replace("-", "−")
    if isinstance(value, (tuple, list)):
        text = ", ".join(map(plain, value))
        return f"[{text}]" if isinstance(value, list) else f"({text})"
    return repr(value)


def solution(name):
    """Show an exercise's solution, folded."""
    code = inspect.getsource(exercises()[name].solution).rstrip()
    text = (
        f"<details><summary>Solution</summary>\n\n```python\n{code}\n```\n\n</details>"
    )
    display(Markdown(text), exclude=["text/plain"])

"""Promises about the code itself: its size, the direction of its imports, its words, and the list
of deviations.
"""

import ast
import re
import sys
from pathlib import Path
from statistics import median

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "gbdqn_ref"
READING_ORDER = re.search(
    r"nn, optim.*?__main__", (PACKAGE / "__init__.py").read_text(), re.DOTALL
)[0].split(",")
MODULES = [name.strip() for name in READING_ORDER]
CORE = MODULES[: MODULES.index("gbdqn") + 1]
TREES = {path.stem: ast.parse(path.read_text()) for path in PACKAGE.glob("*.py")}
STANDARD_ONLY = {"nn", "optim", "bellman", "boosting", "replay", "tabular"}


def code_lines(node):
    """The line numbers of a tree that hold code: no blanks, comments or docstrings."""
    lines = set()
    for part in ast.walk(node):
        docstring = (
            isinstance(part, ast.Expr)
            and isinstance(part.value, ast.Constant)
            and isinstance(part.value.value, str)
        )
        if docstring:
            lines -= set(range(part.lineno, part.end_lineno + 1))
        elif hasattr(part, "lineno") and not (
            isinstance(part, ast.Constant) and isinstance(part.value, str)
        ):
            lines |= {part.lineno, part.end_lineno}
    return lines


def imports(tree):
    """(module, is it ours) for every import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name.split(".")[0], False) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level:
            yield from ((node.module or alias.name, True) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.split(".")[0], False


def test_the_reading_order_names_every_module():
    assert sorted(MODULES) == sorted(set(TREES) - {"__init__"})


@pytest.mark.parametrize("name", MODULES)
def test_imports_go_against_the_reading_order_only(name):
    ours = {module for module, local in imports(TREES[name]) if local and module in TREES}
    assert all(MODULES.index(module) < MODULES.index(name) for module in ours)


@pytest.mark.parametrize("name", sorted(STANDARD_ONLY))
def test_the_learning_core_needs_numpy_alone(name):
    foreign = {module for module, local in imports(TREES[name]) if not local} - set(
        sys.stdlib_module_names
    )
    assert foreign <= {"numpy"}


def test_the_core_is_under_1000_lines_of_code():
    assert sum(len(code_lines(TREES[name])) for name in CORE) < 1000


@pytest.mark.parametrize("name", MODULES)
def test_no_module_is_over_200_lines_of_code(name):
    assert len(code_lines(TREES[name])) <= 200


def test_functions_are_short():
    functions = [
        node
        for tree in TREES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    sizes = {node.name: len(code_lines(node)) for node in functions}
    assert max(sizes.values()) <= 40, max(sizes, key=sizes.get)
    assert median(sizes.values()) <= 10


def test_every_public_function_says_what_it_does():
    for name, tree in TREES.items():
        assert ast.get_docstring(tree), name
        for node in tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                assert ast.get_docstring(node), f"{name}.{node.name}"


def test_nothing_is_called_done_and_nothing_is_pickled():
    """A single flag for termination and truncation is how time limits come to look like
    failures.
    """
    for path in PACKAGE.glob("*.py"):
        text = path.read_text()
        assert not re.search(r"\bdone\b", text), path.name
        assert "allow_pickle=True" not in text
        assert "import pickle" not in text


def test_no_global_random_numbers():
    for path in PACKAGE.glob("*.py"):
        assert not re.search(
            r"np\.random\.(?!default_rng|Generator|SeedSequence)", path.read_text()
        ), path.name


def test_every_deviation_is_listed_once_and_cited_at_its_line():
    listed = re.findall(
        r"^\| (D\d+) \|", (ROOT / "paper_checks" / "README.md").read_text(), re.MULTILINE
    )
    cited = {
        number
        for path in PACKAGE.glob("*.py")
        for number in re.findall(r"\bD\d+\b", path.read_text())
    }
    assert listed == [f"D{i + 1}" for i in range(len(listed))]
    assert set(listed) == cited

"""Rules for the code: its size, its imports, its docstrings, its listed deviations."""

import ast
import inspect
import re
import sys
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from statistics import median

import pytest

from gbdqn_ref.config import SETTINGS

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "gbdqn_ref"
INTRODUCTION = ast.get_docstring(ast.parse((PACKAGE / "__init__.py").read_text()))
MODULES = re.findall(r"\w+", re.search(r"nn, optim.*?__main__", INTRODUCTION, re.DOTALL)[0])
PAPER = ["nn", "optim", "bellman", "boosting", "replay", "dqn", "gbdqn"]  # what reads in an hour
TREES = {path.stem: ast.parse(path.read_text()) for path in PACKAGE.glob("*.py")}
NUMPY_ONLY = {*PAPER, "tabular", "baselines", "agents"}
NO_GYMNASIUM = {*NUMPY_ONLY, "schedule", "presets", "config", "stats", "files"}
FUNCTIONS = [
    pytest.param(node, id=f"{name}.{node.name}:{node.lineno}")
    for name, tree in TREES.items()
    for node in ast.walk(tree)
    if isinstance(node, ast.FunctionDef)
]


def is_docstring(node):
    return isinstance(node, ast.Expr) and isinstance(getattr(node.value, "value", None), str)


def statements(tree):
    """How many statements a tree contains, without docstrings."""
    inside = (node for node in ast.walk(tree) if node is not tree)
    return sum(isinstance(node, ast.stmt) and not is_docstring(node) for node in inside)


def imports(tree):
    """(module, is it ours) for every import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name.split(".")[0], False) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level:
            yield from ((node.module or alias.name, True) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.split(".")[0], False


def reached(name):
    """The module and all modules of the package that it imports, directly or not."""
    found, new = set(), {name}
    while new:
        found |= new
        new = {module for each in new for module, ours in imports(TREES[each]) if ours}
        new = new & set(TREES) - found
    return found


def test_the_reading_order_names_every_module():
    assert sorted(MODULES) == sorted(set(TREES) - {"__init__"})


@pytest.mark.parametrize("name", MODULES)
def test_modules_import_only_earlier_ones_in_the_reading_order(name):
    ours = {module for module, local in imports(TREES[name]) if local and module in TREES}
    assert all(MODULES.index(module) < MODULES.index(name) for module in ours)


@pytest.mark.parametrize("name", sorted(NUMPY_ONLY))
def test_the_learning_core_needs_only_numpy(name):
    trees = [TREES[module] for module in reached(name)]
    foreign = {module for tree in trees for module, local in imports(tree) if not local}
    assert foreign - set(sys.stdlib_module_names) <= {"numpy"}


@pytest.mark.parametrize("name", sorted(NO_GYMNASIUM))
def test_settings_and_schedules_need_no_gymnasium(name):
    trees = [TREES[module] for module in reached(name)]
    assert "gymnasium" not in {module for tree in trees for module, _ in imports(tree)}


def test_the_seven_modules_of_the_paper_read_in_an_hour():
    assert sum(statements(TREES[name]) for name in PAPER) <= 493  # 395, and a quarter


def test_the_package_is_small():
    assert len(MODULES) <= 29
    assert len(SETTINGS) <= 42
    main = (PACKAGE / "__main__.py").read_text()
    assert 7 <= len(re.findall(r"\.add_parser\(", main)) <= 8


@pytest.mark.parametrize("function", FUNCTIONS)
def test_no_function_has_over_30_statements(function):
    assert statements(function) <= 30


def test_half_of_the_functions_have_at_most_5_statements():
    assert median(statements(function.values[0]) for function in FUNCTIONS) <= 5


def test_these_tests_see_every_function():
    text = "".join(path.read_text() for path in PACKAGE.glob("*.py"))
    assert len(FUNCTIONS) == len(re.findall(r"^ *def \w", text, re.MULTILINE))


def test_every_module_and_public_name_has_a_docstring():
    for name, tree in TREES.items():
        assert ast.get_docstring(tree), name
        for node in tree.body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
                assert ast.get_docstring(node), f"{name}.{node.name}"


def test_nothing_is_called_done_and_nothing_is_pickled():
    """One flag for both termination and truncation would treat time limits as failures."""
    for path in PACKAGE.glob("*.py"):
        text = path.read_text()
        assert not re.search(r"\bdone\b", text), path.name
        assert "allow_pickle=True" not in text
        assert "import pickle" not in text


def test_no_global_random_numbers():
    for path in PACKAGE.glob("*.py"):
        found = re.search(r"np\.random\.(?!default_rng|Generator|SeedSequence)", path.read_text())
        assert not found, path.name


def source(name):
    """Of a module, a class or a function its source; of a constant the comment above it, too."""
    module, _, inside = name.partition(".")
    found = import_module(f"gbdqn_ref.{module}")
    thing = attrgetter(inside)(found) if inside else found
    if not isinstance(thing, dict):
        return inspect.getsource(thing)
    text = inspect.getsource(found)
    until = text[: re.search(rf"^{inside}\b.*", text, re.MULTILINE).end()]
    *_, comment = re.finditer(r"(?:^#.*\n)+", until, re.MULTILINE)
    return until[comment.start() :]


def test_every_deviation_is_listed_once_and_cited_at_its_line():
    page = (ROOT / "paper_checks" / "README.md").read_text()
    rows = re.findall(r"^\| (D\d+) \|.*\| (.*) \|$", page, re.MULTILINE)
    listed = [number for number, _ in rows]
    texts = [path.read_text() for path in PACKAGE.glob("*.py")]
    cited = {number for text in texts for number in re.findall(r"\bD\d+\b", text)}
    assert listed == [f"D{i + 1}" for i in range(len(listed))]
    assert set(listed) == cited
    for number, where in rows:
        for name in re.findall(r"`(.+?)`", where):
            assert re.search(rf"\b{number}\b", source(name)), (number, name)


def test_every_promise_names_existing_tests():
    page = (ROOT / "docs" / "promises.md").read_text(encoding="utf-8")
    rows = [row for row in page.splitlines() if re.match(r"\| (?!promise)", row)]
    assert len(rows) > 10
    for row in rows:
        named = re.findall(r"`(test_\w+\.py)::(test_\w+)`", row)
        assert named, row
        for file, name in named:
            text = (ROOT / "tests" / file).read_text(encoding="utf-8")
            assert f"def {name}(" in text, name


@pytest.mark.parametrize("target", ["train", "test"])
def test_the_readme_has_the_lines_of_make(target):
    """Its commands without make are those of the Makefile."""
    texts = [(ROOT / name).read_text(encoding="utf-8") for name in ("Makefile", "README.md")]
    make, readme = (re.sub(r"\\\n\s+", "", text) for text in texts)
    recipe = re.search(rf"^{target}: .*\n((?:\t.*\n)+)", make, re.MULTILINE)[1]
    for line in recipe.replace("$(BIN)", ".venv/bin").splitlines():
        assert line.strip() in readme

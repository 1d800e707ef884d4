"""The wheel works outside the clone, and pyproject.toml lists what the package needs."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path
from zipfile import ZipFile

import pytest
from helpers import SMALL, environ, flags
from test_structure import PACKAGE, ROOT, TREES, imports

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
REQUIREMENT = re.compile(r"(\w+)(\[[\w,-]+\])?>=\d+(\.\w+)*")


def pip(*arguments):
    subprocess.run([sys.executable, "-m", "pip", *arguments, "--no-index"], check=True)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy, since setuptools would add leftovers of older builds in the clone."""
    source, dist = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    shutil.copytree(PACKAGE, source / "gbdqn_ref")
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", dist, source)
    return next(dist.iterdir())


def test_the_wheel_holds_the_package_and_nothing_else(wheel):
    names = [name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name]
    assert sorted(names) == sorted(f"gbdqn_ref/{module}.py" for module in TREES)


def test_the_wheel_trains_outside_the_clone(wheel, tmp_path):
    """With -S Python reads no .pth file, so it does not find an editable install of the clone."""
    site, elsewhere = tmp_path / "site", tmp_path / "elsewhere"
    elsewhere.mkdir()
    pip("install", "--no-deps", "--target", site, wheel)
    path = environ(PYTHONPATH=os.pathsep.join([str(site), sysconfig.get_path("platlib")]))

    def python(*arguments):
        command = [sys.executable, "-S", *arguments]
        return subprocess.check_output(command, cwd=elsewhere, env=path, text=True).strip()

    used = Path(python("-c", "import gbdqn_ref; print(gbdqn_ref.__file__)"))
    assert used == site / "gbdqn_ref" / "__init__.py"
    settings = flags(**SMALL | dict(episodes=2, learning_starts=10))
    python("-m", "gbdqn_ref", "train", "--env", "cartpole", "--out", "run", *settings)
    assert len((elsewhere / "run" / "episodes.csv").read_text().splitlines()) == 1 + 2


@pytest.mark.parametrize("requirement", PROJECT["dependencies"])
def test_a_requirement_is_only_a_lower_bound(requirement):
    """`make test-oldest` installs exactly these versions."""
    assert REQUIREMENT.fullmatch(requirement)


def test_the_package_requires_what_it_imports():
    """Another package's dependency could disappear any day."""
    modules = {module for tree in TREES.values() for module, ours in imports(tree) if not ours}
    imported = {"pillow" if module == "PIL" else module for module in modules}
    required = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["cluster"]]
    names = {re.match(r"\w+", requirement)[0] for requirement in required}
    assert imported - set(sys.stdlib_module_names) == names

"""The notebooks run, as committed they show what their sources say, and nothing in them belongs to
one machine.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).parent.parent / "notebooks"
sys.path.insert(0, str(FOLDER))
import render  # noqa: E402

MEGABYTE = 10**6


@pytest.mark.parametrize("path", render.SOURCES, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_the_current_source(path, monkeypatch):
    """In fast mode; every assertion in a cell, solutions included, is one of this test's."""
    monkeypatch.setenv("NOTEBOOKS", "fast")
    executed = render.execute(render.read(path))
    assert markdown(executed) == markdown(
        nbformat.read(path.with_suffix(".ipynb"), as_version=4)
    ), "make notebooks"


def markdown(notebook):
    """What the cells show as Markdown: the package's source, and tables made from it."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    return [
        output["data"]["text/markdown"]
        for output in outputs
        if "text/markdown" in output.get("data", {})
    ]


@pytest.mark.parametrize("path", render.SOURCES, ids=lambda path: path.stem)
def test_the_committed_notebook_has_the_cells_of_its_source(path):
    rendered = nbformat.read(path.with_suffix(".ipynb"), as_version=4)
    assert [(c.cell_type, c.source) for c in rendered.cells] == [
        (c.cell_type, c.source) for c in render.read(path).cells
    ]


@pytest.mark.parametrize("path", render.SOURCES, ids=lambda path: path.stem)
def test_its_outputs_are_small_and_machine_independent(path):
    """No paths, no memory addresses, no times, no widgets, no errors; every code cell was executed,
    in order.
    """
    text = path.with_suffix(".ipynb").read_text(encoding="utf-8")
    assert len(text) < 0.7 * MEGABYTE
    cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    executed = [cell for cell in cells if "slider" not in cell["metadata"].get("tags", [])]
    assert [cell["execution_count"] for cell in executed] == list(range(1, len(executed) + 1))
    outputs = json.dumps([cell["outputs"] for cell in cells])
    outputs = re.sub(r'"image/png": "[^"]*"', "", outputs)
    assert not re.search(
        r"/(home|Users|root|tmp|opt|usr)/|C:\\\\| at 0x|widget-view|\bms\b|µs|it/s", outputs
    )
    assert str(FOLDER.parent) not in outputs
    assert '"output_type": "error"' not in outputs


@pytest.mark.parametrize("name", ["04_boosting", "05_replay"])
def test_the_sliders_work(name):
    """Their cells are left out above; as a script the same source runs with them."""
    environ = os.environ | {"NOTEBOOKS": "fast", "MPLBACKEND": "agg"}
    script = subprocess.run(
        [sys.executable, f"{name}.py"],
        cwd=FOLDER,
        env=environ,
        capture_output=True,
        text=True,
        check=False,
    )
    assert script.returncode == 0, script.stderr
    assert "interactive(children=(FloatSlider(" in script.stdout


def test_notebooks_and_sources_match_one_to_one():
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == {path.stem for path in render.SOURCES}


def test_a_cell_that_fails_fails_the_test():
    """Negative control."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("assert 1 == 2")])
    with pytest.raises(Exception, match="AssertionError"):
        render.execute(notebook)

"""The notebooks run, match their sources as committed, and hold nothing of one machine."""

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
    """In fast mode; every assertion in a cell counts, solutions included."""
    monkeypatch.setenv("NOTEBOOKS", "fast")
    executed = markdown(render.execute(render.read(path)))
    committed = markdown(nbformat.read(path.with_suffix(".ipynb"), as_version=4))
    assert executed == committed, "run make notebooks"


def markdown(notebook):
    """The Markdown that the cells show: the package's source, and tables made from it."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    shown = [output.get("data", {}).get("text/markdown") for output in outputs]
    return [text for text in shown if text is not None]


@pytest.mark.parametrize("path", render.SOURCES, ids=lambda path: path.stem)
def test_the_committed_notebook_has_the_cells_of_its_source(path):
    rendered = nbformat.read(path.with_suffix(".ipynb"), as_version=4)
    cells, committed = (
        [(cell.cell_type, cell.source) for cell in notebook.cells]
        for notebook in (render.read(path), rendered)
    )
    assert cells == committed


@pytest.mark.parametrize("path", render.SOURCES, ids=lambda path: path.stem)
def test_its_outputs_are_small_and_machine_independent(path):
    """No paths, addresses, times, widgets or errors; every code cell was executed in order."""
    text = path.with_suffix(".ipynb").read_text(encoding="utf-8")
    assert len(text) < 0.7 * MEGABYTE
    cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    executed = [cell for cell in cells if "slider" not in cell["metadata"].get("tags", [])]
    assert [cell["execution_count"] for cell in executed] == list(range(1, len(executed) + 1))
    outputs = json.dumps([cell["outputs"] for cell in cells])
    outputs = re.sub(r'"image/png": "[^"]*"', "", outputs)
    of_one_machine = r"/(home|Users|root|tmp|opt|usr)/|C:\\\\| at 0x|widget-view|\bms\b|µs|it/s"
    assert not re.search(of_one_machine, outputs)
    assert str(FOLDER.parent) not in outputs
    assert '"output_type": "error"' not in outputs


@pytest.mark.parametrize("name", ["04_boosting", "05_replay"])
def test_the_sliders_work(name):
    """The tests above leave their cells out; run as a script the source includes them."""
    command = [sys.executable, f"{name}.py"]
    options = dict(cwd=FOLDER, env=os.environ | {"NOTEBOOKS": "fast", "MPLBACKEND": "agg"})
    script = subprocess.run(command, capture_output=True, text=True, **options)
    assert script.returncode == 0, script.stderr
    assert "interactive(children=(FloatSlider(" in script.stdout


def test_notebooks_and_sources_match_one_to_one():
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == {path.stem for path in render.SOURCES}


def test_a_cell_that_fails_fails_the_test():
    """Negative control."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("assert 1 == 2")])
    with pytest.raises(Exception, match="AssertionError"):
        render.execute(notebook)

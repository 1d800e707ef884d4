"""The notebooks run, match their sources as committed, and hold nothing of one machine."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pytest

FOLDER = Path(__file__).parent.parent / "notebooks"
sys.path.insert(0, str(FOLDER))
with plt.rc_context():  # the look of the lesson's pictures stays there
    import render

MEGABYTE = 10**6
PICTURE = r'"image/(?:png|svg\+xml)": (?:"[^"]*"|\[[^\]]*\])'
CURRENT = [path for path in render.SOURCES if (FOLDER / "clean" / f"{path.stem}.ipynb").exists()]
every_notebook = pytest.mark.parametrize("path", render.SOURCES, ids=lambda path: path.stem)


@every_notebook
def test_a_notebook_runs_and_shows_the_current_source(path, monkeypatch):
    """In fast mode; every assertion in a cell counts."""
    monkeypatch.setenv("NOTEBOOKS", "fast")
    executed = markdown(render.execute(render.read(path)))
    committed = markdown(nbformat.read(path.with_suffix(".ipynb"), as_version=4))
    assert executed == committed, "run make notebooks"


def markdown(notebook):
    """The Markdown that the cells show: the package's source, and tables made from it."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    shown = [output.get("data", {}).get("text/markdown") for output in outputs]
    return [text for text in shown if text is not None]


@pytest.mark.parametrize("path", CURRENT, ids=lambda path: path.stem)
def test_the_committed_notebook_has_the_cells_of_its_source(path):
    rendered = nbformat.read(path.with_suffix(".ipynb"), as_version=4)
    cells, committed = (
        [(cell.cell_type, cell.source) for cell in notebook.cells]
        for notebook in (render.read(path), rendered)
    )
    assert cells == committed


@every_notebook
def test_its_outputs_are_machine_independent(path):
    """No paths, addresses, times, widgets or errors; every code cell was executed in order."""
    text = path.with_suffix(".ipynb").read_text(encoding="utf-8")
    cells = [cell for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    executed = [cell for cell in cells if "slider" not in cell["metadata"].get("tags", [])]
    assert [cell["execution_count"] for cell in executed] == list(range(1, len(executed) + 1))
    outputs = re.sub(PICTURE, "", json.dumps([cell["outputs"] for cell in cells]))
    of_one_machine = r"/(home|Users|root|tmp|opt|usr)/|C:\\\\| at 0x|widget-view|\bms\b|µs|it/s"
    assert not re.search(of_one_machine, outputs)
    assert str(FOLDER.parent) not in outputs
    assert '"output_type": "error"' not in outputs


def test_the_notebooks_are_small():
    """All together, with their clean copies."""
    assert sum(path.stat().st_size for path in FOLDER.rglob("*.ipynb")) < 6 * MEGABYTE


SLIDERS = [path for path in render.SOURCES if '"slider"' in path.read_text(encoding="utf-8")]


@pytest.mark.parametrize("path", SLIDERS, ids=lambda path: path.stem)
def test_the_sliders_work(path):
    """The tests above leave their cells out; run as a script the source includes them."""
    options = dict(cwd=FOLDER, env=os.environ | {"NOTEBOOKS": "fast", "MPLBACKEND": "agg"})
    script = subprocess.run([sys.executable, path], capture_output=True, text=True, **options)
    assert script.returncode == 0, script.stderr
    assert "interactive(children=(" in script.stdout


def test_notebooks_and_sources_match_one_to_one():
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == {path.stem for path in render.SOURCES}


def test_a_notebook_is_written_beside_a_clean_copy(tmp_path, monkeypatch):
    """Without a name, each of them; the copy has no outputs, and finds what the cells import."""
    (tmp_path / "01_sum.py").write_text("# %%\n1 + 1\n")
    monkeypatch.setattr(render, "FOLDER", tmp_path)
    monkeypatch.setattr(render, "SOURCES", [tmp_path / "01_sum.py"])
    monkeypatch.setattr(render, "execute", answered)
    render.main([])
    notebook, copy = (
        nbformat.read(tmp_path / name, as_version=4)["cells"][0]
        for name in ("01_sum.ipynb", "clean/01_sum.ipynb")
    )
    assert notebook.source == "1 + 1" and notebook.outputs[0].text == "2"
    assert copy.source == f"{render.PATH}1 + 1" and copy.outputs == []


def answered(notebook):
    """With an output, as if its cells had run."""
    notebook.cells[0].outputs = [nbformat.v4.new_output("stream", text="2")]
    return notebook


def test_a_cell_that_fails_fails_the_test():
    """Negative control."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("assert 1 == 2")])
    with pytest.raises(Exception, match="AssertionError"):
        render.execute(notebook)

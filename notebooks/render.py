"""Execute each notebook's source, NAME.py, and write what is read, NAME.ipynb: python notebooks/render.py [NAME …]"""

import os
import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
SOURCES = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
WIDGET = "application/vnd.jupyter.widget-view+json"  # a slider's picture has a random id, and is dead without a kernel


def read(path):
    """The cells of a source in percent format, as a notebook without outputs, the same for the same text."""
    notebook = jupytext.read(path)
    notebook.metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    notebook.metadata["language_info"] = {"name": "python"}
    notebook.nbformat_minor = 5
    for k, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{k}"
    return notebook


def execute(notebook):
    """Run all cells, in the folder of the notebooks; an exception in one of them is raised here."""
    os.environ["JUPYTER_PLATFORM_DIRS"] = "1"  # or jupyter_core warns that it will look elsewhere one day
    return NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(FOLDER)}}).execute()


def clean(notebook):
    """Take away what differs from one run to the next: times, widgets and progress bars."""
    notebook.metadata.pop("widgets", None)
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if not _passing(output)]
    return notebook


def _passing(output):
    return output.get("name") == "stderr" or WIDGET in output.get("data", {})


def main(names):
    """Render the named notebooks, or all."""
    for path in [FOLDER / f"{name}.py" for name in names] or SOURCES:
        print(path.stem, flush=True)
        notebook = clean(execute(read(path)))
        nbformat.validate(notebook)
        nbformat.write(notebook, path.with_suffix(".ipynb"))


if __name__ == "__main__":
    main(sys.argv[1:])

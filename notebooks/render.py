"""Execute each notebook's source, NAME.py, and write what is read, NAME.ipynb: python
notebooks/render.py [NAME …]
"""

import os
import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent
SOURCES = sorted(FOLDER.glob("[0-9][0-9]_*.py"))


def read(path):
    """The cells of a source in percent format, as a notebook without outputs, the same for the same
    text.
    """
    notebook = jupytext.read(path)
    notebook.metadata = {
        "kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}
    }
    notebook.metadata["language_info"] = {"name": "python"}
    notebook.nbformat_minor = 5
    for k, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{k}"
    return notebook


def execute(notebook):
    """Run all cells in the folder of the notebooks; an exception in one of them is raised here.

    Cells with a slider are left out: what they show is dead without a kernel, and waiting for it
    sometimes never ends.
    """
    os.environ["JUPYTER_PLATFORM_DIRS"] = (
        "1"  # or jupyter_core warns that it will look elsewhere one day
    )
    options = dict(
        timeout=600, skip_cells_with_tag="slider", coalesce_streams=True
    )  # or prints are cut by chance
    return NotebookClient(
        notebook, resources={"metadata": {"path": str(FOLDER)}}, **options
    ).execute()


def clean(notebook):
    """Take away what differs from one run to the next: times and progress bars."""
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    return notebook


def main(names):
    """Render the named notebooks, or all."""
    for path in [FOLDER / f"{name}.py" for name in names] or SOURCES:
        print(path.stem, flush=True)
        notebook = clean(execute(read(path)))
        nbformat.validate(notebook)
        nbformat.write(notebook, path.with_suffix(".ipynb"))


if __name__ == "__main__":
    main(sys.argv[1:])

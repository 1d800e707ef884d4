"""Execute each notebook's source, NAME.py, and write NAME.ipynb and clean/NAME.ipynb, a
copy without outputs: python notebooks/render.py [NAME …]
"""

import json
import os
import re
from copy import deepcopy
from pathlib import Path

import jupytext
import lesson
import nbformat
from nbclient import NotebookClient

from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.files import write_atomically

FOLDER = Path(__file__).parent
SOURCES = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
LEDGER = FOLDER.parent / "paper_checks"
CLAIMS = {
    row["id"]
    for row in json.loads((LEDGER / "ledger.json").read_text(encoding="utf-8"))[
        "claims"
    ]
}
DEVIATIONS = set(
    re.findall(
        r"^\| (D\d+) \|",
        (LEDGER / "README.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
)
ID = re.compile(r"\b(T\d-[a-z]|[A-Z]\d+)\b")
NOT_PROSE = re.compile(  # fenced code, code, equations, links, tags
    r"(```.*?```|`[^`\n]*`|\$\$.*?\$\$|\$[^$\n]*\$|\[[^\]]*\]\([^)]*\)|<[^>\n]*>)",
    re.DOTALL,
)
# tag: JupyterLab's key
HIDDEN = {
    "predicted": "outputs_hidden",
    "solution": "source_hidden",
    "checks": "source_hidden",
}
TELLING = re.compile(r"\bassert\b|\bshow\(")  # code that says what will be seen
PATH = """import sys

sys.path.insert(0, "..")  # where lesson, exercises and pictures are

"""


def read(path):
    """A source in percent format as a notebook without outputs.

    Ids of claims and deviations become links. Tags hide what is to be guessed first:
    the output, and the code too if it asserts the answer or describes its picture.
    """
    notebook = jupytext.read(path)
    notebook.metadata = {
        "kernelspec": {
            "name": "python3",
            "display_name": "Python 3",
            "language": "python",
        }
    }
    notebook.nbformat_minor = 5
    for k, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{k}"
        if cell.cell_type == "markdown":
            cell.source = linked(cell.source)
        tags = cell.metadata.get("tags", [])
        hidden = [HIDDEN[tag] for tag in tags if tag in HIDDEN]
        if "predicted" in tags and TELLING.search(cell.source):
            hidden.append("source_hidden")
        if hidden:
            cell.metadata["jupyter"] = dict.fromkeys(hidden, True)
    return notebook


def linked(text):
    """Markdown with each id of a claim or a deviation as a link to the ledger's page.

    >>> linked("By T1-a and D6, but not `D6`, $B1$ or Z9.")[:47]
    'By [T1-a](../paper_checks/README.md#t1-a) and ['
    """

    def link(found):
        known = found[0] in CLAIMS | DEVIATIONS
        return (
            f"[{found[0]}](../paper_checks/README.md#{found[0].lower()})"
            if known
            else found[0]
        )

    parts = NOT_PROSE.split(text)
    parts[::2] = [ID.sub(link, part) for part in parts[::2]]
    return "".join(parts)


def execute(notebook):
    """Run all cells in the folder of the notebooks; an exception in one is raised here.

    Cells with a slider are left out: what they show is dead without a kernel, and
    waiting for it sometimes never ends.
    """
    os.environ["JUPYTER_PLATFORM_DIRS"] = (
        "1"  # or jupyter_core warns of a change to come
    )
    options = dict(timeout=600, skip_cells_with_tag="slider", coalesce_streams=True)
    resources = {"metadata": {"path": str(FOLDER)}}
    return NotebookClient(notebook, resources=resources, **options).execute()


def steady(notebook):
    """Take away what differs from run to run: times, progress bars, the version."""
    notebook.metadata["language_info"] = {"name": "python"}
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [
                output for output in cell.outputs if output.get("name") != "stderr"
            ]
    return notebook


def clean(notebook):
    """A copy without outputs, in clean/, for viewers that cannot hide them."""
    copy = deepcopy(notebook)
    code = [cell for cell in copy.cells if cell.cell_type == "code"]
    for cell in code:
        cell.outputs, cell.execution_count = [], None
    code[0].source = PATH + code[0].source
    for cell in copy.cells:
        if cell.cell_type == "markdown":
            cell.source = re.sub(
                r"\]\((?=\.\./|README\.md|\w+\.py\))", "](../", cell.source
            )
    return copy


def write(notebook, path):
    """Write a notebook whole or not at all."""
    nbformat.validate(notebook)
    text = nbformat.writes(notebook) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def main(arguments=None):
    """Render the named notebooks, or all."""
    parser = Parser(description="Run notebooks, and write them.")
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="like 14_network; default all"
    )
    names, known = parser.parse_args(arguments).names, [path.stem for path in SOURCES]
    for name in names:
        if name not in known:
            parser.error(f"no notebook is called {name!r}; {', '.join(known)} are")
    (FOLDER / "clean").mkdir(exist_ok=True)
    for path in [FOLDER / f"{name}.py" for name in names or known]:
        notebook = steady(execute(read(path)))
        print(f"{path.stem}: {lesson.minutes(notebook)} minutes", flush=True)
        write(notebook, path.with_suffix(".ipynb"))
        write(clean(notebook), FOLDER / "clean" / f"{path.stem}.ipynb")


if __name__ == "__main__":
    program(main)

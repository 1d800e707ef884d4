"""The pages of the course: the notebooks with their links, folds, alt texts and downloads; the
glossary.
"""

import json
import re

from places import ROOT, moved, notebooks, read, relative

FOLDED = {  # a cell's tag: MyST-NB's tag, and what the fold says
    "predicted": ("hide-output", "the answer"),
    "solution": ("hide-input", "the solution"),
    "checks": ("hide-input", "the checks of the answers above"),
}
WHOLLY = "hide-cell", "the answer and its code"  # where the code, too, gives it away


def pages():
    """{name: text} of these pages."""
    found = notebooks()
    texts = {f"course/{stem}.ipynb": notebook(stem, content) for stem, content in found.items()}
    index = moved(read("notebooks/README.md"), "notebooks/README.md", "course/index.md")
    contents = "\n".join(found)
    texts["course/index.md"] = f"{index}\n```{{toctree}}\n:hidden:\n\n{contents}\n```\n"
    texts["glossary.md"] = re.sub(
        r"^### (.*)",
        lambda term: f"({anchor(term[1])})=\n{term[0]}",
        read("docs/glossary.md"),
        flags=re.M,
    )
    return texts


def notebook(stem, content):
    """A notebook as MyST-NB reads it; a live figure stands in the place of its slider, and of a
    still picture beside that. A slider without a figure is left out: no kernel would move it.
    """
    source, page = f"notebooks/{stem}.ipynb", f"course/{stem}.ipynb"
    cells, content["cells"] = content["cells"], []
    for cell in cells:
        tags = cell["metadata"].get("tags", [])
        if figure := [tag.removeprefix("live:") for tag in tags if tag.startswith("live:")]:
            cell = markdown(cell["id"], f"```{{figure-live}} {figure[0]}\n```")
        elif {"still", "slider"} & {*tags}:
            continue
        elif cell["cell_type"] == "markdown":
            cell["source"] = moved("".join(cell["source"]), source, page)
        else:
            prepare(cell, source, page)
        content["cells"].append(cell)
    content["cells"].insert(1, markdown("offer", offered(stem, page)))
    return json.dumps(content, ensure_ascii=False, indent=1)


def markdown(name, text):
    """A cell of text."""
    return {"cell_type": "markdown", "id": name, "metadata": {}, "source": text}


def prepare(cell, source, page):
    """Fold a code cell by its tags, name its pictures, and move the links of its output."""
    tags, options = cell["metadata"].setdefault("tags", []), {}
    for tag, fold in FOLDED.items():
        if tag in tags:
            told = tag == "predicted" and "source_hidden" in cell["metadata"]["jupyter"]
            hidden, what = WHOLLY if told else fold
            tags.append(hidden)
            options |= {"code_prompt_show": f"Show {what}", "code_prompt_hide": f"Hide {what}"}
    if "= check(" in "".join(cell["source"]):
        tags.append("checked")  # site.css breaks the lines of its verdict
    for output in cell["outputs"]:
        for described in output.get("metadata", {}).values():
            if "alt" in described:
                options["image"] = {"alt": described["alt"]}
        if "text/markdown" in output.get("data", {}):
            text = "".join(output["data"]["text/markdown"])
            output["data"]["text/markdown"] = moved(text, source, page)
    cell["metadata"]["mystnb"] = options


def offered(stem, page):
    """The line under a notebook's title that offers its files.

    >>> offered("01_x", "course/01_x.ipynb")
    'Download: . Open in Jupyter, from a clone: `.venv/bin/jupyter lab notebooks/01_x.ipynb`'
    """
    files = {
        f"notebooks/{stem}.ipynb": "this notebook",
        f"notebooks/clean/{stem}.ipynb": "a clean copy, without outputs",
    }
    if "forty_lines" in stem:
        files["notebooks/forty_lines.py"] = "the forty lines"
    links = [
        f'<a href="{relative(f"files/{file}", page)}" download>{words}</a>'
        for file, words in files.items()
        if (ROOT / file).exists()
    ]
    jupyter = f"`.venv/bin/jupyter lab notebooks/{stem}.ipynb`"
    return f"Download: {', '.join(links)}. Open in Jupyter, from a clone: {jupyter}"


# The glossary


def terms():
    """{term in lower case: anchor} of the glossary."""
    found = re.findall(r"^### (.*)", read("docs/glossary.md"), re.M)
    return {term.lower(): anchor(term) for term in found}


def anchor(term):
    """A term's anchor.

    >>> anchor("TD error"), anchor("ε-greedy")
    ('term-td-error', 'term-epsilon-greedy')
    """
    return "term-" + re.sub(r"\W+", "-", term.lower().replace("ε", "epsilon")).strip("-")

"""The site's pages, as Sphinx reads them: {name: text}, from the notebooks, the ledger, the package
and the Markdown files of the repository.

Links to files are moved here (places.py). Names of claims, equations and functions become links
later, in links.py.
"""

import posixpath
import re
import tomllib

import checked
import course
from answer import draw
from places import MODULES, ROOT, SHOWN, moved, own, read

from gbdqn_ref import __version__


def every():
    """{name: text} of every page."""
    pages = files() | checked.pages() | course.pages() | api() | figures()
    pages["index.md"] += contents(pages)
    return pages


def files():
    """The pages that are Markdown files of the repository or of this folder."""
    pages = {name: moved(own(name), name, name) for name in ("index.md", "cite.md")}
    pages["cite.md"] = pages["cite.md"].replace("VERSION", __version__)
    for source, name in SHOWN.items():
        if name not in pages and (ROOT / source).is_file():
            pages[name] = moved(read(source), source, name)
    name = "what_to_keep.md"  # the question, and the answer
    pages[name] = moved(own(name), name, name) + re.sub(r"^# ", "## ", pages[name])
    return pages


def api():
    """A page for each module, in the order of docs/modules.md."""
    above, listed = own("api.md"), "\n".join(MODULES)
    pages = {"api/index.md": f"{above}\n```{{toctree}}\n\n{listed}\n```\n"}
    for module in MODULES:
        directive = f".. automodule:: gbdqn_ref.{module}\n   :members:\n   :ignore-module-all:"
        text = f"# gbdqn_ref.{module}\n\n```{{eval-rst}}\n{directive}\n```\n"
        pages[f"api/{module}.md"] = text
    return pages


def figures():
    """The pages of the live figures, which lie in figures/ beside their scripts."""
    paths = sorted((ROOT / "site/figures").glob("*.md"))
    return {f"figures/{path.name}": path.read_text(encoding="utf-8") for path in paths}


def contents(pages):
    """The start page's hidden contents, which the sidebar shows: contents.toml, less what is not
    there.
    """
    known, text = {posixpath.splitext(name)[0] for name in pages}, ""
    for title, entries in tomllib.loads(own("contents.toml")).items():
        names = {entry: re.search(r"[^<>]+(?=>?$)", entry)[0] for entry in entries}
        if listed := "\n".join(entry for entry, name in names.items() if name in known):
            text += f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{listed}\n```\n"
    return text


def write(folder, extra):
    """Write all pages and their pictures, and into `extra` the files that they offer."""
    pages = every()
    wanted = {folder / name: text.encode() for name, text in pages.items()}
    for name, text in pages.items():
        for picture in re.findall(r"!\[[^\]]*\]\(([^)\s]+\.(?:png|svg))\)", text):
            file = posixpath.normpath(posixpath.join(posixpath.dirname(name), picture))
            drawn = file == "answer.svg"
            wanted[folder / file] = draw() if drawn else (ROOT / file).read_bytes()
        for file in re.findall(r'href=\\?"(?:\.\./)*files/([^"\\]+)\\?"', text):
            wanted[extra / "files" / file] = (ROOT / file).read_bytes()
    for path, content in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)

"""Where the site has what the repository has: the page of a file, and links between pages."""

import json
import posixpath
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
CHECKS = "paper_checks/README.md"
SHOWN = {  # a file or folder of the repository: its page
    "README.md": "index.md",
    CHECKS: "ledger.md",
    "paper_checks/results/README.md": "results.md",
    "paper_checks/results/keep/README.md": "keep.md",
    "paper_checks/results/keep/settings/README.md": "settings.md",
    "paper_checks/results/keep/network/README.md": "network.md",
    "paper_checks/results/keep/hopper/README.md": "hopper.md",
    "benchmarks/keep/README.md": "detectors.md",
    "notebooks/README.md": "course/index.md",
    "docs/what_to_keep.md": "what_to_keep.md",
    "docs/when_not.md": "when_not.md",
    "docs/measured.md": "measured.md",
    "docs/speed.md": "speed.md",
    "docs/modules.md": "modules.md",
    "docs/promises.md": "promises.md",
    "docs/use.md": "use.md",
    "docs/glossary.md": "glossary.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changes.md",
    "paper_checks": "ledger.md",
    "notebooks": "course/index.md",
    "notebooks/clean": "course/index.md",
    "gbdqn_ref": "modules.md",
    "benchmarks": "speed.md",
}
CODE = ("gbdqn_ref/*", "paper_checks/*", "tests/*", "benchmarks/**/*", "notebooks/**/*")
LINK = re.compile(r"(?<!\\)(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")


def read(name):
    """A file of the repository, as text."""
    return (ROOT / name).read_text(encoding="utf-8")


def own(name):
    """A file of the site's folder, as text."""
    return read(f"site/{name}")


MODULES = re.findall(r"^\| \[`(\w+)`\]", read("docs/modules.md"), re.M)


def notebooks():
    """{stem: content} of every notebook, in order."""
    paths = sorted(ROOT.glob("notebooks/[0-9]*.ipynb"))
    return {path.stem: json.loads(read(path)) for path in paths}


def code():
    """Every Python file that has a page, by its name in the repository."""
    found = {path for pattern in CODE for path in ROOT.glob(f"{pattern}.py")}
    return sorted(path.relative_to(ROOT).as_posix() for path in found)


def shown(file):
    """The page that shows a file of the repository, or None.

    >>> shown("notebooks/04_boosting.ipynb"), shown("gbdqn_ref/nn.py"), shown("LICENSE")
    ('course/04_boosting.ipynb', 'api/nn.md', None)
    """
    folder, _, name = file.rpartition("/")
    if folder == "notebooks" and name.endswith(".ipynb"):
        return f"course/{name}"
    if folder == "gbdqn_ref" and name.removesuffix(".py") in MODULES:
        return f"api/{name.removesuffix('.py')}.md"
    return SHOWN.get(file)


def address(file, anchor=""):
    """Where a file of the repository lies: Python as a page, another to be downloaded.

    >>> address("paper_checks/smt.py", "L7"), address("LICENSE")
    ('source/paper_checks/smt.html#L7', 'files/LICENSE')
    """
    if file.endswith(".py"):
        return f"source/{file.removesuffix('.py')}.html" + f"#{anchor}" * bool(anchor)
    return f"files/{file}"


def relative(target, page):
    """An address as seen from a page.

    >>> relative("files/LICENSE", "course/01.ipynb")
    '../files/LICENSE'
    """
    return posixpath.relpath(target, posixpath.dirname(page) or ".")


def moved(text, source, page):
    """A source's text with its links to files as links from its page.

    >>> moved("[T1-a](../paper_checks/README.md#t1-a)", "notebooks/01.py", "course/01.ipynb")
    '[T1-a](#t1-a)'
    >>> moved("[code](gbdqn_ref/nn.py), [licence](LICENSE)", "README.md", "index.md")
    '[code](api/nn.md), <a href="files/LICENSE">licence</a>'
    """
    return LINK.sub(lambda found: _moved(*found.groups(), source, page), text)


def _moved(image, label, link, source, page):
    if re.match(r"#|\w+:", link):
        return f"{image}[{label}]({link})"
    if "issues/new" in link:  # a form of the forge
        contributing = relative("contributing.md", page)
        return f"[{label}]({contributing})" if page != contributing else label
    link, _, anchor = link.partition("#")
    file = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
    if file == CHECKS and anchor:
        return f"[{label}](#{anchor})"
    target = shown(file)
    if not (ROOT / file).exists():  # a page that is made, or a file that is not there yet
        return label if target else f"{image}[{label}]({link})"
    if target:
        return f"[{label}]({relative(target, page)}{'#' * bool(anchor)}{anchor})"
    if image:
        return f"![{label}]({relative(file, page)})"
    return f'<a href="{relative(address(file), page)}">{label.replace("`", "")}</a>'

"""The site's pages, written as Sphinx reads them: {name: text}, from the notebooks, the ledger, the
package and the Markdown files of the repository.

A link in a source leads to a file of the repository; moved() turns it into one to the page that
shows the file. Names of claims, equations and functions become links later, in links.py.
"""

import json
import os.path
import posixpath
import re
import sys
import tomllib
from pathlib import Path

FOLDER = Path(__file__).parent
ROOT = FOLDER.parent
sys.path[:0] = [str(FOLDER), str(ROOT), str(ROOT / "paper_checks")]
import ledger  # noqa: E402
import page as ledger_page  # noqa: E402
from answer import draw  # noqa: E402

from gbdqn_ref import __version__  # noqa: E402

CHECKS = "paper_checks/README.md"
SHOWN = {  # a Markdown file of the repository: its page
    "README.md": "index.md",
    CHECKS: "ledger.md",
    "paper_checks/results/README.md": "results.md",
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
}
FOLDERS = {
    "paper_checks": "ledger.md",
    "notebooks": "course/index.md",
    "gbdqn_ref": "modules.md",
    "benchmarks": "speed.md",
}
CODE = ("gbdqn_ref/*.py", "paper_checks/*.py", "tests/*.py", "benchmarks/**/*.py", "notebooks/**/*.py")
LINK = re.compile(r"(?<!\\)(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")
EQUATIONS = tomllib.loads((FOLDER / "equations.toml").read_text(encoding="utf-8"))
LINES = tomllib.loads((FOLDER / "algorithm.toml").read_text(encoding="utf-8"))["line"]
MODULES = re.findall(r"^\| \[`(\w+)`\]", (ROOT / "docs/modules.md").read_text(encoding="utf-8"), re.M)


def read(name):
    """A file of the repository, as text."""
    return (ROOT / name).read_text(encoding="utf-8")


def notebooks():
    """{stem: cells as JSON} of every notebook, in order."""
    return {path.stem: json.loads(read(path)) for path in sorted(ROOT.glob("notebooks/[0-9]*.ipynb"))}


def code():
    """Every Python file that a page shows, by its name in the repository."""
    found = {path for pattern in CODE for path in ROOT.glob(pattern)}
    return sorted(path.relative_to(ROOT).as_posix() for path in found)


# Links


def shown(name):
    """The page that shows a file of the repository, or None.

    >>> shown("notebooks/04_boosting.ipynb"), shown("gbdqn_ref/nn.py"), shown("LICENSE")
    ('course/04_boosting.ipynb', 'api/nn.md', None)
    """
    folder, _, file = name.rpartition("/")
    if name in SHOWN or name in FOLDERS:
        return SHOWN.get(name) or FOLDERS[name]
    if folder == "notebooks" and file.endswith(".ipynb"):
        return f"course/{file}"
    if folder == "gbdqn_ref" and file[:-3] in MODULES:
        return f"api/{file[:-3]}.md"
    return None


def moved(text, source, name):
    """The text of a source with its links to files as links from the page of this name.

    >>> moved("[T1-a](../paper_checks/README.md#t1-a), [4](04_boosting.ipynb)", "notebooks/01.py", "course/01.ipynb")
    '[T1-a](#t1-a), [4](04_boosting.ipynb)'
    >>> moved("[code](gbdqn_ref/nn.py), [licence](LICENSE)", "README.md", "docs/index.md")
    '[code](../api/nn.md), <a href="../files/LICENSE">licence</a>'
    """

    def target(found):
        image, label, link = found.groups()
        if re.match(r"#|\w+:", link):
            return found[0]
        link, _, anchor = link.partition("#")
        file = posixpath.normpath(posixpath.join(posixpath.dirname(source), link))
        if "issues/new" in link:  # a form of the forge
            return f"[{label}](#a-verdict-that-is-wrong)"
        if file == CHECKS and anchor:
            return f"[{label}](#{anchor})"
        if (page := shown(file)) and (ROOT / file).exists():
            return f"{image}[{label}]({relative(page, name)}{'#' * bool(anchor)}{anchor})"
        if image and (ROOT / file).exists():
            return f"![{label}]({relative(file, name)})"
        if not (ROOT / file).is_file():  # a page that is made, or a file that is not there yet
            return label if page else found[0]
        return f'<a href="{relative(address(file), name)}">{label.replace("`", "")}</a>'

    return LINK.sub(target, text)


def relative(target, name):
    """A page's or file's address, as seen from another page."""
    return posixpath.relpath(target, posixpath.dirname(name) or ".")


def address(file, place=""):
    """Where the site has a file of the repository: Python's as a page, others to be downloaded.

    >>> address("paper_checks/smt.py", "test_x"), address("LICENSE")
    ('source/paper_checks/smt.html#test_x', 'files/LICENSE')
    """
    if file.endswith(".py"):
        return f"source/{file[:-3]}.html" + (f"#{place}" if place else "")
    return f"files/{file}"


def linked_files(pages):
    """The files that pages offer for download."""
    found = re.findall(r'href="(?:\.\./)*files/([^"]+)"', "".join(pages.values()))
    return sorted(set(found))


# The ledger and what the other sections of its README say


def sections(text):
    """{heading: text} of a page's sections, "" for what stands above the first.

    >>> sections("# A\\n\\nb\\n\\n## C\\n\\nd\\n")
    {'': '# A\\n\\nb\\n\\n', 'C': '\\nd\\n'}
    """
    first, *rest = re.split(r"^## ", text, flags=re.M)
    return {"": first} | {each.partition("\n")[0]: each.partition("\n")[2] for each in rest}


def rows():
    """What the ledger knows of every claim: claims/*.toml, and ledger.json for what the checks show."""
    known = ledger.committed()
    return [known[id] | claim | {"id": id} for id, claim in ledger.CLAIMS.items()]


def badge(verdict):
    """A verdict as a coloured word.

    >>> badge("holds with an assumption")
    '[holds with an assumption]{.badge .holds-with-an-assumption}'
    """
    return f"[{verdict}]{{.badge .{verdict.replace(' ', '-')}}}"


def claim(row, treated):
    """A claim's section: its verdict, and all that is known of it in a fold."""
    far = ledger_page.how_far(row).replace("–", "not checked")
    text = f"({row['id'].lower()})=\n### {row['id']} · {row['claim']}\n\n"
    text += f"{badge(row['verdict'])} [{far}]{{.far}} {row['place']}"
    if why := row.get("decides", row.get("assumption")):
        text += f": {ledger_page.filled(why, row)}"
    fields = ledger_page.section(row).split("\n\n", 3)[-1].split("- Notebooks: ")[0]
    if treated:
        fields += f"- The course: {', '.join(treated)}\n"
    return f"{text}\n\n<details><summary>Reading, counterexample, checks</summary>\n\n{fields}\n</details>\n"


def treated():
    """{id: links to the sections of the course that cite it}."""
    found = {}
    for stem, content in notebooks().items():
        number, heading = int(stem[:2]), ""
        for cell in content["cells"]:
            for block in re.split(r"(?=^#+ )", "".join(cell["source"]), flags=re.M):
                if cell["cell_type"] != "markdown":
                    continue
                if title := re.match(r"#+ (.*)", block):
                    heading = title[1]
                for id in ledger.CLAIMS:
                    if re.search(rf"\b{id}\b", block):
                        links = found.setdefault(id, {})
                        links.setdefault(stem, f"[{number}, {plain(heading)}](course/{stem}.ipynb)")
    return {id: list(links.values()) for id, links in found.items()}


def plain(heading):
    """A heading without mathematics and marks.

    >>> plain("4 · The `step` α, and [T1-a](x.md)")
    'The step α, and T1-a'
    """
    heading = re.sub(r"^\d+ · ", "", LINK.sub(r"\2", heading))
    return re.sub(r"[$`*\\]", "", heading)


def ledger_pages():
    """The ledger, and the other sections of its README as pages of their own."""
    parts, found, cites = sections(read(CHECKS)), rows(), treated()
    options = [f"<option>{verdict}</option>" for verdict in ledger.VERDICTS]
    form = (FOLDER / "filter.html").read_text(encoding="utf-8").replace("VERDICTS", "".join(options))
    text = f"---\ntocdepth: 2\n---\n\n{parts['']}\n## In twelve lines\n{parts['In twelve lines']}"
    counts = ledger_page.counts(found)
    for verdict in ledger.VERDICTS:
        counts = counts.replace(f"**{verdict}**", badge(verdict))
    text += f"## The count\n\n{counts}\n## Claim by claim\n\n{form}\n"
    text += "\n".join(claim(row, cites.get(row["id"], [])) for row in found)
    concordance = "".join(equation(name) for name in EQUATIONS)
    checks = "How to run and change it"
    pages = {
        "ledger.md": text,
        "equations.md": f"# Equations, theorems, and where they are\n\n{parts['Numbers of equations']}\n{concordance}",
        "deviations.md": deviations(parts["Deviations"]),
        "paragraphs.md": f"# The paper, paragraph by paragraph\n{parts['The paper, paragraph by paragraph']}",
        "checks.md": f"# The checks: {checks.lower()}\n{parts[checks]}",
    }
    return {name: re.sub(r"<!--.*?-->\n*", "", moved(text, CHECKS, name)) for name, text in pages.items()}


def equation(name):
    """An equation or theorem: the formula, what computes it, and its claims."""
    place = ledger.PLACES[name]
    here = [row for row in rows() if name in ledger.markers(row["place"])]
    text = f"({place.lower().replace('. ', '-').replace(' ', '-')})=\n## {place}: {EQUATIONS[name]['title']}\n\n"
    if formula := EQUATIONS[name].get("formula"):
        text += f"$$\n{formula}\n$$\n\n"
    uses = dict.fromkeys(f"`{each}`" for row in here for each in row.get("uses", []))
    found = treated_places(place)
    text += f"- Functions: {', '.join(uses)}\n"
    text += f"- The course: {', '.join(found)}\n" if found else ""
    text += "- Claims: " + ", ".join(f"{row['id']} {badge(row['verdict'])}" for row in here)
    return text + "\n\n"


def treated_places(place):
    """Links to the notebooks with a heading on a place of the paper."""
    found = {}
    for stem, content in notebooks().items():
        for cell in content["cells"]:
            titles = re.findall(r"^#+ (.*)", "".join(cell["source"]), re.M)
            marks = [mark for title in titles for mark in ledger.markers(title)]
            if cell["cell_type"] == "markdown" and place in [ledger.PLACES.get(mark) for mark in marks]:
                title = next(each for each in titles if ledger.markers(each))
                found.setdefault(stem, f"[{int(stem[:2])}, {plain(title)}](course/{stem}.ipynb)")
    return list(found.values())


def deviations(text):
    """The table of deviations as sections, each with an anchor."""
    above, table = text.split("\n| |", 1)
    page = f"# Deviations\n\n{above.strip()}\n\n"
    for row in re.findall(r"^\| (D\d+) \|(.*)\|$", table, re.M):
        paper, ours, why, where = (cell.strip() for cell in re.split(r"(?<!\\)\|", row[1]))
        page += f"({row[0].lower()})=\n## {row[0]}\n\n- The paper: {paper}\n- Here: {ours}\n- Why: {why}\n- Where: {where}\n\n"
    return page


# Algorithm 1


def algorithm():
    """Algorithm 1's lines, each beside the line of the package that does it."""
    text = (FOLDER / "algorithm.md").read_text(encoding="utf-8")
    for entry in LINES:
        file, number, line = found(entry["where"], entry["code"])
        where = entry["where"].replace("_", "\\_")
        link = f'<a href="{address(file, f"L{number}")}">{where}</a>'
        first = entry["lines"].split("–")[0].split(",")[0]
        text += f"\n(line-{first})=\n::::{{container}} pair\n:::{{container}} printed\n"
        text += f"**{entry['lines']}** {entry['says']}\n:::\n:::{{container}} ours\n{link}\n"
        text += f"```python\n{line}\n```\n:::\n::::\n"
    return text


def found(where, code):
    """(file, number, line) of the one line of a function that has this code.

    >>> found("gbdqn.GBDQN.learn", "polyak(")[2]
    'polyak(self.theta_target, self.theta, c.tau)  # D9'
    """
    module, _, name = where.partition(".")
    file = f"gbdqn_ref/{module}.py"
    lines = read(file).splitlines()
    start, end = extent(lines, name)
    (number,) = [k for k in range(start, end) if code in lines[k]]
    return file, number + 1, lines[number].strip()


def extent(lines, name):
    """(first, one past the last) line of a function or Class.method, counted from 0.

    >>> extent(["class A:", "    x = 1", "    def f(self):", "        return 1", "", "y = 2"], "A.f")
    (2, 5)
    """
    start, indent = 0, ""
    for part in name.split("."):
        start = next(
            k for k in range(start, len(lines)) if re.match(rf"{indent}(def|class) {part}\b", lines[k])
        )
        indent += "    "
    inside = re.compile(rf"{indent}|\s*$|\)")
    end = next((k for k in range(start + 1, len(lines)) if not inside.match(lines[k])), len(lines))
    return start, end


# The course


def course():
    """The notebooks: folded predictions, alt texts, links, and a line to download each."""
    pages, found = {}, notebooks()
    for stem, content in found.items():
        name, source = f"course/{stem}.ipynb", f"notebooks/{stem}.ipynb"
        for cell in content["cells"]:
            cell["source"] = moved("".join(cell["source"]), source, name) if cell["cell_type"] == "markdown" else cell["source"]
            prepared(cell, source, name)
        offer = {"cell_type": "markdown", "id": "offer", "metadata": {}, "source": offered(stem, name)}
        content["cells"].insert(1, offer)
        pages[name] = json.dumps(content, ensure_ascii=False, indent=1)
    pages["course/index.md"] = moved(read("notebooks/README.md"), "notebooks/README.md", "course/index.md")
    pages["course/index.md"] += "\n```{toctree}\n:hidden:\n\n" + "\n".join(found) + "\n```\n"
    return pages


def prepared(cell, source, name):
    """A code cell with what MyST-NB needs to fold its output and to describe its pictures."""
    if cell["cell_type"] != "code":
        return
    tags, options = cell["metadata"].setdefault("tags", []), cell["metadata"].setdefault("mystnb", {})
    if "predicted" in tags:
        tags.append("hide-output")
        options |= {"code_prompt_show": "Show the answer", "code_prompt_hide": "Hide the answer"}
    if "slider" in tags or cell["metadata"].get("jupyter", {}).get("source_hidden"):
        tags.append("hide-input")
        options |= {"code_prompt_show": "Show the code", "code_prompt_hide": "Hide the code"}
    for output in cell["outputs"]:
        for kind, described in output.get("metadata", {}).items():
            if isinstance(described, dict) and "alt" in described:
                options["image"] = {"alt": described["alt"]}
        if "text/markdown" in output.get("data", {}):
            text = "".join(output["data"]["text/markdown"])
            output["data"]["text/markdown"] = moved(text, source, name)


def offered(stem, name):
    """The line under a notebook's title that offers its files."""
    files = {f"notebooks/{stem}.ipynb": "this notebook", f"notebooks/clean/{stem}.ipynb": "without outputs"}
    if "forty" in stem:
        files["notebooks/forty_lines.py"] = "the forty lines"
    links = [
        f'<a href="{relative(f"files/{file}", name)}" download>{words}</a>'
        for file, words in files.items()
        if (ROOT / file).exists()
    ]
    jupyter = f"`.venv/bin/jupyter lab notebooks/{stem}.ipynb`"
    return f"Download: {', '.join(links)}. Open in Jupyter, from a clone: {jupyter}"


def glossary():
    """{term in lower case: anchor} of the glossary."""
    text = read("docs/glossary.md") if (ROOT / "docs/glossary.md").exists() else ""
    return {term.lower(): anchor(term) for term in re.findall(r"^### (.*)", text, re.M)}


def anchor(term):
    """A glossary term's anchor.

    >>> anchor("TD error")
    'term-td-error'
    """
    return "term-" + re.sub(r"\W+", "-", term.lower()).strip("-")


# All pages


def api():
    """A page for each module, in the order of docs/modules.md."""
    listed = "\n".join(MODULES)
    pages = {"api/index.md": f"{(FOLDER / 'api.md').read_text(encoding='utf-8')}\n```{{toctree}}\n\n{listed}\n```\n"}
    for module in MODULES:
        pages[f"api/{module}.md"] = (
            f"# gbdqn_ref.{module}\n\n```{{eval-rst}}\n.. automodule:: gbdqn_ref.{module}\n   :members:\n```\n"
        )
    return pages


def files():
    """The pages that are Markdown files of the repository or of this folder."""
    own = ("index.md", "cite.md")
    pages = {name: moved((FOLDER / name).read_text(encoding="utf-8"), name, name) for name in own}
    pages["cite.md"] = pages["cite.md"].replace("VERSION", __version__)
    for source, name in SHOWN.items():
        if name not in ("index.md", "ledger.md", "course/index.md") and (ROOT / source).exists():
            pages[name] = moved(read(source), source, name)
    if "glossary.md" in pages:
        marked = lambda found: f"({anchor(found[1])})=\n{found[0]}"  # noqa: E731
        pages["glossary.md"] = re.sub(r"^### (.*)", marked, pages["glossary.md"], flags=re.M)
    for path in sorted(FOLDER.glob("figures/*.md")):
        pages[f"figures/{path.name}"] = path.read_text(encoding="utf-8")
    if "what_to_keep.md" in pages:
        framing = (FOLDER / "what_to_keep.md").read_text(encoding="utf-8")
        table = re.sub(r"^# ", "## ", pages["what_to_keep.md"])
        pages["what_to_keep.md"] = moved(framing, "what_to_keep.md", "what_to_keep.md") + table
    return pages


def contents(pages):
    """The start page's hidden contents: what the sidebar shows."""
    text = ""
    groups = tomllib.loads((FOLDER / "contents.toml").read_text(encoding="utf-8"))
    for title, names in groups.items():
        listed = [name for name in names if any(f"{name}{end}" in pages for end in (".md", ".ipynb"))]
        if title == "Live figures":
            listed = sorted(name[:-3] for name in pages if name.startswith("figures/"))
        if listed:
            text += f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n" + "\n".join(listed) + "\n```\n"
    return text


def all_pages():
    """{name: text} of every page."""
    pages = files() | ledger_pages() | course() | api() | {"algorithm.md": algorithm()}
    pages["index.md"] += contents(pages)
    return pages


def write(folder, extra):
    """Write all pages, their pictures, and the files that they offer; keep what has not changed."""
    pages = all_pages()
    wanted = {folder / name: text.encode() for name, text in pages.items()}
    for name, text in pages.items():
        for picture in re.findall(r"!\[[^\]]*\]\(([^)\s]+\.(?:png|svg))\)", text):
            file = posixpath.normpath(posixpath.join(posixpath.dirname(name), picture))
            wanted[folder / file] = draw() if file == "answer.svg" else (ROOT / file).read_bytes()
    for file in linked_files(pages):
        wanted[extra / "files" / file] = (ROOT / file).read_bytes()
    for path in [path for base in (folder, extra) for path in base.rglob("*") if path.is_file()]:
        if path not in wanted:
            path.unlink()
    for path, content in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_bytes() != content:
            path.write_bytes(content)

"""The pages of "Is the paper right?": the ledger and the other sections of its README, the
equations, the deviations, Algorithm 1 beside the code.
"""

import re
import sys
import tomllib

from places import CHECKS, LINK, ROOT, address, moved, notebooks, own, read

sys.path[:0] = [str(ROOT), str(ROOT / "paper_checks")]
import ledger  # noqa: E402
import page as ledger_page  # noqa: E402

EQUATIONS = tomllib.loads(own("equations.toml"))
LINES = tomllib.loads(own("algorithm.toml"))["line"]


def pages():
    """{name: text} of these pages."""
    parts = sections(read(CHECKS))
    equations = "".join(map(equation, EQUATIONS))
    run, paragraphs = "How to run and change it", "The paper, paragraph by paragraph"
    texts = {
        "ledger.md": claims(parts),
        "equations.md": "# Equations, theorems, and where they are\n"
        f"{parts['Numbers of equations']}{equations}",
        "deviations.md": deviations(parts["Deviations"]),
        "paragraphs.md": f"# {paragraphs}\n{parts[paragraphs]}",
        "checks.md": f"# The checks: {run.lower()}\n{parts[run]}",
    }
    texts = {name: moved(text, CHECKS, name) for name, text in texts.items()}
    texts = {name: re.sub(r"<!--.*?-->\n*", "", text) for name, text in texts.items()}
    return texts | {"algorithm.md": algorithm()}


def sections(text):
    """{heading: text} of a page's sections, "" for what stands above the first.

    >>> sections("# A\\n\\nb\\n\\n## C\\n\\nd\\n")
    {'': '# A\\n\\nb\\n\\n', 'C': '\\nd\\n'}
    """
    above, *rest = re.split(r"^## ", text, flags=re.M)
    return {"": above} | {each.partition("\n")[0]: each.partition("\n")[2] for each in rest}


# The ledger


def rows():
    """All of every claim: claims/*.toml, and ledger.json for what the checks show."""
    known = ledger.committed()
    return [known[id] | claim | {"id": id} for id, claim in ledger.CLAIMS.items()]


def claims(parts):
    """The ledger: in twelve lines, the count, and a section for each claim behind a filter."""
    verdicts = "".join(f"<option>{verdict}</option>" for verdict in ledger.VERDICTS)
    form = own("filter.html").replace("VERDICTS", verdicts)
    counts = ledger_page.counts(rows())
    for verdict in ledger.VERDICTS:
        counts = counts.replace(f"**{verdict}**", badge(verdict))
    cites = citing()
    short = "In twelve lines"
    text = f"---\ntocdepth: 2\n---\n\n{parts['']}\n## {short}\n{parts[short]}"
    text += f"## The count\n\n{counts}\n## Claim by claim\n\n{form}\n"
    return text + "\n".join(claim(row, cites.get(row["id"], [])) for row in rows())


def claim(row, course):
    """A claim's section: its verdict, and all that is known of it in a fold."""
    far = ledger_page.how_far(row).replace("–", "not checked")
    text = f"({row['id'].lower()})=\n### {row['id']} · {row['claim']}\n\n"
    text += f"{badge(row['verdict'])} [{far}]{{.far}} {row['place']}"
    if why := row.get("decides", row.get("assumption")):
        text += f": {ledger_page.filled(why, row)}"
    fields = ledger_page.section(row).split("\n\n", 3)[-1].split("- Notebooks: ")[0]
    fields = re.sub(r"^- (Why|Missing assumption): .*\n", "", fields, flags=re.M)
    fields += f"- The course: {', '.join(course)}\n" if course else ""
    summary = "<summary>Reading, counterexample, checks</summary>"
    return f"{text}\n\n<details>{summary}\n\n{fields}\n</details>\n"


def badge(verdict):
    """A verdict as a coloured word.

    >>> badge("holds with an assumption")
    '[holds with an assumption]{.badge .holds-with-an-assumption}'
    """
    return f"[{verdict}]{{.badge .{verdict.replace(' ', '-')}}}"


def headed():
    """(stem, heading, text) of every section of the course."""
    for stem, content in notebooks().items():
        heading = ""
        for cell in content["cells"]:
            text = "".join(cell["source"]) if cell["cell_type"] == "markdown" else ""
            for block in re.split(r"^(?=#+ )", text, flags=re.M):
                if title := re.match(r"#+ (.*)", block):
                    heading = title[1]
                yield stem, heading, block


def citing():
    """{id: links to the notebooks that cite the claim, each with its first section that does}."""
    found = {}
    for stem, heading, text in headed():
        for id in set(ledger.ID.findall(text)) & set(ledger.CLAIMS):
            found.setdefault(id, {}).setdefault(stem, treated(stem, heading))
    return {id: list(links.values()) for id, links in found.items()}


def treated(stem, heading):
    """A link to a notebook, with its number and a section's title."""
    return f"[{int(stem[:2])}, {plain(heading)}](course/{stem}.ipynb)"


def plain(heading):
    """A heading without mathematics, links and the notebook's number.

    >>> plain("4 · The `step` α, and [T1-a](x.md)")
    'The step α, and T1-a'
    """
    heading = re.sub(r"^\d+ · ", "", LINK.sub(r"\2", heading))
    return re.sub(r"[$`*\\]", "", heading)


# Equations and deviations


def equation(name):
    """An equation or theorem: the formula, what computes it, and its claims."""
    place, markers = ledger.PLACES[name], ledger.markers
    here = [row for row in rows() if name in markers(row["place"])]
    text = f"({anchor(place)})=\n## {place}: {EQUATIONS[name]['title']}\n\n"
    if formula := EQUATIONS[name].get("formula"):
        text += f"$$\n{formula}\n$$\n\n"
    uses = dict.fromkeys(f"`{each}`" for row in here for each in row.get("uses", []))
    course = {stem: treated(stem, title) for stem, title, _ in headed() if name in markers(title)}
    text += f"- Functions: {', '.join(uses)}\n"
    text += f"- The course: {', '.join(course.values())}\n" if course else ""
    text += "- Claims: " + ", ".join(f"{row['id']} {badge(row['verdict'])}" for row in here)
    return text + "\n\n"


def anchor(place):
    """The anchor of a place of the paper.

    >>> anchor("Eq. 8"), anchor("Theorem 2")
    ('eq-8', 'theorem-2')
    """
    return re.sub(r"\W+", "-", place.lower())


def deviations(text):
    """The table of deviations as sections, each with an anchor."""
    above, table = text.split("\n| |", 1)
    page = f"# Deviations\n\n{above.strip()}\n\n"
    for number, cells in re.findall(r"^\| (D\d+) \|(.*)\|$", table, re.M):
        page += f"({number.lower()})=\n## {number}\n\n"
        titles = ("The paper", "Here", "Why", "Where")
        for title, cell in zip(titles, re.split(r"(?<!\\)\|", cells), strict=True):
            page += f"- {title}: {cell.strip()}\n"
        page += "\n"
    return page


# Algorithm 1


def algorithm():
    """Algorithm 1's lines, each beside the line of the package that does it."""
    text = own("algorithm.md")
    for entry in LINES:
        file, number, line = found(entry["where"], entry["code"])
        where = entry["where"].replace("_", "\\_")
        link = f'<a href="{address(file, f"L{number}")}">{where}</a>'
        text += f"\n(line-{numbers(entry)[0]})=\n::::{{container}} pair\n:::{{container}} printed\n"
        text += f"**{entry['lines']}** {entry['says']}\n:::\n:::{{container}} ours\n{link}\n"
        text += f"```python\n{line}\n```\n:::\n::::\n"
    return text


def numbers(entry):
    """The printed lines that an entry of algorithm.toml is about.

    >>> numbers({"lines": "9–11"}), numbers({"lines": "15, 20"})
    ([9, 10, 11], [15, 20])
    """
    found = [int(number) for number in re.findall(r"\d+", entry["lines"])]
    return list(range(found[0], found[1] + 1)) if "–" in entry["lines"] else found


def found(where, code):
    """(file, number, line) of the one line of a function that has this code.

    >>> found("gbdqn.GBDQN.learn", "polyak(")[2]
    'polyak(self.theta_target, self.theta, c.tau)  # D9'
    """
    module, _, name = where.partition(".")
    file = f"gbdqn_ref/{module}.py"
    lines = read(file).splitlines()
    (number,) = [k for k in extent(lines, name) if code in lines[k]]
    return file, number + 1, lines[number].strip()


def extent(lines, name):
    """The lines of a function or of Class.method, counted from 0.

    >>> extent(["class A:", "    def f(self):", "        return 1", "", "y = 2"], "A.f")
    range(1, 4)
    """
    start, indent = 0, ""
    for part in name.split("."):
        opens = re.compile(rf"{indent}(def|class) {part}\b")
        start = next(k for k in range(start, len(lines)) if opens.match(lines[k]))
        indent += "    "
    inside = re.compile(rf"{indent}|\s*$|\s*\)")
    end = next((k for k in range(start + 1, len(lines)) if not inside.match(lines[k])), len(lines))
    return range(start, end)

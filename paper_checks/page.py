"""The page: README.md's parts that are written from ledger.json, and both files.

python paper_checks/page.py    writes them after a change of claims/*.toml, without running a check
"""

import json
import re
from collections import Counter

import ledger

from gbdqn_ref import UsageError
from gbdqn_ref.__main__ import Parser, program
from gbdqn_ref.files import write_atomically

PAGE = ledger.HERE / "README.md"


def write(figures):
    """Write ledger.json with these figures beside those that it has, and README.md from it."""
    known = {id: row["figures"] for id, row in ledger.committed().items()}
    rows = ledger.rows({id: known.get(id, {}) | figures.get(id, {}) for id in ledger.CLAIMS})
    content = {"claims": rows, "coverage": ledger.COVERAGE}
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    page = renewed(PAGE.read_text(encoding="utf-8"), blocks(content))
    write_atomically(ledger.LEDGER, lambda file: file.write(text.encode()))
    write_atomically(PAGE, lambda file: file.write(page.encode()))


def renewed(page, parts):
    """The page with what stands between its marks written anew, {name of the mark: text}.

    >>> renewed("a <!-- claims --> b <!-- /claims --> c", {"claims": "d"})
    'a <!-- claims -->\\n\\nd\\n<!-- /claims --> c'
    """
    for name, text in parts.items():
        begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        before, _, rest = page.partition(begin)
        _, _, after = rest.partition(end)
        if (page.count(begin), page.count(end), rest.count(end)) != (1, 1, 1):
            raise UsageError(f"the page needs {begin} and {end} behind it, each once")
        page = f"{before}{begin}\n\n{text}\n{end}{after}"
    return page


def blocks(content):
    """{name: text} of every part that is written."""
    rows = content["claims"]
    return {
        "counts": counts(rows),
        "table": table(rows),
        "claims": "\n".join(map(section, rows)),
        "concordance": concordance(rows),
        "coverage": coverage(content["coverage"]),
    }


def counts(rows):
    """How many claims have each verdict, and how far the checks reach."""
    found, reach = Counter(row["verdict"] for row in rows), Counter(map(how_far, rows))
    text = f"| {len(rows)} claims | | |\n|---|---|---|\n"
    for verdict, meaning in ledger.VERDICTS.items():
        text += f"| **{verdict}** | {found[verdict]} | {meaning} |\n"
    return text + (
        f"\nOf the claims {reach['proved']} are proved for every instance of a stated size,"
        f" {reach['sampled']} are sampled, {reach['examples']} are decided by examples.\n"
    )


def how_far(row):
    """The strongest of a row's checks in one word.

    >>> how_far({"extents": ["proved for every Q (and not without μ)", "sampled by Hypothesis"]})
    'proved'
    """
    return row["extents"][0].replace("decided by ", "").split()[0] if row["extents"] else "–"


def table(rows):
    """One line for each claim."""
    text = "| | claim | place | verdict | how far |\n|---|---|---|---|---|\n"
    for row in rows:
        verdict = f"**{row['verdict']}**"
        if why := row.get("decides", row.get("assumption")):
            verdict += ": " + why
        cells = [f"[{row['id']}](#{row['id'].lower()})", row["claim"], row["place"]]
        cells += [filled(verdict, row), how_far(row)]
        text += "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"
    return text


def section(row):
    """All that the ledger knows of a claim, under its anchor."""
    text = f'<a id="{row["id"].lower()}"></a>\n\n#### {row["id"]} · {row["claim"]}\n\n'
    text += f"{row['place']}: **{row['verdict']}**\n\n"
    lines = []
    for name, title in list(ledger.FIELDS.items())[3:]:
        if name in row and name not in ("extent", "uses"):
            lines.append(f"{title}: {filled(row[name], row)}")
    extents = row["extents"] + [row[name] for name in ["extent"] if name in row]
    lines += [f"How far: {'; '.join(extents)}"] if extents else []
    lines += shown(row)
    functions = ", ".join(f"`{name}`" for name in row.get("uses", []))
    lines += [f"Functions: {functions}"] if functions else []
    notebooks = ", ".join(map(link, row["notebooks"]))
    lines += [f"Notebooks: {notebooks}"] if notebooks else []
    return text + "".join(f"- {line}\n" for line in lines)


def shown(row):
    """The checks of a claim, each with its figure unless a field has it already."""
    prose = " ".join(row.get(name, "") for name in ledger.FIELDS if name != "uses")
    for check in row["checks"]:
        test = check.split("::")[1]
        figure = row["figures"].get(test, "")
        yield f"`{check}`" + (f": {figure}" if f"{{{test}}}" not in prose else "")
    for title in ("proofs", "controls"):
        if row[title]:
            yield f"{title.capitalize()}: " + ", ".join(f"`{check}`" for check in row[title])


def filled(text, row):
    """A text with {name of a test} as the figure of that test, and the ids of claims as links.

    >>> filled("it grows: {a_test} (T1-a)", {"id": "M1", "figures": {"a_test": "1 → 2"}})
    'it grows: 1 → 2 ([T1-a](#t1-a))'
    """
    text = re.sub(r"\{(\w+)\}", lambda name: row["figures"].get(name[1], name[0]), text)
    return ledger.ID.sub(lambda found: linked(found[0], row["id"]), text)


def linked(id, here=""):
    """A link to a claim from any other."""
    return f"[{id}](#{id.lower()})" if id in ledger.CLAIMS and id != here else id


def link(notebook, text=""):
    """A link to a notebook: its number, and a text."""
    return f"[{int(notebook[:2])}](../notebooks/{notebook}.ipynb){text}"


def concordance(rows):
    """For each numbered place of the paper: what computes it, the notebooks with a heading on it,
    and its claims.
    """
    text = "| | functions | notebooks | claims |\n|---|---|---|---|\n"
    headings = [
        (name, title)
        for name in ledger.NOTEBOOKS
        for title in re.findall(r"^##+ (.*)", ledger.NOTEBOOKS[name], re.M)
    ]
    for marker, place in ledger.PLACES.items():
        here = [row for row in rows if marker in ledger.markers(row["place"])]
        uses = dict.fromkeys(name for row in here for name in row.get("uses", []))
        shown = [(name, title) for name, title in headings if marker in ledger.markers(title)]
        found = [link(name, f" {title}") for name, title in shown]
        ids = ", ".join(linked(row["id"]) for row in here)
        text += f"| {place} | {', '.join(uses)} | {'<br>'.join(found)} | {ids} |\n"
    return text


def coverage(paragraphs):
    """For each paragraph of the paper, its claims or why it has none."""
    text = "| section, paragraph | begins | claims |\n|---|---|---|\n"
    for each in paragraphs:
        claims = ", ".join(map(linked, each.get("ids", []))) or f"none: {each['none']}"
        place = f"{each['section']}, {each['number']}"
        text += f"| {place} | {each['begins']} | {claims} |\n"
    return text


def main(arguments=None):
    """Write both files; figures of checks that are not run stay."""
    Parser(description="Write ledger.json and README.md anew.").parse_args(arguments)
    write({})


if __name__ == "__main__":
    program(main)

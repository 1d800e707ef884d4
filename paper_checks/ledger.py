"""The ledger: which checks decide which claim of the paper, and how; and where each numbered place
of it is found.

`--ledger` writes both into README.md, and the rows into ledger.json.
"""

import json
import re
import string
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest

README = Path(__file__).with_name("README.md")
ROWS = README.with_name("ledger.json")
BEGIN, END = (
    "<!-- ledger: written by pytest paper_checks --ledger paper_checks/README.md -->",
    "<!-- end of ledger -->",
)
PLACES_BEGIN, PLACES_END = (
    "<!-- concordance: written with the ledger -->",
    "<!-- end of concordance -->",
)
PLACES = {f"eq{n}": f"Eq. {n}" for n in range(1, 12)} | {
    f"theorem{n}": f"Theorem {n}" for n in range(1, 5)
}
PLACES["algorithm1"] = "Algorithm 1"
SECTIONS = (  # the headings of the paper that places name
    "Introduction",
    "Related Work",
    "Methodology",
    "Gradient Boosted DQN",
    "Recency and TD-error",
    "Ensemble Target Networks",
    "Algorithm",
    "Theoretical Analysis",
    "Experimental Results",
    "Acrobot",
    "MountainCar",
    "Hopper",
    "Conclusions",
)
NOTEBOOKS = {
    path.stem: path.read_text(encoding="utf-8").replace("\n# ", "\n")
    for path in sorted(README.parent.parent.glob("notebooks/[0-9]*.py"))
}
GROUPS = (
    "M",
    "R",
    "W",
    "P",
    "A",
    "T1",
    "B",
    "T2",
    "T3",
    "T4",
    "C",
    "X",
)  # in the order of the paper
HEADER = (
    "| | claim | place | verdict | what decides it | functions | notebooks | checks |\n"
    + 8 * "|---"
    + "|\n"
)
NOT_CHECKABLE = (  # (id, claim, place, reason)
    (
        "T2-n",
        "F, F_m, Q and Q_m, 𝒯 and 𝒯* are used for one another",
        "Theorem 2, proof",
        "notation; the checks read all as Q_m and 𝒯*",
    ),
    (
        "A7",
        "a booster has been trained when it is added",
        "Algorithm 1, lines 3 and 29",
        (
            "it is added after max-episodes, of which no value is given; what it misses then is the"
            " ε of T4-d"
        ),
    ),
    (
        "X11",
        "CartPole was among the benchmarks",
        "section Conclusions",
        "the paper shows none of it",
    ),
    (
        "X12",
        "boosters are added when drift is detected",
        "section Introduction",
        "a schedule tells, nothing detects",
    ),
)
GLYPHS = {"1/2": "½", "1/4": "¼", "3/4": "¾"}
CLAIMS = {}  # id: what marks a test of it
current = None  # the test that runs, set by conftest


def claim(id, place, says, verdict, uses):
    """Mark a test that decides a claim: `says` in our words, `uses` the functions that decide it,
    if any.

    verdict is "holds", "holds if …", "fails: …" or "ambiguous: …". The test gets the markers of its
    place: theorem1 from "Theorem 1", eq8 from "Eq. 8", algorithm1 from "Algorithm 1". It calls
    shows() with the figure that decides the claim. Further tests of it are marked by also().
    """
    assert re.match(r"holds$|holds if |fails: |ambiguous: ", verdict), verdict
    marks = [pytest.mark.claim(id=id, place=place, says=says, verdict=verdict, uses=uses)]
    marks += [getattr(pytest.mark, name) for name in markers(place)]

    def decorate(test):
        for mark in marks:
            test = mark(test)
        return test

    CLAIMS[id] = decorate
    return decorate


def also(id):
    """Mark a further test of a claim: one example, one test, and all of them decide it."""
    return CLAIMS[id]


def shows(template, *values):
    """Take down a figure that decides the claim of the running test, formatted from the values that
    the test asserted; ledger.json must have the same.
    """
    test, figure = current.originalname.removeprefix("test_"), Figure().format(template, *values)
    row = current.get_closest_marker("claim").kwargs
    row = row | {"notebooks": notebooks(row["id"]), "file": current.path.name}
    if ("claim", row | {"figures": {test: figure}}) not in current.user_properties:
        current.user_properties.append(("claim", row | {"figures": {test: figure}}))
    if not current.config.getoption("--ledger"):
        known = committed().get(row["id"], {"figures": {}})
        assert known | {"figures": known["figures"].get(test)} == row | {"figures": figure}, (
            "ledger.json has another row for this claim; write it with --ledger"
        )


class Figure(string.Formatter):
    """Numbers as the ledger prints them: a real minus, fractions as fractions, 10,000, and arrays
    element by element. The format "/" prints a float as the fraction that it is next to.

    >>> Figure().format("r = ({}), h = {:/}, {:.3f} of {}", [2.0, -1.0], -0.4, Fraction(1, 3), 9999)
    'r = (2, −1), h = −2/5, 0.333 of 9,999'
    """

    def format_field(self, value, spec):
        if isinstance(value, str):
            return value
        if isinstance(value, (list, tuple, np.ndarray)):
            return ", ".join(self.format_field(each, spec) for each in np.ravel(value).tolist())
        if spec == "/":
            value, spec = Fraction(value).limit_denominator(1000), ""
        if isinstance(value, Fraction) and not spec:
            text = re.sub(r"\d+/\d+", lambda found: GLYPHS.get(found[0], found[0]), str(value))
        else:
            plain = spec or ("," if isinstance(value, int) else ".10g")
            text = format(float(value) if isinstance(value, Fraction) else value, plain)
        return text.replace("-", "−").replace("%", " %")


def control(*ids):
    """Mark a test as the negative control of claims: with one term or assumption taken away, the
    outcome differs.
    """
    return pytest.mark.control(*ids)


def markers(place):
    """The pytest markers of a place in the paper.

    >>> markers("Theorem 1, Eqs. 7–8")
    ['theorem1', 'eq7', 'eq8']
    """
    names = [
        f"{word.lower()}{number}" for word, number in re.findall(r"(Theorem|Algorithm) (\d)", place)
    ]
    for first, last in re.findall(r"Eqs?\. (\d+)(?:–(\d+))?", place):
        names += [f"eq{number}" for number in range(int(first), int(last or first) + 1)]
    return names


def cited(text):
    """The claims that a notebook's text cites.

    >>> sorted(cited("falls (claims T1-a, M3). By Eq. 4, M9 (claim C1, D5)"))
    ['C1', 'M3', 'T1-a']
    """
    after = " ".join(re.findall(r"\bclaims? ([^.;:)]*)", text))
    return set(re.findall(r"\b[MRWPABCX]\d+\b|\bT\d-\w", after))


@cache
def notebooks(id):
    """Links to the notebooks that cite a claim."""
    return ", ".join(link(name) for name in NOTEBOOKS if id in cited(NOTEBOOKS[name]))


def link(notebook, text=""):
    """A link from README.md to a notebook: its number, and a text."""
    return f"[{int(notebook[:2])}](../notebooks/{notebook}.ipynb){text}"


def position(id):
    """Where a claim stands in the ledger: ("T1-b" is the second of group T1).

    >>> sorted(["T1-b", "M10", "X1", "M9", "T1-a"], key=position)
    ['M9', 'M10', 'T1-a', 'T1-b', 'X1']
    """
    group, number = re.fullmatch(r"(T\d|[A-Z])-?(\w+)", id).groups()
    return GROUPS.index(group), int(number) if number.isdigit() else ord(number)


def joined(found):
    """The rows of the ledger in its order, each claim with the figures of all of its tests."""
    rows = {}
    for row in found:
        known = rows.setdefault(row["id"], row)
        rows[row["id"]] = row | {"figures": known["figures"] | row["figures"]}
    return sorted(rows.values(), key=lambda row: position(row["id"]))


def table(rows):
    """The ledger as a Markdown table, from the rows of ledger.json."""
    lines = []
    for row in rows:
        figure, tests = "; ".join(row["figures"].values()), ", ".join(row["figures"])
        cells = [row[name] for name in ("id", "says", "place", "verdict")]
        cells += [figure, row["uses"], row["notebooks"], f"`{row['file']}` {tests}"]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
    lines += [
        f"| {id} | {says} | {place} | not checkable: {why} | | | | |\n"
        for id, says, place, why in NOT_CHECKABLE
    ]
    return HEADER + "".join(sorted(lines, key=lambda line: position(line.split(" | ")[0][2:])))


def concordance(rows):
    """For each numbered place of the paper: what computes it, the notebooks with a heading on it,
    and its claims.
    """
    text = "| | functions | notebooks | claims |\n|---|---|---|---|\n"
    for marker, place in PLACES.items():
        here = [row for row in rows if marker in markers(row["place"])]
        uses = dict.fromkeys(name for row in here for name in row["uses"].split(", ") if name)
        headings = [
            (name, title)
            for name in NOTEBOOKS
            for title in re.findall(r"^##+ (.*)", NOTEBOOKS[name], re.M)
        ]
        shown = [link(name, f" {title}") for name, title in headings if marker in markers(title)]
        text += (
            f"| {place} | {', '.join(uses)} | {'<br>'.join(shown)} |"
            f" {', '.join(row['id'] for row in here)} |\n"
        )
    return text


@cache
def committed():
    """{id: row} of ledger.json."""
    return {row["id"]: row for row in json.loads(ROWS.read_text(encoding="utf-8"))}


def write(path, rows):
    """Write ledger and concordance to a file, or into their places in README.md, and the rows to
    ledger.json beside it.
    """
    path = Path(path)
    page = path.read_text(encoding="utf-8") if path.exists() else ""
    if BEGIN not in page:
        page = f"{BEGIN}\n{END}\n\n{PLACES_BEGIN}\n{PLACES_END}\n"
    for begin, end, text in (
        (BEGIN, END, table(rows)),
        (PLACES_BEGIN, PLACES_END, concordance(rows)),
    ):
        page = f"{page.split(begin)[0]}{begin}\n\n{text}\n{end}{page.split(end)[1]}"
    path.write_text(page, encoding="utf-8")
    content = json.dumps(rows, indent=1, ensure_ascii=False)
    path.with_name("ledger.json").write_text(content + "\n", encoding="utf-8")

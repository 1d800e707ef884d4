"""The ledger: what the paper claims (claims/*.toml), and which checks decide each claim.

A test is marked with the id of its claim and shows the figure that decides it. ledger.json holds
the claims with their figures and checks; page.py writes it, and README.md from it.
"""

import importlib
import re
import string
import tomllib
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from gbdqn_ref.files import read_json

HERE = Path(__file__).parent
LEDGER = HERE / "ledger.json"
VERDICTS = {  # and what each means
    "holds": "as the paper states it",
    "holds with an assumption": "that the paper does not state; it is named",
    "fails": "as we read it; the smallest counterexample is shown",
    "misprint": "what is meant is clear",
    "ambiguous": "the paper says two things, or leaves open what decides",
    "inference": "drawn by us; the paper does not say it",
    "conceded": "by the paper itself",
    "not checkable": "here",
}
UNCHECKED = ("conceded", "not checkable")  # verdicts that need no test
FIELDS = {  # of a claim, and what the page calls them
    "place": "Place",
    "claim": "Claim",
    "verdict": "Verdict",
    "reading": "Our reading",
    "decides": "Why",
    "assumption": "Missing assumption",
    "charitable": "The most charitable reading",
    "charitable_verdict": "Its verdict",
    "counterexample": "Smallest counterexample",
    "mend": "What would be true",
    "proof": "Proof",
    "kin": "Kin",
    "extent": "How far",
    "uses": "Functions",
}
PLACES = {f"eq{n}": f"Eq. {n}" for n in range(1, 12)} | {
    f"theorem{n}": f"Theorem {n}" for n in range(1, 5)
}
PLACES["algorithm1"] = "Algorithm 1"
SECTIONS = (  # the headings of the paper that places name
    "Abstract",
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
    for path in sorted(HERE.parent.glob("notebooks/[0-9]*.py"))
}
GROUPS = ("M", "R", "W", "P", "A", "T1", "B", "T2", "T3", "T4", "C", "X", "K")
KINDS = ("claim", "proof", "control")  # of a check
GLYPHS = {"1/2": "½", "1/4": "¼", "3/4": "¾"}
LETTERS = "".join(group for group in GROUPS if len(group) == 1)
ID = re.compile(rf"\b(?:T\d-[a-z]|[{LETTERS}]\d+)\b")
CHECKS = {}  # (id, kind, file, test): Check, filled by the marks
current = None  # the test that runs, set by conftest


class Check(NamedTuple):
    """A test of a claim: of kind "claim", "control" or "proof", and how far it reaches."""

    id: str
    kind: str
    file: str
    test: str
    extent: str = ""


# The claims


def position(id):
    """Where a claim stands in the ledger: ("T1-b" is the second of group T1).

    >>> sorted(["T1-b", "M10", "X1", "M9", "T1-a"], key=position)
    ['M9', 'M10', 'T1-a', 'T1-b', 'X1']
    """
    group, number = re.fullmatch(r"(T\d|[A-Z])-?(\w+)", id).groups()
    return GROUPS.index(group), int(number) if number.isdigit() else ord(number)


def tables(path):
    """What a TOML file holds, with line breaks inside a text as spaces."""

    def folded(value):
        if isinstance(value, dict):
            return {name: folded(each) for name, each in value.items()}
        if isinstance(value, list):
            return [folded(each) for each in value]
        return " ".join(value.split()) if isinstance(value, str) else value

    return folded(tomllib.loads(path.read_text(encoding="utf-8")))


FILES = [path for path in sorted(HERE.glob("claims/*.toml")) if path.stem != "coverage"]
CLAIMS = {
    id: claim
    for _, id, claim in sorted(
        (position(id), id, claim) for path in FILES for id, claim in tables(path).items()
    )
}
COVERAGE = tables(HERE / "claims/coverage.toml")["paragraph"]


# The marks


def claim(id):
    """Mark a test that decides a claim. It gets the markers of the claim's place: theorem1 from
    "Theorem 1", eq8 from "Eq. 8", algorithm1 from "Algorithm 1". It calls shows() with the figure
    that decides. One example, one test: a claim may have several.
    """
    marks = [pytest.mark.claim(id)]
    marks += [getattr(pytest.mark, name) for name in markers(CLAIMS[id]["place"])]

    def decorate(test):
        sampled = getattr(test, "is_hypothesis_test", False)
        _note("claim", test, [id], "sampled by Hypothesis" if sampled else "decided by examples")
        for mark in marks:
            test = mark(test)
        return test

    return decorate


def control(*ids):
    """Mark a test as the negative control of claims: with one term or assumption taken away, the
    outcome differs.
    """

    def decorate(test):
        _note("control", test, ids)
        return pytest.mark.control(*ids)(test)

    return decorate


def proves(*ids, size, without):
    """Mark a test as a proof of what claims say, by a solver, for every instance of this size.

    Its second half is the negative control: `without` one assumption, or with one term changed, the
    solver finds a counterexample, which exact fractions confirm.
    """

    def decorate(test):
        _note("proof", test, ids, f"proved for {size} (and not without {without})")
        return test

    return decorate


def _note(kind, test, ids, extent=""):
    file, name = f"{test.__module__}.py", test.__name__.removeprefix("test_")
    for id in ids:
        CHECKS[id, kind, file, name] = Check(id, kind, file, name, extent)


def shows(template, *values):
    """Take down a figure that decides the claim of the running test, formatted from the values that
    the test asserted; ledger.json must have the same.
    """
    id = current.get_closest_marker("claim").args[0]
    test, figure = current.originalname.removeprefix("test_"), Figure().format(template, *values)
    current.user_properties.append(("figure", (id, test, figure)))
    if not current.config.getoption("--ledger"):
        known = committed().get(id, {"figures": {}})["figures"].get(test)
        assert known == figure, "ledger.json has another figure; write it with --ledger"


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


# What places and notebooks say


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
    """The claims that a notebook's Markdown cells cite.

    >>> sorted(cited("%% [markdown]\\nfalls (T1-a, M3), not `M4` or $B2$ (D5)\\n%%\\nC1 = 0"))
    ['M3', 'T1-a']
    """
    cells = re.split(r"^(?:# )?%%", text, flags=re.M)
    prose = " ".join(cell for cell in cells if cell.startswith(" [markdown]"))
    prose = re.sub(r"`[^`]*`|\$[^$]*\$", "", prose)
    return set(ID.findall(prose))


CITED = {name: cited(text) for name, text in NOTEBOOKS.items()}


# The rows


def checks():
    """Every mark of every test file; those that pytest has not collected are imported."""
    for path in sorted(HERE.glob("test_*.py")):
        if path.stem != "test_ledger":
            importlib.import_module(path.stem)
    return sorted(CHECKS.values(), key=lambda check: check.file)


def rows(figures):
    """What ledger.json holds of every claim, given its figures as {id: {test: figure}}."""
    found = checks()
    return [_row(id, [check for check in found if check.id == id], figures) for id in CLAIMS]


def _row(id, checks, figures):
    kinds = {kind: [each for each in checks if each.kind == kind] for kind in KINDS}
    names = {kind: [f"{each.file}::{each.test}" for each in kinds[kind]] for kind in KINDS}
    extents = [each.extent for each in kinds["proof"]]
    extents += sorted({each.extent for each in kinds["claim"]}, reverse=True)
    known = figures.get(id, {})
    return {
        "id": id,
        **CLAIMS[id],
        "extents": extents,
        "figures": {each.test: known[each.test] for each in kinds["claim"] if each.test in known},
        "checks": names["claim"],
        "proofs": names["proof"],
        "controls": names["control"],
        "notebooks": [name for name in NOTEBOOKS if id in CITED[name]],
    }


@cache
def committed():
    """{id: row} of ledger.json."""
    content = read_json(LEDGER, claims=[{"id": (str,), "figures": (dict,)}])
    return {row["id"]: row for row in content["claims"]}

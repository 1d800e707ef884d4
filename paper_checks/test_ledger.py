"""The ledger itself: every claim has a check and a negative control, the page is what claims and
figures give, and both name only what exists.
"""

import ast
import importlib
import json
import re

import ledger
import page
import pytest

from gbdqn_ref import UsageError

IDS = list(ledger.CLAIMS)
ROWS = ledger.rows({id: row["figures"] for id, row in ledger.committed().items()})
CONTENT = {"claims": ROWS, "coverage": ledger.COVERAGE}
PAGE = page.PAGE.read_text(encoding="utf-8")
NAMED = {  # verdict: the field that it asks for
    "holds with an assumption": "assumption",
    "fails": "counterexample",
    "not checkable": "decides",
    "conceded": "decides",
}
MENDED = ("fails", "ambiguous", "misprint")


def test_the_committed_ledger_is_what_claims_and_checks_give():
    """All but the figures, which each test compares."""
    content = json.loads(ledger.LEDGER.read_text(encoding="utf-8"))
    assert content == CONTENT


def test_the_page_is_what_the_ledger_gives():
    """Count, table, sections, concordance and coverage."""
    assert page.renewed(PAGE, page.blocks(CONTENT)) == PAGE


@pytest.mark.parametrize(
    "text",
    ["", "<!-- a -->", "<!-- /a --> <!-- a -->", "<!-- a --> <!-- /a --> <!-- /a -->"]
    + ["`<!-- a -->` and <!-- a --> <!-- /a -->"],
)
def test_a_page_whose_marks_are_not_a_pair_is_left_alone(text):
    with pytest.raises(UsageError, match="each once"):
        page.renewed(text, {"a": "new"})


def test_every_id_is_used_once():
    """A second table of the same id, in another file, would hide the first."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in ledger.FILES)
    assert sorted(re.findall(r"^\[([^\[\]]+)\]$", text, re.M)) == sorted(IDS)


@pytest.mark.parametrize("row", ROWS, ids=IDS)
def test_a_claim_has_the_fields_that_its_verdict_asks_for(row):
    """And no field that the page does not print."""
    claim = ledger.CLAIMS[row["id"]]
    assert claim.keys() <= ledger.FIELDS.keys() and {"place", "claim", "verdict"} <= claim.keys()
    assert claim["verdict"] in ledger.VERDICTS
    assert claim.get("charitable_verdict", "holds") in ledger.VERDICTS
    assert ("charitable" in claim) == ("charitable_verdict" in claim)
    assert claim.get(NAMED.get(claim["verdict"], "claim"))
    assert claim.get("mend") or claim["verdict"] not in MENDED


@pytest.mark.parametrize("row", ROWS, ids=IDS)
def test_a_claim_has_a_check_with_a_figure_and_a_negative_control(row):
    """Each of its checks shows a figure, and only an unchecked claim has none."""
    assert list(row["figures"]) == [check.split("::")[1] for check in row["checks"]]
    if row["verdict"] not in ledger.UNCHECKED:
        assert row["checks"] and row["controls"]


@pytest.mark.parametrize("row", ROWS, ids=IDS)
def test_every_figure_that_a_text_names_is_there(row):
    """A {name_of_a_test} that is none would be printed as it stands."""
    texts = " ".join(str(value) for value in ledger.CLAIMS[row["id"]].values())
    assert set(re.findall(r"{([a-z]\w+_\w+)}", texts)) <= row["figures"].keys()


def test_every_mark_names_a_claim():
    """Also those of controls and proofs; at least twenty claims are proved."""
    found = ledger.checks()
    assert {check.id for check in found} <= ledger.CLAIMS.keys()
    assert len({check.id for check in found if check.kind == "proof"}) >= 20


# The figures


def shown():
    """(file and line, (template, its values)) of every figure."""
    for path in sorted(ledger.HERE.glob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "shows":
                template, *values = node.args
                starred = [each.value for each in values if isinstance(each, ast.Starred)]
                values += [each for part in starred for each in getattr(part, "elts", ())]
                yield f"{path.name}:{node.lineno}", (template, values)


FIGURES = dict(shown())


@pytest.mark.parametrize(("template", "values"), FIGURES.values(), ids=FIGURES)
def test_no_figure_is_typed(template, values):
    """A template has no decimals, no number of two digits, and after = and → at most a 0 or 1 that
    states a condition; no value is a literal.
    """
    words = re.sub(r"{[^{}]*}", "", template.value.replace("{{", "").replace("}}", ""))
    assert not re.search(r"\d[.,]?\d|[=→] \(?[−±]?[2-9½¼¾](?![\w/])", words)
    assert not any(isinstance(value, ast.Constant) for value in values)


# What the ledger names


@pytest.mark.parametrize("row", ROWS, ids=IDS)
def test_every_function_that_is_named_exists(row):
    """In the package, under that name."""
    for name in row.get("uses", []):
        module, _, path = name.partition(".")
        thing = importlib.import_module(f"gbdqn_ref.{module}")
        for part in path.split("."):
            thing = getattr(thing, part)


@pytest.mark.parametrize("notebook", ledger.NOTEBOOKS)
def test_every_claim_that_a_notebook_cites_is_in_the_ledger(notebook):
    assert ledger.CITED[notebook] <= ledger.CLAIMS.keys()


def test_every_link_within_the_page_has_its_anchor():
    anchors = re.findall(r'<a id="([^"]+)"></a>', PAGE)
    deviations = re.findall(r"^\| (D\d+) \|", PAGE, re.M)
    assert sorted(anchors) == sorted(id.lower() for id in IDS + deviations)
    assert set(re.findall(r"\]\(#([\w-]+)\)", PAGE)) <= set(anchors)


@pytest.mark.parametrize("marker", ledger.PLACES)
def test_every_numbered_place_has_a_claim_a_function_and_a_notebook(marker):
    """No cell of the concordance is empty."""
    lines = page.concordance(ROWS).splitlines()
    row = next(line for line in lines if line.startswith(f"| {ledger.PLACES[marker]} |"))
    assert all(cell.strip() for cell in row.split("|")[1:-1])


def test_every_line_of_algorithm_1_is_in_the_notebook_on_it():
    """That each is found in the code is asserted where its table is made."""
    table = (ledger.HERE.parent / "notebooks/pictures/algorithm.py").read_text(encoding="utf-8")
    lines = re.search(r"^LINES = (\(.*?^\))", table, re.M | re.S)[1]
    printed = ",".join(re.findall(r'\(\s*"([\d–, ]+)",', lines)).split(",")
    spans = [[int(number) for number in part.split("–")] for part in printed]
    assert sorted(n for span in spans for n in range(span[0], span[-1] + 1)) == list(range(1, 30))


def test_every_section_that_is_named_is_one_of_the_paper():
    """By its heading."""
    for claim in ledger.CLAIMS.values():
        for name in re.findall(r"section (.+?)(?:, |$)", claim["place"]):
            assert re.sub(r" Algorithm 1.*", "", name) in ledger.SECTIONS, claim["place"]


def test_the_places_give_the_markers():
    """A range of equations gives a marker for each."""
    assert ledger.markers("Theorem 3 and Eqs. 10–11") == ["theorem3", "eq10", "eq11"]
    assert ledger.markers("Algorithm 1, line 17") == ["algorithm1"]


# The paper, paragraph by paragraph


def test_every_paragraph_has_claims_or_a_reason_and_every_claim_a_paragraph():
    """Sections in the paper's order, and paragraphs counted without a gap."""
    expected = 0, 1
    for each in ledger.COVERAGE:
        assert bool(each.get("ids")) != bool(each.get("none")), each
        assert len(each["begins"].split()) <= 8
        section, number = ledger.SECTIONS.index(each["section"]), each["number"]
        assert (section, number) in (expected, (expected[0] + 1, 1)), each
        expected = section, number + 1
    assert {id for each in ledger.COVERAGE for id in each.get("ids", [])} == set(IDS)
    assert {each["section"] for each in ledger.COVERAGE} == set(ledger.SECTIONS)


# How it is written


def test_a_page_is_written_into_its_place_and_read_again(tmp_path, monkeypatch):
    """The text around it stays, what a run has shown replaces what was there, the rest is kept, and
    a bar in a cell is escaped.
    """
    monkeypatch.setattr(page, "PAGE", tmp_path / "README.md")
    monkeypatch.setattr(ledger, "LEDGER", tmp_path / "ledger.json")
    monkeypatch.setattr(ledger, "committed", lambda: {row["id"]: row for row in ROWS})
    places = "".join(f"<!-- {each} -->\nold\n<!-- /{each} -->\n" for each in page.blocks(CONTENT))
    page.PAGE.write_text(f"before\n{places}after\n")
    test = next(iter(ROWS[0]["figures"]))
    page.write({IDS[0]: {test: "new"}})
    first, *others = json.loads(ledger.LEDGER.read_text())["claims"]
    assert first["figures"][test] == "new" and others == ROWS[1:]
    text = page.PAGE.read_text()
    assert text.startswith("before\n") and text.endswith("\nafter\n") and "\nold\n" not in text
    assert "\\|δ\\|" in text and text.count("\n| [") == len(ROWS)

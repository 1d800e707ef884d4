"""The ledger itself: every claim has one check and a negative control, and names only what
exists.
"""

import ast
import importlib
import re
from pathlib import Path

import ledger
import pytest

FILES = sorted(Path(__file__).parent.glob("test_*.py"))
ROWS, MISSING = ledger.committed(), {id for id, *_ in ledger.NOT_CHECKABLE}
CONCORDANCE = (
    ledger.README.read_text(encoding="utf-8")
    .split(ledger.PLACES_BEGIN)[1]
    .split(ledger.PLACES_END)[0]
)


def decorators(name):
    """(file, function, arguments) of every decorator of this name in the checks."""
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for call in getattr(node, "decorator_list", []):
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") == name:
                    arguments = call.args + [keyword.value for keyword in call.keywords]
                    yield (
                        path.name,
                        node.name,
                        [ast.literal_eval(argument) for argument in arguments],
                    )


CLAIMS, CONTROLS = list(decorators("claim")), list(decorators("control"))
TESTS = CLAIMS + list(decorators("also"))


def test_the_committed_ledger_has_the_claims_of_the_checks_and_no_others():
    """Each of them once."""
    assert sorted(arguments[0] for _, _, arguments in CLAIMS) == sorted(ROWS)


def test_the_page_has_the_table_that_the_rows_give():
    """README.md shows what ledger.json holds."""
    page = ledger.README.read_text(encoding="utf-8")
    assert page.split(ledger.BEGIN)[1].split(ledger.END)[0].strip() == (
        ledger.table(ROWS.values()).strip()
    )


@pytest.mark.parametrize("id", ROWS)
def test_a_row_has_the_figures_of_all_its_tests(id):
    """Of each test that is marked with its id, and of no other."""
    tests = {(path, name.removeprefix("test_")) for path, name, ids in TESTS if ids[0] == id}
    assert tests == {(ROWS[id]["file"], test) for test in ROWS[id]["figures"]}


def shown():
    """(file and line, (template, its values)) of every figure."""
    for path in FILES:
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


def test_every_claim_has_a_negative_control():
    """At least one test is marked as the control of each id."""
    controlled = {id for _, _, ids in CONTROLS for id in ids}
    assert {arguments[0] for _, _, arguments in CLAIMS} == controlled


@pytest.mark.parametrize("id", ROWS)
def test_every_function_that_is_named_exists(id):
    """In the package, under that name."""
    for name in filter(None, ROWS[id]["uses"].split(", ")):
        module, _, path = name.partition(".")
        thing = importlib.import_module(f"gbdqn_ref.{module}")
        for part in path.split("."):
            thing = getattr(thing, part)


@pytest.mark.parametrize("notebook", ledger.NOTEBOOKS)
def test_every_claim_that_a_notebook_cites_is_in_the_ledger(notebook):
    """With a check, or as not checkable."""
    assert ledger.cited(ledger.NOTEBOOKS[notebook]) <= ROWS.keys() | MISSING


def test_every_claim_is_cited_in_a_notebook():
    """No check is without a place where it is explained."""
    shown = set().union(*map(ledger.cited, ledger.NOTEBOOKS.values()))
    assert {arguments[0] for _, _, arguments in CLAIMS} <= shown


@pytest.mark.parametrize("marker", ledger.PLACES)
def test_every_numbered_place_has_a_claim_a_function_and_a_notebook(marker):
    """No cell of the concordance is empty."""
    row = next(
        line for line in CONCORDANCE.splitlines() if line.startswith(f"| {ledger.PLACES[marker]} |")
    )
    assert all(cell.strip() for cell in row.split("|")[1:-1])


def test_every_line_of_algorithm_1_is_in_the_notebook_on_it():
    """That each is found in the code is asserted there."""
    lines = re.search(r"^LINES = (\(.*?^\))", ledger.NOTEBOOKS["06_algorithm"], re.M | re.S)[1]
    printed = ",".join(re.findall(r'\(\s*"([\d–, ]+)",', lines)).split(",")
    spans = [[int(number) for number in part.split("–")] for part in printed]
    assert sorted(n for span in spans for n in range(span[0], span[-1] + 1)) == list(range(1, 30))


def test_the_committed_concordance_is_that_of_ledger_and_notebooks():
    """README.md shows what rows and headings give."""
    assert CONCORDANCE.strip() == ledger.concordance(ROWS.values()).strip()


def test_every_section_that_is_named_is_one_of_the_paper():
    """By its heading."""
    places = [row["place"] for row in ROWS.values()]
    for place in places + [place for _, _, place, _ in ledger.NOT_CHECKABLE]:
        for name in re.findall(r"section (.+?)(?:, |$)", place):
            assert re.sub(r" Algorithm 1.*", "", name) in ledger.SECTIONS, place


def test_the_places_give_the_markers():
    """A range of equations gives a marker for each."""
    assert ledger.markers("Theorem 3 and Eqs. 10–11") == ["theorem3", "eq10", "eq11"]
    assert ledger.markers("Algorithm 1, line 17") == ["algorithm1"]


def test_a_row_is_written_into_its_place_and_read_again(tmp_path, monkeypatch):
    """The text around it stays, and a bar in a cell is escaped."""
    fields = ("place", "says", "verdict", "uses", "notebooks", "file")
    row = dict.fromkeys(fields, "x") | {"id": "M1", "figures": {"a_test": "|1 − α| ≤ 1"}}
    page = tmp_path / "README.md"
    places = f"{ledger.PLACES_BEGIN}\nold\n{ledger.PLACES_END}"
    page.write_text(f"before\n{ledger.BEGIN}\nold\n{ledger.END}\n{places}\nafter\n")
    monkeypatch.setattr(ledger, "ROWS", tmp_path / "ledger.json")
    monkeypatch.setattr(ledger, "NOT_CHECKABLE", ())
    ledger.write(page, [row])
    assert ledger.committed.__wrapped__() == {"M1": row}
    assert page.read_text().startswith("before\n") and page.read_text().endswith("\nafter\n")
    assert "| \\|1 − α\\| ≤ 1 |" in page.read_text() and "\nold\n" not in page.read_text()


def test_a_claim_has_the_figures_of_all_its_tests():
    """In the order in which they ran."""
    rows = ledger.joined([{"id": "M1", "figures": {name: name}} for name in "ab"])
    assert rows == [{"id": "M1", "figures": {"a": "a", "b": "b"}}]

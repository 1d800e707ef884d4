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
ROWS = ledger.committed()
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


def test_the_committed_ledger_has_the_claims_of_the_checks_and_no_others():
    ids = [arguments[0] for _, _, arguments in CLAIMS] + [row[0] for row in ledger.NOT_CHECKABLE]
    assert sorted(ids) == sorted(ROWS)


def test_every_claim_has_a_negative_control():
    controlled = {id for _, _, ids in CONTROLS for id in ids}
    assert {arguments[0] for _, _, arguments in CLAIMS} == controlled


@pytest.mark.parametrize("id", ROWS)
def test_every_function_and_check_that_is_named_exists(id):
    row = ROWS[id]
    if row["verdict"].startswith("not checkable: "):
        return
    for name in filter(None, row["uses"].split(", ")):
        module, _, path = name.partition(".")
        thing = importlib.import_module(f"gbdqn_ref.{module}")
        for part in path.split("."):
            thing = getattr(thing, part)
    file, _, test = row["check"].replace("`", "").partition(" ")
    assert (file, f"test_{test}") in {(path, function) for path, function, _ in CLAIMS}


@pytest.mark.parametrize("notebook", ledger.NOTEBOOKS)
def test_every_claim_that_a_notebook_cites_is_in_the_ledger(notebook):
    assert ledger.cited(ledger.NOTEBOOKS[notebook]) <= ROWS.keys()


def test_every_claim_is_cited_in_a_notebook():
    shown = set().union(*map(ledger.cited, ledger.NOTEBOOKS.values()))
    assert {arguments[0] for _, _, arguments in CLAIMS} <= shown


@pytest.mark.parametrize("marker", ledger.PLACES)
def test_every_numbered_place_has_a_claim_a_function_and_a_notebook(marker):
    row = next(
        line for line in CONCORDANCE.splitlines() if line.startswith(f"| {ledger.PLACES[marker]} |")
    )
    assert all(cell.strip() for cell in row.split("|")[1:-1])


def test_every_line_of_algorithm_1_is_in_the_notebook_on_it():
    """That each is found in the code is asserted there."""
    lines = re.search(r"^LINES = (\(.*?^\))", ledger.NOTEBOOKS["06_algorithm"], re.M | re.S)[1]
    printed = ",".join(re.findall(r'^ +\("([\d–, ]+)",', lines, re.M)).split(",")
    spans = [[int(number) for number in part.split("–")] for part in printed]
    assert sorted(n for span in spans for n in range(span[0], span[-1] + 1)) == list(range(1, 30))


def test_the_committed_concordance_is_that_of_ledger_and_notebooks():
    assert CONCORDANCE.strip() == ledger.concordance(ROWS.values()).strip()


def test_every_section_that_is_named_is_one_of_the_paper():
    for row in ROWS.values():
        for name in re.findall(r"section (.+?)(?:, |$)", row["place"]):
            assert re.sub(r" Algorithm 1.*", "", name) in ledger.SECTIONS, row["place"]


def test_the_places_give_the_markers():
    assert ledger.markers("Theorem 3 and Eqs. 10–11") == ["theorem3", "eq10", "eq11"]
    assert ledger.markers("Algorithm 1, line 17") == ["algorithm1"]


def test_a_row_survives_being_written_and_read(tmp_path, monkeypatch):
    row = dict.fromkeys(ledger.FIELDS, "x") | {"id": "M1", "figure": "|1 − α| ≤ 1"}
    page = tmp_path / "README.md"
    places = f"{ledger.PLACES_BEGIN}\nold\n{ledger.PLACES_END}"
    page.write_text(f"before\n{ledger.BEGIN}\nold\n{ledger.END}\n{places}\nafter\n")
    monkeypatch.setattr(ledger, "README", page)
    monkeypatch.setattr(ledger, "NOT_CHECKABLE", ())
    ledger.write(page, [row])
    assert ledger.committed() == {"M1": row}
    assert page.read_text().startswith("before\n") and page.read_text().endswith("\nafter\n")

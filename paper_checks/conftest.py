"""Markers by theorem and equation, and the ledger at the end of a run."""

import ledger
import page

FIGURES = {}  # id: {test: figure} of the tests that ran, in whichever process


def pytest_addoption(parser):
    parser.addoption(
        "--ledger",
        action="store_true",
        help="write ledger.json with the figures of this run, and the pages",
    )


def pytest_configure(config):
    for name in ledger.PLACES:
        config.addinivalue_line("markers", f"{name}: claims of this part of the paper")
    config.addinivalue_line("markers", "claim(id): a check that decides a claim")
    config.addinivalue_line("markers", "control(*ids): the negative control of claims")


def pytest_ignore_collect(collection_path, config):
    """The checks of the committed page wait while --ledger writes it."""
    return (
        True if config.getoption("--ledger") and collection_path.name == "test_ledger.py" else None
    )


def pytest_runtest_setup(item):
    ledger.current = item


def pytest_runtest_logreport(report):
    for name, value in report.user_properties:
        if name == "figure":
            id, test, figure = value
            FIGURES.setdefault(id, {})[test] = figure


def pytest_terminal_summary(terminalreporter, config):
    if FIGURES:
        terminalreporter.section("the ledger: is the paper right?")
    for id in sorted(FIGURES, key=ledger.position):
        claim, figures = ledger.CLAIMS[id], "; ".join(FIGURES[id].values())
        terminalreporter.write_line(
            f"{id:5} {claim['place']:24} {claim['verdict']}\n{'':30} {figures}"
        )
    if FIGURES and config.getoption("--ledger"):
        page.write(FIGURES)
        terminalreporter.write_line(f"written to {page.PAGE}")

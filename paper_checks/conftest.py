"""Markers by theorem and equation, and the ledger at the end of a run."""

import ledger


def pytest_addoption(parser):
    parser.addoption(
        "--ledger",
        metavar="FILE",
        help="write the ledger as Markdown to FILE, and as JSON beside it",
    )


def pytest_configure(config):
    for name in ledger.PLACES:
        config.addinivalue_line("markers", f"{name}: claims of this part of the paper")
    config.addinivalue_line(
        "markers", "claim(id, place, says, verdict, uses): a check that decides a claim"
    )
    config.addinivalue_line("markers", "control(*ids): the negative control of claims")


def pytest_ignore_collect(collection_path, config):
    """The checks of the committed page wait while --ledger writes it."""
    return (
        True if config.getoption("--ledger") and collection_path.name == "test_ledger.py" else None
    )


def pytest_runtest_setup(item):
    ledger.current = item


def pytest_terminal_summary(terminalreporter, config):
    reports = [report for reports in terminalreporter.stats.values() for report in reports]
    found = [
        row
        for report in reports
        for name, row in getattr(report, "user_properties", ())
        if name == "claim"
    ]
    rows = ledger.joined(found)
    if rows:
        terminalreporter.section("the ledger: is the paper right?")
    for row in rows:
        terminalreporter.write_line(
            f"{row['id']:5} {row['place']:24} {row['verdict']}\n{'':30} "
            + "; ".join(row["figures"].values())
        )
    if rows and (path := config.getoption("--ledger")):
        ledger.write(path, rows)
        terminalreporter.write_line(f"written to {path}")

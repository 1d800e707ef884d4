"""Hypothesis profiles: HYPOTHESIS_PROFILE=ci is reproducible, =deep takes a night."""

import os

import pytest
from hypothesis import settings

pytest.register_assert_rewrite("helpers")  # its assertions show their values, as in a test

settings.register_profile("dev", max_examples=50, deadline=None, print_blob=True)
settings.register_profile("ci", max_examples=100, deadline=None, print_blob=True, derandomize=True)
settings.register_profile("deep", max_examples=1000, deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dev"))


def pytest_configure(config):
    config.addinivalue_line("markers", "browser: opens the site in a browser")


def pytest_collection_modifyitems(items):
    for item in items:
        if {"browser", "chromium"} & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.browser)


def pytest_terminal_summary(terminalreporter):
    """How many tests of the site ran in a browser."""
    counts = {
        kind: sum("browser" in report.keywords for report in terminalreporter.stats.get(kind, []))
        for kind in ("passed", "failed", "skipped")
    }
    if any(counts.values()):
        told = ", ".join(f"{count} {kind}" for kind, count in counts.items())
        terminalreporter.write_line(f"browser tests: {told}")

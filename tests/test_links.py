"""Every link from one page of the repository to another leads to a file and an anchor in it."""

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDERS = ".", "docs", "notebooks", "paper_checks/**", "benchmarks/**", "site"
PAGES = sorted({path for folder in FOLDERS for path in ROOT.glob(f"{folder}/*.md")})
ELSEWHERE = {  # a text that another folder's page takes in; the site's stand for the root's
    ROOT / "benchmarks/keep/conclusions.md": ROOT / "paper_checks/results/keep",
    ROOT / "benchmarks/keep/exploratory.md": ROOT / "paper_checks/results/keep/settings",
    ROOT / "benchmarks/keep/decision.md": ROOT / "docs",
    **dict.fromkeys(ROOT.glob("site/*.md"), ROOT),
}
MADE = {ROOT / name for name in ("algorithm.md", "answer.svg", "api/index.md")}  # by the site


def links(path):
    """(the file, the anchor or "") of each link to a file of the repository."""
    folder = ELSEWHERE.get(path, path.parent)
    for link in re.findall(r"\]\(([^()\s]+)\)", path.read_text(encoding="utf-8")):
        if not re.match(r"https?:", link) and "issues/new" not in link:
            name, _, anchor = link.partition("#")
            yield (folder / name).resolve() if name else path, anchor


@cache
def anchors(path):
    """The anchors of a page: those that it writes, and those that GitHub gives to its headings."""
    text = path.read_text(encoding="utf-8")
    titles = re.findall(r"^#+ (.+)$", text, re.M)
    made = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
    return made.union(re.findall(r'<a id="([^"]+)"', text))


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_link_is_dead(path):
    for target, anchor in links(path):
        assert target.exists() or target in MADE, target
        assert not anchor or anchor in anchors(target), (target, anchor)

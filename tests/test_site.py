"""The site builds without a warning, and its links, folds and pages are all there.

Sphinx does not warn of a link that is silently lost, so links are counted. Tests with the mark
`browser` open the pages in the system's Chromium, from the disk.
"""

import ast
import doctest
import importlib.util
import json
import posixpath
import re
import subprocess
import sys
import tomllib
from collections import Counter
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from helpers import CHROMIUM

ROOT = Path(__file__).parent.parent
SITE = ROOT / "site"
HTML = SITE / "_build/html"
EXTRA = ("sphinx", "furo", "myst_nb", "sphinx_copybutton", "sphinx-mathjax-offline")
MISSING = [name for name in EXTRA if importlib.util.find_spec(name) is None]
pytestmark = pytest.mark.skipif(bool(MISSING), reason="without the extra site: make test-site")
CLAIM = re.compile(r"\b(?:T[1-4]-[a-z]|[MRWPABCXK]\d{1,2})\b")


@pytest.fixture(scope="module", autouse=True)
def site():
    """The site, built anew."""
    build = [sys.executable, str(SITE / "build.py")]
    result = subprocess.run(build, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout == f"open {HTML / 'index.html'}\n"


class Page(HTMLParser):
    """A page's ids, its links as [address, text], the text of its article outside of links,
    headings, code, formulas, live figures and scripts, and the code in that text.
    """

    STILL = {
        "a",
        "h1",
        "h2",
        "h3",
        "h4",
        "title",
        "code",
        "pre",
        "script",
        "style",
        "option",
        "dt",
        "figure",
    }

    def __init__(self, text):
        super().__init__()
        self.ids, self.links, self.loaded, self.classes = set(), [], [], Counter()
        self.free, self.code, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        found = {name: value or "" for name, value in attributes}
        self.ids.add(found.get("id"))
        self.classes.update(found.get("class", "").split())
        if tag == "a" and "href" in found:
            self.links.append([found["href"], ""])
        self.code += [""] * (tag == "code")
        self.loaded += [found[name] for name in ("src", "data") if name in found]
        self.loaded += [found["href"]] if tag == "link" and "href" in found else []
        if tag not in ("br", "img", "hr", "meta", "link", "input", "wbr", "path", "use", "source"):
            still = tag in self.STILL or "math" in found.get("class", "").split()
            self.open.append((tag, still))

    def handle_endtag(self, tag):
        while self.open and self.open.pop()[0] != tag:
            pass

    def handle_data(self, data):
        tags = [tag for tag, _ in self.open]
        if "a" in tags and self.links:
            self.links[-1][1] += data
        if "article" in tags and not any(still for _, still in self.open):
            self.free.append(data)
        if {"article", "code"} <= {*tags} and not {"a", "pre", "h1", "h2", "h3", "dt"} & {*tags}:
            self.code[-1] += data


@cache
def page(name):
    return Page((HTML / name).read_text(encoding="utf-8"))


@cache
def names():
    """Every page but the source's, by its name."""
    found = (path.relative_to(HTML).as_posix() for path in HTML.rglob("*.html"))
    return sorted(name for name in found if not name.startswith("source/"))


def ledger():
    return json.loads((ROOT / "paper_checks/ledger.json").read_text(encoding="utf-8"))["claims"]


def led(start, target):
    """How many links of the pages whose names begin with `start` lead to each anchor of a page."""
    found = Counter()
    for name in names():
        for link, _ in page(name).links if name.startswith(start) else ():
            file, _, anchor = link.partition("#")
            if posixpath.normpath(posixpath.join(posixpath.dirname(name), file or name)) == target:
                found[anchor] += 1
    return found


# What there is


@pytest.mark.parametrize("module", ["places", "checked", "course", "links", "answer"])
def test_the_examples_of_the_sites_modules(module, monkeypatch):
    monkeypatch.syspath_prepend(str(SITE))
    monkeypatch.syspath_prepend(str(ROOT / "paper_checks"))
    result = doctest.testmod(importlib.import_module(module))
    assert result.attempted > 0 and result.failed == 0


def test_the_sidebar_has_every_page():
    listed = {link.partition("#")[0] for link, _ in page("index.html").links}
    others = {"genindex.html", "py-modindex.html", "search.html"}
    assert set(names()) - others <= listed | {"index.html"}


def test_every_claim_has_its_section_with_verdict_and_extent():
    rows = ledger()
    found = page("ledger.html")
    assert {row["id"].lower() for row in rows} <= found.ids
    count = Counter(row["verdict"].replace(" ", "-") for row in rows)
    for verdict, times in count.items():
        assert found.classes[verdict] == times + 1, verdict  # and once in the count of all
    assert found.classes["far"] == len(rows)


def test_every_check_of_a_claim_leads_to_its_source():
    checks = [
        check
        for row in ledger()
        for kind in ("checks", "proofs", "controls")
        for check in row[kind]
    ]
    links = [link for link, text in page("ledger.html").links if "::" in text]
    assert len(links) == len(checks) > 300
    assert all(re.fullmatch(r"source/paper_checks/test_\w+\.html#L\d+", link) for link in links)


def test_every_claim_that_the_course_cites_leads_there_and_back():
    cited = Counter()
    for path in ROOT.glob("notebooks/[0-9]*.ipynb"):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        texts = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
        cited.update(set(CLAIM.findall("\n".join(texts))) & {row["id"] for row in ledger()})
    there = led("course/", "ledger.html")
    assert {id.lower() for id in cited} <= set(there)
    back = [link for link, text in page("ledger.html").links if re.match(r"\d+, ", text)]
    assert len(back) == cited.total() > 0


def test_every_deviation_and_equation_has_its_section():
    numbers = re.findall(r"^\| D(\d+) \|", (ROOT / "paper_checks/README.md").read_text(), re.M)
    assert {f"d{number}" for number in numbers} <= page("deviations.html").ids
    assert {f"eq-{n}" for n in range(1, 12)} <= page("equations.html").ids
    assert {f"theorem-{n}" for n in range(1, 5)} <= page("equations.html").ids


def test_every_line_of_algorithm_1_stands_beside_its_code():
    lines = tomllib.loads((SITE / "algorithm.toml").read_text(encoding="utf-8"))["line"]
    printed = []
    for entry in lines:
        first, *rest = map(int, re.findall(r"\d+", entry["lines"]))
        printed += range(first, rest[0] + 1) if "–" in entry["lines"] else [first, *rest]
    assert sorted(printed) == list(range(1, 30))
    links = [link for link, _ in page("algorithm.html").links if link.startswith("source/")]
    assert len(links) == len(lines)


def public():
    """{module: its public functions, classes and methods with a docstring}."""
    found = {}
    for module in re.findall(r"^\| \[`(\w+)`\]", (ROOT / "docs/modules.md").read_text(), re.M):
        tree = ast.parse((ROOT / f"gbdqn_ref/{module}.py").read_text(encoding="utf-8"))
        found[module] = list(defined(tree, f"gbdqn_ref.{module}"))
    return found


def defined(tree, prefix):
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            if ast.get_docstring(node):
                yield f"{prefix}.{node.name}"
            if isinstance(node, ast.ClassDef):
                yield from defined(node, f"{prefix}.{node.name}")


def test_every_public_function_is_in_the_api_with_its_source_and_its_claims():
    resting = Counter(use for row in ledger() for use in row.get("uses", []))
    for module, functions in public().items():
        found = page(f"api/{module}.html")
        assert set(functions) <= found.ids, set(functions) - found.ids
        sources = [link for link, text in found.links if text == "[source]"]
        assert len(sources) >= len([name for name in functions if name in found.ids])
        assert all(link.startswith("../source/gbdqn_ref/") for link in sources)
        claims = sum(resting[name.removeprefix("gbdqn_ref.")] for name in functions)
        assert led(f"api/{module}.html", "ledger.html").total() >= claims
    assert len(public()) == len(list(ROOT.glob("gbdqn_ref/*.py"))) - 2  # __init__ and __main__


def test_a_function_that_cites_equations_stands_under_them():
    assert page("api/boosting.html").classes["math"] >= 3
    assert led("api/boosting.html", "equations.html")["eq-8"] == 1


# Links


@pytest.mark.parametrize(
    "kind", ["claims", "deviations", "equations", "lines", "notebooks", "functions"]
)
def test_no_name_is_left_without_its_link(kind):
    documented = {
        name.removeprefix("gbdqn_ref.") for module in public().values() for name in module
    }
    patterns = {
        "claims": "|".join(re.escape(row["id"]) for row in ledger()),
        "deviations": r"D\d+",
        "equations": r"Eqs?\.\s\d+|Theorems?\s\d",
        "lines": r"[Ll]ines?\s\d+",
        "notebooks": r"[Nn]otebooks?\s\d+",
        "functions": "|".join(re.escape(name) for name in documented),
    }
    pattern = re.compile(rf"(?<![\w.])({patterns[kind]})(?![\w-])")
    for name in names():
        for text in page(name).free:
            assert not pattern.search(text), (name, text)


def test_a_name_may_be_broken_over_two_lines(monkeypatch):
    monkeypatch.syspath_prepend(str(SITE))
    monkeypatch.syspath_prepend(str(ROOT / "paper_checks"))
    pieces = importlib.import_module("links").pieces("Begin at notebook\n1, or at Eq.\n8.", {})
    pages = [target[0] for _, target in pieces if target]
    assert pages == ["course/01_ten_rooms", "equations"]


def test_the_printed_lines_of_algorithm_1_lead_to_them():
    """Lines 9 to 11 have one row."""
    assert {"line-7", "line-9", "line-16"} <= set(led("course/02_", "algorithm.html"))
    assert {"line-7", "line-9", "line-26", "line-29"} <= set(led("course/07_", "algorithm.html"))
    assert {"line-9", "line-16", "line-19", "line-29"} <= set(led("ledger", "algorithm.html"))


def test_a_function_named_without_its_module_is_no_dead_end():
    """`forward` is no link, nn.MLP.forward is. In a notebook a bare name is meant as it stands only
    if its own code has it, or the source that it shows; the other pages that are looked at have no
    names of their own.
    """
    functions = {name.rpartition(".")[2] for module in public().values() for name in module}
    pages = dict.fromkeys(("ledger.html", "deviations.html", "algorithm.html"), "")
    pages["contributing.html"] = "make"  # the program
    for stem, found in cells():
        code = (json.dumps(cell) for cell in found if cell["cell_type"] == "code")
        pages[f"course/{stem}.html"] = "\n".join(code)
    for name, code in pages.items():
        bare = {text.removesuffix("()") for text in page(name).code} & functions
        dead = [each for each in bare if not re.search(rf"(?<![.\w]){each}\b", code)]
        assert not dead, (name, dead)


def test_functions_named_in_code_lead_to_the_api():
    found = [text for link, text in page("ledger.html").links if link.startswith("api/")]
    uses = [use for row in ledger() for use in row.get("uses", [])]
    known = {name.removeprefix("gbdqn_ref.") for module in public().values() for name in module}
    assert Counter(found) >= Counter(use for use in uses if use in known)


def test_each_use_of_a_glossary_term_leads_to_it():
    terms = re.findall(r"^### (.*)", (ROOT / "docs/glossary.md").read_text(encoding="utf-8"), re.M)
    pattern = re.compile(rf"(?<![\w-])({'|'.join(map(re.escape, terms))})(?![\w-])", re.I)
    course = [name for name in names() if name.startswith("course/")]
    for name in course:
        for text in page(name).free:
            assert not pattern.search(text), (name, text)
    assert led("course/", "glossary.html").total() > 10 * len(course)


def test_no_link_is_dead():
    ids = {}
    for name in [
        *names(),
        *(path.relative_to(HTML).as_posix() for path in HTML.glob("source/**/*.html")),
    ]:
        text = (HTML / name).read_text(encoding="utf-8")
        ids[name] = set(re.findall(r'\bid="([^"]+)"', text))
    for name in names():
        for link, text in page(name).links:
            if re.match(r"https?:|mailto:", link):
                continue
            file, _, anchor = unquote(link).partition("#")
            target = (
                posixpath.normpath(posixpath.join(posixpath.dirname(name), file)) if file else name
            )
            assert (HTML / target).is_file(), (name, link, text)
            assert not anchor or anchor in ids[target], (name, link, text)


def test_nothing_is_loaded_from_elsewhere():
    for name in names():
        for address in page(name).loaded:
            assert not re.match(r"(https?:)?//", address), (name, address)
    for style in HTML.glob("_static/**/*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//", style.read_text(encoding="utf-8")), style


# The course


def cells():
    for path in sorted(ROOT.glob("notebooks/[0-9]*.ipynb")):
        yield path.stem, json.loads(path.read_text(encoding="utf-8"))["cells"]


def test_every_answer_is_folded():
    for stem, found in cells():
        tags = Counter(tag for cell in found for tag in cell["metadata"].get("tags", []))
        whole = sum(
            "predicted" in cell["metadata"].get("tags", [])
            and "source_hidden" in cell["metadata"]["jupyter"]
            for cell in found
        )
        shown = page(f"course/{stem}.html").classes
        assert shown["below-input"] == tags["predicted"] - whole, stem
        text = (HTML / f"course/{stem}.html").read_text(encoding="utf-8")
        assert text.count("Show the answer and its code") == whole, stem


def test_live_figures_stand_in_the_course_in_place_of_their_sliders():
    found = []
    for stem, listed in cells():
        tags = [tag for cell in listed for tag in cell["metadata"].get("tags", [])]
        figures = [tag.removeprefix("live:") for tag in tags if tag.startswith("live:")]
        text = (HTML / f"course/{stem}.html").read_text(encoding="utf-8")
        assert re.findall(r'data-figure="(\w+)"', text) == figures
        assert "ipywidgets" not in text  # a slider without a kernel is dead
        found += figures
    assert found == ["rooms", "parabola", "replay", "rooms", "theorem"]


def test_the_learning_curves_stand_where_the_question_is_answered():
    text = (HTML / "what_to_keep.html").read_text(encoding="utf-8")
    assert re.findall(r'data-figure="(\w+)"', text) == ["curves"]
    assert text.index('data-figure="curves"') < text.index("Ask first")


def test_every_picture_has_its_words():
    for stem, found in cells():
        kept = [cell for cell in found if "still" not in cell["metadata"].get("tags", [])]
        outputs = [output for cell in kept for output in cell.get("outputs", ())]
        described = [
            kind["alt"]
            for output in outputs
            for kind in output.get("metadata", {}).values()
            if "alt" in kind
        ]
        text = (HTML / f"course/{stem}.html").read_text(encoding="utf-8")
        assert len(re.findall(r'<img alt="(?!\.\./)', text)) >= len(described), stem


def test_every_notebook_is_offered_and_opens_in_jupyter():
    for stem, _ in cells():
        name = f"course/{stem}.html"
        files = [link for link, _ in page(name).links if "/files/" in link]
        assert f"../files/notebooks/{stem}.ipynb" in files
        copied = HTML / f"files/notebooks/{stem}.ipynb"
        assert copied.read_bytes() == (ROOT / f"notebooks/{stem}.ipynb").read_bytes()
        if (ROOT / f"notebooks/clean/{stem}.ipynb").exists():
            assert f"../files/notebooks/clean/{stem}.ipynb" in files
        assert f">notebooks/{stem}.ipynb</span>" in (HTML / name).read_text(encoding="utf-8")


# The README


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) < 150


# In a browser


@pytest.fixture(scope="module")
def chromium():
    if not CHROMIUM:
        pytest.skip("there is no Chromium here")
    api = pytest.importorskip("playwright.sync_api", reason="without the extra site-test")
    with api.sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        yield found
        found.close()


@pytest.fixture
def visit(chromium):
    """visit(name, **context) opens a page and gives it, with what went wrong as .wrong."""
    contexts = []

    def opened(name="index.html", tab=None, **options):
        if tab is None:
            contexts.append(chromium.new_context(**options))
            tab = contexts[-1].new_page()
            tab.set_default_timeout(180_000)  # ms, for a busy machine
            tab.wrong = []
            tab.on(
                "console",
                lambda told: told.type in ("error", "warning") and tab.wrong.append(told.text),
            )
            tab.on("pageerror", lambda error: tab.wrong.append(str(error)))
            tab.on("requestfailed", lambda request: tab.wrong.append(request.url))
            tab.on(
                "request", lambda request: foreign(request.url) and tab.wrong.append(request.url)
            )
        tab.goto(f"{HTML.as_uri()}/{name}")
        return tab

    yield opened
    for context in contexts:
        context.close()


def foreign(url):
    return not url.startswith((HTML.as_uri(), "data:", "blob:"))


DRAWN = """async () => {
  if (document.querySelector(".math")) await MathJax.startup.promise;
  return [document.querySelectorAll("span.math, div.math").length,
          document.querySelectorAll("mjx-container").length,
          document.querySelectorAll("mjx-merror").length];
}"""
WIDE = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


def test_every_page_opens_on_a_phone_without_errors_requests_or_overflow(visit):
    tab = visit(viewport={"width": 390, "height": 844})
    for name in names():
        visit(name, tab)
        formulas, drawn, errors = tab.evaluate(DRAWN)
        assert drawn >= formulas and errors == 0, name
        assert tab.evaluate(WIDE) == 0, name
        assert not tab.wrong, (name, tab.wrong)


def test_the_source_opens_on_a_phone(visit):
    tab = visit("source/gbdqn_ref/gbdqn.html#L60", viewport={"width": 390, "height": 844})
    assert tab.evaluate(WIDE) == 0 and not tab.wrong
    assert tab.locator("#L60").count() == 1


def of_each_kind():
    """A page of each kind, in the order of their names."""
    kinds = {name.partition("/")[0]: name for name in names()}
    others = "course/02_forty_lines.html", "source/gbdqn_ref/optim.html"
    return sorted({*kinds.values(), *others})


@pytest.mark.parametrize("mode", ["light", "dark"])
def test_text_can_be_told_from_its_ground(visit, mode):
    """And axe finds nothing else that is grave."""
    found = pytest.importorskip("axe_playwright_python.sync_playwright", reason="without axe")
    axe, tab = found.Axe(), visit(color_scheme=mode, viewport={"width": 1280, "height": 900})
    for name in of_each_kind():
        visit(name, tab)
        found = axe.run(tab).response["violations"]
        grave = [each for each in found if each["impact"] in ("critical", "serious")]
        assert not grave, (name, [(each["id"], each["nodes"][0]["html"]) for each in grave])


def test_the_search_finds_the_residual(visit):
    tab = visit("search.html?q=residual")
    tab.wait_for_selector("#search-results li")
    found = tab.locator("#search-results li a").all_inner_texts()
    assert len(found) > 5 and any("residual" in text.lower() for text in found)
    assert not tab.wrong


def test_the_ledgers_filter_leaves_what_it_says(visit):
    tab, rows = visit("ledger.html"), ledger()
    count, shown = tab.locator(".filter output"), tab.locator("section:has(> p > .badge):visible")
    assert count.inner_text() == f"{len(rows)} of {len(rows)} claims"
    tab.select_option("[name=verdict]", "fails")
    failing = [row for row in rows if row["verdict"] == "fails"]
    assert shown.count() == len(failing) and count.inner_text().startswith(f"{len(failing)} of")
    tab.select_option("[name=far]", "proved")
    proved = [row for row in failing if row["extents"][0].startswith("proved")]
    assert 0 < len(proved) < len(failing) and shown.count() == len(proved)
    tab.fill("[name=words]", "no such words")
    assert shown.count() == 0


def test_a_link_to_a_claim_opens_its_fold_even_if_the_filter_had_left_it_out(visit):
    tab = visit("ledger.html")
    tab.select_option("[name=verdict]", "misprint")
    tab.evaluate("location.hash = '#t1-g'")
    section = tab.locator("section:has(> h3):has-text('T1-g ·')").last
    section.locator("details[open]").wait_for()
    assert section.is_visible()
    top = tab.evaluate("document.getElementById('t1-g').getBoundingClientRect().top")
    assert 0 <= top < 400


def test_without_scripts_the_ledger_is_whole(visit):
    tab = visit("ledger.html", java_script_enabled=False)
    assert not tab.locator("form.filter").is_visible()
    assert tab.locator("section:has(> p > .badge):visible").count() == len(ledger())
    fold = tab.locator("details").first
    fold.locator("summary").click()
    assert fold.locator("li").first.is_visible()


def test_answers_stay_hidden_until_they_are_asked_for(visit):
    tab = visit("course/01_ten_rooms.html")
    for kind in ("below-input", "above-input"):  # the output alone; with its code
        fold = tab.locator(f"details.{kind}:has(.cell_output)").first
        parts = fold.locator(".cell_input, .cell_output").all()
        assert parts and not any(each.is_visible() for each in parts)
        fold.locator("summary").click()
        assert all(each.is_visible() for each in parts)


def test_dark_pictures_are_turned_round(visit):
    seen = {}
    for mode in ("light", "dark"):
        tab = visit("index.html", color_scheme=mode)
        seen[mode] = tab.evaluate("getComputedStyle(document.querySelector('article img')).filter")
        seen[mode, "ground"] = tab.evaluate("getComputedStyle(document.body).backgroundColor")
    assert seen["light"] == "none" and "invert" in seen["dark"]
    assert seen["light", "ground"] != seen["dark", "ground"]

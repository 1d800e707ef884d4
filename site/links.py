"""What the site adds to Sphinx: names become links, and the source of every function has a page."""

import html
import inspect
import re
from functools import cache
from importlib import import_module
from pathlib import PurePosixPath

import pages
from docutils import nodes
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer
from sphinx.util.nodes import make_refnode

NAMES = re.compile(
    r"\b(?P<claim>T[1-4]-[a-z]|[MRWPABCXK]\d{1,2})\b"
    r"|\b(?P<deviation>D\d{1,2})\b"
    r"|\b(?P<place>(?:Eqs?\.|Theorems?|Algorithm)[  ]\d+(?:(?:–|, | and )\d+)*)"
    r"|(?<=\bAlgorithm 1, )(?P<line>lines?[  ]\d+(?:(?:–|, | and )\d+)*)"
    r"|\b(?P<notebook>[Nn]otebooks?[  ]\d+(?:(?:–|, | and )\d+)*)"
)
STILL = (  # where names stay text
    nodes.title,
    nodes.reference,
    nodes.literal_block,
    nodes.math,
    nodes.math_block,
    nodes.raw,
    nodes.comment,
)


# Where a name leads


@cache
def deviations():
    return set(re.findall(r"^\| (D\d+) \|", pages.read(pages.CHECKS), re.M))


@cache
def line_anchors():
    """{line of Algorithm 1: the first line of its row}."""
    rows = [[int(n) for n in re.findall(r"\d+", entry["lines"])] for entry in pages.LINES]
    spans = [(row, range(row[0], row[-1] + 1) if "–" in entry["lines"] else row) for row, entry in zip(rows, pages.LINES, strict=True)]
    return {number: row[0] for row, span in spans for number in span}


@cache
def course():
    return {int(stem[:2]): stem for stem in pages.notebooks()}


def place(kind, number):
    """(page, anchor) of a numbered place of the paper, of a line or of a notebook; None if there is none."""
    if kind == "notebook":
        return (f"course/{course()[number]}", "") if number in course() else None
    if kind == "line":
        return ("algorithm", f"line-{line_anchors()[number]}") if number in line_anchors() else None
    if kind == "Algorithm":
        return ("algorithm", "") if number == 1 else None
    name, anchor = {"Eq": ("eq", "eq"), "Theorem": ("theorem", "theorem")}[kind]
    return ("equations", f"{anchor}-{number}") if f"{name}{number}" in pages.EQUATIONS else None


def pieces(text):
    """A text as [(piece, its (page, anchor) or None)].

    >>> pieces("by T1-a and Eqs. 7–8")[1:]
    [('T1-a', ('ledger', 't1-a')), (' and ', None), ('Eqs. 7', ('equations', 'eq-7')), ('–', None), ('8', ('equations', 'eq-8'))]
    """
    found, end = [], 0
    for match in NAMES.finditer(text):
        found.append((text[end : match.start()], None))
        end = match.end()
        name, kind = match[0], match.lastgroup
        if kind == "claim":
            found.append((name, ("ledger", name.lower()) if name in pages.ledger.CLAIMS else None))
        elif kind == "deviation":
            found.append((name, ("deviations", name.lower()) if name in deviations() else None))
        else:
            found += numbered(name, kind)
    return [(piece, target) for piece, target in [*found, (text[end:], None)] if piece]


def numbered(name, kind):
    """The pieces of "Eqs. 7–8": each number leads to its place, the first together with the word."""
    if kind == "place":
        kind = re.match(r"Eq|Theorem|Algorithm", name)[0]
    word, rest = re.match(r"(\D*)(.*)", name).groups()
    for piece in re.split(r"(\d+)", rest)[1:]:
        if piece.isdigit():
            yield word + piece, place(kind, int(piece))
            word = ""
        elif piece:
            yield piece, None


def functions(env):
    """{name: (page, anchor)} of what the API documents: dotted names, and long ones that are unique."""
    found, short = {}, {}
    for name, entry in env.domains["py"].objects.items():
        own = name.removeprefix("gbdqn_ref.")
        target = entry.docname, entry.node_id
        found |= {name: target, own: target, own.partition(".")[2]: target}
        short.setdefault(own.rpartition(".")[2], set()).add(target)
    alone = {name: next(iter(where)) for name, where in short.items() if len(where) == 1}
    return alone | {name: where for name, where in found.items() if "." in name or name in alone}


@cache
def terms():
    """{term in lower case: anchor} of the glossary, and a pattern that finds them."""
    found = pages.glossary()
    words = "|".join(re.escape(term) for term in sorted(found, key=len, reverse=True))
    return found, re.compile(rf"(?<![\w-])({words})s?(?![\w-])", re.I) if found else None


def glossed(text):
    """A text as [(piece, its (page, anchor) in the glossary or None)]."""
    found, pattern = terms()
    if not pattern:
        return [(text, None)]
    split, end = [], 0
    for match in pattern.finditer(text):
        split += [(text[end : match.start()], None), (match[0], ("glossary", found[match[1].lower()]))]
        end = match.end()
    return [(piece, target) for piece, target in [*split, (text[end:], None)] if piece]


def link_names(app, doctree, docname):
    """Make links of the names in a page."""

    def reference(piece, target, kind):
        page, anchor = target
        node = make_refnode(app.builder, docname, page, anchor, nodes.inline("", piece, classes=[kind]))
        return node

    for text in list(doctree.findall(nodes.Text)):
        parents = list(ancestors(text))
        if any(isinstance(each, STILL) for each in parents):
            continue
        if any(isinstance(each, nodes.literal) for each in parents):
            link_code(app, text, docname)
            continue
        new = []
        for piece, target in pieces(str(text)):
            if target and target != (docname, ""):
                new.append(reference(piece, target, "name"))
            elif docname.startswith("course/") and not target:
                new += [
                    reference(word, where, "term") if where else nodes.Text(word)
                    for word, where in glossed(piece)
                ]
            else:
                new.append(nodes.Text(piece))
        if any(not isinstance(node, nodes.Text) for node in new):
            text.parent.replace(text, new)


def ancestors(node):
    while node := node.parent:
        yield node


def link_code(app, text, docname):
    """A literal that is a function's name leads to the API, a test's to its source."""
    literal = text.parent
    name = str(text).removesuffix("()")
    if test := re.fullmatch(r"(test_\w+\.py)(?:::(\w+))?", name):
        uri = tested(*test.groups())
    else:
        target = functions(app.env).get(name)
        uri = target and app.builder.get_relative_uri(docname, target[0]) + f"#{target[1]}"
        uri = None if target and target[0] == docname else uri
    if uri:
        up = "../" * docname.count("/") if test else ""
        node = nodes.reference("", "", literal.deepcopy(), refuri=up + uri, internal=True)
        literal.parent.replace(literal, node)


def tested(file, name):
    """The address of a test's source, or None."""
    for folder in ("paper_checks", "tests"):
        path = pages.ROOT / folder / file
        if path.exists():
            return pages.address(f"{folder}/{file}", defined(path).get(name, ""))
    return None


@cache
def defined(path):
    """{function or test without test_: anchor of its line}."""
    found = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if definition := re.match(r"\s*(?:def|class) (\w+)", line):
            found.setdefault(definition[1], f"L{number}")
            found.setdefault(definition[1].removeprefix("test_"), f"L{number}")
    return found


# The API


def escaped(app, what, name, thing, options, lines):
    """A docstring as reStructuredText: prose as it stands, what is indented as it stands, examples
    as examples; before it the equations it cites, after it the claims that rest on it.
    """
    prose = "\n".join(lines).rstrip()
    lines[:] = []
    for number in dict.fromkeys(cited_equations(prose)):
        formula = pages.EQUATIONS[f"eq{number}"]["formula"]
        lines += [".. math::", "", f"   {formula}", ""] if what != "module" else []
    for block in re.split(r"\n\s*\n", prose):
        lines += restructured(block)
    own = name.removeprefix("gbdqn_ref.")
    resting = [id for id, claim in pages.ledger.CLAIMS.items() if own in claim.get("uses", [])]
    if resting:
        lines += [f"Claims that rest on it: {', '.join(resting)}.", ""]


def cited_equations(text):
    """The numbers of the equations that a docstring cites.

    >>> list(cited_equations("Q (Eqs. 7–9), as in Eq. 1"))
    [7, 8, 9, 1]
    """
    for first, last in re.findall(r"Eqs?\. (\d+)(?:–(\d+))?", text):
        yield from range(int(first), int(last or first) + 1)


def restructured(block):
    """A paragraph of a docstring as lines of reStructuredText."""
    if block.startswith(">>>"):
        return [*block.splitlines(), ""]
    if block.startswith("    "):
        return ["::", "", *block.splitlines(), ""]
    parts = re.split(r"(`[^`]+`)", block)
    text = "".join(
        f"`{part}`" if k % 2 else re.sub(r"([\\*_|`])", r"\\\1", part)
        for k, part in enumerate(parts)
    )
    return [*re.sub(r"``?([^`]+)``?", r"``\1``", text).splitlines(), ""]


def linkcode_resolve(domain, info):
    """The address of [source], from a page of the API."""
    thing = import_module(info["module"])
    for part in info["fullname"].split("."):
        thing = getattr(thing, part, None)
    thing = getattr(thing, "fget", thing)
    try:
        number = inspect.getsourcelines(thing)[1]
    except TypeError:
        return None
    return "../" + pages.address(info["module"].replace(".", "/") + ".py", f"L{number}")


# The source


def source_pages(app):
    """A page for each Python file, each line with an anchor."""
    look = HtmlFormatter(lineanchors="L", anchorlinenos=True, linenos=False)
    for file in pages.code():
        text = highlight(pages.read(file), PythonLexer(stripnl=False), look)
        text = re.sub(r'(id|name|href)="(#?)L-(\d+)"', r'\1="\2L\3"', text)
        body = f"<h1>{html.escape(file)}</h1>{text}"
        name = str(PurePosixPath("source", file).with_suffix(""))
        yield name, {"title": file, "body": body, "parents": []}, "page.html"


def setup(app):
    app.connect("autodoc-process-docstring", escaped)
    app.connect("doctree-resolved", link_names)
    app.connect("html-collect-pages", source_pages)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

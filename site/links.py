"""What the site adds to Sphinx: names become links, and the source of every function has a page."""

import html
import inspect
import re
from functools import cache
from importlib import import_module
from pathlib import PurePosixPath

import checked
import course
from docutils import nodes
from places import CHECKS, ROOT, address, code, notebooks, read
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer
from sphinx.util.nodes import make_refnode

NAMES = re.compile(
    rf"(?P<claim>{checked.ledger.ID.pattern})"
    r"|\b(?P<deviation>D\d{1,2})\b"
    r"|\b(?P<place>(?:Eqs?\.|Theorems?|Algorithm)\s+\d+(?:(?:–|,\s|\sand\s)\d+)*)"
    r"|\b(?P<line>[Ll]ines?\s\d+(?:(?:–|,\s|\sand\s)\d+)*)"
    r"|(?<![\w./])(?P<function>[a-z]\w*(?:\.\w+)+)"
    r"|\b(?P<notebook>[Nn]otebooks?\s\d+(?:(?:–|,\s|\sand\s)\d+)*)"
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
def known():
    """{kind of name: {name: (page, anchor)}} of all that is numbered."""
    deviations = re.findall(r"^\| (D\d+) \|", read(CHECKS), re.M)
    stems = {str(int(stem[:2])): stem for stem in notebooks()}
    places = {
        checked.ledger.PLACES[name]: ("equations", checked.anchor(checked.ledger.PLACES[name]))
        for name in checked.EQUATIONS
    }
    lines = {
        str(number): ("algorithm", f"line-{checked.numbers(entry)[0]}")
        for entry in checked.LINES
        for number in checked.numbers(entry)
    }
    return {
        "claim": {id: ("ledger", id.lower()) for id in checked.ledger.CLAIMS},
        "deviation": {number: ("deviations", number.lower()) for number in deviations},
        "Eq": {name.removeprefix("Eq. "): target for name, target in places.items()},
        "Theorem": {name.removeprefix("Theorem "): target for name, target in places.items()},
        "Algorithm": {"1": ("algorithm", "")},
        "line": lines,
        "notebook": {number: (f"course/{stem}", "") for number, stem in stems.items()},
    }


def pieces(text, functions):
    """A text as [(piece, its (page, anchor) or None)], given {function: (page, anchor)}.

    >>> pieces("by T1-a and Eqs. 7–8", {})[1:4]
    [('T1-a', ('ledger', 't1-a')), (' and ', None), ('Eqs. 7', ('equations', 'eq-7'))]
    """
    found, end = [], 0
    for match in NAMES.finditer(text):
        found.append((text[end : match.start()], None))
        found += [(match[0], functions.get(match[0]))] if match["function"] else named(match)
        end = match.end()
    return [(piece, target) for piece, target in [*found, (text[end:], None)] if piece]


def named(match):
    """The pieces of a name that was found; in "Eqs. 7–8" each number leads to its place.

    >>> [piece for piece, target in named(NAMES.search("Eqs. 7–8")) if target]
    ['Eqs. 7', '8']
    """
    name, kind = match[0], match.lastgroup
    if kind in ("claim", "deviation"):
        return [(name, known()[kind].get(name))]
    kind = re.match(r"Eq|Theorem|Algorithm|[Ll]ine|[Nn]otebook", name)[0]
    kind = kind.lower() if kind in ("Line", "Notebook") else kind
    word, *rest = re.split(r"(?<=\D)(?=\d)|(?<=\d)(?=\D)", name)
    found = [(word + rest[0], known()[kind].get(rest[0]))]
    return found + [(piece, known()[kind].get(piece)) for piece in rest[1:]]


@cache
def functions(env):
    """{name: (page, anchor)} of what the API documents: dotted names, and of others those that are
    alone and that no reader would give to something else, such as td_target and GBDQN.
    """
    found, short = {}, {}
    for name, entry in env.domains["py"].objects.items():
        own = name.removeprefix("gbdqn_ref.")
        target = entry.docname, entry.node_id
        found |= {each: target for each in (name, own, own.partition(".")[2]) if "." in each}
        short.setdefault(own.rpartition(".")[2], set()).add(target)
    alone = {name: where for name, (where, *others) in short.items() if not others}
    return found | {name: alone[name] for name in alone if re.search(r"\w_\w|^[A-Z]", name)}


@cache
def terms():
    """{word in lower case: anchor in the glossary}, plurals included, and the pattern of them."""
    found = {}
    for term, where in course.terms().items():
        plural = term + ("es" if re.search(r"(s|ch)$", term) else "s")
        plural = term[:-1] + "ies" if re.search(r"[^aeiou]y$", term) else plural
        found |= {term: where, plural: where}
    words = "|".join(re.escape(word) for word in sorted(found, key=len, reverse=True))
    return found, re.compile(rf"(?<![\w-])({words})(?![\w-])", re.I)


def glossed(text):
    """A text as [(piece, its (page, anchor) in the glossary or None, "term")]."""
    found, pattern = terms()
    words = pattern.split(text)
    return [
        (word, ("glossary", found.get(word.lower())) if k % 2 else None, "term")
        for k, word in enumerate(words)
        if word
    ]


def link_names(app, doctree, docname):
    """Make links of the names in a page."""
    join_lines(doctree)
    for text in list(doctree.findall(nodes.Text)):
        parents = list(ancestors(text))
        if any(isinstance(each, STILL) for each in parents) or in_html_link(text):
            continue
        if any(isinstance(each, nodes.literal) for each in parents):
            link_code(app, text, docname)
            continue
        found = [(*each, "name") for each in pieces(text.astext(), functions(app.env))]
        if docname.startswith("course/"):
            found = [word for each in found for word in ([each] if each[1] else glossed(each[0]))]
        if any(target for _, target, _ in found):
            text.parent.replace(text, [linked(app, docname, *each) for each in found])


def join_lines(doctree):
    """Make one text of a paragraph's lines, for a name may be broken over two."""
    for parent in doctree.findall(nodes.TextElement):
        for k in range(len(parent) - 1, 0, -1):
            if isinstance(parent[k - 1], nodes.Text) and isinstance(parent[k], nodes.Text):
                parent[k - 1 : k + 1] = [nodes.Text(parent[k - 1] + parent[k])]


def linked(app, docname, words, target, kind):
    """A piece of text as a link, or as text where it leads nowhere or to the page's own top."""
    if not target or target == (docname, ""):
        return nodes.Text(words)
    return make_refnode(app.builder, docname, *target, nodes.inline("", words, classes=[kind]))


def in_html_link(text):
    """Whether a text is that of a link in HTML."""
    before = text.parent[: text.parent.index(text)]
    return bool(before) and isinstance(before[-1], nodes.raw) and before[-1].astext()[:3] == "<a "


def ancestors(node):
    while node := node.parent:
        yield node


def link_code(app, text, docname):
    """A literal that is a function's name leads to the API, a test's to its source."""
    literal = text.parent
    name = text.astext().removesuffix("()")
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
        path = ROOT / folder / file
        if path.exists():
            return address(f"{folder}/{file}", defined(path).get(name, ""))
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
        formula = checked.EQUATIONS[f"eq{number}"]["formula"]
        lines += [".. math::", "", f"   {formula}", ""] if what != "module" else []
    for block in re.split(r"\n\s*\n", prose):
        lines += restructured(block)
    own = name.removeprefix("gbdqn_ref.")
    resting = [id for id, claim in checked.ledger.CLAIMS.items() if own in claim.get("uses", [])]
    if resting:
        lines += [f"Claims that rest on it: {', '.join(resting)}.", ""]


def without_text(app, what, name, thing, skip, options):
    """Leave out what has no text of its own: the fields of a NamedTuple."""
    return True if (thing.__doc__ or "").startswith("Alias for field number") else None


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
    thing = getattr(thing, "fget", getattr(thing, "func", thing))  # of a property
    try:
        number = inspect.getsourcelines(thing)[1]
    except TypeError:
        return None
    return "../" + address(info["module"].replace(".", "/") + ".py", f"L{number}")


# The source


def source_pages(app):
    """A page for each Python file, each line with an anchor."""
    look = HtmlFormatter(linespans="L")
    for file in code():
        text = highlight(read(file), PythonLexer(stripnl=False), look)
        text = text.replace('<span id="L-', '<span id="L')
        body = f"<h1>{html.escape(file)}</h1>{text}"
        name = str(PurePosixPath("source", file).with_suffix(""))
        yield name, {"title": file, "body": body, "parents": []}, "page.html"


def setup(app):
    app.connect("autodoc-process-docstring", escaped)
    app.connect("autodoc-skip-member", without_text)
    app.connect("doctree-resolved", link_names)
    app.connect("html-collect-pages", source_pages)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

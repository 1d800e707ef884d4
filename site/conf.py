"""Sphinx's settings. What pages there are: pages.py. How names become links: links.py."""

import importlib.util
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

from links import linkcode_resolve  # noqa: E402, F401

from gbdqn_ref import __version__  # noqa: E402

project, author, release = "gbdqn_ref", "the gbdqn_ref authors", __version__
copyright = "the gbdqn_ref authors, MIT licence"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.linkcode",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "links",
    "figures.directive",
]

# Markdown and notebooks
myst_enable_extensions = ["amsmath", "attrs_inline", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"
nb_render_markdown_format = "myst"
nb_mime_priority_overrides = [("html", "text/html", 20)]
suppress_warnings = ["myst.header"]  # a page of the ledger starts its sections at the third level

# The API
autodoc_member_order = "bysource"
autodoc_inherit_docstrings = False
autodoc_typehints = "none"
autodoc_preserve_defaults = True
default_role = "code"

# The look
html_theme = "furo"
html_title = "gbdqn_ref"
html_static_path = [str(FOLDER / "static")]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_extra_path = [str(FOLDER / "_build/extra")]
html_copy_source = False
html_show_sourcelink = False
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
copybutton_prompt_text = ">>> "

# Mathematics: one file of MathJax 3, out of the package that carries it
MATHJAX = Path(importlib.util.find_spec("sphinx-mathjax-offline").origin).parent / "static/mathjax"
html_static_path.append(str(MATHJAX / "tex-svg.js"))
mathjax_path = "tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}

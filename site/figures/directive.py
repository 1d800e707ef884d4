"""The directive {figure-live}: a live figure in a page of the site, by its name."""

from docutils import nodes
from figures import frames
from sphinx.util.docutils import SphinxDirective


class FigureLive(SphinxDirective):
    """Put the figure's HTML into the page; its claims and equations are links."""

    required_arguments = 1

    def run(self):
        html = frames.html(self.arguments[0], link=self.address)
        return [nodes.raw("", html, format="html")]

    def address(self, name):
        page = "equations" if name.startswith("Eq") else "ledger"
        anchor = name.lower().replace(". ", "-")
        return "../" * self.env.docname.count("/") + f"{page}.html#{anchor}"


def setup(app):
    """The figures' files are part of every page; they are small."""
    app.add_directive("figure-live", FigureLive)
    for file in frames.FILES:
        app.config.html_static_path.append(str(frames.FOLDER / file))
        if file.endswith(".css"):
            app.add_css_file(file)
        else:
            app.add_js_file(file, loading_method="defer")
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

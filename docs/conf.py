"""The documentation site: `make docs` builds it, with warnings as errors."""

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.highlighting import lexers

from mavdiag import __version__

project, copyright, release = "mavdiag", "the authors of mavdiag", __version__  # noqa: A001  # Sphinx's own name
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx-mathjax-offline"]
html_theme = "furo"
html_title = "mavdiag"
myst_heading_anchors = 4
myst_fence_as_directive = ["math"]
autodoc_member_order = "bysource"


def show_as_written(app: Sphinx, what: str, name: str, about: object, options: object, lines: list[str]) -> None:
    """Show the first line of a docstring as text and the rest as it is written: docstrings are plain text."""
    first, rest = lines[:1], lines[1:]
    lines[:] = [line.replace("*", r"\*").replace("`", "") for line in first]
    lines += ["", "::", "", *(f"   {line}" for line in rest), ""] if any(rest) else []


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", show_as_written)


lexers["mermaid"] = TextLexer()

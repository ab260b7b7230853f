"""The documentation site: `make docs` builds it, with warnings as errors."""

import re

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.highlighting import lexers

from mavdiag import __version__
from mavdiag.monitors import MONITORS

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
    lines[:] = [re.sub(r"([*|_\\])", r"\\\1", line.replace("`", "")) for line in first]
    lines += ["", "::", "", *(f"   {line}" for line in rest), ""] if any(rest) else []


def list_monitors(app: Sphinx, name: str, source: list[str]) -> None:
    """Put every monitor of the registry on its page, by the docstrings of its module and its class."""
    parts = [
        f"### {one.name}\n\n```{{eval-rst}}\n.. automodule:: {one.__module__}\n   :no-members:\n"
        f".. autoclass:: {one.__module__}.{one.__name__}\n   :no-members:\n```\n"
        for one in MONITORS
    ]
    source[0] = source[0].replace("<!-- every monitor of the registry -->\n", "\n".join(parts))


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", list_monitors)
    app.connect("autodoc-process-docstring", show_as_written)


lexers["mermaid"] = TextLexer()

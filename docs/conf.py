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
add_module_names = False
highlight_language = "text"
myst_enable_extensions = ["dollarmath"]
html_static_path, html_css_files = ["style"], ["site.css"]

FIELD = re.compile(r"[\w-]+(?:, [\w-]+)*: ")


def show_as_written(app: Sphinx, what: str, name: str, about: object, options: object, lines: list[str]) -> None:
    """Show a docstring, which is plain text: sentences as text, fields on lines of their own, the rest as it stands."""
    shown: list[str] = []
    for paragraph in re.split(r"\n(?:[ \t]*\n)+", "\n".join(lines).strip("\n")):
        parts = paragraph.splitlines()
        if parts and parts[0].startswith(">>>"):
            shown += ["", ".. code-block:: python", "", *(f"   {part}" for part in parts), ""]
        elif any(part.startswith(" ") for part in parts):
            shown += ["", "::", "", *(f"   {part}" for part in parts), ""]
        elif any(FIELD.match(part) for part in parts):
            shown += [
                "",
                *(f"{'|' if k == 0 or FIELD.match(part) else ' '} {plain(part)}" for k, part in enumerate(parts)),
                "",
            ]
        else:
            shown += ["", *map(plain, parts), ""]
    lines[:] = shown


def plain(text: str) -> str:
    """Text in which nothing is markup."""
    return re.sub(r"([*|_\\])", r"\\\1", text.replace("`", ""))


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

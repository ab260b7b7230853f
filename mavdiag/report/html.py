"""HTML piece by piece: every text that comes in is escaped, for names, notes and parameters of logs are not ours."""

import html
import re
from collections.abc import Iterable, Sequence

from mavdiag.printable import printable
from mavdiag.report.style import Picture, embedded

__all__ = ["escaped", "figure", "listed", "page", "paragraph", "table"]

STYLE = """
/* Each chart is dark on white; the page around it follows the reader's choice. */
:root { color-scheme: light dark; --text: #111; --soft: #333; --page: #fff; --box: #f4f4f4; --rule: #bbb;
  --link: #00507d; }
@media screen and (prefers-color-scheme: dark) { :root { --text: #e8e8e8; --soft: #c4c4c4; --page: #16181a;
  --box: #24272a; --rule: #555; --link: #8cc8f0; } }
body { font: 16px/1.5 system-ui, "DejaVu Sans", Verdana, Arial, sans-serif; color: var(--text);
  background: var(--page); overflow-wrap: anywhere; max-width: 60rem; margin: 0 auto; padding: 1rem 1.25rem 4rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0.5rem 0; }
h2 { font-size: 1.3rem; margin: 2.5rem 0 0.5rem; border-top: 3px solid var(--text);
  padding-top: 0.75rem; }
h3, h2.part { font-size: 1.1rem; margin: 2rem 0 0.5rem; border: 0; padding: 0; }
a { color: var(--link); }
.verdict { border-left: 0.6rem solid var(--text); padding: 0.5rem 1rem; margin: 1rem 0; background: var(--box); }
.verdict p { margin: 0.3rem 0; }
.verdict .said { font-size: 1.25rem; font-weight: 600; }
.verdict.fault { border-color: #D55E00; } .verdict.suspected { border-color: #E69F00; }
.verdict.healthy { border-color: #009E73; }
.verdict.not_judgeable, .verdict.error { border-color: #767676; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; margin: 0.5rem 0 1rem; font-size: 0.9rem; overflow-wrap: normal; }
caption { text-align: left; color: var(--soft); padding-bottom: 0.3rem; }
th, td { text-align: left; vertical-align: top; padding: 0.25rem 0.6rem 0.25rem 0;
  border-bottom: 1px solid var(--rule); }
.index tbody th { min-width: 10rem; }
tbody th, tbody td { overflow-wrap: break-word; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
thead th { border-bottom: 2px solid var(--text); }
tbody th { font-weight: 400; }
tr.above th, tr.above td.number { font-weight: 700; }
figure { margin: 1.5rem 0; break-inside: avoid; overflow-x: auto; }
figure > svg { width: 100%; height: auto; display: block; background: #fff; }
@media screen { figure > svg { min-width: 36rem; } } /* a phone scrolls a chart whose words can be read */
figure#airframe > svg, figure[id$="-airframe"] > svg { min-width: 0; max-width: 20rem; }
figcaption { font-size: 0.95rem; color: var(--soft); max-width: 52rem; }
figcaption b { color: var(--text); }
.missing { border: 1px dashed #767676; padding: 0.4rem 0.8rem; color: var(--soft); }
code { font-size: 0.85em; overflow-wrap: anywhere; }
@media print { body { font-size: 10pt; max-width: none; padding: 0; } h2 { break-before: page; }
  h2.part, h2:first-of-type { break-before: auto; } h2, h3, caption { break-after: avoid; }
  .scroll { overflow: visible; } table { font-size: 7.5pt; } tr { break-inside: avoid; }
  th, td { overflow-wrap: anywhere; }
  a { color: inherit; text-decoration: none; } }
"""


def escaped(text: object) -> str:
    """A text that is not ours: nothing in it is markup, moves the reading direction or hides."""
    return html.escape(printable(str(text)))


def page(title: str, body: Iterable[str]) -> str:
    """The whole file. body: parts that are HTML already."""
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src 'none'"
    head = (
        f'<meta charset="utf-8">\n<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n<title>{escaped(title)}</title>\n'
        f"<style>{STYLE}</style>"
    )
    inner = "\n".join(part for part in body if part)
    return f'<!DOCTYPE html>\n<html lang="en">\n<head>\n{head}\n</head>\n<body>\n{inner}\n</body>\n</html>\n'


def paragraph(text: str, kind: str = "") -> str:
    """One paragraph of text that is not HTML yet; nothing for an empty one."""
    return f"<p{_class(kind)}>{_with_code(escaped(text))}</p>" if text else ""


def listed(texts: Sequence[str]) -> str:
    """A list of texts; nothing for none."""
    return f"<ul>{''.join(f'<li>{escaped(one)}</li>' for one in texts)}</ul>" if texts else ""


def table(
    caption: str,
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    above: Sequence[int] = (),
    links: Sequence[str] = (),
) -> str:
    """A table with headers of columns and rows.

    numbers: columns that are set to the right. above: rows that stand out. links: an address for the head of each row.
    """
    if not rows:
        return ""

    def cell(column: int, text: str, tag: str, more: str = "") -> str:
        return f"<{tag}{more}{_class('number' if column in numbers else '')}>{text}</{tag}>"

    lines = []
    for number, row in enumerate(rows):
        first = escaped(row[0])
        if links:
            first = f'<a href="#{escaped(links[number])}">{first}</a>'
        cells = cell(0, first, "th", ' scope="row"') + "".join(
            cell(i, escaped(text), "td") for i, text in enumerate(row[1:], start=1)
        )
        lines.append(f"<tr{_class('above' if number in above else '')}>{cells}</tr>")
    head = "".join(cell(i, escaped(text), "th", ' scope="col"') for i, text in enumerate(heads))
    kind = _class("index" if links else "")
    return (
        f'<div class="scroll"><table{kind}><caption>{escaped(caption)}</caption><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def figure(picture: Picture, prefix: str, number: int) -> str:
    """A picture with its caption, or the reason why there is none. prefix: of all ids in it."""
    name = f"<b>Figure {number}. {escaped(picture.title)}.</b>"
    thesis = f' data-thesis-figure="{escaped(picture.thesis)}"' if picture.thesis else ""  # a pilot need not see it
    place = f'id="{prefix}-{picture.key}"{thesis}'
    if not picture.svg:
        reason = f"Not drawn: {escaped(picture.not_drawn)}."
        return f'<figure {place}><figcaption class="missing">{name} {reason}</figcaption></figure>'
    drawing = embedded(picture.svg, f"{prefix}-{picture.key}")
    return f"<figure {place}>{drawing}<figcaption>{name} {escaped(picture.caption)}</figcaption></figure>"


def _with_code(markup: str) -> str:
    """What stands between backticks as code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", markup)


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""

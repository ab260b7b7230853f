"""Reads a report's page as a browser would, strictly: tags, ids, addresses, texts and drawings."""

import base64
import hashlib
import itertools
import re
from html.parser import HTMLParser
from xml.etree import ElementTree

VOID = {"meta", "br", "hr", "img", "link", "input"}
FETCHED = ("src", "href", "xlink:href", "data", "action", "poster", "srcset")


class Page(HTMLParser):
    """What a page holds: all text that is said, and its drawings. Raises AssertionError for unordered tags."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self._words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open, self._open
        self.said = " ".join(" ".join(self._words).split())
        self.ids = [value for _, name, value in self.attributes if name == "id"]
        self.addresses = [value for _, name, value in self.attributes if name in FETCHED]
        outer = r"<figure[^>]*>(?:<figcaption[^>]*>.*?</figcaption>)?(<svg.*?</svg>)\s*(?:</figure>|<figcaption)"
        self.drawings = [ElementTree.fromstring(one) for one in re.findall(outer, text, re.DOTALL)]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self._open, f"</{tag}> closes nothing"
        opened = self._open.pop()
        assert opened == tag, f"</{tag}> closes <{opened}>"

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self._open):
            self._words.append(data)


def check(text: str) -> Page:
    """A page that stands alone and can be read: everything that must hold of every page."""
    page, scripts = Page(text), re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert page.tags.count("script") == len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text
    assert not {"iframe", "object", "embed", "link", "base", "form"} & set(page.tags)
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]
    assert all(one.startswith("#") for one in page.addresses), page.addresses
    assert {one[1:] for one in page.addresses} <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    text = text.replace(scripts[0], "")
    assert not re.search(r"@import|url\(\s*['\"]?\s*(?!#)", text), "something is fetched"
    assert ("html", "lang", "en") in page.attributes
    for drawing in page.drawings:
        assert drawing.get("role") == "img"
        labels = (drawing.get("aria-labelledby") or "").split()
        there = {one.get("id"): one.text for one in drawing}
        assert labels
        assert all(there.get(label) for label in labels)
    levels = [int(tag[1]) for tag in page.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels)), levels
    assert {name for tag, name, _ in page.attributes if tag == "th"} <= {"scope", "class"}
    return page

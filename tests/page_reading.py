"""Reads a report's page as a browser would, strictly: tags, ids, addresses, texts and drawings."""

import itertools
import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from xml.etree import ElementTree

VOID = {"meta", "br", "hr", "img", "link", "input"}
FETCHED = ("src", "href", "xlink:href", "data", "action", "poster", "srcset")


@dataclass
class Page(HTMLParser):
    """What a page holds. Raises AssertionError for a tag that is not closed in order."""

    text: str
    tags: list[str] = field(default_factory=list)
    ids: list[str] = field(default_factory=list)
    addresses: list[str] = field(default_factory=list)
    handlers: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)
    attributes: list[tuple[str, str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        HTMLParser.__init__(self)
        self._open: list[str] = []
        self.feed(self.text)
        self.close()
        assert not self._open, self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            self.attributes.append((tag, name, value or ""))
            if name == "id":
                self.ids.append(value or "")
            if name in FETCHED:
                self.addresses.append(value or "")
            if name.startswith("on"):
                self.handlers.append(name)

    def handle_endtag(self, tag: str) -> None:
        assert self._open, f"</{tag}> closes nothing"
        opened = self._open.pop()
        assert opened == tag, f"</{tag}> closes <{opened}>"

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def said(self) -> str:
        """All text."""
        return " ".join(" ".join(self.words).split())

    @property
    def drawings(self) -> list[ElementTree.Element]:
        """Each drawing, read as XML, which is stricter."""
        return [ElementTree.fromstring(one) for one in re.findall(r"<svg.*?</svg>", self.text, re.DOTALL)]


def check(text: str) -> Page:
    """A page that stands alone and can be read: everything that must hold of every page."""
    page = Page(text)
    assert not {"script", "iframe", "object", "embed", "link", "base", "form"} & set(page.tags)
    assert not page.handlers
    assert all(one.startswith("#") for one in page.addresses), page.addresses
    assert {one[1:] for one in page.addresses} <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    assert not re.search(r"url\(\s*['\"]?\s*(?!#)", text), "something is fetched"
    assert "@import" not in text
    assert ("html", "lang", "en") in page.attributes
    for drawing in page.drawings:
        assert drawing.get("role") == "img"
        labels = (drawing.get("aria-labelledby") or "").split()
        assert labels
        there = {one.get("id"): one.text for one in drawing}
        assert all(there.get(label) for label in labels)
    levels = [int(tag[1]) for tag in page.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels)), levels
    for _, name, _ in (one for one in page.attributes if one[0] == "th"):
        assert name in {"scope", "class"}
    return page

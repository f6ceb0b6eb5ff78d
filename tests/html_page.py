"""What a browser would make of a page: its text, its tables, and whether it stands alone."""

import re
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path

EMPTY = {"meta", "img", "br"}  # elements without an end


class Page(HTMLParser):
    """A page, its tags balanced; `tables` by the last heading before them, rows of texts."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.text, self.tags, self.sources = "", list[str](), list[str]()
        self.attributes, self.commands = set[str](), list[str]()
        self.tables = dict[str, list[list[str]]]()
        self._open, self._heading = list[str](), ""
        self.feed(self.source)
        self.close()
        assert not self._open, f"never closed: {self._open}"

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attrs}
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in EMPTY:
            self._open.append(tag)
        if tag in ("h2", "h3"):
            self._heading = ""
        if tag == "tr":
            self.tables.setdefault(self._heading, []).append([])
        if tag in ("td", "th"):
            self.tables[self._heading][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self._open and self._open[-1] == tag, f"</{tag}> in {self._open}"
        self._open.pop()

    def handle_data(self, data: str) -> None:
        self.text += data
        if self._open and self._open[-1] in ("h2", "h3"):
            self._heading += data
        if {"td", "th"} & set(self._open):
            self.tables[self._heading][-1][-1] += data
        if self._open and self._open[-1] == "code" and data.startswith("pcpc "):
            self.commands.append(data)

    def cells(self, heading: str, key: str) -> list[str]:
        """Return the cells behind the first of a table's row that begins with `key`."""
        return next(row[1:] for row in self.tables[heading] if row[0] == key)

    def check_alone(self) -> None:
        """AssertionError if it could fetch anything, or run anything."""
        assert not {"script", "link", "iframe", "object", "form", "base"} & set(self.tags)
        assert not [name for name in self.attributes if name.startswith("on") or name == "style"]
        wrong = [s for s in self.sources if not s.startswith(("data:image/png;base64,", "#"))]
        assert not wrong, wrong
        assert re.search(r'Content-Security-Policy" content="default-src \'none\'; ', self.source)

"""A result declared once, as sections, tables, pictures and notes, and rendered as it is wanted.

    Section("Metrics", [Table(("metric", "value"), rows, right=(1,)), Note("of the whole run")])

    html(part)         for `tools.terminal.html.page`; whatever a name holds is text there
    markdown(part)     for a pull request
    terminal(part)     lines of text, at most as wide as the terminal

A line is a text, or a tuple of texts one behind the other, of which some are `Code` or `Strong`;
cells are the same, or any value. What is empty is left out: None, a table without rows, a section
without parts.
"""

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pcpc.tools.terminal import html as tags
from pcpc.tools.terminal import screen


class Code(str):
    """Words to copy."""


class Link(str):
    """Words that lead to a file; `to`: its address, relative and quoted. Only a page follows it."""

    to: str

    def __new__(cls, words: str, to: str) -> "Link":
        """Return the words with the address beside them."""
        found = super().__new__(cls, words)
        found.to = to
        return found


class Strong(str):
    """Words not to be overlooked."""


class Note(str):
    """A remark."""


class Block(str):
    """Lines that stay as they are, as those of a file."""


Line = Any  # a text, or a tuple of texts


@dataclass(frozen=True)
class Table:
    """Rows of cells below a head, whose texts may all be empty; `right`: columns of numbers."""

    head: Sequence[Line]
    rows: Sequence[Sequence[Line]]
    right: Sequence[int] = ()


@dataclass(frozen=True)
class Bullets:
    """Lines that belong together."""

    lines: Iterable[Line]


@dataclass(frozen=True)
class LabelledTexts:
    """Texts by what they say something of; on a terminal behind labels of this `width`."""

    texts: Mapping[str, str | Sequence[str]]
    width: int = 12
    indent: str = ""


@dataclass(frozen=True)
class Picture:
    """A PNG, and what it shows; `file`: where it lies, for Markdown."""

    png: bytes
    shows: str
    file: str = ""


@dataclass(frozen=True)
class Verdict:
    """What it came to in a word, and the reasons; `good`: there is nothing to mend."""

    word: str
    reasons: Sequence[Line]
    good: bool


@dataclass(frozen=True)
class Section:
    """Parts below a title; `folded`: the reader opens it."""

    title: str
    parts: Sequence["Part"] = field(default_factory=list)
    folded: bool = False


Part = Line | Note | Block | Table | Bullets | LabelledTexts | Picture | Verdict | Section | None


# As HTML


def html(part: Part, level: int = 2) -> str:
    """Return a part as an element of a page; `level`: of a section's heading."""
    match part:
        case None | "":
            return ""
        case Section(title, parts, folded):
            body = "".join(html(one, level + 1) for one in parts)
            name = tags.text(title)
            if folded:
                return body and f"<details><summary>{name}</summary>{body}</details>"
            about = f' id="{name}"' if level == 2 else ""
            return body and f"<h{level}{about}>{name}</h{level}>{body}"
        case Table(head, rows, right):
            cells = [[*map(_inline, row)] for row in rows]
            return tags.table([*map(_inline, head)], cells, right) if cells else ""
        case LabelledTexts(texts):
            rows = [(label, line) for label, own in texts.items() for line in _each(own)]
            return html(Table(("", ""), rows))
        case Bullets(lines):
            items = "".join(f"<li>{_inline(line)}</li>" for line in lines)
            return items and f"<ul>{items}</ul>"
        case Picture(png, shows):
            return tags.image(png, shows)
        case Verdict(word, reasons, good):
            body = f"Verdict: {_inline(Strong(word))}{html(Bullets(reasons))}"
            return f'<div class="verdict{" ok" * good}">{body}</div>'
        case Note():
            return f'<p class="note">{tags.text(part)}</p>'
        case Block():
            return f"<pre>{tags.text(part)}</pre>"
        case _:
            return f"<p>{_inline(part)}</p>"


def _inline(value: Line) -> str:
    if isinstance(value, tuple):
        return "".join(map(_inline, value))
    if isinstance(value, Link):
        return f'<a href="./{tags.text(value.to)}">{tags.text(value)}</a>'
    tag = "code" if isinstance(value, Code) else "b" if isinstance(value, Strong) else ""
    return f"<{tag}>{tags.text(value)}</{tag}>" if tag else tags.text(value)


# As Markdown


def markdown(part: Part, level: int = 3) -> str:
    """Return a part as Markdown, with the end of its last line; `level`: of a section's heading."""
    match part:
        case None | "":
            return ""
        case Section(title, parts, folded):
            body = "\n".join(filter(None, (markdown(one, level + 1) for one in parts)))
            if folded:
                return body and f"<details><summary>{title}</summary>\n\n{body}\n</details>\n"
            return body and f"{'#' * level} {title}\n\n{body}"
        case Table(head, rows, right):
            rule = ["---:" if i in right else "---" for i in range(len(head))]
            lines = [[*map(_plain, head)], rule, *([*map(_plain, row)] for row in rows)]
            return "".join(f"| {' | '.join(row)} |\n" for row in lines) if rows else ""
        case LabelledTexts(texts):
            return markdown(
                Bullets([(Strong(k), ": ", "; ".join(_each(v))) for k, v in texts.items()])
            )
        case Bullets(lines):
            return "".join(f"- {_plain(line)}\n" for line in lines)
        case Picture(_, shows, file):
            return f"![{_plain(shows)}]({file})\n" if file else ""
        case Verdict(word, reasons):
            return f"Verdict: **{_plain(word)}**\n" + markdown(Bullets(reasons))
        case Block():
            return f"```\n{part}\n```\n"
        case _:
            return f"{_plain(part)}\n"


def _plain(value: Line) -> str:
    """Return a line that stays in its cell."""
    if isinstance(value, tuple):
        return "".join(map(_plain, value))
    text = str(value).replace("|", "\\|").replace("\n", " ").replace("`", "'")
    mark = "`" if isinstance(value, Code) else "**" if isinstance(value, Strong) else ""
    return f"{mark}{text}{mark}"


# For a terminal


def terminal(part: Part) -> list[str]:
    """Return a part as lines; no pictures, no files, nothing folded; too broad a table: a list."""
    match part:
        case None | "" | Picture() | Block() | Section(folded=True):
            return []
        case Section(title, parts):
            body = [line for one in parts for line in terminal(one)]
            return body and [*screen.wrapped_lines(title, rest="  "), *body, ""]
        case Table(_, []):
            return []
        case Table(head, rows, right):
            cells = [[*map(_bare, row)] for row in (head, *rows)]
            broad = sum(max(map(len, column)) + 2 for column in zip(*cells, strict=True))
            if broad <= screen.width():
                return screen.table(cells if any(head) else cells[1:], [*right])
            return [line for row in cells[1:] for line in _row_lines(cells[0], row)]
        case LabelledTexts(texts, width, indent):
            return [
                line
                for label, own in texts.items()
                for number, text in enumerate(_each(own))
                for line in screen.wrapped_lines(text, f"{indent}{'' if number else label:{width}}")
            ]
        case Bullets(lines):
            return [one for line in lines for one in screen.wrapped_lines(_bare(line), "  ")]
        case Verdict(word, reasons):
            return [f"verdict: {word}", *terminal(Bullets(reasons))]
        case _:
            return screen.wrapped_lines(_bare(part), rest="  ")


def _row_lines(head: Sequence[str], row: Sequence[str]) -> list[str]:
    told = (f"{what} {cell}" for what, cell in zip(head[1:], row[1:], strict=True) if cell)
    return [row[0], *screen.wrapped_lines(", ".join(told), "  ")]


def _bare(value: Line) -> str:
    return "".join(map(_bare, value)) if isinstance(value, tuple) else str(value)


def _each(own: str | Sequence[str]) -> Sequence[str]:
    return [own] if isinstance(own, str) else own


def show(lines: Iterable[str], width: int) -> None:
    """Print lines; their labels, as wide as that, are bold on a terminal."""
    bold = is_terminal()
    for line in lines:
        label, rest = line[:width], line[width:]
        print(f"\x1b[1m{label}\x1b[0m{rest}" if bold and label else line)


def is_terminal() -> bool:
    """Return whether stdout shows bold letters; TTY_COMPATIBLE and FORCE_COLOR can say so."""
    environment = os.environ.get
    if environment("TERM", "").lower() in ("dumb", "unknown"):
        return False
    if (wanted := environment("TTY_COMPATIBLE")) in ("0", "1"):
        return wanted == "1"
    if (forced := environment("FORCE_COLOR")) is not None:
        return forced != ""
    return sys.stdout.isatty()

"""Text for a terminal: it fits the width, and what is cut into lines can still be copied.

Without a terminal the width is 80, or what COLUMNS says.
"""

import argparse
import math
import re
import shutil
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

_NARROWEST = 60  # below that nothing can be aligned any more
_AHEAD = re.compile(r"\A {,15}(\S(.{,20}?\S)? {2,12}(?=\S))?")  # blanks, a label, blanks
_WORD = re.compile(r"""(?:[^\s"']|"[^"]*"|'[^']*')+""")

# what a terminal obeys, or shows in another order; then what this program itself says to one
_OBEYED = r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]"
_CONTROL = re.compile(_OBEYED)
_OWN = re.compile(  # colours; a line in place of another; lines in place of those above
    rf"(\x1b\[[\d;]*m|(?:\A(?:\x1b\[\d+A)?|(?<=\n))\r\x1b\[K|\r\n)|{_OBEYED}"
)


class Help(argparse.RawDescriptionHelpFormatter):
    """Keeps the lines of a description or epilog, and wraps those that are too long."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines = []
        for line in text.splitlines():
            blanks = " " * (len(line) - len(line.lstrip()) + 2)
            lines += textwrap.wrap(
                line,
                width,
                initial_indent=indent,
                subsequent_indent=indent + blanks,
                break_on_hyphens=False,
            ) or [""]
        return "\n".join(lines)


def clean(text: str) -> str:
    r"""Return `text` of others with `\x1b` and the like spelt out: no terminal obeys it."""
    return _CONTROL.sub(_spelt, text)


def without_foreign_codes(text: str) -> str:
    """Return `text` in which only the few codes of this program itself are left."""
    return _OWN.sub(lambda found: found[1] or _spelt(found), text)


def _spelt(found: re.Match[str]) -> str:
    return found[0].encode("unicode_escape").decode()


def width() -> int:
    """Return the columns that a line may take."""
    return max(shutil.get_terminal_size().columns, _NARROWEST)


def wrapped_lines(text: str, first: str = "", rest: str | None = None) -> list[str]:
    """Return `text` as lines behind `first`, the following ones behind `rest` or as many blanks.

    A word that is longer than the line is cut.
    """
    after = " " * len(first) if rest is None else rest
    lines = textwrap.wrap(
        text, width(), initial_indent=first, subsequent_indent=after, break_on_hyphens=False
    )
    return [line.rstrip() for line in lines] or [first.rstrip()]


def fitted(lines: Iterable[str]) -> Iterator[str]:
    """Yield lines that fit; a longer one goes on below the text behind its label, or further in."""
    for line in lines:
        text = _AHEAD.sub("", line)
        ahead = line[: len(line) - len(text)]
        after = len(ahead) + (0 if ahead.strip() else 2)
        yield from wrapped_lines(text, ahead, " " * after)


def table(lines: Sequence[Sequence[str]], right: Sequence[int] = ()) -> list[str]:
    """Return rows with aligned columns, those of `right` to the right, the last one wrapped."""
    sizes = [max(map(len, column)) for column in zip(*lines, strict=True)]
    found = []
    for line in lines:
        *cells, last = (
            f"{text:{'>' if i in right else ''}{sizes[i]}}  " for i, text in enumerate(line)
        )
        found += wrapped_lines(last, "".join(cells))
    return found


def some(texts: Sequence[str], most: int, more: str = "and {} more, see --json") -> list[str]:
    """Return the first texts, at most as many; then `more`, with the count of those left out."""
    return [*texts[:most], *[more.format(len(texts) - most)] * (len(texts) > most)]


def answer(as_json: bool, found: Any, lines: Iterable[str], indent: int | None = None) -> None:
    """Print what was found as JSON, or its lines, fitted; none of them is made for JSON."""
    print(json_text(found, indent) if as_json else "\n".join(fitted(lines)))


def json_text(found: Any, indent: int | None = 2) -> str:
    """Return JSON of plain values and structs; what is not finite, which it lacks, becomes text."""
    import json  # time

    return json.dumps(_json_value(found), indent=indent)


def _json_value(value: Any) -> Any:
    if hasattr(value, "__struct_fields__"):
        import msgspec  # time

        value = msgspec.to_builtins(value)
    if isinstance(value, Mapping):
        return {key: _json_value(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(child) for child in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def shell(command: str) -> list[str]:
    r"""Return a shell command as lines to copy, continued with `\`; quoted words stay whole."""
    room, lines = width() - len("   \\"), [""]
    for word in _WORD.findall(command):
        if lines[-1] and len(lines[-1]) + 1 + len(word) > room:
            lines.append("  " + word)
        else:
            lines[-1] = f"{lines[-1]} {word}" if lines[-1] else word
    return [f"  {line} \\" for line in lines[:-1]] + [f"  {lines[-1]}"]

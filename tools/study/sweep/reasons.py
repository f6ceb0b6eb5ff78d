"""Why runs failed, counted: reasons that differ in numbers alone are one, with their range."""

import re
from collections.abc import Iterable, Sequence

_NUMBER = re.compile(r"(?<![\w.])-?(?:\d+(?:,\d{3})*(?:\.\d+)?(?:e[-+]?\d+)?|inf)(?!\w)")


def count_reasons(texts: Iterable[str], names: Sequence[str] = ()) -> list[tuple[str, int]]:
    """Return reasons and how often each is there, the most frequent first.

    `names`: of requirements, in which a number is no value.
    """
    found: dict[tuple[str, ...], list[list[str]]] = {}
    kept = "|".join(re.escape(name) for name in sorted(names, key=len, reverse=True) if name)
    begin = re.compile(kept) if kept else re.compile(r"(?!)")
    for text in texts:
        name = match[0] if (match := begin.match(text)) else ""
        rest = text[len(name) :]
        numbers = [match[0] for match in _NUMBER.finditer(rest)]
        found.setdefault((name, *_NUMBER.split(rest)), []).append(numbers)
    rows = [(_text(*parts, numbers=all_of), len(all_of)) for parts, all_of in found.items()]
    return sorted(rows, key=lambda row: -row[1])


def _text(name: str, first: str, *rest: str, numbers: Sequence[Sequence[str]]) -> str:
    """Return what reasons have in common, each of their numbers as a range."""
    ranges = [_range(column) for column in zip(*numbers, strict=True)]
    return name + first + "".join(f"{a}{b}" for a, b in zip(ranges, rest, strict=True))


def _range(numbers: Sequence[str]) -> str:
    ordered = sorted(numbers, key=_value)
    low, high = ordered[0], ordered[-1]
    return low if _value(low) == _value(high) else f"{low} to {high}"


def _value(text: str) -> float:
    return float(text.replace(",", ""))

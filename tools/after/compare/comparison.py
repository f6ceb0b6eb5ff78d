"""All pairs of a comparison, and what is told of them: on a terminal, in Markdown, as JSON."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

from pcpc.tools.after.compare.pair import ALONE, CHANGED, EQUAL, FAILED, UNCHANGED, Change, Pair
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.terminal import screen

_METRICS, _SIGNALS, _SETTINGS = 6, 3, 4  # shown of a rig; all of them in JSON
_LONGEST = 40  # letters of a value
_LABEL = "  {:9}"
_HEAD = """| rig | first difference | metric | old | new | change |
| --- | --- | --- | ---: | ---: | ---: |"""


@dataclass
class Comparison:
    """What came of comparing `old` with `new`, pair by pair."""

    old: str
    new: str
    pairs: list[Pair] = field(default_factory=list)

    def of(self, *states: str) -> list[Pair]:
        """Return the pairs in one of these states."""
        return [pair for pair in self.pairs if pair.state in states]

    @property
    def changed(self) -> bool:
        """Something differs, or is on one side only, or could not be compared."""
        return bool(self.of(CHANGED, ALONE, FAILED))

    def fails(self, on: str = "any") -> bool:
        """Return whether it differs in what counts: anything, a metric, a verdict."""
        counts = {
            "any": self.changed,
            "metrics": any(pair.changed_metrics or pair.verdict.differs for pair in self.pairs),
            "verdict": any(pair.verdict.differs for pair in self.pairs),
            "never": False,
        }
        return counts[on] or (on != "never" and bool(self.of(FAILED)))

    @property
    def counts(self) -> str:
        """How many are in which state, in words."""
        words = {
            CHANGED: "changed", EQUAL: "equal", UNCHANGED: "unchanged", ALONE: "on one side only",
            FAILED: "not compared",
        }  # fmt: skip
        told = [f"{n} {word}" for state, word in words.items() if (n := len(self.of(state)))]
        return ", ".join(told) or "nothing to compare"

    def text(self) -> str:
        """Return what a terminal shows."""
        lines = screen.wrapped(f"{self.old} -> {self.new}: {self.counts}", rest="  ")
        for pair in self.of(CHANGED):
            lines += ["", *_block(pair)]
        for state, word in ((ALONE, "on one side only"), (FAILED, "not compared")):
            for pair in self.of(state):
                text = f"{pair.name}: {'; '.join(pair.said) or word}"
                lines += ["", *screen.wrapped(text, rest="  ")]
        for state, word in ((EQUAL, "equal to the bit"), (UNCHANGED, "unchanged, not run")):
            if names := ", ".join(_names(self.of(state))):
                lines += ["", *screen.wrapped(f"{word}: {names}", rest="  ")]
        return "\n".join(lines)

    def markdown(self, pictures: bool = False) -> str:
        """Return a table for a pull request and what does not fit into it, maybe `pictures`."""
        old, new = _cell(self.old), _cell(self.new)
        parts = [f"### pcpc compare: {self.counts}\n\n`{old}` → `{new}`\n"]
        if rows := [row for pair in self.of(CHANGED) for row in _rows(pair)]:
            parts.append("\n".join((_HEAD, *(f"| {' | '.join(row)} |" for row in rows), "")))
        for pair in self.of(ALONE, FAILED):
            parts.append(f"- **{_cell(pair.name)}**: {_cell('; '.join(pair.said))}\n")
        if more := [line for pair in self.of(CHANGED) for line in _more(pair)]:
            parts.append(_details("what else differs", "\n".join(more)))
        for state, word in ((EQUAL, "equal to the bit"), (UNCHANGED, "unchanged, not run")):
            if names := ", ".join(map(_cell, _names(self.of(state)))):
                parts.append(_details(f"{len(self.of(state))} {word}", names))
        parts += [
            f"![{_cell(pair.name)}]({pair.figure})\n"
            for pair in self.pairs if pictures and pair.figure
        ]  # fmt: skip
        return "\n".join(parts)

    def as_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        return {"changed": self.changed, "counts": self.counts, **asdict(self)}

    def json(self) -> str:
        """Return everything as JSON; NaN and infinity are text."""
        return summary_file.text_of(self.as_dict())


def _details(title: str, text: str) -> str:
    return f"<details><summary>{title}</summary>\n\n{text}\n\n</details>\n"


def _names(pairs: list[Pair]) -> list[str]:
    """Return the rigs, those with several controllers once."""
    found: dict[str, list[str]] = {}
    for pair in pairs:
        found.setdefault(pair.rig, []).append(pair.controller)
    return [f"{rig} ({', '.join(dict.fromkeys(laws))})" for rig, laws in found.items()]


def _where(pair: Pair) -> str:
    """Return where a pair parts."""
    first = pair.first
    if first is None:
        return "in no recorded signal"
    return f"from cycle {first.cycle} ({first.time_s:.3f} s) on, first {first.name}"


def _block(pair: Pair) -> Iterator[str]:
    """Yield the lines of a changed pair for a terminal."""
    yield from screen.wrapped(f"{pair.name}: differs {_where(pair)}", rest="  ")
    for label, texts in (
        ("rig", _settings(pair)), ("verdict", _verdict(pair)), ("signals", _signals(pair)),
        ("also", pair.said),
    ):  # fmt: skip
        for number, text in enumerate(texts):
            yield from screen.wrapped(text, _LABEL.format("" if number else label))
    shown = pair.changed_metrics[:_METRICS]
    rows = [(c.name, (v := _values(c))[0], "->", v[1], _percent(c)) for c in shown]
    lines = screen.table(rows, right=(1, 3, 4)) if rows else []
    indent = len(_LABEL.format(""))
    if len(lines) > len(rows) or any(indent + len(line) > screen.width() for line in lines):
        lines = [" ".join(row) for row in rows]  # too broad for a table
    for number, line in enumerate(lines):
        label = _LABEL.format("" if number else "metrics")
        short = indent + len(line) <= screen.width()
        yield from [label + line] if short else screen.wrapped(line, label)
    if left := len(pair.changed_metrics) - len(shown):
        yield _LABEL.format("") + f"and {left} more, see --json"
    if pair.figure:
        yield _LABEL.format("figure") + pair.figure


def _rows(pair: Pair) -> Iterator[tuple[str, ...]]:
    """Yield the rows of a changed pair: its verdict, then its metrics."""
    changes = pair.changed_metrics[: _METRICS - 1]
    if pair.verdict.differs or not changes:
        changes = [pair.verdict, *changes]
    for number, one in enumerate(changes):
        name, first = (_cell(pair.name), _cell(_where(pair))) if not number else ("", "")
        percent = "**changed**" if one is pair.verdict and one.differs else _percent(one)
        yield name, first, _cell(one.name), *map(_cell, _values(one)), percent


def _more(pair: Pair) -> Iterator[str]:
    """Yield a list item with what the table does not say of a pair."""
    texts = [*_settings(pair), *_signals(pair), *pair.said]
    rest = pair.changed_metrics[_METRICS - 1 :]
    texts += [_told(one) for one in rest]
    if texts:
        yield f"- **{_cell(pair.name)}**: {_cell('; '.join(texts))}"


def _settings(pair: Pair) -> list[str]:
    told = [_told(one) for one in pair.settings[:_SETTINGS]]
    left = len(pair.settings) - len(told)
    return told + [f"and {left} more values"] * (left > 0)


def _verdict(pair: Pair) -> list[str]:
    return [f"{pair.verdict.old} -> {pair.verdict.new}"] if pair.verdict.differs else []


def _signals(pair: Pair) -> list[str]:
    """Return the signals that differ most, and how many there are."""
    most = [
        f"{s.name} by up to {s.largest:.3g} at {s.at_s:.3f} s"
        + (f" ({100 * s.share:.2g} % of its range)" if math.isfinite(s.share) else "")
        for s in pair.outside[:_SIGNALS]
    ]
    left = len(pair.signals) - len(most)
    return most + [f"and {left} more signals, {pair.frames} kinds of frames"] * (left > 0)


def _told(one: Change) -> str:
    return f"{one.name} {' -> '.join(_values(one))}"


def _values(one: Change) -> tuple[str, str]:
    """Return old and new, with as many digits as it takes to tell them apart."""
    for digits in range(4, 18):
        told = _value(one.old, digits), _value(one.new, digits)
        if told[0] != told[1]:
            break
    return told


def _value(value: Any, digits: int) -> str:
    text = f"{value:.{digits}g}" if isinstance(value, float) else str(value)
    return "none" if value is None else text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def _percent(one: Change) -> str:
    percent = 100 * one.relative
    if math.isnan(percent):
        return ""
    return f"{percent:+.1f} %" if abs(percent) >= 0.1 else f"{percent:+.1g} %"


def _cell(text: str) -> str:
    """Return a text that stays in its cell."""
    return text.replace("|", "\\|").replace("\n", " ").replace("`", "'")

"""All pairs of a comparison, and what is told of them: on a terminal, in Markdown, as JSON."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from msgspec import Struct, to_builtins

from pcpc.tools.after.compare.pair import ALONE, CHANGED, EQUAL, FAILED, UNCHANGED, Pair
from pcpc.tools.after.differences import Change
from pcpc.tools.after.log.diff import DifferentBits, plain
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.document import (
    Bullets,
    Code,
    LabelledTexts,
    Part,
    Picture,
    Section,
    Strong,
    Table,
    markdown,
    terminal,
)

_METRICS, _SIGNALS, _SETTINGS = 6, 3, 4  # shown of a rig; all of them in JSON
_LONGEST = 40  # letters of a value
_INDENT, _LABEL = "  ", 9  # letters of a label
_HEAD = "rig", "first difference", "metric", "old", "new", "change"
_APART = {ALONE: "on one side only", FAILED: "not compared"}

_MOST_PERCENT = 1e6  # that is printed in full; more is a run that diverged


@dataclass
class PairFacts(Pair):
    """A rig in two runs."""

    first: DifferentBits | None = None  # type: ignore[assignment]


class ComparisonFacts(Struct):
    """What runs differ in."""

    changed: bool
    "something differs, is on one side only or could not be compared"
    counts: str
    "of pairs in each state, in words"
    old: str
    "side A, as given"
    new: str
    "side B, as given"
    pairs: list[PairFacts]


@dataclass
class Comparison:
    """The comparison of `old` with `new`, pair by pair."""

    old: str
    new: str
    pairs: list[Pair] = field(default_factory=list)

    def of(self, *states: str) -> list[Pair]:
        """Return the pairs in one of these states."""
        return [pair for pair in self.pairs if pair.state in states]

    @property
    def changed(self) -> bool:
        """Whether something differs, is on one side only, or could not be compared."""
        return bool(self.of(CHANGED, ALONE, FAILED))

    def fails(self, on: str = "any") -> bool:
        """Return whether it differs in `on`: any, metrics, verdict, never.

        True also if something cannot be classified or is on one side only, or nothing was compared.
        """
        if on == "never":
            return False
        changed = self.of(CHANGED)
        alone = any(not pair.allowed for pair in self.of(ALONE))
        if alone or self.of(FAILED) or not self.of(CHANGED, EQUAL, UNCHANGED):
            return True
        if on == "any":
            return bool(changed)
        metrics = on == "metrics" and any(pair.changed_metrics for pair in changed)
        verdict = any(pair.verdict.differs for pair in changed)
        unknown = any(on in pair.unknown for pair in self.of(CHANGED, EQUAL))
        return metrics or verdict or unknown

    @property
    def counts(self) -> str:
        """How many pairs are in which state, in words."""
        words = {CHANGED: "changed", EQUAL: "equal", UNCHANGED: "unchanged", **_APART}
        told = [f"{n} {word}" for state, word in words.items() if (n := len(self.of(state)))]
        return ", ".join(told) or "nothing to compare"

    def commits(self) -> list[str]:
        """Return a line for each pair of commits of the rigs, if both sides name one."""
        found: dict[str, list[Pair]] = {}
        for pair in self.pairs:
            if pair.commit.old and pair.commit.new and pair.commit.differs:
                found.setdefault(f"{pair.commit.old} -> {pair.commit.new}", []).append(pair)
        return [f"commit of the rig {two}: {_names(pairs)}" for two, pairs in found.items()]

    def text(self) -> str:
        """Return the text for a terminal."""
        parts = [terminal(f"{self.old} -> {self.new}: {self.counts}")]
        parts += [terminal(line) for line in self.commits()]
        parts += [_block(pair) for pair in self.of(CHANGED)]
        for state, word in _APART.items():
            parts += [
                terminal(f"{pair.name}: {'; '.join(pair.said) or word}") for pair in self.of(state)
            ]
        equal = [terminal(_equal_text(pair)) for pair in self.of(EQUAL)]
        parts.append([line for lines in equal for line in lines])
        if names := _names(self.of(UNCHANGED)):
            parts.append(terminal(f"unchanged, not run: {names}"))
        return "\n\n".join("\n".join(lines) for lines in parts if lines)

    def markdown(self, pictures: bool = False) -> str:
        """Return a table for a pull request and the rest below it, with `pictures` if asked."""
        changed = self.of(CHANGED)
        rows = [row for pair in changed for row in _rows(pair)]
        more = [line for pair in changed for line in _more(pair)]
        parts: list[Part] = [(Code(self.old), " → ", Code(self.new)), Table(_HEAD, rows, (3, 4, 5))]
        parts += [
            Bullets([(Strong(pair.name), f": {'; '.join(pair.said)}")])
            for pair in self.of(ALONE, FAILED)
        ]
        parts.append(Bullets(self.commits()))
        parts.append(Section("what else differs", [Bullets(more)], folded=True))
        equal, same = self.of(EQUAL), self.of(UNCHANGED)
        lines = [Bullets([_equal_text(pair) for pair in equal])]
        parts.append(Section(f"{len(equal)} equal to the bit", lines, folded=True))
        parts.append(Section(f"{len(same)} unchanged, not run", [_names(same)], folded=True))
        parts += [
            Picture(b"", pair.name, pair.figure)
            for pair in (self.pairs if pictures else ())
            if pair.figure
        ]
        return markdown(Section(f"pcpc compare: {self.counts}", parts))

    def as_dict(self) -> dict[str, Any]:
        """Return everything, for JSON."""
        pairs = [PairFacts(**vars(one) | {"first": _first(one)}) for one in self.pairs]
        told = ComparisonFacts(self.changed, self.counts, self.old, self.new, pairs)
        return dict(to_builtins(told))

    def json(self) -> str:
        """Return everything as JSON; NaN and infinity are text."""
        return screen.json_text(self.as_dict())


def _names(pairs: list[Pair]) -> str:
    """Return the rigs, those with several controllers once."""
    found: dict[str, list[str]] = {}
    for pair in pairs:
        found.setdefault(pair.rig, []).append(pair.controller)
    return ", ".join(f"{rig} ({', '.join(dict.fromkeys(laws))})" for rig, laws in found.items())


def _first(pair: Pair) -> DifferentBits | None:
    return None if pair.first is None else plain(pair.first)


def _divergence_text(pair: Pair) -> str:
    """Return where a pair parts."""
    first = pair.first
    if first is None:
        return "in no recorded signal"
    return f"from cycle {first.cycle} ({first.time_s:.3f} s) on, first {first.label}"


def _equal_text(pair: Pair) -> str:
    """Return what is known of an equal pair: what was compared, and the verdict of both."""
    verdict = pair.verdict.new or "not compared, there are no two summaries"
    told = [f"equal to the bit, {pair.checked}", f"verdict {verdict}", *pair.said]
    return f"{pair.name}: {'; '.join(told)}"


def _block(pair: Pair) -> list[str]:
    """Return the lines of a changed pair for a terminal."""
    texts = {
        "compared": [pair.checked],
        "rig": _settings(pair),
        "verdict": [f"{pair.verdict.old} -> {pair.verdict.new}"] * pair.verdict.differs,
        "signals": _signals(pair),
        "also": pair.said, "metrics": _metrics(pair), "figure": [pair.figure] * bool(pair.figure),
    }  # fmt: skip
    head = f"{pair.name}: differs {_divergence_text(pair)}"
    return [*terminal(head), *terminal(LabelledTexts(texts, _LABEL, _INDENT))]


def _metrics(pair: Pair) -> list[str]:
    """Return the metrics that changed most, in columns where these are not too broad."""
    shown = pair.changed_metrics[:_METRICS]
    rows = [(one.name, (v := _values(one))[0], "->", v[1], _percent(one)) for one in shown]
    lines = screen.table(rows, right=(1, 3, 4)) if rows else []
    room = screen.width() - _LABEL - len(_INDENT)
    if len(lines) > len(rows) or any(len(line) > room for line in lines):
        lines = [" ".join(row) for row in rows]
    left = len(pair.changed_metrics) - len(shown)
    return lines + [f"and {left} more, see --json"] * (left > 0)


def _rows(pair: Pair) -> Iterator[tuple[str, ...]]:
    """Yield the rows of a changed pair: its verdict, then its metrics."""
    changes: list[Change[Any]] = [*pair.changed_metrics[: _METRICS - 1]]
    if pair.verdict.differs or not changes:
        changes = [pair.verdict, *changes]
    for number, one in enumerate(changes):
        name, first = ("", "") if number else (pair.name, _divergence_text(pair))
        percent = Strong("changed") if one is pair.verdict and one.differs else _percent(one)
        yield name, first, one.name, *_values(one), percent


def _more(pair: Pair) -> Iterator[tuple[str, ...]]:
    """Yield what the table does not say of a pair."""
    texts = [*_settings(pair), *_signals(pair), *pair.said]
    texts += [_change_text(one) for one in pair.changed_metrics[_METRICS - 1 :]]
    if texts:
        yield Strong(pair.name), f": {'; '.join(texts)}"


def _settings(pair: Pair) -> list[str]:
    return screen.some(
        [_change_text(one) for one in pair.settings], _SETTINGS, "and {} more values"
    )


def _signals(pair: Pair) -> list[str]:
    """Return the signals that differ most, and how many there are."""
    most = [
        f"{s.name} by up to {s.largest:.3g} at {s.at_s:.3f} s"
        + (f" ({100 * s.share:.2g} % of its range)" if math.isfinite(s.share) else "")
        for s in pair.outside[:_SIGNALS]
    ]
    left = len(pair.signals) - len(most)
    return most + [f"and {left} more signals, {pair.frames} kinds of frames"] * (left > 0)


def _change_text(one: Change[Any]) -> str:
    return f"{one.name} {' -> '.join(_values(one))}"


def _values(one: Change[Any]) -> tuple[str, str]:
    """Return old and new, with as many digits as it takes to tell them apart."""
    for digits in range(4, 18):
        told = _value(one.old, digits), _value(one.new, digits)
        if told[0] != told[1]:
            break
    return told


def _value(value: Any, digits: int) -> str:
    text = f"{value:.{digits}g}" if isinstance(value, float) else str(value)
    return "none" if value is None else text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def _percent(one: Change[Any]) -> str:
    percent = 100 * one.relative
    if math.isnan(percent):
        return ""
    if abs(percent) >= _MOST_PERCENT:
        return f"{percent:+.1e} %"
    return f"{percent:+.1f} %" if abs(percent) >= 0.1 else f"{percent:+.1g} %"

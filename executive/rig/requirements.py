"""Requirements in time: what a rig file, or a test, says that has to hold in a run, and when.

    always: C  [until: C  [within: D]]          in every cycle; until another condition holds, which
                                                it has to within D of the begin
    never: C                                    in no cycle
    when: E  then: C  [within: D]  [for: D]     at most D after each event C begins to hold, for D
    settles: V  into: V  [to: V]  [when: E]  [within: D]  [for: D]
                                                |settles - to| <= into from D after each event on:
                                                to the next event, or once for the D of `for`
    overshoot: V  over: V  at_most: V  [when: E]
                                                past the reference `over` after its step, in the
                                                step's direction; at_most as 10 % of the step
    rate: V  at_most: V                         the change a second, up and down
    after: T, before: T                         only cycles k with after <= k T < before; of a form
                                                with events: only events in there

C is a condition, V a value of `rig.expressions`; D, T are as 200ms, 1.5s, 2min. An event E is
`V changes`, a condition (as it becomes true) or a time. Within D means k T <= D: closed intervals.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from pcpc.executive.durations import duration_ns
from pcpc.executive.laws.units import NONE
from pcpc.executive.rig import expressions as ex
from pcpc.executive.rig import schema
from pcpc.executive.rig.expressions import Condition, ExpressionError, Units, Value

_SPOKEN = (  # the order of the keys in a sentence
    "when", "always", "never", "settles", "overshoot", "rate", "to", "into", "over", "at_most",
    "until", "within", "then", "for", "after", "before",
)  # fmt: skip
_ALSO = ("after", "before", "id", "name", "controllers")
_FORMS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {  # needs, and may have
    "always": ((), ("until", "within")),
    "never": ((), ()),
    "then": (("when",), ("within", "for")),
    "settles": (("into",), ("to", "when", "within", "for")),
    "overshoot": (("over", "at_most"), ("when",)),
    "rate": (("at_most",), ()),
}
_LONGEST_NS = 10**15  # the longest run
_CHANGES = re.compile(r"(.+?)\s+changes\s*")
_TIME = re.compile(r"[0-9]{1,9}(\.[0-9]{1,9})?(ms|s|min)")
PAST, LIMIT = "past the reference", "limit"  # columns that are made of others; no names


class RequirementError(ValueError):
    """What is wrong with a requirement, at which of its keys; `number` of it, of several."""

    number = 0

    def __init__(self, key: str, what: str) -> None:
        super().__init__(f"{key}: {what}" if key else what)
        self.keys, self.what = (key,) if key else (), what


@dataclass(frozen=True)
class Event:
    """What an obligation begins with: a value that changes, a condition that comes, a time."""

    changes: Value | None = None
    becomes: Condition | None = None
    at_s: float = 0.0


@dataclass(frozen=True)
class Overshoot:
    """How far a value goes past a reference after a step; the limit as a number or a share."""

    value: Value
    over: Value
    limit: float
    relative: bool


@dataclass(frozen=True)
class TimedRequirement:
    """A requirement that can be judged: `holds`, from when, until when. Times in s.

    `lasts_s`: once for so long; None: to the next event, or to the end.
    """

    text: str
    holds: Condition
    event: Event | None = None
    until: Condition | None = None
    within_s: float | None = None
    lasts_s: float | None = None
    window_s: tuple[float, float] = (0.0, np.inf)
    overshoot: Overshoot | None = None

    @property
    def names(self) -> frozenset[str]:
        """The variables that it is about."""
        event, past = self.event or Event(), self.overshoot
        parts = [self.holds, self.until, event.changes, event.becomes]
        parts += [past.value, past.over] if past else []
        found = frozenset[str]().union(*(part.names for part in parts if part is not None))
        return found - {PAST, LIMIT}


def text_of(entry: schema.Requirement) -> str:
    """Return a requirement's name, or what it says, behind its id if it has one."""
    words = entry.name or _sentence(entry)
    return f"{entry.id} {words}" if entry.id else words


def _sentence(entry: schema.Requirement) -> str:
    """Return what a requirement says."""
    given: dict[str, Any] = msgspec.to_builtins(entry)
    words = ", ".join(f"{key.replace('_', ' ')} {given[key]}" for key in _SPOKEN if key in given)
    return words.removeprefix("then ")


def timed_requirement(entry: schema.Requirement, units: Units) -> TimedRequirement:
    """Return a requirement with its names known and its units checked; RequirementError."""
    form = _form(entry)
    texts = {key: str(value) for key, value in msgspec.to_builtins(entry).items()}
    seconds = {key: _seconds(texts, key) for key in ("within", "for", "after", "before")}
    expressions = _Part(texts, units)
    window_s = seconds["after"] or 0.0, np.inf if (end := seconds["before"]) is None else end
    if not window_s[0] < window_s[1]:
        raise RequirementError("before", f"{texts['before']} is not later than after")
    event = expressions.event() if entry.when else None
    until, lasts_s, past = None, seconds["for"], None
    if form in ("always", "never", "then"):
        holds = expressions.condition(form)
        holds = holds.inverse() if form == "never" else holds
        until = expressions.condition("until") if entry.until else None
        lasts_s = lasts_s or 0.0 if form == "then" else None
    elif form == "settles":
        holds = expressions.settles()
    elif form == "overshoot":
        past, holds = expressions.overshoot()
        event = event or Event(changes=past.over)
    else:
        holds = expressions.rate()
    made = TimedRequirement(
        text_of(entry), holds, event, until, seconds["within"], lasts_s, window_s, past
    )
    if not made.names:
        raise RequirementError(form, "names no variable")
    return made


def _form(entry: schema.Requirement) -> str:
    """Return the key that tells the form; RequirementError for keys that do not go together."""
    keys = [key for key in msgspec.to_builtins(entry) if key not in _ALSO]
    forms = [key for key in keys if key in _FORMS]
    if len(forms) != 1:
        what = f"{' and '.join(forms)} in one" if forms else "no condition"
        raise RequirementError(
            forms[1] if forms else "", f"{what}; give one of {', '.join(_FORMS)}"
        )
    (form,) = forms
    needs, may = _FORMS[form]
    for key in needs:
        if key not in keys:
            raise RequirementError(form, f"key {key} is missing")
    for key in keys:
        if key not in (form, *needs, *may):
            known = ", ".join((*needs, *may, "after", "before"))
            raise RequirementError(key, f"does not go with {form}, which takes {known}")
    if entry.within and form == "always" and not entry.until:
        raise RequirementError("within", "needs until; for a part of a run give after, before")
    if entry.until and entry.before:
        raise RequirementError("before", "does not go with until; give within")
    return form


def _seconds(texts: Mapping[str, str], key: str) -> float | None:
    if key not in texts:
        return None
    ns = round(duration_ns(texts[key], zero=True))
    if ns > _LONGEST_NS:
        raise RequirementError(key, f"{texts[key]}: expected no more than 12 days")
    return 1e-9 * ns


class _Part:
    """The expressions of one requirement."""

    def __init__(self, given: Mapping[str, str], units: Units) -> None:
        self.given, self.units = given, units

    def condition(self, key: str) -> Condition:
        try:
            return ex.condition(self.given[key], self.units)
        except ExpressionError as error:
            raise RequirementError(key, str(error)) from None

    def value(self, key: str, text: str = "") -> Value:
        try:
            return ex.value(text or self.given[key], self.units)
        except ExpressionError as error:
            raise RequirementError(key, str(error)) from None

    def at_most(self, key: str, value: Value, limit: Value) -> Condition:
        """Return that a value is no larger than what `key` gives."""
        try:
            return ex.comparison(value, "<=", limit)
        except ExpressionError as error:
            raise RequirementError(key, str(error)) from None

    def event(self) -> Event:
        """Return the event of `when`."""
        text = self.given["when"].strip()
        if _TIME.fullmatch(text):
            return Event(at_s=1e-9 * round(duration_ns(text, zero=True)))
        if found := _CHANGES.fullmatch(text):
            return Event(changes=self.value("when", found[1]))
        return Event(becomes=self.condition("when"))

    def settles(self) -> Condition:
        """Return that a value is in the band around its goal."""
        about = f"({self.given['settles']}) - ({self.given['to']})" if "to" in self.given else ""
        one = self.value("to" if about else "settles", f"abs({about or self.given['settles']})")
        return self.at_most("into", one, self.value("into"))

    def rate(self) -> Condition:
        """Return that a value changes slowly enough."""
        one = self.value("rate", f"abs(rate({self.given['rate']}))")
        return self.at_most("at_most", one, self.value("at_most"))

    def overshoot(self) -> tuple[Overshoot, Condition]:
        """Return how an overshoot is measured, and that it is small enough."""
        value, over, limit = (self.value(key) for key in ("overshoot", "over", "at_most"))
        if limit.number is None:
            raise RequirementError("at_most", "expected a number, like 10 % or 2 mrad")
        relative = limit.unit is not None and limit.unit.text == "%"
        if not relative:
            self.at_most("at_most", value, limit)
            limit = limit.taken_as(value.unit)
        self.at_most("over", value, over)
        own = value.unit or over.unit or NONE
        overshoot = ex.column(PAST, own, text=f"overshoot of {value.text}")
        bound = ex.column(LIMIT, own)
        past = Overshoot(value, over, float(limit.number or 0), relative)
        return past, ex.comparison(overshoot, "<=", bound)

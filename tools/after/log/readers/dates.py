"""The dates of text recordings, English or German, or as in ISO 8601; in the local zone."""

import re
from datetime import datetime

from pcpc.tools.after.log.readers.account import ns_of

_MONTHS = {
    name: 1 + i % 12
    for i, name in enumerate(
        ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec",
         "jän", "feb", "mär", "apr", "mai", "jun", "jul", "aug", "sep", "okt", "nov", "dez")
    )
}  # fmt: skip
_CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d)(?:[.,](?P<part>\d+))?"
_WORDS = re.compile(
    rf"(?:[^\W\d]+\s+)?(?P<month>[^\W\d]+)\s+(?P<day>\d{{1,2}})\s+{_CLOCK}"
    r"(?:\s+(?P<half>am|pm))?\s+(?P<year>\d{4})",
    re.IGNORECASE,
)
_ISO = re.compile(rf"(?P<year>\d{{4}})-(?P<month>\d\d)-(?P<day>\d\d)[T ]{_CLOCK}(?P<half>)")


def date_ns(text: str) -> int | None:
    """Return the wall time of a date since 1970, ns; None if it is not understood."""
    match = _WORDS.fullmatch(text.strip()) or _ISO.fullmatch(text.strip())
    if match is None:
        return None
    month, half, hour = match["month"].lower(), (match["half"] or "").lower(), int(match["h"])
    if half:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + (12 if half == "pm" else 0)
    try:
        number = int(month) if month.isdigit() else _MONTHS[month]
        parts = (int(match[key]) for key in ("day", "m", "s"))
        day, minute, second = parts
        at = datetime(int(match["year"]), number, day, hour, minute, second)
        whole_s = round(at.timestamp())
    except (KeyError, ValueError, OverflowError):
        return None
    return whole_s * 10**9 + ns_of(f"0.{match['part'] or 0}") if whole_s >= 0 else None


def unknown_date(text: str) -> str:
    """Return the line for a date that is not understood."""
    return f"its date {text!r} is not understood: stamps count from 1970"

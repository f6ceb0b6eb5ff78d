"""Durations as people write them: `500us`, `5ms`, `10s`, `2min` or `2m`, `1h`."""

import re
from fractions import Fraction

_UNITS_NS = {
    "us": 10**3, "ms": 10**6, "s": 10**9, "m": 60 * 10**9, "min": 60 * 10**9, "h": 3600 * 10**9,
}  # fmt: skip
_WRITTEN = re.compile(r"([0-9]*\.?[0-9]*(?:[eE][-+]?[0-9]{1,2})?)([a-z]*)")


def duration_ns(text: str, unit: str = "", zero: bool = False) -> Fraction:
    """Return the ns of a duration, of a bare number in `unit`.

    ValueError, in words, for what is none; 0 is one if `zero`.
    """
    written = _WRITTEN.fullmatch(text)
    try:
        ns = Fraction(written[1]) * _UNITS_NS[written[2] or unit] if written else Fraction(-1)
    except (ValueError, KeyError):
        ns = Fraction(-1)
    if ns < 0 or (ns == 0 and not zero):
        raise ValueError(f"{text}: not a duration above 0; expected like 500us, 5ms, 10s, 2min")
    return ns


def duration_s(text: str, unit: str = "s") -> float:
    """Return the seconds of a duration, as `duration_ns`."""
    return float(duration_ns(text, unit) / 10**9)

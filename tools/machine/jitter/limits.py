"""The limits of a machine, as `pcpc jitter --limits` reads them.

    wake: {99.9: 100us}
    response: {99: 1.1ms, 99.99: 2ms}

By way (see `nines`), then by % of the cycles, the time below which the quantile's interval has to
end.
"""

import re
from fractions import Fraction
from pathlib import Path
from typing import Any

from msgspec import UNSET, UnsetType

from pcpc.executive.durations import duration_ns
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.conversion import convert
from pcpc.executive.rig.keyed import Keyed

_PERCENT = re.compile(r"[0-9]{1,2}(\.[0-9]{1,12})?", re.ASCII)
Times = dict[str, Any]


class _Limits(Keyed):
    wake: Times | UnsetType = UNSET
    command: Times | UnsetType = UNSET
    response: Times | UnsetType = UNSET


def read_limits(file: Path) -> dict[tuple[str, Fraction], float]:
    """Return the limits, us, by way and %; RigError with the place of what is wrong."""
    document = yamlfile.load(file)
    convert(document, document.data, _Limits, ())
    limits: dict[tuple[str, Fraction], float] = {}
    for way, times in document.data.items():
        for text, time in times.items():
            keys = (way, text)
            if not _PERCENT.fullmatch(text) or not Fraction(text):
                what = "expected a percentage above 0 and below 100, like 99.9"
                raise document.error(keys, f"{what}, with at most 12 decimals")
            key = (way, Fraction(text))
            if key in limits:
                raise document.error(keys, "given twice, in other digits; remove one of the two")
            try:
                limits[key] = float(duration_ns(str(time)) / 1000)
            except ValueError as error:
                raise document.error(keys, str(error)) from None
    if not limits:
        raise document.error((), "no limit in it; expected like `wake: {99.9: 100us}`")
    return limits

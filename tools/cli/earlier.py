"""Words of `pcpc` that have another name now: for one release they work, and say so."""

import shlex
from collections.abc import Sequence

_NOW = {
    "exec": "run --only executive",
    "plant": "run --only plant",
    "local": "run --only local",
    "list": "get --long",
    "a2l": "generate a2l",
    "step": "replay",
    "verify": "replay --brief",
    "log cat": "log export -o -",
    "log diff": "compare --bits",
    "log require": "report --requirements",
    "log animate": "log plot --moving",
    **{verb: f"operate {verb}" for verb in ("reset", "arm", "hold", "resume", "lock", "handover")},
}


def present_words(words: Sequence[str]) -> tuple[list[str], str]:
    """Return a command line as it is written now, and what is said of that; "": it is so."""
    for count in (2, 1):
        name = " ".join(words[:count])
        if len(words) >= count and (now := _NOW.get(name)):
            rest = [*words[count:]]
            if name == "log diff" and "--json" in rest:  # of `compare` it takes a file
                at = rest.index("--json")
                rest[at : at + 1] = ["--json", "-"]
            return [*shlex.split(now), *rest], f"pcpc {name}: is `pcpc {now}` now"
    return [*words], ""

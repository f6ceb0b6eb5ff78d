"""Names, numbers and comments as C has them."""

import math
import re

_WORDS = (
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while bool true false asm typeof main"
)
_RESERVED = frozenset(_WORDS.split())


def identifier(name: str) -> str:
    """Return a name of a rig or a DBC file as C takes it."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"{word}_" if word in _RESERVED or word[:1].isdigit() else word


def number(value: float) -> str:
    """Return a float64 in C with all its bits; of an infinite bound the largest number."""
    if math.isinf(value):
        return "UNLIMITED" if value > 0 else "-UNLIMITED"
    return repr(float(value))


def comment(text: str) -> str:
    """Return text that may stand in a comment, on one line."""
    return " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *")

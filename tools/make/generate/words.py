"""Names, numbers and comments as C has them."""

import math
import re

from pcpc.tools.make.generate.translator.kinds import c_name


def identifier(name: str) -> str:
    """Return a name of a rig or a DBC file as C takes it."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return c_name(f"_{word}" if word[:1].isdigit() else word)


def number(value: float) -> str:
    """Return a float64 in C with all its bits; of an infinite bound the largest number."""
    if math.isinf(value):
        return "UNLIMITED" if value > 0 else "-UNLIMITED"
    return repr(float(value))


def comment(text: str) -> str:
    """Return text that may stand in a comment, on one line."""
    return " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *")

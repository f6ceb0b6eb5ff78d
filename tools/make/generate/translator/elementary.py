"""`pcpc_math.h` and `pcpc_math.c`: the elementary functions in C, translated from emath.

With the self-test, which refuses a build with other bits.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from typing import Any

from pcpc.executive.laws import emath
from pcpc.tools.make.generate.translator import points
from pcpc.tools.make.generate.translator.kinds import FLOAT, CellsKind, Number
from pcpc.tools.make.generate.translator.source import comment
from pcpc.tools.make.generate.translator.unit import Unit, wrapped_lines

NAMES = ("floor", "clip", "sign", "exp", "expmsq", "tanh", "logistic", "sincos", "sin", "cos")
FLAGS = ("-std=c99", "-ffp-contract=off")

_TEMPLATES = resources.files("pcpc.tools.make.generate") / "c"


class _Math(Unit):
    """The file of the elementary functions themselves."""

    prefix = "PCPC_"

    def elementary(self, function: Callable[..., Any]) -> tuple[str, tuple[Number, ...]]:
        name = function.__name__
        if name in ("pow2", "sqrt"):
            return f"pcpc_{name}", (FLOAT,)
        count = function.__code__.co_argcount
        called = self.function(function, (FLOAT,) * count, None, None)  # type: ignore[arg-type]
        return called.name, called.results

    def _function_name(self, function: Callable[..., Any]) -> str:
        return f"pcpc_{function.__name__.strip('_')}"


def files() -> dict[str, str]:
    """Return the texts of both files by their names."""
    unit = _Math("pcpc")
    unit.constant("ROUND", emath.ROUND)
    for name in NAMES:
        unit.elementary(getattr(getattr(emath, name), "py_func", getattr(emath, name)))
    functions = [
        line.replace("static ", "static inline ", 1) if line.startswith("static ") else line
        for line in unit.function_lines([emath.__name__])
    ]
    test = _Math("pcpc")
    evaluate = getattr(points.evaluate, "py_func", points.evaluate)
    called = test.function(evaluate, (FLOAT, CellsKind((points.VALUES,))), None, None)  # type: ignore[arg-type]
    doc = f"{emath.__doc__}\n\nMade by `pcpc generate c` from executive/laws/emath.py."
    constants = unit.constant_lines()
    own = [line for line in test.constant_lines() if line not in constants]
    evaluated = [part for line in called.lines for part in wrapped_lines(line)]
    header = {
        "/* HEADER */": comment(doc),
        "/* CONSTANTS */": constants,
        "/* FUNCTIONS */": functions,
    }
    parts = {"/* CONSTANTS */": own, "/* FUNCTIONS */": evaluated}
    words = {"POINTS": points.POINTS, "VALUES": points.VALUES, "EVALUATE": called.name}
    return {
        "pcpc_math.h": _filled("pcpc_math.h", header, {}),
        "pcpc_math.c": _filled("pcpc_math.c", parts, words | {"DIGESTU": f"{hex(points.DIGEST)}U"}),
    }


def _filled(name: str, parts: Mapping[str, Sequence[str]], words: Mapping[str, object]) -> str:
    """Return a template with lines in the place of comments, and values in that of words."""
    text = (_TEMPLATES / name).read_text(encoding="utf-8")
    for place, lines in parts.items():
        text = text.replace(place, "\n".join(lines), 1)
    for word, value in words.items():
        text = re.sub(rf"\b{word}\b", str(value), text)
    return text

"""Generated C in single precision: each double a float, which a Cortex-M4 has in hardware.

It gives up the bits of Python, not those of other machines: all
builds of the same C still agree. `pcpc_mathf.h` holds the elementary functions, by hand.

    double            float                      0.1    0.1f
    pcpc_exp(x)       pcpc_expf(x)               whole numbers that meet a float are converted
    1e300             3.4028235e+38f, the largest
"""

import re
from collections.abc import Mapping
from importlib import resources

import numpy as np

from pcpc.executive.laws.block import Block
from pcpc.tools.make.generate.translator.kinds import Untranslatable
from pcpc.tools.make.generate.translator.law import LETTERS, signature

MATH = ("pcpc_mathf.h", "pcpc_mathf.c")
_TOKEN = re.compile(
    r"/\*.*?\*/"
    r'|"[^"\n]*"'
    r"|(?<![\w.])(?:[0-9]+\.[0-9]*(?:e[+-]?[0-9]+)?|[0-9]+e[+-]?[0-9]+)"
    r"|\bdouble\b|\bpcpc_\w+|\bPCPC_(?:NAN|INFINITY)\b",
    re.DOTALL,
)
_LARGEST = float(np.finfo(np.float32).max)


def files() -> dict[str, str]:
    """Return the texts of the elementary functions by their names."""
    folder = resources.files("pcpc.tools.make.generate") / "c"
    return {name: (folder / name).read_text(encoding="utf-8") for name in MATH}


def single_precision(texts: Mapping[str, str]) -> dict[str, str]:
    """Return generated files in single precision; Untranslatable for a number that would be 0."""

    def token(found: re.Match[str], file: str) -> str:
        text = found[0]
        if text.startswith("/*"):
            return text
        if text.startswith('"'):
            return text.replace("pcpc_math.h", "pcpc_mathf.h")
        if text == "double":
            return "float"
        if text[0] in "pP":
            return text + ("F" if text[0] == "P" else "f")
        return literal(text, file)

    return {
        name: _TOKEN.sub(lambda found, file=name: token(found, file), text)  # type: ignore[misc]
        for name, text in texts.items()
    }


def literal(text: str, file: str) -> str:
    """Return the literal of a float nearest to that of a double.

    Untranslatable: it is 0 in float.
    """
    value = float(text)
    if abs(value) > _LARGEST:
        return f"{np.float32(_LARGEST)!s}f"
    if value != 0.0 and np.float32(value) == 0.0:
        what = f"{text} is 0 in single precision; let the law do without so small a number"
        raise Untranslatable(f"{file}: {what}")
    return f"{text}f"


def adapter(block: Block, name: str) -> str:
    """Return the C of `NAME_entry`, a step with floats as the loop calls it, with doubles."""
    has = signature(block)
    before, given, after = [], [], []
    for role, letter in LETTERS.items():
        if role not in has:
            before.append(f"    (void){letter};")
            continue
        size = f"(uint32_t)(sizeof {letter}_ / sizeof(float))"
        before.append(f"    {name}_{role} {letter}_;")
        before.append(f"    narrowed({letter}, (float *)&{letter}_, {size});")
        given.append(f", &{letter}_")
        if role in ("states", "outputs"):
            after.append(f"    widened((const float *)&{letter}_, {letter}, {size});")
    head = _ENTRY.replace("NAME", name)
    body = [*before, f"    {name}_step((float)t, (float)dt{''.join(given)});", *after]
    lines = [f'#include "{name}.h"', _COPIES, f"{head};", head, "{"]
    lines += ["    (void)result;", "    (void)error;", *body, "    return 0;", "}", ""]
    return "\n".join(lines)


_ENTRY = """\
int32_t NAME_entry(void *result, void *error, double t, double dt, double *p, double *x,
        double *u, double *y)"""
_COPIES = """\
static inline void widened(const float *from, double *to, uint32_t count)
{
    for (uint32_t i = 0U; i < count; i += 1U) {
        to[i] = (double)from[i];
    }
}
static inline void narrowed(const double *from, float *to, uint32_t count)
{
    for (uint32_t i = 0U; i < count; i += 1U) {
        to[i] = (float)from[i];
    }
}"""

"""What a step says instead of what numba, or lanes of it, cannot take: a word and its cure."""

import re

_LOOP = "a loop over range(n) for what is done to all values of an array"
_NUMBER = "where(c, 1.0, 0.0) for a comparison as a number"
_NOTHING = "emath has nothing like it"
_OF_EMATH = ("floor", "sqrt", "sign", "sin", "cos", "exp", "tanh")
_INSTEAD = {  # a word as numba names it: what does the same
    **{name: f"{name}(x) of emath" for name in _OF_EMATH},
    **dict.fromkeys(("max", "maximum", "fmax"), "where(a > b, a, b)"),
    **dict.fromkeys(("min", "minimum", "fmin"), "where(a < b, a, b)"),
    **dict.fromkeys(("round", "rint"), "floor(x + 0.5) of emath"),
    **dict.fromkeys(("fabs", "absolute"), "abs(x)"),
    **dict.fromkeys(("mod", "fmod", "remainder"), "x - d * floor(x / d) of emath"),
    **dict.fromkeys(("floordiv", "floor_divide", "divmod"), "floor(x / d) of emath"),
    **dict.fromkeys(("pow", "power"), "a product, or sqrt(x) of emath"),
    **dict.fromkeys(("logical_and", "all"), "(a > b) & (c > d)"),
    **dict.fromkeys(("logical_or", "any"), "(a > b) | (c > d)"),
    **dict.fromkeys(("degrees", "radians", "rad2deg", "deg2rad"), "a product"),
    **dict.fromkeys(("getiter", "enumerate", "zip", "sum", "dot", "matmul", "setitem"), _LOOP),
    **dict.fromkeys(("log", "log10", "asin", "acos", "atan", "atan2", "arctan2", "cbrt"), _NOTHING),
    "where": "where(c, a, b) of emath",
    "clip": "clip(x, low, high) of emath",
    "ceil": "-floor(-x) of emath",
    "trunc": "sign(x) * floor(abs(x)) of emath",
    "copysign": "where(b < 0.0, -abs(a), abs(a))",
    "float": "x without float()",
    "hypot": "sqrt(a * a + b * b) of emath",
    "square": "x * x",
    "tan": "sin(x) / cos(x) of emath",
    "isnan": "x != x",
    "isfinite": "x - x == 0.0",
    "logical_not": "not a",
    "bool": "a comparison, as x != 0.0",
}  # fmt: skip
_WORD = re.compile(r"there is no (\w+)|unknown attribute '(\w+)'|global name '(\w+)'|use of (\w+) ")
_ARITHMETIC = {"add", "sub", "mul", "truediv", "float", "neg"}


def cure(reason: str) -> str:
    """Return "; write ..." for what numba says, with its arguments; "" if nothing is known."""
    match = _WORD.search(reason)
    word = next(filter(None, match.groups()), "") if match else ""
    if "Cells(" in reason and word:
        return f"; write {_LOOP}"
    if word in _ARITHMETIC and re.search(r"\bbool\b|Mask", reason):
        return f"; write {_NUMBER}"
    instead = _INSTEAD.get(word, "")
    return f"; {'' if instead == _NOTHING else 'write '}{instead}" if instead else ""

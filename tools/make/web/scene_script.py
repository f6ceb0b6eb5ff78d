"""A plant's drawing as a page draws it: a drawing.py's scene, written down as plain data for JSON.

Its `scene` runs once a way through it, on numbers that write down what is calculated with them
(`symbols.Trace`); `page/scene.js` calculates the same of the values of an instant.

    nodes      as in `symbols`; ["now", NAME] and ["setting", NAME] are what is given
    tree       {"if": node, "yes": tree, "no": tree}, or a leaf: {"bounds", "note", "shapes"}, or
               {"error": what the drawing said}
    shapes     as in `plants/scene.py`; a number is itself or [node], words are texts and
               [node, format]
    assumed    [node, value, settings]: what the drawing took as a plain number or a way that only
               settings decide. Where a setting makes it another, the drawing does not follow it.
"""

import builtins
import math
import operator
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from pcpc.plants.drawing import Drawing, DrawingError, Settings
from pcpc.plants.scene import Scene, Shape
from pcpc.tools.make.web.symbols import Fork, Trace, Unrecordable, plain

_FUNCTIONS = {  # of math, with the operation that each is
    "fabs": "absolute", "sqrt": "sqrt", "cbrt": "cbrt", "exp": "exp", "expm1": "expm1",
    "log1p": "log1p", "log2": "log2", "log10": "log10", "sin": "sin", "cos": "cos", "tan": "tan",
    "asin": "arcsin", "acos": "arccos", "atan": "arctan", "sinh": "sinh", "cosh": "cosh",
    "tanh": "tanh", "floor": "floor", "ceil": "ceil", "trunc": "trunc", "isfinite": "isfinite",
    "isnan": "isnan", "isinf": "isinf", "radians": "deg2rad", "degrees": "rad2deg",
    "hypot": "hypot", "atan2": "arctan2", "pow": "power", "copysign": "copysign", "log": "log",
}  # fmt: skip
_OPERATORS = {
    "add": "add", "sub": "subtract", "mul": "multiply", "truediv": "divide", "pow": "power",
    "mod": "remainder", "lt": "less", "le": "less_equal", "gt": "greater", "ge": "greater_equal",
    "eq": "equal", "ne": "not_equal",
}  # fmt: skip
_FORMAT = re.compile(r"\+?(\.\d{1,2})?[gfe]|")
_TOKEN = re.compile("\x01([0-9]+):([^\x02]*)\x02")


def scene_data(made: Drawing, settings: Settings) -> dict[str, Any]:
    """Return a drawing with the settings of its rig; Unrecordable: why there is none."""
    script = _Script()
    now: Any = {name: script.given("now", name) for name in (*made.needs, "t")}
    p: Any = {name: script.given("setting", name, value) for name, value in settings.items()}

    def leaf() -> dict[str, Any]:
        try:
            return script.leaf(made.raw_scene(now, p))
        except DrawingError as error:
            return {"error": str(error)}

    with _open_functions(script):
        tree = _tree(script.trace.ways(leaf))
    leaves = list(_leaves(tree))
    if all("error" in leaf for leaf in leaves):
        raise Unrecordable(leaves[0]["error"])
    used = {node[1] for node in script.trace.nodes if node[0] == "setting"}
    return {
        "needs": dict(made.needs),
        "settings": {name: plain(settings[name]) for name in settings if name in used},
        "nodes": script.trace.nodes,
        "tree": tree,
        "shapes": script.shapes,
        "assumed": [list(one) for one in script.assumed.values()],
    }


def _tree(found: Any) -> Any:
    if isinstance(found, Fork):
        return {"if": found.condition, "yes": _tree(found.yes), "no": _tree(found.no)}
    return found


def _leaves(tree: dict[str, Any]) -> Iterator[dict[str, Any]]:
    if "if" in tree:
        yield from _leaves(tree["yes"])
        yield from _leaves(tree["no"])
    else:
        yield tree


class _Script:
    """What has been written down of a drawing."""

    def __init__(self) -> None:
        self.trace = Trace()
        self.shapes: list[list[Any]] = []
        self.assumed: dict[int, tuple[int, float, list[str]]] = {}
        self._places: dict[str, int] = {}

    def given(self, *what: str | float) -> "Quantity":
        """Return a value of the instant, or a setting with its value in the rig."""
        kind, name, *value = what
        return Quantity(self, self.trace.node(kind, name), *map(float, value))

    def apply(self, operation: str, function: Callable[..., Any], *given: Any) -> "Quantity":
        """Return what an operation makes of numbers, at least one of them open."""
        parts = [one if isinstance(one, Quantity) else self._number(one) for one in given]
        node = self.trace.node(operation, *(one.index for one in parts))
        values = [one.value for one in parts]
        known = None if None in values else float(function(*values))
        return Quantity(self, node, known)

    def _number(self, value: Any) -> "Quantity":
        if not isinstance(value, int | float | np.integer | np.floating):
            raise TypeError(f"a number with a {type(value).__name__}")
        return Quantity(self, self.trace.node("number", plain(float(value))), float(value))

    def assume(self, index: int, value: float) -> float:
        """Note that a node of settings alone is taken as its value."""
        if index not in self.assumed:
            names = sorted(self._settings(index))
            self.assumed[index] = index, value, names
        return value

    def _settings(self, index: int) -> set[str]:
        word, *given = self.trace.nodes[index]
        if word == "setting":
            return {given[0]}
        return set() if word == "number" else set().union(*map(self._settings, given))

    def leaf(self, scene: Scene) -> dict[str, Any]:
        """Return a scene as plain data."""
        return {
            "bounds": [_number(one) for one in scene.bounds],
            "note": _words(scene.note),
            "shapes": [self._shape(one) for one in scene.given],
        }

    def _shape(self, one: Shape) -> int:
        size = _words(one.size) if isinstance(one.size, str) else _number(one.size)
        style = one.style if isinstance(one.style, str | bool) else _number(one.style)
        found = [one.kind, one.role, [_number(v) for v in one.xy], size, style]
        place = self._places.setdefault(repr(found), len(self.shapes))
        if place == len(self.shapes):
            self.shapes.append(found)
        return place


class Quantity:
    """A number of a drawing that is open: of settings alone it has its value in the rig, too."""

    def __init__(self, script: _Script, index: int, value: float | None = None) -> None:
        self._script, self.index, self.value = script, index, value

    def apply(self, operation: str, function: Callable[..., Any], *given: Any) -> "Quantity":
        """Return what an operation makes of this number and others."""
        return self._script.apply(operation, function, self, *given)

    def __bool__(self) -> bool:
        if self.value is None:
            return self._script.trace.branch(self.index)
        truth = self.apply("not_equal", operator.ne, 0.0)
        return bool(self._script.assume(truth.index, float(self.value != 0.0)))

    def _plain(self, what: str) -> float:
        if self.value is None:
            raise Unrecordable(f"it takes a number of the instant as {what}")
        return self._script.assume(self.index, self.value)

    def __float__(self) -> float:
        return self._plain("a plain float: only functions of math and numpy's operators are open")

    def __int__(self) -> int:
        return int(self._plain("a whole number"))

    def __index__(self) -> int:
        return operator.index(self._plain("a count"))  # type: ignore[arg-type]  # TypeError: a float

    def __round__(self, digits: int | None = None) -> Any:
        if digits is None and self.value is not None:
            return round(self._script.assume(self.apply("rint", round).index, round(self.value)))
        scale = 10.0 ** (digits or 0)
        whole = self.apply("multiply", operator.mul, scale).apply("rint", round)
        return whole.apply("divide", operator.truediv, scale)

    def __format__(self, spec: str) -> str:
        if not _FORMAT.fullmatch(spec):
            raise Unrecordable(f"it writes a number with the format {spec}")
        return f"\x01{self.index}:{spec}\x02"

    def __str__(self) -> str:
        return format(self, "")

    __repr__ = __str__

    def __abs__(self) -> "Quantity":
        return self.apply("absolute", abs)

    def __neg__(self) -> "Quantity":
        return self.apply("negative", operator.neg)

    def __pos__(self) -> "Quantity":
        return self

    __hash__ = None  # type: ignore[assignment]


def _operator(name: str, operation: str) -> None:
    function = getattr(operator, name)

    def forward(self: Quantity, other: Any) -> Any:
        return NotImplemented if _foreign(other) else self.apply(operation, function, other)

    def backward(self: Quantity, other: Any) -> Any:
        return self._script.apply(operation, function, other, self)

    setattr(Quantity, f"__{name}__", forward)
    if name in ("add", "sub", "mul", "truediv", "pow", "mod"):
        setattr(Quantity, f"__r{name}__", backward)


def _foreign(other: Any) -> bool:
    return isinstance(other, np.ndarray)


def _method(name: str, operation: str) -> None:
    """Give open numbers the method that numpy's functions ask for in an array of objects."""
    function = getattr(math, name)
    setattr(Quantity, operation, lambda self, *other: self.apply(operation, function, *other))


for _name, _operation in _OPERATORS.items():
    _operator(_name, _operation)
for _name, _operation in _FUNCTIONS.items():
    _method(_name, _operation)


@contextmanager
def _open_functions(script: _Script) -> Iterator[None]:
    """Let the functions of `math`, `max` and `min` take open numbers for a while."""
    opened = [(math, name, _open_function(script, name, each)) for name, each in _FUNCTIONS.items()]
    folds = [(builtins, one.__name__, _fold(script, one)) for one in (max, min)]
    own = [(module, name, getattr(module, name)) for module, name, _ in opened + folds]
    try:
        for module, name, function in opened + folds:
            setattr(module, name, function)
        yield
    finally:
        for module, name, function in own:
            setattr(module, name, function)


def _open_function(script: _Script, name: str, operation: str) -> Callable[..., Any]:
    function = getattr(math, name)

    def open_function(*given: Any, **more: Any) -> Any:
        if not any(isinstance(one, Quantity) for one in given):
            return function(*given, **more)
        if name == "log" and len(given) == 2:
            return open_function(given[0]) / open_function(given[1])
        if name == "hypot" and len(given) != 2:
            return open_function(sum(one * one for one in given) ** 0.5, 0.0)
        return script.apply(operation, function, *given)

    return open_function


def _fold(script: _Script, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `max` or `min` with Python's order: the first is kept unless another is beyond it."""
    operation, beyond = ("greater", operator.gt) if function is max else ("less", operator.lt)

    def fold(*given: Any, **more: Any) -> Any:
        if len(given) == 1:
            given = (list(given[0]),)
        found = given[0] if len(given) == 1 else given
        if more or not any(isinstance(one, Quantity) for one in found):
            return function(*given, **more)
        best, *others = found
        for one in others:
            better = script.apply(operation, beyond, one, best)
            best = script.apply("where", lambda c, yes, no: yes if c else no, better, one, best)
        return best

    return fold


def _number(value: Any) -> Any:
    """Return a number for JSON: itself, or [node]."""
    return [value.index] if isinstance(value, Quantity) else plain(float(value))


def _words(text: str) -> list[Any]:
    """Return words with open numbers in them as texts and [node, format]."""
    found, end = list[Any](), 0
    for one in _TOKEN.finditer(text):
        found += [text[end : one.start()], [int(one[1]), one[2]]]
        end = one.end()
    return [one for one in (*found, text[end:]) if one != ""]

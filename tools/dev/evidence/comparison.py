"""Code that is compared with a model of it: declared once, for the compiled side and the model.

    given       a NamedTuple: what a step is given
    step        what the code is made to do with it: plain Python, whose calls go to the copies
    whole, real what is seen after a step: its name in the LOOP record, and what the model says

In a name `came` is what `step` returned, `given` is the step's; `v[3:5]` stands for two. `whole`
are integers, `real` are numbers that may be NaN. An episode begins with a LOOP record set back.
"""

import ast
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.structures import structure, words_of
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import variables
from pcpc.executive.loop.ring_layout import FRAME_WORDS

FRAMES = 450  # of an episode in the ring, at most
FRAME_ROWS = 1 << 16
EVENT = f"event[(event_ends.head - 1) % {sh.EVENT_RING_ROWS}]"  # the last one
Seen = Mapping[str, Callable[[Any], Any]]

LAST_EVENT: Seen = {  # of models that keep it, and how many there were
    "event_ends.head": lambda m: m.events,
    f"{EVENT}.code": lambda m: m.event[0], f"{EVENT}.argument": lambda m: m.event[1],
    f"{EVENT}.bits": lambda m: m.event[2],
}  # fmt: skip


def same(*names: str) -> Seen:
    """Return what a model has under the last part of the name."""
    return {name: attrgetter(name.rpartition(".")[2]) for name in names}


def frame_word(back: int, word: int) -> str:
    """Return the name of a word of the last frame but `back` in the ring."""
    return f"frame[(frame_ends.head - {1 + back}) % {FRAME_ROWS} * {FRAME_WORDS} + {word}]"


@dataclass(frozen=True)
class Compared:
    """A step of the code, what it is given, and what is seen beside what is expected."""

    given: Any
    step: Callable[..., Any]
    whole: Seen
    real: Seen = field(default_factory=dict)

    @cached_property
    def record(self) -> np.dtype[Any]:
        """The type of a row of `given`."""
        plain: dict[Any, tuple[str]] = {int: ("<i8",), float: ("<f8",)}
        hints = get_type_hints(self.given, include_extras=True)
        fields = [(name, *(plain.get(one) or one.__metadata__)) for name, one in hints.items()]
        dtype = np.dtype((np.record, fields))
        structure(dtype)
        return dtype

    @property
    def driver(self) -> str:
        """The text of a function that does the steps and writes what is seen."""
        lines = [
            "@loop_function", "def feed(_m, n, rows, whole, real):",
            "    for s in range(rows.shape[0]):", "        given = rows[s]",
            f"        came = {self.step.__name__}(n, given)",
        ]  # fmt: skip
        for target, seen in (("whole", self.whole), ("real", self.real)):
            at = 0
            for name in seen:
                value, some = _parted(name)
                place = ast.unparse(_OfLoop().visit(value))
                if some is None:
                    lines.append(f"        {target}[s, {at}] = {place}")
                else:
                    these = f"{target}_{at}"
                    lines.append(f"        {these} = {place}")
                    lines.append(f"        for i in range({some.start}, {some.stop}):")
                    lines.append(f"            {target}[s, {at - some.start} + i] = {these}[i]")
                at += 1 if some is None else len(some)
        return "\n".join(lines)

    def names(self, seen: Seen) -> list[str]:
        """Return the name of each column."""
        names: list[str] = []
        for name in seen:
            value, some = _parted(name)
            names += [name] if some is None else [f"{ast.unparse(value)}[{i}]" for i in some]
        return names


def _parted(name: str) -> tuple[ast.expr, range | None]:
    """Return what stands before the range of a name, and the range."""
    value = ast.parse(name, mode="eval").body
    if isinstance(value, ast.Subscript) and isinstance(value.slice, ast.Slice):
        first, past = ast.unparse(value.slice).split(":")
        return value.value, range(int(first), int(past))
    return value, None


class _OfLoop(ast.NodeTransformer):
    """Leads a name to the LOOP record, or to the place of a variable."""

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Take the record's part of that name, or the number."""
        if node.id in (sh.LOOP.names or ()):
            return ast.Attribute(ast.Name("n"), node.id)
        return ast.Constant(getattr(variables, node.id)) if node.id.isupper() else node


def _flat(values: Iterable[Any]) -> Iterator[Any]:
    for one in values:
        yield from one if isinstance(one, list | tuple) else [one]


@dataclass
class Episodes:
    """Episodes for the driver of what is compared, `feed(mutant, n, rows, whole, real)`."""

    about: Compared
    feed: Callable[..., None]

    def __post_init__(self) -> None:
        memory, fields = np.recarray(1, sh.LOOP), dict[str, Any](sh.LOOP.fields or {})
        self._bytes, self._loop = memory.view(np.uint8), memory[0]
        self._private = self._bytes[fields["k"][1] :]
        self._episodes: list[tuple[NDArray[np.uint8], NDArray[Any], list[NDArray[Any]]]] = []

    def new_loop(self) -> Any:
        """Return the record, empty, for the settings of an episode."""
        self._bytes[:] = 0
        self._loop.rings.frame_words, self._loop.rings.frame_rows = FRAME_WORDS, FRAME_ROWS
        return self._loop

    def new_rows(self, steps: int) -> Any:
        """Return what the steps of an episode are given, to be filled."""
        return np.zeros(steps, self.about.record).view(np.recarray)

    def add(self, rows: NDArray[Any], model: Any) -> None:
        """Add an episode that begins with the record as it is; `model.step` takes its steps."""
        seen: Iterable[Any] = (self.about.whole, np.int64), (self.about.real, np.float64)
        said: list[list[list[Any]]] = [[], []]
        for row in rows.tolist():
            model.step(self.about.given(*row))
            for values, (names, _) in zip(said, seen, strict=True):
                values.append([*_flat(one(model) for one in names.values())])
        expected = [np.array(one, kind) for one, (_, kind) in zip(said, seen, strict=True)]
        self._episodes.append((self._private.copy(), rows, expected))

    def difference(self, number: int) -> str:
        """Return where an episode shows that this mutant is there; 0: the code as it is."""
        for i, episode in enumerate(self._episodes):
            if where := self._difference(np.array([number]), *episode):
                return f"{where} of episode {i}"
        return ""

    def _difference(
        self,
        mutant: NDArray[Any],
        private: NDArray[np.uint8],
        rows: NDArray[Any],
        expected: list[NDArray[Any]],
    ) -> str:
        n = self._loop
        for record in (n.control, n.answer, n.event_ends, n.frame_ends):
            words_of(record)[:] = 0
        n.event[:] = n.frame[-2 * FRAME_WORDS :] = n.frame[: FRAMES * FRAME_WORDS] = 0
        self._private[:] = private
        came = [np.zeros_like(one) for one in expected]
        self.feed(mutant, n, rows, *came)
        every = zip((self.about.whole, self.about.real), came, expected, strict=True)
        for seen, one, other in every:
            if not np.array_equal(one, other, equal_nan=True):
                return self._where(seen, one, other)
        return ""

    def _where(self, seen: Seen, came: NDArray[Any], expected: NDArray[Any]) -> str:
        """Return the first that differs."""
        differ = (came != expected) & ((came == came) | (expected == expected))  # NaN is NaN
        step, column = np.argwhere(differ)[0].tolist()
        values = f"{came[step, column]}, expected {expected[step, column]}"
        return f"{self.about.names(seen)[column]} is {values}, in step {step}"

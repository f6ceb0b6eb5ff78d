"""`pcpc get|set|watch`, `operate lock`: the variables of a running node, shown and tuned."""

import json
import math
import shutil
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop.alarms import Alarms
from pcpc.executive.nodes.live import Live, LiveVariable, known_name
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.live.commands import GetRequest, LockRequest, SetRequest, WatchRequest
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.terminal import screen

if TYPE_CHECKING:
    from pcpc.tools.live.answers import Locked, Tuned, Values, VariableNow, WatchedValues

_CYCLE, _NUMBER = 8, 12  # columns of a cycle number and of a value


@dataclass(frozen=True)
class _Column:
    """A variable of a node, and how it is called here: with its node, where there are several."""

    label: str
    live: Live
    name: str

    def shown(self, value: float) -> str:
        """Return a value with its unit."""
        return self.live.variables[self.name].shown(value)


def command(request: GetRequest | SetRequest | WatchRequest | LockRequest) -> int:
    """Run one of the four. UserError: wrong input."""
    if isinstance(request, LockRequest):
        Nodes().chosen(request.node).lock(request.level)
        locked: Locked = {"lock": request.level}
        screen.answer(request.json, locked, [f"lock {request.level}"])
        return Exit.OK
    chosen = _nodes_and_words(request)
    if isinstance(request, WatchRequest):
        _watch(_columns(chosen, globs=True), request.every_s, request.json)
    elif isinstance(request, SetRequest):
        _set(*_of_one_node(chosen, request.names, "set"), request.json)
    elif request.long or not request.names:
        _list(*_of_one_node(chosen, request.names, "get"), request.long, request.json)
    else:
        _get(_columns(chosen, globs=False), request.json)
    return Exit.OK


def _of_one_node(
    chosen: Sequence[tuple[Live, str]], names: Sequence[str], verb: str
) -> tuple[Live, list[str]]:
    """Return the node of all words, and the words; UserError: there are several nodes."""
    if len({live.name for live, _ in chosen}) > 1:
        raise UserError(f"{' '.join(names)}: of several nodes; {verb} those of one node")
    return chosen[0][0], [word for _, word in chosen if word]


def _nodes_and_words(request: GetRequest | SetRequest | WatchRequest) -> list[tuple[Live, str]]:
    """Return each word with its node: the one that is named, else one that has all, else its own.

    Without words, [(node, "")].
    """
    there, words = Nodes(), [word.rpartition(":")[::2] for word in request.names]
    if not words:
        return [(there.chosen(request.node), "")]
    for shown, (role, word) in zip(request.names, words, strict=True):
        if not word.partition("=")[0]:
            if isinstance(request, SetRequest):
                raise UserError(f"{shown or repr(shown)}: expected NAME=VALUE")
            raise UserError(f"{shown!r}: names no variable; `pcpc get` shows all")
        if request.node and role not in ("", request.node):
            raise UserError(f"{shown}: contradicts --node {request.node}; give one of them")
    if request.node:
        node = there.find(request.node)
        return [(node, word) for _, word in words]
    free = [word.partition("=")[0] for role, word in words if not role]
    try:
        nodes = dict.fromkeys(free, there.find_for(free)) if free else {}
    except LiveError:  # each by itself, or the same error
        nodes = {word: there.find_for([word]) for word in free}
    return [
        (there.find(role) if role else nodes[word.partition("=")[0]], word) for role, word in words
    ]


def _columns(chosen: Sequence[tuple[Live, str]], globs: bool) -> list[_Column]:
    """Return the variables that the words choose, each once; `globs`: a word may be a pattern."""
    nodes = {live.name: live for live, _ in chosen}
    roles = [name.rpartition(".")[2] for name in nodes]
    found: dict[str, _Column] = {}
    for live, word in chosen:
        role = live.name.rpartition(".")[2]
        at = "" if len(nodes) == 1 else f"{role if roles.count(role) == 1 else live.name}:"
        for name in live.select([word]) if globs else [known_name(word, live.variables)]:
            found[f"{at}{name}"] = _Column(f"{at}{name}", live, name)
    return [*found.values()]


def _list(live: Live, words: Sequence[str], is_long: bool, as_json: bool) -> None:
    values = live.read()
    rows = [(live.variables[name], values[name]) for name in live.select(words or ["*"])]
    cells = [("name", "value", "unit", "kind and range")]
    for one, value in rows:
        about = one.kind
        if one.range is not None:
            about += " {:.9g}..{:.9g}".format(*one.range)
        if is_long:
            about += f", {one.writer}: {one.help}"
        cells.append((one.name, f"{value:.9g}", one.unit, about))
    told = [_description(*row) for row in rows]
    screen.answer(as_json, told, screen.table(cells, right=(1,)))


def _description(one: LiveVariable, value: float) -> "VariableNow":
    """Return one variable for `get --long --json`."""
    return {
        "name": one.name, "value": _json(value), "unit": one.unit, "kind": one.kind,
        "writer": one.writer, "help": one.help,
        "range": None if one.range is None else [_json(bound) for bound in one.range],
    }  # fmt: skip


def _read(columns: Sequence[_Column]) -> dict[str, float]:
    """Return the values of all columns; those of a node are of one cycle."""
    values = {one.live.name: one.live.read() for one in columns}
    return {one.label: values[one.live.name][one.name] for one in columns}


def _get(columns: Sequence[_Column], as_json: bool) -> None:
    values = _read(columns)
    told: Values = {name: _json(value) for name, value in values.items()}
    lines = (f"{one.label} = {one.shown(values[one.label])}" for one in columns)
    screen.answer(as_json, told, lines)


def _set(live: Live, words: Sequence[str], as_json: bool) -> None:
    changes: dict[str, float] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not (equals and name):
            raise UserError(f"{word or repr(word)}: expected NAME=VALUE")
        if name in changes:
            raise UserError(f"{name}: given twice")
        try:
            changes[name] = float(text)
        except ValueError:
            raise UserError(f"{word}: {text!r} is not a number") from None
    tune(live, changes, as_json)


def tune(live: Live, changes: Mapping[str, float], as_json: bool) -> None:
    """Set parameters and print what they were, what they are and from which cycle on."""
    before = live.read()
    cycle = live.tune(changes)
    old = {name: _json(before[name]) for name in changes}
    told: Tuned = {"cycle": cycle, "values": {**changes}, "before": old}
    lines = (
        f"{name} = {live.variables[name].shown(value)} (was {before[name]:.9g}) from cycle {cycle}"
        for name, value in changes.items()
    )
    screen.answer(as_json, told, lines)


def _watch(columns: Sequence[_Column], every_s: float, as_json: bool) -> None:
    nodes = {one.live.name: one.live for one in columns}
    shown = _Screen(columns, as_json)
    alarms = [Alarms(live.block) for live in nodes.values()]
    for leading in columns[0].live.every(every_s):
        for alarm in (alarm for one in alarms for alarm in one.look()):
            shown.tell(str(alarm))
        others = [one for one in columns if one.live is not columns[0].live]
        values = {one.label: leading[one.name] for one in columns if one not in others}
        shown.show(leading.cycle, values | _read(others))


class _Screen:
    """Shows values: in place on a terminal, else below a header, or one JSON object a line.

    The cycle is that of the first column's node.
    """

    def __init__(self, columns: Sequence[_Column], as_json: bool) -> None:
        self._columns, self._json = columns, as_json
        self._in_place = sys.stdout.isatty()
        self._shown = 0
        units = {one.label: one.live.variables[one.name].unit for one in columns}
        self._sizes = {
            name: max(_NUMBER, len(name), len(unit) + len("[]")) for name, unit in units.items()
        }
        self._fits = _CYCLE + sum(2 + size for size in self._sizes.values()) <= screen.width()
        if not (self._json or self._in_place) and self._fits:
            print(self._row("cycle", {name: name for name in units}))
            told = {name: f"[{unit}]" if unit else "" for name, unit in units.items()}
            print(self._row("", told).rstrip(), flush=True)

    def tell(self, line: str) -> None:
        """Print a line that stays, on stderr; what is shown in place goes on below it."""
        print(line, file=sys.stderr, flush=True)
        self._shown = 0

    def show(self, cycle: int, values: Mapping[str, float]) -> None:
        """Show the values of all columns, by label."""
        if self._json:
            found = {one.label: _json(values[one.label]) for one in self._columns}
            told: WatchedValues = {"cycle": cycle, **found}
            print(json.dumps(told), flush=True)
        elif self._in_place:
            self._rewrite(
                [f"{self._columns[0].live.name}, cycle {cycle}", *self._named_lines(values)]
            )
        elif self._fits:
            row = {name: f"{value:.9g}" for name, value in values.items()}
            print(self._row(str(cycle), row), flush=True)
        else:
            print(
                f"cycle {cycle}",
                *(f"  {line}" for line in self._named_lines(values)),
                sep="\n",
                flush=True,
            )

    def _row(self, cycle: str, cells: Mapping[str, str]) -> str:
        padded = (f"  {cells[name]:>{size}}" for name, size in self._sizes.items())
        return f"{cycle:>{_CYCLE}}{''.join(padded)}"

    def _named_lines(self, values: Mapping[str, float]) -> list[str]:
        """Return a line for each variable: its name, its value, its unit."""
        broad = max(len(one.label) for one in self._columns)
        return [f"{one.label:{broad}} = {one.shown(values[one.label])}" for one in self._columns]

    def _rewrite(self, lines: list[str]) -> None:
        columns, rows = shutil.get_terminal_size()
        up = f"\x1b[{self._shown}A" if self._shown else ""
        fitting = lines[: rows - 1]
        sys.stdout.write(up + "".join(f"\r\x1b[K{line[: columns - 1]}\n" for line in fitting))
        sys.stdout.flush()
        self._shown = len(fitting)


def _json(value: float) -> float | None:
    """Return what JSON can hold."""
    return float(value) if math.isfinite(value) else None

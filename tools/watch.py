"""`pcpc list|get|set|watch|lock`: the variables of a running node, shown and tuned."""

import argparse
import json
import math
import shutil
import sys
from collections.abc import Mapping, Sequence

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.durations import duration_s
from pcpc.executive.loop.alarms import Alarms
from pcpc.executive.nodes.live import Live, Values, Variable
from pcpc.tools.console import screen
from pcpc.tools.remote.nodes import nodes_of

_CYCLE, _NUMBER = 8, 12  # columns of a cycle number and of a value


def command(options: argparse.Namespace) -> int:
    """Run one of the five subcommands."""
    actions = {"list": _list, "get": _get, "set": _set, "watch": _watch, "lock": _lock}
    actions[options.command](_node(options), options)
    return Exit.OK


def _node(options: argparse.Namespace) -> Live:
    """Return the node that is named, also as `plant:NAME`, else the one that has the variables."""
    pairs = [word.rpartition(":")[::2] for word in options.names]
    options.names, nodes = [word for _, word in pairs], {node for node, _ in pairs}
    for role, word in pairs:
        if not word.partition("=")[0]:
            shown = f"{role}:{word}" if role else word
            if options.command == "set":
                raise UserError(f"{shown or repr(shown)}: expected NAME=VALUE")
            raise UserError(f"{shown!r}: names no variable; `pcpc list` shows all")
    node = options.node or (nodes.pop() if len(nodes) == 1 else "")
    if node:
        return nodes_of(options).find(node)
    words = [] if options.command == "lock" else options.names
    return nodes_of(options).find_for([word.partition("=")[0] for word in words])


def _list(live: Live, options: argparse.Namespace) -> None:
    values = live.read()
    rows = [(live.variables[name], values[name]) for name in live.select(options.names or ["*"])]
    if options.json:
        print(json.dumps([_described(*row) for row in rows]))
        return
    cells = [("name", "value", "unit", "kind and range")]
    for one, value in rows:
        about = one.kind
        if one.range is not None:
            about += " {:.9g}..{:.9g}".format(*one.range)
        if options.long:
            about += f", {one.writer}: {one.help}"
        cells.append((one.name, f"{value:.9g}", one.unit, about))
    print("\n".join(screen.table(cells, right=(1,))))


def _described(one: Variable, value: float) -> dict[str, object]:
    """Return one variable for `list --json`."""
    span = None if one.range is None else [_json(bound) for bound in one.range]
    return {"name": one.name, "value": _json(value)} | vars(one) | {"range": span}


def _get(live: Live, options: argparse.Namespace) -> None:
    values = live.read()
    found = {name: values[name] for name in options.names}
    if options.json:
        print(json.dumps({name: _json(value) for name, value in found.items()}))
        return
    for name, value in found.items():
        print(f"{name} = {live.variables[name].shown(value)}")


def _set(live: Live, options: argparse.Namespace) -> None:
    changes: dict[str, float] = {}
    for word in options.names:
        name, equals, text = word.partition("=")
        if not (equals and name):
            raise UserError(f"{word or repr(word)}: expected NAME=VALUE")
        if name in changes:
            raise UserError(f"{name}: given twice")
        try:
            changes[name] = float(text)
        except ValueError:
            raise UserError(f"{word}: {text!r} is not a number") from None
    tune(live, changes, options.json)


def tune(live: Live, changes: Mapping[str, float], as_json: bool) -> None:
    """Set parameters and print what they were, what they are and from which cycle on."""
    before = live.read()
    cycle = live.tune(changes)
    if as_json:
        old = {name: _json(before[name]) for name in changes}
        print(json.dumps({"cycle": cycle, "values": changes, "before": old}))
        return
    for name, value in changes.items():
        shown = live.variables[name].shown(value)
        print(f"{name} = {shown} (was {before[name]:.9g}) from cycle {cycle}")


def _lock(live: Live, options: argparse.Namespace) -> None:
    (level,) = options.names
    live.lock(level)
    print(json.dumps({"lock": level}) if options.json else f"lock {level}")


def _watch(live: Live, options: argparse.Namespace) -> None:
    try:
        every_s = duration_s(options.every)
    except ValueError as error:
        raise UserError(f"--every {error}") from None
    shown = _Screen(live, live.select(options.names), options.json)
    alarms = Alarms(live.block)
    for values in live.every(every_s):
        for alarm in alarms.look():
            shown.tell(str(alarm))
        shown.show(values)


class _Screen:
    """Shows values: in place on a terminal, else below a header, or one JSON object a line."""

    def __init__(self, live: Live, names: Sequence[str], as_json: bool) -> None:
        self._live, self._names, self._json = live, names, as_json
        self._in_place = sys.stdout.isatty()
        self._shown = 0
        units = {name: live.variables[name].unit for name in names}
        self._columns = {
            name: max(_NUMBER, len(name), len(units[name]) + len("[]")) for name in names
        }
        self._fits = _CYCLE + sum(2 + size for size in self._columns.values()) <= screen.width()
        if not (self._json or self._in_place) and self._fits:
            print(self._row("cycle", {name: name for name in names}))
            told = {name: f"[{unit}]" if unit else "" for name, unit in units.items()}
            print(self._row("", told).rstrip(), flush=True)

    def tell(self, line: str) -> None:
        """Print a line that stays, on stderr; what is shown in place goes on below it."""
        print(line, file=sys.stderr, flush=True)
        self._shown = 0

    def show(self, values: Values) -> None:
        if self._json:
            line = {"cycle": values.cycle} | {name: _json(values[name]) for name in self._names}
            print(json.dumps(line), flush=True)
        elif self._in_place:
            self._rewrite([f"{self._live.name}, cycle {values.cycle}", *self._named(values)])
        elif self._fits:
            row = {name: f"{values[name]:.9g}" for name in self._names}
            print(self._row(str(values.cycle), row), flush=True)
        else:
            print(f"cycle {values.cycle}", *(f"  {line}" for line in self._named(values)),
                  sep="\n", flush=True)  # fmt: skip

    def _row(self, cycle: str, cells: Mapping[str, str]) -> str:
        padded = (f"  {cells[name]:>{size}}" for name, size in self._columns.items())
        return f"{cycle:>{_CYCLE}}{''.join(padded)}"

    def _named(self, values: Values) -> list[str]:
        """Return a line for each variable: its name, its value, its unit."""
        broad = max(map(len, self._names))
        variables = self._live.variables
        return [f"{name:{broad}} = {variables[name].shown(values[name])}" for name in self._names]

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

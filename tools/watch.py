"""`pcpc list|get|set|watch|lock`: the variables of a running node, shown and tuned."""

import argparse
import json
import math
import shutil
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit
from pcpc.executive.loop import shared as sh
from pcpc.tools import screen
from pcpc.tools.nodes import (
    HostError,
    exactly,
    find,
    find_for,
    is_running,
    names_of,
    read,
    select,
    set_lock,
    tune,
)

_CYCLE, _NUMBER = 8, 12  # columns of a cycle number and of a value
_SLICE_S = 0.05  # how soon `watch` notices the end of the node
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "": 1.0}


def command(options: argparse.Namespace) -> int:
    """Run one of the five subcommands."""
    actions = {"list": _list, "get": _get, "set": _set, "watch": _watch, "lock": _lock}
    actions[options.command](_node(options), options)
    return Exit.OK


def _node(options: argparse.Namespace) -> sh.Shared:
    """Return the node that is named, else the one that has the variables."""
    if options.node is not None:
        return find(options.node)
    words = [] if options.command == "lock" else options.names
    return find_for([word.partition("=")[0] for word in words])


def _list(block: sh.Shared, options: argparse.Namespace) -> None:
    variables, values = block.description["variables"], read(block)
    chosen = select(names_of(block), options.names or ["*"]).values()
    ranges = block.description["ranges"]
    rows = [(float(values[at]), *variables[at]) for at in chosen]
    if options.json:
        print(json.dumps([_described(row, ranges.get(row[1])) for row in rows]))
        return
    cells = [("name", "value", "unit", "kind and range")]
    for value, name, unit, kind, writer, help in rows:
        about = kind
        if name in ranges:
            about += " {:.9g}..{:.9g}".format(*ranges[name])
        if options.long:
            about += f", {writer}: {help}"
        cells.append((name, f"{value:.9g}", unit, about))
    print("\n".join(screen.table(cells, right=(1,))))


def _described(row: tuple[Any, ...], bounds: list[float] | None) -> dict[str, Any]:
    """Return one variable for `list --json`."""
    value, name, unit, kind, writer, help = row
    found = {"name": name, "value": _json(value), "unit": unit, "kind": kind, "writer": writer}
    span = None if bounds is None else [_json(bound) for bound in bounds]
    return found | {"help": help, "range": span}


def _get(block: sh.Shared, options: argparse.Namespace) -> None:
    places = names_of(block)
    chosen = {name: exactly(places, name) for name in options.names}
    values = read(block)
    if options.json:
        print(json.dumps({name: _json(values[at]) for name, at in chosen.items()}))
        return
    for name, at in chosen.items():
        print(f"{name} = {_with_unit(block, at, values[at])}")


def _set(block: sh.Shared, options: argparse.Namespace) -> None:
    changes: dict[str, float] = {}
    for word in options.names:
        name, equals, text = word.partition("=")
        if not equals:
            raise HostError(f"{word}: expected NAME=VALUE")
        if name in changes:
            raise HostError(f"{name}: given twice")
        try:
            changes[name] = float(text)
        except ValueError:
            raise HostError(f"{word}: {text!r} is not a number") from None
    places = names_of(block)
    before = read(block)
    cycle = tune(block, changes)
    if options.json:
        old = {name: _json(before[places[name]]) for name in changes}
        print(json.dumps({"cycle": cycle, "values": changes, "before": old}))
        return
    for name, value in changes.items():
        at = places[name]
        print(f"{name} = {_with_unit(block, at, value)} (was {before[at]:.9g}) from cycle {cycle}")


def _lock(block: sh.Shared, options: argparse.Namespace) -> None:
    set_lock(block, options.names[0])
    text = json.dumps({"lock": options.names[0]}) if options.json else f"lock {options.names[0]}"
    print(text)


def _watch(block: sh.Shared, options: argparse.Namespace) -> None:
    every_s = duration_s(options.every)
    screen = _Screen(block, select(names_of(block), options.names), options.json)
    next_s = time.monotonic()
    while is_running(block):
        screen.show(read(block))
        next_s = max(next_s + every_s, time.monotonic())
        while not block["control"][sh.DONE] and (rest_s := next_s - time.monotonic()) > 0:
            time.sleep(min(rest_s, _SLICE_S))


def duration_s(text: str) -> float:
    """Return the seconds of `500us`, `5ms`, `10s` or `10`; HostError unless above 0."""
    number = text.rstrip("mus")
    try:
        seconds = float(number) * _SECONDS[text[len(number) :]]
    except (ValueError, KeyError):
        seconds = math.nan
    if not 0 < seconds < math.inf:
        raise HostError(f"{text}: not a duration above 0; expected like 500us, 5ms, 10s")
    return seconds


class _Screen:
    """Shows values: in place on a terminal, else below a header, or one JSON object a line."""

    def __init__(self, block: sh.Shared, chosen: Mapping[str, int], as_json: bool) -> None:
        self._block, self._chosen, self._json = block, chosen, as_json
        self._time = names_of(block)["time.t_s"]
        self._in_place = sys.stdout.isatty()
        self._shown = 0
        units = {name: block.description["variables"][at][1] for name, at in chosen.items()}
        self._columns = {
            name: max(_NUMBER, len(name), len(units[name]) + len("[]")) for name in chosen
        }
        self._fits = _CYCLE + sum(2 + size for size in self._columns.values()) <= screen.width()
        if not (self._json or self._in_place) and self._fits:
            print(self._row("cycle", {name: name for name in chosen}))
            told = {name: f"[{unit}]" if unit else "" for name, unit in units.items()}
            print(self._row("", told).rstrip(), flush=True)

    def show(self, values: NDArray[np.float64]) -> None:
        cycle = round(float(values[self._time]) * 1e9 / self._block.description["period_ns"])
        if self._json:
            line = {"cycle": cycle} | {name: _json(values[at]) for name, at in self._chosen.items()}
            print(json.dumps(line), flush=True)
        elif self._in_place:
            self._rewrite([f"{self._block.name}, cycle {cycle}", *self._named(values)])
        elif self._fits:
            row = {name: f"{values[at]:.9g}" for name, at in self._chosen.items()}
            print(self._row(str(cycle), row), flush=True)
        else:
            print(f"cycle {cycle}", *(f"  {line}" for line in self._named(values)), sep="\n",
                  flush=True)  # fmt: skip

    def _row(self, cycle: str, cells: Mapping[str, str]) -> str:
        padded = (f"  {cells[name]:>{size}}" for name, size in self._columns.items())
        return f"{cycle:>{_CYCLE}}{''.join(padded)}"

    def _named(self, values: NDArray[np.float64]) -> list[str]:
        """Return a line for each variable: its name, its value, its unit."""
        broad = max(map(len, self._chosen))
        return [
            f"{name:{broad}} = {_with_unit(self._block, at, values[at])}"
            for name, at in self._chosen.items()
        ]

    def _rewrite(self, lines: list[str]) -> None:
        columns, rows = shutil.get_terminal_size()
        up = f"\x1b[{self._shown}A" if self._shown else ""
        fitting = lines[: rows - 1]
        sys.stdout.write(up + "".join(f"\r\x1b[K{line[: columns - 1]}\n" for line in fitting))
        sys.stdout.flush()
        self._shown = len(fitting)


def _with_unit(block: sh.Shared, at: int, value: float) -> str:
    return f"{value:.9g} {block.description['variables'][at][1]}".rstrip()


def _json(value: float) -> float | None:
    """Return what JSON can hold."""
    return float(value) if math.isfinite(value) else None

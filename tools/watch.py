"""`pcpc list|get|set|watch|lock`: the variables of a running node, shown and tuned.

exit code: 0 ok; 2 wrong input or locked; 4 no such node, or it does not answer; 130 Ctrl-C
"""

import argparse
import json
import math
import shutil
import sys
import time
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from executive import shared as sh
from tools.nodes import (
    INTERRUPTED,
    OK,
    HostError,
    exactly,
    find,
    is_running,
    names_of,
    read,
    select,
    set_lock,
    tune,
)

_SLICE_S = 0.05  # how soon `watch` notices the end of the node
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "": 1.0}


def command(options: argparse.Namespace) -> int:
    """Run one of the five subcommands; print errors; return the exit code."""
    actions = {"list": _list, "get": _get, "set": _set, "watch": _watch, "lock": _lock}
    try:
        actions[options.command](find(options.node), options)
    except HostError as error:
        print(error, file=sys.stderr)
        return error.code
    except KeyboardInterrupt:
        return INTERRUPTED
    return OK


def _list(block: sh.Shared, options: argparse.Namespace) -> None:
    variables, values = block.description["variables"], read(block)
    chosen = select(names_of(block), options.names or ["*"]).values()
    rows = [(variables[at][0], float(values[at]), *variables[at][1:]) for at in chosen]
    if options.json:
        keys = ("name", "value", "unit", "kind", "writer", "help")
        print(
            json.dumps(
                [dict(zip(keys, (row[0], _json(row[1]), *row[2:]), strict=True)) for row in rows]
            )
        )
        return
    cells = [(name, f"{value:.9g}", *rest) for name, value, *rest in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(5)]
    for row in cells:
        padded = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
        padded[1] = row[1].rjust(widths[1])
        print("  ".join((*padded, row[5])))


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
    """Shows values: in place on a terminal, else one line a time, or one JSON object a line."""

    def __init__(self, block: sh.Shared, chosen: Mapping[str, int], as_json: bool) -> None:
        self._block, self._chosen, self._json = block, chosen, as_json
        self._time = names_of(block)["time.t_s"]
        self._in_place = sys.stdout.isatty()
        self._shown = 0

    def show(self, values: NDArray[np.float64]) -> None:
        cycle = round(float(values[self._time]) * 1e9 / self._block.description["period_ns"])
        if self._json:
            line = {"cycle": cycle} | {name: _json(values[at]) for name, at in self._chosen.items()}
            print(json.dumps(line), flush=True)
        elif self._in_place:
            width = max(map(len, self._chosen))
            self._rewrite(
                [f"{self._block.path.name}, cycle {cycle}"]
                + [
                    f"{name:{width}} = {_with_unit(self._block, at, values[at])}"
                    for name, at in self._chosen.items()
                ]
            )
        else:
            shown = "  ".join(f"{name}={values[at]:.9g}" for name, at in self._chosen.items())
            print(f"cycle {cycle}  {shown}", flush=True)

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

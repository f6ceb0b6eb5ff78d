"""`pcpc top [RIG]`: the screen on a terminal until q or Ctrl-C, else its lines again and again.

Only a terminal needs rich, which takes time to import.
"""

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from shutil import get_terminal_size
from typing import TYPE_CHECKING

from pcpc.drivers.errors import Exit
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.live.top.commands import TopRequest
from pcpc.tools.live.top.meter import Meter
from pcpc.tools.live.top.page import lines

if TYPE_CHECKING:
    from rich.live import Live as Screen

_LOOK_S = 0.1  # how soon a key and a new size are seen
_ONCE_S = 0.5  # over which rates are measured with --once


def command(request: TopRequest) -> int:
    """Show runs until somebody has seen enough; return the exit code."""
    if request.once:
        request.refuse("contradicts --once", "every_s")
    there = Nodes()
    rig = there.rig_of(request.run)
    if request.once:
        nodes = _nodes(there, rig, request.node)
        if not nodes:
            live = there.leader(rig, request.node or "executive")  # else what runs instead
            nodes = {live.name: live}
        meter = Meter(nodes)
        time.sleep(_ONCE_S)
        meter.look()
        print("\n".join(lines(meter, *get_terminal_size())))
        return Exit.OK
    with _screen() as screen:
        _watch(there, rig, request.node, request.every_s, screen)
    return Exit.OK


def _watch(
    there: Nodes, rig: str, node: str | None, every_s: float, screen: "Screen | None"
) -> None:
    meter, ended, shown = None, "", [""]
    while True:
        if meter is None and (nodes := _nodes(there, rig, node)):
            meter = Meter(nodes)
            time.sleep(min(every_s, _ONCE_S))  # for the first rates
        elif meter is not None and not meter.running:
            about = meter.leader.live.run
            ended, meter = f"{about}: ended in cycle {meter.leader.now.cycle}; ", None
        waiting = f"{ended}waiting for a run{f' of {rig}' if rig else ''}"
        page = [waiting] if meter is None else []
        if _show(every_s, screen, meter, page, again=not page or page != shown):
            return
        shown = page


def _show(
    every_s: float, screen: "Screen | None", meter: Meter | None, page: list[str], again: bool
) -> bool:
    """Show a page for a while; return whether somebody asked for the end.

    Without a terminal only what is new is printed (`again`).
    """
    if meter is not None:
        try:
            meter.look()
        except LiveError:  # it died in the middle of a cycle
            return False
    end_s, size = time.monotonic() + every_s, None
    while True:
        if size != get_terminal_size():  # at first, and where the terminal has another one
            size = get_terminal_size()
            text = "\n".join(page or (lines(meter, *size) if meter else []))
            if screen is None and again:
                print(text, end="\n\n", flush=True)
            elif screen is not None:
                from rich.text import Text

                screen.update(Text(text, no_wrap=True), refresh=True)
        rest_s = end_s - time.monotonic()
        if rest_s <= 0.0 or (meter is not None and not meter.running):
            return False
        if _key(min(rest_s, _LOOK_S), screen is not None) in ("q", "Q"):
            return True


def _nodes(there: Nodes, rig: str, node: str | None) -> dict[str, Live]:
    """Return the nodes of the one run that is meant, {} for none; LiveError if it is not one."""
    lives = there.running(rig)
    if node is not None:
        lives = {name: live for name, live in lives.items() if node in (name, live.run)}
    runs = {live.run for live in lives.values()}
    if len(runs) > 1:
        raise LiveError(f"{len(runs)} runs; choose one with --node: {', '.join(sorted(runs))}")
    (run,) = runs or {""}
    every = there.running(rig) if lives else {}
    return {name: live for name, live in every.items() if live.run == run}


def _key(within_s: float, terminal: bool) -> str:
    """Wait for a key, as long as there is a terminal that sends any; "" for none."""
    if not (terminal and sys.stdin is not None and sys.stdin.isatty()):
        time.sleep(within_s)
        return ""
    ready, _, _ = select.select([sys.stdin], [], [], within_s)
    return os.read(sys.stdin.fileno(), 1).decode(errors="replace") if ready else ""


@contextmanager
def _screen() -> "Iterator[Screen | None]":
    """Take the terminal, if there is one, and give it back as it was."""
    if not sys.stdout.isatty():
        yield None
        return
    from rich.console import Console
    from rich.live import Live as Screen

    keys = sys.stdin.fileno() if sys.stdin is not None and sys.stdin.isatty() else -1
    before = termios.tcgetattr(keys) if keys >= 0 else None
    try:
        if before is not None:
            tty.setcbreak(keys)
        sys.stdout.obeyed = True  # type: ignore[union-attr]
        with Screen(console=Console(highlight=False), screen=True, auto_refresh=False) as screen:
            yield screen
    finally:
        if before is not None:
            termios.tcsetattr(keys, termios.TCSADRAIN, before)

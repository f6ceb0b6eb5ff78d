"""What packages of others add: a command of theirs, and a line for each of them.

`python -m pcpc.tools.terminal.additions N` loads all from the Nth on: `pcpc doctor` does so in a
process apart, which one of them may end.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

from pcpc.drivers.errors import UserError
from pcpc.drivers.machine import outside
from pcpc.drivers.machine.outside import Addition
from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.parsing import Parser
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import offers

WORDS = {"rooms": "command", "plants": "system", "drives": "drive", "buses": "bus"}


@cache
def command_named(name: str) -> Command | None:
    """Return the command that a package adds by this name; UserError where it is broken."""
    one = outside.named("rooms", name)
    return None if one is None else _command(one)


def _command(one: Addition) -> Command:
    found = outside.loaded(one)
    if not isinstance(found, Command):
        raise outside.broken(one, f"{one.target} is of type {type(found).__name__}, not Command")
    command = _added(found, one)
    for part in (command, *command.parts):
        if not (isinstance(part.asked, type) and issubclass(part.asked, Request)):
            raise outside.broken(one, f"what {one.target} asks for is no Request")
    try:
        replace(command, name=one.name).add_to(Parser().add_subparsers(), lambda *_: None)
    except Exception as error:
        why = f"its options cannot be read: {type(error).__name__}: {error}"
        raise outside.broken(one, why) from None
    return replace(command, name=one.name)


def _added(command: Command, one: Addition) -> Command:
    parts = [_added(part, one) for part in command.parts]
    return replace(command, addition=one, parts=parts)


def lines() -> Iterator[tuple[str, str]]:
    """Yield what is added, and of which package or why it is not; nothing is loaded."""
    for kind, word in WORDS.items():
        for one in outside.additions(kind):
            taken = outside.why_taken(one, _ours(kind))
            yield f"{word} {one.name}", f"{one.package} {one.version}{taken and f': {taken}'}"


def _ours(kind: str) -> set[str]:
    if kind == "rooms":
        return {command.name for room in offers("COMMANDS") for command in room}
    from pcpc.drivers.can.bus import INTERFACES  # here, because they take half a second
    from pcpc.executive.rig.bus_keys import PROFILES
    from pcpc.executive.rig.law_lookup import shipped_plants

    return {*{"plants": shipped_plants(), "drives": PROFILES, "buses": (*INTERFACES, "auto")}[kind]}


def problem(one: Addition) -> str:
    """Load an addition; return what is wrong with it, "" if nothing is."""
    if taken := outside.why_taken(one, _ours(one.kind)):
        return str(outside.broken(one, taken))
    try:
        outside.check_version(one)
        if one.kind == "rooms":
            _command(one).function()
        elif one.kind == "drives":
            from pcpc.executive.nodes.planned_robot import kind_of  # here, because it loads numba

            kind_of(one.name)
        elif one.kind == "buses" and not callable(outside.loaded(one)):
            raise outside.broken(one, f"{one.target} cannot be called")
        elif one.kind == "plants" and not (one.folder / "rig.yaml").is_file():
            raise outside.broken(one, f"{one.target} is no folder with a rig.yaml")
    except UserError as error:
        return str(error)
    return ""


if __name__ == "__main__":
    every = [one for kind in WORDS for one in outside.additions(kind)]
    for one in every[int(sys.argv[1]) :]:
        print(problem(one), flush=True)

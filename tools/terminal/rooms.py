"""Capabilities are rooms, folders of tools/ that are found, not listed: each can be taken out.

A room is known by the names of its files: what is offered to others stands in

    commands.py    COMMANDS, PARTS_OF commands of others, BESIDE_... others' arguments, its ROOM
    api.py         what `import pcpc` offers
    checks.py      what `pcpc check` tells of a node: KEY, report(plan) and lines(one of it)
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from pcpc.drivers.errors import Exit, UserError

_TOOLS = Path(__file__).resolve().parents[1]
_DEPTHS = ("*", "*/*", "*/*/*")  # groups, rooms in them, rooms in those


class Room(NamedTuple):
    """What a room says of itself: its page, its attacker's tests; and how it is missed.

    `asked`: a command line for it alone, "" of one on which others stand. Where the room was taken
    out that is `refused` with these words and this code. `needed_by`: what goes with it.
    """

    page: str
    attacked_by: str
    asked: str = ""
    refused: str = "no such command"
    code: int = 2
    needed_by: tuple[str, ...] = ()


def declared_rooms() -> dict[str, Room]:
    """Return the rooms that say something of themselves, by their folders."""
    modules = {room: part_of(room, "commands") for room in rooms_with("commands") if room != "cli"}
    return {room: one.ROOM for room, one in modules.items() if hasattr(one, "ROOM")}


@cache
def rooms_with(part: str) -> list[str]:
    """Return the rooms that have a file `part`.py, by their folders below tools/."""
    files = [file for depth in _DEPTHS for file in _TOOLS.glob(f"{depth}/{part}.py")]
    return sorted(file.parent.relative_to(_TOOLS).as_posix() for file in files)


def offers(name: str) -> list[Any]:
    """Return what the commands.py of rooms offer under `name`, in the order of their folders."""
    modules = [
        import_module(f"pcpc.tools.{room.replace('/', '.')}.commands")
        for room in rooms_with("commands")
        if room != "cli"
    ]
    return [getattr(module, name) for module in modules if hasattr(module, name)]


def parts_called(name: str) -> list[ModuleType]:
    """Import the file `name`.py of each room that has one."""
    return [part_of(room, name) for room in rooms_with(name)]


def part_of(room: str, part: str) -> ModuleType:
    """Import a part of a room; UserError where that was taken out."""
    need_room(f"{room}/{part}", room)
    return import_module(".".join(("pcpc.tools", *room.split("/"), *part.split("/"))))


def need_room(place: str, room: str = "") -> None:
    """Raise UserError where a room, or the part of one at `place`, was taken out."""
    if not is_installed(place):
        raise UserError(f"{room or place}: not in this installation of pcpc", Exit.ENVIRONMENT)


def is_installed(room: str) -> bool:
    """Return whether a room is in this installation, not only what was compiled of it once."""
    return any((_TOOLS / file).is_file() for file in (f"{room}/__init__.py", f"{room}.py"))

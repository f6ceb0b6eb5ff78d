"""All commands of `pcpc`: those that the rooms of tools/ offer in their commands.py."""

from dataclasses import replace
from importlib import import_module

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.command import Command, exit_codes
from pcpc.tools.terminal.rooms import declared_rooms, part_of, rooms_with


def _titles() -> dict[str, str]:
    """Return what the groups, folders of tools/ with rooms, say that they are, in their order."""
    names = {room.split("/")[0] for room in rooms_with("commands")} - {"cli"}
    modules = {name: import_module(f"pcpc.tools.{name}") for name in names}
    ordered = sorted(modules, key=lambda name: modules[name].PLACE)
    return {name: modules[name].TITLE for name in ordered}


def _commands_by_group() -> dict[str, tuple[Command, ...]]:
    """Return the commands by group; parts that another room offers stand behind a command's own."""
    modules = {room: part_of(room, "commands") for room in rooms_with("commands") if room != "cli"}
    more: dict[str, list[Command]] = {}
    for module in modules.values():
        for name, parts in getattr(module, "PARTS_OF", {}).items():
            more.setdefault(name, []).extend(parts)
    groups: dict[str, list[Command]] = {group: [] for group in TITLES}
    for room, module in modules.items():
        groups[room.split("/")[0]] += [
            replace(one, parts=(*one.parts, *more.get(one.name, ()))) for one in module.COMMANDS
        ]
    return {group: tuple(commands) for group, commands in groups.items() if commands}


TITLES = _titles()
GROUPS = _commands_by_group()
COMMANDS = {command.name: command for group in GROUPS.values() for command in group}
_WORDS = """\
RIG is a name (pcpc rigs), a file, a folder with rig.yaml, or the name of a
run in progress; LOG a file, a run folder, or `latest`.
`pcpc COMMAND --help` prints the options, with an example."""


def overview() -> str:
    """Return the help's first page: what people begin with, and where the rest stands."""
    first = [(f"  {one.name}", one.help) for one in COMMANDS.values() if one.first]
    groups = [(f"  {group}", TITLES[group]) for group in GROUPS]
    return "\n".join(
        [
            "to begin with:",
            *screen.table(first),
            "",
            "all commands: `pcpc help GROUP`",
            *screen.table(groups),
            "",
            *_outside(),
            _WORDS,
            exit_codes(),
        ]
    )


def _of_command(name: str) -> str:
    """Return what a command is for, and what its room says of itself."""
    rows = [("  " + name, COMMANDS[name].help)]
    for room, one in declared_rooms().items():
        if name in {command.name for command in part_of(room, "commands").COMMANDS}:
            rows += [("  page", one.page), ("  attacked by", one.attacked_by)]
            rows += [("  without it", f"no {other}") for other in one.needed_by]
    return "\n".join([*screen.table(rows), "", f"`pcpc {name} --help` prints the options."])


def named(name: str) -> Command | None:
    """Return a command, ours or that of a package of others; UserError where that is broken."""
    if (found := COMMANDS.get(name)) is not None:
        return found
    from pcpc.tools.terminal import additions  # here, because no command of ours needs it

    return additions.command_named(name)


def _outside() -> list[str]:
    """Return what packages of others add; no lines for nothing."""
    from pcpc.tools.terminal import additions  # here, because no command of ours needs it

    rows = [(f"  {name}", whose) for name, whose in additions.lines()]
    return ["of other packages:", *screen.table(rows), ""] if rows else []


def of_group(name: str) -> str:
    """Return the commands of a group, of all for `all`; what a command's room says; UserError."""
    if name in COMMANDS and name not in GROUPS:
        return _of_command(name)
    if name != "all" and name not in GROUPS:
        cure = did_you_mean(name, [*GROUPS, "all"]) or f"; there are {', '.join(GROUPS)}, all"
        raise UserError(f"pcpc help {name}: no such group{cure}")
    lines: list[str] = []
    for group in GROUPS if name == "all" else (name,):
        rows = [(f"  {one.name}", one.help) for one in GROUPS[group]]
        lines += [f"{group}: {TITLES[group]}", *screen.table(rows), ""]
    lines += _outside() if name == "all" else []
    return "\n".join([*lines, "`pcpc COMMAND --help` prints the options, with an example."])

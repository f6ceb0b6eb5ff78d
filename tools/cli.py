"""The `pcpc` command: its subcommands and where each lives; see `tools.arguments`."""

import argparse
import importlib.metadata
import platform
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from pcpc.tools import arguments, screen
from pcpc.tools.ending import ended

_GROUPS = {
    "a rig, from choosing one to a verdict": {
        "rigs": "list the rigs that come with pcpc",
        "check": "check a rig file and print its wiring and bus load",
        "run": "start emulator, executive and recorder, end with a verdict",
        "simulate": "run the same in virtual time, in one process, without a bus",
        "experiment": "run a whole study in virtual time: tables and figures",
    },
    "its nodes one by one, in several terminals or on several machines": {
        "plant": "start the emulator only",
        "exec": "start executive and recorder only",
        "local": "start the node between the two only, of a rig with three",
    },
    "while it runs": {
        "list": "list the variables of a node with values, units and ranges",
        "get": "print values",
        "set": "tune parameters, all at once",
        "watch": "print values again and again",
        "lock": "forbid tunings (tune, all), or allow them again (none)",
    },
    "afterwards": {
        "log": "look into logs, compare, draw, convert and repair them",
        "replay": "recompute a recorded run and compare it bit by bit",
        "play": "put recorded frames on a bus",
    },
    "this machine": {
        "doctor": "what it offers, and how to get the rest",
        "jitter": "measure the timing of the loop, beside cyclictest and C",
        "bench": "measure ratios against C and others, interleaved in one run",
        "vm": "run a command on a kernel with vcan, in QEMU",
    },
}
COMMANDS = {name: text for group in _GROUPS.values() for name, text in group.items()}
_OWN_ARGUMENTS = ("replay", "play", "log", "jitter", "bench")
_MODULE = dict.fromkeys(("run", "exec", "local", "plant", "simulate"), "run") | dict.fromkeys(
    ("list", "get", "set", "watch", "lock"), "watch"
)
_WITH_VERDICT = (  # which does not depend on whether somebody reads what is printed
    "run", "exec", "local", "plant", "simulate", "check", "replay", "play", "jitter", "experiment",
    "vm",
)  # fmt: skip

_COMPILING = (
    "run",
    "exec",
    "local",
    "plant",
    "simulate",
    "check",
    "replay",
    "play",
    "experiment",
    "bench",
    "log",
)  # here
_BEGIN_NS = time.monotonic_ns()  # of this process, but for the interpreter's own start


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit code; see `tools.ending` for how it ends."""
    words = list(sys.argv[1:] if argv is None else argv)
    return ended(lambda: _carry_out(words), goes_on=words[:1] != [] and words[0] in _WITH_VERDICT)


def _carry_out(words: Sequence[str]) -> int:
    from pcpc.executive.errors import RigError, did_you_mean

    if words[:1] == ["vm"]:  # has its own arguments, up to --
        from pcpc.tools.vm import run as run_vm

        return run_vm(list(words[1:]))
    if words and not words[0].startswith("-") and words[0] not in COMMANDS:
        cure = did_you_mean(words[0], COMMANDS) or "; `pcpc --help` lists all"
        print(f"pcpc {words[0]}: no such command{cure}", file=sys.stderr)
        return arguments.USAGE
    options = parser(words[:1]).parse_args(words)
    options.begin_ns = _BEGIN_NS
    try:
        _name_files(options)
    except RigError as error:
        print(error, file=sys.stderr)
        return arguments.USAGE
    if options.command in _COMPILING:
        from pcpc.tools.progress import Compiling

        Compiling().told(getattr(options, "quiet", False))
    module = import_module(f"pcpc.tools.{_MODULE.get(options.command, options.command)}")
    return int(module.command(options))


def parser(chosen: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser; of `_OWN_ARGUMENTS` only the `chosen` one is imported."""
    found = argparse.ArgumentParser(
        "pcpc",
        usage="pcpc COMMAND ...",
        description="hardware-in-the-loop: a real-time executive and a plant emulator on CAN",
        epilog="\n".join(_commands()),
        formatter_class=screen.Help,
    )
    found.add_argument("--version", action=_Version, nargs=0, help="of pcpc, Python and numba")
    commands = found.add_subparsers(
        prog="pcpc", dest="command", required=True, metavar="COMMAND", help=argparse.SUPPRESS
    )
    arguments.add_all(commands, COMMANDS)
    for name in _OWN_ARGUMENTS:
        if name in chosen:
            import_module(f"pcpc.tools.{name}").add_arguments(commands)
        else:
            commands.add_parser(name, add_help=False)
    return found


def _commands() -> list[str]:
    """Return the help's list of commands, in the order of use."""
    lines = []
    for title, group in _GROUPS.items():
        lines += [f"{title}:", *(f"  {name:12}{text}" for name, text in group.items()), ""]
    return [
        *lines,
        "`pcpc COMMAND --help` tells the options of each, with an example.",
        "RIG is a name (pcpc rigs) or a file; LOG a file, a run folder, or `latest`.",
        arguments.CODES,
    ]


def _name_files(options: argparse.Namespace) -> None:
    """Put the file in place of a rig's name, of a run folder and of `latest`; RigError."""
    if getattr(options, "rig", None) is not None:
        from pcpc.tools.rigs import find

        options.rig = type(options.rig)(find(str(options.rig)))
    if options.command in ("log", "replay", "play"):
        from pcpc.tools.recorded import LATEST, log_of

        for key in {"log", "a", "b"} & vars(options).keys():
            value = getattr(options, key)
            setattr(options, key, type(value)(log_of(str(value))))
        if "words" in options:  # of `log plot`: logs and variables
            options.words = [str(log_of(w)) if _is_log(w, LATEST) else w for w in options.words]


def _is_log(word: str, latest: str) -> bool:
    return word == latest or Path(word).is_dir()


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        versions = [f"{name} {importlib.metadata.version(name)}" for name in ("pcpc", "numba")]
        print(", ".join((versions[0], f"Python {platform.python_version()}", versions[1])))
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())

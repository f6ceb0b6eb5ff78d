"""From the words of a command line to a command of `tools.cli.commands`."""

import argparse
import gc
import os
import platform
import re
import resource
import shlex
import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.machine import outside
from pcpc.tools.cli import completion
from pcpc.tools.cli.commands import COMMANDS, named, overview
from pcpc.tools.cli.earlier import present_words
from pcpc.tools.terminal.command import check_places
from pcpc.tools.terminal.ending import end_in_order
from pcpc.tools.terminal.parsing import Parser

_OPEN_FILES = 64  # at once: a run has 32, and its libraries theirs
# words that were commands, and the modules that they are now
_OF_THE_REPOSITORY = {"bench": "bench", "evidence": "evidence", "soak": "evidence.soak"}


def complete() -> None:
    """Answer a shell that asks which words may come next."""
    name = [*os.environ.get("COMP_LINE", "").split(), "", ""][1]
    try:
        found = parser("" if name in COMMANDS or named(name) is None else name)
    except UserError:  # that of a package which is broken
        found = parser()
    completion.complete(found, [name for name in COMMANDS if " " in name])


def goes_on(words: Sequence[str]) -> bool:
    """Return whether a command has a verdict, whoever reads its words."""
    now = joined(present_words(words)[0])
    return any(word in COMMANDS and COMMANDS[word].judges for word in now[:1])


def joined(words: Sequence[str]) -> list[str]:
    """Return the words with a command's name of two as one: `bus emulate`."""
    name = " ".join(words[:2])
    return [name, *words[2:]] if name in COMMANDS else [*words]


def carry_out(words: Sequence[str], begin_ns: int) -> int:
    """Run a command of a process that began then; return its exit code. UserError, SystemExit."""
    words, note = present_words(words)
    options = parsed_options(words)
    if note:
        print(note, file=sys.stderr)
    command = options.whole
    options.begin_ns = begin_ns
    _allow_open_files()
    check_places(options)
    _name_files(options)
    if command.compiles:
        from pcpc.tools.terminal.progress import Compiling

        Compiling().told(getattr(options, "quiet", False))
    if command.compiles and command.module.startswith("run.") and hasattr(options, "rig"):
        from pcpc.executive.nodes import first_start

        first_start.start_helper(str(options.rig))
    function = options.registered.function()
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
    end_in_order()
    return int(function(options.registered.request(options)))


def _allow_open_files() -> None:
    """Raise a low limit of open files as far as is allowed; UserError if that does not do."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= soft < _OPEN_FILES:
        if 0 <= hard < _OPEN_FILES:
            what = f"{hard} open files are allowed, {_OPEN_FILES} are needed"
            raise UserError(f"{what}; raise the limit with `ulimit -n`", Exit.ENVIRONMENT)
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, hard))


def parsed_options(words: Sequence[str]) -> argparse.Namespace:
    """Return the options of a command line; UserError. SystemExit of a help."""
    if not words:
        what = "no command; `pcpc simulate hull` runs a rig, `pcpc --help` lists all commands"
        raise UserError(f"pcpc: {what}")
    words = joined(words)
    name = words[0]
    command = None if name.startswith("-") else named(name)
    if command is None and not name.startswith("-"):
        from pcpc.executive.errors import did_you_mean

        cure = did_you_mean(name, COMMANDS) or "; `pcpc --help` lists all"
        if module := _OF_THE_REPOSITORY.get(name):
            cure = f" any more; in the repository, `python -m pcpc.tools.dev.{module}` is it"
        raise UserError(f"pcpc {name}: no such command{cure}")
    last = command.last if command is not None else ""
    rest: list[str] = []
    behind: list[str] = []
    if command is not None and command.rest and "--" in words:
        at = words.index("--")
        words, rest = words[:at], list(words[at + 1 :])
    if last and last in words:  # argparse would stop at a -- in it
        at = words.index(last) + 1
        words, behind = words[:at], list(words[at:])
    options = parser(name).parse_args(words, argparse.Namespace(rest=rest, whole=command))
    if any(value for name, value in vars(options).items() if name.startswith("elsewhere")):
        raise UserError(
            f"--at is gone; run it there: {_by_ssh(options.elsewhere or 'HOST', words)}"
        )
    if behind:
        setattr(options, last.removeprefix("--"), behind)
    return options


def _by_ssh(host: str, words: Sequence[str]) -> str:
    """Return the command line that does on another machine what `--at HOST:PORT` did."""
    own, with_value = ("--at", "--token-file", "--ca", "--plain"), ("--at", "--token-file", "--ca")
    there = [
        word
        for before, word in pairwise(("", *words))
        if before not in with_value and word.partition("=")[0] not in own
    ]
    found = re.fullmatch(r"\[(.+)\](?::\d+)?|([^:]+):\d+", host)  # the port is that of `pcpc host`
    name = (found[1] or found[2]) if found else host
    return shlex.join(["ssh", "-t", name, "pcpc", *map(shlex.quote, there)])


def parser(name: str = "") -> Parser:
    """Return the parser of all commands, or of the one that is named: a twentieth of a start."""
    found = Parser(
        prog="pcpc",
        usage="pcpc COMMAND ...",
        description="hardware-in-the-loop: a real-time executive and a plant emulator on CAN",
        epilog=overview() if name in ("-h", "--help") else None,
    )
    found.add_argument("--version", action=_Version, nargs=0, help="of pcpc, Python and numba")
    commands = found.add_subparsers(
        prog="pcpc", dest="command", required=True, metavar="COMMAND", help=argparse.SUPPRESS
    )
    only = None if name.startswith("-") else named(name)
    for command in [only] if only else COMMANDS.values():
        command.add_to(commands, completion.attach)
    for one in [] if name else outside.additions("rooms"):
        commands.add_parser(one.name)
    return found


def _name_files(options: argparse.Namespace) -> None:
    """Put the file in place of a rig's name, of a run folder and of `latest`; RigError."""
    is_schema_of_all = getattr(options, "schema", False) and not options.rig
    if getattr(options, "rig", None) is not None and not is_schema_of_all:
        from pcpc.tools.start.rigs import find

        options.rig = type(options.rig)(find(str(options.rig)))
    if options.whole.reads_logs:
        from pcpc.tools.after.log.recorded import LATEST, log_of

        for key in {"log", "a", "b"} & vars(options).keys():
            value = getattr(options, key)
            setattr(options, key, type(value)(log_of(str(value))))
        if "words" in options:  # of `log plot`: logs and variables
            options.words = [
                str(log_of(word)) if word == LATEST or Path(word).is_dir() else word
                for word in options.words
            ]


class _Version(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        versions = [f"{name} {version(name)}" for name in ("pcpc", "numba")]
        print(", ".join((versions[0], f"Python {platform.python_version()}", versions[1])))
        parser.exit()

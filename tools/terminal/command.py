"""How a command of `pcpc` is registered: one `Command` in the commands.py of its room is enough."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.machine import outside
from pcpc.drivers.machine.outside import Addition
from pcpc.tools.terminal.option_notes import note_options
from pcpc.tools.terminal.outfile import check_file, check_folder, check_source
from pcpc.tools.terminal.request import Add as Add
from pcpc.tools.terminal.request import Request

Attach = Callable[[str, argparse.Action], None]
Check = Callable[[str, Path], None]  # of an option's place

BASIC_CODES = {Exit.OK: "", Exit.WRONG_INPUT: ""}


def codes(others: Mapping[Exit, str] = BASIC_CODES, **said: str) -> dict[Exit, str]:
    """Return exit codes by their names with their words beside `others`, in order."""
    return dict(sorted({**others, **{Exit[name]: words for name, words in said.items()}}.items()))


NODE_CODES = codes(ENVIRONMENT="no such node, or no answer", INTERRUPTED="")
LOG_CODES = codes(LOSS="the log is damaged", INTERRUPTED="")
OUTPUT_CODES = codes(
    LOSS="a log is damaged; its readable part was written",
    ENVIRONMENT="cannot be written, or a package is missing",
    INTERRUPTED="",
)


PLACES = {"DIR": "a folder", "FILE": "a file", "OUT": "a file", "LOG": "a log", "A": "a log",
          "B": "a log"}  # fmt: skip
CHECKS: dict[str, Check] = {"DIR": check_folder, "FILE": check_file, "OUT": check_file}


@dataclass(frozen=True)
class Command:
    """A command, or with `parts` a family of them: `pcpc log info`.

    It is carried out by `command(request)` in pcpc.tools.MODULE, which is imported only then.
    """

    name: str
    help: str  # one line
    example: str  # command lines to copy
    asked: type[Request] = Request  # whose fields its options are
    module: str = ""  # below pcpc.tools
    codes: Mapping[Exit, str] | None = None  # with words of its own, "" for the usual; None: all
    notes: str = ""  # in its help, above the exit codes
    judges: bool = False  # its verdict does not depend on whether somebody reads what it prints
    compiles: bool = False  # in this process
    reads_logs: bool = False
    rest: str = ""  # takes the words after --, which are so called
    last: str = ""  # an option that takes all words behind it, also --
    own_h: bool = False  # -h is an option of its own
    first: bool = False  # one that people begin with
    parts: Sequence["Command"] = ()
    addition: Addition | None = None  # of a package of others: `module` is below nothing then

    def add_to(self, commands: "argparse._SubParsersAction[Any]", attach: Attach) -> None:
        """Register it; `attach` gives its arguments the words that a shell can complete."""
        parser = commands.add_parser(
            self.name,
            help=self.help,
            description=self.help,
            epilog=self._epilog(),
            conflict_handler="resolve" if self.own_h else "error",
            usage=f"%(prog)s [options] -- {self.rest}" if self.rest else None,
        )
        places: list[tuple[argparse.Action, Check]] = []
        parser.set_defaults(registered=self, places=places)
        note_options(parser)

        def add(*names: str, **about: Any) -> argparse.Action:
            kind = str(about.get("metavar", "")).partition(".")[0]
            if kind in PLACES and "nargs" not in about:
                about["type"] = _nonempty_kind(names[0], PLACES[kind], about.get("type", str))
            check = check_source if about.pop("reads", False) else CHECKS.get(kind)
            action = parser.add_argument(*names, **about)
            if check and action.option_strings and action.nargs is None:
                places.append((action, check))
            attach(self.name, action)
            return action

        self.asked.add_to(add)
        if self.parts:
            parts = parser.add_subparsers(required=True, metavar="SUB")
            for part in self.parts:
                part.add_to(parts, attach)

    def request(self, options: argparse.Namespace) -> Request:
        """Return what `command` in its module takes of the options that were read."""
        return self.asked.from_options(options)

    def function(self) -> Callable[[Request], int]:
        """Import what carries it out; UserError where a package of others is broken."""
        if self.addition is not None:
            return outside.loaded(self.addition, f"{self.module}:command")
        return import_module(f"pcpc.tools.{self.module}").command

    def _epilog(self) -> str:
        lines = ["example:", *(f"  {line}" for line in self.example.splitlines())]
        tail = "each SUB has its own --help" if self.parts else exit_codes(self.codes)
        return "\n".join([*lines, *self.notes.splitlines(), tail])


def _nonempty_kind(option: str, expected: str, kind: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return `kind` that refuses an empty name, as that of a variable that is not set; UserError.

    `Path` would make of it the folder in which one is.
    """

    def nonempty_value(text: str) -> Any:
        if not text:
            raise UserError(f"{option} '': expected {expected}")
        return kind(text)

    return nonempty_value


def check_places(options: argparse.Namespace) -> None:
    """Raise UserError for an option's file or folder that cannot be, before the work begins."""
    for action, check in options.places:
        value = getattr(options, action.dest)
        for one in value if isinstance(value, list) else [value]:
            if one is not None and one != action.default and str(one) != "-":
                check(action.option_strings[0], Path(one))


def exit_codes(codes: Mapping[Exit, str] | None = None) -> str:
    """Return the line of a help about exit codes."""
    chosen = codes or dict.fromkeys(Exit, "")
    told = (f"{code:d} {said or code.meaning}" for code, said in chosen.items())
    return f"exit code: {', '.join(told)}"

"""How a command of `pcpc` is registered: one `Command` in commands.py is all that it takes."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pcpc.drivers.errors import Exit
from pcpc.tools.console import completion, screen

Add = Callable[..., argparse.Action]  # add_argument of a command's parser


def nothing(add: Add) -> None:
    """Take no arguments."""


@dataclass(frozen=True)
class Command:
    """A command, or with `parts` a family of them: `pcpc log info`.

    It is carried out by `command(options)` in pcpc.tools.MODULE, which is imported only then.
    """

    name: str
    help: str  # one line
    example: str  # command lines to copy
    arguments: Callable[[Add], None] = nothing
    module: str = ""  # else its name
    codes: Mapping[Exit, str] | None = None  # with words of its own, "" for the usual; None: all
    notes: str = ""  # in its help, above the exit codes
    judges: bool = False  # its verdict does not depend on whether somebody reads what it prints
    compiles: bool = False  # in this process
    reads_logs: bool = False
    rest: str = ""  # takes the words after --, which are so called
    last: str = ""  # an option that takes all words behind it, also --
    own_h: bool = False  # -h is an option of its own
    parts: Sequence["Command"] = ()

    @property
    def at(self) -> str:
        """The module below pcpc.tools that carries it out."""
        return self.module or self.name

    def add_to(self, commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
        """Register it."""
        parser = commands.add_parser(
            self.name, help=self.help, description=self.help, epilog=self._epilog(),
            formatter_class=screen.Help, conflict_handler="resolve" if self.own_h else "error",
            usage=f"%(prog)s [options] -- {self.rest}" if self.rest else None,
        )  # fmt: skip
        parser.set_defaults(registered=self)

        def add(*names: str, **about: Any) -> argparse.Action:
            action = parser.add_argument(*names, **about)
            completion.attach(self.name, action)
            return action

        self.arguments(add)
        if self.parts:
            parts = parser.add_subparsers(required=True, metavar="SUB")
            for part in self.parts:
                part.add_to(parts)

    def _epilog(self) -> str:
        lines = ["example:", *(f"  {line}" for line in self.example.splitlines())]
        tail = "each SUB has its own --help" if self.parts else exit_codes(self.codes)
        return "\n".join([*lines, *self.notes.splitlines(), tail])


def exit_codes(codes: Mapping[Exit, str] | None = None) -> str:
    """Return the line of a help about exit codes."""
    chosen = codes or dict.fromkeys(Exit, "")
    told = (f"{code:d} {said or code.meaning}" for code, said in chosen.items())
    return f"exit code: {', '.join(told)}"

"""Commands of this repository, `python -m NAME`: options, messages and ends as those of `pcpc`."""

import time
from collections.abc import Sequence
from importlib import import_module

from pcpc.tools.terminal.command import Command, check_places
from pcpc.tools.terminal.ending import end_in_order, exit_code, leave_at_once
from pcpc.tools.terminal.parsing import Parser
from pcpc.tools.terminal.progress import Compiling


def carried_out(command: Command, words: Sequence[str]) -> int:
    """Run a command; return its exit code. UserError, SystemExit of a help."""
    parser = Parser(prog="python -m")
    commands = parser.add_subparsers(prog="python -m", dest="command", required=True)
    command.add_to(commands, lambda *_: None)
    options = parser.parse_args([command.name, *words])
    options.begin_ns = time.monotonic_ns()
    check_places(options)
    Compiling().told(options.quiet)
    module = import_module(f"pcpc.tools.{command.module}")
    end_in_order()
    return int(module.command(command.request(options)))


def main(command: Command, words: Sequence[str], own: bool = False) -> int:
    """Run a command, `own`: in a process that ends with it; return its exit code."""
    if own:
        leave_at_once()
    return exit_code(lambda: carried_out(command, words), goes_on=False, last=own)

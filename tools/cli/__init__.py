"""The `pcpc` command; what it does is in `command_line`, which takes most of a start to load."""

import gc
import os
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.tools.terminal.ending import exit_code, leave_at_once, refusal

_BEGIN_NS = time.monotonic_ns()  # of this process, but for the interpreter's own start


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; see `tools.terminal.ending` for how it ends."""
    own = argv is None  # a process of its own
    if own:
        leave_at_once()
        gc.disable()  # to look for garbage in imports is a fifth of a start
    try:
        from pcpc.tools.cli import command_line  # here, so that a signal meanwhile is heard
    except (OSError, MemoryError) as error:
        said = refusal(error) or UserError()
        print(said, file=sys.stderr)
        return said.code
    if "_ARGCOMPLETE" in os.environ:  # a shell asks which words may come next
        command_line.complete()
    words = list(sys.argv[1:] if argv is None else argv)
    goes_on = command_line.goes_on(words)
    return exit_code(lambda: command_line.carry_out(words, _BEGIN_NS), goes_on=goes_on, last=own)


def __getattr__(name: str) -> Any:
    """Return a part of `command_line`, which is loaded on use."""
    if name.startswith("__") or name == "command_line":
        raise AttributeError(name)
    return getattr(import_module("pcpc.tools.cli.command_line"), name)

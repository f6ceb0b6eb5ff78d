"""Commands: spin. Imported when somebody asks for it."""

from typing import Annotated

from pcpc.tools.terminal.command import BASIC_CODES, Command
from pcpc.tools.terminal.request import Request


class SpinRequest(Request):
    """How often."""

    turns: Annotated[int, "N", "whole turns"]
    backwards: Annotated[bool, "the other way"] = False


SPIN = Command(
    "spin",
    "turn on the spot",
    "pcpc spin 3 --backwards",
    SpinRequest,
    module="pcpc_acme.spin",
    codes=BASIC_CODES,
)

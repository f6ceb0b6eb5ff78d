"""Commands: rigs."""

from collections.abc import Sequence
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import BASIC_CODES, Command
from pcpc.tools.terminal.request import WORD, Request


class RigsRequest(Request):
    """Names or patterns of rigs."""

    names: Annotated[
        Sequence[str], WORD, "NAME", "only these rigs or plants; patterns with * ? []"
    ] = ()
    json: take.Json = False


COMMANDS = (
    Command(
        "rigs",
        "list the rigs that come with pcpc",
        "pcpc rigs atb1000 'friction-*'",
        RigsRequest,
        codes=BASIC_CODES,
        module="start.rigs",
        first=True,
    ),
)

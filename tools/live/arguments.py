"""What the commands about running nodes take; imports nothing that takes time."""

from typing import Annotated

from pcpc.tools.terminal.request import HIDDEN, Request

Node = Annotated[str | None, "NODE", "executive, plant, RIG, RIG.plant or a full name"]
NodeOfNames = Annotated[
    str | None, "NODE", "executive, plant, RIG or RIG.plant; default: the one that has NAME"
]


class Elsewhere(Request):
    """What once asked another machine, and is answered with what does so now."""

    elsewhere: Annotated[str | None, "--at", HIDDEN] = None
    elsewhere_token: Annotated[str | None, "--token-file", HIDDEN] = None
    elsewhere_ca: Annotated[str | None, "--ca", HIDDEN] = None
    elsewhere_plain: Annotated[bool, "--plain", HIDDEN] = False

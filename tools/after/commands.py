"""Commands: replay."""

from collections.abc import Sequence
from typing import Annotated

from pcpc.executive.rig.roles import ROLES
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import WORD, Offers, Request


class ReplayRequest(Request):
    """A log or several, and what is changed in one."""

    logs: Annotated[
        Sequence[str],
        WORD,
        "LOG",
        "log file, run folder or latest; several: a row each",
    ] = ()
    node: Annotated[
        str,
        "NODE",
        "node to recompute; device: its frames, by the rig's law; default: all",
        {"choices": (*ROLES, "device", "all")},
    ] = "all"
    since: Annotated[
        float | None,
        take.time,
        "--from",
        "TIME",
        "first time of the run that is compared: 1.5, 500ms",
    ] = None
    until: Annotated[float | None, take.time, "--to", "TIME", "last time that is compared"] = None
    show: Annotated[
        Sequence[str], "NAME", "print this variable as CSV, a row a cycle; * is any text"
    ] = ()
    controller: Annotated[str | None, "NAME", "use another controller of the log's rig"] = None
    set: Annotated[
        Sequence[str],
        "NAME=VALUE",
        "recompute with a change, in open loop: recorded frames stay",
    ] = ()
    code: take.CodeOfLaws = take.CodeOfLaws()
    beside: Annotated[Offers, "BESIDE_REPLAY"] = Offers()
    json: take.Json = False
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "replay",
        "recompute recorded runs, compare them bit by bit, sign that they are",
        "pcpc replay latest\npcpc replay latest --cycle 2000 --show 'barrel.*'\n"
        "pcpc replay runs --table runs/verified.txt --sign ~/.ssh/id_ed25519\n"
        "pcpc replay --check runs/verified.txt --signers signers --identity me@lab",
        ReplayRequest,
        codes=codes(
            OK="all bit-identical",
            NOT_MET="something differs, or is not as in the table; a wrong signature",
            LOSS="nothing differs, but a log is incomplete or missing",
            SAFETY_STOP="a law hangs or raises",
            INTERRUPTED="",
        ),
        judges=True,
        compiles=True,
        module="after.replay",
        first=True,
    ),
)

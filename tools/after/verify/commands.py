"""What `replay` takes of many logs."""

from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class ManyLogs(Request):
    """What is written of logs, or held against them."""

    brief: Annotated[bool, "a row a log, as of several logs or a folder of them"] = False
    table: Annotated[Path | None, "FILE", "write digests and verdicts"] = None
    sign: Annotated[str | None, "KEY", "sign the table with an SSH key: FILE.sig"] = None
    check: Annotated[
        Path | None,
        "FILE",
        "check logs against a table; default: those beside it",
        {"reads": True},
    ] = None
    signers: Annotated[
        str | None, "FILE", "check its signature: allowed signers of ssh-keygen", {"reads": True}
    ] = None
    identity: Annotated[str | None, "WHO", "who must have signed it"] = None
    junit: Annotated[Path | None, "FILE", "a testcase for each log"] = None
    jobs: Annotated[
        int | None,
        take.positive,
        "N",
        "processes; default: one a processor, fewer for small logs",
    ] = None


BESIDE_REPLAY = ManyLogs
COMMANDS: tuple[Command, ...] = ()
ROOM = Room(
    "docs/howto/ci.md",
    "tests/tools/after/verify",
    "replay latest --brief",
    refused="no option --brief",
)

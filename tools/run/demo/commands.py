"""Commands: demo."""

from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class DemoRequest(Request):
    """Which rig moves, and where it is seen."""

    rig: Annotated[str, "NAME", "a rig's name (pcpc rigs), or its file; default: %(default)s"] = (
        "hull"
    )
    terminal: Annotated[bool, "draw it in this terminal; needs no browser, no bus"] = False
    port: Annotated[
        int | None, take.port, "N", "port of the page; default: the first free from 8642 on"
    ] = None


COMMANDS = (
    Command(
        "demo",
        "show a rig in motion in the browser, for five minutes",
        "pcpc demo\npcpc demo --rig suspension-kick --terminal",
        DemoRequest,
        codes=codes(OK="Ctrl-C, or five minutes", ENVIRONMENT="the port is taken"),
        compiles=True,
        module="run.demo.cli",
        first=True,
    ),
)
ROOM = Room("README.md", "tests/tools/run/test_demo.py", "demo", needed_by=("dev/release.py",))

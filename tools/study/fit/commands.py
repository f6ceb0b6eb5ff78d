"""Commands: fit."""

from collections.abc import Sequence
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room


class FitRequest(Request):
    """A rig, a log, and what is to be estimated from which sensors."""

    rig: Annotated[str, "RIG", "the rig whose plant is the model: name or file"]
    log: take.Log
    parameter: Annotated[
        Sequence[str],
        "NAME[=lo:hi]",
        "a setting of the plant, BLOCK.NAME, and its bounds; default: those of the plant's "
        "identification.py",
    ] = ()
    sensor: Annotated[
        Sequence[str],
        "NAME",
        "FRAME.signal, or BLOCK.PORT in the plant's record; default: all sent",
    ] = ()
    set: Annotated[
        Sequence[str], "NAME=VALUE", "change a value of the model, or a start of the search"
    ] = ()
    output: Annotated[str | None, "-o", "DIR", "folder; default: runs/<UTC time>-fit-<rig>"] = None
    json: take.Json = False
    quiet: take.Quiet = False


COMMANDS = (
    Command(
        "fit",
        "estimate plant parameters from a log, with 95 % intervals",
        "pcpc fit slew10 latest\n"
        "pcpc fit slew10 latest --parameter barrel.gap_rad=0:0.01 -o fitted\n"
        "pcpc simulate slew10 --set @fitted/fit.yaml",
        FitRequest,
        judges=True,
        compiles=True,
        reads_logs=True,
        module="study.fit.cli",
        codes=codes(
            NOT_MET="the log does not determine a --parameter, or no parameter at all",
            LOSS="the log is damaged",
            ENVIRONMENT="a package is missing",
            INTERRUPTED="",
        ),
    ),
)
ROOM = Room("docs/howto/fit.md", "tests/tools/study/test_fit.py", "fit probe latest")

"""Commands: log."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import LOG_CODES, OUTPUT_CODES, Command, codes
from pcpc.tools.terminal.request import Request
from pcpc.tools.terminal.rooms import Room

_Log = Annotated[Path, "LOG", "log file, run folder or latest"]


class Window(Request):
    """A part of a log, in time."""

    start_s: Annotated[
        float | None, take.time, "--start", "TIME", "from 1.5 or 500ms after the start on"
    ] = None
    end_s: Annotated[float | None, take.time, "--end", "TIME", "up to this time"] = None


class InfoRequest(Request):
    """A log."""

    log: _Log
    json: take.Json = False
    quiet: take.Quiet = False


class Bits(Request):
    """Whether two logs are compared value by value, and what counts as a difference."""

    bits: Annotated[bool, "two logs: every variable and frame, bit by bit"] = False
    absolute: Annotated[float, "ABS", "--bits: absolute tolerance"] = 0.0


class RecoverRequest(Request):
    """A damaged log."""

    log: _Log
    output: Annotated[Path | None, "-o", "OUT", "new file; default: LOG-recovered.mcap"] = None
    json: take.Json = False
    quiet: take.Quiet = False


class ExportRequest(Request):
    """A log, which part of it, and a file."""

    log: _Log
    output: Annotated[Path, "-o", "FILE", "file to write; -: as text to stdout, of any topics"]
    format: Annotated[
        Literal["candump", "blf", "asc", "csv", "parquet", "mf4", "ndjson"] | None,
        "default: by the suffix of FILE; -: candump of frames, csv of variables, else ndjson",
    ] = None
    topics: Annotated[
        Sequence[str] | None,
        "TOPIC",
        "/can/frames; /state, /timing; with /plant before them the plant's; "
        "-: also /events, /tunings, ...",
        {"nargs": "+"},
    ] = None
    window: Window = Window()
    force: Annotated[bool, "overwrite FILE"] = False
    json: take.Json = False
    quiet: take.Quiet = False


class ImportRequest(Request):
    """A recording and perhaps its DBC file."""

    recording: Annotated[Path, "FILE", "recording of a CAN bus"]
    dbc: Annotated[
        Path | None,
        "FILE.dbc",
        "DBC file of its frames; without one only frames are imported",
        {"reads": True},
    ] = None
    output: Annotated[Path, "-o", "OUT.mcap", "log to write"]
    node: Annotated[
        str | None, "NAME", "direction of frames as seen by this node of the DBC file"
    ] = None
    channel: Annotated[str | None, "NAME", "only this channel of the recording"] = None
    force: Annotated[bool, "overwrite OUT.mcap"] = False
    json: take.Json = False
    quiet: take.Quiet = False


class Requirements(Request):
    """Whether only requirements are told, and which."""

    requirements: Annotated[bool, "print only what became of each requirement"] = False
    require: Annotated[
        Sequence[str],
        "REQUIREMENT",
        "judge by this instead: 'always: CONDITION'; repeatable",
    ] = ()
    json: Annotated[bool, "--requirements, --require: print JSON"] = False


class PlotRequest(Request):
    """Logs, variables and a picture."""

    words: Annotated[
        Sequence[str],
        "LOG|VARIABLE",
        "logs, and variables (* ? [] as in the shell, in quotes); "
        "no variables: the figure of its evaluation",
    ]
    output: Annotated[
        Path, "-o", "FILE.png", ".png, .svg or .pdf; default: %(default)s; --moving: .gif"
    ] = Path("plot.png")
    moving: Annotated[bool, "the plant of a log as it moved, a GIF"] = False
    speed: Annotated[float, "X", "--moving: playback; default: 1"] = 1.0
    code: take.CodeOfLaws = take.CodeOfLaws()
    window: Window = Window()
    quiet: take.Quiet = False


_PARTS = (
    Command(
        "info",
        "show what a log holds and what is missing in it",
        "pcpc log info latest",
        InfoRequest,
        module="after.log.info",
        codes=LOG_CODES,
    ),
    Command(
        "recover",
        "write the readable part of a damaged log to a new file",
        "pcpc log recover latest",
        RecoverRequest,
        module="after.log.recover",
        codes=codes(
            OK="messages were recovered",
            WRONG_INPUT="nothing was recovered",
            LOSS="the disk is full",
            ENVIRONMENT="cannot be written",
            INTERRUPTED="",
        ),
    ),
    Command(
        "export",
        "export frames as candump, BLF, ASC, variables as CSV, Parquet, both as MDF 4",
        "pcpc log export latest -o frames.blf\n"
        "pcpc log export latest -o - --topics /can/frames --end 500ms",
        ExportRequest,
        module="after.log.export",
        codes=OUTPUT_CODES,
    ),
    Command(
        "import",
        "make a log of a recording: candump, BLF, ASC, TRC, MDF 4, python-can's CSV and SQLite",
        "pcpc log import drive.blf --dbc car.dbc -o drive.mcap\n"
        "pcpc log import drive.log -o drive.mcap\npcpc play drive.mcap --bus vcan0",
        ImportRequest,
        module="after.log.importer",
        codes=codes(
            OUTPUT_CODES,
            LOSS="something of the recording is lost; all that can be read is imported",
        ),
    ),
    Command(
        "plot",
        "draw variables over time, of one log or several",
        "pcpc log plot runs/A runs/B controller.e_rad 'barrel.*' -o e.png\n"
        "pcpc log plot latest --moving -o barrel.gif\n"
        "pcpc log plot latest --moving --start 0.4s --end 1.6s --speed 0.2 -o slew.gif",
        PlotRequest,
        module="after.log.plot",
        codes=OUTPUT_CODES,
    ),
)

BESIDE_COMPARE = Bits
BESIDE_REPORT = Requirements
COMMANDS = (
    Command(
        "log",
        "inspect, compare, draw, convert and repair logs",
        "pcpc log info latest",
        compiles=True,
        reads_logs=True,
        parts=_PARTS,
        first=True,
    ),
)
ROOM = Room("docs/log-format.md", "tests/tools/after/log")

"""Commands: log."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import LOG_CODES, OUTPUT_CODES, Add, Command, codes


def info(add: Add) -> None:
    """Take a log."""
    take.log(add, type=Path)
    take.json(add)
    take.quiet(add)


def cat(add: Add) -> None:
    """Take a log, which part of it, and in which format."""
    take.log(add, type=Path)
    add(
        "--topics",
        nargs="+",
        metavar="TOPIC",
        help="/state, /timing, /can/frames, /events, /tunings, /plant/state, ...; "
        "default: /state as csv, /can/frames as candump, all as ndjson",
    )
    add(
        "--format",
        choices=("csv", "ndjson", "candump"),
        help="default: candump for frames, csv for variables, ndjson for all else",
    )
    _window(add, "up to this time")
    take.quiet(add)


def _window(add: Add, end: str) -> None:
    add("--start", metavar="TIME", help="from this time on: 1.5 or 500ms after the start")
    add("--end", metavar="TIME", help=end)


def diff(add: Add) -> None:
    """Take two logs, and what counts as a difference."""
    add("a", type=Path, metavar="A", help="log file, run folder or latest")
    add("b", type=Path, metavar="B", help="the other log")
    add(
        "variables",
        nargs="*",
        metavar="VAR",
        help="compare only these, and no frames; default: all but timing",
    )
    add("--tolerance", type=float, default=0.0, metavar="REL", help="relative tolerance")
    add("--absolute", type=float, default=0.0, metavar="ABS", help="absolute tolerance")
    take.json(add)
    take.quiet(add)


def recover(add: Add) -> None:
    """Take a damaged log."""
    take.log(add, type=Path)
    add("-o", "--output", type=Path, metavar="OUT", help="new file; default: LOG-recovered.mcap")
    take.json(add)
    take.quiet(add)


def export(add: Add) -> None:
    """Take a log, which part of it, and a file."""
    take.log(add, type=Path)
    add("-o", "--output", type=Path, required=True, metavar="FILE", help="file to write")
    add(
        "--format",
        choices=("candump", "blf", "asc", "csv", "parquet", "mf4"),
        help="default: by the suffix of FILE",
    )
    add(
        "--topics",
        nargs="+",
        metavar="TOPIC",
        help="/can/frames; /state, /timing; with /plant before them the plant's",
    )
    _window(add, "up to this time")
    add("--force", action="store_true", help="overwrite FILE")
    take.json(add)
    take.quiet(add)


def import_(add: Add) -> None:
    """Take a recording and perhaps its DBC file."""
    add("recording", type=Path, metavar="FILE", help="recording of a CAN bus")
    about = "DBC file of its frames; without one only frames are imported"
    add("--dbc", type=Path, reads=True, metavar="FILE.dbc", help=about)
    add("-o", "--output", type=Path, required=True, metavar="OUT.mcap", help="log to write")
    add("--node", metavar="NAME", help="direction of frames as seen by this node of the DBC file")
    add("--channel", metavar="NAME", help="only this channel of the recording")
    add("--force", action="store_true", help="overwrite OUT.mcap")
    take.json(add)
    take.quiet(add)


def require(add: Add) -> None:
    """Take a log, and what is required of it."""
    take.log(add, type=Path)
    take.several(
        add, "--require", "REQUIREMENT", "judge by this instead: 'always: CONDITION'; repeatable"
    )
    take.code_of_laws(add)
    take.json(add)
    take.quiet(add)


def plot(add: Add) -> None:
    """Take logs, variables and a picture."""
    add(
        "words",
        nargs="+",
        metavar="LOG|VARIABLE",
        help="logs, and variables (* ? [] as in the shell, in quotes); "
        "no variables: the figure of its evaluation",
    )
    add(
        "-o",
        "--output",
        type=Path,
        default=Path("plot.png"),
        metavar="FILE.png",
        help=".png, .svg or .pdf; default: %(default)s",
    )
    take.code_of_laws(add)
    _window(add, "up to this time")
    take.quiet(add)


def animate(add: Add) -> None:
    """Take a log, and a film."""
    take.log(add, type=Path)
    add("-o", "--output", type=Path, required=True, metavar="FILE.gif", help="GIF to write")
    add("--speed", type=float, default=1.0, metavar="X", help="playback speed; default: 1")
    take.code_of_laws(add)
    _window(add, "up to this time")
    take.quiet(add)


_PARTS = (
    Command(
        "info",
        "show what a log holds and what is missing in it",
        "pcpc log info latest",
        info,
        module="after.log.info",
        codes=LOG_CODES,
    ),
    Command(
        "cat",
        "print the messages of a log as text",
        "pcpc log cat latest --topics /can/frames --end 500ms",
        cat,
        module="after.log.cat",
        codes=LOG_CODES,
    ),
    Command(
        "diff",
        "compare two logs, variable by variable and frame by frame",
        "pcpc log diff runs/A runs/B 'controller.*' --absolute 1e-9",
        diff,
        module="after.log.diff",
        codes=codes(
            OK="equal",
            NOT_MET="they differ",
            LOSS="equal as far as readable",
            INTERRUPTED="",
        ),
    ),
    Command(
        "recover",
        "write the readable part of a damaged log to a new file",
        "pcpc log recover latest",
        recover,
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
        "pcpc log export latest -o frames.blf",
        export,
        module="after.log.export",
        codes=OUTPUT_CODES,
    ),
    Command(
        "import",
        "make a log of a recording: candump, BLF, ASC, TRC, MDF 4, python-can's CSV and SQLite",
        "pcpc log import drive.blf --dbc car.dbc -o drive.mcap\n"
        "pcpc log import drive.log -o drive.mcap\npcpc play drive.mcap --bus vcan0",
        import_,
        module="after.log.importer",
        codes=codes(
            OUTPUT_CODES,
            LOSS="something of the recording is lost; all that can be read is imported",
        ),
    ),
    Command(
        "require",
        "judge a log by its rig's requirements, or by others",
        "pcpc log require latest --require 'never: abs(controller.e_rad) > 5 mrad, after: 1s'",
        require,
        module="after.log.require",
        codes=codes(
            OK="all hold",
            NOT_MET="violated",
            LOSS="all hold as far as the log is readable",
            INTERRUPTED="",
        ),
    ),
    Command(
        "plot",
        "draw variables over time, of one log or several",
        "pcpc log plot runs/A runs/B controller.e_rad 'barrel.*' -o e.png",
        plot,
        module="after.log.plot",
        codes=OUTPUT_CODES,
    ),
    Command(
        "animate",
        "animate the plant of a log as a GIF",
        "pcpc log animate latest -o barrel.gif\n"
        "pcpc log animate latest --start 0.4s --end 1.6s --speed 0.2 -o slew.gif",
        animate,
        module="after.log.animate",
        codes=OUTPUT_CODES,
    ),
)

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

"""What the parts of `pcpc log` take."""

from pathlib import Path

from pcpc.tools.console.arguments import code_of_laws, json, quiet
from pcpc.tools.console.command import Add


def _log(add: Add) -> None:
    add("log", type=Path, metavar="LOG", help="log file or run folder")


def _window(add: Add, end: str) -> None:
    add("--start", metavar="TIME", help="from here on: 1.5 or 500ms after the start")
    add("--end", metavar="TIME", help=end)


def info(add: Add) -> None:
    """Take a log."""
    _log(add)
    json(add)
    quiet(add)


def cat(add: Add) -> None:
    """Take a log, which part of it, and in which format."""
    _log(add)
    add("--topics", nargs="+", metavar="TOPIC",
        help="/state, /timing, /can/frames, /events, /tunings, /plant/state, ...; "
        "default: /state as csv, /can/frames as candump, all as ndjson")  # fmt: skip
    add("--format", choices=("csv", "ndjson", "candump"),
        help="default: candump for frames, csv for variables, ndjson for all else")  # fmt: skip
    _window(add, "up to here, exclusive")
    quiet(add)


def diff(add: Add) -> None:
    """Take two logs, and what counts as a difference."""
    add("a", type=Path, metavar="A", help="log file or run folder")
    add("b", type=Path, metavar="B", help="the other one")
    add("variables", nargs="*", metavar="VAR",
        help="names or patterns, without frames; default: all but timing")  # fmt: skip
    add("--tolerance", type=float, default=0.0, metavar="REL", help="relative")
    add("--absolute", type=float, default=0.0, metavar="ABS", help="absolute")
    json(add)
    quiet(add)


def recover(add: Add) -> None:
    """Take a damaged log."""
    _log(add)
    add("-o", "--output", type=Path, metavar="OUT", help="new file, instead of LOG-recovered.mcap")
    json(add)
    quiet(add)


def export(add: Add) -> None:
    """Take a log, which part of it, and a file."""
    _log(add)
    add("-o", "--output", type=Path, required=True, metavar="FILE", help="output")
    add("--format", choices=("candump", "blf", "asc", "csv", "parquet"),
        help="instead of what the suffix of FILE says")  # fmt: skip
    add("--topics", nargs="+", metavar="TOPIC",
        help="/can/frames; /state, /timing; with /plant before them the plant's")  # fmt: skip
    _window(add, "up to here, exclusive")
    add("--force", action="store_true", help="overwrite FILE")
    json(add)
    quiet(add)


def import_(add: Add) -> None:
    """Take a recording and its DBC file."""
    add("recording", type=Path, metavar="FILE", help="recording of a CAN bus")
    add("--dbc", type=Path, required=True, metavar="FILE.dbc", help="its frames")
    add("-o", "--output", type=Path, required=True, metavar="OUT.mcap", help="log")
    add("--node", metavar="NAME", help="see the bus as this node of the DBC file")
    add("--channel", metavar="NAME", help="only this channel of the recording")
    add("--force", action="store_true", help="overwrite OUT.mcap")
    json(add)
    quiet(add)


def require(add: Add) -> None:
    """Take a log, and what is required of it."""
    _log(add)
    add("--require", action="append", default=[], metavar="REQUIREMENT",
        help="instead of the rig's: 'always: CONDITION', ...; may be repeated")  # fmt: skip
    code_of_laws(add)
    json(add, "print one JSON list")
    quiet(add)


def plot(add: Add) -> None:
    """Take logs, variables and a picture."""
    add("words", nargs="+", metavar="LOG|VARIABLE",
        help="logs, and variables (* ? [] as in the shell, in quotes); "
        "no variables: the figure of its evaluation")  # fmt: skip
    add("-o", "--output", type=Path, required=True, metavar="FILE.png", help="picture")
    code_of_laws(add)
    _window(add, "up to here")
    quiet(add)


def animate(add: Add) -> None:
    """Take a log, and a film."""
    _log(add)
    add("-o", "--output", type=Path, required=True, metavar="FILE.gif", help="film")
    add("--speed", type=float, default=1.0, metavar="X", help="seconds of the log a second; 1")
    code_of_laws(add)
    _window(add, "up to here")
    quiet(add)


def report(add: Add) -> None:
    """Take a log, and a page."""
    add("log", metavar="LOG", help="log file, run folder or latest")
    add("-o", "--output", type=Path, metavar="FILE.html",
        help="instead of report.html in the run folder, LOG.html beside another log")  # fmt: skip
    code_of_laws(add)
    quiet(add)

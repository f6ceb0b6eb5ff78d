"""Every command that reads a log, called in this process, and what a user may never see of it.

It ends with a documented exit code, without a traceback; what it prints are printable lines.
"""

import contextlib
import io
import random
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

from pcpc.tools.after.log import frames as play_frames
from pcpc.tools.cli import main

CODES = {0, 1, 2, 3, 4, 130}


@dataclass(frozen=True)
class Finding:
    """What a command did that it may not do; `key` tells findings of one cause together."""

    words: tuple[str, ...]
    key: str
    text: str


def lines_of(log: Path, other: Path, out: Path) -> dict[str, list[str]]:
    """Return the command lines to try on a log, by name; `other` is a true log."""
    a, b = str(log), str(other)
    quiet = ["--quiet"]
    return {
        "info": ["log", "info", a, *quiet],
        "info json": ["log", "info", a, "--json", *quiet],
        "cat": ["log", "export", a, "-o-", *quiet],
        "cat all": ["log", "export", a, "-o-", "--format", "ndjson", *quiet],
        "cat frames": ["log", "export", a, "-o-", "--topics", "/can/frames", *quiet],
        "cat frames csv": [
            "log",
            "export",
            a,
            "-o-",
            "--topics",
            "/can/frames",
            "--format",
            "csv",
            *quiet,
        ],
        "cat plant": [
            "log",
            "export",
            a,
            "-o-",
            "--topics",
            "/plant/state",
            "--start",
            "1ms",
            *quiet,
        ],
        "diff": ["compare", "--bits", a, b, *quiet],
        "diff back": ["compare", "--bits", b, a, "*", "--json", "-", *quiet],
        "recover": ["log", "recover", a, "-o", str(out / "r.mcap"), *quiet],
        "csv": ["log", "export", a, "-o", str(out / "o.csv"), *quiet],
        "candump": ["log", "export", a, "-o", str(out / "o.log"), *quiet],
        "blf": ["log", "export", a, "-o", str(out / "o.blf"), *quiet],
        "asc": ["log", "export", a, "-o", str(out / "o.asc"), *quiet],
        "parquet": ["log", "export", a, "-o", str(out / "o.parquet"), *quiet],
        "mf4": ["log", "export", a, "-o", str(out / "o.mf4"), *quiet],
        "plot": ["log", "plot", a, "-o", str(out / "o.png"), *quiet],
        "plot some": ["log", "plot", a, b, "*.position", "-o", str(out / "p.svg"), *quiet],
        "report": ["report", a, "-o", str(out / "r.html"), *quiet],
        "replay": ["replay", a, *quiet],
        "replay json": ["replay", a, "--node", "plant", "--json", *quiet],
    }


FAST = ("info", "info json", "cat", "cat all", "cat frames", "cat frames csv", "cat plant", "diff",
        "diff back", "recover", "csv", "candump", "blf", "asc")  # fmt: skip
SLOW = ("parquet", "mf4", "plot", "plot some", "report", "replay", "replay json")


def tried(words: list[str], out: Path) -> Finding | None:
    """Run a command; return what is wrong with how it ended."""
    for file in out.iterdir():
        file.unlink()
    screen, errors = io.StringIO(), io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(screen),
            contextlib.redirect_stderr(errors),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message="First-class function type")
            code = main(words)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        last = traceback.extract_tb(error.__traceback__)
        ours = [
            f for f in last if "/site-packages/" not in f.filename and "/tests/" not in f.filename
        ]
        place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}" if ours else "?"
        name = type(error).__name__
        return Finding(tuple(words), f"{name} {place}", traceback.format_exc(limit=-6))
    said = screen.getvalue(), errors.getvalue()
    if code not in CODES:
        return Finding(tuple(words), f"exit code {code}", "".join(said))
    for text in said:
        wrong = next((c for c in text if not c.isprintable() and c not in "\n\xa0"), "")
        if wrong:
            at = text.index(wrong)
            return Finding(
                tuple(words), f"unprintable from {words[1]}", repr(text[at - 60 : at + 60])
            )
    if code and not any(said):
        return Finding(tuple(words), f"silence from {words[1]}", f"exit code {code}")
    if max(map(len, said[1].split("\n"))) > 2000:
        return Finding(tuple(words), f"endless line from {words[1]}", said[1][:300])
    return None


def tried_to_play(log: Path) -> Finding | None:
    """Choose the frames to play, as `pcpc play` does before it opens a bus."""
    from pcpc.executive.log import reader as logs

    try:
        play_frames.choose(play_frames.bus_frames(logs.read(log)), str(log))
    except (play_frames.PlayError, logs.LogError):
        return None
    except Exception as error:
        return Finding(
            ("play", str(log)), f"play {type(error).__name__}", traceback.format_exc(limit=-6)
        )
    return None


def some_of(log: Path, other: Path, out: Path, dice: random.Random) -> list[Finding]:
    """Try five of the quick commands on a log and, now and then, one of the slow ones."""
    lines = lines_of(log, other, out)
    names = dice.sample(FAST, 5)
    if dice.random() < 0.25:
        names.append(dice.choice(SLOW))
    found = [tried(lines[name], out) for name in names]
    return [one for one in [*found, tried_to_play(log)] if one is not None]


def dbc_lines(rig: Path, out: Path) -> list[list[str]]:
    """Return the command lines to try on a rig whose DBC file is odd."""
    return [["check", str(rig)], ["check", str(rig), "--json"]]


def import_line(recording: Path, dbc: Path, out: Path) -> list[str]:
    """Return the command line to try on an odd recording, or with an odd DBC file."""
    words = ["log", "import", str(recording), "--dbc", str(dbc), "-o", str(out / "i.mcap")]
    return [*words, "--quiet"]

"""DBC files as they are in the world, read by cantools, or refused in one line with the cure.

    encoding    UTF-8, with or without a mark at the beginning; else cp1252, Vector's usual one;
                UTF-16 by its mark
    sizes       of frames, places of signals and multiplexer ranges are looked at before cantools
                makes lists of them; the rest of its work is bounded by a time

Strictly: signals fit and do not overlap, ids and names are unique.
"""

import codecs
import logging
import re
from functools import lru_cache
from pathlib import Path

from pcpc.drivers.errors import DbcError, printable
from pcpc.drivers.machine.closed_package import leave_closed
from pcpc.drivers.machine.patience import StalledError, patience
from pcpc.drivers.machine.regular_files import open_regular

leave_closed("cantools")  # the whole of it brings python-can and asyncio: a tenth of a start
from cantools.database import load_string  # noqa: E402
from cantools.database.can import Database, Message  # noqa: E402
from cantools.database.can.signal import Signal as DbcSignal  # noqa: E402
from cantools.database.errors import Error  # noqa: E402

__all__ = ["Database", "DbcSignal", "Error", "Message", "load", "parse", "place", "text"]

logging.getLogger("cantools").setLevel(logging.ERROR)  # equal ids are refused in one line here

_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16",
}  # fmt: skip
_MOST_BYTES = 1785  # of the longest message that a DBC file is used for, J1939's transport
_MOST_MULTIPLEXED = 1 << 16  # multiplexer values of all signals together
_PATIENCE_S, _PATIENCE_S_PER_BYTE = 20.0, 2e-5  # cantools reads about 0.3 MB in a second
_STRING = re.compile(r'"(?:\\"|[^"])*?"')
_FRAME_OR_SIGNAL = re.compile(
    r"\bBO_\s++[^\s:]++\s++([^\s:]++)\s*+:\s*+([-+]?\d++)"
    r"|\bSG_\s++(\w++)(?:\s++\w++)?+\s*+:\s*+([-+]?\d++)\s*+\|\s*+([-+]?\d++)"
)
_RANGES = re.compile(r"\bSG_MUL_VAL_\s++\S++\s++(\w++)\s++\w++\s++([-+\d,\s]++)")
_RANGE = re.compile(r"(\d++)\s*+[-+]\s*+(\d++)")
_NAME = re.compile(r"\w+", re.ASCII)


def text(path: str | Path) -> str:
    """Return the text of a DBC file, lines ended by a newline; DbcError if it is none."""
    try:
        with open_regular(Path(path)) as file:
            data = file.read()
    except FileNotFoundError:
        raise DbcError(f"{path}: no such file; give the path of the plant's DBC file") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise DbcError(f"{path}: {reason}; give a readable DBC file") from None
    encoding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), "utf-8")
    try:
        found = data.decode(encoding)
    except UnicodeDecodeError:
        found = data.decode("cp1252", "replace")
    if "\0" in found:
        raise DbcError(f"{path}: not text; give a DBC file")
    return found.replace("\r\n", "\n").replace("\r", "\n")


def load(path: str | Path) -> Database:
    """Read a DBC file strictly; DbcError: path, line and column if known, what is wrong."""
    return _checked_database(path, text(path))


@lru_cache(maxsize=16)  # the nodes of a rig, and a thousand runs of an experiment, share it
def _checked_database(path: str | Path, content: str) -> Database:
    database = parse(path, content, strict=True)
    seen: dict[object, str] = {}
    for message in database.messages:
        for key in (message.name, (message.frame_id, message.is_extended_frame)):
            if key in seen:
                raise DbcError(
                    f"{path}: frames {seen[key]} and {message.name} (id {message.frame_id:#x}) "
                    "have the same id or name; make them differ"
                )
            seen[key] = message.name
        names = [signal.name for signal in message.signals]
        for name in (message.name, *names):
            if not _NAME.fullmatch(name):
                what = f"{name[:80]!r} is no name; use letters, digits and _"
                raise DbcError(f"{path}: frame {message.name[:80]!r}: {what}")
            if names.count(name) > 1:
                what = f"{names.count(name)} signals {name}; give each a name of its own"
                raise DbcError(f"{path}: frame {message.name}: {what}")
    return database


def parse(path: str | Path, content: str, *, strict: bool) -> Database:
    """Return what cantools makes of the text of `path`; DbcError."""
    _check_format(path, content)
    _check_sizes(path, content)
    try:
        with patience(_PATIENCE_S + _PATIENCE_S_PER_BYTE * len(content)):
            database = load_string(content, database_format="dbc", strict=strict)
    except StalledError:
        raise DbcError(f"{path}: cantools does not come to an end with it; simplify it") from None
    except Exception as error:  # cantools lets KeyError, ValueError, ... of its parser through
        raise DbcError(_explain(path, error)) from None
    assert isinstance(database, Database)
    return database


def place(path: str | Path, frame: str, signal: str) -> str:
    """Return file:line of a signal; the file alone where it is not found."""
    bare, inside = _without_strings(text(path)), ""
    for found in _FRAME_OR_SIGNAL.finditer(bare):
        inside = found[1] or inside
        if (inside, found[3]) == (frame, signal):
            return f"{path}:{bare.count(chr(10), 0, found.start()) + 1}"
    return str(path)


def _without_strings(content: str) -> str:
    return _STRING.sub(lambda found: '""' + "\n" * found[0].count("\n"), content)


def _check_format(path: str | Path, content: str) -> None:
    """Raise DbcError for what is plainly something else."""
    begin = content.lstrip()
    if begin.startswith(("<", "FormatVersion")):
        kind = "XML (KCD, ARXML?)" if begin.startswith("<") else "SYM"
        what = f"{kind}, not DBC; convert it: python -m cantools convert IN OUT.dbc"
        raise DbcError(f"{path}: {what}")
    if not begin:
        raise DbcError(f"{path}: it is empty; give the plant's DBC file")


def _check_sizes(path: str | Path, content: str) -> None:
    """Raise DbcError for a number that cantools would make a list of, however long."""
    bare = _without_strings(content)

    def error(at: int, what: str) -> DbcError:
        line = bare.count("\n", 0, at) + 1
        return DbcError(f"{path}:{line}: {what}")

    frame = ""
    for found in _FRAME_OR_SIGNAL.finditer(bare):
        name, length, signal, start, bits = found.groups()
        frame = name or frame
        if name and _large(length, _MOST_BYTES):
            what = f"{length[:20]} bytes; classic CAN has 8, CAN FD 64"
            raise error(found.start(), f"frame {frame}: {what}; correct its length")
        if signal and (_large(start, 8 * _MOST_BYTES) or _large(bits, 8 * _MOST_BYTES)):
            what = f"{start[:20]}|{bits[:20]} lies in no frame; correct its start and length"
            raise error(found.start(), f"frame {frame}: {signal}: {what}")
    count = 0
    for found in _RANGES.finditer(bare):
        for low, high in _RANGE.findall(found[2]):
            count += 1 + max(0, int(high[:20]) - int(low[:20]))
            if count > _MOST_MULTIPLEXED:
                what = f"{found[1]}: {low[:20]}-{high[:20]}: more than {_MOST_MULTIPLEXED} values"
                raise error(found.start(), f"{what} of a multiplexer; name those in use")


def _large(digits: str, limit: int) -> bool:
    return len(digits) > 9 or not 0 <= int(digits) <= limit


def _explain(path: str | Path, error: Exception) -> str:
    """Return one line: path:line:column when the parser tells, and what it says."""
    cause = getattr(error, "e_dbc", None) or error
    said = " ".join(str(cause).split())
    found = re.match(r'Invalid syntax at line (\d+), column (\d+): "\s*(.*?)\s*"$', said)
    if found:
        line, column, near = found.groups()
        return f"{path}:{line}:{column}: not DBC syntax at >>!<<: {printable(near[:200])}"
    kind = f"cantools: {type(cause).__name__} "
    kind = "" if isinstance(cause, Error) else kind
    return f"{path}: {kind}{printable(said[:300])}; correct the DBC file"

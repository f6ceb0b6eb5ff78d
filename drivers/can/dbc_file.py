"""DBC files as they are in the world, read by cantools, or refused in one line with the cure.

encoding    UTF-8, with or without a mark at the beginning; else cp1252, Vector's usual one;
            UTF-16 by its mark
entries     cantools gets those that are well-formed, see `drivers.can.dbc_entries`; it takes
            a bounded time
"""

import codecs
import logging
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from pcpc.drivers.can.dbc_entries import Description, OddEntry
from pcpc.drivers.can.dbc_written import Writing
from pcpc.drivers.errors import DbcError, printable
from pcpc.drivers.machine.closed_package import leave_closed
from pcpc.drivers.machine.patience import StalledError, patience
from pcpc.drivers.machine.regular_files import open_regular

leave_closed("cantools")  # the whole of it brings python-can and asyncio: a tenth of a start
from cantools.database import load_string  # noqa: E402
from cantools.database.can import Message  # noqa: E402
from cantools.database.can import database as can_database  # noqa: E402
from cantools.database.can.signal import Signal as DbcSignal  # noqa: E402
from cantools.database.errors import Error  # noqa: E402

__all__ = ["Database", "DbcSignal", "Error", "Message", "load", "parse", "place", "text"]

logging.getLogger("cantools").setLevel(logging.ERROR)  # equal ids are refused in one line here

_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16",
}  # fmt: skip
_PADDING = "\0\x1a"  # behind the end, of DOS and of a file system
_PATIENCE_S, _PATIENCE_S_PER_BYTE = 20.0, 2e-5  # cantools reads about 0.3 MB in a second
_STRING = re.compile(r'"(?:\\"|[^"])*?"')
_FRAME_OR_SIGNAL = re.compile(
    r"\bBO_\s++[^\s:]++\s++([^\s:]++)\s*+:\s*+([-+]?\d++)"
    r"|\bSG_\s++(\w++)(?:\s++\w++)?+\s*+:\s*+([-+]?\d++)\s*+\|\s*+([-+]?\d++)"
)


@dataclass(frozen=True)
class Database:
    """The frames and nodes of a DBC file, and what of it is left out. `j1939`: it says so."""

    path: str
    messages: tuple[Message, ...]
    nodes: tuple[str, ...]
    odd: tuple[OddEntry, ...]
    j1939: bool

    def get_message_by_name(self, name: str) -> Message:
        """Return a frame; KeyError if there is none of this name."""
        return next(message for message in self.messages if message.name == name)


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
        decoded = data.decode(encoding)
    except UnicodeDecodeError:
        decoded = data.decode("cp1252", "replace")
    decoded = decoded.rstrip(_PADDING)
    if "\0" in decoded:
        raise DbcError(f"{path}: not text; give a DBC file")
    return decoded.replace("\r\n", "\n").replace("\r", "\n")


def load(path: str | Path) -> Database:
    """Read a DBC file; what is odd in it is left out and listed. DbcError if it is none."""
    return _loaded(path, text(path))


@lru_cache(maxsize=16)  # the nodes of a rig, and a thousand runs of an experiment, share it
def _loaded(path: str | Path, content: str) -> Database:
    return parse(path, content)


def parse(path: str | Path, content: str, *, strict: bool = False) -> Database:
    """Return what the text of `path` describes; DbcError, `strict` also for an odd entry."""
    _check_format(path, content)
    described = Description(content)
    writing = Writing(described)
    plain = writing.text()
    if described.odd and (strict or not described.count):
        raise DbcError(f"{path}:{described.odd[0].place}: {described.odd[0].what}")
    try:
        with patience(_PATIENCE_S + _PATIENCE_S_PER_BYTE * len(content)):
            database = cantools_database(plain)
    except StalledError:
        raise DbcError(f"{path}: cantools does not come to an end with it; simplify it") from None
    except Exception as error:  # cantools lets KeyError, ValueError, ... of its parser through
        said = f"cantools: {type(error).__name__} {printable(' '.join(str(error).split())[:300])}"
        raise DbcError(f"{path}: {said}; correct the DBC file") from None
    for message in database.messages:
        _name(message, writing)
    nodes = tuple(writing.long_nodes.get(name, name) for name in described.nodes)
    odd = sorted((_with_long_nodes(one, writing) for one in described.odd), key=_line)
    return Database(str(path), tuple(database.messages), nodes, tuple(odd), writing.is_j1939)


def cantools_database(content: str) -> can_database.Database:
    """Return what cantools makes of a text; whatever it raises."""
    found = load_string(content, database_format="dbc", strict=False)
    assert isinstance(found, can_database.Database)
    return found


def _name(message: Message, writing: Writing) -> None:
    """Give a message, its signals and its nodes the names that the file has for them."""
    alias = message.name
    message.name = writing.names[alias, ""]
    message.senders[:] = [writing.nodes.get(name, name) for name in message.senders]
    for signal in message.signals:
        signal.name = writing.names[alias, signal.name]
        signal.receivers[:] = [writing.nodes.get(name, name) for name in signal.receivers]
        if signal.multiplexer_signal is not None:
            signal.multiplexer_signal = writing.names[alias, signal.multiplexer_signal]
    message.refresh(strict=False)


def _with_long_nodes(one: OddEntry, writing: Writing) -> OddEntry:
    return replace(one, nodes=frozenset(writing.long_nodes.get(n, n) for n in one.nodes))


def _line(one: OddEntry) -> int:
    return int(one.place.split(":")[0])


def place(path: str | Path, frame: str, signal: str) -> str:
    """Return file:line of a signal; the file alone where it is not found."""
    bare, inside = _without_strings(text(path)), ""
    for match in _FRAME_OR_SIGNAL.finditer(bare):
        inside = match[1] or inside
        if (inside, match[3]) == (frame, signal):
            return f"{path}:{bare.count(chr(10), 0, match.start()) + 1}"
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
    if begin.startswith("version https://git-lfs"):
        raise DbcError(f"{path}: a Git LFS pointer; fetch the file itself by `git lfs pull`")

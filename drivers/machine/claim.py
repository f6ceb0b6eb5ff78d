"""Names that one process of this machine holds at a time, without a file that could stay behind.

A claim is a listening socket with an abstract name (unix(7)). The kernel gives a name to one socket
only, whoever asks; it is seen by all users, lives in the network namespace as ports do, and is gone
with the last process that holds it. Nobody accepts: who connects learns the holder's process and
user from the kernel, and is told when the holder lets go.
"""

import errno
import hashlib
import select
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

_PREFIX = "pcpc/"
_MOST_BYTES = 100  # a name has 107
_QUEUE = 4096  # who asks leaves an entry until the holder ends; a full queue answers nobody
_TURN_S = 2.0  # a choice takes milliseconds; one who keeps the turn must not stop the others


@dataclass(frozen=True)
class Holder:
    """The process that made a claim (0 where it is not visible from here) and its user."""

    pid: int
    uid: int


def hold(name: str) -> socket.socket | None:
    """Claim `name` for as long as the returned socket is open here or in a child; None if taken."""
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        claim.bind(_address(name))
    except OSError as error:
        claim.close()
        if error.errno == errno.EADDRINUSE:
            return None
        raise
    claim.listen(_QUEUE)
    return claim


def holder(name: str) -> Holder | None:
    """Return who holds `name`; None if nobody does, or if too many have asked."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as question:
        question.setblocking(False)
        try:
            question.connect(_address(name))
            credentials = question.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
        except OSError:
            return None
    pid, uid, _ = struct.unpack("iII", credentials)
    return Holder(pid, uid)


def meet(name: str) -> socket.socket | None:
    """Return a connection to the holder of `name`; None if nobody listens there."""
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    line.setblocking(False)
    try:
        line.connect(_address(name))
    except OSError:
        line.close()
        return None
    return line


def held_names(start: str) -> list[str]:
    """Return the names now held by anybody that begin with `start`, in order."""
    try:
        with open("/proc/net/unix", encoding="utf-8", errors="replace") as file:
            paths = [line.rstrip("\n").split(None, 7)[-1] for line in file]
    except OSError:
        return []
    wanted = f"@{_PREFIX}{start}"
    return sorted({path[1 + len(_PREFIX) :] for path in paths if path.startswith(wanted)})


@contextmanager
def turn() -> Iterator[None]:
    """Wait until nobody else is choosing; others wait meanwhile, but never longer than 2 s."""
    end_s = time.monotonic() + _TURN_S
    while (mine := hold("turn")) is None:
        left_s = end_s - time.monotonic()
        if left_s <= 0.0:
            break
        _until_let_go("turn", left_s)
    try:
        yield
    finally:
        if mine is not None:
            mine.close()


def _until_let_go(name: str, within_s: float) -> None:
    """Return once the holder of `name` lets go, at the latest after `within_s`."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as waiting:
        waiting.settimeout(within_s)
        try:
            waiting.connect(_address(name))
        except OSError:  # let go just now
            return
        select.select([waiting], [], [], within_s)


def _address(name: str) -> bytes:
    """Return the abstract address of `name`; of a long one its beginning and a digest."""
    text = (_PREFIX + name).encode("utf-8", "surrogateescape")
    if len(text) > _MOST_BYTES:
        text = text[: _MOST_BYTES - 33] + b"~" + hashlib.sha256(text).hexdigest()[:32].encode()
    return b"\0" + text

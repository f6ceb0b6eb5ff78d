"""How a node hands its memory to clients: two memory files without names, over a socket.

    published   description and what the loop publishes: clients can map it, but not for writing
    mailbox     what clients write

Both are sealed: nobody can shorten them under whom has mapped them. The rest of the LOOP record is
private to the process. The socket has an abstract name (`drivers.machine.claim`) with user, rig,
bus and role; it gives both files to this user and root, tells by its end that the node is gone, and
leaves nothing behind. A client may say what it is: HOST, for which the node stays after its end
until it is told LEAVE, or RECORDER.
"""

import contextlib
import errno
import fcntl
import hashlib
import json
import mmap
import os
import secrets
import socket
import struct
import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from pcpc.drivers.machine import claim, kernel
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.ring_layout import RECORD_HEAD, data_bytes
from pcpc.executive.loop.shared import (
    LOOP,
    MAILBOX_BYTES,
    PAGE_BYTES,
    PUBLISHED_BYTES,
    NodeMemory,
    SharedError,
)

HOST, RECORDER, LEAVE = b"h", b"r", b"l"
MAGIC = b"pcpc 2\0\0"
_LAYOUT = hashlib.sha256(repr(LOOP.descr).encode()).digest()[:8]
_HEAD = struct.Struct("<8s8sQ")  # magic, layout, bytes of the description that follows
_HELLO = b"pcpc node"
_MOST_CLIENTS, _AT_ONCE = 200, 50
_ANSWER_S = 2.0  # a node that takes longer stands still
_MOMENT_S = 0.02
_NAME_BYTES = 70
_MFD_NOEXEC_SEAL, _F_SEAL_FUTURE_WRITE = 0x8, 0x10  # newer than Python knows
_SEALS = fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW


# Names


def _path(kind: str, name: str, user: int | None = None) -> str:
    """Return the claim of a node: kind, user, and of a long name the beginning and a digest."""
    if len(name) > _NAME_BYTES:
        digest = hashlib.sha256(name.encode()).hexdigest()[:16]
        name = f"{name[: _NAME_BYTES - 17]}+{digest}"
    return f"{kind}/{os.geteuid() if user is None else user}/{name}"


def _ours(name: str) -> claim.Holder | None:
    """Return who holds the claim `name`, if it is a process of this user.

    A moment lies between taking a name and answering for it.
    """
    end_s = time.monotonic() + _MOMENT_S
    while (who := claim.holder(name)) is None and time.monotonic() < end_s:
        os.sched_yield()
    return who if who is not None and who.uid == os.geteuid() else None


def _claim(path: str) -> tuple[str, socket.socket]:
    """Claim `path`, or with a suffix that nobody guesses where another user has it."""
    for name in (path, *(f"{path}~{secrets.token_hex(4)}" for _ in range(3))):
        try:
            own_socket = claim.hold(name)
        except OSError as error:
            raise SharedError(
                f"{path}: no abstract socket here ({error.strerror}); a node is found by one"
            ) from None
        if own_socket is not None:
            return name, own_socket
        if (who := _ours(name)) is not None:
            raise _in_use(path, who)
    raise SharedError(f"{path}: cannot be claimed")


def _others(path: str, own_name: str = "") -> Iterator[claim.Holder]:
    """Yield who of this user holds `path`, or had to take it with a suffix, but `own_name`."""
    for name in claim.held_names(path):
        if name != own_name and (name == path or name.startswith(f"{path}~")):
            who = _ours(name)
            if who is not None:
                yield who


def lock(name: str) -> socket.socket:
    """Hold node `name` for as long as the socket is open; SharedError tells which process has it.

    Another user who squats the name does not matter.
    """
    path = _path("lock", name)
    own_name, own_socket = _claim(path)
    for who in _others(path, own_name):  # it met a squatter who is gone
        own_socket.close()
        raise _in_use(path, who)
    return own_socket


def _in_use(path: str, who: claim.Holder) -> SharedError:
    return SharedError(
        f"{path.split('/', 2)[2]}: already in use by process {who.pid}; "
        "end it first, or choose another bus with --bus"
    )


def is_locked(name: str) -> bool:
    """Return whether a node of this name is there, from its start-up to its end."""
    return any(_others(_path("lock", name)))


def running() -> Iterator[NodeMemory]:
    """Yield the nodes of this user that hand out their memory."""
    for path in claim.held_names(_path("node", "")):
        with contextlib.suppress(SharedError):
            yield _attach(path)


def other_users() -> list[str]:
    """Return the numbers of other users that have nodes here."""
    users = {name.split("/")[1] for name in claim.held_names("node/")}
    return sorted(users - {str(os.geteuid())})


# The node's side


class ServedMemory:
    """A node's memory, and from `open` on the socket at which clients get it."""

    def __init__(self, name: str, description: Mapping[str, Any]) -> None:
        """Map everything into this process. SharedError if there is no memory for it."""
        full = sh.full_description(name, description)
        body = json.dumps(full).encode()
        self._head = -(-(_HEAD.size + len(body)) // PAGE_BYTES) * PAGE_BYTES
        self._files: list[int] = []
        self._listener: socket.socket | None = None
        self._clients: dict[socket.socket, bytes] = {}
        self.told: set[bytes] = set()  # what clients have said so far
        memory = sh.blank()
        try:
            published = self._file(self._head + PUBLISHED_BYTES)
            os.pwrite(published, _HEAD.pack(MAGIC, _LAYOUT, len(body)) + body, 0)
            mailbox = self._file(MAILBOX_BYTES)
            kernel.map_over(memory, 0, PUBLISHED_BYTES, published, self._head)
            kernel.map_over(memory, PUBLISHED_BYTES, MAILBOX_BYTES, mailbox, 0)
            _seal(published, fcntl.F_SEAL_SEAL | _SEALS | _F_SEAL_FUTURE_WRITE)
            _seal(mailbox, fcntl.F_SEAL_SEAL | _SEALS)
        except OSError as error:
            self.close()
            size = (self._head + LOOP.itemsize) >> 20
            raise SharedError(f"{name}: {size} MiB of shared memory: {error.strerror}") from None
        loop = np.recarray(1, LOOP, memory)[0]
        self.block = NodeMemory(name, full, sh.fields(memory, LOOP), loop)

    def _file(self, size: int) -> int:
        """Make a memory file of `size` zeroed bytes that are really there."""
        flags = os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING
        try:
            descriptor = os.memfd_create("pcpc", flags | _MFD_NOEXEC_SEAL)
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            descriptor = os.memfd_create("pcpc", flags)  # before Linux 6.3
        self._files.append(descriptor)
        os.posix_fallocate(descriptor, 0, size)
        return descriptor

    def open(self) -> None:
        """Let clients come; SharedError."""
        _, self._listener = _claim(_path("node", self.block.name))
        self._listener.setblocking(False)

    def sockets(self) -> list[socket.socket]:
        """Return what is to be waited for between two calls of `serve`."""
        return [*([] if self._listener is None else [self._listener]), *self._clients]

    def is_sealed(self) -> bool:
        """Return whether nobody else can map for writing what the node publishes."""
        seals = int(fcntl.fcntl(self._files[0], fcntl.F_GET_SEALS))
        return bool(seals & _F_SEAL_FUTURE_WRITE)

    def has_host(self) -> bool:
        """Return whether a host is there for which the node has to stay."""
        return HOST in self._clients.values()

    def serve(self) -> None:
        """Hand the memory to all who wait, hear the others; never blocks."""
        for client in list(self._clients):
            self._hear(client)
        if self._listener is None:
            return
        for _ in range(_AT_ONCE):
            try:
                client, _ = self._listener.accept()
            except OSError:  # nobody, or it left again
                return
            if self._greet(client):
                self._hear(client)
            else:
                client.close()

    def _greet(self, client: socket.socket) -> bool:
        """Hand the memory to a client; return whether it got it."""
        client.setblocking(False)
        if _peer(client).uid not in (os.geteuid(), 0) or len(self._clients) >= _MOST_CLIENTS:
            return False
        try:
            socket.send_fds(client, [_HELLO], self._files)
        except OSError:
            return False
        self._clients[client] = b""
        return True

    def _hear(self, client: socket.socket) -> None:
        """Note what a client says; forget one that is gone."""
        try:
            words = client.recv(16)
        except BlockingIOError:
            return
        except OSError:
            words = b""
        self.told |= {words[i : i + 1] for i in range(len(words))}
        if RECORDER in words:
            self.block.control.recorded = 1
        self._clients[client] = words[-1:] if words else b""
        if not words or LEAVE in words:
            del self._clients[client]
            client.close()

    def close(self) -> None:
        """Let name, clients and files go; who has mapped the memory keeps it."""
        for one in self.sockets():
            one.close()
        self._clients.clear()
        self._listener = None
        while self._files:
            os.close(self._files.pop())


def _seal(descriptor: int, seals: int) -> None:
    """Forbid changes of the size, and new writers where the kernel can do that (Linux 5.1)."""
    try:
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, seals)
    except OSError as error:
        if error.errno != errno.EINVAL or not seals & _F_SEAL_FUTURE_WRITE:
            raise
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, seals & ~_F_SEAL_FUTURE_WRITE)


def _peer(client: socket.socket) -> claim.Holder:
    pid, uid, _ = struct.unpack("iII", client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    return claim.Holder(pid, uid)


# The client's side


def attach(name: str, word: bytes = b"") -> NodeMemory:
    """Map the memory of the running node `name`, tell it `word`; SharedError if there is none."""
    path = _path("node", name)
    try:
        return _attach(path, word)
    except SharedError as error:
        failure = error
    for other in claim.held_names(f"{path}~"):  # where another user has the name
        with contextlib.suppress(SharedError):
            return _attach(other, word)
    raise failure


def _attach(path: str, word: bytes = b"") -> NodeMemory:
    name = path.split("/", 2)[2]
    line = claim.meet(path)
    if line is None:
        raise SharedError(f"{name}: no such node is running here")
    files: list[int] = []
    try:
        if _peer(line).uid != os.geteuid():
            raise SharedError(f"{name}: no such node is running here")
        line.settimeout(_ANSWER_S)
        hello, files, _, _ = socket.recv_fds(line, len(_HELLO), 2)
        if hello != _HELLO or len(files) != 2:
            raise SharedError(f"{name}: takes no more clients, or is of another version of pcpc")
        line.setblocking(False)
        if word:
            line.send(word)
        return _mapped_memory(name, line, files[0], files[1])
    except (OSError, SharedError) as error:
        for descriptor in (*files, line.detach()):
            os.close(descriptor)
        if isinstance(error, SharedError):
            raise
        raise SharedError(f"{name}: does not share its memory: {error}") from None


def _mapped_memory(name: str, line: socket.socket, published: int, mailbox: int) -> NodeMemory:
    """Return the block of both files; of `published` no descriptor is kept."""
    for descriptor, least in ((published, PUBLISHED_BYTES), (mailbox, MAILBOX_BYTES)):
        seals = fcntl.fcntl(descriptor, fcntl.F_GET_SEALS)
        if os.fstat(descriptor).st_size < least or seals & _SEALS != _SEALS:
            raise SharedError(f"{name}: not a block of this version of pcpc")
    description = _description(name, published)
    offset = os.fstat(published).st_size - PUBLISHED_BYTES
    arrays = sh.fields(
        mmap.mmap(published, PUBLISHED_BYTES, prot=mmap.PROT_READ, offset=offset), sh.PUBLISHED
    ) | sh.fields(mmap.mmap(mailbox, MAILBOX_BYTES), sh.MAILBOX)
    os.close(published)
    return NodeMemory(description["name"], description, arrays, client=sh.Client(line, mailbox))


def check(description: Any) -> None:
    """Raise ValueError, TypeError or KeyError if a description does not fit the memory."""
    full = sh.full_description(description["name"], description)
    if full["record_columns"] != description["record_columns"]:
        raise ValueError("its rows have another size")
    if not RECORD_HEAD < full["record_columns"] <= sh.RECORD_RING_WORDS:
        raise ValueError("its rows do not fit the ring")
    if data_bytes(description) not in (8, 64):
        raise ValueError("its frames have another size")
    if len(description["variables"]) > sh.MAX_VARIABLES:
        raise ValueError("it has too many variables")
    for name, unit, kind, writer, text in description["variables"]:
        if not all(isinstance(word, str) for word in (name, unit, kind, writer, text)):
            raise TypeError("a variable is not described in words")


def _description(name: str, published: int) -> dict[str, Any]:
    """Return what the node says about itself; SharedError if it does not fit its memory."""
    room = os.fstat(published).st_size - PUBLISHED_BYTES
    if room < _HEAD.size or room % PAGE_BYTES:
        raise SharedError(f"{name}: not a block of this version of pcpc")
    magic, layout, size = _HEAD.unpack(os.pread(published, _HEAD.size, 0))
    if magic != MAGIC or layout != _LAYOUT or size > room - _HEAD.size:
        raise SharedError(f"{name}: a block of another version of pcpc")
    try:
        description = json.loads(os.pread(published, size, _HEAD.size))
        check(description)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise SharedError(f"{name}: does not describe itself properly: {error}") from None
    return dict(description)

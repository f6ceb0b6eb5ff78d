"""A node's memory in other hands: found by name, readable, not writable, not to be shortened."""

import ctypes
import errno
import fcntl
import json
import mmap
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import standing
from places import ROOT

from pcpc.drivers.machine import claim
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.nodes import live

HEAD: dict[str, object] = {
    "node": "executive", "variables": [["a.gain", "1/s", "parameter", "a", "gain ä"]],
    "ranges": {"a.gain": [0.0, 1.0]}, "state_columns": ["a.gain"], "timing_columns": [],
}  # fmt: skip
NOBODY = 65534


@pytest.fixture
def name() -> Iterator[str]:
    """Return a name of this test; what stands under it ends afterwards."""
    yield f"test-sharing.{os.getpid()}.executive"
    standing.end_all()


@pytest.fixture
def block(name: str) -> sh.NodeMemory:
    return standing.stand(name, HEAD)


def files_of(name: str) -> tuple[socket.socket, int, int]:
    """Return line, published and mailbox file, as any program of the same user can get them."""
    line = claim.meet(sharing._path("node", name))
    assert line is not None
    line.setblocking(True)
    _, (published, mailbox), _, _ = socket.recv_fds(line, 64, 2)
    return line, published, mailbox


# ---------------------------------------------------------------------------------------- in hands


class Refusing(socket.socket):
    """A line of which the kernel refuses the first word."""

    refused = False

    def send(self, *words: Any) -> int:
        """Send, but the first time."""
        if not self.refused:
            self.refused = True
            raise OSError(errno.ENOBUFS, "No buffer space available")
        return super().send(*words)


def test_a_word_that_the_kernel_refuses_once_is_said_again(name: str) -> None:
    standing.stand(name, HEAD)
    block = sharing.attach(name)
    assert block.client is not None
    line = Refusing(fileno=os.dup(block.client.line.fileno()))
    block.client = sh.Client(line, os.dup(block.client.mailbox))
    block.tell(sharing.LEAVE)
    line.settimeout(10.0)
    assert line.recv(1) == b"", "the node has let go of who said it"


def test_a_search_for_nodes_passes_over_what_is_none(block: sh.NodeMemory, name: str) -> None:
    assert name in [one.name for one in sharing.running()], "it hands out its memory"
    assert "period_ns" not in block.description, "a node says its period"
    assert name not in live.running()


def test_a_client_finds_description_and_fields_by_name(block: sh.NodeMemory, name: str) -> None:
    other = sharing.attach(name)
    assert other.description == block.description and other.name == name
    block["record"][3, 2], other.mail.count = 77, 5
    assert int(other["record"][3, 2]) == 77 and int(block.mail.count) == 5
    assert name in [one.name for one in sharing.running()]


def test_the_fields_of_a_client_lie_where_the_loop_has_them() -> None:
    fields = sh.LOOP.fields or {}
    for kind, begin in ((sh.PUBLISHED, 0), (sh.MAILBOX, sh.PUBLISHED_BYTES)):
        for field, (dtype, at, *_) in (kind.fields or {}).items():
            assert fields[field][:2] == (dtype, begin + at), field


def test_nobody_can_map_for_writing_what_a_node_publishes(block: sh.NodeMemory, name: str) -> None:
    line, published, mailbox = files_of(name)
    size = os.fstat(published).st_size
    again = os.open(f"/proc/self/fd/{published}", os.O_RDWR)
    for descriptor in (published, again):
        with pytest.raises(PermissionError):
            mmap.mmap(descriptor, size)
        with pytest.raises(PermissionError):
            os.pwrite(descriptor, b"x" * 100, 0)
    reading = mmap.mmap(published, size, prot=mmap.PROT_READ)
    libc, at = ctypes.CDLL(None, use_errno=True), ctypes.c_size_t
    begin = sh.np.frombuffer(reading, sh.np.uint8).ctypes.data
    assert libc.mprotect(ctypes.c_void_p(begin), at(mmap.PAGESIZE), 3) == -1, "made writable"
    block.control.passes = 7
    assert int(sharing.attach(name).control.passes) == 7, "the node itself writes"
    for descriptor in (published, again, mailbox):
        os.close(descriptor)
    line.close()


def test_nobody_can_shorten_lengthen_or_seal_a_nodes_memory(
    block: sh.NodeMemory, name: str
) -> None:
    line, *files = files_of(name)
    for descriptor in files:
        size = os.fstat(descriptor).st_size
        for other in (0, 1, size - 1, size + 1, 2 * size):
            with pytest.raises(PermissionError):
                os.ftruncate(descriptor, other)
        with pytest.raises(PermissionError):
            fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_WRITE)
        os.close(descriptor)
    line.close()
    block.loop.v[:] = 1.0
    assert float(block.loop.v.sum()) == sh.MAX_VARIABLES


def test_who_has_mapped_a_node_goes_on_reading_after_its_end_and_notices_it(
    block: sh.NodeMemory, name: str
) -> None:
    other = sharing.attach(name)
    block["record"][3, 2] = 77
    assert other.alive()
    standing.end(name)
    assert not other.alive() and int(other["record"][3, 2]) == 77
    with pytest.raises(sh.SharedError, match=f"^{name}: no such node is running here$"):
        sharing.attach(name)
    assert not [left for left in claim.held_names("node/") if name in left]


def test_a_node_that_stands_still_answers_nobody_and_nobody_waits_for_ever(name: str) -> None:
    served = sharing.ServedMemory(name, HEAD)
    served.open()
    try:
        with pytest.raises(sh.SharedError, match="does not share its memory: timed out"):
            sharing.attach(name)
    finally:
        served.close()


def test_more_clients_than_a_node_takes_are_told_so(
    block: sh.NodeMemory, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sharing, "_MOST_CLIENTS", 20)  # both ends' descriptors are this process's
    clients: list[sh.NodeMemory] = []
    with pytest.raises(sh.SharedError, match="takes no more clients"):
        while len(clients) < 21:
            clients.append(sharing.attach(name))
    assert len(clients) > 10, "a few of the seats are for others who look for nodes on this machine"
    assert all(client.alive() for client in clients)


def test_a_long_name_and_odd_characters_are_a_name_too(name: str) -> None:
    for rig in ("r" * 210, "a b/c:d\0e\nf", "läufer"):
        long = sh.block_name(rig, f"udp_multicast:239.1.2.3:{os.getpid()}", "executive")
        standing.stand(long, HEAD)
        assert sharing.attach(long).name == long
        assert long in [one.name for one in sharing.running()]
        with sharing.lock(long), pytest.raises(sh.SharedError, match="already in use"):
            sharing.lock(long)


# ----------------------------------------------------------------------------------------- nonsense


def offer(name: str, *files: int) -> Callable[[], None]:
    """Hand out `files` as a node would; return what ends it."""
    listener = claim.hold(sharing._path("node", name))
    assert listener is not None
    over = threading.Event()

    def serve() -> None:
        while not over.is_set():
            if select.select([listener], [], [], 0.01)[0]:
                with listener.accept()[0] as client:
                    socket.send_fds(client, [sharing._HELLO], files)

    thread = threading.Thread(target=serve)
    thread.start()

    def end() -> None:
        over.set()
        thread.join()
        listener.close()

    return end


def memory(size: int, head: bytes = b"", seals: int = sharing._SEALS) -> int:
    descriptor = os.memfd_create("test", os.MFD_ALLOW_SEALING)
    os.ftruncate(descriptor, size)
    os.pwrite(descriptor, head, 0)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, seals)
    return descriptor


def published(about: object, length: int | None = None, magic: bytes = sharing.MAGIC) -> int:
    """Return a file like a node's that says `about` of itself."""
    body = json.dumps(about).encode()
    head = sharing._HEAD.pack(magic, sharing._LAYOUT, len(body) if length is None else length)
    return memory(sh.PAGE_BYTES + sh.PUBLISHED_BYTES, head + body)


GOOD = sh.full_description("x", HEAD)
NONSENSE: dict[str, Callable[[], tuple[int, ...]]] = {
    "no files": lambda: (),
    "one file": lambda: (published(GOOD),),
    "no memory files": lambda: (os.open("/dev/null", os.O_RDWR), os.open("/dev/zero", os.O_RDWR)),
    "not sealed": lambda: (memory(1 << 24, b"", 0), memory(sh.MAILBOX_BYTES, b"", 0)),
    "too small": lambda: (memory(4096), memory(4096)),
    "small mailbox": lambda: (published(GOOD), memory(sh.MAILBOX_BYTES - 1)),
    "no head": lambda: (memory(sh.PUBLISHED_BYTES), memory(sh.MAILBOX_BYTES)),
    "zeros": lambda: (memory(sh.PAGE_BYTES + sh.PUBLISHED_BYTES), memory(sh.MAILBOX_BYTES)),
    "other magic": lambda: (published(GOOD, None, b"pcpc 1\0\0"), memory(sh.MAILBOX_BYTES)),
    "endless": lambda: (published(GOOD, 2**64 - 1), memory(sh.MAILBOX_BYTES)),
    "cut": lambda: (published(GOOD, 30), memory(sh.MAILBOX_BYTES)),
    "a list": lambda: (published([1]), memory(sh.MAILBOX_BYTES)),
    "empty": lambda: (published({}), memory(sh.MAILBOX_BYTES)),
    "rows": lambda: (published(GOOD | {"record_columns": 0}), memory(sh.MAILBOX_BYTES)),
    "wide": lambda: (
        published(GOOD | {"state_columns": 9, "record_columns": 13}), memory(sh.MAILBOX_BYTES)
    ),
    "variables": lambda: (published(GOOD | {"variables": [[1] * 5]}), memory(sh.MAILBOX_BYTES)),
    "short variable": lambda: (published(GOOD | {"variables": ["a"]}), memory(sh.MAILBOX_BYTES)),
}  # fmt: skip


@pytest.mark.parametrize("kind", NONSENSE)
def test_what_is_no_node_of_this_version_is_refused_in_a_line(name: str, kind: str) -> None:
    files = NONSENSE[kind]()
    end = offer(name, *files)
    before = len(os.listdir("/proc/self/fd"))
    try:
        with pytest.raises(sh.SharedError) as caught:
            sharing._attach(sharing._path("node", name))
        assert "\n" not in str(caught.value) and name in str(caught.value), caught.value
        assert name not in [one.name for one in sharing.running()]
    finally:
        end()
        for descriptor in files:
            os.close(descriptor)
    left = len(os.listdir("/proc/self/fd")) - before
    assert left <= 0, f"{left} descriptors left open"


# ------------------------------------------------------------------------------------------- locks

HOLDER = """
import sys
from pcpc.executive.loop import sharing
held = sharing.lock(sys.argv[1])
print("locked", flush=True)
sys.stdin.read()
"""


def test_a_node_that_runs_is_refused_with_its_pid_and_free_when_it_is_killed(name: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, name],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "locked\n"
        assert sharing.is_locked(name)
        with pytest.raises(
            sh.SharedError, match=f"^{name}: already in use by process {holder.pid};"
        ):
            sharing.lock(name)
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        with sharing.lock(name):
            pass
    assert not sharing.is_locked(name)


def test_of_many_that_start_in_the_same_instant_one_has_the_name(name: str) -> None:
    for _ in range(20):
        barrier, held = threading.Barrier(6), []

        def start(barrier: threading.Barrier = barrier, held: list[socket.socket] = held) -> None:
            barrier.wait()
            try:
                held.append(sharing.lock(name))
            except sh.SharedError as error:
                assert f"already in use by process {os.getpid()};" in str(error), error

        starts = [threading.Thread(target=start) for _ in range(6)]
        for thread in starts:
            thread.start()
        for thread in starts:
            thread.join()
        assert len(held) == 1, f"{len(held)} have it"
        held[0].close()


SQUATTER = """
import os, socket, sys
os.setresgid(65534, 65534, 65534)
os.setresuid(65534, 65534, 65534)
held = []
for name in sys.argv[2:]:
    one = socket.socket(socket.AF_UNIX)
    one.bind(b"\\0" + name.encode())
    if sys.argv[1] == "listens":
        one.listen()
    held.append(one)
print("squats", flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("how", ["listens", "is deaf"])
def test_a_name_that_another_user_squats_is_no_obstacle(name: str, how: str) -> None:
    if os.geteuid() != 0:
        return  # only root can be two users
    names = [f"pcpc/{sharing._path(kind, name)}" for kind in ("lock", "node")]
    with subprocess.Popen(
        [sys.executable, "-c", SQUATTER, how, *names],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as squatter:
        assert squatter.stdout is not None and squatter.stdout.readline() == "squats\n"
        with pytest.raises(sh.SharedError, match="no such node is running here"):
            sharing.attach(name)
        with sharing.lock(name):
            block = standing.stand(name, HEAD)
            block.control.passes = 12
            assert int(sharing.attach(name).control.passes) == 12
            assert [one.name for one in sharing.running()].count(name) == 1
            with pytest.raises(sh.SharedError, match="already in use"):
                sharing.lock(name)
            squatter.kill()
            squatter.wait()
            with pytest.raises(sh.SharedError, match="already in use"):
                sharing.lock(name)
            assert int(sharing.attach(name).control.passes) == 12


OTHER_USER = """
import os, socket, sys
os.setresgid(65534, 65534, 65534)
os.setresuid(65534, 65534, 65534)
one = socket.socket(socket.AF_UNIX)
one.connect(b"\\0" + sys.argv[1].encode())
one.settimeout(240.0)
try:
    print(socket.recv_fds(one, 64, 2)[:2])
except ConnectionResetError:
    print((b"", []))
"""


def test_another_user_gets_nothing_of_a_node(block: sh.NodeMemory, name: str) -> None:
    if os.geteuid() != 0:
        return  # only root can be two users
    path = f"pcpc/{sharing._path('node', name)}"
    done = subprocess.run([sys.executable, "-c", OTHER_USER, path], capture_output=True, text=True)
    assert done.stdout == "(b'', [])\n", done.stdout + done.stderr
    assert sharing.attach(name).alive(), "the node goes on"

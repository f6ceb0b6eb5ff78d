"""A node's side of its memory: odd clients, old and narrow kernels, and what it says of itself."""

import errno
import fcntl
import os
import socket
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import standing
from places import PATIENCE_S

from pcpc.drivers.machine import claim
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing

HEAD: dict[str, Any] = {
    "variables": [["a.gain", "1/s", "parameter", "a", ""]],
    "state_columns": ["a.gain"], "timing_columns": [],
}  # fmt: skip
NAME = f"test-serving.{os.getpid()}"
REAL = fcntl.fcntl, os.memfd_create


@pytest.fixture
def served() -> Iterator[sharing.ServedMemory]:
    """Yield a memory that is handed out when the test serves it."""
    made = sharing.ServedMemory(NAME, HEAD)
    made.open()
    yield made
    made.close()


def client() -> socket.socket:
    """Return the line of a client that has not read anything yet."""
    line = claim.meet(sharing._path("node", NAME))
    assert line is not None
    return line


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def refuse(number: int) -> Any:
    def refused(*_: Any) -> Any:
        raise OSError(number, "no")

    return refused


def test_before_it_is_open_nobody_is_served() -> None:
    made = sharing.ServedMemory(NAME, HEAD)
    made.serve()
    assert made.sockets() == [] and made.is_sealed()
    made.close()


def test_a_client_says_what_it_is(served: sharing.ServedMemory) -> None:
    host = client()
    host.send(sharing.HOST)
    served.serve()
    assert served.has_host() and not served.block.control.recorded
    recorder = client()
    recorder.send(sharing.RECORDER)
    served.serve()
    assert served.block.control.recorded and served.told == {sharing.HOST, sharing.RECORDER}
    host.send(sharing.LEAVE)
    served.serve()
    assert not served.has_host() and len(served.sockets()) == 2, "the recorder stays"
    recorder.close()
    host.close()


def test_who_attaches_says_its_word_at_once() -> None:
    block = standing.stand(NAME, HEAD)
    other = sharing.attach(NAME, sharing.RECORDER)
    until_s = time.monotonic() + PATIENCE_S
    while not block.control.recorded and time.monotonic() < until_s:
        os.sched_yield()
    assert other.alive() and block.control.recorded
    standing.end(NAME)


def test_who_leaves_unheard_is_forgotten(served: sharing.ServedMemory) -> None:
    before = descriptors()
    client().close()  # before it is greeted
    unread = client()
    served.serve()
    assert len(served.sockets()) == 2
    unread.close()  # with the greeting unread: the connection is reset
    served.serve()
    assert len(served.sockets()) == 1 and descriptors() == before


def test_many_who_come_at_once_are_greeted_in_turns(
    served: sharing.ServedMemory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sharing, "_AT_ONCE", 2)
    lines = [client() for _ in range(3)]
    for count in (2, 3):
        served.serve()
        assert len(served.sockets()) == 1 + count
    for line in lines:
        line.close()


@pytest.mark.parametrize("number", [errno.ENOMEM, errno.EPERM])
@pytest.mark.parametrize("call", ["posix_fallocate", "memfd_create", "seal"])
def test_without_memory_nothing_is_left_behind(
    number: int, call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = descriptors()
    where, what = (fcntl, "fcntl") if call == "seal" else (os, call)
    monkeypatch.setattr(where, what, refuse(number))
    with pytest.raises(sh.SharedError, match=rf"^{NAME}: \d+ MiB of shared memory: no$"):
        sharing.ServedMemory(NAME, HEAD)
    monkeypatch.undo()
    assert descriptors() == before


def without_newer_seals(patch: pytest.MonkeyPatch, call: str, number: int) -> None:
    """Let the kernel refuse, with an error number, what only newer ones know."""

    def add_seals(descriptor: int, command: int, seals: int = 0) -> Any:
        if command == fcntl.F_ADD_SEALS and seals & sharing._F_SEAL_FUTURE_WRITE:
            raise OSError(number, "before Linux 5.1")
        return REAL[0](descriptor, command, seals)

    def memfd_create(name: str, flags: int) -> int:
        if flags & sharing._MFD_NOEXEC_SEAL:
            raise OSError(number, "before Linux 6.3")
        return REAL[1](name, flags)

    if call == "fcntl":
        patch.setattr(fcntl, "fcntl", add_seals)
    else:
        patch.setattr(os, "memfd_create", memfd_create)


@pytest.mark.parametrize("call", ["fcntl", "memfd_create"])
def test_an_older_kernel_has_memory_files_without_the_newer_seals(
    monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    without_newer_seals(monkeypatch, call, errno.EINVAL)
    made = sharing.ServedMemory(NAME, HEAD)
    assert made.is_sealed() == (call != "fcntl")
    for descriptor in made._files:
        seals = REAL[0](descriptor, fcntl.F_GET_SEALS)
        assert seals & (sharing._SEALS | fcntl.F_SEAL_SEAL) == sharing._SEALS | fcntl.F_SEAL_SEAL
    made.close()
    without_newer_seals(monkeypatch, call, errno.EPERM)
    with pytest.raises(sh.SharedError, match="shared memory: before Linux"):
        sharing.ServedMemory(NAME, HEAD)


def test_a_name_that_cannot_be_had_is_refused_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claim, "holder", lambda name: None)
    monkeypatch.setattr(claim, "hold", lambda name: None)
    with pytest.raises(sh.SharedError, match=f"{NAME}: cannot be claimed"):
        sharing.lock(NAME)
    monkeypatch.setattr(claim, "hold", refuse(errno.EPERM))
    with pytest.raises(sh.SharedError, match=r"no abstract socket here [(]no[)]; a node is found"):
        sharing.lock(NAME)


def test_other_users_are_told_by_their_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["node/7/a", "node/12/b", "node/7/c", f"node/{os.geteuid()}/d"]
    monkeypatch.setattr(claim, "held_names", lambda start: names)
    assert sharing.other_users() == ["12", "7"]


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"state_columns": range(sh.RECORD_RING_WORDS)}, "its rows do not fit the ring"),
        ({"data_bytes": 9}, "its frames have another size"),
        ({"variables": range(sh.MAX_VARIABLES + 1)}, "it has too many variables"),
        ({"variables": [["a", "1", "b", "c", 5]]}, "a variable is not described in words"),
    ],
)
def test_a_description_that_does_not_fit_the_memory_is_none(said: dict[str, Any], why: str) -> None:
    with pytest.raises((ValueError, TypeError), match=f"^{why}$"):
        sharing.check(sh.full_description("x", HEAD | said))


def test_a_block_of_its_own_lives_and_hears_nothing() -> None:
    block = sh.private(HEAD)
    block.tell(sharing.HOST)
    assert block.alive() and int(block.answer.request) == 0


def test_a_client_whose_line_is_closed_has_no_node(served: sharing.ServedMemory) -> None:
    line = client()
    block = sh.private(HEAD)
    other = sh.NodeMemory(
        "x", block.description, sh.fields(sh.blank(), sh.LOOP), client=sh.Client(line, os.dup(0))
    )
    other.tell(sharing.HOST)
    served.serve()
    assert served.has_host() and other.alive()
    line.close()
    other.tell(sharing.HOST)
    assert not other.alive()


def test_a_copy_of_variables_is_whole_the_old_one_or_an_error() -> None:
    class Moving:
        """Variables that a writer changes whenever they are copied, so many times."""

        def __init__(self, left: int) -> None:
            self.left = left

        def copy(self) -> Any:
            block["seq"][0] += 2 * (self.left > 0)
            self.left -= 1
            return np.array([self.left])

    block = sh.private(HEAD)
    block.arrays["snapshot"] = Moving(3)  # type: ignore[assignment]
    assert sh.snapshot(block).tolist() == [-1], "the fourth"
    block.arrays["snapshot"] = Moving(100)  # type: ignore[assignment]
    old = np.zeros(1)
    assert sh.snapshot(block, old, 3) is old
    block["seq"][0] = 1  # its writer died in the middle
    assert sh.snapshot(block, old) is old
    with pytest.raises(sh.SharedError, match="the writer died or never pauses"):
        sh.snapshot(block)

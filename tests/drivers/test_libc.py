"""libc calls and atomics, one source compiled and interpreted: results, errors, the GIL."""

import os
import signal
import socket
import struct
import threading
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function

EBADF, EINVAL = 9, 22
SECOND_NS = 1_000_000_000


@loop_function
def read_clock(timespec: Any) -> Any:
    return libc.clock_gettime(libc.CLOCK_MONOTONIC, libc.address(timespec))


@loop_function
def sleep_until(timespec: Any) -> Any:
    at = libc.address(timespec)
    return libc.clock_nanosleep(libc.CLOCK_MONOTONIC, libc.TIMER_ABSTIME, at, 0)


@loop_function
def send(fd: Any, data: Any) -> Any:
    n = libc.send(fd, libc.address(data), len(data), libc.MSG_DONTWAIT)
    return n, libc.errno()


@loop_function
def receive(fd: Any, data: Any, flags: Any) -> Any:
    n = libc.recv(fd, libc.address(data), len(data), flags)
    return n, libc.errno()


@loop_function
def announce_and_receive(fd: Any, data: Any) -> Any:
    libc.send(fd, libc.address(data), len(data), 0)
    return libc.recv(fd, libc.address(data), len(data), 0)


@loop_function
def give_way() -> Any:
    return libc.sched_yield()


@loop_function
def publish(words: Any, value: Any) -> Any:
    libc.store_release(words, 0, value)
    libc.fence_release()
    libc.store_release(words, 2, -value)
    return libc.load_acquire(words, 2)


@loop_function
def count_until(words: Any, limit: Any) -> Any:
    """Spin until words[0] is set from another thread; -1 after `limit` turns."""
    for turn in range(limit):
        if libc.load_acquire(words, 0) != 0:
            return turn
        libc.sched_yield()
    return -1


def timespec(t_ns: int) -> NDArray[np.int64]:
    return np.array(divmod(t_ns, SECOND_NS), np.int64)


def test_the_clock_is_pythons_monotonic_clock() -> None:
    now = np.zeros(2, np.int64)
    before = time.monotonic_ns()
    assert read_clock(now) == 0
    after = time.monotonic_ns()
    t_ns = int(now[0]) * SECOND_NS + int(now[1])
    assert before <= t_ns <= after, f"{t_ns} ns is not in {before} to {after}"


def test_sleep_wakes_at_the_deadline_and_at_once_when_it_has_passed() -> None:
    until_ns = time.monotonic_ns() + 2_000_000
    assert sleep_until(timespec(until_ns)) == 0
    late_ns = time.monotonic_ns() - until_ns
    assert late_ns >= 0, f"woke {-late_ns} ns early"
    assert sleep_until(timespec(1)) == 0


def test_sleep_returns_the_error_number_itself() -> None:
    got = sleep_until(np.array([0, SECOND_NS], np.int64))
    assert got == EINVAL, f"{got}, not EINVAL for 1e9 ns"


def test_a_signal_ends_the_sleep_with_eintr() -> None:
    caught: list[int] = []
    before = signal.signal(signal.SIGALRM, lambda number, _: caught.append(number))
    sleep_until(timespec(1))  # is compiled
    until = timespec(time.monotonic_ns() + 20 * SECOND_NS)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.02, 0.02)  # the first may come before it sleeps
        got = sleep_until(until)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert got == libc.EINTR, f"{got}, not EINTR"


def test_datagrams_pass_and_failures_leave_their_error_number() -> None:
    left, right = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    data, buffer = np.arange(16, dtype=np.uint8), np.zeros(64, np.uint8)
    with left, right:
        n, _ = send(left.fileno(), data)
        assert n == 16, f"{n} of 16 bytes sent"
        n, _ = receive(right.fileno(), buffer, libc.MSG_DONTWAIT)
        assert n == 16 and bytes(buffer[:17]) == bytes(range(16)) + b"\0", f"{n}: {buffer}"
        got = receive(right.fileno(), buffer, libc.MSG_DONTWAIT)
        assert got == (-1, libc.EAGAIN), f"{got}"
    assert receive(-1, buffer, 0) == (-1, EBADF)
    assert send(-1, data) == (-1, EBADF)


def test_each_thread_has_its_own_error_number() -> None:
    buffer = np.zeros(8, np.uint8)
    assert receive(-1, buffer, 0) == (-1, EBADF)
    read_end, write_end = os.pipe()
    others: list[Any] = []
    thread = threading.Thread(target=lambda: others.append(receive(read_end, buffer, 0)))
    thread.start()
    thread.join()
    os.close(read_end)
    os.close(write_end)
    assert others == [(-1, 88)], f"{others}, not ENOTSOCK"
    assert receive(-1, buffer, 0) == (-1, EBADF)


def test_a_blocked_receive_holds_no_gil() -> None:
    left, right = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    right.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 2, 0))
    buffer, got = np.zeros(8, np.uint8), []
    fd = right.fileno()
    with left, right:
        thread = threading.Thread(target=lambda: got.append(announce_and_receive(fd, buffer)))
        thread.start()
        left.recv(8)
        left.send(b"go")
        thread.join()
    assert got == [2], f"received {got}: the sender had to wait for the receiver's time-out"


def test_stores_are_seen_by_loads_here_and_in_another_thread() -> None:
    words = np.zeros(3, np.int64)
    loaded = publish(words, -(2**63) + 1)
    assert loaded == 2**63 - 1, f"loaded {loaded}"
    assert words.tolist() == [-(2**63) + 1, 0, 2**63 - 1], f"{words}"
    words[:] = 0
    count_until(words, 1)
    turns: list[int] = []
    thread = threading.Thread(target=lambda: turns.append(count_until(words, 10_000_000)))
    thread.start()
    publish(words, 7)
    thread.join()
    assert turns[0] >= 0, "the other thread never saw the store"


def test_yield_succeeds() -> None:
    assert give_way() == 0

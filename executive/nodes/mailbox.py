"""A client's side of a node's mailbox: requests, the lock, and a stop that needs neither.

One client at a time writes: the mailbox's own file is the lock (flock), which the kernel frees when
a client dies. Any process of this user may write anything all the same, so what stands there is
never believed, and a stop that nobody hears is asked for by a signal to the node's process.
"""

import fcntl
import os
import select
import signal
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.requests import Lock, Refusal

LEVELS = Lock.words()
STOP = "supervisor.stop"
PATIENCE_S = 2.0  # a node that runs takes tunings within a period
POLL_S = 0.001
_REFUSALS = {int(one): one.says for one in Refusal}


class LiveError(UserError):
    """A node, or what is asked of it, cannot be had; ENVIRONMENT: it is not there."""


def level_of(block: sh.NodeMemory) -> str:
    """Return what is locked, one of LEVELS; a word that is none of them locks all."""
    word = int(block.mail.lock)
    return LEVELS[word] if 0 <= word < len(LEVELS) else LEVELS[-1]


class Mailbox:
    """That of a node; LiveError where it has ended."""

    def __init__(self, block: sh.NodeMemory) -> None:
        self._block = block

    def post(self, places: Mapping[str, int], values: Sequence[float]) -> int:
        """Ask for values of variables, by their places; return the first cycle with them.

        LiveError: refused or not answered.
        """
        block = self._block
        mail, answer = block.mail, block.answer
        with self._one_client():
            level = level_of(block)
            if level != "none" and [*places] != [STOP]:
                raise LiveError(
                    f"{block.name}: locked ({level}); `pcpc operate lock none` allows tunings"
                )
            if not block.control.passes:
                what = "no cycle yet; it waits for the other node"
                raise LiveError(f"{block.name}: {what}", Exit.ENVIRONMENT)
            self._acknowledged_cycle(int(mail.request))  # of a client that died waiting
            block["mail_index"][: len(places)] = [*places.values()]
            block["mail_value"][: len(places)] = values
            mail.count = len(places)
            _release()
            request = _next(int(mail.request))
            mail.request = request
            cycle = self._acknowledged_cycle(request)
            refusal, entry = int(answer.refusal), int(answer.entry)
            if refusal != Refusal.ACCEPTED:
                name = dict(enumerate(places)).get(entry, block.name)  # if another wrote meanwhile
                why = _REFUSALS.get(refusal, f"reason {refusal}")
                raise LiveError(f"{name}: refused by the node: {why}; nothing was set")
            return cycle

    def stop(self, place: int, value: float) -> int:
        """Ask for the end of the run, whatever others write or hold; return the cycle.

        `place`: of the variable STOP. A signal to the process is the last resort: it ends by its
        ramp, also where `value` asked for a quick stop. LiveError: the node does not react.
        """
        block = self._block
        try:
            cycle = self.post({STOP: place}, [value])
            if self._heard(place):
                return cycle
        except LiveError:
            if not self._runs() or not block.control.passes:
                raise
        pid = int(block.control.pid)
        with suppress(OSError):
            if pid > 1:  # not a group
                os.kill(pid, signal.SIGTERM)
        if not self._heard(place):
            what = f"it does not react to requests or signals; kill -9 {pid} ends it"
            raise LiveError(f"{block.name}: {what}", Exit.ENVIRONMENT)
        return int(block.control.cycle)

    def lock(self, level: str) -> None:
        """Write a lock level, one of LEVELS."""
        with self._one_client():
            self._block.mail.lock = LEVELS.index(level)

    def _runs(self) -> bool:
        return self._block.alive() and not self._block.control.done

    def _heard(self, place: int) -> bool:
        """Wait until a request to stop was heard; return whether it was."""
        deadline_s = time.monotonic() + PATIENCE_S
        control, values = self._block.control, self._block["snapshot"]
        while self._runs() and not control.stop and not values[place]:
            if time.monotonic() > deadline_s:
                return False
            pause(self._block, POLL_S)
        return True

    @contextmanager
    def _one_client(self) -> Iterator[None]:
        """Keep others out of the mailbox; LiveError if one stays in it or the node ended."""
        client, name = self._block.client, self._block.name
        if not self._block.alive() or client is None:
            raise LiveError(f"{name}: ended", Exit.ENVIRONMENT)
        descriptor = os.open(f"/proc/self/fd/{client.mailbox}", os.O_RDONLY)  # a lock of its own
        deadline_s = time.monotonic() + 2 * PATIENCE_S  # the other one waits as long
        try:
            while True:
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if not self._block.alive() or time.monotonic() > deadline_s:
                        what = f"{name}: another host holds the mailbox; end it"
                        raise LiveError(what, Exit.ENVIRONMENT) from None
                    pause(self._block, POLL_S)
            yield
        finally:
            os.close(descriptor)

    def _acknowledged_cycle(self, request: int) -> int:
        """Wait for the node's acknowledgement; return its cycle, or withdraw: LiveError."""
        deadline_s = time.monotonic() + PATIENCE_S
        answer = self._block.answer
        while int(answer.request) != request:
            runs = self._runs()
            if not runs or time.monotonic() > deadline_s:
                self._block.mail.count = 0  # the loop looks at it once: all or none here too
                why = f"took no tunings for {PATIENCE_S:g} s" if runs else "ended"
                raise LiveError(f"{self._block.name}: {why}; nothing was set", Exit.ENVIRONMENT)
            pause(self._block, POLL_S)
        return int(answer.cycle)


def pause(block: sh.NodeMemory, seconds: float) -> None:
    """Sleep, but not beyond the end of the node's process."""
    client = block.client
    select.select([] if client is None else [client.line], [], [], seconds)


def _next(request: int) -> int:
    """Return the number behind one of 64 bits, whatever somebody has made of that."""
    return (request + 1 + 2**63) % 2**64 - 2**63


def _release() -> None:
    """Make the slots visible before the request that is stored next, also on ARM.

    Releasing a lock orders what is before it, taking it again what follows.
    """
    barrier = threading.Lock()
    for _ in range(2):
        barrier.acquire()
        barrier.release()

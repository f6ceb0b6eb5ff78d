"""One command in one guest: carries stdin, stdout, stderr and signals, returns the exit code.

The guest's side is guest.sh. stdout and stderr are apart unless they are the same file here (then
their order is kept). SIGINT, SIGTERM and SIGHUP go to the command; a second one, or 5 s without its
end, ends QEMU.
"""

import math
import os
import platform
import re
import secrets
import selectors
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from pcpc.tools.machine.vm.errors import VmError
from pcpc.tools.machine.vm.machine import PORTS, Machine
from pcpc.tools.machine.vm.progress import Progress

_GRACE_S = 5.0
_CONSOLE_LINES = 12
_CAUSE = re.compile(r"pcpc-vm: |Kernel panic|BUG: |qemu-system")
_SIGNALS = {signal.SIGINT: b"INT\n", signal.SIGTERM: b"TERM\n", signal.SIGHUP: b"HUP\n"}
_CODE_TIMEOUT, _CODE_BROKEN_PIPE = 124, 141  # as of timeout(1) and of a shell


@dataclass
class Stream:
    """Splits the end mark off a stream of bytes that arrives in pieces."""

    mark: bytes
    ended: bool = False
    _held: bytes = b""

    def feed(self, piece: bytes) -> bytes:
        """Return what can be passed on: no possible beginning of the mark, nothing after it."""
        if self.ended:
            return b""
        data = self._held + piece
        at = data.find(self.mark)
        if at >= 0:
            self.ended, self._held = True, b""
            return data[:at]
        lengths = range(min(len(self.mark) - 1, len(data)), 0, -1)
        keep = next((n for n in lengths if data.endswith(self.mark[:n])), 0)
        self._held = data[len(data) - keep :]
        return data[: len(data) - keep]


@dataclass(frozen=True)
class TimeLimits:
    """Times in s from the start of QEMU: to the end of the command, and to `up`."""

    total_s: float
    boot_s: float = math.inf


class MachineSession:
    """Runs one job (a shell script, job.py) in a machine that has just been started; used once."""

    def __init__(
        self, machine: Machine, job: bytes, limits: TimeLimits, progress: Progress
    ) -> None:
        """Nothing is sent before `run`."""
        self.up = False
        self._machine, self._job, self._limits, self._progress = machine, job, limits, progress
        self._mark = secrets.token_hex(16).encode()
        self._streams = {"out": Stream(self._mark), "err": Stream(self._mark)}
        self._console = bytearray()
        self._control = b""
        self._status: int | None = None
        self._stop_code: int | None = None
        self._stop_at_s = math.inf
        self._signals: list[int] = []

    def run(self) -> int:
        """Return the command's exit code; 124 after the time limit, 128 + n after signal n.

        Raises VmError if the guest is not up in time or ends without an exit status.
        """
        start_s = time.monotonic()
        with selectors.PollSelector() as selector, self._handled_signals():
            for name in (*PORTS, "console"):
                selector.register(self._machine.sockets[name], selectors.EVENT_READ, name)
            while self._status is None or not all(s.ended for s in self._streams.values()):
                for key, _ in selector.select(0.2):
                    piece = self._machine.sockets[key.data].recv(1 << 16)
                    if not piece:
                        selector.unregister(key.fileobj)
                    elif not self._take(key.data, piece):
                        return _CODE_BROKEN_PIPE
                if not selector.get_map() or self._machine.process.poll() is not None:
                    raise self._guest_error("ended without an exit status")
                now_s = time.monotonic() - start_s
                self._watch(now_s)
                if now_s >= self._stop_at_s:
                    break
        if self._stop_code is not None and (
            self._status is None or self._stop_code == _CODE_TIMEOUT
        ):
            return self._stop_code
        return self._status or 0

    def _take(self, name: str, piece: bytes) -> bool:
        """Handle bytes from a port or the console; False if nobody reads our output any more."""
        if name == "console":
            self._console += piece
            self._progress.console(piece)
        elif name == "control":
            self._control += piece
            *lines, self._control = self._control.split(b"\n")
            for line in lines:
                self._take_control(line.decode())
        elif name == "job":
            self._machine.send("job", self._job)
            self._machine.close("job")
        elif name == "in":
            threading.Thread(target=self._pass_stdin, daemon=True).start()
        else:
            return _written(2 if name == "err" else 1, self._streams[name].feed(piece))
        return True

    def _take_control(self, line: str) -> None:
        if line == "up":
            self.up = True
            self._progress.done()
            streams = b"merged" if os.path.sameopenfile(1, 2) else b"split"
            hostname = platform.node().encode() or b"vm"
            self._machine.send("control", b"%s %s %s\n" % (self._mark, streams, hostname))
        elif line.startswith("exit "):
            self._status = int(line.removeprefix("exit "))

    def _pass_stdin(self) -> None:
        """Copy stdin to the guest; a thread, since it may take input only after we took output."""
        with suppress(OSError):  # closed here, or the guest is gone
            while data := os.read(0, 1 << 16):
                self._machine.sockets["in"].sendall(data)
        self._machine.close("in")

    def _watch(self, now_s: float) -> None:
        """Apply the time limits and the signals that have come."""
        if not self.up:
            self._progress.booting(now_s)
            if now_s > self._limits.boot_s:
                raise self._guest_error(f"is not up after {now_s:.0f} s")
        if now_s > self._limits.total_s and self._stop_code is None:
            self._progress.say(f"time limit of {self._limits.total_s:g} s: ending the guest")
            self._stop(_CODE_TIMEOUT, signal.SIGTERM, now_s)
        while self._signals:
            number = self._signals.pop(0)
            if self._stop_code is None:
                self._stop(128 + number, number, now_s)
            else:
                self._stop_at_s = now_s

    def _stop(self, code: int, number: int, now_s: float) -> None:
        self._stop_code = code
        self._stop_at_s = now_s + (_GRACE_S if self.up else 0.0)
        self._machine.send("control", _SIGNALS[signal.Signals(number)])

    def _guest_error(self, what: str) -> VmError:
        text = re.sub(r"\x1b(\[[?0-9;]*[a-zA-Z]|c)", "", self._console.decode(errors="replace"))
        lines = [line for line in text.splitlines() if line.strip()]
        for line in lines[-_CONSOLE_LINES:]:
            self._progress.say(f"console: {line}")
        causes = [line for line in lines if _CAUSE.search(line)]
        why = causes[0] if causes else "--verbose shows its console"
        return VmError(f"the guest {what}: {why}")

    @contextmanager
    def _handled_signals(self) -> Iterator[None]:
        def remember(number: int, _: object) -> None:
            self._signals.append(number)

        before = {number: signal.signal(number, remember) for number in _SIGNALS}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def _written(fd: int, data: bytes) -> bool:
    """Write all of `data`; False when the reader is gone."""
    try:
        while data:
            data = data[os.write(fd, data) :]
    except BrokenPipeError:
        return False
    return True

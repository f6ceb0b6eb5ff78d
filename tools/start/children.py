"""The processes of a run: started together, watched, ended in order.

    forked     a copy of the host, which has loaded everything already: the nodes, the recorder
    started    a Python of its own: nodes of which the loop is to be interpreted

Either has a session of its own (Ctrl-C is for the host, which ends them in order), nothing to read,
nobody who reads its stdout, and a stderr that is kept.
"""

import contextlib
import ctypes
import gc
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from pcpc.tools.terminal.ending import refusal

_PR_SET_PDEATHSIG, _PR_SET_NAME = 1, 15
_LOOK_S = 0.005
_libc = ctypes.CDLL(None)


class Child:
    """A process of the run; its stderr is kept for `complaint`."""

    def __init__(
        self, name: str, process: "subprocess.Popen[bytes] | ForkedProcess", stderr: Any
    ) -> None:
        self.name, self.process, self._stderr = name, process, stderr
        self.asked = False  # to end, by this process

    @classmethod
    def fork(
        cls,
        name: str,
        main: Callable[[Sequence[str]], int],
        arguments: Sequence[str],
        *,
        survives: bool = False,
    ) -> "Child":
        """Call `main` in a copy of this process, which has no other thread; it ends with it.

        `survives`: it lives on when this process dies, and holds nothing that this one has open.
        """
        stderr = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the child
        return cls(
            name, ForkedProcess(name, lambda: main(arguments), stderr.fileno(), survives), stderr
        )

    @classmethod
    def serving(cls, name: str, main: Callable[[int], int]) -> "Child":
        """Call `main(ready)` in a copy of this process; return once it closes `ready`, or ends."""
        ready, told = os.pipe()
        child = cls.fork(name, lambda _: main(told), ())
        os.close(told)
        os.read(ready, 1)  # nothing comes but the end, when the other side is closed
        os.close(ready)
        return child

    @classmethod
    def started(
        cls, name: str, module: str, arguments: Sequence[str], *, interpreted: bool = False
    ) -> "Child":
        """Start a Python module; it ends with this process."""
        host = os.getpid()
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        if interpreted:
            environment["PCPC_LOOP"] = "interpreted"
        stderr = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the child
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *arguments],  # -P: the user's folder has no say
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            env=environment,
            preexec_fn=lambda: end_with(host),
            start_new_session=True,
        )
        return cls(name, process, stderr)

    @property
    def ended(self) -> bool:
        """True once the process is gone."""
        return self.process.poll() is not None

    @property
    def code(self) -> int:
        """The exit code; negative is a signal's number; only once `ended`."""
        assert self.process.returncode is not None, "it has ended"
        return self.process.returncode

    def complaint(self) -> list[str]:
        """Return the lines that the child wrote to stderr so far."""
        self._stderr.seek(0)
        return self._stderr.read().decode(errors="replace").splitlines()

    def end(self, patience_s: float, ask_s: float = 5.0) -> None:
        """Wait, then ask with SIGTERM, then after `ask_s` kill."""
        for ask, wait_s in ((None, patience_s), (signal.SIGTERM, ask_s), (signal.SIGKILL, 5.0)):
            if ask is not None:
                self.ask(ask)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(wait_s)
                return

    def ask(self, number: int = signal.SIGTERM) -> None:
        """Ask the child to end, without waiting."""
        if not self.ended:
            self.asked = True
            self.process.send_signal(number)


class ForkedProcess:
    """A copy of this process, used as a `subprocess.Popen` is."""

    def __init__(self, name: str, call: Callable[[], int], stderr: int, survives: bool) -> None:
        self.returncode: int | None = None
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        gc.freeze()  # what is here stays shared with the copy
        host, self.pid = os.getpid(), os.fork()
        if self.pid == 0:
            _be_child(name, call, stderr, 0 if survives else host)

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if pid else None
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Wait for the end and return the exit code; subprocess.TimeoutExpired."""
        end_s = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() >= end_s:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            time.sleep(_LOOK_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, if it is still there."""
        if self.poll() is None:
            os.kill(self.pid, number)


def _be_child(name: str, call: Callable[[], int], stderr: int, host: int) -> NoReturn:
    """Go on as a process of its own, which ends with `call`, and with `host` unless that is 0."""
    code = 1
    try:
        os.setsid()
        if host:
            end_with(host)
        _libc.prctl(_PR_SET_NAME, f"pcpc {name}".encode())
        nothing = os.open(os.devnull, os.O_RDWR)
        for number, file in ((0, nothing), (1, nothing), (2, stderr)):
            os.dup2(file, number)
        if not host:
            _let_go(nothing)
        sys.stdout, sys.stderr = (
            open(n, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
            for n in (1, 2)
        )
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        code = call()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException as error:
        with contextlib.suppress(OSError, ValueError):
            said = refusal(error)
            if said is None:
                traceback.print_exc()
            else:
                print(f"{name}: {said}", file=sys.stderr)
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.flush()
        os._exit(code)


def _let_go(nothing: int) -> None:
    """Close what was open; its numbers stay taken, so that no object of the host closes ours.

    But for those beyond `ulimit -n`, which was lowered since: nobody can take them.
    """
    for number in map(int, os.listdir("/proc/self/fd")):
        if number > 2:
            try:
                os.dup2(nothing, number)
            except OSError:
                with contextlib.suppress(OSError):  # the list's own
                    os.close(number)


def end_with(host: int, number: int = signal.SIGTERM) -> None:
    """Let this process get a signal, asking it to end, when `host`, its parent, dies."""
    _libc.prctl(_PR_SET_PDEATHSIG, number)
    if os.getppid() != host:  # it died before the request stood
        os._exit(1)


def on_request(handler: Callable[[int, Any], None]) -> None:
    """Let `handler` hear Ctrl-C, SIGTERM and a terminal that is closed (unless by nohup)."""
    signal.signal(signal.SIGINT, handler)
    signal.signal(signal.SIGTERM, handler)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, handler)


def complain(children: Sequence[Child]) -> None:
    """Print on stderr what the children said; what two of them say is printed once."""
    said: dict[str, list[str]] = {}  # a sentence and the children that name themselves before it
    for child in children:
        for line in child.complaint():
            text = line.removeprefix(f"{child.name}: ")
            said.setdefault(text, []).extend([child.name] if text != line else [])
    for text, names in said.items():
        print(f"{' and '.join(names)}: {text}" if names else text, file=sys.stderr)

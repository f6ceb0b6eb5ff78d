"""`pcpc` in copies of a process that has imported it: most of a start is imports.

A server, one a test process, imports all commands and forks for each request. The copy runs the
script `pcpc`, in a session of its own, with the folder and the streams that it is given. It ends as
every Python does; the server hands on its exit code. The environment is the server's.
"""

import atexit
import gc
import json
import os
import runpy
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path

_LOOK_S = 0.005
_LARGEST = 1 << 20


class Copies:
    """The server, from the side of the tests; it ends with them."""

    def __init__(self, script: str, at_start: Callable[[], None]) -> None:
        self.environment = _environment()
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._server = subprocess.Popen(
                [sys.executable, __file__, script], stdin=theirs, stdout=subprocess.DEVNULL,
                start_new_session=True, preexec_fn=at_start,
            )  # fmt: skip
        atexit.register(self.end)

    def end(self) -> None:
        """End the server."""
        self._ours.close()
        self._server.wait()

    @property
    def fits(self) -> bool:
        """Return whether a copy has the environment that a process started now would have."""
        return _environment() == self.environment

    def start(self, words: Sequence[str], cwd: Path, out: int, err: int) -> "Copy":
        """Start `pcpc` with `words`."""
        return Copy(self._ours, json.dumps([str(cwd), *words]).encode(), out, err)


class Copy:
    """A started command, used as a `subprocess.Popen` is."""

    def __init__(self, server: socket.socket, request: bytes, out: int, err: int) -> None:
        self.returncode: int | None = None
        self._status, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            socket.send_fds(server, [request], [out, err, theirs.fileno()])
        self.pid = int(self._status.recv(64))
        self._status.setblocking(False)

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        if self.returncode is None:
            try:
                self.returncode = int(self._status.recv(64))
                self._status.close()
            except BlockingIOError:
                pass
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end and return the exit code; subprocess.TimeoutExpired."""
        end = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if end is not None and time.monotonic() >= end:
                raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
            time.sleep(_LOOK_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, if it is still there."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


def _environment() -> dict[str, str]:
    """Return this process's environment, but for what pytest says in it of the present test."""
    return {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}


def _serve(requests: socket.socket) -> tuple[list[str], list[int]]:
    """Fork for each request until the tests end; return, in the copy, what it got: words, files."""
    with selectors.DefaultSelector() as selector:
        selector.register(requests, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.data is not None:
                    selector.unregister(key.fd)
                    _hand_on(key.fd, *key.data)
                    continue
                text, files, _, _ = socket.recv_fds(requests, _LARGEST, 3, socket.MSG_CMSG_CLOEXEC)
                if not text:
                    sys.exit()
                pid = os.fork()
                if pid == 0:
                    return json.loads(text), files
                out, err, status = files
                os.close(out)
                os.close(err)
                answer = socket.socket(fileno=status)
                answer.send(str(pid).encode())
                selector.register(os.pidfd_open(pid), selectors.EVENT_READ, (pid, answer))


def _hand_on(watched: int, pid: int, answer: socket.socket) -> None:
    """Tell the exit code of a copy that has ended."""
    os.close(watched)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    with answer, suppress(BrokenPipeError):  # a test that wants it no more
        answer.send(str(code).encode())


def _become(cwd: str, words: Sequence[str], files: Sequence[int]) -> None:
    """Take the place of a command that was started with these words, folder and streams."""
    os.setsid()
    nothing = os.open(os.devnull, os.O_RDWR)
    for number, file in enumerate((nothing, *files[:2])):
        os.dup2(file, number)
    os.closerange(3, 256)
    os.chdir(cwd)
    sys.argv[1:] = words


if __name__ == "__main__":
    sys.argv[0] = sys.argv.pop()
    sys.path[0] = str(Path(sys.argv[0]).parent)
    for _command in import_module("pcpc.tools.console.commands").COMMANDS.values():
        for _one in _command.parts or (_command,):
            import_module(f"pcpc.tools.{_one.at}")
    import_module("pcpc.executive.loop.exchange").run_of(2)
    gc.collect()
    gc.freeze()
    (_cwd, *_words), _files = _serve(socket.socket(fileno=os.dup(0)))
    _become(_cwd, _words, _files)
    runpy.run_path(sys.argv[0], run_name="__main__")

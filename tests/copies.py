"""Commands in copies of a process that has imported what they need: most of a start is imports.

A server, one a test process, imports all commands, steps a rig, so that compiled code is loaded,
and forks for each request. The copy runs the command's script in a session of its own, with the
folder, environment and streams that it is given; the server hands on its exit code. What an
environment would change at an import starts a new Python instead.

`bin_folder` holds programs that ask for a copy, for shells and for pytest in a pytest.
"""

import atexit
import ctypes
import gc
import json
import math
import os
import runpy
import select
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

PROGRAMS = {name: str(Path(sys.executable).with_name(name)) for name in ("pcpc", "pytest")}
_AT_RUN_TIME = {  # read when they are needed, not at an import
    "PATH", "PWD", "OLDPWD", "SHLVL", "_", "COLUMNS", "LINES", "HOME", "USERPROFILE",
    "XDG_CACHE_HOME", "XDG_STATE_HOME",
}  # fmt: skip
_LATER = (  # what commands import once they know that they need it
    "matplotlib.figure", "matplotlib.backends.backend_agg", "pytest", "pcpc.tools.live.host.server",
    "uvicorn.lifespan.on", "uvicorn.loops.asyncio", "uvicorn.protocols.http.h11_impl",
)  # fmt: skip
_BEFORE = dict(os.environ)  # imports add to it, and tests, one of which may start the server
_RIG = str(Path(__file__).resolve().parents[1] / "plants" / "atb1000" / "rigs" / "slew10.yaml")
_LARGEST = 1 << 20
_PR_SET_PDEATHSIG = 1
_PROGRAM = """\
#!{python} -SE
import sys
sys.path.insert(0, {here!r})
from copies import stand_in
stand_in({address!r}, {script!r})
"""


class Copies:
    """The server, from the side of the tests; it ends with them."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="copies-")
        self.address = str(Path(self._folder.name, "socket"))
        self._ours, theirs = socket.socketpair()
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening, theirs:
            listening.bind(self.address)
            listening.listen(16)
            self._server = subprocess.Popen(
                [sys.executable, __file__, str(listening.fileno())],
                pass_fds=[listening.fileno()],
                stdin=theirs,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,  # cannot be sought
                start_new_session=True,
                preexec_fn=as_of_a_terminal,
                env=_BEFORE,
            )
        atexit.register(self.end)

    def end(self) -> None:
        """End the server."""
        self._ours.close()
        self._server.wait()
        self._folder.cleanup()

    def bin_folder(self) -> Path:
        """Return a folder with a program for each of PROGRAMS."""
        folder = Path(self._folder.name, "bin")
        if not folder.exists():
            folder.mkdir()
            here = str(Path(__file__).parent)
            for name, script in PROGRAMS.items():
                values = {"here": here, "address": self.address, "script": script}
                (folder / name).write_text(_PROGRAM.format(python=sys.executable, **values))
                (folder / name).chmod(0o755)
        return folder


@cache
def copies() -> Copies:
    """Return the server of this test process."""
    return Copies()


def program(name: str = "pcpc") -> str:
    """Return a program that asks for a copy, for what starts programs."""
    return str(copies().bin_folder() / name)


class Copy:
    """A started script, used as a `subprocess.Popen` is; `files`: stdin, stdout, stderr."""

    def __init__(
        self,
        address: str,
        words: Sequence[str],
        cwd: Path,
        environment: Mapping[str, str],
        files: Sequence[int],
    ) -> None:
        self.returncode: int | None = None
        self._status = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._status.connect(address)
        request = json.dumps([str(cwd), dict(environment), *words]).encode()
        socket.send_fds(self._status, [request], list(files))
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
        limit = None if timeout == math.inf else timeout
        if self.returncode is None and not select.select([self._status], [], [], limit)[0]:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        code = self.poll()
        assert code is not None, "what can be read is the code"
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, if it is still there."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


class Heard(Copy):
    """One whose stdout and stderr are read while it runs; its words are those of `pcpc`."""

    def __init__(self, words: Sequence[str], environment: Mapping[str, str]) -> None:
        nothing, ours = os.open(os.devnull, os.O_RDONLY), [os.pipe() for _ in range(2)]
        files = [nothing, *(theirs for _, theirs in ours)]
        super().__init__(
            copies().address, [PROGRAMS["pcpc"], *words], Path.cwd(), environment, files
        )
        for file in files:
            os.close(file)
        self.stdout, self.stderr = (os.fdopen(file, errors="replace") for file, _ in ours)
        self._rest: tuple[str, str] | None = None

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Wait for the end; return what was not read before, also when asked again."""
        self.wait(timeout)
        if self._rest is None:
            with self.stdout, self.stderr:
                self._rest = self.stdout.read(), self.stderr.read()
        return self._rest


def end_with_the_tests() -> None:
    """Begin so, before what is started; it does not outlive the tests, also killed ones."""
    as_of_a_terminal()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def say_no_compiling() -> None:
    """Let commands of this process not say that they compile: when is the machine's affair."""
    vars(import_module("pcpc.drivers.compiled.compile_cache"))["SHORT_S"] = math.inf


def defer_grammars() -> None:
    """Let 38 grammars be made once jsonschema has an IRI to check, not at its import: a second."""
    name, later = "rfc3987_syntax", ModuleType("rfc3987_syntax")

    def is_valid_syntax(term: str, text: str) -> bool:
        if sys.modules[name] is later:
            del sys.modules[name]
        return bool(import_module(name).is_valid_syntax(term, text))

    vars(later)["is_valid_syntax"] = is_valid_syntax
    if name not in sys.modules and find_spec(name) is not None:
        sys.modules[name] = later


def as_of_a_terminal() -> None:
    """Begin as a shell of a terminal begins a command, whatever started the tests: nohup, cron."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def stand_in(address: str, script: str) -> NoReturn:
    """Be a copy that runs `script` with the words of this process, as far as others can tell."""
    handed_on = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    signal.pthread_sigmask(signal.SIG_BLOCK, handed_on)  # until there is somebody to hear them
    copy = Copy(address, [script, *sys.argv[1:]], Path.cwd(), os.environ, [0, 1, 2])
    for number in handed_on:
        signal.signal(number, lambda which, _: copy.send_signal(which))
    signal.pthread_sigmask(signal.SIG_UNBLOCK, handed_on)
    code = copy.wait()
    if code < 0:
        signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    sys.exit(code)


def _fits(environment: Mapping[str, str]) -> bool:
    """Return whether imports have read nothing else than they would in this environment."""
    return all(
        environment.get(name) in (_BEFORE.get(name), os.environ.get(name))
        for name in {*environment, *_BEFORE, *os.environ} - _AT_RUN_TIME
        if not name.startswith("PYTEST_")
    )


def _serve(listening: socket.socket, tests: socket.socket) -> tuple[list[Any], list[int]]:
    """Fork for each request until the tests end; return, in the copy, what it got: words, files."""
    with selectors.DefaultSelector() as selector:
        selector.register(listening, selectors.EVENT_READ)
        selector.register(tests, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.data is not None:
                    _look(selector, *key.data)
                    continue
                if key.fileobj is tests:
                    _end_all(selector)
                    sys.exit()
                client, _ = listening.accept()
                text, files, _, _ = socket.recv_fds(client, _LARGEST, 3, socket.MSG_CMSG_CLOEXEC)
                if not text:
                    continue  # who asked is gone
                pid = os.fork()
                if pid == 0:
                    vars(import_module("pcpc.tools.cli"))["_BEGIN_NS"] = time.monotonic_ns()
                    return json.loads(text), files
                for file in files:
                    os.close(file)
                client.send(str(pid).encode())
                watched = os.pidfd_open(pid)
                for one in (watched, client):
                    selector.register(one, selectors.EVENT_READ, (pid, watched, client))


def _end_all(selector: selectors.BaseSelector) -> None:
    """End what goes on once the tests are gone, also killed ones."""
    for pid in {key.data[0] for key in selector.get_map().values() if key.data is not None}:
        os.kill(pid, signal.SIGKILL)  # it is there until it is waited for


def _look(selector: selectors.BaseSelector, pid: int, watched: int, client: socket.socket) -> None:
    """Tell the exit code of a copy that has ended; end one that nobody waits for any more."""
    if watched not in selector.get_map():
        return  # both had something to say
    found, status = os.waitpid(pid, os.WNOHANG)
    if not found:
        selector.unregister(client)
        os.kill(pid, signal.SIGKILL)
        return
    selector.unregister(watched)
    os.close(watched)
    with suppress(KeyError):
        selector.unregister(client)
    with client, suppress(BrokenPipeError):
        client.send(str(os.waitstatus_to_exitcode(status)).encode())


def _become(cwd: str, environment: dict[str, str], words: list[str], files: Sequence[int]) -> None:
    """Take the place of a Python that was started with this folder, environment and streams."""
    os.setsid()
    for number, file in enumerate(files):
        os.dup2(file, number)
    os.closerange(3, 256)
    os.chdir(cwd)
    if not _fits(environment):
        os.execve(sys.executable, [sys.executable, *words], environment)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv[:] = words
    sys.path[0] = str(Path(words[0]).parent)


def _leave(code: int) -> None:
    """End as Python does, but do not tear down what is imported: that copies every page of it."""
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
            continue
        sys.exit(code)  # Python tells what it could not write
    os._exit(code)


if __name__ == "__main__":
    defer_grammars()
    for _command in import_module("pcpc.tools.cli.commands").COMMANDS.values():
        for _one in _command.parts or (_command,):
            import_module(f"pcpc.tools.{_one.module}")
    for _name in _LATER:
        with suppress(ModuleNotFoundError):  # a room that was taken out
            import_module(_name)
    say_no_compiling()
    _rig = import_module("pcpc.executive.rig.reading").load_rig(_RIG, None, ("duration_s=0.001",))
    import_module("pcpc.executive.nodes.virtual").in_memory(_rig)
    gc.collect()
    gc.freeze()
    with socket.socket(fileno=int(sys.argv[1])) as _listening, socket.socket(fileno=0) as _tests:
        (_cwd, _environment, *_words), _files = _serve(_listening, _tests)
        _listening.detach()
        _tests.detach()
    _become(_cwd, _environment, _words, _files)
    try:
        runpy.run_path(sys.argv[0], run_name="__main__")
    except SystemExit as _end:
        if not isinstance(_end.code, int):
            raise
        _leave(_end.code)

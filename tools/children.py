"""The processes of a run: started together, watched, ended in order."""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from typing import IO, Any

_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None)


class Child:
    """A Python module in a process of its own; its stderr is kept for `complaint`.

    `survives`: it lives on when the host dies, else it is asked to end.
    """

    def __init__(
        self, name: str, module: str, arguments: Sequence[str], *,
        interpreted: bool = False, survives: bool = False,
    ) -> None:  # fmt: skip
        self.name = name
        host = os.getpid()

        def end_with_host() -> None:
            _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
            if os.getppid() != host:  # it died before the request stood
                os._exit(1)

        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        if interpreted:
            environment["PCPC_LOOP"] = "interpreted"
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the child
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, *arguments],  # -P: the user's folder has no say
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._stderr,
            env=environment, preexec_fn=None if survives else end_with_host,
            start_new_session=True,  # Ctrl-C is for the host, which ends them in order
        )  # fmt: skip

    @property
    def ended(self) -> bool:
        """True once the process is gone."""
        return self.process.poll() is not None

    @property
    def code(self) -> int:
        """The exit code; negative is a signal's number; only once `ended`."""
        return self.process.returncode

    def complaint(self) -> list[str]:
        """Return the lines that the child wrote to stderr so far."""
        self._stderr.seek(0)
        return self._stderr.read().decode(errors="replace").splitlines()

    def end(self, patience_s: float, ask_s: float = 5.0) -> None:
        """Wait, then ask with SIGTERM, then after `ask_s` kill."""
        for ask, wait_s in ((None, patience_s), (signal.SIGTERM, ask_s), (signal.SIGKILL, 5.0)):
            if ask is not None and not self.ended:
                self.process.send_signal(ask)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(wait_s)
                return

    def ask(self) -> None:
        """Ask the child to end, without waiting."""
        if not self.ended:
            self.process.send_signal(signal.SIGTERM)


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

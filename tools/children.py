"""The processes of a run: started together, watched, ended in order."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from typing import IO


class Child:
    """A Python module in a process of its own; its stderr is kept for `complaint`."""

    def __init__(
        self, name: str, module: str, arguments: Sequence[str], interpreted: bool = False
    ) -> None:
        self.name = name
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        if interpreted:
            environment["PCPC_LOOP"] = "interpreted"
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  lives as long as the child
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._stderr,
            env=environment,
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

    def end(self, patience_s: float) -> None:
        """Wait, then ask with SIGTERM, then kill."""
        for ask, wait_s in ((None, patience_s), (signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0)):
            if ask is not None and not self.ended:
                self.process.send_signal(ask)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(wait_s)
                return

    def ask(self) -> None:
        """Ask the child to end, without waiting."""
        if not self.ended:
            self.process.send_signal(signal.SIGTERM)

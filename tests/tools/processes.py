"""The `pcpc` command as a user starts it, in real processes, each test on a bus of its own."""

import json
import os
import re
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from copies import PROGRAMS, Copy, copies, end_with_the_tests
from free_bus import GROUP, own_port
from places import PATIENCE_S

from pcpc.drivers.machine import claim
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing

ROOT = Path(__file__).resolve().parents[2]
ATB1000 = ROOT / "plants" / "atb1000"
RIGS = ATB1000 / "rigs"
PCPC = PROGRAMS["pcpc"]
DEADLINE_S = PATIENCE_S
PATIENT = (  # for paced runs that are not about missing frames: a loaded machine stalls
    "--set", "supervisor.hold_cycles=100000", "--set", "supervisor.fault_after_cycles=100000",
)  # fmt: skip
_ROLES = ("executive", "local", "plant", "recorder")
_NODE = "pcpc.executive.nodes.process"


def own_bus() -> str:
    """Return a bus that no other test and no other test process uses."""
    return f"udp_multicast:{GROUP}:{own_port()}"


def until(met: Callable[[], Any], what: str, within_s: float = DEADLINE_S) -> Any:
    """Return the first true result of `met`; AssertionError with `what` after `within_s`."""
    end = time.monotonic() + within_s
    while not (result := met()):
        assert time.monotonic() < end, f"not within {within_s:g} s: {what}"
        time.sleep(0.03)
    return result


def alive(pid: int) -> bool:
    """Return whether a process runs; one that only waits to be reaped does not.

    While one of its threads ends, a process that was killed still holds its sockets.
    """
    try:
        threads = list(Path(f"/proc/{pid}/task").iterdir())
        states = [(t / "stat").read_text().rpartition(")")[2].split()[0] for t in threads]
        return any(state not in "ZX" for state in states)
    except OSError:
        return Path(f"/proc/{pid}/task").exists()  # one ended just now: look again


def blocks_left(bus: str) -> list[str]:
    """Return what is left of the nodes on a bus: claims, and files in /dev/shm."""
    mine = sh.block_name("", bus, "")[1:-1]
    files = [path.name for path in Path("/dev/shm").iterdir() if "pcpc" in path.name]
    claims = [*claim.held_names("lock/"), *claim.held_names("node/")]
    return [name for name in (*files, *claims) if mine in name]


@dataclass(frozen=True)
class Done:
    """What came of a command."""

    words: Sequence[str]
    code: int
    out: str
    err: str

    def __str__(self) -> str:
        return f"{' '.join(self.words)}\nexit code {self.code}\n{self.out}\n{self.err}"

    @property
    def ran(self) -> bool:
        """Whether nothing speaks against the run; it may be too short for the rig's limits."""
        unjudged = re.search(r'verdict(": "|  )not judged', self.out)
        return self.code == (1 if unjudged else 0)

    @property
    def summary(self) -> dict[str, Any]:
        """The summary that --json printed."""
        try:
            return dict(json.loads(self.out))
        except ValueError:
            raise AssertionError(f"no summary came:\n{self}") from None


class Running:
    """A started command; `before` are words in front of it, such as setpriv's.

    It is a copy, see `copies`, where no words stand in front of it.
    """

    def __init__(
        self,
        *words: str,
        cwd: Path = ROOT,
        environment: Mapping[str, str] | None = None,
        before: Sequence[str] = (),
    ) -> None:
        self.words = [*before, PCPC, *words]
        self._out: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  as long as the command
        self._err: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115
        self.process: subprocess.Popen[bytes] | Copy
        files = [os.open(os.devnull, os.O_RDONLY), self._out.fileno(), self._err.fileno()]
        surroundings = os.environ | dict(environment or {})
        if before:
            self.process = subprocess.Popen(
                self.words,
                stdin=files[0],
                stdout=files[1],
                stderr=files[2],
                cwd=cwd,
                env=surroundings,
                start_new_session=True,
                preexec_fn=end_with_the_tests,
            )
        else:
            self.process = Copy(copies().address, self.words, cwd, surroundings, files)
        os.close(files[0])
        self.children: dict[str, int] = {}

    def __enter__(self) -> "Running":
        return self

    def __exit__(self, *_: object) -> None:
        """Leave nothing behind, whatever the test found."""
        self.look()
        for pid in (self.process.pid, *self.children.values()):
            if alive(pid):
                os.kill(pid, signal.SIGKILL)
        self.process.wait(DEADLINE_S)

    def look(self) -> dict[str, int]:
        """Return role -> pid of the processes that the command has started so far."""
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
                words = (folder / "cmdline").read_bytes().decode().split("\0")
                name = (folder / "comm").read_text().strip()
            except OSError:
                continue
            if int(parent) == self.process.pid:
                role = name.removeprefix("pcpc ")
                if _NODE in words:
                    role = words[words.index(_NODE) + 1]
                if role in _ROLES:
                    self.children[role] = int(folder.name)
        return self.children

    def pid(self, role: str) -> int:
        """Wait for a child and return its pid."""
        known = self.children.get
        until(lambda: known(role) or self.look().get(role) or self.over(), f"{role}\n{self}")
        return self.children[role]

    def over(self) -> bool:
        """Return False while the command runs; AssertionError with its words when it has ended."""
        assert self.process.poll() is None, f"ended too early:\n{self}"
        return False

    def block(self, rig: str, bus: str, role: str) -> sh.NodeMemory:
        """Wait for the shared block of one of the command's nodes."""
        pid, name = self.pid(role), sh.block_name(rig, bus, role)

        def attached() -> sh.NodeMemory | None:
            self.over()
            with suppress(sh.SharedError):
                block = sharing.attach(name)
                return block if int(block.control.pid) == pid else None
            return None

        return until(attached, f"the block of {role} {pid}\n{self}")

    def in_the_middle(self, rig: str, bus: str) -> sh.NodeMemory:
        """Wait until all run and a part of the executive's records is in the recorder's hands."""
        for role in ("executive", "plant", "recorder"):
            self.pid(role)
        block = self.block(rig, bus, "executive")
        until(lambda: block["record_taken"][0] > 100 or self.over(), f"records go\n{self}")
        return block

    def done(self, within_s: float = DEADLINE_S) -> Done:
        """Wait for the end and return what came."""
        until(lambda: self.process.poll() is not None, f"it ends\n{self}", within_s)
        return Done(
            self.words, self.process.returncode, self._text(self._out), self._text(self._err)
        )

    def left(self, within_s: float = 10.0) -> list[str]:
        """Wait for the end of all processes; return which of them live on."""
        pids = {"host": self.process.pid} | self.children
        end = time.monotonic() + within_s
        while any(map(alive, pids.values())) and time.monotonic() < end:
            time.sleep(0.01)
        return [role for role, pid in pids.items() if alive(pid)]

    def __str__(self) -> str:
        out, err = self._text(self._out), self._text(self._err)
        return f"{' '.join(self.words)}\n{out}\n{err}"

    @staticmethod
    def _text(file: Any) -> str:
        return os.pread(file.fileno(), 1 << 20, 0).decode(errors="replace")


def pcpc(
    *words: str,
    cwd: Path = ROOT,
    environment: Mapping[str, str] | None = None,
    before: Sequence[str] = (),
) -> Done:
    """Run a command to its end."""
    with Running(*words, cwd=cwd, environment=environment, before=before) as running:
        return running.done()

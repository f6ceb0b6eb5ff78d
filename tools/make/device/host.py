"""The processes of a run with a device: the emulator, the recorder, and the device's command.

The device's command is started once the emulator listens, has a session of its own, and is ended
with the run: it hears of the end by the plant's last heartbeat and has a second to go, then it is
asked (SIGTERM), then killed. That it ended before the plant did is a fault, unless it had told the
end by its own last frames.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import dbc, e2e_states
from pcpc.drivers.errors import UserError
from pcpc.executive.log import recorder
from pcpc.executive.log.reader import FD_FRAME, FRAME
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.nodes.rings import rows_of
from pcpc.executive.rig.messages import database_of
from pcpc.executive.rig.reading import Rig
from pcpc.tools.make.device import witness
from pcpc.tools.make.device.commands import InPlace
from pcpc.tools.run.commands import RunRequest
from pcpc.tools.run.run import Host
from pcpc.tools.start.children import Child, end_with
from pcpc.tools.start.folder import LOG
from pcpc.tools.start.peer_wait import PeerWait

_LEAVE_S, _ASKED_S = 1.0, 2.0
_SHOWN_LINES = 20  # of what a device that failed wrote
OUTPUT = "device.txt"  # in the run's folder: what it wrote


def check(rig: Rig, pacing: str | None) -> None:
    """Raise RigError for a rig in which no device can be the executive in this pacing."""
    for name, fault in rig.config.faults.items() if pacing == "lockstep" else ():
        if fault.kind == "stall":
            what = "a device does not know of a stall, and waits for the plant without a clock"
            raise rig.error(f"faults.{name}.kind", f"{what}; choose --pacing real")
    if path := next(_at_the_device(rig), ""):
        raise rig.error(path, "it acts in the executive, which is a device here; take it out")
    if rig.config.bus.emulate is not None:
        what = "a device is on no emulated line; --set bus.emulate=null"
        raise rig.error("bus.emulate", what)


def _at_the_device(rig: Rig) -> Iterator[str]:
    """Yield the keys of faults and losses on purpose that act in the executive."""
    config = rig.config
    heard = {one.name for one in dbc.frames(database_of(rig), config.executive.node, "rx")}
    for name, fault in config.faults.items():
        place, colon, _ = (fault.at or "").partition(":")
        node = fault.node or (place if colon else "executive")
        if node == "executive" and (fault.frame is None or fault.frame in heard):
            yield f"faults.{name}"
    for name, loss in config.losses.items():
        if loss.share > 0.0 and name in heard:
            yield f"losses.{name}"


class DeviceProcess:
    """The device's command, once it runs; nothing where it is started elsewhere."""

    def __init__(self, words: Sequence[str], bus: str, output: Path) -> None:
        self.words = [word.replace("{bus}", bus) for word in words]
        self.process: subprocess.Popen[bytes] | None = None
        self.output = output
        self.asked = False  # to end, by this process

    def start(self) -> None:
        """Start it; UserError if that cannot be."""
        host = os.getpid()
        try:
            with self.output.open("wb") as output:
                self.process = subprocess.Popen(
                    self.words,
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    preexec_fn=lambda: end_with(host),
                    start_new_session=True,
                )
        except OSError as error:
            raise UserError(f"--device {self.words[0]}: {error.strerror}") from None

    @property
    def ended(self) -> bool:
        """Whether it was started and is gone."""
        return self.process is not None and self.process.poll() is not None

    def end(self) -> None:
        """Let it go by itself, then ask it and all that it started, then kill them."""
        if self.process is None:
            return
        for number, wait_s in ((0, _LEAVE_S), (signal.SIGTERM, _ASKED_S), (signal.SIGKILL, 5.0)):
            if number and not self.ended:
                self.asked = True
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(self.process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(wait_s)
                break
        with contextlib.suppress(ProcessLookupError):  # what it started and left behind
            os.killpg(self.process.pid, signal.SIGKILL)

    def complaint(self) -> str:
        """Return how it ended if that was no good end; "" else."""
        if self.process is None or self.asked or not self.process.returncode:
            return ""
        code = self.process.returncode
        return f"ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"

    def said(self) -> list[str]:
        """Return the last lines that it wrote."""
        return self.output.read_text(errors="replace").splitlines()[-_SHOWN_LINES:]

    def tidy(self) -> None:
        """Remove the file of what it wrote, if that was nothing."""
        with contextlib.suppress(OSError):
            if not self.output.stat().st_size:
                self.output.unlink()


class _WaitingForDevice(PeerWait):
    """As `PeerWait`, and over once the device's command is.

    What is heard is noted while it comes: a device that sends fast fills the ring within seconds.
    """

    device: DeviceProcess

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._heard: dict[str, set[str]] = {}
        self._looked_at = 0  # rows of the ring

    @property
    def heard(self) -> str:
        """Which frames of the device the plant has heard, and what was wrong with them."""
        names = [frame.name for frame in _frames(self.rig) if frame.name in self._heard]
        wrong = {name: f" ({', '.join(sorted(self._heard[name]))})" for name in names}
        return ", ".join(name + wrong[name] * bool(self._heard[name]) for name in names)

    def too_long(self, blocks: Any, under_way: bool) -> bool:
        """Return whether the node has waited for too long, or waits for nobody any more."""
        if self.device.process is None and self.device.words:
            if all(role in blocks and blocks[role].control.ready for role in self.rig.config.below):
                self.device.start()
            return False
        if self.device.ended:
            return True
        lead = self.rig.config.below[0]
        if lead in blocks and not under_way:
            rows, first = rows_of(blocks[lead], "frame", self._looked_at)
            self._looked_at = first + len(rows)
            for name, wrong in heard_frames(self.rig, rows):
                self._heard.setdefault(name, set()).update(wrong)
        return super().too_long(blocks, under_way)

    def message(self, leader: str, bus: str, rig_file: str) -> str:
        """Return what to say once it was too long: what came, and what did not."""
        kept = "no cycle was done, so no run is kept; docs/device.md"
        missing = ", ".join(frame.name for frame in _frames(self.rig) if frame.has_sequence)
        if self.heard:
            what = f"{self.heard} came from the device, but no valid {missing}, which begins"
            return f"{leader}: on {bus} {what} the first cycle, for {self.given_up_s:.0f} s; {kept}"
        cure = "start the device on this bus, or raise supervisor.peer_timeout_s"
        what = f"no frame of a device on {bus} for {self.given_up_s:.0f} s; {cure}"
        return f"{leader}: {what}; {kept}"


def _frames(rig: Rig) -> tuple[dbc.Frame, ...]:
    """Return the frames that the device sends."""
    return dbc.frames(database_of(rig), rig.config.executive.node, "tx")


def heard_frames(rig: Rig, rows: NDArray[np.int64]) -> Iterator[tuple[str, list[str]]]:
    """Yield which frames of the device stand in rows of a ring, and what was wrong with them.

    `rows`: (n, columns of the ring).
    """
    payload = np.ascontiguousarray(rows[:, 1:]).view(np.uint8)
    frames = payload.view(FRAME if payload.shape[1] == FRAME.itemsize else FD_FRAME)[:, 0]
    for frame in _frames(rig):
        came = frames[(frames["id"] == frame.word) & (frames["direction"] == 1)]
        if len(came):
            states = [int(state) for state in np.unique(came["e2e"]) if state > 1]
            yield frame.name, [e2e_states.name_of(state) for state in states]


class DeviceHost(Host):
    """One run of all nodes but the executive with a device, from start to what the log holds."""

    def __init__(self, request: RunRequest, rig: Rig, folder: Path) -> None:
        self.command = [*(request.in_place.of(InPlace).device or ())]
        for program in self.command[:1]:
            if shutil.which(program) is None:
                raise UserError(f"--device {program}: no such program, or it is not executable")
        below = tuple(role for role in rig.roles if role != "executive")
        super().__init__(request, rig, below, folder)
        self.device = DeviceProcess(self.command, str(self.bus), folder / OUTPUT)
        self.waiting = self.of_device = _WaitingForDevice(rig, below)
        self.of_device.device = self.device
        self.counts: witness.Counts = {}

    def run(self) -> int:
        """Run all to the end, as `Host.run`; whatever happens, the device and its witness end."""
        by_clock = self.pacing == "real" and self.bus.compiled
        ear = witness.start_witness(self.rig, self.bus, self.folder) if by_clock else None
        try:
            code = super().run()
        finally:
            if ear is not None:
                ear.end(0.0)
                self.counts = witness.read_counts(self.folder)
            self.device.end()
            self.device.tidy()
        if code < 0:
            self._judge_end()
        return code

    def _words(self, role: Any) -> list[str]:
        words = [word for word in super()._words(role) if word != "--alone"]
        return [*words, *["--device"] * (role in self.rig.config.below)]

    def _greet(self) -> None:
        super()._greet()
        if not self.device.words:
            self.progress.say(f"waiting for a device on {self.bus}")

    def _start_recorder(self) -> None:
        if "recorder" in self.children or not set(self.roles) <= set(self.nodes):
            return
        names = [self._block_name(role) for role in self.roles]
        words = [str(self.folder / LOG), *names, "--judged", json.dumps({})]
        self.children["recorder"] = Child.fork("recorder", recorder.main, words, survives=True)

    def _recorder_may_come(self) -> bool:
        return "recorder" in self.children and not self.children["recorder"].ended

    def _state(self) -> str:
        if self.leader in self.nodes and self.nodes[self.leader].ready and not self._under_way():
            waited = 1e-9 * (time.monotonic_ns() - self.begin_ns)
            heard = self.of_device.heard
            came = f", which sent {heard} so far" if heard else ""
            return f"waiting for the device on {self.bus}{came}, {waited:.0f} s"
        return super()._state()

    def _judge_end(self) -> None:
        """Note how far the plant came, and what became of the device's command."""
        block, outcome, wanted = self.blocks.get(self.leader), self.outcome, cycles_of(self.rig)
        outcome.begin_ns = None
        done = 0
        if block is not None:
            control = block.control
            done = min(int(control.cycle) + 1, wanted) if control.passes else 0
            outcome.cycles, outcome.realtime = done, bool(control.realtime)
            if done < wanted and int(control.passes + control.skipped) < wanted:
                outcome.short = f"{done:,} of {wanted:,} cycles: the run ended before"
        if complaint := self.device.complaint():
            cause = 0 if self.children[self.leader].code >= 0 else len(outcome.faults)
            outcome.faults.insert(cause, f"device: {complaint} after {done:,} of {wanted:,} cycles")
            for line in self.device.said() if self.device.output.exists() else ():
                self.progress.say(f"device: {line}")

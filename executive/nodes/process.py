"""One real-time process: executive, plant emulator or local node, of the same program.

The compiled loop runs in a worker thread without the GIL. The main thread waits for signals, hands
the node's memory to clients and looks whether the loop stands in a step; nothing else runs in this
process. Ends by itself after the rig's duration, on SIGTERM or SIGINT, or on a fault; after its end
the node can be read for as long as its host wants, or some seconds if nobody has come yet: a run
may last a millisecond.

    executive.nodes.process ROLE RIG [--pacing P] [--bus B] [--controller C] [--set NAME=VALUE]...
"""

import signal

# numpy starts threads of its own: the mask must stand before its import, or a signal could hit one
# of them. Whoever only imports this module keeps its signals.
if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})

import argparse
import ctypes
import os
import select
import socket
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import choice
from pcpc.drivers.compiled.jit import LOOP_INTERPRETED
from pcpc.drivers.errors import BusError, Exit, UserError
from pcpc.drivers.machine import claim, kernel, realtime
from pcpc.executive.laws.emath_selftest import selftest
from pcpc.executive.log.provenance import facts, of_rig
from pcpc.executive.loop import faults, sharing
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Trigger
from pcpc.executive.loop.cycle import STEPS, N, finish
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.running import run
from pcpc.executive.nodes import greeting, planned_drive, without_effect
from pcpc.executive.nodes.install import install, install_in_memory
from pcpc.executive.nodes.plan import (
    Plan,
    check_pacing,
    close,
    cycles_of,
    describe,
    failures,
    plan,
)
from pcpc.executive.nodes.watched import POLL_S, StepError, Watch, Work, loop_error
from pcpc.executive.own_laws import carried_files
from pcpc.executive.rig.bus_load import check_rate
from pcpc.executive.rig.buses import check_line, second_bus, side_of, wanted_bus
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import PLANTS, ROLES, Role

MODULE = "pcpc.executive.nodes.process"
_PR_SET_PDEATHSIG = 1
_WARM_UP_CYCLES = 3
_LINGER_S = 5.0  # for a host or a recorder that has not come yet
_SIGNALS = {signal.SIGINT, signal.SIGTERM}  # taken when the process looks for them
_SIGNAL_BYTES = 128  # struct signalfd_siginfo


def main(argv: Sequence[str]) -> int:
    """Run one node in this process, of its own; print errors; return the exit code."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored ones never come
    signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    options = _arguments().parse_args(argv)
    if options.with_parent:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    try:
        return Process(options).run()
    except UserError as error:
        who = f"{options.role}: " if isinstance(error, StepError) else ""
        print(f"{who}{error}", file=sys.stderr)
        return error.code


def _arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("pcpc.executive.nodes.process")
    parser.add_argument("role", choices=ROLES)
    parser.add_argument("rig")
    parser.add_argument("--pacing", choices=("real", "sync", "lockstep"))
    parser.add_argument("--bus")
    parser.add_argument("--controller")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--device", action="store_true", help="a device is the executive")
    parser.add_argument("--alone", action="store_true", help="others are started elsewhere")
    parser.add_argument("--with-parent", type=int, metavar="PID", help="end when this one dies")
    return parser


class Process:
    """A node between its set-up and its end."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.role: Role = options.role
        self.host: int | None = options.with_parent
        self.device: bool = options.device
        self.alone: bool = options.alone
        self.rig: Rig = load_rig(options.rig, options.controller, options.set)
        self.pacing: str = options.pacing or self.rig.config.pacing
        self._paced = self.pacing != "lockstep"
        check_pacing(self.rig, self.pacing)
        check_rate(self.rig, self.pacing)
        check_line(self.rig, self.pacing)
        self.choice = choice.take_bus(wanted_bus(self.rig, (self.role,), options.bus))
        self.bus = self.choice.bus
        self.plan: Plan = plan(self.rig, self.role, self.pacing)
        without_effect.check(self.plan)
        self.report = realtime.Report(())

    def run(self) -> int:
        """Set up, warm up, run the loop in its thread, wait; return the exit code.

        BusError: the bus is not usable.
        """
        name = sh.block_name(self.rig.config.rig, str(self.bus), self.role)
        node_lock = sharing.lock(name)
        self.choice.claims += claim_frames(self.rig, self.plan, self.bus)
        metadata = (
            facts()
            | of_rig(self.rig.path)
            | {
                "pacing": self.pacing,
                "bus": str(self.bus),
                "controller": self.rig.config.controller,
                "seed": str(self.rig.config.seed),
                "rate_hz": repr(self.rig.config.rate_hz),
            }
        )
        self.signals = kernel.signal_file(_SIGNALS)
        head = describe(self.plan, metadata)
        head["initial"], head["file"] = self._parameters(), str(self.rig.path.resolve())
        if lacking := carried_files.missing_warning(head["files"]):
            print(f"{self.role}: {lacking}", file=sys.stderr, flush=True)
        served = sharing.ServedMemory(name, head)
        block = served.block
        open_buses(self.rig, self.bus, self.plan, block.loop.wire)
        opened_ns = time.monotonic_ns()  # from here on it hears the others
        install(self.plan, block.loop)
        if self.alone:
            greeting.install(block.loop, self.rig, self.role)
        if self.device:  # which may know nothing of the duration; its last word is one cycle more
            block.loop.guard.cycles = cycles_of(self.rig) + 2
        scratch = warm_up_memory(self.plan)
        self._watch(lambda: run(scratch, self.plan.steps), scratch)
        self.report = realtime.prepare_process(self._paced)
        wall_ns, clock_ns = (int(metadata[f"clock_{name}_ns"]) for name in ("wall", "monotonic"))
        block.loop.clock.wall_offset_ns = wall_ns - clock_ns
        block.control.pid = os.getpid()
        block["snapshot"][:] = block.loop.v[: len(block["snapshot"])]  # until the first cycle
        served.open()
        try:
            self._watch(lambda: self._loop(block, opened_ns), block.loop, served)
        except StepError as error:
            print(f"{self.role}: {error}", file=sys.stderr, flush=True)
            finish(block.loop)
        for line in failures(self.plan):
            print(f"{self.role}: {line}", file=sys.stderr, flush=True)
        close(self.plan)
        fault, passes = block.control.fault, block.control.passes
        refused = fault == Fault.ANOTHER_SENDER and not passes
        if not refused:
            self._linger(served)
        served.close()
        node_lock.close()
        if refused:
            why = faults.reason(block.description, block.control)
            raise BusError(f"{self.bus}: {why}; end it or choose another with --bus")
        return Exit.SAFETY_STOP if block.control.fault else Exit.OK

    def _watch(
        self, call: Callable[[], Any], loop: Loop, served: sharing.ServedMemory | None = None
    ) -> None:
        """Let `call` step `loop` to its end, in a thread; hear signals, serve clients. StepError.

        Without `served` it is the warm-up.
        """
        loop_end, end = socket.socketpair()
        work, watch = Work(call, end.close), Watch([loop])
        work.start()
        look_s = time.monotonic() + POLL_S
        with loop_end:
            while not self._waits_for(served, loop_end, look_s):
                if self._asked_to_end():
                    if served is None:
                        os._exit(Exit.OK)
                    loop.control.stop = 1
                if time.monotonic() >= look_s:
                    look_s = time.monotonic() + POLL_S
                    if watch.stands() is not None:
                        self._hangs(loop, served)
        work.join()
        if work.error is not None:
            raise loop_error(work.error, [loop]) from work.error

    def _hangs(self, loop: Loop, served: sharing.ServedMemory | None) -> NoReturn:
        """End the process, whose loop stands in a step; its host reads the fault in the block."""
        loop.control.fault = Fault.STEP_HANGS
        if served is None:
            name = self.plan.spec.blocks[int(loop.control.stepping) - 1].name
            what = f"the step of {name} does not return, in cycle {int(loop.k)} of the warm-up"
            print(f"{self.role}: {what}", file=sys.stderr, flush=True)
        else:
            self._linger(served, for_host=False)
        os._exit(Exit.SAFETY_STOP)

    def _waits_for(
        self, served: sharing.ServedMemory | None, loop_end: socket.socket, until_s: float
    ) -> bool:
        """Serve clients until a signal, `until_s` or the loop's end; return whether that came."""
        while True:
            waited: list[Any] = [loop_end, self.signals, *(served.sockets() if served else [])]
            left_s = max(until_s - time.monotonic(), 0.0)
            ready, _, _ = select.select(waited, [], [], left_s)
            if served:
                served.serve()
            if not ready or loop_end in ready or self.signals in ready:
                return loop_end in ready

    def _linger(self, served: sharing.ServedMemory, for_host: bool = True) -> None:
        """Serve clients of a node that has ended, while its host is there or may come.

        Without `for_host` only until they have it.
        """
        end_s = time.monotonic() + _LINGER_S
        while (has_host := for_host and served.has_host()) or not self._was_taken(served):
            left_s = end_s - time.monotonic()
            if left_s <= 0.0 and not has_host:
                return
            waited: list[Any] = [self.signals, *served.sockets()]
            select.select(waited, [], [], None if has_host else left_s)
            served.serve()
            if self._asked_to_end() and not (for_host and served.has_host()):
                return

    def _was_taken(self, served: sharing.ServedMemory) -> bool:
        """Return whether whoever needs this node has it: a recorder, its host, or both."""
        if sharing.LEAVE in served.told:
            return True
        wanted = {sharing.RECORDER} if self.host is None else {sharing.RECORDER, sharing.HOST}
        return wanted <= served.told

    def _asked_to_end(self) -> bool:
        """Take the signals that have come; return whether there was one."""
        try:
            return bool(os.read(self.signals, 8 * _SIGNAL_BYTES))
        except BlockingIOError:
            return False

    def _parameters(self) -> dict[str, float]:
        """Return what the rig gives for its parameters, by name."""
        table, given = self.plan.table, self.plan.values
        found = [i for i in sorted(given) if table.variables[i].kind == "parameter"]
        return {table.variables[i].name: given[i] for i in found}

    def _loop(self, block: sh.NodeMemory, opened_ns: int) -> None:
        """Do the real-time settings, the self-test, then the compiled loop.

        `opened_ns`: since when the bus is heard.
        """
        settings = self.rig.config.realtime.of_node(self.role)
        if self._paced:  # a loop that never waits for time would take the whole machine
            self.report += realtime.prepare_thread(settings.priority, settings.cpu)
        selftest()
        warning = self.report.warning()
        if warning and self._paced:
            print(f"{self.role}: {warning}", file=sys.stderr, flush=True)
        block.control.realtime = self.report.is_realtime
        block.control.ready = 1
        heard_ns = time.monotonic_ns() - opened_ns
        block.loop.rx.listen_ns = max(block.loop.rx.listen_ns - heard_ns, 1)
        run(block.loop, self.plan.steps)


def claim_frames(rig: Rig, made: Plan, bus: buses.BusAddress) -> list[socket.socket]:
    """Claim the frames that a node of `rig` sends; BusError if one of them has a sender here.

    Whoever claims none is noticed by his frames, see `executive.loop.strangers`.
    """
    below, claims = second_bus(rig, bus, made.role), []
    bus = side_of(rig, bus, made.role) if made.role == "local" else bus
    for frame in made.tx_frames:
        lower = below is not None and (made.role in PLANTS or frame.name in made.below)
        own_bus = below if lower else bus
        name = f"frame/{own_bus}/{frame.word:08X}"
        claimed = claim.hold(name)
        if claimed is None:
            holder = claim.holder(name)
            who = f", process {holder.pid}" if holder and holder.pid else ""
            what = faults.frame_text(frame.word, frame.name)
            raise BusError(
                f"{own_bus}: another sender of {what} is on this bus{who}; "
                "end it or choose another with --bus"
            )
        claims.append(claimed)
    return claims


def open_buses(rig: Rig, bus: buses.BusAddress, made: Plan, end: Any) -> None:
    """Open the bus of a node of `rig`, or both, into the Wire `end`; BusError.

    `bus` is the executive's. A node also listens to its own ids: nobody else may send them;
    a drive to all, since a master may choose the ids of its PDOs.
    """
    end.fd = made.fd
    below = second_bus(rig, bus, made.role)
    bus = side_of(rig, bus, made.role) if made.role == "local" else bus
    own_bus = below if made.role in PLANTS and below is not None else bus
    ids = made.receive_ids + made.send_ids
    is_drive = planned_drive.drive_of(rig, made.role) is not None
    end.remotes = is_drive
    buses.open_bus(own_bus, None if is_drive else ids, end)
    if made.below and below is not None:
        buses.open_second(below, made.receive_ids_below + made.send_ids_below, end)
    buses.set_own_address(end)


def warm_up_memory(made: Plan) -> Any:
    """Return scratch memory for a few cycles, so that the loop is compiled and touched."""
    scratch = np.recarray(1, sh.LOOP)
    scratch.view(np.uint8)[:] = 0
    loop: Loop = scratch[0]
    install_in_memory(made, loop)
    loop.clock.trigger, loop.clock.arm_pass = Trigger.CLOCKED, -1  # every deadline is over already
    loop.meeting.seeks_below = 0  # it waits for nobody
    loop.guard.cycles = _WARM_UP_CYCLES
    return loop


def load_code() -> None:
    """Put the loop into memory, if it is to be compiled: for copies of this process."""
    if not LOOP_INTERPRETED:
        run.compile((N, STEPS))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

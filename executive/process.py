"""One real-time process: the executive or, started by `plants.emulator`, the emulator.

The compiled loop runs in a worker thread without the GIL. The main thread waits for signals and
hands the node's memory to clients; nothing else runs in this process. Ends by itself after the
rig's duration, on SIGTERM or SIGINT, or on a fault; after its end the node can be read for as long
as its host wants, or some seconds if nobody has come yet: a run may last a millisecond.

    executive.process ROLE RIG [--pacing P] [--bus B] [--controller C] [--set NAME=VALUE]...

exit code: 0 ok; 2 rig file; 4 environment; 5 fault
"""

import signal

# numpy starts threads of its own: the mask must stand before its import, or a signal could hit one
# of them. Whoever only imports this module keeps its signals.
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored ones never come
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})

import argparse
import ctypes
import os
import select
import socket
import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from drivers import bus as buses
from drivers import choice, claim, kernel, realtime, wire
from drivers.errors import BusError, DbcError
from drivers.wire_layout import MEMORY
from executive import carried, faults, plausible, sharing
from executive import shared as sh
from executive.cycle import run
from executive.emath_selftest import selftest
from executive.errors import RigError
from executive.facts import facts
from executive.install import install
from executive.node import Plan, check_pacing, check_rate, describe, plan
from executive.rig import Rig, load_rig
from executive.rig_bus import bus_wanted
from executive.roles import ROLES, Role
from executive.supervisor import ANOTHER_SENDER

OK, BAD_RIG, NO_ENVIRONMENT, SAFETY_STOP = 0, 2, 4, 5
_PR_SET_PDEATHSIG = 1
_WARM_UP_CYCLES = 3
_LINGER_S = 5.0  # for a host or a recorder that has not come yet
_SIGNALS = {signal.SIGINT, signal.SIGTERM}
_SIGNAL_BYTES = 128  # struct signalfd_siginfo


def main(argv: Sequence[str]) -> int:
    """Run one node; print errors; return the exit code."""
    options = _arguments().parse_args(argv)
    if options.with_parent:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    try:
        return Process(options).run()
    except RigError as error:
        print(error, file=sys.stderr)
        return BAD_RIG
    except (BusError, sh.SharedError) as error:
        print(error, file=sys.stderr)
        return BAD_RIG if isinstance(error, DbcError) else NO_ENVIRONMENT


def _arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("executive.process")
    parser.add_argument("role", choices=ROLES)
    parser.add_argument("rig")
    parser.add_argument("--pacing", choices=("real", "sync", "lockstep"))
    parser.add_argument("--bus")
    parser.add_argument("--controller")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--with-parent", type=int, metavar="PID", help="end when this one dies")
    return parser


class Process:
    """A node between its set-up and its end."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.role: Role = options.role
        self.host: int | None = options.with_parent
        self.rig: Rig = load_rig(options.rig, options.controller, options.set)
        self.pacing: str = options.pacing or self.rig.config.pacing
        check_pacing(self.rig, self.pacing)
        check_rate(self.rig, self.pacing)
        self.choice = choice.take(bus_wanted(self.rig, (self.role,), options.bus))
        self.bus = self.choice.bus
        self.plan: Plan = plan(self.rig, self.role, self.pacing)
        plausible.check(self.plan)
        self.report = realtime.Report(())

    def run(self) -> int:
        """Set up, warm up, run the loop in its thread, wait; return the exit code."""
        name = sh.block_name(self.rig.config.rig, str(self.bus), self.role)
        held = sharing.lock(name)
        self.claim_frames()
        metadata = facts() | {
            "pacing": self.pacing,
            "bus": str(self.bus),
            "controller": self.rig.config.controller,
            "seed": str(self.rig.config.seed),
            "rate_hz": repr(self.rig.config.rate_hz),
        }
        warm_up(self.plan)
        self.report = realtime.prepare_process()
        about = describe(self.plan, metadata)
        if lacking := carried.warning(about["files"]):
            print(f"{self.role}: {lacking}", file=sys.stderr, flush=True)
        served = sharing.Served(name, about)
        block = served.block
        open_buses(self.rig, self.bus, self.plan, block.loop.wire)
        install(self.plan, block.loop)
        wall_ns, clock_ns = (int(metadata[f"clock_{name}_ns"]) for name in ("wall", "monotonic"))
        block.loop.wall_offset_ns = wall_ns - clock_ns
        block["control"][sh.PID] = os.getpid()
        block["snapshot"][:] = block.loop.v[: len(block["snapshot"])]  # until the first cycle
        served.open()
        self.signals = kernel.signal_file(_SIGNALS)
        over, self.end = socket.socketpair()
        loop = threading.Thread(target=self._loop, args=(block,))
        loop.start()
        while not self._waits_for(served, over):
            if self._asked_to_end():
                block["control"][sh.STOP] = 1
        loop.join()
        refused = block["control"][sh.FAULT] == ANOTHER_SENDER and not block["control"][sh.PASSES]
        if not refused:
            self._linger(served)
        served.close()
        held.close()
        if refused:
            why = faults.reason(block.description, block["control"])
            raise BusError(f"{self.bus}: {why}; end it or choose another with --bus")
        return SAFETY_STOP if block["control"][sh.FAULT] else OK

    def _waits_for(self, served: sharing.Served, over: socket.socket) -> bool:
        """Serve clients until a signal comes or the loop ends; return whether it has ended."""
        while True:
            waited: list[Any] = [over, self.signals, *served.sockets()]
            ready, _, _ = select.select(waited, [], [])
            served.serve()
            if over in ready or self.signals in ready:
                return over in ready

    def _linger(self, served: sharing.Served) -> None:
        """Serve clients of a node that has ended, while its host is there or may come."""
        end_s = time.monotonic() + _LINGER_S
        while served.has_host() or not self._was_taken(served):
            left_s = end_s - time.monotonic()
            if left_s <= 0.0 and not served.has_host():
                return
            timeout = None if served.has_host() else left_s
            waited: list[Any] = [self.signals, *served.sockets()]
            select.select(waited, [], [], timeout)
            served.serve()
            if self._asked_to_end() and not served.has_host():
                return

    def _was_taken(self, served: sharing.Served) -> bool:
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

    def claim_frames(self) -> None:
        """Claim the frames that this node sends; BusError if one of them has a sender here.

        Whoever claims none is noticed by his frames, see `executive.strangers`.
        """
        below = bus_below(self.rig, self.bus)
        for frame in self.plan.tx_frames:
            lower = below is not None and (self.role == "plant" or frame.name in self.plan.below)
            bus = below if lower else self.bus
            name = f"frame/{bus}/{frame.can_id | frame.extended << 31:08X}"
            held = claim.hold(name)
            if held is None:
                holder = claim.holder(name)
                who = f", process {holder.pid}" if holder and holder.pid else ""
                what = faults.frame_text(frame.can_id, frame.extended, frame.name)
                raise BusError(
                    f"{bus}: another sender of {what} is on this bus{who}; "
                    "end it or choose another with --bus"
                )
            self.choice.claims.append(held)

    def orphaned(self) -> bool:
        """Return whether the host that started this process, if it named itself, is dead."""
        return self.host is not None and os.getppid() != self.host

    def _loop(self, block: sh.Shared) -> None:
        """Be the loop's thread; its end is heard by the main thread."""
        try:
            self._run(block)
        finally:
            self.end.close()

    def _run(self, block: sh.Shared) -> None:
        """Do the real-time settings, the self-test, then the compiled loop."""
        settings = self.rig.config.realtime
        priority = {
            "executive": settings.priority, "local": settings.local_priority,
            "plant": settings.plant_priority,
        }[self.role]  # fmt: skip
        cpu = settings.plant_cpu if self.role == "plant" else settings.cpu
        self.report += realtime.prepare_thread(priority, cpu)
        selftest()
        warning = self.report.warning()
        if warning and self.pacing != "lockstep":
            print(f"{self.role}: {warning}", file=sys.stderr, flush=True)
        block["control"][sh.REALTIME] = self.report.is_realtime
        block["control"][sh.READY] = 1
        run(block.loop, self.plan.steps)


def open_buses(rig: Rig, bus: buses.Bus, made: Plan, end: Any) -> None:
    """Open the bus of a node of `rig`, or both of a local node, into the WIRE `end`; BusError.

    `bus` is the executive's. A node also listens to its own ids: nobody else may send them.
    """
    below = bus_below(rig, bus)
    own = below if made.role == "plant" and below is not None else bus
    buses.open_bus(own, made.receive_ids + made.send_ids, end)
    if made.role == "local" and below is not None:
        buses.open_second(below, made.receive_ids_below + made.send_ids_below, end)
    buses.know_own(end)


def bus_below(rig: Rig, bus: buses.Bus) -> buses.Bus | None:
    """Return the bus between local node and plant; None for a rig of two nodes."""
    local = rig.config.local
    if local is None:
        return None
    if local.bus is None:
        return buses.beside(bus)
    channel = None if local.bus.channel is None else str(local.bus.channel)
    return buses.choose(local.bus.interface, channel)


def warm_up(made: Plan) -> None:
    """Run a few cycles on scratch memory, so that the loop is compiled and touched."""
    scratch = np.recarray(1, sh.LOOP)
    scratch.view(np.uint8)[:] = 0
    loop: Any = scratch[0]
    wire.prepare(loop.wire, MEMORY, -1, -1)
    install(made, loop)
    loop.trigger = 0  # clocked, in memory: every deadline is over already
    loop.arm_pass = -1
    loop.is_plant = 1  # waits for nobody
    loop.cycles = _WARM_UP_CYCLES
    run(loop, made.steps)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

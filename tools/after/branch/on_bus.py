"""A branch on a bus: its nodes go on in lockstep, each in a thread, over real sockets.

before    as in `branching`; the buses are opened once all nodes stand in their cycles
at N - 2  what the node below the executive sent last goes out once more, from its own socket
from N    each node blocks until its frames are here, so that the bits are those of virtual time

A run that begins anew meets as `pcpc run` does, and waits for that no longer.
"""

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import choice
from pcpc.drivers.can.wire import put_frame
from pcpc.drivers.can.wire_layout import FRAME_BYTES
from pcpc.drivers.errors import BusError, UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import WITHOUT_CLOCK, Wanted
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.running import run
from pcpc.executive.nodes.process import claim_frames, open_buses
from pcpc.executive.nodes.watched import POLL_S, StepError, Watch, Work, loop_error
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.branch.branching import Branch, left_by_local
from pcpc.tools.after.replay import pacing_of
from pcpc.tools.start.peer_wait import PeerWait

_DRAIN_S = 0.005  # between two drains of the recorder, whose rings hold several seconds


def _go_on(n: Any, steps: Any, frames: NDArray[np.uint8]) -> Any:
    """Say `frames` (k, FRAME_BYTES), then run the node to its end."""
    for frame in frames:
        n.wire.tx[: len(frame)] = frame
        put_frame(n.wire)
    return run(n, steps)


class BranchOnBus(Branch):
    """As `Branch`, on a bus."""

    def __init__(
        self,
        head: logs.Log,
        rig: Rig,
        cycle: int,
        metadata: dict[str, str],
        log: Path,
        judged: Wanted | None,
        bus: choice.Choice,
    ) -> None:
        """`bus` is let go by `close` and `discard`. UserError, BusError."""
        paced = [role for role in rig.roles if pacing_of(head, role) not in WITHOUT_CLOCK]
        if paced:
            what = f"on a bus a branch goes in lockstep, but the {paced[0]} of this log keeps time"
            raise UserError(f"{head.path}: {what}; leave out --bus")
        self._bus, self._hangs = bus, False
        super().__init__(head, rig, cycle, metadata, log, judged)

    def _hand_on(self) -> None:
        """Open the buses; keep what has to be said again. UserError for what nobody can say."""
        if left_by_local([block.loop for block in self.blocks]):
            what = "frames of the plant wait at the local node, which no bus brings back"
            raise UserError(f"{self.head.path}: {what}; leave out --bus")
        self._again = [np.empty((0, FRAME_BYTES), np.uint8)] * len(self.blocks)
        for i, before in self._left_there().items():
            wire = self.blocks[i].loop.wire
            self._again[i] = np.zeros((len(before) + int(wire.outbox_put), FRAME_BYTES), np.uint8)
            for row, frame in zip(self._again[i], before, strict=False):
                row[: len(frame)] = frame
            self._again[i][len(before) :] = wire.outbox[: wire.outbox_put]
        for made, block in zip(self.plans, self.blocks, strict=True):
            self._bus.claims += claim_frames(self.rig, made, self._bus.bus)
            block.loop.wire.outbox_put = 0
            open_buses(self.rig, self._bus.bus, made, block.loop.wire)

    def _let_go(self, loop: Any) -> None:
        super()._let_go(loop)
        loop.clock.kind, loop.rings.wait_recorder = Time.LOCKSTEP, 1
        loop.control.recorded = loop.control.ready = 1

    def advance(self) -> Iterator[int]:
        """Run to the end; yield the cycles done now and then. Raises StepError."""
        loops = [block.loop for block in self.blocks]
        given = zip(loops, self.steps, self._again, strict=True)
        works = [Work(partial(_go_on, *one)) for one in given]
        for work in reversed(works):  # who waits first hears all
            work.start()
        watch, looks, meeting = Watch(loops), 0.0, PeerWait(self.rig, self.rig.roles)
        while (alive := next((one for one in works if one.is_alive()), None)) is not None:
            alive.join(_DRAIN_S)
            self._drain()
            looks += _DRAIN_S
            if looks >= POLL_S:
                looks = 0.0
                if (standing := watch.stands(self._stopped)) is not None:
                    standing.control.fault = Fault.STEP_HANGS
                    self._hangs = True
                    raise StepError
                self._end_unmet(meeting)
                yield int(loops[0].passes)
        self._drain()
        if meeting.given_up_s:
            raise BusError(meeting.message(self.rig.roles[0], str(self._bus.bus), "the rig"))
        for work in works:
            if work.error is not None:
                raise loop_error(work.error, loops) from work.error
        yield int(loops[0].passes)

    def _end_unmet(self, meeting: PeerWait) -> None:
        """End nodes that have not met, once they should have, or the user wants the end."""
        begun = all(block.loop.passes for block in self.blocks)
        by_role = {str(role): one for role, one in zip(self.rig.roles, self.blocks, strict=True)}
        if meeting.too_long(by_role, begun) or (self._stopped and not begun):
            for block in self.blocks:
                block.control.stop = 1

    def discard(self) -> None:
        """Leave no log behind, nor the bus."""
        self._let_bus_go()
        super().discard()

    def close(self) -> None:
        """As `VirtualRun`; let the bus go."""
        super().close()
        self._let_bus_go()

    def _let_bus_go(self) -> None:
        if self._hangs:  # its threads still use their sockets, until the process ends
            return
        for wire in (block.loop.wire for block in getattr(self, "blocks", ())):
            ends = {int(wire[name]) for name in ("fd_tx", "fd_rx", "fd_tx2", "fd_rx2")}
            for descriptor in ends - {-1}:
                os.close(descriptor)
            wire.fd_tx = wire.fd_rx = wire.fd_tx2 = wire.fd_rx2 = -1
        self._bus.release()

"""Virtual time: both nodes of a rig in one thread, the same cycle, the bus in memory, no clock.

Frames are encoded, protected, checked and decoded as on a bus, and the one sample of delay is the
same; so the records of a virtual run and of a lockstep run on a bus are equal bit for bit.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from drivers import wire
from drivers.jit import i8, loop
from drivers.wire_layout import MEMORY
from executive import shared as sh
from executive.cycle import (
    STEPS,
    N,
    announce,
    finish,
    one_pass,
    request_first_sample,
    wait_for_peer,
)
from executive.emath_selftest import selftest
from executive.facts import facts
from executive.node import describe, install, plan
from executive.recorder import Recorder
from executive.rig import Rig

CYCLES_BETWEEN_DRAINS = 1000  # rows in flight; the rings hold several thousand


@loop(i8(N, STEPS, N, STEPS, i8))
def run_virtual(executive: Any, laws: Any, plant: Any, models: Any, cycles: Any) -> Any:
    """Run at most `cycles` cycles; return 1 while the rig goes on, 0 at its end."""
    if executive.passes == 0:
        announce(plant)
        wire.carry(plant.wire, executive.wire)
        wait_for_peer(executive)
        request_first_sample(executive)
        wire.carry(executive.wire, plant.wire)
        one_pass(plant, models)
    for _ in range(cycles):
        wire.carry(plant.wire, executive.wire)
        executive.virtual_now = executive.k * executive.period_ns
        more = one_pass(executive, laws)
        wire.carry(executive.wire, plant.wire)
        plant.virtual_now = plant.k * plant.period_ns
        one_pass(plant, models)
        if not more:
            finish(executive)
            wire.carry(executive.wire, plant.wire)
            one_pass(plant, models)
            finish(plant)
            return 0
    return 1


class VirtualRun:
    """A rig in virtual time; `advance` runs it piece by piece, `close` completes the log."""

    def __init__(self, rig: Rig, log: Path) -> None:
        selftest()
        made = [plan(rig, role, "lockstep") for role in ("executive", "plant")]
        metadata = facts() | {
            "pacing": "virtual",
            "bus": "memory",
            "controller": rig.config.controller,
            "seed": str(rig.config.seed),
            "rate_hz": repr(rig.config.rate_hz),
        }
        self.blocks: list[sh.Shared] = []
        for p in made:
            block = sh.create(
                f"{rig.config.rig}.virtual.{p.role}.{os.getpid()}", describe(p, metadata)
            )
            block.unlink()
            wire.prepare(block.loop.wire, MEMORY, -1, -1)
            install(p, block.loop)
            block.loop.wait_recorder = 0
            block["control"][sh.PID] = os.getpid()
            self.blocks.append(block)
        self.steps = [p.steps for p in made]
        self.recorder = Recorder(log, self.blocks, clock=lambda: 0)

    def advance(self) -> Iterator[int]:
        """Run to the end in pieces; yield the cycles done after each."""
        executive, plant = (block.loop for block in self.blocks)
        laws, models = self.steps
        more = 1
        while more:
            more = run_virtual(executive, laws, plant, models, CYCLES_BETWEEN_DRAINS)
            self.recorder.drain()
            yield int(executive.passes)

    def stop(self) -> None:
        """Ask both nodes to end at the next cycle."""
        for block in self.blocks:
            block["control"][sh.STOP] = 1

    def close(self) -> None:
        """Finish the log."""
        self.recorder.finish()


def simulate(rig: Rig, log: Path, progress: Callable[[int], None] | None = None) -> VirtualRun:
    """Run `rig` in virtual time into `log`; RigError, BusError, RecordError as on a bus."""
    run = VirtualRun(rig, log)
    try:
        for cycles in run.advance():
            if progress is not None:
                progress(cycles)
    finally:
        run.close()
    return run

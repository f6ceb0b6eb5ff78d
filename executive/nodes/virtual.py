"""Virtual time: all nodes of a rig in one thread, the same cycle, the bus in memory, no clock.

Frames are encoded, protected, checked and decoded as on a bus, and the one sample of delay is the
same; so the records of a virtual run and of a lockstep run on a bus are equal bit for bit. With
`bus.emulate` frames take their time on a CAN line, see `executive.loop.over_line`.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.line import line as lines
from pcpc.executive.laws.emath_selftest import selftest
from pcpc.executive.log import reader as logs
from pcpc.executive.log.description import node_description
from pcpc.executive.log.long_logs import Wanted
from pcpc.executive.log.provenance import facts, of_rig
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.exchange import run_of
from pcpc.executive.loop.over_line import run_over_line
from pcpc.executive.loop.ring_layout import RECORD_HEAD
from pcpc.executive.nodes.external import External
from pcpc.executive.nodes.install import install_in_memory
from pcpc.executive.nodes.plan import Plan, close, describe, plan
from pcpc.executive.nodes.rings import kept_cycles
from pcpc.executive.nodes.watched import watched_result
from pcpc.executive.rig.buses import check_line, line_options, on_line, virtual_pacing
from pcpc.executive.rig.reading import Rig


class Memory:
    """Takes the records of nodes into memory; frames and events are let go.

    `rig`: that of nodes whose descriptions do not have its text.
    """

    def __init__(self, blocks: list[sh.NodeMemory], rig: Rig | None = None) -> None:
        self._blocks, self._rig = blocks, rig
        self._rows: list[list[NDArray[np.int64]]] = [[] for _ in blocks]

    def drain(self) -> None:
        """Take the rows that are there."""
        for block, rows in zip(self._blocks, self._rows, strict=True):
            ring = block["record"]
            put, taken = int(block.ends("record").head), int(block["record_taken"][0])
            first, past = taken % len(ring), taken % len(ring) + put - taken
            rows.append(ring[first:past].copy())
            rows.append(ring[: max(0, past - len(ring))].copy())
            block["record_taken"][0] = put
            for name in ("frame", "event"):
                block[f"{name}_taken"][0] = block.ends(name).head

    def log(self) -> logs.Log:
        """Return the run as it would be read back from a file."""
        nodes = {}
        for block, rows in zip(self._blocks, self._rows, strict=True):
            description = node_description(block.description)
            rows[:] = [table := np.concatenate(rows)]
            values = table.view(np.float64).T
            n = len(description["state_columns"])
            columns = dict(zip(description["state_columns"], values[RECORD_HEAD:], strict=False))
            timing = dict(
                zip(description["timing_columns"], values[RECORD_HEAD + n + 1 :], strict=True)
            )
            nodes[description["node"]] = logs.NodeLog(
                table[:, 0],
                table[:, 1],
                columns,
                timing,
                np.empty(0, logs.FRAME),
                [],
                [],
                description,
            )
        first = self._blocks[0].description
        metadata = {name: node.description["metadata"] for name, node in nodes.items()}
        rig = None if self._rig is None else self._rig.effective()
        return logs.Log(Path(), nodes, first["attachments"], metadata, [], rig=rig)


class VirtualRun:
    """A rig in virtual time; `advance` runs it piece by piece, `close` completes the log."""

    _controller: External | None = None

    def __init__(
        self,
        rig: Rig,
        log: Path | None,
        judged: Wanted | None = None,
        controller: External | None = None,
        check: Callable[[Plan], None] = lambda made: None,
    ) -> None:
        """`log` None keeps the records in memory (`memory.log()`). `judged`: of the recorder.

        `controller`: its step, in the place of the rig's own; it may take any time. `check` may
        refuse the plan of a node, or have more of it recorded.
        """
        selftest()
        check_line(rig, "virtual")
        made = [plan(rig, role, virtual_pacing(rig)) for role in rig.roles]
        for one in made:
            check(one)
        if controller is not None:
            made[0].external["controller"] = controller.entry
        rig_facts = {} if log is None else of_rig(rig.path)
        metadata = (
            facts()
            | rig_facts
            | {
                "pacing": "virtual",
                "bus": "memory",
                "controller": rig.config.controller,
                "seed": str(rig.config.seed),
                "rate_hz": repr(rig.config.rate_hz),
            }
        )
        blocks: list[sh.NodeMemory] = []
        for p in made:
            block = sh.private(describe(p, metadata, kept=log is not None))
            install_in_memory(p, block.loop)
            blocks.append(block)
        self._controller = controller
        self._begin(rig, made, blocks, log, judged)

    def _begin(
        self,
        rig: Rig,
        plans: list[Plan],
        blocks: list[sh.NodeMemory],
        log: Path | None,
        judged: Wanted | None,
    ) -> None:
        """Take the nodes, as they stand in `blocks`, and open the log."""
        self.plans, self.blocks = plans, blocks
        self.steps = tuple(p.steps for p in plans)
        for block in blocks:
            block.control.pid = os.getpid()
        self.over = () if rig.config.bus.emulate is None else _over_line(rig)
        self.memory = Memory(blocks, rig)
        self._stopped = False
        every = [int(one.loop.keep.every) for one in blocks if one.loop.keep.every]
        self._at_once = min(*every, *map(kept_cycles, blocks))  # none is missed
        self.recorder = (
            None if log is None else Recorder(log, blocks, judged=judged, clock=lambda: 0)
        )

    def advance(self) -> Iterator[int]:
        """Run to the end in pieces; yield the cycles done after each. Raises StepError."""
        loops = tuple(block.loop for block in self.blocks)
        run, more = run_over_line(len(loops)) if self.over else run_of(len(loops)), 1
        while more:
            more = self._call_watched(
                lambda: run(loops, self.steps, *self.over, self._at_once), loops
            )
            (self.recorder or self.memory).drain()
            yield int(self.blocks[0].loop.passes)

    def _call_watched(self, call: Callable[[], int], loops: Sequence[Any]) -> int:
        """Do the call; a step that hangs is named, but in Python nobody knows what hangs."""
        if self._controller is not None:
            return call()
        return int(watched_result(call, loops, lambda: self._stopped))

    def stop(self) -> None:
        """Ask the executive to end, and the others by it."""
        self._stopped = True
        self.blocks[0].control.stop = 1

    def close(self) -> None:
        """Finish the log file, and what blocks have opened."""
        if self.recorder is not None:
            self.recorder.finish()
        for made in self.plans:
            close(made)


def _over_line(rig: Rig) -> tuple[Any, NDArray[np.int64]]:
    """Return the rig's emulated line, and which other node is how far behind, ns."""
    config = rig.config
    line: Any = np.zeros(1, lines.Line.dtype).view(np.recarray)[0]
    lines.prepare(line, len(on_line(rig)), config.bus.queue, **line_options(rig))
    phases = [config.realtime.of_node(role).phase for role in rig.roles]
    behind = [(phase - phases[0]) % 1.0 or 1.0 for phase in phases[1:]]
    rows = [(i + 1, round(one * config.period_ns)) for i, one in enumerate(behind)]
    return line, np.array(sorted(rows, key=lambda row: row[1]), np.int64)


def simulate(rig: Rig, log: Path) -> VirtualRun:
    """Run `rig` in virtual time into the file `log`; RigError, BusError, RecordError."""
    run = VirtualRun(rig, log)
    try:
        for _ in run.advance():
            pass
    finally:
        run.close()
    return run


def in_memory(rig: Rig) -> logs.Log:
    """Run `rig` in virtual time without a file and return its records; RigError, BusError."""
    run = VirtualRun(rig, None)
    for _ in run.advance():
        pass
    return run.memory.log()

"""How a node runs, and what it shows of it: its clock, its cycles, the loop's own variables."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec.structs import asdict

from pcpc.drivers.can.bus import RECEIVE_TIMEOUT_US
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time, Trigger
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.ring_layout import RECORD_HEAD
from pcpc.executive.loop.table import Variable
from pcpc.executive.loop.timing import reset
from pcpc.executive.loop.variables import BUS, DRIVE, HEAD, REFUSALS, REQUESTS, RESETS, TIMING
from pcpc.executive.nodes.part import Part, Plan, Size
from pcpc.executive.rig.buses import OVER_LINE
from pcpc.executive.rig.reading import Rig

RECEIVE_TIMEOUT_S = 1e-6 * RECEIVE_TIMEOUT_US  # of a blocking receive
LISTEN_S = 0.2  # several cycles of a slow rig; a waiting node sends its heartbeat more often
PATIENCE_S = 5.0  # lockstep and sync: silence after which the other node is given up


def cycles_of(rig: Rig) -> int:
    """Return the number of cycles of a run."""
    return max(1, round(rig.config.duration_s * rig.config.rate_hz))


class Pace(Part):
    """What starts a cycle, how long the node waits, how many cycles there are."""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the clock of the node and its patience."""
        config, clock = made.rig.config, loop.clock
        clocked = made.pacing in ("real", OVER_LINE) or (made.pacing == "sync" and made.leads)
        clock.trigger = Trigger.CLOCKED if clocked else Trigger.ON_FRAMES
        clock.period_ns = config.period_ns
        clock.phase_ns = round(clock.period_ns * config.realtime.of_node(made.role).phase)
        clock.late_ns = round(clock.period_ns * config.realtime.late_fraction)
        loop.guard.cycles = cycles_of(made.rig) if made.leads else 2**62
        clock.arm_pass = -1 if made.pacing == OVER_LINE else 0 if made.leads else 1
        loop.rx.listen_ns = round(1e9 * LISTEN_S)
        loop.rx.patience = round(PATIENCE_S / RECEIVE_TIMEOUT_S)
        lockstep = made.pacing == "lockstep"
        clock.kind = Time.LOCKSTEP if lockstep else Time.REAL
        loop.rings.wait_recorder = lockstep
        reset(loop)

    def described(self, made: Plan) -> NodeDescription:
        """Return whose run this is, what clients watch, and what a log keeps."""
        config = made.rig.config
        return {
            "node": made.role,
            "rig": config.rig,
            "period_ns": config.period_ns,
            "cycles": cycles_of(made.rig),
            "watch": config.watch,
            "alarms": asdict(config.alarms) if made.pacing in ("real", "sync") else {},
            "timing": {"warn": config.timing.warn, "error": config.timing.error},
            "keep_ns": config.record.keep_ns,
            "keep_on": config.record.events,
        }


class OwnVariables(Part):
    """The variables that the loop itself writes, and what is said and kept of all variables."""

    def variables(self, made: Plan) -> None:
        """Add them; those of no kind are of supervisor, health or timing by their names."""

        def add(rows: Sequence[tuple[str, str, str]], kind: str = "", **more: Any) -> None:
            for name, unit, help in rows:
                own = kind or name.partition(".")[0]
                made.add(Variable(name, unit, own, "loop", help, **more))

        add(HEAD, "supervisor")
        add(TIMING, timing=True)
        add(RESETS, "parameter", low=0.0, high=1.0, recorded=False)
        add(REFUSALS, recorded=False)
        for *row, high in REQUESTS:
            most = 0.0 if row[0] == "supervisor.disarmed" and not made.leads else high
            add([(row[0], row[1], row[2])], "parameter", low=0.0, high=most, recorded=False)
        add((*DRIVE, *BUS), recorded=False)

    def sizes(self, made: Plan) -> list[Size]:
        """Return how many variables there are, of all parts."""
        return [("variables", len(made.table.variables), sh.MAX_VARIABLES)]

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the first values of all variables, the ranges of parameters, what is recorded."""
        variables, rings, tuning = made.table.variables, loop.rings, loop.tuning
        loop.n_variables = len(variables)
        loop.v[:] = 0.0
        loop.v[list(made.values)] = list(made.values.values())
        ranges = [(v.low, v.high) if v.kind == "parameter" else (math.nan,) * 2 for v in variables]
        tuning.low[: len(ranges)], tuning.high[: len(ranges)] = np.array(ranges).T
        for name, timing in (("state", False), ("timing", True)):
            places = made.columns(timing)
            rings[f"{name}_columns"][: len(places)] = places
            rings[f"n_{name}"] = len(places)
        columns = RECORD_HEAD + rings.n_state + 1 + rings.n_timing
        rings.record_rows = sh.RECORD_RING_WORDS // columns

    def described(self, made: Plan) -> NodeDescription:
        """Return all variables, and which of them a row of the records has."""
        variables = made.table.variables
        return {
            "variables": [[v.name, v.unit, v.kind, v.writer, v.help] for v in variables],
            "ranges": {v.name: [v.low, v.high] for v in variables if v.kind == "parameter"},
            "state_columns": [variables[i].name for i in made.columns(False)],
            "timing_columns": [variables[i].name for i in made.columns(True)],
        }

"""From a rig to one runnable node: its table, its wiring, the LOOP record of the compiled loop.

plan(rig, role, ...)    checks the wiring and lays out the table        (nothing is opened or
compiled) install(plan, loop)     writes a plan into a zeroed LOOP record
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers import dbc, e2e
from executive import shared as sh
from executive.block import Block, Port
from executive.cycle import CLOCKED, HEAD, ON_FRAMES, TIMING, idle
from executive.errors import RigError, did_you_mean
from executive.rig import BlockSpec, NodeSpec, Rig
from executive.supervisor import FAULT_NAMES, STATE_NAMES
from executive.table import Table, Variable, Views, add_block

Role = Literal["executive", "plant"]
RECEIVE_TIMEOUT_S = 0.1  # of a blocking receive; see drivers.bus
PATIENCE_S = 5.0  # lockstep and sync: silence after which the other node is given up


@dataclass
class Plan:
    """Everything that `install` writes; tables of frames are those of `drivers.dbc`."""

    rig: Rig
    role: Role
    spec: NodeSpec
    pacing: str
    table: Table = field(default_factory=Table)
    views: list[Views] = field(default_factory=list)
    copies: list[list[tuple[int, int]]] = field(default_factory=list)
    rx_frames: list[dbc.Frame] = field(default_factory=list)
    tx_frames: list[dbc.Frame] = field(default_factory=list)
    values: dict[int, float] = field(default_factory=dict)

    @property
    def steps(self) -> tuple[Any, ...]:
        """The compiled steps, filled up with idle ones."""
        used = tuple(block.block.step for block in self.spec.blocks)
        return used + (idle,) * (sh.MAX_BLOCKS - len(used))

    @property
    def receive_ids(self) -> list[int]:
        """The ids this node listens to."""
        return [frame.can_id for frame in self.rx_frames]

    def columns(self, timing: bool) -> list[int]:
        """Return the places of the recorded variables, of the timing or of the state record."""
        return [
            place
            for place, variable in enumerate(self.table.variables)
            if variable.recorded and (variable.kind == "timing") == timing
        ]

    @property
    def names(self) -> list[str]:
        """Names in the order of the table."""
        return [variable.name for variable in self.table.variables]


def plan(rig: Rig, role: Role, pacing: str) -> Plan:
    """Check the wiring of one node and lay out its table; RigError, BusError say what is wrong."""
    spec = rig.nodes()[0 if role == "executive" else 1]
    made = Plan(rig, role, spec, pacing)
    database = dbc.load(rig.dbc)
    made.rx_frames = list(dbc.frames(database, spec.name, "rx"))
    made.tx_frames = sorted(dbc.frames(database, spec.name, "tx"), key=_sending_order)
    _check_protocol(made)
    _lay_out(made)
    _wire_blocks(made)
    _wire_frames(made)
    _check_sizes(made)
    return made


def check_rate(rig: Rig, pacing: str) -> float:
    """Return the worst-case load of the rig's bus; RigError if frames on a clock would not fit."""
    bitrate = rig.config.bus.bitrate
    if bitrate is None:
        return 0.0
    load = dbc.bus_load(dbc.load(rig.dbc), rig.config.rate_hz, bitrate)
    if load > 1.0 and pacing in ("real", "sync"):
        raise rig.error(
            "rate_hz",
            f"{rig.config.rate_hz:g} Hz loads the bus with {load:.1%} of {bitrate} bit/s; "
            "lower rate_hz, use pacing lockstep, or --set bus.bitrate=null for no limit",
        )
    return load


def _sending_order(frame: dbc.Frame) -> tuple[bool, bool, int]:
    """Slow frames first, then the frames of every cycle, SYNC last; each by id."""
    return frame.has_sequence, frame.cycle_ms == 0.0, frame.can_id


def _check_protocol(made: Plan) -> None:
    frames = made.rx_frames if made.role == "plant" else made.tx_frames
    if not any(frame.has_sequence for frame in frames):
        raise made.rig.error(
            "dbc",
            "no SYNC frame from executive to plant; give one frame the signals sequence and crc",
        )
    if not any(_awaited(made.role, frame) for frame in made.rx_frames):
        raise made.rig.error(
            "dbc", f'{made.spec.name} receives no frame with send type "EveryCycle"'
        )


def _awaited(role: Role, frame: dbc.Frame) -> bool:
    return frame.cycle_ms == 0.0 and not frame.has_sequence


def _starts(role: Role, frame: dbc.Frame) -> bool:
    return frame.has_sequence if role == "plant" else _awaited(role, frame)


def _lay_out(made: Plan) -> None:
    """Fill the table: the loop's own variables, frames, blocks."""
    table = made.table
    for name, unit, help in HEAD:
        table.add(Variable(name, unit, "health", "loop", help))
    for name, unit, help in TIMING:
        table.add(Variable(name, unit, "timing", "loop", help))
    for kind, prefix, frames in (
        ("received", "rx", made.rx_frames),
        ("sent", "tx", made.tx_frames),
    ):
        for frame in frames:
            for s in frame.signals:
                name = f"{prefix}.{frame.name}.{s.name}"
                table.add(Variable(name, s.unit, kind, frame.name, s.help, s.low, s.high))
    for spec in made.spec.blocks:
        try:
            made.views.append(add_block(table, spec.name, spec.block))
        except RigError as error:
            raise RigError(f"{spec.where()}: {error}") from None
        _initial_values(made, spec)


def _initial_values(made: Plan, spec: BlockSpec) -> None:
    """Note parameters and initial states of a block, computed by its `prepare` where it has one."""
    block, table, config = spec.block, made.table, made.rig.config
    parameters: dict[str, Any] = dict(spec.settings)
    states: dict[str, Any] = {}
    if block.prepare is not None:
        try:
            prepared = block.prepare(spec.settings, config.rate_hz, config.seed)
        except ValueError as error:
            raise RigError(f"{spec.where()}: {spec.name}: {error}") from None
        parameters, states = dict(prepared.parameters), dict(prepared.states)
    for ports, given in ((block.parameters or block.settings, parameters), (block.states, states)):
        for port in ports:
            for name, value in _elements(port, given):
                made.values[table.index[f"{spec.name}.{name}"]] = value


def _elements(port: Port, given: dict[str, Any]) -> list[tuple[str, float]]:
    """Return name and value of each element; a port of several is given whole or by element."""
    names = port.names()
    default = 0.0 if port.default is None else port.default
    if port.size > 1 and port.name in given:
        values = np.asarray(given[port.name], float)
        if values.shape != (port.size,):
            raise ValueError(
                f"{port.name}: prepare gave shape {values.shape}, expected ({port.size},)"
            )
        return [(name, float(value)) for name, value in zip(names, values, strict=True)]
    return [(name, float(given.get(name, default))) for name in names]


def _wire_blocks(made: Plan) -> None:
    """Resolve the inputs of every block to copies from variable to variable."""
    for spec, views in zip(made.spec.blocks, made.views, strict=True):
        ports = {name: port for port in spec.block.inputs for name in port.names()}
        for name in spec.inputs:
            if name not in ports:
                raise RigError(
                    f"{spec.where(f'inputs.{name}')}: {spec.name} has no input {name}"
                    + did_you_mean(name, ports)
                )
        copies = []
        for target, (name, port) in zip(views.inputs, ports.items(), strict=True):
            if name not in spec.inputs:
                raise RigError(
                    f"{spec.where()}: {spec.name}.{name} [{port.unit}] is not wired: {port.help}; "
                    f"add it to inputs"
                )
            source = made.table.source(
                spec.inputs[name], port.unit, spec.where(f"inputs.{name}"), f"{spec.name}.{name}"
            )
            copies.append((source, target))
        made.copies.append(copies)


def _wire_frames(made: Plan) -> None:
    """Resolve `transmit` to the last copies; check `limits` and `safe`."""
    section, table = made.role, made.table
    sent = {v.name[3:]: v for v in table.variables if v.kind == "sent"}
    copies = []
    for name, source in made.spec.transmit.items():
        place = made.rig.where(f"{section}.transmit.{name}")
        if name not in sent:
            raise RigError(
                f"{place}: {made.spec.name} sends no signal {name}{did_you_mean(name, sent)}; "
                "the DBC file says which node sends a frame"
            )
        copies.append(
            (table.source(source, sent[name].unit, place, name), table.index[f"tx.{name}"])
        )
    made.copies += [[] for _ in range(sh.MAX_BLOCKS - len(made.copies))] + [copies]
    received = {v.name[3:] for v in table.variables if v.kind == "received"}
    for key, names, known in (
        ("limits", made.spec.limits, set(sent)),
        ("safe", made.spec.safe, received),
    ):
        for name in names:
            if name not in known:
                place = made.rig.where(f"{section}.{key}.{name}")
                raise RigError(
                    f"{place}: {made.spec.name} has no such signal {name}"
                    + did_you_mean(name, known)
                )


def _check_sizes(made: Plan) -> None:
    rx, tx = dbc.table(made.rx_frames, 1.0), dbc.table(made.tx_frames, 1.0)
    for what, size, limit in (
        ("blocks", len(made.spec.blocks), sh.MAX_BLOCKS),
        ("variables", len(made.table.variables), sh.MAX_VARIABLES),
        ("wires", sum(map(len, made.copies)), sh.MAX_COPIES),
        ("frames", max(len(made.rx_frames), len(made.tx_frames)), sh.MAX_FRAMES),
        ("signals", max(len(rx.variables), len(tx.variables)), sh.MAX_SIGNALS),
        ("limits", max(len(made.spec.limits), len(made.spec.safe)), sh.MAX_LIMITS),
    ):
        if size > limit:
            raise made.rig.error(
                made.role,
                f"{size} {what}; one node holds {limit} (raise the limit in executive/shared.py)",
            )


def cycles_of(rig: Rig) -> int:
    """Return the number of cycles of a run."""
    return max(1, round(rig.config.duration_s * rig.config.rate_hz))


def install(made: Plan, loop: Any) -> None:
    """Write `made` into the zeroed LOOP record `loop`; its wire stays as it is."""
    config = made.rig.config
    _install_schedule(made, loop)
    period_s = loop.period_ns * 1e-9
    loop.hold_cycles = config.supervisor.hold_cycles
    loop.fault_after = config.supervisor.fault_after_cycles
    loop.ramp_step = period_s / config.supervisor.ramp_s
    loop.gain = 1.0
    loop.v[:] = 0.0
    for place, value in made.values.items():
        loop.v[place] = value
    _install_frames(made, loop)
    _install_wiring(made, loop)
    loop.mode_index = -1
    if made.role == "plant":
        modes = [
            f"rx.{f.name}.mode" for f in made.rx_frames if any(s.name == "mode" for s in f.signals)
        ]
        loop.mode_index = made.table.index[modes[0]] if modes else -1
    for i, (name, limit) in enumerate(made.spec.limits.items()):
        rate = math.inf if limit.rate_per_s is None else limit.rate_per_s * period_s
        loop.limit_index[i] = made.table.index[f"tx.{name}"]
        loop.limits[i] = (limit.low, limit.high, rate, 0.0, 0.0)
    for i, (name, value) in enumerate(made.spec.safe.items()):
        loop.safe_index[i] = made.table.index[f"rx.{name}"]
        loop.safe[i] = (0.0, 0.0, 0.0, 0.0, value)
    loop.n_limits, loop.n_safe = len(made.spec.limits), len(made.spec.safe)


def _install_schedule(made: Plan, loop: Any) -> None:
    config = made.rig.config
    plant = made.role == "plant"
    loop.is_plant = plant
    clocked = made.pacing == "real" or (made.pacing == "sync" and not plant)
    loop.trigger = CLOCKED if clocked else ON_FRAMES
    loop.period_ns = round(1e9 / config.rate_hz)
    loop.phase_ns = round(loop.period_ns * config.realtime.plant_phase) if plant else 0
    loop.late_ns = round(loop.period_ns * config.realtime.late_fraction)
    loop.cycles = 2**62 if plant else cycles_of(made.rig)
    loop.arm_pass = 1 if plant else 0
    loop.patience = round(PATIENCE_S / RECEIVE_TIMEOUT_S)
    loop.wait_recorder = made.pacing == "lockstep"
    loop.n_blocks, loop.n_variables = len(made.spec.blocks), len(made.table.variables)


def _install_frames(made: Plan, loop: Any) -> None:
    rate = made.rig.config.rate_hz
    for prefix, frames in (("rx", made.rx_frames), ("tx", made.tx_frames)):
        index = {
            v.name[3:]: i
            for i, v in enumerate(made.table.variables)
            if v.name.startswith(prefix + ".")
        }
        table = dbc.table(frames, rate, index)
        loop[prefix][: len(frames)] = table.frames
        loop[f"{prefix}_signals"][: len(table.signals)] = table.signals
        loop[f"{prefix}_scales"][: len(table.scales)] = table.scales
    loop.n_rx, loop.n_tx = len(made.rx_frames), len(made.tx_frames)
    loop.rx_state[: loop.n_rx] = e2e.new_state(loop.n_rx)
    for i, frame in enumerate(made.rx_frames):
        loop.rx_role[i] = (_starts(made.role, frame), _awaited(made.role, frame))
    loop.n_starters, loop.n_awaited = loop.rx_role[: loop.n_rx].sum(axis=0)
    for i, frame in enumerate(made.tx_frames):
        loop.tx_role[i] = (frame.has_sequence, 0x700 <= frame.can_id < 0x780)


def _install_wiring(made: Plan, loop: Any) -> None:
    at = 0
    for i, copies in enumerate(made.copies):
        for pair in copies:
            loop.copies[at] = pair
            at += 1
        loop.copies_end[i] = at
    for i, views in enumerate(made.views):
        ranges = (views.parameters, views.states, views.inputs, views.outputs)
        loop.views[i] = [edge for r in ranges for edge in (r.start, r.stop)]
    for name, timing in (("state", False), ("timing", True)):
        places = made.columns(timing)
        loop[f"{name}_columns"][: len(places)] = places
        loop[f"n_{name}"] = len(places)
    columns = sh.RECORD_HEAD + loop.n_state + 1 + loop.n_timing
    loop.record_rows = sh.RECORD_RING_WORDS // columns


def describe(made: Plan, metadata: dict[str, str]) -> dict[str, Any]:
    """Return the JSON head of the node's shared block; it also goes into the log."""
    rig, table = made.rig, made.table
    attachments = {str(_short(path, rig.path)): text for path, text in rig.document.sources.items()}
    attachments["rig-resolved.yaml"] = rig.resolved()
    attachments[rig.dbc.name] = rig.dbc.read_text()
    return {
        "node": made.role,
        "rig": rig.config.rig,
        "period_ns": round(1e9 / rig.config.rate_hz),
        "cycles": cycles_of(rig),
        "watch": rig.config.watch,
        "variables": [[v.name, v.unit, v.kind, v.writer, v.help] for v in table.variables],
        "ranges": {v.name: [v.low, v.high] for v in table.variables if v.kind == "parameter"},
        "state_columns": [table.variables[i].name for i in made.columns(False)],
        "timing_columns": [table.variables[i].name for i in made.columns(True)],
        "frames": {str(f.can_id): f.name for f in (*made.rx_frames, *made.tx_frames)},
        "state_names": list(STATE_NAMES),
        "fault_names": list(FAULT_NAMES),
        "attachments": attachments,
        "metadata": metadata,
    }


def _short(path: Path, rig: Path) -> Path:
    """Return `path` relative to the rig file's folder, or its name where it lies elsewhere."""
    folder = rig.parent
    return path.relative_to(folder) if path.is_relative_to(folder) else Path(path.name)


def blocks_of(made: Plan) -> Sequence[Block]:
    """Return the node's blocks in the order of the schedule."""
    return [spec.block for spec in made.spec.blocks]

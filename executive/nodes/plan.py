"""From a rig to the plan of one node: its table, its wiring, its frames; every mistake has a place.

plan(rig, role, ...)      checks the wiring and lays out the table; opens nothing; of the loop it
                          compiles nothing, the steps of laws when they are imported
install(plan, loop)       in `executive.nodes.install`: writes it into a zeroed LOOP record
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msgspec.structs import asdict

from pcpc.drivers.can import dbc
from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.laws.idle import idle
from pcpc.executive.log import signals  # noqa: F401  tables may be signals of a log
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.faults import FAULT_NAMES
from pcpc.executive.loop.states import STATE_NAMES
from pcpc.executive.loop.table import Table, Variable, Views
from pcpc.executive.loop.variables import BUS, DRIVE, HEAD, REFUSALS, REQUESTS, RESETS, TIMING
from pcpc.executive.nodes import (
    planned_controllers,
    planned_drive,
    planned_faults,
    planned_keyframes,
    planned_plausible,
)
from pcpc.executive.rig import messages as protocol
from pcpc.executive.rig import standby
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.carried_files import Reads, add_reads, noted_reads
from pcpc.executive.rig.commands import commands
from pcpc.executive.rig.preparation import prepared_values
from pcpc.executive.rig.reading import NodeSpec, Rig
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.executive.rig.schema import Limit


@dataclass
class Plan:
    """Everything that `install` writes; tables of frames are those of `drivers.can.dbc`."""

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
    schedule: list[tuple[int, int, float]] = field(default_factory=list)
    faults: list[planned_faults.PlannedFault] = field(default_factory=list)
    noted: list[int] = field(default_factory=list)
    read: Reads = field(default_factory=dict)  # by `prepare`
    limits: dict[str, Limit] = field(default_factory=dict)  # by sent signal, `safe` given
    below: frozenset[str] = frozenset()  # of executive or local node: frames on the second bus
    senders: dict[str, int] = field(default_factory=dict)  # of frames from several nodes below
    external: dict[str, Any] = field(default_factory=dict)  # entries in the place of blocks' own
    opened: list[Any] = field(default_factory=list)  # what has to live as long as the loop runs

    @property
    def steps(self) -> tuple[Any, ...]:
        """What the loop calls: the steps of the blocks, filled up with idle ones."""
        used = [self.external.get(b.name, b.block.step.entry) for b in self.spec.blocks]
        return (*used, *(idle.entry,) * (sh.MAX_BLOCKS - len(used)))

    @property
    def fd(self) -> bool:
        """Whether a frame of the node, or of the rig's drive, is one of CAN FD."""
        own = any(frame.fd for frame in (*self.rx_frames, *self.tx_frames))
        return own or protocol.has_fd_drive(self.rig)

    @property
    def data_bytes(self) -> int:
        """The most data bytes of a frame."""
        return LENGTHS[-1] if self.fd else 8

    @property
    def receive_ids(self) -> list[int]:
        """The ids this node listens to; a local node: towards the executive."""
        return [frame.can_id for frame in self.rx_frames if frame.name not in self.below]

    @property
    def receive_ids_below(self) -> list[int]:
        """The ids a local node listens to on its bus to the plant."""
        return [frame.can_id for frame in self.rx_frames if frame.name in self.below]

    @property
    def send_ids(self) -> list[int]:
        """The ids this node sends; a local node: towards the executive."""
        return [frame.can_id for frame in self.tx_frames if frame.name not in self.below]

    @property
    def send_ids_below(self) -> list[int]:
        """The ids a local node sends on its bus to the plant."""
        return [frame.can_id for frame in self.tx_frames if frame.name in self.below]

    def columns(self, timing: bool) -> list[int]:
        """Return the places of the recorded variables, of the timing or of the state record."""
        return [i for i, v in enumerate(self.table.variables) if v.recorded and v.timing == timing]

    @property
    def names(self) -> list[str]:
        """Names in the order of the table."""
        return [variable.name for variable in self.table.variables]


def plan(rig: Rig, role: Role, pacing: str) -> Plan:
    """Check the wiring of one node and lay out its table; RigError, BusError say what is wrong."""
    spec = planned_controllers.complete(rig, role)
    made = Plan(rig, role, spec, pacing)
    database = protocol.database_of(rig)
    with protocol.errors_named(rig):
        _take_frames(made, database)
    _lay_out(made)
    _wire_blocks(made)
    _wire_frames(made)
    _plan_schedule(made)
    _plan_faults(made, database)
    made.schedule.sort(key=lambda row: row[0])
    _check_sizes(made)
    return made


def _take_frames(made: Plan, database: dbc.Database) -> None:
    rig, role = made.rig, made.role
    made.rx_frames = planned_drive.frames(rig, role, database, "rx")
    said = planned_drive.frames(rig, role, database, "tx")
    made.tx_frames = sorted(said, key=protocol.sending_order)
    if role not in PLANTS:
        own = {frame.name for frame in (*made.rx_frames, *made.tx_frames)}
        made.below = protocol.frames_on_second(rig, database) & own
    made.senders = protocol.senders_below(rig, role, database)
    planned_drive.check_senders(rig, database, made.pacing)
    protocol.check(rig, role, made.rx_frames, made.tx_frames)
    protocol.check_losses(rig, database)
    protocol.check_stops(rig, database)


def check_pacing(rig: Rig, pacing: str) -> None:
    """Raise RigError if the controller cannot run on a clock and `pacing` is one."""
    for name in standby.laws(rig.config):
        why = rig.config.controllers[name].lockstep_only
        if why and pacing in ("real", "sync"):
            others = [n for n, law in rig.config.controllers.items() if not law.lockstep_only]
            cure = f", or --controller {' or '.join(others)}" if others else ""
            raise rig.error(
                f"controllers.{name}.lockstep_only",
                f"{name} does not run in pacing {pacing}: {why}; use --pacing lockstep{cure}",
            )


def _lay_out(made: Plan) -> None:
    """Fill the table: the loop's own variables, frames, blocks."""
    table = made.table

    def add_own(entries: Sequence[tuple[str, str, str]], kind: str = "", **more: Any) -> None:
        for name, unit, help in entries:  # of no kind: supervisor, health, timing by their names
            own = kind or name.partition(".")[0]
            table.add(Variable(name, unit, own, "loop", help, **more))

    add_own(HEAD, "supervisor")
    add_own(TIMING, timing=True)
    add_own(RESETS, "parameter", low=0.0, high=1.0, recorded=False)
    add_own(REFUSALS, recorded=False)
    for name, unit, help, high in REQUESTS:
        most = 0.0 if name == "supervisor.disarmed" and made.role != "executive" else high
        add_own([(name, unit, help)], "parameter", low=0.0, high=most, recorded=False)
    add_own((*DRIVE, *BUS), recorded=False)
    for kind, prefix, frames in (
        ("received", "rx", made.rx_frames),
        ("sent", "tx", made.tx_frames),
    ):
        for frame in frames:
            for s in frame.signals:
                name = f"{prefix}.{frame.name}.{s.name}"
                table.add(Variable(name, s.unit, kind, frame.name, s.help, s.low, s.high))
    names = [spec.name for spec in made.spec.blocks]
    for spec in made.spec.blocks:
        try:
            view = planned_controllers.views(made.rig, table, made.views, spec, names)
            made.views.append(view)
        except RigError as error:
            raise RigError(f"{spec.where()}: {error}") from None
        _initial_values(made, spec)
    made.values |= planned_controllers.beginning(made.spec, table, made.values)
    planned_plausible.add_counts(made.rig, made.role, table)
    made.values |= planned_drive.add_variables(made.rig, made.role, table, made.spec.blocks)


def _initial_values(made: Plan, spec: BlockSpec) -> None:
    """Note parameters and initial states of a block, computed by its `prepare` where it has one."""
    table, config = made.table, made.rig.config
    try:
        with noted_reads() as reads:
            pairs = prepared_values(spec.block, spec.settings, config.rate_hz, config.seed)
    except ValueError as error:
        raise RigError(f"{spec.where()}: {spec.name}: {error}") from None
    add_reads(made.read, reads)
    for name, value in (*pairs[0], *pairs[1]):
        made.values[table.index[f"{spec.name}.{name}"]] = value


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
            place = spec.where(f"inputs.{name}")
            source = _source(made, spec.inputs[name], port.unit, place, f"{spec.name}.{name}")
            copies.append((source, target))
        made.copies.append(copies)


def _source(made: Plan, name: str, unit: str, place: str, target: str) -> int:
    """Return the index of a wiring source; RigError with the cures of a wrong unit."""
    try:
        return made.table.source(name, unit, place, target)
    except RigError as error:
        cure = _other_cure(made, name, target) if name in made.table.index else ""
        raise RigError(f"{error}{cure}") from None


def _other_cure(made: Plan, name: str, target: str) -> str:
    """Return what else cures a wiring of two units: a reference from a table, the DBC file."""
    block = made.rig.config.sections[made.role].blocks.get(name.partition(".")[0])
    law = "" if block is None else block.law or ""
    if law.startswith("references:"):
        return "; these references are angles; for another unit: law: profiles:step (docs/rig.md)"
    if law.startswith("profiles:"):
        cure = "value, rate and acc are in its unit, unit/s and unit/s2"
        return f"; {cure}, the unit being that of the first input it feeds, or `unit: ...`"
    for path in (name.removeprefix("rx."), target):
        frame, _, signal = path.partition(".")
        if frame in (one.name for one in (*made.rx_frames, *made.tx_frames)):
            where = dbc.place(made.rig.dbc, frame, signal)
            return f"; or change unit and scale in {where}: nothing is converted"
    return ""


def _wire_frames(made: Plan) -> None:
    """Resolve `transmit` to the last copies; check `limits` and `safe`."""
    section, table = made.role, made.table
    sent = {v.name[3:]: v for v in table.variables if v.kind == "sent"}
    copies = planned_controllers.standby_copies(made.spec, table)
    for name, source in made.spec.transmit.items():
        place = made.rig.where(f"{section}.transmit.{name}")
        if name not in sent:
            raise RigError(
                f"{place}: {made.spec.name} sends no signal {name}{did_you_mean(name, sent)}; "
                "the DBC file says which node sends a frame"
            )
        found = _source(made, source, sent[name].unit, place, name)
        copies.append((found, table.index[f"tx.{name}"]))
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
    made.limits = commands(made.rig, made.role, sent)


def _plan_schedule(made: Plan) -> None:
    """Resolve the rig's scheduled tunings and noted variables; only the executive has them."""
    if made.role != "executive":
        return
    table, config = made.table, made.rig.config
    tunable = [v.name for v in table.variables if v.kind == "parameter"]
    for i, tuning in enumerate(config.schedule):
        for name, value in standby.scheduled_values(made.rig.document, config, i, tuning).items():
            path = f"schedule[{i}].set.{name}"
            if name not in tunable:
                raise made.rig.error(path, f"no parameter {name}{did_you_mean(name, tunable)}")
            variable = table.variables[table.index[name]]
            if not (variable.low <= value <= variable.high and math.isfinite(value)):
                span = f"{variable.low:g}..{variable.high:g} {variable.unit}"
                raise made.rig.error(path, f"{value:g} is outside {span}")
            cycle = round(tuning.at_s * config.rate_hz)
            made.schedule.append((cycle, table.index[name], value))
    for i, name in enumerate(config.note):
        if name not in table.index:
            what = f"no variable {name}{did_you_mean(name, table.index)}"
            raise made.rig.error(f"note[{i}]", what)
        made.noted.append(table.index[name])
    if standby.IN_CHARGE in table.index:
        made.noted.append(table.index[standby.IN_CHARGE])


def _plan_faults(made: Plan, database: dbc.Database) -> None:
    """Add what the rig's faults on purpose need in this node, and when they begin."""
    rig, role = made.rig, made.role
    planned_faults.check_frames(rig, protocol.received_frames(rig, database))
    place = made.table, made.views, made.rx_frames
    made.faults = planned_faults.add_faults(rig, role, made.pacing, *place)
    for one in made.faults:
        made.values.update(planned_faults.values_of(one))
        made.schedule += planned_faults.moments_of(rig, role, one)


def _check_sizes(made: Plan) -> None:
    rx, tx = dbc.table(made.rx_frames, 1.0), dbc.table(made.tx_frames, 1.0)
    for what, size, limit in (
        ("blocks", len(made.spec.blocks), sh.MAX_BLOCKS),
        ("variables", len(made.table.variables), sh.MAX_VARIABLES),
        ("wires", sum(map(len, made.copies)), sh.MAX_COPIES),
        ("frames", max(len(made.rx_frames), len(made.tx_frames)), sh.MAX_FRAMES),
        ("signals", max(len(rx.variables), len(tx.variables)), sh.MAX_SIGNALS),
        ("limits", max(len(made.limits), len(made.spec.safe)), sh.MAX_LIMITS),
        ("scheduled values", len(made.schedule), sh.MAX_SCHEDULE),
        ("noted variables", len(made.noted), sh.MAX_LIMITS),
    ):
        if size > limit:
            raise made.rig.error(
                made.role,
                f"{size} {what}; one node holds {limit} (see executive/loop/shared.py)",
            )


def cycles_of(rig: Rig) -> int:
    """Return the number of cycles of a run."""
    return max(1, round(rig.config.duration_s * rig.config.rate_hz))


def describe(made: Plan, metadata: dict[str, str], kept: bool = True) -> NodeDescription:
    """Return the JSON head of the node's shared block; it also goes into the log.

    Not `kept`: without the effective rig's text, for a run whose log is not written.
    """
    rig, table = made.rig, made.table
    attachments = {str(_short(path, rig.path)): text for path, text in rig.document.sources.items()}
    attachments |= {"rig-resolved.yaml": rig.resolved()} if kept else {}
    attachments |= rig.tables()
    attachments[rig.dbc.name] = dbc.text(rig.dbc)
    return {
        "node": made.role,
        "rig": rig.config.rig,
        "period_ns": rig.config.period_ns,
        "cycles": cycles_of(rig),
        "watch": rig.config.watch,
        "alarms": asdict(rig.config.alarms) if made.pacing in ("real", "sync") else {},
        "timing": {"warn": rig.config.timing.warn, "error": rig.config.timing.error},
        "keep_ns": rig.config.record.keep_ns,
        "keep_on": rig.config.record.events,
        "variables": [[v.name, v.unit, v.kind, v.writer, v.help] for v in table.variables],
        "ranges": {v.name: [v.low, v.high] for v in table.variables if v.kind == "parameter"},
        "state_columns": [table.variables[i].name for i in made.columns(False)],
        "timing_columns": [table.variables[i].name for i in made.columns(True)],
        "sources": {
            table.variables[target].name: table.variables[source].name
            for copies in made.copies
            for source, target in copies
        },
        "blocks": [spec.name for spec in made.spec.blocks],
        "laws": list(standby.laws(rig.config)) if standby.IN_CHARGE in table.index else [],
        "faults": planned_faults.fault_descriptions(made.faults),
        "frames": planned_drive.names(made.rig, made.role)
        | {str(f.can_id): f.name for f in (*made.rx_frames, *made.tx_frames)},
        "state_names": list(STATE_NAMES),
        "fault_names": list(FAULT_NAMES),
        "attachments": attachments,
        "files": rig.carried_files(made.read),
        "external": list(made.external),
        "metadata": metadata,
        **({"data_bytes": made.data_bytes} if made.fd else {}),
        **planned_keyframes.keyframe_description(made),
    }


def _short(path: Path, rig: Path) -> Path:
    """Return `path` relative to the rig file's folder, or its name where it lies elsewhere."""
    folder = rig.parent
    return path.relative_to(folder) if path.is_relative_to(folder) else Path(path.name)

"""The plant's drive, planned: its variables, its frames, its dictionary, installed.

What is a robot's dialect's stands in `executive.nodes.planned_robot`.
"""

from collections.abc import Sequence
from typing import Any, Literal

from pcpc.drivers.can import dbc
from pcpc.drivers.canopen import eds_file, objects
from pcpc.drivers.canopen.layout import COB_ID, FIRST_TPDO, PDOS, RPDO_ROWS, TPDO_ROWS
from pcpc.drivers.compiled.stage import entry_of
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.drive.foreign import Maker
from pcpc.drivers.drive.layout import Drive as DriveRecord
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.laws.units import unit
from pcpc.executive.log.run_counts import DRIVEN
from pcpc.executive.loop import plant_drive
from pcpc.executive.loop.clock import Trigger
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.shared import LOOP
from pcpc.executive.loop.table import Table, Variable
from pcpc.executive.nodes import planned_robot
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.bus_keys import Drive
from pcpc.executive.rig.messages import (
    FD_PROFILES,
    check_heartbeats,
    check_starters,
    database_of,
)
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

Way = Literal["rx", "tx"]

COMMAND = DRIVEN
GAINS = ("drive.position_gain_per_s", "drive.velocity_gain", "drive.integral_gain_per_s")
_SYNC, _ID = 0x080, 0x7FF
_HIGHEST_GAIN = 1e9
_NODES, _SCALE = range(1, 128), 1000.0
CIA402 = "cia402"


def _ids(node: int, start: Any) -> set[int]:
    rows = [i * RPDO_ROWS for i in range(PDOS)] + [FIRST_TPDO + i * TPDO_ROWS for i in range(PDOS)]
    found = {start[row + COB_ID] & _ID for row in rows}
    return found | {0, _SYNC + node, 0x580 + node, 0x600 + node, 0x700 + node}


def _ids_of_one(node: int, start: Any) -> set[int]:
    found = {base + node for base in (_SYNC, 0x580, 0x600, 0x700)}
    cob_ids = [start[FIRST_TPDO + i * TPDO_ROWS + COB_ID] for i in range(PDOS)]
    return found | {one & _ID for one in cob_ids if not one & objects.NOT_VALID}


def _names(node: int, start: Any) -> dict[int, str]:
    id_names = {0: "NMT", _SYNC: "SYNC", _SYNC + node: "EMCY", 0x700 + node: "heartbeat"}
    id_names |= {0x580 + node: "SDO answer", 0x600 + node: "SDO request"}
    for i in range(PDOS):
        for word, row in (("RPDO", i * RPDO_ROWS), ("TPDO", FIRST_TPDO + i * TPDO_ROWS)):
            id_names[start[row + COB_ID] & _ID] = f"{word}{i + 1}"
    return id_names


CANOPEN = planned_robot.RobotKind(None, _NODES, (), _SCALE, _ids, _ids_of_one, _names)


def kind_of(drive: Drive) -> planned_robot.RobotKind:
    """Return what a drive speaks; UserError."""
    return CANOPEN if drive.profile == CIA402 else planned_robot.kind_of(drive.profile)


def starts(rig: Rig, role: Role) -> Any:
    """Return the drive's settings at the start, of CiA 402 by row, else by name; RigError."""
    drive = rig.config.drives[role]
    if drive.profile == CIA402:
        return [one.start for one in dictionary_of(rig, role)]
    return {one.name: one.start for one in planned_robot.settings_of(rig, drive)}


def drive_of(rig: Rig, role: Role) -> Drive | None:
    """Return the keys of the drive, if this node is one."""
    return rig.config.drives.get(role)


def is_lone_drive(rig: Rig, roles: Sequence[str]) -> bool:
    """Return whether these nodes are drives alone, for a master elsewhere."""
    return set(roles) <= set(rig.config.drives)


def dictionary_of(rig: Rig, role: Role = "plant") -> list[objects.Object]:
    """Return a drive's objects as they are at the start; RigError for what cannot be."""
    drive, section = rig.config.drives[role], f"{role}.drive"
    if drive.node not in _NODES:
        raise rig.error(f"{section}.node", f"{drive.node} is not one of 1 to 127")
    dictionary = taken_from_eds(rig, role).every
    for key, raw in drive.objects.items():
        if raw != int(raw):
            raise rig.error(f"{section}.objects", f"{key}: {raw:g} is not a whole number")
    try:
        return objects.changed_dictionary(
            dictionary, {str(key): int(raw) for key, raw in drive.objects.items()}
        )
    except ValueError as error:
        raise rig.error(f"{section}.objects", str(error)) from None


def taken_from_eds(rig: Rig, role: Role = "plant") -> eds_file.EdsContent:
    """Return a drive's own objects with what its EDS makes of them; RigError."""
    drive, section = rig.config.drives[role], f"{role}.drive"
    dictionary = objects.objects(drive.node, rig.config.rig)
    if drive.eds is None or drive.profile != CIA402:
        return eds_file.EdsContent(dictionary)
    file = rig.document.file((role, "drive", "eds"), drive.eds)
    try:
        return eds_file.read(file, dictionary, drive.node)
    except OSError as error:
        raise rig.error(f"{section}.eds", f"{file}: {error.strerror or error}") from None
    except ValueError as error:
        raise rig.error(f"{section}.eds", f"{file.name}: {error}") from None


def frames(rig: Rig, role: Role, database: dbc.Database, way: Way) -> list[dbc.Frame]:
    """Return a node's received or sent frames but for those of the drive."""
    node_frames = list(dbc.frames(database, rig.config.sections[role].node, way))
    drive = drive_of(rig, role)
    if drive is None:
        return node_frames
    ids, fd = kind_of(drive).ids(drive.node, starts(rig, role)), drive.profile in FD_PROFILES
    if drive.profile == CIA402:
        return [frame for frame in node_frames if frame.can_id not in ids]
    for frame in node_frames:
        if frame.can_id in ids and frame.fd >= fd:
            what = f"{drive.node} has the id of {frame.name}, {frame.can_id:#05x}; choose another"
            raise rig.error(f"{role}.drive.node", what)
    return node_frames


def frames_before_start(
    rig: Rig, database: dbc.Database, pacing: str
) -> dict[Role, list[dbc.Frame]]:
    """Return what each node sends before its first cycle; of a drive, on a clock, its own too."""
    return {
        role: list(dbc.frames(database, node.node, "tx"))
        if pacing in ("real", "sync")
        else frames(rig, role, database, "tx")
        for role, node in rig.config.sections.items()
    }


def check_senders(rig: Rig, database: dbc.Database, pacing: str) -> None:
    """Raise RigError if two plants on one bus send the same id, or hear one as the same drive.

    Also for a frame that another node waits for and nobody sends.
    """
    check_heartbeats(rig, frames_before_start(rig, database, pacing))
    if pacing == "lockstep":
        check_starters(rig, database)
    senders: dict[tuple[bool, int], Role] = {}
    for role, plant in rig.config.plants.items():
        sent = {one.can_id for one in frames(rig, role, database, "tx") if not one.extended}
        for number in sorted(sent | _spoken_ids(rig, role)):
            other = senders.setdefault((plant.bus is None, number), role)
            if other != role:
                key = f"{role}.node" if plant.drive is None else f"{role}.drive.node"
                what = f"{number:#05x} is an id of {other} on this bus, too; choose another"
                raise rig.error(key, what)


def _spoken_ids(rig: Rig, role: Role) -> set[int]:
    """Return the ids that a drive sends, and those by which it alone is meant."""
    drive = drive_of(rig, role)
    return set() if drive is None else kind_of(drive).spoken_ids(drive.node, starts(rig, role))


def names(rig: Rig, role: Role) -> dict[str, str]:
    """Return what the frames of a drive are called that the DBC file does not name, by id."""
    drive = drive_of(rig, role)
    if drive is None:
        return {}
    found = kind_of(drive).names(drive.node, starts(rig, role))
    known = {message.frame_id for message in database_of(rig).messages}
    shown = {number: name for number, name in found.items() if number not in known}
    return {
        str(number): f"{name} {drive.node}" if number else name for number, name in shown.items()
    }


def shown_variables(drive: Drive) -> Sequence[tuple[str, str, str]]:
    """Return what the table shows of a drive: name, unit (or whose), meaning."""
    return plant_drive.SEEN if drive.profile == CIA402 else plant_drive.SEEN_ROBOT


def _measured_unit(rig: Rig, table: Table, key: str, name: str) -> str:
    """Return the unit of a variable that the drive measures."""
    if name not in table.index:
        readable = [v.name for v in table.variables if v.kind in ("output", "state")]
        what = f"the plant has no variable {name}{did_you_mean(name, readable)}"
        raise rig.error(key, what)
    return table.variables[table.index[name]].unit


def _unit_of_command(rig: Rig, role: Role, blocks: Sequence[BlockSpec]) -> str:
    """Return the unit of the inputs that take the drive's command."""
    units = {
        port.unit
        for spec in blocks
        for port in spec.block.inputs
        for name in port.names()
        if spec.inputs.get(name) == COMMAND
    }
    if len(units) == 1:
        return units.pop()
    problem = f"no block of the plant takes {COMMAND}; wire an input of one to it, as torque_Nm"
    if units:
        problem = f"{COMMAND} is wired to inputs in {' and '.join(sorted(units))}; it has one unit"
    raise RigError(f"{rig.where(f'{role}.drive')}: {problem}")


class PlantDrive(Part):
    """A drive that moves the plant, as its master on the bus tells it."""

    def variables(self, made: Plan) -> None:
        """Add what is seen of the drive, and its gains; RigError for a wrong key."""
        rig, role, drive = made.rig, made.role, drive_of(made.rig, made.role)
        if drive is None:
            return
        position = _measured_unit(rig, made.table, f"{role}.drive.position", drive.position)
        velocity = unit(position).per_second().text
        if drive.velocity is not None:
            velocity = _measured_unit(rig, made.table, f"{role}.drive.velocity", drive.velocity)
        command = _unit_of_command(rig, role, made.spec.blocks)
        units = {"position": position, "velocity": velocity, "": ""}
        for name, whose, help in shown_variables(drive):
            made.add(Variable(f"drive.{name}", units[whose], "output", "drive", help))
        made.add(Variable(COMMAND, command, "output", "drive", "what moves the plant"))
        gains = drive.gains
        for name, of, help, value in zip(
            GAINS,
            ("1/s", unit(command).named_over(unit(velocity)).text, "1/s"),
            ("position loop", "velocity loop", "integral of the velocity loop"),
            (gains.position_per_s, gains.velocity, gains.integral_per_s),
            strict=True,
        ):
            span = 0.0, _HIGHEST_GAIN
            made.add(Variable(name, of, "parameter", "drive", help, *span, recorded=False), value)
        starts(rig, role)

    def in_no_lane(self, rig: Rig) -> str:
        """Return that there is one."""
        return "its plant is a drive" if rig.config.drives else ""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the drive; it waits for no other node's frames but for SYNC.

        On a clock not even for that: a master may come at any time.
        """
        rig, drive, index = made.rig, drive_of(made.rig, made.role), made.table.index
        if drive is None:
            return
        node = structure(LOOP)
        d: DriveRecord = loop.canopen if drive.profile == CIA402 else loop.robot
        if drive.profile == CIA402:
            hooks = plant_drive.hear_drive, plant_drive.work_drive, plant_drive.speak_drive
            objects.install(d, drive.node, dictionary_of(rig, made.role))
            d.position_scale = drive.scale.position or _SCALE
            d.velocity_scale = drive.scale.velocity or _SCALE
        else:
            hooks = plant_drive.hear_robot, plant_drive.work_robot, plant_drive.speak_robot
            planned_robot.install_robot(loop.robot, rig, drive)
        h = loop.drive
        h.on, (h.hears, h.works, h.speaks) = 1, (entry_of(one, node) for one in hooks)
        d.rate_hz, d.rated = rig.config.rate_hz, drive.rated
        d.answers_last = loop.meeting.ordered
        spoken = {one.profile.upper() for one in rig.config.drives.values()}
        if not spoken <= {*Maker.__members__}:  # what one from outside hears may look like any
            spoken = {*Maker.__members__}
        d.makers = sum(1 << Maker[name] for name in spoken)
        d.place_position, d.place_command = index[drive.position], index[COMMAND]
        d.place_velocity = -1 if drive.velocity is None else index[drive.velocity]
        shown = shown_variables(drive)[0][0]
        d.place_gains, d.place_seen = index[GAINS[0]], index[f"drive.{shown}"]
        loop.rx.role["awaited"] = 0
        if loop.clock.trigger == Trigger.CLOCKED:
            loop.rx.role["starts"] = 0
            loop.clock.arm_pass = min(loop.clock.arm_pass, 0)
        loop.rx.starters, loop.rx.awaited = loop.rx.role["starts"].sum(), 0

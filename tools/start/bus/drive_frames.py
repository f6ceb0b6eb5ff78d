"""What a rig's drives send by themselves beside the frames of the DBC file, as the rig starts them.

    heartbeat       every 0x1017 ms
    TPDO            with each SYNC or each n-th one, which comes every cycle; one of an event at
                    most every cycle, and no sooner than its inhibit time
    ODrive          its cyclic messages, with their periods
    MIT, RobStride  an answer each cycle

What a master asks for besides, SDOs as an example, nothing bounds.
"""

from collections.abc import Iterator

from pcpc.drivers.can import dbc
from pcpc.drivers.can.frames import Frame
from pcpc.drivers.canopen.layout import (
    COB_ID,
    FIRST_TPDO,
    INHIBIT,
    KIND,
    PDOS,
    TPDO_MAPPING,
    TPDO_ROWS,
    Od,
)
from pcpc.drivers.canopen.objects import NOT_VALID
from pcpc.drivers.robots.odrive_settings import SENT, CommandId
from pcpc.executive.rig.bus_keys import Drive
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

LAST_SYNC_KIND = 240  # of CiA 301: 1 to 240, with so many SYNCs
LEFT_OUT = "a moteus' answers, SDOs, EMCY and what else a master asks for come on top"


def own_frames(rig: Rig, database: dbc.Database) -> Iterator[tuple[Role, Frame]]:
    """Yield the frames of each drive that the DBC file does not have; RigError."""
    if not rig.config.drives:
        return
    known = {message.frame_id for message in database.messages}
    for role, drive in rig.config.drives.items():
        found = _canopen(rig, role) if drive.profile == "cia402" else _robot(rig, drive)
        yield from ((role, frame) for frame in found if frame.can_id not in known)


def _frame(name: str, number: int, length: int, cycle_ms: float, extended: bool = False) -> Frame:
    return Frame(name, number, extended, length, cycle_ms, False, (0, 0, 0), (0, 0, 0), (), "")


def _canopen(rig: Rig, role: Role) -> Iterator[Frame]:
    from pcpc.executive.nodes.planned_drive import dictionary_of  # here, because it imports numba

    start = [one.start for one in dictionary_of(rig, role)]
    node, period_ms = rig.config.drives[role].node, 1e3 / rig.config.rate_hz
    if start[Od.HEARTBEAT_MS]:
        yield _frame(f"heartbeat {node}", 0x700 + node, 1, float(start[Od.HEARTBEAT_MS]))
    for i in range(PDOS):
        row = FIRST_TPDO + i * TPDO_ROWS
        entries = start[row + TPDO_MAPPING + 1 :][: start[row + TPDO_MAPPING]]
        if start[row + COB_ID] & NOT_VALID or not entries:
            continue
        kind, length = start[row + KIND], sum(entry & 0xFF for entry in entries) // 8
        cycle_ms = kind * period_ms if 1 < kind <= LAST_SYNC_KIND else 0.0
        if kind > LAST_SYNC_KIND:
            shortest_ms = max(0.1 * start[row + INHIBIT], period_ms)
            cycle_ms = shortest_ms if shortest_ms > period_ms else 0.0
        name = f"TPDO{i + 1} {node}"
        yield _frame(name, start[row + COB_ID] & 0x7FF, length, cycle_ms)


def _robot(rig: Rig, drive: Drive) -> Iterator[Frame]:
    from pcpc.executive.nodes.planned_robot import settings_of  # here, because it imports numba

    start = {one.name: one.start for one in settings_of(rig, drive)}
    if drive.profile == "odrive":
        for command, ms in zip(SENT.tolist(), start.values(), strict=False):
            if ms:
                name = f"{CommandId(command).name.lower()} {drive.node}"
                yield _frame(name, drive.node << 5 | command, 8, float(ms))
    elif drive.profile == "mit":
        yield _frame(f"feedback {drive.node}", int(start["MST_ID"]), 8, 0.0)
    elif drive.profile == "robstride":
        number = 0x028000FD | drive.node << 8  # from a motor that is on, to the usual host
        yield _frame(f"feedback {drive.node}", number, 8, 0.0, True)

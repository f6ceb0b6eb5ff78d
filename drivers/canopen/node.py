"""The drive as one: a frame that came, a cycle that passes, frames that are due.

    hear      a frame: whose it is, and what follows; answers lie in the outbox
    work      a cycle: the command for what was measured (`drivers.canopen.motion.measure`)
    speak     at its end: boot-up, heartbeat, PDOs

What is heard: NMT 0x000, SYNC 0x080, the master's heartbeat, SDO 0x600 + node, received PDOs, and
the remote frame 0x700 + node (node guarding).
Frames with the ids that the drive sends are another drive's with its number.
"""

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.canopen import pdo, sdo
from pcpc.drivers.canopen.frames import EMERGENCY, HEARTBEAT, SDO_ANSWER
from pcpc.drivers.canopen.layout import Canopen, ErrorCode, Heartbeat
from pcpc.drivers.canopen.mapping import PDOS
from pcpc.drivers.canopen.motion import advance
from pcpc.drivers.canopen.network import (
    answer_guard,
    beat,
    boot,
    command,
    master_is_silent,
    note_heartbeat,
)
from pcpc.drivers.canopen.power import has_power, lose_connection
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.drive.layout import Whose

SYNC, SDO_REQUEST, LAST_NODE = 0x080, 0x600, 127
REMOTE = int64(1 << 30)
hear_sync, receive_pdo, serve = pdo.hear_sync, pdo.receive, sdo.serve
send_due, give_up = pdo.send_due, sdo.give_up


@loop_function
def hear(d: Canopen, frame: Cells[Byte]) -> int:
    """Take a frame (16,) that came; return whose it is."""
    if d.state.boots == 0:
        boot(d)
    can_id, dlc, data = four_bytes(frame, 0), int64(frame[LENGTH]), data_of(frame)
    if can_id & REMOTE != 0:
        if can_id != REMOTE | HEARTBEAT + d.node:
            return int64(Whose.OTHER)
        answer_guard(d)
        return int64(Whose.OURS)
    if can_id == 0:
        if dlc >= 2 and (data[1] == 0 or data[1] == d.node):
            command(d, int64(data[0]))
            return int64(Whose.OURS)
        return int64(Whose.OTHER)
    if can_id == SYNC:
        hear_sync(d)
        return int64(Whose.ALL)
    if can_id == SDO_REQUEST + d.node:
        if dlc == 8 and d.state.nmt != Heartbeat.STOPPED:
            serve(d, data)
        return int64(Whose.OURS)
    if is_own(d, can_id):
        return int64(Whose.TWIN)
    if HEARTBEAT < can_id <= HEARTBEAT + LAST_NODE:
        awaited = note_heartbeat(d, can_id - HEARTBEAT)
        return int64(Whose.ALL if awaited else Whose.OTHER)
    return int64(Whose.OURS if receive_pdo(d, can_id, dlc, data) else Whose.OTHER)


@loop_function
def is_own(d: Canopen, can_id: int) -> bool:
    """Return whether only this drive sends frames of this id."""
    if can_id == EMERGENCY + d.node or can_id == SDO_ANSWER + d.node:
        return True
    if can_id == HEARTBEAT + d.node:
        return True
    for p in range(PDOS, 2 * PDOS):  # noqa: SIM110  compiled
        if d.map_id[p] == can_id:
            return True
    return False


@loop_function
def work(d: Canopen) -> float:
    """Do a cycle; return the command."""
    if d.state.boots == 0:
        boot(d)
    if master_is_silent(d):
        lose_connection(d, ErrorCode.SILENCE)
    is_stopped = 1 if d.state.nmt == Heartbeat.STOPPED else 0
    if is_stopped != 0 and d.state.stopped_before == 0 and has_power(d.state.power):
        lose_connection(d, ErrorCode.BUS)
    d.state.stopped_before = is_stopped
    give_up(d)
    return advance(d)


@loop_function
def speak(d: Canopen) -> None:
    """Put into the outbox what is due at the end of a cycle."""
    beat(d)
    send_due(d)

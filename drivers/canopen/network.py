"""The drive in the network: commands of the NMT master, boot-up, heartbeats of both sides.

    state             SDO   PDO   emergency   heartbeat says
    BOOT_UP                                   0, once: then PRE_OPERATIONAL; or OPERATIONAL if
                                              object 0x1F80 is 8, self-starting
    PRE_OPERATIONAL   yes         yes         127
    OPERATIONAL       yes   yes   yes         5
    STOPPED                                   4

    0x000: command, node (0: all)   1 start, 2 stop, 128 pre-operational, 129 reset of the node,
                                    130 of its communication (objects 0x1000 to 0x1FFF)

The heartbeat of a master (0x1016: node << 16 | ms) that came once and then no more ends the
connection, see `drivers.canopen.power`. Source: CiA 301, 7.2.8 and 7.3.2.
"""

from pcpc.drivers.canopen.dictionary import is_possible
from pcpc.drivers.canopen.frames import HEARTBEAT, put_heartbeat
from pcpc.drivers.canopen.layout import SELF_STARTING, Canopen, Heartbeat, Od, OperationMode, Power
from pcpc.drivers.canopen.mapping import PDOS, arrange
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.drive.outbox import put

START, STOP, PREPARE, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
OF_COMMUNICATION = 0x1000, 0x1FFF


@loop_function
def boot(d: Canopen) -> None:
    """Say that the drive is there, and be in its first state."""
    x = d.state
    for p in range(2 * PDOS):
        arrange(d, p)
    x.nmt = Heartbeat.BOOT_UP
    put_heartbeat(d)
    x.nmt = (
        Heartbeat.OPERATIONAL if d.value[Od.STARTUP] == SELF_STARTING else Heartbeat.PRE_OPERATIONAL
    )
    x.heard = x.guarded = 0
    x.segment_row = 0
    x.boots += 1


@loop_function
def start_over(d: Canopen, all_objects: bool) -> None:
    """Give the objects their first values: all, or those of the communication; boot."""
    for i in range(d.n):
        index = d.objects[i].index
        if all_objects or OF_COMMUNICATION[0] <= index <= OF_COMMUNICATION[1]:
            d.value[i] = d.objects[i].start
    if all_objects:
        x = d.state
        x.power, x.mode, x.word_before, x.enabled = Power.NOT_READY, OperationMode.NONE, 0, 0
        x.homed, x.offset = 0, 0.0
        x.moves, x.pends, x.acknowledged = 0, 0, 0
    boot(d)


@loop_function
def command(d: Canopen, code: int) -> None:
    """Do what the NMT master wants."""
    x = d.state
    before = x.nmt
    if code == START:
        x.nmt = Heartbeat.OPERATIONAL
    elif code == STOP:
        x.nmt = Heartbeat.STOPPED
    elif code == PREPARE:
        x.nmt = Heartbeat.PRE_OPERATIONAL
    elif code == RESET_NODE:
        start_over(d, True)
    elif code == RESET_COMMUNICATION:
        start_over(d, False)
    if before != Heartbeat.OPERATIONAL and x.nmt == Heartbeat.OPERATIONAL:
        for t in range(PDOS):
            d.sent_at[t] = d.since_sync[t] = -1
            d.pending[t] = d.owed[t] = d.state.sync_at = 0


@loop_function
def beat(d: Canopen) -> None:
    """Send the heartbeat when it is due."""
    ms = d.value[Od.HEARTBEAT_MS]
    if ms > 0 and d.k - d.state.beat_at >= ms * 1e-3 * d.rate_hz:
        put_heartbeat(d)


@loop_function
def answer_guard(d: Canopen) -> None:
    """Answer a master that guards its nodes: the state, and a bit that toggles."""
    x = d.state
    put(d, HEARTBEAT + d.node, 1, x.nmt | x.guarded << int64(7), 0)
    x.guarded = 1 - x.guarded


@loop_function
def note_heartbeat(d: Canopen, node: int) -> bool:
    """Note the heartbeat of another node; return whether it is the one that is awaited."""
    if d.value[Od.CONSUMER] >> 16 == node and node != 0:
        d.state.heard, d.state.heard_at = 1, d.k
        return True
    return False


@loop_function
def master_is_silent(d: Canopen) -> bool:
    """Return whether the heartbeat that is awaited came once and is missing now."""
    ms = d.value[Od.CONSUMER] & 0xFFFF
    if ms == 0 or d.state.heard == 0:
        return False
    if d.k - d.state.heard_at <= ms * 1e-3 * d.rate_hz:
        return False
    d.state.heard = 0
    return True


@loop_function
def mode_to_be(d: Canopen) -> int:
    """Return the mode that is asked for, or the one before if it does not exist."""
    wanted = d.value[Od.MODE]
    return wanted if is_possible(d, Od.MODE, wanted) else d.state.mode

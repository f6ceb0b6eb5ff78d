"""What stands between the blocks' outputs and the wire, and belongs to no law.

finite   every output and every value to be sent is a finite number, else it is named and the
         node faults; a command keeps its last value
range    low <= command <= high
rate     |change| <= rate_per_s T a cycle, from the value sent before, also on a ramp and at
         the end of the run
begin    before the first valid input (state INIT) the executive's commands are their safe values
ramp     command = safe + gain (last - safe), gain falling from 1 to 0 by `pace` a cycle: as
         fast as the supervisor's ramp_s, or as slow as the slowest command's rate
reset    command = safe + gain (wanted - safe), gain rising; last is what it would be at gain 1
"""

from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Cells, int64
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import CommandLimits, Loop
from pcpc.executive.loop.rings import bits_of, push_event
from pcpc.executive.loop.states import RAMPS, SENDS
from pcpc.executive.loop.variables import CLAMPED, STATE

FINITE = 1e300  # from here on, and as NaN, a value counts as not finite


class Quick(NumberedEnum):
    """A quick stop, whose ramp is another one."""

    NONE, ASKED, BEGUN = range(3)


@loop_function
def find_not_finite(v: Cells[float], first: int, past: int) -> int:
    """Return the first of these places that holds no finite number, -1 for none."""
    not_finite = int64(0)
    for i in range(first, past):
        not_finite |= not abs(v[i]) < FINITE
    if not_finite != 0:
        for i in range(first, past):
            if not abs(v[i]) < FINITE:
                return int64(i)
    return int64(-1)


@loop_inline
def check_finite(n: Loop) -> bool:
    """Look at all outputs and at what is to be sent; note the first value that is not finite."""
    place = int64(-1)
    for b in range(n.blocks.n):
        if place < 0:
            place = find_not_finite(n.v, n.blocks.views[b].y, n.blocks.views[b].y_end)
    if place < 0:
        place = find_not_finite(n.v, n.tx.first, n.tx.past)
    if place >= 0 and n.control.odd_place == 0:
        n.control.odd_place = place + 1
        n.control.odd_cycle = n.k
        n.control.odd_bits = bits_of(n.v[place])
        push_event(n, Event.NOT_FINITE, place, n.v[place])
    return place >= 0


@loop_inline
def limit_commands(n: Loop) -> None:
    """Judge what is to be sent: finite or a fault; clamp, limit the rate, ramp to safe."""
    guard, table = n.guard, n.limits.table
    not_finite = check_finite(n)
    n.v[CLAMPED] = 0.0
    state = int64(n.v[STATE])
    waits = guard.safe_start != 0 and SENDS[state] == 0
    ramping = RAMPS[state] != 0 or guard.pace > 0.0
    rising = guard.gain < 1.0
    for i in range(n.limits.n):
        j = n.limits.place[i]
        wanted, last, safe = n.v[j], table[i].last, table[i].safe
        rate, sent = table[i].rate, table[i].sent
        if not abs(wanted) < FINITE:
            if guard.faulted == Fault.NONE:
                guard.faulted = Fault.COMMAND_NOT_FINITE
            wanted = last
        if waits:
            wanted = safe
        if ramping:
            wanted = guard.gain * last if safe == 0.0 else safe + guard.gain * (last - safe)
        elif rising:
            wanted = safe + guard.gain * (wanted - safe)
        value = min(max(wanted, table[i].low), table[i].high)
        value = min(max(value, sent - rate), sent + rate)
        table[i].sent = n.v[j] = value
        if ramping:
            continue
        if value != wanted:
            n.v[CLAMPED] = 1.0
            n.control.saturated += 1
        table[i].last = value
        if rising and guard.gain > 0.0:
            table[i].last = safe + (value - safe) / guard.gain
    if not_finite and guard.faulted == Fault.NONE:
        guard.faulted = guard.odd_output


@loop_function
def settled(limits: CommandLimits) -> bool:
    """Return whether every command may be its safe value in the next frame."""
    table = limits.table
    for i in range(limits.n):  # noqa: SIM110  compiled
        if abs(table[i].sent - table[i].safe) > table[i].rate:
            return False
    return True


@loop_inline
def quick_stop(n: Loop, fault: int) -> None:
    """Note a fault whose ramp is a quick stop, also if another fault came first."""
    if n.guard.faulted == Fault.NONE:
        n.guard.faulted = fault
    if n.guard.quick == Quick.NONE:
        n.guard.quick = Quick.ASKED


@loop_function
def begin_ramp(n: Loop, end_asked: bool) -> None:
    """Set the pace of the ramp by the slowest command; at an end nobody above is waited for."""
    guard, rx, table = n.guard, n.rx, n.limits.table
    guard.pace = guard.ramp_step
    if guard.quick != Quick.NONE:
        guard.pace, guard.quick = guard.quick_step, Quick.BEGUN
    for i in range(n.limits.n):
        way = abs(table[i].last - table[i].safe)
        if way * guard.pace > table[i].rate:
            guard.pace = table[i].rate / way
    if end_asked:
        rx.starters = 0
        rx.awaited = 0
        for row in range(rx.n):
            is_peers = int64(rx.role[row].peer != 0)  # it is the number of one of several plants
            rx.starters += rx.role[row].starts * is_peers
            rx.awaited += rx.role[row].awaited * is_peers

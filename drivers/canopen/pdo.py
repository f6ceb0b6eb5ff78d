"""Process data: what comes is taken at once or at the next SYNC, what goes is sent when it is due.

    transmission type   received              sent
    0                   at the next SYNC      at a SYNC, if it has changed
    1 to 240            at the next SYNC      at every n-th SYNC
    254, 255            at once               when it has changed, not within the inhibit time
                                              (0.1 ms); and at the event timer (ms)

A value outside of its object's bounds is not taken. A frame that is too short is an emergency,
0x8210, and not taken. Only in OPERATIONAL. Source: CiA 301, 7.2.2 and 7.5.2.35.
"""

from pcpc.drivers.can.codec import eight_bytes, four_bytes
from pcpc.drivers.canopen.dictionary import from_bits, is_possible, low_word, to_bits
from pcpc.drivers.canopen.frames import tell_error
from pcpc.drivers.canopen.layout import Canopen, ErrorCode, Heartbeat, Mistake, Od
from pcpc.drivers.canopen.mapping import (
    EVENT,
    INHIBIT,
    KIND,
    MAX_ENTRIES,
    PDOS,
    first_row,
)
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.drive.outbox import put

LAST_SYNC_KIND = 240


@loop_function
def bits_of(d: Canopen, p: int) -> int:
    """Return how many bits are mapped in a PDO."""
    bits = int64(0)
    for i in range(d.map_n[p]):
        bits += d.objects[d.map_row[p * MAX_ENTRIES + i]].bits
    return bits


@loop_function
def take(d: Canopen, p: int, word: int) -> None:
    """Write the data of a received PDO into its objects."""
    shift = int64(0)
    for i in range(d.map_n[p]):
        row = d.map_row[p * MAX_ENTRIES + i]
        raw = from_bits(d, row, word >> shift)
        od_object = d.objects[row]
        if od_object.low <= raw <= od_object.high and is_possible(d, row, raw):
            d.value[row] = raw
        else:
            d.mistakes[Mistake.VALUE_REFUSED] += 1
        shift += od_object.bits


@loop_function
def receive(d: Canopen, can_id: int, dlc: int, data: Cells[Byte]) -> bool:
    """Take a frame if it is a PDO; return whether it is one."""
    for p in range(PDOS):
        if d.map_id[p] == can_id:
            if d.state.nmt != Heartbeat.OPERATIONAL:
                d.mistakes[Mistake.PDO_EARLY] += 1
                return True
            if 8 * dlc < bits_of(d, p):
                d.mistakes[Mistake.PDO_SHORT] += 1
                tell_error(d, ErrorCode.PDO_SHORT, d.value[Od.ERROR_REGISTER])
            elif d.value[first_row(p) + KIND] <= LAST_SYNC_KIND:
                d.pending[p] = 1
                d.since_sync[p] = max(d.since_sync[p], 0) + 1
                d.pending_low[p] = low_word(four_bytes(data, 0))
                d.pending_high[p] = low_word(four_bytes(data, 4))
            else:
                take(d, p, eight_bytes(data, 0))
            return True
    return False


@loop_function
def judge_rates(d: Canopen) -> None:
    """Count what was wrong between the last two SYNCs: PDOs that come with them, and their time."""
    x, period = d.state, d.value[Od.SYNC_PERIOD] * 1e-6 * d.rate_hz
    off = abs(d.k - x.sync_at - period)
    if period > 0.0 and x.sync_at > 0 and off > max(0.5 * period, 1.0):
        d.mistakes[Mistake.SYNC_OFF] += 1
    x.sync_at = d.k
    for p in range(PDOS):
        if d.map_id[p] < 0 or d.value[first_row(p) + KIND] > LAST_SYNC_KIND:
            d.since_sync[p] = -1
        elif d.since_sync[p] >= 0:
            judge_count(d, p, d.since_sync[p] - 1)
            d.since_sync[p] = 0


@loop_inline
def judge_count(d: Canopen, p: int, more: int) -> None:
    """Count a PDO that came `more` than once, or not, unless it only changed sides with a SYNC.

    On a line a SYNC overtakes a PDO that is sent just before it: then one more follows one less.
    """
    other = d.owed[p]
    d.owed[p] = 0
    if other != 0 and other == -more:
        return
    d.mistakes[Mistake.PDO_MISSING] += 1 if other < 0 else 0
    d.mistakes[Mistake.PDO_TWICE] += 1 if other > 0 or more > 1 else 0
    if more == -1 or more == 1:
        d.owed[p] = more


@loop_function
def hear_sync(d: Canopen) -> None:
    """Take what waited for a SYNC; let be due what is sent with it."""
    if d.state.nmt != Heartbeat.OPERATIONAL:
        return
    d.state.syncs += 1
    judge_rates(d)
    for p in range(PDOS):
        if d.pending[p] != 0:
            d.pending[p] = 0
            take(d, p, d.pending_low[p] | d.pending_high[p] << 32)


@loop_function
def is_due(d: Canopen, t: int, changed: bool) -> bool:
    """Return whether the sent PDO `t` goes out in this cycle."""
    first = first_row(PDOS + t)
    kind, since = d.value[first + KIND], d.k - d.sent_at[t]
    fresh = d.sent_at[t] < 0
    if kind <= LAST_SYNC_KIND:
        d.sync_count[t] += d.state.syncs
        if d.state.syncs == 0:
            return False
        if kind == 0:
            return changed or fresh
        return d.sync_count[t] >= kind
    if fresh:
        return True
    inhibit, timer = d.value[first + INHIBIT], d.value[first + EVENT]
    if changed and since >= inhibit * 1e-4 * d.rate_hz:
        return True
    return timer > 0 and since >= timer * 1e-3 * d.rate_hz


@loop_function
def send_due(d: Canopen) -> None:
    """Send the PDOs that are due in this cycle."""
    if d.state.nmt == Heartbeat.OPERATIONAL:
        for t in range(PDOS):
            p = PDOS + t
            if d.map_id[p] < 0 or d.map_n[p] == 0:
                continue
            word, shift = int64(0), int64(0)
            for i in range(d.map_n[p]):
                row = d.map_row[p * MAX_ENTRIES + i]
                word |= int64(to_bits(d, row)) << shift
                shift += d.objects[row].bits
            low, high = low_word(word), low_word(word >> int64(32))
            if is_due(d, t, low != d.sent_low[t] or high != d.sent_high[t]):
                d.sent_low[t], d.sent_high[t] = low, high
                d.sent_at[t] = d.k
                d.sync_count[t] = 0
                put(d, d.map_id[p], shift // 8, low, high)
    d.state.syncs = 0

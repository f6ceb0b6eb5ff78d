"""A CAN line as a pure model: who sends when, bit by bit, and what errors do. No clock; ticks.

    tick       of `drivers.line.ticks`: a bit, or less with the second bit rate of CAN FD        (0)
    start      at the first bit at which the line is idle and a frame waits; the lowest id of what
               waits then wins, and keeps the line to its end                                    (1)
    length     of the frame's real bits (`stuffing`, `fd_stuffing`), then 3 of intermission      (2)
    error      a bit is flipped: the sender's error flag begins at the next one, at the nominal bit
               rate. How long it and those of the receivers last say `error_flags`; then 8 bits of
               delimiter, 3 of intermission, and the frame comes again                           (3)
    counters   sender: error + 8, sent - 1. Receivers: error + 1, received - 1, from above 127 to
               127. Passive above 127: its flags are recessive and it lets others go first for 8
               bits after sending. Bus off above 255: what waits is lost                         (4)
    recovery   of bus off: 128 times 11 recessive bits, both counters 0                          (5)
    alone      nobody acknowledges: an error in the ACK slot; passive among passive not counted  (6)
    passive    a sender has ESI in its FD frames                                                 (7)
    odd        a receiver of another bit rate than the sender's samples at 3/4 of its own bits; it
               flags the sixth equal one, at the latest the ACK slot. Passive it lets the frame be.
               It never acknowledges, and counts an error for each frame                         (8)

Each sender is one controller with a transmit queue of `room` frames, the most urgent first, or
`in_order` the oldest first. A frame more than that is refused, as by ENOBUFS. Errors are drawn:
each bit is hit with probability `p`; after a hit the next transmission is hit too with 1 - 1/burst.

Left out: two senders of one id in the same bit (the first sender wins), a hit in the last bit of
EOF (the frame would come twice), errors of one receiver alone but for (8), in which nobody
synchronises again behind SOF, overload frames. All hits count as errors of the sender, also in the
arbitration field. Source: ISO 11898-1:2015, 10.4, 10.11, 12.1.
"""

from collections.abc import Mapping

from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, Flag
from pcpc.drivers.compiled.structures import copy, structure
from pcpc.drivers.line.error_flags import flag_ticks
from pcpc.drivers.line.fd_stuffing import Place, encode_fd
from pcpc.drivers.line.line_layout import MOST_ROOM as MOST_ROOM
from pcpc.drivers.line.line_layout import SENDERS as SENDERS
from pcpc.drivers.line.line_layout import Line as Line
from pcpc.drivers.line.stuffing import EOF_BITS, INTERMISSION_BITS, encode
from pcpc.drivers.line.ticks import MOST_TICKS, ticks_of, ticks_per_s

WARNING_AT, PASSIVE_AT, OFF_AT = 96, 128, 256  # of the higher counter; bus off by that of sending
RECESSIVE_RUN, RUNS_TO_RECOVER = 11, 128
SUSPENDED_BITS, DELIMITER_BITS = 8, 8
_PRIME, _FACTOR = 2**31 - 1, 48271  # Park and Miller's generator, as `executive.loop.draws`
_NEVER = 2**62


class Outcome(NumberedEnum):
    """What happens next on a line."""

    NOTHING, SENT, ERROR, BUS_OFF, RECOVERED = range(5)


class SenderState(NumberedEnum):
    """The state of a sender."""

    ACTIVE, WARNING, PASSIVE, OFF = range(4)


N = structure(Line.dtype)


def prepare(
    line: Line,
    senders: int,
    room: int = 64,
    *,
    bitrate: int = 1,
    data_bitrate: int | None = None,
    in_order: bool = False,
    p: float = 0.0,
    burst: float = 1.0,
    seed: int = 1,
    others: Mapping[int, int] | None = None,
) -> None:
    """Fill the zeroed Line record `line`; ValueError for wrong `senders` or `room`, or rates (0).

    Bit rates in bit/s; without the second one FD frames do not switch theirs. `others`: those of
    senders that have another one.
    """
    if not 1 <= senders <= SENDERS or not 1 <= room <= MOST_ROOM:
        raise ValueError(f"{senders} senders with room for {room}: at most {SENDERS}, {MOST_ROOM}")
    rates = dict.fromkeys(range(senders), bitrate) | dict(others or {})
    per_s = ticks_per_s(bitrate, data_bitrate, rates.values())
    if per_s > MOST_TICKS:
        raise ValueError(f"{bitrate} and {data_bitrate} bit/s: no common tick")
    for s, rate in rates.items():
        line.own_bit[s] = per_s // rate
    line.senders, line.room, line.in_order = senders, room, in_order
    line.per_s, line.bit, line.fast = per_s, per_s // bitrate, per_s // (data_bitrate or bitrate)
    line.p, line.burst, line.draw = p, burst, 1 + seed % (_PRIME - 1)
    line.sending = -1


@loop_inline
def urgency_of(frame: Cells[Byte]) -> int:
    """Return what arbitration compares, the lowest wins: 11 bits of id, RTR or SRR, IDE, the rest.

    A long id loses against the short one that begins like it.
    """
    word = int64(0)
    for i in range(4):
        word |= int64(frame[i]) << (8 * i)
    if word >> 31 != 0:
        return ((word >> 18) & 0x7FF) << 19 | 1 << 18 | (word & 0x3FFFF)
    return (word & 0x7FF) << 19


@loop_function
def put(line: Line, s: int, frame: Cells[Byte], tick: int) -> bool:
    """Queue `frame` of sender `s` at `tick`; return False if it is lost.

    `tick` is not before the last `until` of `advance`.
    """
    if line.off[s] != 0:
        line.lost_off[s] += 1
        return False
    k = line.waiting[s]
    if k >= line.room:
        line.refused[s] += 1
        return False
    copy(line.frames[s * MOST_ROOM + k], frame)
    line.urgency[s, k] = urgency_of(frame)
    line.since[s, k] = tick
    line.waiting[s] = k + 1
    line.most_waiting[s] = max(line.most_waiting[s], k + 1)
    return True


@loop_function
def advance(line: Line, until: int) -> int:
    """Return what happens next up to tick `until`, NOTHING if nothing does; call until then.

    A frame begins only before `until`: all that is queued by then must have been put.
    """
    if line.sending < 0:
        begin = _next_begin(line)
        if _recovers(line, min(begin, until)):
            return Outcome.RECOVERED
        if begin >= until:
            return Outcome.NOTHING
        _begin(line, begin)
    if line.due > until:
        return Outcome.NOTHING
    line.who, line.at = line.sending, line.due
    line.sending = -1
    if line.hit >= 0:
        return _fail(line, line.who)
    _succeed(line, line.who)
    return Outcome.SENT


@loop_function
def close(line: Line, tick: int) -> None:
    """Let what waits at `tick`, up to which `advance` went, begin: nothing more comes for it."""
    if line.sending < 0 and _next_begin(line) <= tick:
        _begin(line, tick)


@loop_function
def next_due(line: Line) -> int:
    """Return until when `advance` returns NOTHING if nothing more is put; 2^62 for ever."""
    if line.sending >= 0:
        return line.due
    due = _next_begin(line) + 1
    for s in range(line.senders):
        if line.off[s] != 0:
            due = min(due, line.recessive_since + _run_ticks(line) * line.runs_left[s])
    return min(due, int64(_NEVER))


@loop_inline
def passive(line: Line, s: int) -> bool:
    """Return whether a sender is error passive."""
    return max(line.transmit_errors[s], line.receive_errors[s]) >= PASSIVE_AT


@loop_function
def state_of(line: Line, s: int) -> int:
    """Return ACTIVE, WARNING, PASSIVE or OFF."""
    if line.off[s] != 0:
        return SenderState.OFF
    if passive(line, s):
        return SenderState.PASSIVE
    worse = max(line.transmit_errors[s], line.receive_errors[s]) >= WARNING_AT
    return SenderState.WARNING if worse else SenderState.ACTIVE


@loop_inline
def _ready(line: Line, s: int) -> int:
    """Return the first tick at which a sender can begin (1)."""
    if line.waiting[s] == 0:
        return int64(_NEVER)
    return max(line.free_at, line.since[s, 0], line.not_before[s])


@loop_function
def _next_begin(line: Line) -> int:
    begin = int64(_NEVER)
    for s in range(line.senders):
        begin = min(begin, _ready(line, s))
    return begin


@loop_function
def _begin(line: Line, begin: int) -> None:
    """Let the most urgent frame of those that are ready begin (1)."""
    least = int64(_NEVER)
    for s in range(line.senders):
        if _ready(line, s) <= begin:
            for k in range(1 if line.in_order != 0 else line.waiting[s]):
                if line.since[s, k] <= begin and line.urgency[s, k] < least:
                    least = line.urgency[s, k]
                    line.sending, line.entry = s, k
    line.who = line.sending
    run = (begin - line.recessive_since) // _run_ticks(line)
    for s in range(line.senders):
        line.runs_left[s] -= run * line.off[s]
    copy(line.frame, line.frames[line.sending * MOST_ROOM + line.entry])
    if line.busy == 0:
        line.first = begin
    line.begin = begin
    if line.frame[FLAGS] & Flag.FD != 0:
        if passive(line, line.sending):
            line.frame[FLAGS] |= Flag.ESI  # (7)
        line.length = encode_fd(line.frame, line.raw, line.wire, line.places)
    else:
        line.places[Place.FAST] = line.places[Place.FAST_END] = line.places[Place.FIXED] = 0
        line.length = encode(line.frame, line.raw, line.wire)
    line.hit = _flipped_bit(line)
    wrong = _slot(line) if _listeners(line) == 0 else int64(_NEVER)  # (6)
    for s in range(line.senders):
        if line.off[s] == 0 and not hears(line, s) and not passive(line, s):
            wrong = min(wrong, _misread_bit(line, s))  # (8)
    if wrong < line.length and (line.hit < 0 or line.hit > wrong):
        line.hit = wrong
    lasts = ticks_of(line, line.length if line.hit < 0 else line.hit + 1)
    line.due = begin + lasts * line.own_bit[line.sending] // line.bit


@loop_inline
def _run_ticks(line: Line) -> int:
    return RECESSIVE_RUN * line.bit


@loop_inline
def _slot(line: Line) -> int:
    """Return the place of the ACK slot."""
    return line.length - EOF_BITS - 2


@loop_inline
def hears(line: Line, s: int) -> bool:
    """Return whether sender `s` has the bit rate of the frame that is, or was last, on the line."""
    return bool(line.own_bit[s] == line.own_bit[line.who])


@loop_function
def _misread_bit(line: Line, s: int) -> int:
    """Return the bit of the frame in which `s`, of another bit rate, finds it wrong (8)."""
    slot, run, last = _slot(line), int64(0), int64(-1)
    tick = 3 * line.own_bit[s] // 4
    sampled = tick // line.own_bit[line.sending]
    while sampled < slot:
        run = run + 1 if line.wire[sampled] == last else int64(1)
        if run > 5:
            return sampled
        last = int64(line.wire[sampled])
        tick += line.own_bit[s]
        sampled = tick // line.own_bit[line.sending]
    return slot


@loop_inline
def _listeners(line: Line) -> int:
    """Return how many hear the frame that is on the line."""
    count = int64(-1)
    for s in range(line.senders):
        count += line.off[s] == 0 and hears(line, s)
    return count


@loop_inline
def _uniform(line: Line) -> float:
    line.draw = line.draw * _FACTOR % _PRIME
    return line.draw / _PRIME


@loop_function
def _flipped_bit(line: Line) -> int:
    """Draw which bit of the frame is flipped, -1 for none."""
    if line.p <= 0.0:
        return int64(-1)
    u = _uniform(line)
    if line.hit_before != 0:
        again = 1.0 - 1.0 / line.burst
        if u < again:
            return int64(u / again * (line.length - 1))
        u = (u - again) / (1.0 - again)
    clear = 1.0  # the probability that nothing was hit so far
    for i in range(line.length - 1):
        clear *= 1.0 - line.p
        if u >= clear:
            return int64(i)
    return int64(-1)


@loop_function
def _rest(line: Line, free_at: int, recessive: int) -> None:
    """Note the end of a transmission, and that its last `recessive` ticks were so."""
    line.busy += free_at - line.begin
    line.free_at, line.recessive_since = free_at, free_at - recessive


@loop_inline
def _more(line: Line, r: int) -> int:
    """Return the receive error counter of `r` behind an error more."""
    return min(line.receive_errors[r] + 1, 2 * PASSIVE_AT - 1)


@loop_function
def _succeed(line: Line, s: int) -> None:
    line.hit_before = 0
    line.sent[s] += 1
    line.waited = line.at - line.since[s, line.entry]
    line.longest[s] = max(line.longest[s], line.waited)
    _remove_queued(line, s, line.entry)
    end = 1 + EOF_BITS + INTERMISSION_BITS
    _rest(line, line.at + INTERMISSION_BITS * line.bit, end * line.bit)
    if passive(line, s):
        line.not_before[s] = line.free_at + SUSPENDED_BITS * line.bit
    line.transmit_errors[s] = max(line.transmit_errors[s] - 1, 0)  # (4)
    for r in range(line.senders):
        if r != s and line.off[r] == 0:
            fewer = max(min(line.receive_errors[r], int64(PASSIVE_AT)) - 1, int64(0))
            line.receive_errors[r] = fewer if hears(line, r) else _more(line, r)


@loop_function
def _fail(line: Line, s: int) -> int:
    """Send the error frame (3), count (4); return ERROR or BUS_OFF."""
    alone, was_passive = _listeners(line) == 0, passive(line, s)
    line.hit_before = 1
    line.errors[s] += 1
    flag = flag_ticks(line, int64(was_passive), alone)
    end = (DELIMITER_BITS + INTERMISSION_BITS) * line.bit
    silent = was_passive
    for r in range(line.senders):
        if r != s and line.off[r] == 0:
            silent = silent and passive(line, r)
            line.receive_errors[r] = _more(line, r)
    _rest(line, line.at + flag + end, end + (flag if silent else int64(0)))
    if not (alone and silent and line.hit == _slot(line)):  # (6)
        line.transmit_errors[s] += 8
    line.worst[s] = max(line.worst[s], line.transmit_errors[s])
    if line.transmit_errors[s] >= OFF_AT:
        line.off[s], line.runs_left[s] = 1, RUNS_TO_RECOVER
        line.times_off[s] += 1
        line.lost_off[s] += line.waiting[s]
        line.waiting[s] = 0
        return Outcome.BUS_OFF
    if passive(line, s):
        line.not_before[s] = line.free_at + SUSPENDED_BITS * line.bit
    return Outcome.ERROR


@loop_function
def _remove_queued(line: Line, s: int, k: int) -> None:
    """Close the gap that a frame leaves in its queue."""
    line.waiting[s] -= 1
    for i in range(k, line.waiting[s]):
        copy(line.frames[s * MOST_ROOM + i], line.frames[s * MOST_ROOM + i + 1])
        line.urgency[s, i] = line.urgency[s, i + 1]
        line.since[s, i] = line.since[s, i + 1]


@loop_function
def _recovers(line: Line, until: int) -> bool:
    """Return whether a sender that is off comes back up to tick `until` of an idle line (5)."""
    for s in range(line.senders):
        tick = line.recessive_since + _run_ticks(line) * line.runs_left[s]
        if line.off[s] != 0 and tick <= until:
            line.off[s] = line.transmit_errors[s] = line.receive_errors[s] = 0
            line.who, line.at = s, tick
            return True
    return False

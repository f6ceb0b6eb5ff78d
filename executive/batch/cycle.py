"""The cycle of two nodes for WIDTH runs at once, in the order and with the bits of a single run.

One run is `executive.loop.cycle` and `executive.loop.exchange`. Here are the same steps for what
lasts from the meeting of the nodes to the end of a run without a fault: no clock, no ring, no CRC,
since nothing disturbs the bytes; a frame is the rounded codes of its signals.

    supervise   INIT, READY, RUN, HOLD by what is missing
    tune        the rig's own schedule
    step        the blocks, each once for all runs
    limit       carry, clamp, limit the rate of what is sent
    transmit    the frames that are due: encode, draw the loss, decode at the other node
    keep        the traces that somebody wants

What lanes share with a single run is what has no branch by run: the LOOP record with its tables and
wiring, the declarations of states and counters, the stages of the blocks, the constants of draws.
The steps above stand here a second time because in a single run they branch: `if` skips work there
and is `where` here, for which values of all runs are computed; written as `where` for both, a
single run would do all of it in every cycle.

A run that leaves this path (a fault, a value that is no finite number, a command that is not yet
safe at the end, a counter that wraps) is marked ODD: its numbers are void from there on, and
`executive.batch.runs` does it alone. So no reaction to a fault stands here a second time.

A SEAT is a node: `n` its LOOP record, read for its tables; `values` a LANE each: first those of the
table of variables, then EXTRA, then some of each limit and of each received frame. `heard_as` is
the row of the other node for each frame sent, -1 where nobody listens.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import e2e
from pcpc.drivers.can.dbc import Protection, SignalKind
from pcpc.drivers.compiled.jit import OPTIONS, inline, njit
from pcpc.drivers.compiled.lanes import WIDTH, Lane, Mask, in_single
from pcpc.drivers.compiled.records import Cells
from pcpc.drivers.compiled.stage import call, part
from pcpc.drivers.compiled.views import Array, lane_rows
from pcpc.executive.laws.emath import ROUND, where
from pcpc.executive.loop import draws
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.control import COUNTERS
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.limits import FINITE
from pcpc.executive.loop.states import HEARTBEATS, State
from pcpc.executive.loop.variables import (
    CLAMPED,
    COUNTERS_AT,
    MISSING,
    NMT,
    STATE,
    T_S,
    WALL,
)

ODD, COMPLETE, SENT, RECEIVED, LOST, SATURATED, ON_PURPOSE, HELD, STALE = range(9)
SEED, IN_LOSS, GAP, HEARD = range(4)
EXTRA, OF_FRAME = 9, 4  # how many there are of each; of a limit, one: the value sent
_ROW_OF = {
    "sent": SENT, "received": RECEIVED, "lost": LOST, "saturated": SATURATED,
    "lost_on_purpose": ON_PURPOSE, "held": HELD, "stale": STALE,
}  # fmt: skip
_COUNTED = np.array(  # the row of EXTRA for each of COUNTERS; -1: none is ever counted
    [_ROW_OF.get(word, -1) for word, *_ in COUNTERS]
)
_PASSES_AT = COUNTERS_AT + [word for word, *_ in COUNTERS].index("passes")
_TWO_52 = 2.0**52
_OPTIONS = OPTIONS | {"_nrt": False}  # nothing is allocated: counting references is 4 % of a run
_PRIME, _FACTOR = float(draws.PRIME), float(draws.FACTOR)


class Seat(NamedTuple):
    """A node of a batch, see the module; `trace` (cycles, wanted, lanes) keeps `wanted` rows."""

    n: Loop
    values: NDArray[np.float64]
    steps: NDArray[np.int64]
    heard_as: NDArray[np.int64]
    wanted: NDArray[np.int64]
    trace: NDArray[np.float64]


def rows_of(loop: Loop) -> int:
    """Return how many rows the values of a seat have."""
    return int(loop.n_variables + EXTRA + loop.limits.n + OF_FRAME * loop.rx.n)


@inline
def of_limit(n: Loop, i: int) -> int:
    """Return the row of the value that was sent last under limit `i`."""
    return n.n_variables + EXTRA + i


@inline
def of_frame(n: Loop, row: int) -> int:
    """Return the row of the first value of received frame `row`."""
    return of_limit(n, n.limits.n) + OF_FRAME * row


@inline
def number(answer: Mask) -> Lane:
    """Return 1 where it is true, else 0."""
    return where(answer, 1.0, 0.0)


@inline
def add(n: Loop, w: Cells[Lane], which: int, amount: Lane) -> None:
    """Count."""
    w[n.n_variables + which] = w[n.n_variables + which] + amount


# ---------------------------------------------------------------------------------------- supervise


@inline
def supervise(n: Loop, w: Cells[Lane]) -> None:
    """Count what is missing and advance the states; a fault is odd."""
    own, before = n.n_variables, w[STATE]
    complete, running = w[own + COMPLETE] > 0.5, w[STATE] >= float(State.RUN)
    w[own + COMPLETE] = 1.0
    missing = where(complete, 0.0, w[MISSING] + 1.0)
    held = running & ~complete
    add(n, w, HELD, number(held))
    add(n, w, STALE, number(held & (missing > float(n.guard.hold_cycles))))
    silent = (before != float(State.INIT)) & (missing >= float(n.guard.fault_after))
    add(n, w, ODD, number(silent))
    forth = where(before == float(State.INIT), float(State.READY), float(State.RUN))
    state = where(complete, forth, where(running, float(State.HOLD), before))
    w[STATE], w[MISSING] = state, missing
    w[NMT] = where(state < float(State.RUN), HEARTBEATS[State.INIT], HEARTBEATS[State.RUN])


@inline
def tune(n: Loop, w: Cells[Lane], k: int) -> None:
    """Apply the rig's tunings whose time has come."""
    tuning = n.tuning
    while tuning.done < tuning.n and tuning.schedule[tuning.done].cycle <= k:
        w[tuning.schedule[tuning.done].place] = tuning.value[tuning.done]
        tuning.done += 1


# --------------------------------------------------------------------------------------------- step


@inline
def carry(n: Loop, w: Cells[Lane], block: int) -> None:
    """Carry the wired variables into the inputs of `block` (MAX_BLOCKS: into what is sent)."""
    first = n.blocks.copies_end[block - 1] if block > 0 else 0
    for i in range(first, n.blocks.copies_end[block]):
        w[n.blocks.copies[i].target] = w[n.blocks.copies[i].source]


@inline
def step(
    n: Loop,
    w: Cells[Lane],
    values: Array,
    width: int,
    steps: Cells[int],
    k: int,
) -> None:
    """Step every block at time k T, `width` runs at once: WIDTH lanes of `values`, or one."""
    dt = n.clock.period_ns * 1e-9
    t = k * dt
    w[T_S] = t
    for b in range(n.blocks.n):
        if b == n.blocks.fallback:
            continue
        carry(n, w, b)
        at = n.blocks.views[b]
        p, x = part(values, width * at.p), part(values, width * at.x)
        u, y = part(values, width * at.u), part(values, width * at.y)
        n.control.stepping = b + 1  # for `executive.nodes.watched`
        call(steps[b], t, dt, p, x, u, y)
    n.control.stepping = 0


# -------------------------------------------------------------------------------------------- limit


@inline
def look_for_odd(n: Loop, w: Cells[Lane], first: int, past: int) -> None:
    """Mark runs in which one of these values is no finite number."""
    odd = w[n.n_variables + ODD]
    for i in range(first, past):
        odd = where(abs(w[i]) < FINITE, odd, 1.0)
    w[n.n_variables + ODD] = odd


@inline
def limit(n: Loop, w: Cells[Lane]) -> None:
    """Carry the outputs into what is sent; clamp them and limit their rate."""
    carry(n, w, sh.MAX_BLOCKS)
    for b in range(n.blocks.n):
        look_for_odd(n, w, n.blocks.views[b].y, n.blocks.views[b].y_end)
    look_for_odd(n, w, n.tx.first, n.tx.past)
    w[CLAMPED] = 0.0
    table, waits = n.limits.table, w[STATE] == float(State.INIT)
    for i in range(n.limits.n):
        j, place = n.limits.place[i], of_limit(n, i)
        wanted, sent, rate = where(waits, table[i].safe, w[j]), w[place], table[i].rate
        value = clamp(wanted, table[i].low, table[i].high)
        value = clamp(value, sent - rate, sent + rate)
        clamped = value != wanted
        w[CLAMPED] = where(clamped, 1.0, w[CLAMPED])
        add(n, w, SATURATED, number(clamped))
        w[j], w[place] = value, value


@inline
def clamp(value: Lane, low: Lane, high: Lane) -> Lane:
    """Return min(max(value, low), high) as of a single run: of equals, the first."""
    above = where(value < low, low, value)
    return where(above > high, high, above)


@inline
def mark_unsettled(n: Loop, w: Cells[Lane]) -> None:
    """Mark runs at whose end a command may not be safe at once: they go on for a ramp."""
    for i in range(n.limits.n):
        way = abs(w[of_limit(n, i)] - n.limits.table[i].safe)
        add(n, w, ODD, number(way > n.limits.table[i].rate))


@inline
def end(n: Loop, w: Cells[Lane]) -> None:
    """Be in STOP, every command safe."""
    w[STATE], w[NMT] = float(State.STOP), HEARTBEATS[State.STOP]
    carry(n, w, sh.MAX_BLOCKS)
    for i in range(n.limits.n):
        w[n.limits.place[i]] = n.limits.table[i].safe


# ----------------------------------------------------------------------------------------- transmit


@inline
def survives(m: Loop, z: Cells[Lane], row: int) -> Mask:
    """Return in which runs a frame of `row` is used, by its loss and its counter."""
    if m.rx.loss[row].enter <= 0.0:
        add(m, z, RECEIVED, 1.0)
        return z[m.n_variables + ODD] == z[m.n_variables + ODD]
    place = of_frame(m, row)
    s = z[place + SEED] * _FACTOR
    s = s - (s * (1.0 / _PRIME) + ROUND - ROUND) * _PRIME
    s = where(s < 0.0, s + _PRIME, s)
    lost = z[place + IN_LOSS] > 0.5
    turns = s / _PRIME < where(lost, m.rx.loss[row].leave, m.rx.loss[row].enter)
    lost = (lost & ~turns) | (turns & ~lost)
    gap = where(z[place + HEARD] > 0.5, z[place + GAP] + 1.0, 1.0)  # since the last one
    z[place + SEED], z[place + IN_LOSS] = s, number(lost)
    used, protected = ~lost, m.rx.frames[row].protected != Protection.UNPROTECTED
    if protected:
        used = used & (gap <= float(e2e.MAX_DELTA))
        add(m, z, ODD, number(gap > float(m.rx.frames[row].counter_mask)))
        add(m, z, LOST, where(lost, 0.0, gap - 1.0))
    z[place + GAP], z[place + HEARD] = where(lost, gap, 0.0), where(lost, z[place + HEARD], 1.0)
    add(m, z, RECEIVED, number(used))
    add(m, z, ON_PURPOSE, number(lost))
    return used


@inline
def encoded(n: Loop, w: Cells[Lane], i: int) -> tuple[Lane, Mask]:
    """Return the raw value of signal `i` of what is sent, and where it saturated."""
    signal = n.tx.signals[i]
    kind, low, high = signal.kind, signal.code_low, signal.code_high
    code = w[signal.variable]
    code = (code - signal.offset) / signal.factor
    if kind < SignalKind.FLOAT_32:
        size = abs(code)
        size = where(size < _TWO_52, (size + _TWO_52) - _TWO_52, size)
        code = where(code < 0.0, -size, size)
    void = code != code
    outside = void | (code < low) | (code > high)
    code = where(void, 0.0, where(code < low, low, where(code > high, high, code)))
    if kind == SignalKind.FLOAT_32:
        return in_single(code), outside
    return (code + 0.0 if kind < SignalKind.FLOAT_32 else code), outside


@inline
def decoded(m: Loop, i: int, code: Lane) -> Lane:
    """Return the value of signal `i` of what is received."""
    signal = m.rx.signals[i]
    factor, offset, whole = signal.factor, signal.offset, signal.kind < SignalKind.FLOAT_32
    return code * factor + offset if whole or factor != 1.0 or offset != 0.0 else code


@inline
def send(n: Loop, w: Cells[Lane], row: int, m: Loop, z: Cells[Lane], to: int) -> None:
    """Send the frame of `row`; the other node hears it as `to`, or not (-1)."""
    used = z[m.n_variables + ODD] == z[m.n_variables + ODD]
    if to >= 0:
        used = survives(m, z, to)
        if m.rx.role[to].awaited != 0:
            z[m.n_variables + COMPLETE] = where(used, z[m.n_variables + COMPLETE], 0.0)
    first = n.tx.frames[row].first
    for i in range(first, n.tx.frames[row].end):
        code, outside = encoded(n, w, i)
        w[CLAMPED] = where(outside, 1.0, w[CLAMPED])
        add(n, w, SATURATED, number(outside))
        if to >= 0:
            j = m.rx.frames[to].first + i - first
            place = m.rx.signals[j].variable
            z[place] = where(used, decoded(m, j, code), z[place])
    add(n, w, SENT, 1.0)


@inline
def transmit(
    n: Loop, w: Cells[Lane], heard_as: Cells[int], m: Loop, z: Cells[Lane], k: int
) -> None:
    """Send what is due, in the order of the rows."""
    for row in range(n.tx.n):
        if k % n.tx.frames[row].every_n == 0:
            send(n, w, row, m, z, heard_as[row])


# ------------------------------------------------------------------------------------------ the run


@inline
def keep(n: Loop, w: Cells[Lane], seat: Seat, k: int) -> None:
    """Write the counters to the table, and the traces of this cycle."""
    for i in range(_COUNTED.shape[0]):
        if _COUNTED[i] >= 0:
            w[COUNTERS_AT + i] = w[n.n_variables + _COUNTED[i]]
    w[_PASSES_AT] = float(k)
    w[WALL] = 1e-9 * (k * n.clock.period_ns)
    trace = lane_rows(seat.trace)
    first = k * seat.wanted.shape[0]
    for i in range(seat.wanted.shape[0]):
        trace[first + i] = w[seat.wanted[i]]


@njit(**_OPTIONS)
def one_pass(seat: Seat, k: int, other: Seat) -> None:
    """Do cycle `k` of a node, whose frames go to the other one."""
    n, w = seat.n, lane_rows(seat.values)
    n.control.passes = k
    supervise(n, w)
    tune(n, w, k)
    step(n, w, seat.values, WIDTH, seat.steps, k)
    limit(n, w)
    transmit(n, w, seat.heard_as, other.n, lane_rows(other.values), k)
    keep(n, w, seat, k)


@njit(**_OPTIONS)
def advance(top: Seat, low: Seat, first: int, past: int) -> None:
    """Do the executive's cycles from `first` on, each followed by the plant's for the next one."""
    if first == 0:
        one_pass(low, 0, top)
    for k in range(first, past):
        one_pass(top, k, low)
        one_pass(low, k + 1, top)


@njit(**_OPTIONS)
def finish(top: Seat, low: Seat, cycles: int) -> None:
    """Mark the runs that go on after their last cycle, or whose plant is not told of the end."""
    n, m = top.n, low.n
    w, z = lane_rows(top.values), lane_rows(low.values)
    mark_unsettled(n, w)
    end(n, w)
    transmit(n, w, top.heard_as, m, z, cycles)
    told = z[m.guard.mode_index] == float(State.STOP)
    add(m, z, ODD, where(told, 0.0, 1.0))

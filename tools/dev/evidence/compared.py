"""The copies of the safety code, and what they are compared with: drawn inputs, expected outputs.

Half of the inputs are just on a limit: whole multiples of what a command may change, counters at
the edge, values between two codes of a signal. The copies have all mutants in them; number 0 is
the code as it is.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import dbc, e2e
from pcpc.drivers.compiled.rows import FRAME
from pcpc.executive.loop.clock import Time, Trigger
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.tools.dev.evidence import expected
from pcpc.tools.dev.evidence.episodes import Episodes

AT, OUTPUTS, WATCHED, ESTOP, MODE = 100, 102, 105, 106, 107  # places in the table
NOT_FINITE = Event.NOT_FINITE  # the event that carries a value
SEED = 16
EPISODES, CYCLES, FRAMES = 200, 80, 10_000
FEW = 40  # episodes of code that is not compiled
DRIVER = """
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.variables import DISARMED, ERROR_CODE, FAULT, RESET_ASKED, STOP_ASKED


@loop_function
def supervised(_m, n, whole, values, told):
    for s in range(whole.shape[0]):
        n.k = whole[s, 0]
        n.rx.fresh = whole[s, 1]
        n.rx.started = 1
        n.wire.muted = 1
        if n.guard.faulted == 0:
            n.guard.faulted = whole[s, 2]
        n.control.stop = max(n.control.stop, whole[s, 3])
        for i in range(2):  # a fault on purpose took both
            n.faults.spoiled[i] = n.faults.on_wire[i].fresh = whole[s, 7]
        for i in range(3):
            if i > 0 or whole[s, 1] > 0:
                n.v[105 + i] = values[s, 4 + i]
        m_supervise(_m, n)
        n.v[RESET_ASKED] = whole[s, 4]
        n.v[STOP_ASKED] = whole[s, 5]
        if whole[s, 6] >= 0:
            n.v[DISARMED] = values[s, 7]
        m_hear_requests(_m, n)
        for i in range(4):
            n.v[100 + i] = values[s, i]
        m_limit_commands(_m, n)
        t, guard, control, put = told[s], n.guard, n.control, n.event_ends.head
        last = n.event[(put - 1) % sh.EVENT_RING_ROWS]
        t[0], t[1], t[2], t[3] = n.v[1], n.v[3], n.v[4], n.v[5]
        t[4], t[5], t[6] = guard.pace, n.v[100], n.v[101]
        t[7], t[8] = n.limits.table[0].last, n.limits.table[1].last
        t[9], t[10] = n.v[7], n.v[105]
        t[11], t[12], t[13] = control.held, control.stale, control.saturated
        t[14], t[15] = guard.faulted, control.fault
        t[16], t[17], t[18] = control.odd_place, control.odd_cycle, put
        t[19], t[20] = last.code if put > 0 else 0, last.argument if put > 0 else 0
        t[21], t[22], t[23] = n.rx.awaited, guard.reset, guard.stop
        t[24], t[25], t[26] = n.rx.fresh, n.rx.started, n.wire.muted
        t[27], t[28] = control.state, n.rx.starters
        t[29], t[30] = n.v[RESET_ASKED], n.rx.state[0].age_cycles
        t[31], t[32], t[33] = control.odd_bits, n.v[FAULT], n.v[ERROR_CODE]
        t[34], t[35] = last.bits if put > 0 else 0, n.v[DISARMED]
        t[36], t[37], t[38] = control.starved, n.faults.missed, n.faults.on_wire[1].age_cycles


@loop_function
def received(_m, data, about, frames, state, seen, told):
    for s in range(about.shape[0]):
        if about[s, 0] != 0:
            m_begin_cycle(_m, state, frames.shape[0])
        row = about[s, 1]
        told[s, 0], told[s, 1] = m_check(_m, data[s], about[s, 2], row, frames, state)
        for i in range(10):
            told[s, 2 + i] = seen[row, i]


@loop_function
def sent(_m, data, about, frames):
    for s in range(about.shape[0]):
        m_protect(_m, data[s], about[s, 0], frames, about[s, 1])


@loop_function
def coded(_m, data, rows, tables, told):
    for s in range(rows.shape[0]):
        told[s] = m_pack(_m, data[s], rows[s], tables[0], tables[1], tables[2][s])
"""
Compare = Callable[[int], bool]  # whether a mutant is noticed; 0: the code as it is


# ------------------------------------------------------------------------------------- supervisor


def supervisor(driver: Any, draw: np.random.Generator, count: int) -> Compare:
    """Feed supervise, hear_requests and limit_commands with `count` episodes."""
    episodes = Episodes(driver.supervised)
    for number in range(count):
        has, commands = _settings(draw, number), _commands(draw)
        _install(episodes.new_loop(), has, commands)
        whole, values = _events(draw, number, has)
        model = expected.SupervisorModel(has, commands, 2, 1)
        episodes.add((whole, values), (_expected_values(model, whole, values),))
    return episodes.differ


def _settings(draw: np.random.Generator, number: int) -> expected.Settings:
    return expected.Settings(
        hold_cycles=int(draw.integers(2, 4)), fault_after=int(draw.integers(2, 6)), ramp=0.125,
        quick=float(draw.choice([0.25, 0.5])), waits=number % 3 != 0,
        safe_start=number % 4 != 1, clocked=number % 5 != 2, cycles=int(draw.choice([40, 70, 200])),
        odd_output=int(draw.choice([8, 9])), substitute=float(draw.choice([0.0, 0.5])),
        manual=number % 7 in (3, 4),
    )  # fmt: skip


def _commands(draw: np.random.Generator) -> list[expected.Command]:
    change = float(draw.choice([0.125, 0.25, math.inf]))
    return [
        expected.Command(-1.0, 2.0, change, float(draw.choice([0.0, 0.25, 1.0]))),
        expected.Command(-3.0, 3.0, float(draw.choice([0.5, 1.0, math.inf])), 0.0),
    ]


def _install(n: Any, has: expected.Settings, commands: Sequence[expected.Command]) -> None:
    guard = n.guard
    n.clock.kind = Time.GIVEN
    n.clock.trigger = Trigger.CLOCKED if has.clocked else Trigger.ON_FRAMES
    guard.cycles, guard.hold_cycles, guard.fault_after = (
        has.cycles,
        has.hold_cycles,
        has.fault_after,
    )
    guard.ramp_step, guard.quick_step, guard.gain = has.ramp, has.quick, 1.0
    guard.manual = has.manual
    guard.waits, guard.safe_start, guard.odd_output = has.waits, has.safe_start, has.odd_output
    guard.estop_index, guard.mode_index, guard.stop_row = ESTOP, MODE, -1
    guard.n_safe, guard.safe_index[0] = 1, WATCHED
    guard.safe[0].safe = has.substitute
    n.rx.n, n.rx.starters, n.rx.awaited = 2, 2, 2
    n.rx.role[:2] = [(1, 1, 1, 0), (1, 1, 0, 0)]
    n.tx.first, n.tx.past = AT, OUTPUTS
    n.blocks.n, n.blocks.views[0].y, n.blocks.views[0].y_end = 1, OUTPUTS, OUTPUTS + 2
    n.limits.n = len(commands)
    for i, one in enumerate(commands):
        n.limits.place[i] = AT + i
        n.limits.table[i] = one.low, one.high, one.change, one.safe, one.safe, one.safe
    n.n_variables = 256


def _events(
    draw: np.random.Generator, number: int, has: expected.Settings
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return what happens in each cycle of an episode: whole numbers, and values on limits."""
    whole = np.zeros((CYCLES, 8), np.int64)
    whole[:, 0] = np.arange(CYCLES)
    bursts = np.repeat(draw.random(CYCLES // 4) < 0.2, 4)
    whole[:, 1] = np.where(bursts | (draw.random(CYCLES) < 0.1), draw.integers(0, 2, CYCLES), 2)
    rare = draw.random((CYCLES, 4))
    whole[:, 2] = np.where(rare[:, 0] < 0.02, draw.integers(1, len(Fault), CYCLES), 0)
    whole[:, 3] = (rare[:, 1] < 0.005) * (number % 2)
    whole[:, 4] = rare[:, 2] < 0.25
    whole[:, 5] = np.where(rare[:, 3] < 0.03, draw.integers(1, 3, CYCLES), 0) * (number % 4 == 3)
    arms = np.where(draw.random(CYCLES) < 0.5, 0, 1)
    whole[:, 6] = np.where(draw.random(CYCLES) < 0.1 * (number % 7 > 2), arms, -1)
    whole[:, 7] = np.random.default_rng(number).random(CYCLES) < 0.3
    if number % 3 == 2:  # silent at the end
        whole[has.cycles - 3 :, 1] = 0
    values = draw.integers(-64, 65, (CYCLES, 7)) / 16.0
    values = np.where(draw.random((CYCLES, 7)) < 0.2, draw.normal(0.0, 1.5, (CYCLES, 7)), values)
    held = np.repeat(values[::8], 8, axis=0)
    values[:, :2] = np.where(draw.random((CYCLES, 1)) < 0.7, held[:, :2], values[:, :2])
    odd = draw.choice([math.nan, math.inf, -math.inf, 1e300, -1e300, 9.9e299, 2e300], (CYCLES, 4))
    values[:, :4] = np.where(draw.random((CYCLES, 4)) < 0.006, odd, values[:, :4])
    values[draw.random(CYCLES) < 0.003, 2:4] = math.inf
    pressed = draw.choice([1.0, -1.0, 0.5], CYCLES)
    values[:, 5] = np.where(draw.random(CYCLES) < 0.01, pressed, 0.0)
    values[:, 6] = np.where(draw.random(CYCLES) < 0.004 * (number % 3), 5.0, draw.integers(0, 5))
    said = np.where(whole[:, 6] > 0, draw.choice([1.0, 0.5, -0.5, 2.0], CYCLES), 0.0)
    return whole, np.column_stack((values, said))


def _expected_values(
    model: expected.SupervisorModel, whole: NDArray[np.int64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    rows, aged = [], 0
    cycles = zip(whole.tolist(), values.tolist(), strict=True)
    for age, ((k, fresh, fault, ends, reset, stop, arm, taken), given) in enumerate(cycles, 1):
        model.fault = model.fault or fault
        model.hosts_stop = model.hosts_stop or bool(ends)
        if fresh:
            model.watched = given[4]
        model.supervise(k, fresh, given[5], given[6], bool(taken))
        fault = model.fault
        model.hear(reset, stop, given[7] if arm >= 0 else None)
        model.limit(k, given[2:4], given[:2], AT)
        seen = model.told()
        rest = (fault, list(Fault)[fault].code, model.odd_bits if seen[19] == NOT_FINITE else 0)
        more = 0, 0, 0, seen[0], model.awaited, 0, age, model.odd_bits
        aged += taken  # frames that may be taken alone
        took = model.starved, model.untaken, aged
        rows.append([*seen, *more, *rest, model.disarmed, *took])
    return np.array(rows, np.float64)


# --------------------------------------------------------------------------- end-to-end protection

ROWS = (
    expected.Protection(0x123, 8, 1, byte=6, shift=4, mask=15),
    expected.Protection(0x080, 2, 1, byte=0, shift=0, mask=255),
    expected.Protection(0x2A1, 3, 1),
    expected.Protection(0x345, 8, 5, byte=5, shift=2, mask=15),
    expected.Protection(0x456, 8, 2, byte=3, mask=255, wide=True, data_id=0xA5C3),
    expected.Protection(0x457, 7, 1, byte=6, mask=255, wide=True, data_id=0x0457),
)


def _frames() -> NDArray[Any]:
    table = np.zeros(len(ROWS), FRAME)
    for row, one in enumerate(ROWS):
        crc = (one.mask != 0) + one.wide
        table[row] = (one.can_id, 0, one.dlc, 0, 0, 0, one.every, crc, 0, one.byte,
                      one.shift, one.mask, one.place.start, one.data_id, 0)  # fmt: skip
    return table


def receiver(driver: Any, draw: np.random.Generator) -> Compare:
    """Feed begin_cycle and check with frames of four kinds."""
    frames, receivers = _frames(), [expected.Receiver(one) for one in ROWS]
    data = draw.integers(0, 256, (FRAMES, 16)).astype(np.uint8)
    about = np.zeros((FRAMES, 3), np.int64)
    wanted = np.zeros((FRAMES, 12), np.int64)
    counters = [0] * len(ROWS)
    for s in range(FRAMES):
        row, fate = int(draw.integers(len(ROWS))), draw.random()
        frame = ROWS[row]
        step = (
            1 if fate < 0.5 else int(draw.integers(0, 8)) if fate < 0.9 else int(draw.integers(40))
        )
        counters[row] += step
        content = bytearray(frame.sent(data[s, :8].tobytes(), counters[row]))
        if draw.random() < 0.1:
            content[int(draw.integers(8))] ^= 1 << int(draw.integers(8))
        length = frame.dlc + (int(draw.integers(-1, 2)) if draw.random() < 0.1 else 0)
        data[s, :8] = np.frombuffer(bytes(content), np.uint8)
        about[s] = draw.random() < 0.4, row, length
        if about[s, 0]:
            for one in receivers:
                one.begin()
        wanted[s] = (*receivers[row].check(bytes(content), length), *receivers[row].told())

    def compare(number: int) -> bool:
        told, state = np.zeros_like(wanted), e2e.new_state(len(ROWS))
        seen = state.view(np.int64).reshape(len(ROWS), -1)
        driver.received(np.array([number]), data, about, frames, state, seen, told)
        return not np.array_equal(told, wanted)

    return compare


def sender(driver: Any, draw: np.random.Generator) -> Compare:
    """Feed protect."""
    frames = _frames()
    data = draw.integers(0, 256, (FRAMES, 16)).astype(np.uint8)
    about = np.stack([draw.integers(0, len(ROWS), FRAMES), draw.integers(0, 999, FRAMES)], 1)
    wanted = data.copy()
    for s, (row, counter) in enumerate(about.tolist()):
        content = ROWS[row].sent(data[s, :8].tobytes(), counter)
        wanted[s, :8] = np.frombuffer(content, np.uint8)

    def compare(number: int) -> bool:
        told = data.copy()
        driver.sent(np.array([number]), told, about, frames)
        return not np.array_equal(told, wanted)

    return compare


# ------------------------------------------------------------------------------------------ codec

_BEFORE = 0xA5  # in the data
CODEC_DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 0 FIRST: 8 A
 SG_ s M : 0|2@1+ (1,0) [0|3] "" B
 SG_ t m1 : 8|12@1- (0.125,3) [-100|100] "" B
 SG_ u m2 : 15|16@0+ (0.5,0) [10|20000] "" B
BO_ 1 SMALL: 8 A
 SG_ a : 0|12@1- (0.125,3) [-100|100] "" B
 SG_ b : 23|16@0+ (0.5,0) [10|20000] "" B
 SG_ c : 52|1@1+ (1,0) [0|1] "" B
 SG_ d : 32|20@1- (1,0) [-400000|400000] "" B
BO_ 2 SINGLE: 8 A
 SG_ e : 0|32@1- (1,0) [-1e6|1e6] "" B
 SG_ f : 39|32@0- (2,1) [0|0] "" B
BO_ 3 DOUBLE: 8 A
 SG_ g : 0|64@1- (1,0) [-1e12|1e12] "" B
BO_ 4 LARGE: 8 A
 SG_ h : 0|64@1+ (1,0) [0|0] "" B
BO_ 5 SIGNED: 8 A
 SG_ i : 7|64@0- (1,0) [0|0] "" B
BO_ 6 LONG: 24 A
 SG_ j : 5|12@1- (0.125,3) [-100|100] "" B
 SG_ k : 71|16@0+ (0.5,0) [10|20000] "" B
 SG_ l : 84|20@1- (1,0) [-400000|400000] "" B
 SG_ m : 123|40@0- (1,0) [0|0] "" B
 SG_ n : 168|24@1- (1,0) [0|0] "" B
BO_ 7 LAYERED: 8 A
 SG_ o M : 9|2@1+ (1,0) [0|3] "" B
 SG_ p : 16|12@1- (0.125,3) [-100|100] "" B
 SG_ q m1 : 28|20@1- (1,0) [0|0] "" B
 SG_ r m2 : 39|16@0+ (0.5,0) [10|20000] "" B
BO_ 8 DEEP: 24 A
 SG_ v M : 133|2@1+ (1,0) [0|3] "" B
 SG_ w m1 : 64|32@1- (1,0) [-1e6|1e6] "" B
 SG_ x m2 : 7|64@0- (1,0) [-1e12|1e12] "" B
 SG_ y m3 : 84|20@1- (1,0) [-400000|400000] "" B
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","","","","","","","","","","","","",
 "StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 6 14;
BA_ "VFrameFormat" BO_ 8 14;
BA_DEF_ BO_ "GenMsgSendType" ENUM "EveryCycle","Cyclic";
BA_DEF_DEF_ "GenMsgSendType" "EveryCycle";
SIG_VALTYPE_ 2 e : 1;
SIG_VALTYPE_ 2 f : 1;
SIG_VALTYPE_ 3 g : 2;
SIG_VALTYPE_ 8 w : 1;
SIG_VALTYPE_ 8 x : 2;
"""


def codec(driver: Any, draw: np.random.Generator) -> Compare:
    """Feed pack with values on the limits of signals of each kind."""
    frames = dbc.frames(dbc.parse(Path("codec.dbc"), CODEC_DBC, strict=True), "A", "tx")
    table = dbc.table(frames, 1000.0)
    rows = draw.integers(0, len(frames), FRAMES)
    values = np.zeros((FRAMES, len(table.variables)))
    wanted = np.full((FRAMES, 24), _BEFORE, np.uint8)
    counts = np.zeros(FRAMES, np.int64)
    places = {name: place for place, name in enumerate(table.variables)}
    for s, row in enumerate(rows.tolist()):
        frame = frames[row]
        given = [_value(draw, signal) for signal in frame.signals]
        if frame.selector and draw.random() < 0.8:
            chooses = [signal.name for signal in frame.signals].index(frame.selector)
            given[chooses] = float(draw.integers(4))
        for signal, value in zip(frame.signals, given, strict=True):
            values[s, places[f"{frame.name}.{signal.name}"]] = value
        content, counts[s] = expected.packed_data(frame, given)
        wanted[s, : len(content)] = np.frombuffer(content, np.uint8)
    tables = table.frames, table.signals, values

    def compare(number: int) -> bool:
        data, told = np.full_like(wanted, _BEFORE), np.zeros_like(counts)
        driver.coded(np.array([number]), data, rows, tables, told)
        return not (np.array_equal(data, wanted) and np.array_equal(told, counts))

    return compare


def _value(draw: np.random.Generator, signal: dbc.Signal) -> float:
    """Return a value in or out of the range of a signal, often on a limit or between two codes."""
    low, high = signal.range
    near = float(draw.choice([0.0, 0.25, -0.25, 0.5, -0.5, 0.75, -0.75, 1.0, -1.0, 2.0]))
    kind = int(draw.integers(8))
    if kind == 0:
        return float(draw.choice([math.nan, math.inf, -math.inf, 1e300, -1e300, -0.0]))
    if kind < 4:
        return float(draw.choice([low, high])) + near * signal.factor
    code = draw.integers(-1000, 1000) + near if kind < 7 else draw.uniform(-1e19, 1e19)
    return float(code) * signal.factor + signal.offset

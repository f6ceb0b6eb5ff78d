"""Counters, CRCs and the codec: what mutants are run on.

What is expected stands in `evidence.expected`. Half of the inputs are just on a limit: counters at
the edge, values between two codes of a signal.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from pcpc.drivers.can import dbc, e2e
from pcpc.drivers.can.codec import pack
from pcpc.drivers.can.e2e import begin_cycle, check, protect
from pcpc.tools.dev.evidence import expected
from pcpc.tools.dev.evidence.comparison import Compared, Episodes

FRAMES = 10_000

# --------------------------------------------------------------------------- end-to-end protection

ROWS = (
    expected.Protection(0x123, 8, 1, byte=6, shift=4, mask=15),
    expected.Protection(0x080, 2, 1, byte=0, shift=0, mask=255),
    expected.Protection(0x2A1, 3, 1),
    expected.Protection(0x345, 8, 5, byte=5, shift=2, mask=15),
    expected.Protection(0x456, 8, 2, byte=3, mask=255, wide=True, data_id=0xA5C3),
    expected.Protection(0x457, 7, 1, byte=6, mask=255, wide=True, data_id=0x0457),
)


def _install_frames(n: Any) -> None:
    n.rx.n = len(ROWS)
    for row, one in enumerate(ROWS):
        crc = (one.mask != 0) + one.wide
        n.rx.frames[row] = (one.can_id, 0, one.dlc, 0, 0, 0, one.every, crc, 0, one.byte,
                            one.shift, one.mask, one.place.start, one.data_id, 0)  # fmt: skip
    n.rx.state[: len(ROWS)] = e2e.new_state(len(ROWS))


class Received(NamedTuple):
    """A received frame, now and then the first of a cycle."""

    begins: int
    row: int
    length: int
    content: Annotated[list[int], "u1", 16]


def received(n: Any, given: Received) -> None:
    """Take a frame."""
    if given.begins != 0:
        begin_cycle(n.rx.state, n.rx.n)
    n.control.state, n.control.lost = check(
        given.content, given.length, given.row, n.rx.frames, n.rx.state
    )


class Receivers:
    """The receivers of all rows."""

    def __init__(self) -> None:
        self.rows = [expected.ExpectedReceiver(one) for one in ROWS]

    def step(self, given: Received) -> None:
        """Take a frame."""
        for one in self.rows if given.begins else ():
            one.begin()
        self.row = self.rows[given.row]
        self.state, self.gone = self.row.check(bytes(given.content[:8]), given.length)


RECEIVER = Compared(
    Received, received,
    whole={
        "control.state": lambda m: m.state, "control.lost": lambda m: m.gone,
        "words(rx.state[given.row])[0:10]": lambda m: m.row.told(),
    },
)  # fmt: skip


def receiver(feed: Any, draw: np.random.Generator) -> Episodes:
    """Feed begin_cycle and check with frames of four kinds."""
    episodes = Episodes(RECEIVER, feed)
    _install_frames(episodes.new_loop())
    rows = episodes.new_rows(FRAMES)
    rows.content = draw.integers(0, 256, (FRAMES, 16))
    counters = [0] * len(ROWS)
    for given in rows:
        given.row, fate = int(draw.integers(len(ROWS))), draw.random()
        frame = ROWS[given.row]
        step = (
            1 if fate < 0.5 else int(draw.integers(0, 8)) if fate < 0.9 else int(draw.integers(40))
        )
        counters[given.row] += step
        data = bytearray(frame.sent(given.content[:8].tobytes(), counters[given.row]))
        if draw.random() < 0.1:
            data[int(draw.integers(8))] ^= 1 << int(draw.integers(8))
        given.length = frame.dlc + (int(draw.integers(-1, 2)) if draw.random() < 0.1 else 0)
        given.content[:8] = data
        given.begins = draw.random() < 0.4
    episodes.add(rows, Receivers())
    return episodes


class Sent(NamedTuple):
    """A frame to be protected."""

    row: int
    counter: int
    content: Annotated[list[int], "u1", 16]


def sent(n: Any, given: Sent) -> None:
    """Protect a frame."""
    data, content = n.wire.tx, given.content
    for i in range(16):
        data[i] = content[i]
    protect(data, given.row, n.rx.frames, given.counter)


class Sender:
    """The frames that are sent."""

    def step(self, given: Sent) -> None:
        """Protect a frame."""
        first, rest = bytes(given.content[:8]), given.content[8:]
        self.data = [*ROWS[given.row].sent(first, given.counter), *rest]


SENDER = Compared(Sent, sent, whole={"wire.tx[0:16]": lambda m: m.data})


def sender(feed: Any, draw: np.random.Generator) -> Episodes:
    """Feed protect."""
    episodes = Episodes(SENDER, feed)
    _install_frames(episodes.new_loop())
    rows = episodes.new_rows(FRAMES)
    rows.content = draw.integers(0, 256, (FRAMES, 16))
    rows.row, rows.counter = draw.integers(0, len(ROWS), FRAMES), draw.integers(0, 999, FRAMES)
    episodes.add(rows, Sender())
    return episodes


# ------------------------------------------------------------------------------------------ codec

BEFORE = 0xA5  # in the data
DATA_BYTES, VARIABLES = 24, 25
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


class Coded(NamedTuple):
    """A frame to be packed."""

    row: int
    values: Annotated[list[float], "<f8", VARIABLES]


def coded(n: Any, given: Coded) -> None:
    """Pack a frame."""
    data, values, v = n.wire.tx, given.values, n.v
    for i in range(DATA_BYTES):
        data[i] = BEFORE
    for i in range(VARIABLES):
        v[i] = values[i]
    n.control.saturated = pack(data, given.row, n.tx.frames, n.tx.signals, v)


class Coder:
    """The frames of the database."""

    def __init__(self, frames: Sequence[dbc.Frame], places: Mapping[str, int]) -> None:
        self.frames, self.places = frames, places

    def step(self, given: Coded) -> None:
        """Pack a frame."""
        frame = self.frames[given.row]
        names = [f"{frame.name}.{signal.name}" for signal in frame.signals]
        values = [given.values[self.places[name]] for name in names]
        content, self.count = expected.packed_data(frame, values)
        self.data = [*content, *[BEFORE] * (DATA_BYTES - len(content))]


CODEC = Compared(
    Coded, coded,
    whole={
        f"wire.tx[0:{DATA_BYTES}]": lambda m: m.data, "control.saturated": lambda m: m.count,
    },
)  # fmt: skip


def codec(feed: Any, draw: np.random.Generator) -> Episodes:
    """Feed pack with values on the limits of signals of each kind."""
    frames = dbc.frames(dbc.parse(Path("codec.dbc"), CODEC_DBC, strict=True), "A", "tx")
    table, episodes = dbc.table(frames, 1000.0), Episodes(CODEC, feed)
    n, rows = episodes.new_loop(), episodes.new_rows(FRAMES)
    n.tx.frames[: len(table.frames)] = table.frames
    n.tx.signals[: len(table.signals)] = table.signals
    rows.row = draw.integers(0, len(frames), FRAMES)
    places = {name: place for place, name in enumerate(table.variables)}
    for given in rows:
        frame = frames[given.row]
        values = [_value(draw, signal) for signal in frame.signals]
        if frame.selector and draw.random() < 0.8:
            chooses = [signal.name for signal in frame.signals].index(frame.selector)
            values[chooses] = float(draw.integers(4))
        for signal, value in zip(frame.signals, values, strict=True):
            given.values[places[f"{frame.name}.{signal.name}"]] = value
    episodes.add(rows, Coder(frames, places))
    return episodes


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

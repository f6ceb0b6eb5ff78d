"""The rows of the tables that the compiled loop walks: frames, signals, receivers (no numba here).

int64 each, but of a signal what is no whole number. `drivers.can.dbc` makes frames and signals of a
DBC file, `drivers.can.codec` and `drivers.can.e2e` go by them. Words that several processes write
are in records too.
"""

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Bytes, Element

# struct canfd_frame: id and flags [0:4], [LENGTH], `Flag` [FLAGS], data [HEAD_BYTES:72]; a classic
# frame is struct can_frame, its first 16 bytes, without a flag
FRAME_BYTES, CLASSIC_BYTES, HEAD_BYTES = 72, 16, 8
LENGTH, FLAGS = 4, 5


class Flag(NumberedEnum):
    """Bits in a frame, those of Linux: bit rate switch, error state indicator, CAN FD."""

    NONE, BRS, ESI, FD = 0, 1, 2, 4


class FrameBytes(Bytes):
    """A frame."""

    count = FRAME_BYTES


class FrameRow(Element):
    """A frame; protected: of `drivers.can.dbc`."""

    can_id: int
    extended: int
    dlc: int
    fd_flags: int
    first: int  # its signals are rows `first` to `end` - 1
    end: int
    every_n: int
    protected: int
    sequence: int
    counter_byte: int
    counter_shift: int
    counter_mask: int
    crc_byte: int
    data_id: int
    selector: int  # 1 + the row of its multiplexer, 0 without one


class SignalRow(Element):
    """A signal."""

    byte: int  # it is in 8 bytes from this one on
    big_endian: int
    shift: int
    mask: int
    sign: int
    kind: int
    variable: int
    int_factor: int
    int_offset: int
    bits_low: int  # bits, codes: of its limits, raw
    bits_high: int
    layout: int  # 1 + the raw value of the multiplexer with which it comes, 0: it always does
    factor: float
    offset: float
    code_low: float
    code_high: float


class Receiver(Element):
    """Of one frame; see `drivers.can.e2e`."""

    last_counter: int
    state: int
    received: int
    lost: int
    repeated: int
    wrong_sequence: int
    errors: int
    age_cycles: int
    fresh: int
    still_cycles: int

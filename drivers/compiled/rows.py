"""The rows of the tables that the compiled loop walks: frames, signals, receivers (no numba here).

int64 each, but of a signal what is no whole number. `drivers.can.dbc` makes frames and signals of a
DBC file, `drivers.can.codec` and `drivers.can.e2e` go by them. Words that several processes write
are in records too.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pcpc.drivers.compiled.numbered import NumberedEnum

LINE_BYTES = 64  # of a cache line

# struct canfd_frame: id and flags [0:4], [LENGTH], `Flag` [FLAGS], data [HEAD_BYTES:72]; a classic
# frame is struct can_frame, its first 16 bytes, without a flag
FRAME_BYTES, CLASSIC_BYTES, HEAD_BYTES = 72, 16, 8
LENGTH, FLAGS = 4, 5


class Flag(NumberedEnum):
    """Bits in a frame, those of Linux: bit rate switch, error state indicator, CAN FD."""

    NONE, BRS, ESI, FD = 0, 1, 2, 4


def row_of(names: str, floats: str = "") -> np.dtype[Any]:
    """Return the type of a row with these int64, and these float64 behind them."""
    fields = [(name, "<i8") for name in names.split()]
    return np.dtype((np.record, fields + [(name, "<f8") for name in floats.split()]))


def lines_of(*groups: Sequence[str]) -> np.dtype[Any]:
    """Return the type of a record of these int64, each group on cache lines of its own."""
    places: dict[str, int] = {}
    end = 0
    for group in groups:
        places |= {name: end + 8 * i for i, name in enumerate(group)}
        end += -(-8 * len(group) // LINE_BYTES) * LINE_BYTES
    return np.dtype((np.record, {
        "names": list(places), "formats": ["<i8"] * len(places), "offsets": list(places.values()),
        "itemsize": end, "aligned": True,
    }))  # fmt: skip


FRAME = row_of(  # its signals are rows `first` to `end` - 1; protected: of `drivers.can.dbc`;
    # selector: 1 + the row of its multiplexer, 0 without one
    "can_id extended dlc fd_flags first end every_n protected sequence"
    " counter_byte counter_shift counter_mask crc_byte data_id selector"
)
SIGNAL = row_of(  # in 8 bytes from `byte` on; bits, codes: of its limits, raw; layout: 1 + the
    # raw value of the multiplexer with which it comes, 0: it always does
    "byte big_endian shift mask sign kind variable int_factor int_offset bits_low bits_high layout",
    "factor offset code_low code_high",
)
RECEIVER = row_of(  # of one frame; see `drivers.can.e2e`
    "last_counter state received lost repeated wrong_sequence errors age_cycles fresh still_cycles"
)

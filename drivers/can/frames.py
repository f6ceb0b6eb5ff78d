"""A frame and its signals as plain records; `drivers.can.dbc` reads them from a file."""

from collections.abc import Mapping
from dataclasses import dataclass

from pcpc.drivers.can import can_id
from pcpc.drivers.can.frame_bits import frame_bits
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.compiled.numbered import NumberedEnum


class Protection(NumberedEnum):
    """Values of `protected` in a row of frames."""

    UNPROTECTED, CRC_8, CRC_16 = range(3)


class SignalKind(NumberedEnum):
    """Values of `kind` in a row of signals.

    Integer computed in float64, in int64, integer of 64 bits without sign, IEEE 754 on the wire.
    """

    SCALED, WIDE, UNSIGNED_64, FLOAT_32, FLOAT_64 = range(5)


@dataclass(frozen=True)
class Signal:
    """One signal: value = raw factor + offset, in `unit`; it saturates at [low, high].

    `start` counts as in a DBC. `codes` are the limits as raw numbers. `layout`: the raw value of
    the frame's multiplexer with which it comes; None: it always does.
    """

    name: str
    unit: str
    help: str
    low: float
    high: float
    factor: float
    offset: float
    start: int
    nbits: int
    big_endian: bool
    signed: bool
    is_float: bool
    kind: SignalKind
    codes: tuple[float, float]
    choices: Mapping[int, str]
    layout: int | None = None

    @property
    def range(self) -> tuple[float, float]:
        """The lowest and highest value that it holds."""
        low, high = sorted(float(code) * self.factor + self.offset for code in self.codes)
        return low, high


@dataclass(frozen=True)
class Frame:
    """One frame. `signals` are its variables: in a protected frame all but counter and CRC.

    `counter` is (byte, shift, mask), `crc` (one of PROTECTED, byte, id that it is over), zeros
    without protection. `cycle_ms` is 0 for every cycle. `selector`: the multiplexer's name.
    """

    name: str
    can_id: int
    extended: bool
    dlc: int
    cycle_ms: float
    has_sequence: bool
    counter: tuple[int, int, int]
    crc: tuple[int, int, int]
    signals: tuple[Signal, ...]
    help: str
    on_event: bool = False
    flags: int = Flag.NONE
    selector: str = ""

    @property
    def fd(self) -> bool:
        """Whether it is a frame of CAN FD."""
        return self.flags != Flag.NONE

    def bits(self, all_fd: bool = False) -> tuple[int, int]:
        """Return its most bits, at the nominal rate and in the data phase of CAN FD.

        `all_fd`: as if it were FD with BRS.
        """
        flags = Flag.FD | Flag.BRS if all_fd else self.flags
        return frame_bits(self.dlc, self.extended, flags)

    @property
    def protected(self) -> bool:
        """Whether it has counter and CRC."""
        return self.crc[0] != Protection.UNPROTECTED

    @property
    def word(self) -> int:
        """The id with its flag, see `drivers.can.can_id`."""
        return can_id.word_of(self.can_id, self.extended)

    def every_n(self, rate_hz: float) -> int:
        """Return the number of cycles from one transmission to the next."""
        return max(1, round(self.cycle_ms * rate_hz / 1000))

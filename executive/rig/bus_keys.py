"""Keys of a rig file: its bus, who else is on it, a watchdog, and what a plant is to a master."""

# ruff: noqa: RUF012  msgspec gives each mapping its own copy of a mutable default

from typing import Annotated, ClassVar

from msgspec import Meta

from pcpc.executive.rig.judged_keys import Word
from pcpc.executive.rig.keyed import Keyed
from pcpc.executive.rig.scheduling import Fraction

Positive = Annotated[float, Meta(gt=0, le=1e12)]
Gain = Annotated[float, Meta(ge=0, le=1e9)]

BitRate = Annotated[str, Meta(pattern=r"\A[0-9]{1,7}(\.[0-9]{1,6})? ?[kM]?(bit/s)?\Z")]


class Bus(Keyed):
    """A bus as python-can names it; without `bitrate` its load is not checked.

    `emulate`: a line of this bit rate, see `drivers.line.line`, with `queue` places in each node.
    `bitrates`: of nodes that have another bit rate, in bit/s.
    """

    interface: Word = "auto"
    channel: Word | Annotated[int, Meta(ge=0, le=2**31)] | None = None
    bitrate: Annotated[int, Meta(ge=1, le=10**9)] | None = None
    data_bitrate: Annotated[int, Meta(ge=1, le=10**9)] | None = None
    emulate: BitRate | Annotated[int, Meta(ge=1000, le=10**6)] | None = None
    queue: Annotated[int, Meta(ge=1, le=256)] = 64
    bit_error_rate: Fraction = 0.0
    error_burst: Annotated[float, Meta(ge=1, le=1e9)] = 1.0
    bitrates: dict[str, Annotated[int, Meta(ge=1000, le=10**6)]] = {}

    @property
    def bits_per_s(self) -> int | None:
        """The rate that its frames meet: the emulated one, else `bitrate`."""
        if not isinstance(self.emulate, str):
            return self.emulate or self.bitrate
        number = self.emulate.removesuffix("bit/s").strip()
        scale = {"k": 1e3, "M": 1e6}.get(number[-1], 1.0)
        return round(scale * float(number.rstrip("kM ")))

    @property
    def data_bit(self) -> float:
        """How many nominal bits one of the data phase lasts; without a rate at 1 Mbit/s."""
        return (self.bits_per_s or 1e6) / self.data_bitrate if self.data_bitrate else 1.0


CanId = Annotated[int, Meta(ge=0x001, le=0x1FFFFFFF)]


class Xcp(Keyed):
    """XCP on CAN: ids of the first node, from master to slave and back; 2 more for each next one.

    Above 0x7FF they have 29 bits. `frames`: that a slave may send in CYCLES, lists and answers; it
    takes a quarter as many commands.
    """

    can: tuple[CanId, CanId] = (0x7C0, 0x7C1)
    frames: Annotated[int, Meta(ge=4, le=640)] = 8

    CYCLES: ClassVar[int] = 10

    @property
    def commands(self) -> int:
        """How many commands are taken in CYCLES, and are left to answers by lists."""
        return self.frames // 4


class Watchdog(Keyed):
    """A process that sees only the bus and sends the stop frame; see `tools.live.watchdog`."""

    silent_cycles: Annotated[int, Meta(ge=2)] = 50
    wrong_frames: Annotated[int, Meta(ge=1, le=10)] = 3
    feed: str | None = None


class Scale(Keyed):
    """The protocol's unit to that of what is measured; an acceleration has that of the position.

    None: 1000 increments of CiA 402, turns for a radian (ODrive, moteus), 1 for MIT, RobStride.
    """

    position: Positive | None = None
    velocity: Positive | None = None


class Gains(Keyed):
    """Of the drive's loops, see `drivers.canopen.motion`; `velocity`: command to velocity."""

    position_per_s: Gain
    velocity: Gain
    integral_per_s: Gain = 0.0


PROFILES = "cia402", "odrive", "mit", "moteus", "robstride"  # beside those of packages of others


class Drive(Keyed):
    """The plant as a drive on CAN: a block's input is wired to `drive.command`.

    `position`, `velocity`: variables that it measures; without a velocity, differences. `rated`:
    the command at 100 %, of a robot's drive at a torque of 1. `eds`: EDS or DCF of the real one.
    `objects`: values at the start, by index and subindex (6085, 1800.3), or a setting's name.
    """

    profile: Word
    node: Annotated[int, Meta(ge=0, le=255)]
    position: str
    velocity: str | None = None
    rated: Positive
    scale: Scale = Scale()
    gains: Gains
    eds: str | None = None
    objects: dict[str | int, int | float] = {}

"""The frames that an examination sends in every cycle: those of a rig, or one from each end.

Each carries its number and bytes that follow from it: what was changed on the way is not known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import Flag
from pcpc.executive.rig.reading import Rig
from pcpc.tools.start.bus import traffic

PLAIN_WITHIN_NS = 1_000_000  # a cycle at 1 kHz
PLAIN_ID = 0x1FFFFF00  # lowest of all priorities
NUMBERED = 0xFFFFFFFF
_FILL = bytes((37 * i + 11) & 0xFF for i in range(256))


@dataclass(frozen=True)
class PatternFrame:
    """A frame of each n-th cycle; `end` sends it, at `phase` of the cycle.

    `wanted`: the share of a cycle after which its receiver needs it; None: `PLAIN_WITHIN_NS`.
    """

    end: int
    word: int
    length: int
    flags: int = Flag.NONE
    every_n: int = 1
    phase: float = 0.0
    wanted: float | None = None

    def data(self, number: int) -> bytes:
        """Return the bytes of its `number`-th frame."""
        head = (number & NUMBERED).to_bytes(4, "little")
        begin = (number * 101 + self.word) & 0x7F
        return (head + _FILL[begin : begin + 60])[: self.length]

    def within_ns(self, rate_hz: float) -> int:
        """Return the time after which it is late."""
        return PLAIN_WITHIN_NS if self.wanted is None else round(1e9 * self.wanted / rate_hz)


@dataclass(frozen=True)
class Pattern:
    """The frames of a cycle, and the rig that they are of, with its rate; "": of none."""

    frames: tuple[PatternFrame, ...]
    rig: str = ""
    rate_hz: float = 0.0
    left_out: str = ""

    @property
    def per_cycle(self) -> float:
        """Frames of a cycle in the mean."""
        return sum(1 / frame.every_n for frame in self.frames)

    @property
    def burst(self) -> int:
        """The most frames that an end sends at once."""
        at_once = [(frame.end, frame.phase) for frame in self.frames]
        return max(at_once.count(one) for one in at_once)

    @property
    def fd(self) -> bool:
        """Whether one of them is of CAN FD."""
        return any(frame.flags & Flag.FD for frame in self.frames)


def plain_pattern(length: int = 8, flags: int = Flag.NONE) -> Pattern:
    """Return a frame from each end, half a cycle apart."""
    word = can_id.word_of(PLAIN_ID, True)
    return Pattern(
        tuple(PatternFrame(end, word | end, length, flags, phase=0.5 * end) for end in (0, 1))
    )


def burst_pattern(count: int) -> Pattern:
    """Return so many frames of the first end at once."""
    word = can_id.word_of(PLAIN_ID, True)
    return Pattern(tuple(PatternFrame(0, word | 0x10 | i, 8) for i in range(count)))


def rig_pattern(rig: Rig) -> Pattern:
    """Return the frames on the executive's bus; what it sends is of the second end, RigError."""
    own, *others = traffic.buses(rig)
    executive = rig.config.sections["executive"].node
    frames = tuple(
        PatternFrame(
            end=int(sent.sender == executive),
            word=sent.frame.word,
            length=sent.frame.dlc,
            flags=sent.frame.flags,
            every_n=sent.cycles or sent.frame.every_n(rig.config.rate_hz),
            phase=sent.phase if sent.phase is not None else 0.5 * (sent.sender != executive),
            wanted=_cycles(sent, rig.config.rate_hz),
        )
        for sent in own
        for _ in range(sent.count)
    )
    left_out = "its second bus was not tried" if any(others) else ""
    return Pattern(frames, rig.config.rig, rig.config.rate_hz, left_out)


def _cycles(sent: traffic.SentFrame, rate_hz: float) -> float:
    """Return the cycles after which a frame is needed, as `pcpc bus` counts them."""
    return sent.wanted if sent.wanted != 1.0 else float(sent.frame.every_n(rate_hz))


def by_phase(frames: Sequence[PatternFrame]) -> list[tuple[float, list[PatternFrame]]]:
    """Return the frames that are sent at once, by the moment of the cycle."""
    phases = sorted({frame.phase for frame in frames})
    return [(phase, [one for one in frames if one.phase == phase]) for phase in phases]

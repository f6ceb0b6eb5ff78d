"""All kinds of faults on purpose, each declared once: a member is its number in the LOOP record.

Rig files name a kind by its word; `docs/rig.md` lists what each `says`, and how large a fault is.
What a kind does stands in `injected_values` and `injected_frames`, `stalls` and `floods`.
"""

import math
from dataclasses import dataclass

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.executive.loop.injection_layout import FAULT_DEPTH


class FrameChange(NumberedEnum):
    """How a counter, a checksum or data change."""

    VALUE, FREEZE, RANDOM, OFFSET = range(4)


HOWS = FrameChange.words()
BY_THEMSELVES = ("freeze", "random")  # those of HOWS that need no size
_NUMBER = "a counter (CRC) that is `value`, frozen, `random`, or larger by `value` (`offset`)"


@dataclass(frozen=True)
class KindFacts:
    """What a kind `says` to readers, and what it takes.

    low, high   of its size; `given`: the size where the rig gives none; `sized`: it has one
    protected   only of frames with counter and CRC
    hows        what `how` may be; `counts_on`: it may have `goes_on`; `copies`: it has `data_of`
    """

    says: str
    low: float = -math.inf
    high: float = math.inf
    given: float | None = None
    sized: bool = True
    protected: bool = False
    hows: tuple[str, ...] = ()
    counts_on: bool = False
    copies: bool = False


class FaultKind(NumberedEnum):
    """Kinds of one seam, numbered from 0 on."""

    row: KindFacts

    def __new__(cls, row: KindFacts) -> "FaultKind":
        """Return the next member."""
        one = int.__new__(cls, len(cls.__members__))
        one._value_, one.row = int(one), row
        return one

    @property
    def word(self) -> str:
        """Its name in a rig."""
        return self.name.lower()

    @classmethod
    def of(cls, word: str) -> "FaultKind | None":
        """Return the kind that a rig calls so; None for none."""
        return next((kind for kind in cls if kind.word == word), None)


class WrongValue(FaultKind):
    """What a fault makes of a value x; a is its size."""

    VALUE = KindFacts("a")
    BIAS = KindFacts("x + a")
    GAIN = KindFacts("a x")
    DRIFT = KindFacts("x + a t, t since the start")
    STUCK = KindFacts("x at the start", sized=False)
    DROPOUT = KindFacts("x when the fault last did not act (with a `share`)", sized=False)
    NOISE = KindFacts("x plus noise of standard deviation a", 0.0)
    RANDOM = KindFacts("uniform between -a and a")
    QUANTISE = KindFacts("nearest multiple of a", 0.0)
    DELAY = KindFacts(
        f"x of a cycles ago, at most {FAULT_DEPTH - 1}", 0.0, FAULT_DEPTH - 1.0, given=1.0
    )
    SATURATION = KindFacts("x limited to -a to a", 0.0)
    RATE = KindFacts("x with its change limited to a per second", 0.0)
    DEAD_ZONE = KindFacts("0 within -a to a, and x moved by a towards 0 outside", 0.0)
    NAN = KindFacts("not a number", sized=False)


class WrongFrame(FaultKind):
    """What a fault does to a frame."""

    LOSS = KindFacts("nothing; with `share` 1 a blocked channel", sized=False)
    CORRUPTION = KindFacts("`value` (1) inverted data bits", 0.0, 64.0, given=1.0)
    REPETITION = KindFacts("the frame, then the one before", sized=False)
    SEQUENCE = KindFacts("pairs in the wrong order", sized=False)
    DELAY = KindFacts("the frame from `value` (1) frames before", 0.0, FAULT_DEPTH - 1.0, given=1.0)
    INSERTION = KindFacts("the frame, then one of its id with random data and CRC", sized=False)
    MASQUERADE = KindFacts(
        "random data with the right counter and CRC", sized=False, protected=True
    )
    ADDRESSING = KindFacts("data of the frame `data_of`", sized=False, copies=True)
    LENGTH = KindFacts("`value` bytes", 0.0, 8.0)  # of a frame of CAN FD up to 64
    COUNTER = KindFacts(_NUMBER, -255.0, 255.0, protected=True, hows=HOWS, counts_on=True)
    CHECKSUM = KindFacts(_NUMBER, -255.0, 255.0, protected=True, hows=HOWS)
    PAYLOAD = KindFacts(
        "the data of the first frame (`how: freeze`), while counter and CRC go on",
        sized=False, protected=True, hows=("freeze",),
    )  # fmt: skip
    FORGERY = KindFacts("such a frame, then the true one", sized=False, protected=True)


class WrongNode(FaultKind):
    """What a fault does to a node."""

    STALL = KindFacts("stops it for the time `for`", sized=False)
    FLOOD = KindFacts("makes it send `value` more frames a cycle", 1.0, 200.0)


KINDS = tuple(dict.fromkeys((*WrongValue.words(), *WrongFrame.words(), *WrongNode.words())))

"""What `pcpc doctor --bus` says of a bus: numbers, and a row for each thing judged.

With what it says of machines, for one schema.
"""

from typing import Literal

from msgspec import Struct

from pcpc.tools.machine.doctor.adapter.channel import ChannelFacts
from pcpc.tools.machine.doctor.machine import MachineFacts as MachineFacts
from pcpc.tools.machine.doctor.machine import TuningFacts as TuningFacts
from pcpc.tools.machine.jitter.nines import Quantiles
from pcpc.tools.terminal.answer import Count

State = Literal["held", "violated", "not judged"]
Word = Literal["good", "not good", "not judged"]
Limiting = Literal["loss", "queue", "delay", "this program", ""]


class AdapterRow(Struct, frozen=True):
    """One thing that was judged, or why it was not."""

    name: str
    state: State
    found: str
    cure: str = ""
    "a command, or what to do; empty: nothing"
    needed: bool = True
    "without it nothing is good"


class RatePass(Struct, frozen=True):
    """What became of the frames of a pass."""

    rate_hz: float
    "cycles, Hz"
    frames_per_s: float
    "that were asked of the bus"
    sent: Count
    lost: Count
    doubled: Count
    changed: Count
    misordered: Count
    late: Count
    "after their receiver needed them"
    refused: Count
    "not taken by the sender's queue"
    offered: bool
    "this program kept the rate"


class AdapterFacts(Struct, frozen=True):
    """With --bus: whether a bus is good enough."""

    channels: list[ChannelFacts]
    way: Literal["two channels", "one channel"]
    software: bool
    "of the kernel: no adapter took part"
    rig: str | None
    "whose frames were sent; null: a frame each way"
    verdict: Word
    good_for_hz: float | None
    "with the frames of the rig; null: not shown"
    long: RatePass | None
    "the pass that is judged; null: there was no sense in one"
    loss_below: float | None
    "probability, with 95 % confidence; null: nothing arrived"
    frames_needed: Count
    "without loss, for a verdict"
    delay_us: Quantiles | None
    "by percent of the frames; null: none was measured"
    highest_hz: float | None
    "that short passes held; null: none"
    highest_frames_per_s: float | None
    highest_load: float | None
    "share of the bit rate, at most; null: unknown"
    limited_by: Limiting
    "what came at higher rates; empty: nothing"
    steps: list[RatePass]
    "of rising rates"
    rows: list[AdapterRow]

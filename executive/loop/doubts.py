"""What is doubted of a frame besides its counter and CRC; a doubt has a line in each function.

has_doubts    whether something may be doubted of frames of a row; of most rows it is nothing
take_values   decodes a frame that is used, but for what is doubted of it
note_sender   looks at one that is not used, which may take away the one before it
is_doubted    whether a frame that came is none of this cycle's input
"""

from pcpc.drivers.can import codec
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.structures import copy, data_of
from pcpc.executive.loop import intrusion, plausibility
from pcpc.executive.loop.layout import Loop


@loop_function
def has_doubts(n: Loop, row: int) -> bool:
    """Return whether something may be doubted of the frames of a row."""
    doubts = False
    doubts |= n.intrusion.care[row] != 0
    doubts |= plausibility.is_limited(n, row)
    return doubts


@loop_function
def is_doubted(n: Loop, row: int) -> bool:
    """Return whether a frame of a row is none of this cycle's input, although it came."""
    doubted = False
    doubted |= intrusion.is_out(n, row)
    return doubted


@loop_function
def take_values(n: Loop, row: int, new: bool) -> None:
    """Decode `wire.rx`, of a row with doubts; what is no input is none."""
    known, used = True, n.rx.role[row].awaited * new
    n.rx.fresh -= used
    if n.intrusion.beat_every[row] > 0:
        intrusion.watch_beat(n, row)
        undo(n, row)
    if is_doubted(n, row):
        return
    intrusion.keep_values(n, row, new)
    codec.unpack(data_of(n.wire.rx), row, n.rx.frames, n.rx.signals, n.v)
    known &= plausibility.take_plausible(n, row)
    used *= known
    n.rx.fresh += used
    if new:
        n.intrusion.fresh[row] = used


@loop_function
def note_sender(n: Loop, row: int, state: int, lost: int) -> None:
    """Look at a frame that is not used; `lost` before it, as of its check."""
    intrusion.suspect(n, row, state, lost)
    undo(n, row)


@loop_function
def undo(n: Loop, row: int) -> None:
    """Take back what came of a frame of this cycle, if it is believed to be none of its input."""
    back = False
    back |= intrusion.take_back(n, row)
    plausibility.take_again(n, row, back)


@loop_inline
def note_used(n: Loop, row: int) -> None:
    """Keep the frame in `wire.rx`, which was used, to compare later ones with it."""
    copy(n.intrusion.counted_frame[row], n.wire.rx)

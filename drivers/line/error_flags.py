"""How long the error flags behind a flipped bit last, those of its sender and of all receivers.

    classic   receivers see the error at once (6 bits), or after six equal bits of which m <= 5 were
              there (together 12 - m bits)                                                       (1)
    FD        they see it at once in a fixed stuff bit and from the CRC delimiter on; else in what
              the sender's flag makes them read: the sixth equal bit up to the last of the data, a
              fixed stuff bit like the one before it, a dominant CRC delimiter. A wrong CRC shows
              behind the ACK delimiter. Their own flag follows, 6 bits                           (2)
    BRS       they read their bits at the data bit rate from a recessive BRS up to the CRC
              delimiter: the rate goes by what they read, the flags are nominal                  (3)

`line` is a Line record of `drivers.line.line` with a bit that is flipped, `hit`. Receivers keep to
the format of the sender: a hit in IDE, FDF, res or DLC is one like others to them.
Source: ISO 11898-1:2015, 10.4.4, 10.9, 10.11.
"""

from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.line.fd_stuffing import FIXED_EVERY, Place
from pcpc.drivers.line.line_layout import Line
from pcpc.drivers.line.stuffing import END_BITS

FLAG_BITS, _EQUAL_BITS = 6, 6
_ACK_DELIMITER = 2  # bits behind the CRC delimiter


@loop_function
def flag_ticks(line: Line, recessive: int, alone: bool) -> int:
    """Return it in ticks; `recessive` 1: the flag of the sender is so, `alone`: nobody receives."""
    if alone:
        return FLAG_BITS * line.bit
    if line.places[Place.FIXED] != 0:
        return FLAG_BITS * line.bit + _ticks_to_see(line, recessive)
    return _classic_bits(line, recessive) * line.bit


@loop_function
def _classic_bits(line: Line, recessive: int) -> int:
    """Return (1)."""
    wire, hit = line.wire, line.hit
    if hit >= line.length - END_BITS:
        return int64(FLAG_BITS)
    level = 1 - wire[hit]
    m = int64(1)
    while hit - m >= 0 and wire[hit - m] == level:
        m += 1
    if m > 5:
        return int64(FLAG_BITS)
    return 2 * FLAG_BITS - (m if level == recessive else int64(0))


@loop_function
def _ticks_to_see(line: Line, level: int) -> int:
    """Return how long after the flipped bit of an FD frame receivers, who read `level`, see it."""
    wire, hit, places, end = line.wire, line.hit, line.places, line.length - END_BITS
    if hit >= end:
        return int64(0)
    last, brs = int64(1 - wire[hit]), places[Place.BRS]
    fast = (wire[brs] == 1) != (hit == brs) and hit >= brs
    run = int64(1)
    while hit - run >= 0 and wire[hit - run] == last:
        run += 1
    position, ticks = hit, int64(0)
    while not _seen(position, run, last, places[Place.FIXED], end):
        position += 1
        run = run + 1 if level == last else int64(1)
        last = level
        ticks += line.fast if fast and position <= end else line.bit
        fast = fast or (position == brs and level == 1)
    return ticks


@loop_function
def _seen(position: int, run: int, level: int, fixed: int, end: int) -> bool:
    """Return whether bit `position`, the last of `run` like it, is wrong to a receiver (2)."""
    if position < fixed:
        return run >= _EQUAL_BITS
    if position < end:
        return (position - fixed) % FIXED_EVERY == 0 and run > 1
    return level == 0 or position >= end + _ACK_DELIMITER

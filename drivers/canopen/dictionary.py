"""The object dictionary at run time: found, read, and written with CiA 301's reasons why not.

    abort code    when
    0x05030000    toggle bit not alternated
    0x05040000    no segment for a second
    0x05040001    command not known, as a segment without a transfer, or a block
    0x06010001    read, but may only be written
    0x06010002    written, but may only be read
    0x06020000    no such object
    0x06040041    cannot be mapped to this PDO
    0x06040042    more than 8 bytes mapped
    0x06060000    does not exist in the present transfer
    0x06070010    length does not match
    0x06090011    no such subindex
    0x06090030    value not possible: a mode that is not there, a COB-ID that is another service's
    0x06090031/2  value too high, too low
    0x08000022    not in this state: a PDO has to be not valid before it changes

Source: CiA 301, 7.2.4.3.17.
"""

from pcpc.drivers.canopen.layout import Canopen, Od
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import int64

TOGGLE, TIMED_OUT, NO_COMMAND, READ_ONLY = 0x05030000, 0x05040000, 0x05040001, 0x06010002
WRITE_ONLY = 0x06010001
NO_OBJECT, NOT_MAPPABLE, TOO_LONG_PDO = 0x06020000, 0x06040041, 0x06040042
WRONG_LENGTH, NO_SUBINDEX, WRONG_VALUE = 0x06070010, 0x06090011, 0x06090030
TOO_HIGH, TOO_LOW, NOT_NOW = 0x06090031, 0x06090032, 0x08000022
_LOW_32 = 0xFFFF_FFFF


@loop_function
def row_of_object(d: Canopen, index: int, subindex: int) -> int:
    """Return the row of an object; -1 if there is no such index, -2 no such subindex."""
    missing = int64(-1)
    for i in range(d.n):
        if d.objects[i].index == index:
            missing = int64(-2)
            if d.objects[i].subindex == subindex:
                return int64(i)
    return missing


@loop_inline
def why_none(row: int) -> int:
    """Return the abort code of a row that was not found."""
    return NO_OBJECT if row == -1 else NO_SUBINDEX


@loop_inline
def from_bits(d: Canopen, row: int, word: int) -> int:
    """Return the value of an object in the lowest bits of a word."""
    bits = d.objects[row].bits
    raw = word & ((1 << bits) - 1)
    if d.objects[row].sign != 0 and raw >> (bits - 1) != 0:
        raw -= 1 << bits
    return raw


@loop_inline
def to_bits(d: Canopen, row: int) -> int:
    """Return the value of an object as bits from 0 on."""
    return d.value[row] & ((1 << d.objects[row].bits) - 1)


@loop_inline
def is_possible(d: Canopen, row: int, raw: int) -> bool:
    """Return whether an object may have a value within its bounds, wherever it comes from."""
    if row == Od.MODE:
        if raw < 0 or raw > 10:
            return False
        return raw == 0 or (d.value[Od.MODES] >> max(raw - 1, 0)) & 1 != 0
    if row == Od.QUICK_STOP_OPTION:
        return raw != 3 and raw != 4
    if row == Od.HOMING_METHOD:
        return raw != 36
    if row == Od.STARTUP:
        return raw == 0 or raw == 8
    return True


@loop_inline
def low_word(word: int) -> int:
    """Return the lower four bytes of eight, from 0 on."""
    return word & _LOW_32

"""PDOs as SDOs change them at run time: what may be written when, and what follows from it.

    COB-ID     bit 31: not valid; the id only while it is not valid
    type       0, 1 to 240: with SYNC; 254, 255: when it changes, at the event timer. Others, which
               are reserved or want remote frames, are refused
    mapping    only while the PDO is not valid; entries while their number is 0

Source: CiA 301, 7.5.2.35 to 7.5.2.38.
"""

from pcpc.drivers.canopen import layout as at
from pcpc.drivers.canopen.dictionary import (
    NO_OBJECT,
    NO_SUBINDEX,
    NOT_MAPPABLE,
    NOT_NOW,
    TOO_LONG_PDO,
    WRONG_VALUE,
    row_of_object,
)
from pcpc.drivers.canopen.layout import Canopen
from pcpc.drivers.compiled.jit import loop_function, loop_inline

MAX_BITS = 64
_LOWEST_ID, _HIGHEST_ID = 0x181, 0x57F  # of PDOs; others belong to other services
_ID, _FRAME_BIT = 0x7FF, 1 << 29
_NOT_VALID = 1 << 31
PDO_ROWS, FIRST_TPDO, RPDO_ROWS, TPDO_ROWS = at.OTHERS, at.FIRST_TPDO, at.RPDO_ROWS, at.TPDO_ROWS
RPDO_MAPPING, TPDO_MAPPING, PDOS = at.RPDO_MAPPING, at.TPDO_MAPPING, at.PDOS
COB_ID, KIND, INHIBIT, EVENT = at.COB_ID, at.KIND, at.INHIBIT, at.EVENT
MAX_ENTRIES, TO_DRIVE, FROM_DRIVE = at.MAX_ENTRIES, at.TO_DRIVE, at.FROM_DRIVE


@loop_inline
def pdo_of(row: int) -> int:
    """Return the number of the PDO to which a row belongs."""
    if row < FIRST_TPDO:
        return row // RPDO_ROWS
    return PDOS + (row - FIRST_TPDO) // TPDO_ROWS


@loop_inline
def first_row(p: int) -> int:
    """Return the first row of a PDO."""
    return p * RPDO_ROWS if p < PDOS else FIRST_TPDO + (p - PDOS) * TPDO_ROWS


@loop_inline
def mapping_row(p: int) -> int:
    """Return the row with the number of a PDO's entries."""
    return first_row(p) + (RPDO_MAPPING if p < PDOS else TPDO_MAPPING)


@loop_inline
def is_valid(d: Canopen, p: int) -> bool:
    """Return whether a PDO is in use."""
    return d.value[first_row(p) + COB_ID] & _NOT_VALID == 0


@loop_function
def why_not(d: Canopen, row: int, raw: int) -> int:
    """Return the abort code for a value of a PDO's row; 0 if it may be written."""
    p = pdo_of(row)
    offset, mapping = row - first_row(p), mapping_row(p)
    if offset == COB_ID:
        return _why_no_id(d, p, row, raw)
    if offset == KIND:
        return WRONG_VALUE if 240 < raw < 254 else 0
    if offset == INHIBIT and row < mapping:
        return NOT_NOW if is_valid(d, p) else 0
    if row < mapping:
        return 0
    if is_valid(d, p):
        return NOT_NOW
    if row > mapping:
        return NOT_NOW if d.value[mapping] != 0 else _why_no_entry(d, p, raw)
    bits = 0
    for i in range(raw):
        entry = d.value[mapping + 1 + i]
        why = _why_no_entry(d, p, entry)
        if why != 0 or entry == 0:
            return why if why != 0 else NO_OBJECT
        bits += entry & 255
    return TOO_LONG_PDO if bits > MAX_BITS else 0


@loop_inline
def _why_no_id(d: Canopen, p: int, row: int, raw: int) -> int:
    wanted = raw & _ID
    if raw & _FRAME_BIT != 0 or wanted < _LOWEST_ID or wanted > _HIGHEST_ID:
        return WRONG_VALUE
    if raw & _NOT_VALID == 0 and is_valid(d, p) and wanted != d.value[row] & _ID:
        return WRONG_VALUE
    return 0


@loop_function
def _why_no_entry(d: Canopen, p: int, entry: int) -> int:
    """Return why an object cannot be mapped; 0 of an entry that is empty or right."""
    if entry == 0:
        return 0
    row = row_of_object(d, entry >> 16, (entry >> 8) & 255)
    if row < 0:
        return NO_OBJECT if row == -1 else NO_SUBINDEX
    wanted = TO_DRIVE if p < PDOS else FROM_DRIVE
    if d.objects[row].access & wanted == 0 or d.objects[row].bits != entry & 255:
        return NOT_MAPPABLE
    return 0


@loop_function
def arrange(d: Canopen, p: int) -> None:
    """Take over what the objects of a PDO say; a sent one begins anew."""
    first, mapping = first_row(p), mapping_row(p)
    d.map_id[p] = d.value[first + COB_ID] & _ID if is_valid(d, p) else -1
    d.map_n[p] = d.value[mapping]
    for i in range(d.value[mapping]):
        entry = d.value[mapping + 1 + i]
        row = row_of_object(d, entry >> 16, (entry >> 8) & 255)
        if row < 0:
            d.map_n[p] = 0
            break
        d.map_row[p * MAX_ENTRIES + i] = row
    if p >= PDOS:
        d.sent_at[p - PDOS] = -1
        d.sync_count[p - PDOS] = 0
    else:
        d.pending[p] = 0

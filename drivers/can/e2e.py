"""End-to-end protection of frames: a counter and a CRC, checked by the receiver.

    crc   = CRC-8 SAE J1850 over [id low byte, id high byte, data bytes before the crc]
    crc   = CRC-16 CCITT-FALSE over [all data bytes but the crc, id low byte, id high byte]
    delta = (counter - last counter) mod 2^bits

    state            when                              used   counts
    OK               delta = 1, or the first frame     yes    received
    OK_SOME_LOST     2 <= delta <= MAX_DELTA           yes    received, lost += delta - 1
    REPEATED         delta = 0                         no     repeated
    WRONG_SEQUENCE   delta > MAX_DELTA                 no     wrong_sequence, lost += missing
    ERROR            wrong length or CRC               no     errors
    NOT_AVAILABLE    no frame yet                      -      -

In a receiver's row `last_counter` is -1 before the first frame; `state` judges the latest one; the
next five count since the start; `age_cycles` is since the last used frame, or the start; `fresh` is
1 if one was used in this cycle; `still_cycles` is since the counter moved.

ERROR leaves the counter as it was; WRONG_SEQUENCE takes it over, so that the next frame is OK.
`missing` is delta - 1, but no more than the cycles since the counter last moved had frames: a burst
that is lost is counted in full, a counter that jumps at will is not believed. A frame without
protection is OK when its length is right. CRC-8 SAE J1850: polynomial 0x1D, start
0xFF, not reflected, inverted at the end; "123456789" gives 0x4B. It detects every error of 1 or 2
bits in 8 bytes. The CRC-16, with a counter of 8 bits, is that of AUTOSAR's E2E profile 5:
polynomial 0x1021, start 0xFFFF, not reflected; "123456789" gives 0x29B1. It detects every error of
1 to 3 bits, and of any odd number. Source: SAE J1850; AUTOSAR, E2E protocol specification.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.dbc import Protection
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.compiled.jit import compiled, inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FrameRow, Receiver

MAX_DELTA = 4  # 3 frames lost in a row: as many as trip the plant's watchdog


def _crc_table(polynomial: int, bits: int) -> NDArray[np.uint64]:
    """Return what a byte does to a CRC; unsigned, since numba tests a signed index for its sign."""
    table = np.zeros(256, np.uint64)
    for byte in range(256):
        crc = byte << bits - 8
        for _ in range(8):
            crc = (crc << 1) ^ (polynomial if crc >> bits - 1 & 1 else 0)
        table[byte] = crc & (1 << bits) - 1
    return table


_CRC_TABLE = _crc_table(0x1D, 8)
_CRC_16_TABLE = _crc_table(0x1021, 16)


def new_state(n_frames: int) -> NDArray[Any]:
    """Return the state (n_frames,) of a receiver that has heard nothing, rows of Receiver."""
    state = np.zeros(n_frames, Receiver.dtype)
    state["last_counter"], state["state"] = -1, FrameState.NOT_AVAILABLE
    return state


@inline
def crc8(can_id: int, data: Cells[Byte], n_bytes: int) -> int:
    """Return the CRC-8 over two bytes of the id, low first, and the first `n_bytes` of `data`.

    `data`: (n,).
    """
    crc = _CRC_TABLE[np.uint64(0xFF ^ (can_id & 0xFF))]
    crc = _CRC_TABLE[crc ^ np.uint64((can_id >> 8) & 0xFF)]
    for i in range(n_bytes):
        crc = _CRC_TABLE[crc ^ np.uint64(data[i])]
    return int64(crc) ^ 0xFF


@compiled()
def crc16(data_id: int, data: Cells[Byte], crc_byte: int, n_bytes: int) -> int:
    """Return the CRC-16 over `n_bytes` of `data` (n,) but two at `crc_byte`, and two of the id."""
    crc = np.uint64(0xFFFF)
    for i in range(n_bytes + 2):
        byte = data[i] if i < n_bytes else data_id >> 8 * (i - n_bytes)
        if i < crc_byte or i > crc_byte + 1:
            known = _CRC_16_TABLE[(crc >> np.uint64(8) ^ np.uint64(byte)) & np.uint64(0xFF)]
            crc = crc << np.uint64(8) & np.uint64(0xFFFF) ^ known
    return int64(crc)


@compiled()
def right_crc(data: Cells[Byte], frame: int, frames: Cells[FrameRow]) -> int:
    """Return the CRC that belongs to `data` (n,) of a protected frame of `frames` (rows,)."""
    crc_byte = frames[frame].crc_byte
    if frames[frame].protected == Protection.CRC_16:
        return crc16(frames[frame].data_id, data, crc_byte, frames[frame].dlc)
    return crc8(frames[frame].can_id, data, crc_byte)


@compiled()
def crc_of(data: Cells[Byte], frame: int, frames: Cells[FrameRow]) -> int:
    """Return the CRC that stands in `data` (n,) of a protected frame of `frames` (rows,)."""
    crc_byte = frames[frame].crc_byte
    crc = int64(data[crc_byte])
    if frames[frame].protected == Protection.CRC_16:
        crc |= int64(data[crc_byte + 1]) << 8
    return crc


@compiled()
def put_crc(data: Cells[Byte], frame: int, frames: Cells[FrameRow], crc: int) -> None:
    """Write a CRC into the data of a protected frame, as many bits of it as it has.

    `data` (n,), `frames` (rows,).
    """
    crc_byte = frames[frame].crc_byte
    data[crc_byte] = crc & 0xFF
    if frames[frame].protected == Protection.CRC_16:
        data[crc_byte + 1] = crc >> 8 & 0xFF


@inline
def protect(data: Cells[Byte], frame: int, frames: Cells[FrameRow], counter: int) -> None:
    """Write counter (modulo its width) and CRC into packed `data`; does nothing to a frame without.

    `counter` is the SYNC sequence in a frame of every cycle, the transmission's number in others.
    `data` (n,), `frames` (rows,).
    """
    if frames[frame].protected == Protection.UNPROTECTED:
        return
    byte, shift = frames[frame].counter_byte, frames[frame].counter_shift
    mask = frames[frame].counter_mask
    kept = int64(data[byte]) & ~(mask << shift)
    data[byte] = kept | ((counter & mask) << shift)
    if frames[frame].protected == Protection.CRC_8:
        last = frames[frame].crc_byte
        data[last] = crc8(frames[frame].can_id, data, last)
    else:
        put_crc(data, frame, frames, right_crc(data, frame, frames))


@inline
def begin_cycle(state: Cells[Receiver], n_frames: int) -> None:
    """Age the first frames by one cycle; call it once per cycle before the frames are drained.

    `state`: (rows,).
    """
    for row in range(n_frames):
        age(state, row)


@inline
def age(state: Cells[Receiver], row: int) -> None:
    """Age a frame of `state` (rows,) by one cycle."""
    state[row].age_cycles += 1
    state[row].still_cycles += 1
    state[row].fresh = 0


@inline
def _use(state: Cells[Receiver], frame: int, outcome: int) -> None:
    state[frame].state = outcome
    state[frame].received += 1
    state[frame].age_cycles = 0
    state[frame].fresh = 1


@inline
def check(
    data: Cells[Byte],
    length: int,
    frame: int,
    frames: Cells[FrameRow],
    state: Cells[Receiver],
) -> tuple[int, int]:
    """Judge a received frame of `length` bytes and update its row of `state`.

    Returns the receiver state and the number of frames lost before this one. Decode the frame only
    if the state is OK or OK_SOME_LOST. `data` (n,); `frames`, `state` (rows,) each.
    """
    last, protected = frames[frame].crc_byte, frames[frame].protected
    if length != frames[frame].dlc or (
        crc8(frames[frame].can_id, data, last) != int64(data[last])
        if protected == Protection.CRC_8
        else protected != Protection.UNPROTECTED
        and right_crc(data, frame, frames) != crc_of(data, frame, frames)
    ):
        state[frame].state = FrameState.ERROR
        state[frame].errors += 1
        return FrameState.ERROR, 0
    if protected == Protection.UNPROTECTED:
        _use(state, frame, FrameState.OK)
        return FrameState.OK, 0
    mask = frames[frame].counter_mask
    counter = (int64(data[frames[frame].counter_byte]) >> frames[frame].counter_shift) & mask
    before = state[frame].last_counter
    delta = (counter - before) & mask if before >= 0 else 1
    if delta == 0:
        state[frame].state = FrameState.REPEATED
        state[frame].repeated += 1
        return FrameState.REPEATED, 0
    missing = delta - 1
    if delta > MAX_DELTA:
        turns = state[frame].still_cycles // frames[frame].every_n
        missing = min(missing, max(turns - 1, int64(0)))
    state[frame].last_counter = counter
    state[frame].still_cycles = 0
    state[frame].lost += missing
    if delta > MAX_DELTA:
        state[frame].state = FrameState.WRONG_SEQUENCE
        state[frame].wrong_sequence += 1
        return FrameState.WRONG_SEQUENCE, missing
    outcome = FrameState.OK if delta == 1 else FrameState.OK_SOME_LOST
    _use(state, frame, outcome)
    return outcome, missing

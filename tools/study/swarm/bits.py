"""What the bits of frames say, read one by one: a second derivation beside the codec's."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.tools.study.swarm.files import World, bits_of, scale


def crc_of(rows: NDArray[Any], frame: World, word: int) -> NDArray[np.int64]:
    """Return the CRC that belongs to each frame, a bit at a time."""
    bits, polynomial = (8, 0x1D) if frame["crc"] == 8 else (16, 0x1021)
    data = rows["data"].astype(np.int64)
    place = frame["signals"]["crc"]["start"] // 8
    ids = [np.full(len(rows), word & 0xFF), np.full(len(rows), word >> 8)]
    own = range(place, place + bits // 8)
    columns = [data[:, i] for i in range(frame["length"]) if i not in own]
    columns = [*ids, *columns] if bits == 8 else [*columns, *ids]
    crc = np.full(len(rows), (1 << bits) - 1)
    for column in columns:
        crc = crc ^ (column << bits - 8)
        for _ in range(8):
            crc = ((crc << 1) ^ np.where(crc >> bits - 1 & 1, polynomial, 0)) & (1 << bits) - 1
    return crc ^ 0xFF if bits == 8 else crc


def number(data: NDArray[np.uint8], signal: Mapping[str, Any]) -> NDArray[Any]:
    """Return the raw value of a signal in each row of data, bit by bit; (n,)."""
    found = np.zeros(len(data), np.int64)
    for i, at in enumerate(bits_of(signal)):
        bit = data[:, at // 8].astype(np.int64) >> at % 8 & 1
        found |= bit << (signal["bits"] - 1 - i if signal["big"] else i)
    if signal["kind"] == "float":
        with np.errstate(invalid="ignore"):  # a NaN that signals
            return found.astype(np.uint32).view(np.float32).astype(np.float64)
    if signal["kind"] == "signed":
        found -= (found >> signal["bits"] - 1) << signal["bits"]
    return found


def value(data: NDArray[np.uint8], signal: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the value of a signal in each row."""
    factor, offset = scale(signal)
    return np.asarray(number(data, signal) * factor + offset, float)

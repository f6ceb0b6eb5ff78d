"""Frames as a log has them: their records, and those records as a bus has them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.rows import HEAD_BYTES
from pcpc.executive.log import checks as log_checks
from pcpc.executive.loop.ring_layout import data_bytes

CDR_BYTES = 4  # the header of a CDR payload: 00 01 00 00, little-endian
FRAME, FD_FRAME = (
    np.dtype([
        ("stamp_ns", "<i8"), ("cycle", "<i8"), ("id", "<u4"), ("dlc", "u1"),
        ("direction", "u1"), ("e2e", "u1"), ("flags", "u1"), ("data", "u1", (n,)),
    ])
    for n in (8, 64)
)  # fmt: skip
FRAME_SIZES = (FRAME.itemsize, FD_FRAME.itemsize)


def frame_type(about: Mapping[str, Any]) -> np.dtype[Any]:
    """Return the type of a node's frames, by its description."""
    return FD_FRAME if data_bytes(about) > 8 else FRAME


def frames_in(messages: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the frames of messages (n,), and which of them a bus could have carried."""
    payload = np.ascontiguousarray(messages["data"][:, CDR_BYTES:])
    frames = payload.view(FRAME if payload.shape[1] == FRAME.itemsize else FD_FRAME)[:, 0]
    return frames, log_checks.possible_frames(frames)


def on_bus(frames: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of frames (n,) as a bus has them, see `drivers.can.wire_layout`.

    Shape (n, 16), with CAN FD (n, 72).
    """
    width = frames["data"].shape[1]
    raw = np.zeros((len(frames), HEAD_BYTES + width), np.uint8)
    raw[:, :4] = np.ascontiguousarray(frames["id"]).view(np.uint8).reshape(-1, 4)
    raw[:, 4] = frames["dlc"]
    raw[:, 5] = frames["flags"] if width > 8 else 0
    raw[:, HEAD_BYTES:] = frames["data"]
    return raw

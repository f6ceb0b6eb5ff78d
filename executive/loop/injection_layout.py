"""What the loop keeps of faults on purpose: a part of the LOOP record."""

from typing import Any

from pcpc.drivers.can.wire_layout import FRAME_BYTES
from pcpc.drivers.compiled.rows import RECEIVER

MAX_FAULTS = 32
FAULT_DEPTH = 64  # values or frames that a fault may hold back


def faults(frames: int) -> list[Any]:
    """Return the fields: of values, of frames, of floods; `frames`: how many a node receives."""
    return [
        ("n", "<i8"),
        ("n_values", "<i8"),
        ("n_floods", "<i8"),  # behind the first n
        ("n_places", "<i8"),
        ("every_place", "<i8", (MAX_FAULTS,)),  # of `left`, of faults and stalls
        ("n_own_stalls", "<i8"),
        ("own_stall", "<i8", (MAX_FAULTS,)),  # places of `left`
        ("n_peer_stalls", "<i8"),
        ("peer_stall", "<i8", (MAX_FAULTS,)),
        ("stalled", "<i8"),  # periods of a stall since the last cycle
        ("kind", "<i8", (MAX_FAULTS,)),
        ("how", "<i8", (MAX_FAULTS,)),
        ("place", "<i8", (MAX_FAULTS,)),  # of `fault.NAME.left`
        ("seam", "<i8", (MAX_FAULTS,)),
        ("goes_on", "<i8", (MAX_FAULTS,)),  # a counter, after its fault
        ("target", "<i8", (MAX_FAULTS,)),  # a variable, a row of the received frames, an id
        ("other", "<i8", (MAX_FAULTS,)),  # a further row
        ("seed", "<i8", (MAX_FAULTS,)),
        ("acting", "<i8", (MAX_FAULTS,)),
        ("since", "<i8", (MAX_FAULTS,)),  # the cycle in which it began, -1 while it is off
        ("true", "<f8", (MAX_FAULTS,)),
        ("kept", "<f8", (MAX_FAULTS,)),
        ("earlier", "<f8", (MAX_FAULTS, FAULT_DEPTH)),
        ("count", "<i8", (MAX_FAULTS,)),  # frames held back
        ("first", "<i8", (MAX_FAULTS,)),
        ("waiting", "u1", (MAX_FAULTS, FAULT_DEPTH, FRAME_BYTES)),
        ("raw", "u1", (FRAME_BYTES,)),
        ("another", "u1", (FRAME_BYTES,)),
        ("shown", "<i8"),  # 1: what is wrong with the frame at hand was done on purpose
        ("spoiled", "<i8", (frames,)),  # 1: losses or faults may act on them
        ("on_wire", RECEIVER, (frames,)),  # receivers of these as they came
        ("missed", "<i8"),  # cycles in a row without input that nothing took on purpose
        ("acted", "<i8", (frames,)),  # pass + 1 in which a fault last acted on frames of a row
    ]

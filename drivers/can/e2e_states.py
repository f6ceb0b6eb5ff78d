"""What a receiver makes of a frame, states and names without numba; see `drivers.can.e2e`."""

from typing import TYPE_CHECKING, Any

from pcpc.drivers.compiled.numbered import NumberedEnum

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class FrameState(NumberedEnum):
    """The states of a received frame; the last three are not judged.

    LOST_ON_PURPOSE: a rig lets it be lost. FOREIGN: from another sender of a frame of ours.
    BUS_ERROR: no frame, but what the CAN controller told.
    """

    OK, OK_SOME_LOST, REPEATED, WRONG_SEQUENCE, ERROR, NOT_AVAILABLE = range(6)
    LOST_ON_PURPOSE, FOREIGN, BUS_ERROR = range(6, 9)


INJECTED = 16  # added to the state of a frame that a fault on purpose put on the way
_NAMES = FrameState.names()


def are_of_wire(states: "int | NDArray[np.integer]") -> Any:
    """Return whether frames of these states, (n,) or one, came as they are over the wire."""
    return states < INJECTED


def name_of(state: int) -> str:
    """Return the name of a state in a log; of an injected frame, INJECTED with its state."""
    first, rest = ("INJECTED_", state - INJECTED) if state >= INJECTED else ("", state)
    return first + (_NAMES[rest] if rest < len(_NAMES) else str(rest))

"""What a receiver makes of a frame, states and names without numba; see `drivers.can.e2e`."""

OK, OK_SOME_LOST, REPEATED, WRONG_SEQUENCE, ERROR, NOT_AVAILABLE = range(6)
ON_PURPOSE = 6  # not judged: a rig lets it be lost
FOREIGN = 7  # not judged: from another sender of a frame of ours
BUS_ERROR = 8  # not judged: no frame, but what the CAN controller told
INJECTED = 16  # added to the state of a frame that a fault on purpose put on the way
STATE_NAMES = (
    "OK", "OK_SOME_LOST", "REPEATED", "WRONG_SEQUENCE", "ERROR", "NOT_AVAILABLE",
    "LOST_ON_PURPOSE", "FOREIGN", "BUS_ERROR",
)  # fmt: skip


def name_of(state: int) -> str:
    """Return the name of a state in a log; of an injected frame, INJECTED with its state."""
    first, rest = ("INJECTED_", state - INJECTED) if state >= INJECTED else ("", state)
    return first + (STATE_NAMES[rest] if rest < len(STATE_NAMES) else str(rest))

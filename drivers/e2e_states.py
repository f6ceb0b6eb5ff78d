"""What a receiver makes of a frame, states and names without numba; see `drivers.e2e`."""

OK, OK_SOME_LOST, REPEATED, WRONG_SEQUENCE, ERROR, NOT_AVAILABLE = range(6)
ON_PURPOSE = 6  # not judged: a rig lets it be lost
FOREIGN = 7  # not judged: from another sender of a frame of ours
STATE_NAMES = (
    "OK", "OK_SOME_LOST", "REPEATED", "WRONG_SEQUENCE", "ERROR", "NOT_AVAILABLE",
    "LOST_ON_PURPOSE", "FOREIGN",
)  # fmt: skip

"""The memory of a robot's drive, as a structure that the compiled loop uses (no numba here).

    value     its settings, in the order of the dialect's own table (`odrive`, `mit`, `moteus`)
    state     what it carries from one cycle to the next, in the units of its protocol

Where it measures, its gains, its outbox: those of `drivers.canopen.layout.DRIVE`.
"""

import numpy as np

from pcpc.drivers.compiled.numbered import NumberedEnum, WordedEnum
from pcpc.drivers.compiled.rows import row_of

MAX_SETTINGS = 64
CYCLIC = 8  # frames that are sent by themselves, at most


class Dialect(NumberedEnum):
    """Which one it speaks."""

    NONE, ODRIVE, MIT, MOTEUS = range(4)


class Mistake(WordedEnum):
    """What a master does wrong, counted; behind `master.` the name of a variable."""

    FRAME_SHORT = "frame was shorter than its command"
    NOT_FINITE = "value was no finite number"
    COMMAND_REFUSED = "command was none that the drive has, or not now"
    VALUE_REFUSED = "setting was not there, or its value outside of its bounds"
    TARGET_CLIPPED = "target was outside the limits"
    SILENT = "master was silent for longer than the drive waits"
    NOT_SWITCHED = "frame of CAN FD came without the bit rate switch of the bus"


SETTING = row_of("number whole writable", "start low high")
STATE = row_of(  # regained: 1 once the master has given gains; way: what is demanded of the loops
    "power errors disarmed_by result arrived boots beat_at fed_at regained",
    "position velocity torque offset"
    " target_position target_velocity target_torque stiffness damping most_velocity most_torque"
    " way_position way_velocity way_torque integral",
)
ROBOT = np.dtype(
    [
        ("dialect", "<i8"),
        ("n", "<i8"),  # settings
        ("position_scale", "<f8"),  # of the protocol's unit to that of the plant
        ("velocity_scale", "<f8"),
        ("settings", SETTING, (MAX_SETTINGS,)),
        ("cursor", row_of("at end ok out answers mode")),  # in a frame and its answer
        # from here on kept in keyframes
        ("value", "<f8", (MAX_SETTINGS,)),
        ("state", STATE),
        ("mistakes", "<i8", (len(Mistake),)),
        ("switches", "<i8"),  # 1: the bus has a second bit rate
        ("sent_at", "<i8", (CYCLIC,)),
    ],
    align=True,
)
KEPT = ("value", "state", "mistakes", "sent_at")

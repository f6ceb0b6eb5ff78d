"""Keys of a rig file: who else is on its bus, a watchdog, and what the plant is to a master."""

# ruff: noqa: RUF012  msgspec gives each mapping its own copy of a mutable default

from typing import Annotated, Literal

from msgspec import Meta

from pcpc.executive.rig.keyed import Keyed

Positive = Annotated[float, Meta(gt=0, le=1e12)]
Gain = Annotated[float, Meta(ge=0, le=1e9)]


class Watchdog(Keyed):
    """A process that sees only the bus and sends the stop frame; see `tools.live.watchdog`."""

    silent_cycles: Annotated[int, Meta(ge=2)] = 50
    wrong_frames: Annotated[int, Meta(ge=1, le=10)] = 3
    feed: str | None = None


class Scale(Keyed):
    """The protocol's unit to that of what is measured; an acceleration has that of the position.

    None: 1000 increments of CiA 402, turns for a radian (ODrive, moteus), 1 for MIT.
    """

    position: Positive | None = None
    velocity: Positive | None = None


class Gains(Keyed):
    """Of the drive's loops, see `drivers.canopen.motion`; `velocity`: command to velocity."""

    position_per_s: Gain
    velocity: Gain
    integral_per_s: Gain = 0.0


class Drive(Keyed):
    """The plant as a drive on CAN: a block's input is wired to `drive.command`.

    `position`, `velocity`: variables that it measures; without a velocity, differences. `rated`:
    the command at 100 %, of a robot's drive at a torque of 1. `eds`: EDS or DCF of the real one.
    `objects`: values at the start, by index and subindex (6085, 1800.3), or a setting's name.
    """

    profile: Literal["cia402", "odrive", "mit", "moteus"]
    node: Annotated[int, Meta(ge=0, le=255)]
    position: str
    velocity: str | None = None
    rated: Positive
    scale: Scale = Scale()
    gains: Gains
    eds: str | None = None
    objects: dict[str | int, int | float] = {}

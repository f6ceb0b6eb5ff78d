"""The plant's drive in a robot's dialect, planned: its settings, its ids, its hooks."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pcpc.drivers.robots import mit, moteus, moteus_registers, odrive, odrive_settings, settings
from pcpc.drivers.robots.layout import Dialect
from pcpc.executive.loop.robot_drive import hear_robot, speak_robot, work_robot
from pcpc.executive.rig.bus_keys import Drive
from pcpc.executive.rig.reading import Rig

HOOKS = hear_robot, work_robot, speak_robot


class Kind(NamedTuple):
    """A dialect: its number, the highest node, its settings, its scale, and the ids of a node.

    `first`: the lowest node.
    """

    dialect: Dialect
    nodes: int
    settings: Sequence[settings.Setting]
    scale: float
    ids: Callable[[int], set[int]]
    first: int = 0


KINDS = {
    "odrive": Kind(
        Dialect.ODRIVE, odrive.NODES - 1, odrive_settings.SETTINGS, 0.5 / math.pi,
        lambda node: {node << 5 | command for command in range(32)},
    ),
    "mit": Kind(
        Dialect.MIT, mit.NODES - 1, mit.SETTINGS, 1.0,
        lambda node: {node, 0x100 + node, 0x200 + node, 0x300 + node, mit.REGISTERS},
    ),
    "moteus": Kind(
        Dialect.MOTEUS, moteus.NODES - 1, moteus_registers.SETTINGS, 0.5 / math.pi,
        lambda node: {source << 8 | moteus.ANSWER * asks | whom for source in range(128)
                      for asks in (0, 1) for whom in (node, moteus.NODES)}
        | {node << 8 | whom for whom in range(128)},
        first=1,
    ),
}  # fmt: skip


def settings_of(rig: Rig, drive: Drive) -> list[settings.Setting]:
    """Return the drive's settings as they are at the start; RigError for what cannot be."""
    kind, at = KINDS[drive.profile], rig.config.key_of(drive)
    if not kind.first <= drive.node <= kind.nodes:
        what = f"{drive.node} is not one of {kind.first} to {kind.nodes}"
        raise rig.error(f"{at}.node", what)
    if drive.eds is not None:
        raise rig.error(f"{at}.eds", f"{drive.profile} has no EDS; leave it out")
    try:
        starts = {str(key): float(value) for key, value in drive.objects.items()}
        return settings.started(kind.settings, starts)
    except ValueError as error:
        raise rig.error(f"{at}.objects", str(error)) from None


def own_ids(rig: Rig, drive: Drive) -> set[int]:
    """Return the ids that are the drive's."""
    values = {one.name: one.start for one in settings_of(rig, drive)}
    master = {int(values["MST_ID"])} if drive.profile == "mit" else set()
    return KINDS[drive.profile].ids(drive.node) | master


def spoken_ids(rig: Rig, drive: Drive) -> set[int]:
    """Return those that no other drive on its bus may have; a master's orders may be to many."""
    if drive.profile == "mit":
        return own_ids(rig, drive) - {mit.REGISTERS}
    if drive.profile == "moteus":
        return {drive.node << 8 | whom for whom in range(128)} | {drive.node}
    return own_ids(rig, drive)


def names(rig: Rig, drive: Drive) -> dict[int, str]:
    """Return what the drive's frames are called, by id."""
    if drive.profile == "odrive":
        return {drive.node << 5 | one: one.name.lower() for one in odrive_settings.Command}
    if drive.profile == "mit":
        values = {one.name: one.start for one in settings_of(rig, drive)}
        found = {drive.node: "MIT", 0x100 + drive.node: "position", 0x200 + drive.node: "velocity"}
        return found | {int(values["MST_ID"]): "feedback", mit.REGISTERS: "register"}
    return {}


def install_robot(loop: Any, rig: Rig, drive: Drive) -> None:
    """Write the drive into the LOOP record, but for what `planned_drive` does."""
    kind, r = KINDS[drive.profile], loop.robot
    settings.install(r, kind.dialect, settings_of(rig, drive))
    loop.canopen.node, loop.canopen.on = drive.node, 1
    r.switches = rig.config.bus.data_bitrate is not None
    r.position_scale = kind.scale if drive.scale.position is None else drive.scale.position
    r.velocity_scale = kind.scale if drive.scale.velocity is None else drive.scale.velocity

"""The plant's drive in a robot's dialect, planned: its settings, its ids, its names."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from pcpc.drivers.machine import outside
from pcpc.drivers.robots import mit, moteus, moteus_registers, odrive, odrive_settings, settings
from pcpc.drivers.robots.layout import Dialect
from pcpc.executive.loop.layout import Loop
from pcpc.executive.rig.bus_keys import Drive
from pcpc.executive.rig.reading import Rig

Starts = Mapping[str, float]


class RobotKind(NamedTuple):
    """A dialect: its number, its nodes, its settings, its scale; of a node and these its ids.

    `spoken_ids`: those that no other drive on its bus may have; a master's orders may be to many.
    `names`: what its frames are called, by id. `hooks`: of one from outside: what hears,
    works and speaks for a LOOP record, as in `executive.loop.plant_drive`.
    """

    dialect: Dialect
    nodes: range
    settings: Sequence[settings.Setting]
    scale: float
    ids: Callable[[int, Starts], set[int]]
    spoken_ids: Callable[[int, Starts], set[int]]
    names: Callable[[int, Starts], dict[int, str]]
    hooks: tuple[Any, Any, Any] | None = None


def _odrive_ids(node: int, _: Starts) -> set[int]:
    return {node << 5 | command for command in range(32)}


def _mit_ids(node: int, starts: Starts) -> set[int]:
    return {node, 0x100 + node, 0x200 + node, 0x300 + node, int(starts["MST_ID"])}


KINDS = {
    "odrive": RobotKind(
        Dialect.ODRIVE, range(odrive.NODES), odrive_settings.SETTINGS, 0.5 / math.pi,
        _odrive_ids, _odrive_ids,
        lambda node, _: {node << 5 | one: one.name.lower() for one in odrive_settings.CommandId},
    ),
    "mit": RobotKind(
        Dialect.MIT, range(mit.NODES), mit.SETTINGS, 1.0,
        lambda node, starts: _mit_ids(node, starts) | {mit.REGISTERS}, _mit_ids,
        lambda node, starts: {
            node: "MIT", 0x100 + node: "position", 0x200 + node: "velocity",
            int(starts["MST_ID"]): "feedback", mit.REGISTERS: "register",
        },
    ),
    "moteus": RobotKind(
        Dialect.MOTEUS, range(1, moteus.NODES), moteus_registers.SETTINGS, 0.5 / math.pi,
        lambda node, _: {source << 8 | moteus.ANSWER * asks | whom for source in range(128)
                         for asks in (0, 1) for whom in (node, moteus.NODES)}
        | {node << 8 | whom for whom in range(128)},
        lambda node, _: {node << 8 | whom for whom in range(128)} | {node},
        lambda node, _: {},
    ),
}  # fmt: skip


def kind_of(profile: str) -> RobotKind:
    """Return a robot's dialect, ours or that of a package of others; UserError."""
    one = None if profile in KINDS else outside.named("drives", profile)
    if one is None:
        return KINDS[profile]
    found = outside.loaded(one)
    if not isinstance(found, RobotKind) or found.hooks is None:
        raise outside.broken(one, f"{one.target} is no RobotKind with hooks")
    return found


def settings_of(rig: Rig, drive: Drive) -> list[settings.Setting]:
    """Return the drive's settings as they are at the start; RigError for what cannot be."""
    kind, section = kind_of(drive.profile), rig.config.key_of(drive)
    if drive.node not in kind.nodes:
        what = f"{drive.node} is not one of {kind.nodes[0]} to {kind.nodes[-1]}"
        raise rig.error(f"{section}.node", what)
    if drive.eds is not None:
        raise rig.error(f"{section}.eds", f"{drive.profile} has no EDS; leave it out")
    try:
        starts = {str(key): float(value) for key, value in drive.objects.items()}
        return settings.changed_settings(kind.settings, starts)
    except ValueError as error:
        raise rig.error(f"{section}.objects", str(error)) from None


def install_robot(loop: Loop, rig: Rig, drive: Drive) -> None:
    """Write the drive into the LOOP record, but for what `planned_drive` does."""
    kind, r = kind_of(drive.profile), loop.robot
    settings.install(r, kind.dialect, settings_of(rig, drive))
    loop.canopen.node, loop.canopen.on = drive.node, 1
    r.switches = rig.config.bus.data_bitrate is not None
    r.position_scale = kind.scale if drive.scale.position is None else drive.scale.position
    r.velocity_scale = kind.scale if drive.scale.velocity is None else drive.scale.velocity

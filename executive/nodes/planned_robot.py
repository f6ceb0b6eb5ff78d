"""The plant's drive in a robot's dialect, planned: its settings, its ids, its names."""

import math
from collections.abc import Callable, Container, Mapping, Sequence
from types import ModuleType
from typing import NamedTuple

from pcpc.drivers.compiled.stage import entry_of
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.machine import outside
from pcpc.drivers.robots import (
    mit,
    moteus,
    moteus_registers,
    odrive,
    odrive_settings,
    robstride,
    settings,
)
from pcpc.drivers.robots.layout import Robot
from pcpc.executive.rig.bus_keys import Drive
from pcpc.executive.rig.reading import Rig

Starts = Mapping[str, float]
HOOKS = "hear", "work", "speak"  # of a dialect's module, each of a Robot record


class RobotKind(NamedTuple):
    """A dialect: what it does, its nodes, its settings, its scale; of a node and these its ids.

    `spoken_ids`: those that no other drive on its bus may have; a master's orders may be to many.
    `names`: what its frames are called, by id.
    """

    dialect: ModuleType | None
    nodes: range
    settings: Sequence[settings.Setting]
    scale: float
    ids: Callable[[int, Starts], Container[int]]
    spoken_ids: Callable[[int, Starts], set[int]]
    names: Callable[[int, Starts], dict[int, str]]


def _odrive_ids(node: int, _: Starts) -> set[int]:
    return {node << 5 | command for command in range(32)}


def _mit_ids(node: int, starts: Starts) -> set[int]:
    return {node, 0x100 + node, 0x200 + node, 0x300 + node, int(starts["MST_ID"])}


class _Addressed(Container[int]):
    """The ids of 29 bits to a RobStride, but for type 0, which are as short as others'."""

    def __init__(self, node: int) -> None:
        self.node = node

    def __contains__(self, number: object) -> bool:
        return isinstance(number, int) and number >> 24 > 0 and number & 0xFF == self.node


KINDS = {
    "odrive": RobotKind(
        odrive, range(odrive.NODES), odrive_settings.SETTINGS, 0.5 / math.pi,
        _odrive_ids, _odrive_ids,
        lambda node, _: {node << 5 | one: one.name.lower() for one in odrive_settings.CommandId},
    ),
    "mit": RobotKind(
        mit, range(mit.NODES), mit.SETTINGS, 1.0,
        lambda node, starts: _mit_ids(node, starts) | {mit.REGISTERS}, _mit_ids,
        lambda node, starts: {
            node: "MIT", 0x100 + node: "position", 0x200 + node: "velocity",
            int(starts["MST_ID"]): "feedback", mit.REGISTERS: "register",
        },
    ),
    "moteus": RobotKind(
        moteus, range(1, moteus.NODES), moteus_registers.SETTINGS, 0.5 / math.pi,
        lambda node, _: {source << 8 | moteus.ANSWER * asks | whom for source in range(128)
                         for asks in (0, 1) for whom in (node, moteus.NODES)}
        | {node << 8 | whom for whom in range(128)},
        lambda node, _: {node << 8 | whom for whom in range(128)} | {node},
        lambda node, _: {},
    ),
    "robstride": RobotKind(
        robstride, range(1, robstride.NODES), robstride.SETTINGS, 1.0,
        lambda node, _: _Addressed(node), lambda node, _: {2 << 24 | node << 8},
        lambda node, _: {2 << 24 | bits << 16 | node << 8 | robstride.HOST: "feedback"
                         for bits in (0, 0x80)},
    ),
}  # fmt: skip


def kind_of(profile: str) -> RobotKind:
    """Return a robot's dialect, ours or that of a package of others; UserError."""
    addition = None if profile in KINDS else outside.named("drives", profile)
    if addition is None:
        return KINDS[profile]
    kind = outside.loaded(addition)
    if not isinstance(kind, RobotKind):
        raise outside.broken(
            addition, f"{addition.target} is of type {type(kind).__name__}, not RobotKind"
        )
    if lacking := [name for name in HOOKS if not hasattr(kind.dialect, name)]:
        raise outside.broken(addition, f"its dialect has no {', '.join(lacking)}")
    return kind


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


def install_robot(r: Robot, rig: Rig, drive: Drive) -> None:
    """Write the drive into its record, but for what `planned_drive` does."""
    kind, of_robot = kind_of(drive.profile), structure(Robot.dtype)
    settings.install(r, settings_of(rig, drive))
    r.node, r.switches = drive.node, rig.config.bus.data_bitrate is not None
    r.position_scale = kind.scale if drive.scale.position is None else drive.scale.position
    r.velocity_scale = kind.scale if drive.scale.velocity is None else drive.scale.velocity
    hooks = [getattr(kind.dialect, name) for name in HOOKS]
    r.hears, r.works, r.speaks = (entry_of(one, of_robot) for one in hooks)

"""What the host of a run tells its node processes, and which nodes a command starts."""

import os

from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.run.commands import RunRequest
from pcpc.tools.start.children import Child


def child_arguments(request: RunRequest, bus: str) -> list[str]:
    """Return the arguments of a node's process behind its role."""
    arguments = [request.rig, "--with-parent", str(os.getpid()), "--bus", bus]
    for name, value in (("--pacing", request.pacing), ("--controller", request.controller)):
        if value:
            arguments += [name, value]
    return arguments + [word for setting in request.set for word in ("--set", setting)]


def check_only(request: RunRequest) -> None:
    """Raise UserError for options that do not go with --only, or without it."""
    if request.only != "plant":
        request.refuse("only with --only plant", "node")
    if request.only in ("executive", "local"):
        request.refuse("it takes the executive's place; leave out --only", "device")


def chosen_nodes(request: RunRequest, rig: Rig) -> tuple[Role, ...]:
    """Return the nodes to start: all, or those of --only; RigError."""
    only: Role | None = request.only
    if only == "local" and rig.config.local is None:
        raise RigError(f"{request.rig}: has no local node; use --only executive and --only plant")
    if only == "plant":
        return chosen_plants(request, rig)
    return rig.roles[::-1] if only is None else (only,)


def chosen_plants(request: RunRequest, rig: Rig) -> tuple[Role, ...]:
    """Return the plants to start: all, or that of --node; RigError."""
    plants = tuple(rig.config.plants)
    if request.node is None:
        return plants
    if request.node not in plants:
        what = f"--node {request.node}: no such plant{did_you_mean(request.node, plants)}"
        raise RigError(f"{request.rig}: {what}")
    return (request.node,)


def was_told_to_end(child: Child) -> bool:
    """Return whether it is no node, and died because this process asked it to end."""
    return child.asked and child.name in ("line", "watchdog")

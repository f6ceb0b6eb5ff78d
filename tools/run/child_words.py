"""What the host of a run tells its node processes, and which plants a command starts."""

import argparse
import os

from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.start.children import Child


def child_arguments(options: argparse.Namespace, bus: str) -> list[str]:
    """Return the arguments of a node's process behind its role."""
    arguments = [options.rig, "--with-parent", str(os.getpid()), "--bus", bus]
    for name in ("pacing", "controller"):
        if value := getattr(options, name):
            arguments += [f"--{name}", value]
    return arguments + [word for setting in options.set for word in ("--set", setting)]


def chosen_plants(options: argparse.Namespace, rig: Rig) -> tuple[Role, ...]:
    """Return the plants to start: all, or that of --node; RigError."""
    every = tuple(rig.config.plants)
    if options.node is None:
        return every
    if options.node not in every:
        what = f"--node {options.node}: no such plant{did_you_mean(options.node, every)}"
        raise RigError(f"{options.rig}: {what}")
    return (options.node,)


def was_told_to_end(child: Child) -> bool:
    """Return whether it is no node, and died because this process asked it to end."""
    return child.asked and child.name in ("line", "watchdog")

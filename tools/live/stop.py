"""`pcpc stop|reset [RIG]`: end a run that goes on, or let it go on after a fault that waits."""

import argparse
import json

from pcpc.drivers.errors import Exit
from pcpc.executive.loop.faults import reason
from pcpc.executive.loop.supervisor import FAULT
from pcpc.executive.nodes.live import Live, LiveError
from pcpc.tools.live.remote.nodes import leader, nodes_of, rig_of

_WITHIN_S = 2.0  # a node that runs needs a few cycles


def command(options: argparse.Namespace) -> int:
    """Run one of the two subcommands."""
    told = _stop(options) if options.command == "stop" else _reset(options)
    print(json.dumps(told) if options.json else f"{options.command}: {_text(told)}")
    return Exit.OK


def _text(told: dict[str, int]) -> str:
    return ", ".join(f"{name} in cycle {cycle}" for name, cycle in told.items())


def _stop(options: argparse.Namespace) -> dict[str, int]:
    """Ask the executive, whose frames tell the others."""
    there = nodes_of(options)
    node = leader(there, rig_of(options, there))
    return {node.name: node.tune({"supervisor.stop": 2.0 if options.quick else 1.0})}


def _reset(options: argparse.Namespace) -> dict[str, int]:
    """Reset every node in FAULT, the lowest first; LiveError with the fault that is still there."""
    there = nodes_of(options)
    rig = rig_of(options, there)
    nodes = there.running(rig)
    found = [node for node in nodes.values() if node["supervisor.state"] == FAULT]
    if not found:
        leader(there, rig)  # which says so, if none runs at all
        raise LiveError(f"no fault: {', '.join(nodes)}", Exit.NOT_MET)
    order = ("plant", "local", "executive")
    found.sort(key=lambda node: order.index(node.block.description["node"]))
    return {node.name: _reset_one(node) for node in found}


def _reset_one(node: Live) -> int:
    node.tune({"supervisor.reset": 1.0})
    try:
        now = node.wait_until(lambda now: now["supervisor.state"] != FAULT, _WITHIN_S)
    except LiveError:
        why = reason(node.block.description, node.block["control"])
        raise LiveError(f"{node.name}: still there: {why}", Exit.NOT_MET) from None
    return now.cycle

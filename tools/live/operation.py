"""`pcpc arm|hold|resume|handover|stop|reset`: what an operator asks of a running rig."""

import argparse
import json
from collections.abc import Iterable
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop.faults import reason
from pcpc.executive.loop.states import State
from pcpc.executive.nodes import operating
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.rig.roles import ROLES
from pcpc.tools.live.local_nodes import Nodes

_WITHIN_S = 2.0  # a node that runs needs a few cycles


def command(options: argparse.Namespace) -> int:
    """Carry one out, and tell in which cycle it was taken."""
    if options.command in ("stop", "reset"):
        found: dict[str, Any] = _stop(options) if options.command == "stop" else _reset(options)
        cycles = ", ".join(f"{name} in cycle {cycle}" for name, cycle in found.items())
        text = f"{options.command}: {cycles}"
    else:
        found, text = _ask_executive(options)
    print(json.dumps(found) if options.json else text)
    return Exit.OK


def _ask_executive(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    live = Nodes().find(options.node or "executive")
    if (role := live.block.description["node"]) != "executive":
        raise UserError(
            f"{live.name}: this is a {role} node; `pcpc {options.command}` needs an executive"
        )
    if options.command == "handover":
        cycle = operating.hand_over(live, options.controller)
        text = f"{options.controller} is in charge from cycle {cycle}"
        return {"cycle": cycle, "in_charge": options.controller}, text
    if options.command == "hold":
        cycle = operating.hold(live)
        text = f"the commands ramp to their safe values from cycle {cycle}"
        return {"cycle": cycle, "armed": False}, text
    cycle = operating.arm(live)
    return {"cycle": cycle, "armed": True}, f"the loop is closed from cycle {cycle}"


def _stop(options: argparse.Namespace) -> dict[str, int]:
    """Ask the executive, whose frames tell the others."""
    there = Nodes()
    node = there.leader(there.rig_of(options.run))
    return {node.name: node.tune({"supervisor.stop": 2.0 if options.quick else 1.0})}


def _reset(options: argparse.Namespace) -> dict[str, int]:
    """Reset every node in FAULT, the lowest first; LiveError with the fault that is still there."""
    there = Nodes()
    rig = there.rig_of(options.run)
    nodes = there.running(rig)
    found = nodes_in_fault(nodes.values())
    if not found:
        there.leader(rig)  # which says so, if none runs at all
        raise LiveError(f"no fault: {', '.join(nodes)}", Exit.NOT_MET)
    return {node.name: _reset_one(node) for node in found}


def nodes_in_fault(nodes: Iterable[Live]) -> list[Live]:
    """Return those in FAULT in the order in which they are reset, the lowest first."""
    found = [node for node in nodes if node["supervisor.state"] == State.FAULT]
    return sorted(found, key=lambda node: -ROLES.index(node.block.description["node"]))


def _reset_one(node: Live) -> int:
    node.tune({"supervisor.reset": 1.0})
    try:
        now = node.wait_until(lambda now: now["supervisor.state"] != State.FAULT, _WITHIN_S)
    except LiveError:
        why = reason(node.block.description, node.block.control)
        raise LiveError(f"{node.name}: the cause is still there: {why}", Exit.NOT_MET) from None
    return now.cycle

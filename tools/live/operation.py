"""`pcpc stop`, `operate arm|hold|resume|handover|reset`: what is asked of a running rig."""

import json
from collections.abc import Iterable

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop.faults import reason
from pcpc.executive.loop.states import State
from pcpc.executive.nodes import operating
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.rig.roles import ROLES
from pcpc.tools.live import answers
from pcpc.tools.live.commands import (
    ArmRequest,
    HandoverRequest,
    HoldRequest,
    ResetRequest,
    ResumeRequest,
    StopRequest,
)
from pcpc.tools.live.local_nodes import Nodes

_WITHIN_S = 2.0  # a node that runs needs a few cycles
_Asked = answers.LoopClosed | answers.LoopOpened | answers.HandedOver
_Operation = ArmRequest | HoldRequest | ResumeRequest | HandoverRequest


def command(request: ResetRequest | StopRequest | _Operation) -> int:
    """Carry one out, and tell in which cycle it was taken."""
    found: dict[str, int] | _Asked
    if isinstance(request, ResetRequest):
        taken = _stop(request) if isinstance(request, StopRequest) else _reset(request)
        cycles = ", ".join(f"{name} in cycle {cycle}" for name, cycle in taken.items())
        found, text = taken, f"{request.verb}: {cycles}"
    else:
        found, text = _ask_executive(request)
    print(json.dumps(found) if request.json else text)
    return Exit.OK


def _ask_executive(request: _Operation) -> tuple[_Asked, str]:
    live = Nodes().find(request.node or "executive")
    if (role := live.block.description["node"]) != "executive":
        what = f"`pcpc operate {request.verb}` needs an executive"
        raise UserError(f"{live.name}: this is a {role} node; {what}")
    if isinstance(request, HandoverRequest):
        cycle = operating.hand_over(live, request.controller)
        text = f"{request.controller} is in charge from cycle {cycle}"
        return answers.HandedOver(cycle=cycle, in_charge=request.controller), text
    if isinstance(request, HoldRequest):
        cycle = operating.hold(live)
        text = f"the commands ramp to their safe values from cycle {cycle}"
        return answers.LoopOpened(cycle=cycle, armed=False), text
    cycle = operating.arm(live)
    return answers.LoopClosed(cycle=cycle, armed=True), f"the loop is closed from cycle {cycle}"


def _stop(request: StopRequest) -> answers.CycleOfStop:
    """Ask the executive, whose frames tell the others."""
    there = Nodes()
    node = there.leader(there.rig_of(request.run))
    return {node.name: node.tune({"supervisor.stop": 2.0 if request.quick else 1.0})}


def _reset(request: ResetRequest) -> answers.CyclesOfReset:
    """Reset every node in FAULT, the lowest first; LiveError with the fault that is still there."""
    there = Nodes()
    rig = there.rig_of(request.run)
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

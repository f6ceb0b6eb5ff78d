"""`pcpc fault`: the faults on purpose of a running rig, listed, begun and ended."""

from typing import TYPE_CHECKING

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop.injection import FOR_EVER
from pcpc.executive.nodes.injecting import InjectedFault, faults_of, inject
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.live.commands import FaultRequest
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.terminal import screen

if TYPE_CHECKING:
    from pcpc.tools.live.answers import FaultChange, Faults


def command(request: FaultRequest) -> int:
    """List the faults of the running rig, or begin or end one.

    UserError: wrong input; LiveError: refused.
    """
    if request.name is None:
        request.refuse("of which fault? give its NAME", "for_s", "value", "share", "end")
    elif request.end:
        request.refuse("contradicts --end", "for_s", "value", "share")
    nodes = list(Nodes().running().values())
    if request.node is not None:
        nodes = [live for live in nodes if request.node in live.names or live.is_of(request.node)]
    if not nodes:
        which = f"{request.node}: no such node" if request.node else "no node"
        what = f"{which} is running; start one with `pcpc run RIG`"
        raise LiveError(what, Exit.ENVIRONMENT)
    if len({live.run for live in nodes}) > 1:
        names = ", ".join(live.name for live in nodes)
        raise UserError(f"several rigs run here; choose a node with --node: {names}")
    if request.name is None:
        faults = faults_of(nodes)
        now: Faults = [
            {"name": one.name, "node": one.node, "about": one.about, "left": one.left,
             "value": one.value, "unit": one.unit, "share": one.share}
            for one in faults
        ]  # fmt: skip
        screen.answer(request.json, now, _lines(faults))
        return Exit.OK
    cycles = inject(nodes, request.name, request.for_s, request.value, request.share, request.end)
    span = (
        "ended" if request.end else "on" if request.for_s is None else f"on for {request.for_s:g}s"
    )
    where = ", ".join(f"{node} from cycle {cycle}" for node, cycle in cycles.items())
    told: FaultChange = {"fault": request.name, "on": not request.end, "cycles": {**cycles}}
    screen.answer(request.json, told, [f"{request.name} {span}: {where}"])
    return Exit.OK


def _lines(faults: list[InjectedFault]) -> list[str]:
    rows = [("fault", "node", "value", "share", "cycles left", "what")]
    rows += [
        (
            one.name,
            one.node,
            f"{one.value:g} {one.unit}".strip(),
            f"{one.share:g}",
            "off" if one.left <= 0 else "on" if one.left > 0.5 * FOR_EVER else f"{one.left:.0f}",
            one.about,
        )
        for one in faults
    ]
    return screen.table(rows) if faults else ["the rig file has no faults"]

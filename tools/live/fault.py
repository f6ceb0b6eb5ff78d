"""`pcpc fault`: the faults on purpose of a running rig, listed, begun and ended."""

import argparse
import json
from dataclasses import asdict

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop.injection import FOR_EVER
from pcpc.executive.nodes.injecting import InjectedFault, faults_of, inject
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.option_notes import refuse


def command(options: argparse.Namespace) -> int:
    """List the faults of the running rig, or begin or end one.

    UserError: wrong input; LiveError: refused.
    """
    if options.name is None:
        refuse(options, "of which fault? give its NAME", "for_s", "value", "share", "end")
    elif options.end:
        refuse(options, "contradicts --end", "for_s", "value", "share")
    nodes = list(Nodes().running().values())
    if options.node is not None:
        nodes = [live for live in nodes if options.node in live.names or live.is_of(options.node)]
    if not nodes:
        which = f"{options.node}: no such node" if options.node else "no node"
        what = f"{which} is running; start one with `pcpc run RIG`"
        raise LiveError(what, Exit.ENVIRONMENT)
    if len({live.run for live in nodes}) > 1:
        names = ", ".join(live.name for live in nodes)
        raise UserError(f"several rigs run here; choose a node with --node: {names}")
    if options.name is None:
        _show(faults_of(nodes), options.json)
        return Exit.OK
    cycles = inject(nodes, options.name, options.for_s, options.value, options.share, options.end)
    if options.json:
        print(json.dumps({"fault": options.name, "on": not options.end, "cycles": cycles}))
        return Exit.OK
    span = (
        "ended" if options.end else "on" if options.for_s is None else f"on for {options.for_s:g}s"
    )
    where = ", ".join(f"{node} from cycle {cycle}" for node, cycle in cycles.items())
    print(f"{options.name} {span}: {where}")
    return Exit.OK


def _show(faults: list[InjectedFault], as_json: bool) -> None:
    if as_json:
        print(json.dumps([asdict(one) for one in faults]))
    elif not faults:
        print("the rig file has no faults")
    else:
        rows = [("fault", "node", "value", "share", "cycles left", "what")]
        rows += [
            (
                one.name,
                one.node,
                f"{one.value:g} {one.unit}".strip(),
                f"{one.share:g}",
                "off"
                if one.left <= 0
                else "on"
                if one.left > 0.5 * FOR_EVER
                else f"{one.left:.0f}",
                one.about,
            )
            for one in faults
        ]
        print("\n".join(screen.table(rows)))

"""`pcpc arm|hold|resume|handover`: what an operator asks of a running executive."""

import argparse
import json

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.nodes import operating
from pcpc.tools.live.remote.nodes import nodes_of


def command(options: argparse.Namespace) -> int:
    """Carry one out, and tell in which cycle it was taken."""
    live = nodes_of(options).find(options.node or "executive")
    if (role := live.block.description["node"]) != "executive":
        raise UserError(f"{live.name}: is a {role}; `pcpc {options.command}` asks an executive")
    if options.command == "handover":
        cycle = operating.hand_over(live, options.controller)
        told: dict[str, object] = {"cycle": cycle, "in_charge": options.controller}
        text = f"{options.controller} is in charge from cycle {cycle}"
    else:
        held = options.command == "hold"
        cycle = operating.hold(live) if held else operating.arm(live)
        told = {"cycle": cycle, "armed": not held}
        text = f"{'held, commands go to their safe values' if held else 'armed'}: cycle {cycle}"
    print(json.dumps(told) if options.json else text)
    return Exit.OK

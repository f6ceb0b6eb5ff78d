"""`pcpc handover`: what an operator asks of a running executive."""

import argparse
import json

from pcpc.drivers.errors import Exit
from pcpc.executive.nodes import operating
from pcpc.tools.remote.nodes import nodes_of


def command(options: argparse.Namespace) -> int:
    """Carry one out, and tell from which cycle it holds."""
    live = nodes_of(options).find(options.node or "executive")
    cycle = operating.hand_over(live, options.controller)
    told = {"cycle": cycle, "in_charge": options.controller}
    text = f"{options.controller} is in charge from cycle {cycle}"
    print(json.dumps(told) if options.json else text)
    return Exit.OK

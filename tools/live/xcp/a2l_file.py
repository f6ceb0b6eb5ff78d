"""`pcpc a2l RIG`: the A2L file of a node that need not run."""

import argparse
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.live.xcp.a2l import A2lVariable, a2l_text, version
from pcpc.tools.start import rigs
from pcpc.tools.terminal import outfile


def command(options: argparse.Namespace) -> int:
    """Write the file; return the exit code. RigError, UserError."""
    rig = load_rig(Path(rigs.find(options.rig)), options.controller, options.set)
    if options.node not in rig.roles:
        raise UserError(f"{options.node}: no such node; {', '.join(rig.roles)}")
    variables = plan(rig, options.node, "lockstep").table.variables
    described = [
        A2lVariable(one.name, one.unit, one.help,
                  (one.low, one.high) if one.kind == "parameter" else None)
        for one in variables
    ]  # fmt: skip
    name, period_ns = rig.config.rig, rig.config.period_ns
    ports = [("UDP", options.address, options.udp or 5555)]
    text = a2l_text(name, options.node, version(), period_ns, described, ports)
    output = options.output or Path(f"{name}-{options.node}.a2l")
    outfile.write_text(output, text)
    print(f"{output}: {len(described)} variables")
    return Exit.OK

"""`pcpc generate a2l RIG`: the A2L file of a node that need not run."""

from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.nodes.plan import describe, plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.live.xcp.a2l import a2l_text, ethernet, variables_of, version
from pcpc.tools.live.xcp.commands import A2lRequest
from pcpc.tools.live.xcp.on_can import CanPlace
from pcpc.tools.live.xcp.packets import ETHERNET
from pcpc.tools.live.xcp.serve import port_of
from pcpc.tools.start import rigs
from pcpc.tools.terminal import outfile


def command(request: A2lRequest) -> int:
    """Write the file; return the exit code. RigError, UserError."""
    rig = load_rig(Path(rigs.find(request.rig)), request.controller, request.set)
    if request.node not in rig.roles:
        raise UserError(f"{request.node}: no such node{did_you_mean(request.node, rig.roles)}")
    described = variables_of(describe(plan(rig, request.node, "lockstep"), {}, kept=False))
    name, period_ns = rig.config.rig, rig.config.period_ns
    if can := CanPlace.of(rig, request.node):
        where, link = can.a2l(), can.link
    else:
        kind, _, port = port_of(rig, request.node)
        if request.ports.udp is not None:
            kind, port = "UDP", request.ports.udp
        where, link = ethernet([(kind, request.ports.address, port)]), ETHERNET
    text = a2l_text(name, request.node, version(), period_ns, described, where, link)
    output = request.output or Path(f"{name}-{request.node}.a2l")
    outfile.write_text(output, text)
    print(f"{output}: {len(described)} variables")
    return Exit.OK

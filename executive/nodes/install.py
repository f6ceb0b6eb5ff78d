"""A plan written into the LOOP record of a node, part by part.

With FMUs it makes an instance of each; RigError says what one of them refuses.
"""

from pcpc.drivers.can import wire
from pcpc.drivers.can.wire_layout import Medium
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes.part import Plan
from pcpc.executive.nodes.parts import PARTS
from pcpc.executive.rig.buses import OVER_LINE


def install_in_memory(made: Plan, loop: Loop) -> None:
    """Write `made` into the zeroed LOOP record `loop` without bus, clock and recorder."""
    wire.prepare(loop.wire, Medium.MEMORY, -1, -1)
    install(made, loop)
    loop.clock.kind = Time.VIRTUAL if made.pacing in ("lockstep", OVER_LINE) else Time.GIVEN
    loop.rings.wait_recorder = 0


def install(made: Plan, loop: Loop) -> None:
    """Write `made` into the zeroed LOOP record `loop`; of its wire only what goes out where."""
    for part in PARTS:
        part.install(made, loop)

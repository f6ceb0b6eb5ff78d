"""The order in which the nodes of a rig exchange frames where no bus carries them.

    meet     the lowest node greets; each above it answers whom it hears, and asks for a sample
    cycle k  the executive works on what was sample k; its frames go down; from the lowest node up,
             each works on what has come and sends its own: sample k + 1 for the one above
    end      the executive's last frames go down as in a cycle; a local node goes on until its own
             commands are safe

So each node does one cycle more than the one above it. That is the order of lockstep on a bus.
Several plants are all right below the executive, and hear nobody else.
`nodes` are LOOP records from the executive down, `steps` what they call, both tuples.
"""

from functools import cache
from typing import Any

from pcpc.drivers.can import wire
from pcpc.drivers.can.wire_layout import Wire
from pcpc.drivers.compiled.jit import i8, loop, loop_function, types
from pcpc.drivers.compiled.stage import Steps
from pcpc.executive.loop.cycle import STEPS, N, finish, one_pass, pass_or_finish
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.reception import wait_for_peer
from pcpc.executive.loop.sending import announce, request_first_sample


@loop_function
def pass_on(nodes: tuple[Loop, ...], i: int) -> None:
    """Carry what node `i` has sent to its neighbours."""
    end = nodes[i].wire
    if i == 0 and nodes[0].meeting.peers > 1:
        _share(nodes, end)
    elif i == 0:
        wire.carry(end, nodes[1].wire)
    elif nodes[0].meeting.peers > 1:
        wire.carry(end, nodes[0].wire)
    elif i == len(nodes) - 1:
        wire.carry(end, nodes[i - 1].wire)
    else:
        wire.deal(end, nodes[i - 1].wire, nodes[i + 1].wire)


@loop_function
def _share(nodes: tuple[Loop, ...], end: Wire) -> None:
    """Carry what the executive has sent to each plant on the bus of the frame."""
    for k in range(end.outbox_put):
        second = wire.on_second(end, end.outbox[k])
        for i in range(1, len(nodes)):
            if (nodes[i].meeting.on_second != 0) == second:
                wire.deliver(end.outbox[k], nodes[i].wire)
    end.outbox_put = 0


@loop_function
def meet(nodes: tuple[Loop, ...]) -> None:
    """Let each node find those below it, and ask them for the sample of t = 0."""
    above = len(nodes) - nodes[0].meeting.peers
    for i in range(above, len(nodes)):
        announce(nodes[i])
        pass_on(nodes, i)
    for i in range(above - 1, -1, -1):
        wait_for_peer(nodes[i])
        request_first_sample(nodes[i])
        pass_on(nodes, i)


@loop_function
def work_below(nodes: tuple[Loop, ...], steps: tuple[Steps, ...]) -> None:
    """Do a cycle of each node below the executive, which takes what the last one passed on."""
    for i in range(len(nodes) - 1, 0, -1):
        pass_or_finish(nodes[i], steps[i])
        pass_on(nodes, i)


@loop_function
def end_run(nodes: tuple[Loop, ...], steps: tuple[Steps, ...]) -> None:
    """Send the executive's last frames and let the nodes below it end."""
    above = len(nodes) - nodes[0].meeting.peers
    finish(nodes[0])
    pass_on(nodes, 0)
    work_below(nodes, steps)
    for i in range(1, above):
        while nodes[i].control.done == 0 and nodes[i].guard.pace > 0.0:
            work_below(nodes, steps)
        if nodes[i].control.done == 0:
            finish(nodes[i])
            pass_on(nodes, i)
        pass_or_finish(nodes[i + 1], steps[i + 1])
    for i in range(above, len(nodes)):
        if nodes[i].control.done == 0:
            finish(nodes[i])


def _run(nodes: tuple[Loop, ...], steps: tuple[Steps, ...], cycles: int) -> int:
    """Run at most `cycles` cycles; return 1 while the rig goes on, 0 at its end."""
    top = nodes[0]
    if top.passes == 0:
        meet(nodes)
        work_below(nodes, steps)
    for _ in range(cycles):
        before = top.passes
        more = one_pass(top, steps[0])
        if more or top.passes != before:  # it has sent, or stands still
            pass_on(nodes, 0)
            work_below(nodes, steps)
        if not more:
            end_run(nodes, steps)
            return 0
    return 1


@cache
def run_of(count: int) -> Any:
    """Return `run(nodes, steps, cycles)` for that many nodes, compiled on first use."""
    kinds = types.UniTuple(N, count), types.UniTuple(STEPS, count), i8
    return loop(i8(*kinds))(_run)

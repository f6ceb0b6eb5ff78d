"""A node alone on its bus, to its end; apart, for only such nodes compile it.

Where the nodes of a rig share a process, `executive.loop.exchange` runs them.
"""

from pcpc.drivers.compiled.jit import i8, loop
from pcpc.drivers.compiled.stage import Steps
from pcpc.executive.loop.cycle import STEPS, N, finish, one_pass
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.reception import wait_for_peer
from pcpc.executive.loop.sending import announce, request_first_sample
from pcpc.executive.loop.strangers import listen, refused


@loop(i8(N, STEPS))
def run(n: Loop, steps: Steps) -> int:
    """Run the node on its bus to the end; return the number of cycles done.

    One that stands in a cycle has met the others.
    """
    if n.passes == 0:
        listen(n)
        if n.meeting.seeks_below != 0:
            if wait_for_peer(n):
                request_first_sample(n)
        elif n.meeting.ordered != 0 and not refused(n):
            announce(n)
    while not refused(n) and one_pass(n, steps):
        pass
    finish(n)
    return n.passes

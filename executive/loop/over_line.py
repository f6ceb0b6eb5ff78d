"""The exchange of `executive.loop.exchange` over an emulated CAN line, in virtual time.

    executive   cycle k at k T: takes what is through by then, sends
    others      their next cycle at k T + phi T, phi their phase behind the executive's, above 0
                up to 1: take what is through by then, send
    local node  it is on the line; between it and its plant frames take no time

What is sent waits for the line (`drivers.line.line`) from that time on; a frame that is not through
when its receiver's cycle begins is taken in a later one. What becomes of a node's controller, an
error frame tells it. Nobody waits for frames: both nodes are as on a clock from their first cycle
on. The meeting before it and the last words are carried at once.
"""

from functools import cache
from typing import Any

from pcpc.drivers.can import wire
from pcpc.drivers.compiled.jit import i8, loop, loop_function, types
from pcpc.drivers.compiled.records import Cells
from pcpc.drivers.compiled.stage import Steps
from pcpc.drivers.line import error_frames
from pcpc.drivers.line import line as lines
from pcpc.drivers.line.line import Line, Outcome
from pcpc.drivers.line.ticks import tick_at
from pcpc.executive.loop.cycle import STEPS, N, one_pass, pass_or_finish
from pcpc.executive.loop.exchange import end_run, meet, work_below
from pcpc.executive.loop.layout import Loop

_REST_BITS = 1_000_000  # in which what is on its way at the end comes through


@loop_function
def _queue(line: Line, nodes: tuple[Loop, ...], s: int, tick: int) -> None:
    """Queue what node `s` has sent at tick `tick`."""
    end = nodes[s].wire
    for k in range(end.outbox_put):
        if s >= line.senders:  # the plant of a local node
            wire.deliver(end.outbox[k], nodes[s - 1].wire)
        elif nodes[s].meeting.between != 0 and wire.on_second(end, end.outbox[k]):
            wire.deliver(end.outbox[k], nodes[s + 1].wire)
        else:
            lines.put(line, s, end.outbox[k], tick)
    end.outbox_put = 0


@loop_function
def _go_on(line: Line, nodes: tuple[Loop, ...], until: int) -> None:
    """Let the line go on to tick `until`, and put what is through into its receiver's inbox."""
    outcome = lines.advance(line, until)
    while outcome != Outcome.NOTHING:
        for s in range(line.senders):
            if outcome == Outcome.SENT and s != line.who and lines.hears(line, s):
                wire.deliver(line.frame, nodes[s].wire)
            if error_frames.news(line, s, line.news):
                wire.deliver(line.news, nodes[s].wire)
        outcome = lines.advance(line, until)


def _run(
    nodes: tuple[Loop, ...], steps: tuple[Steps, ...], line: Line, phases: Cells[int], cycles: int
) -> int:
    """Run at most `cycles` cycles; return 1 while the rig goes on, 0 at its end."""
    top = nodes[0]
    if top.passes == 0:
        meet(nodes)
        work_below(nodes, steps)
    for _ in range(cycles):
        before, time_ns = top.passes, top.k * top.clock.period_ns
        tick = tick_at(line.per_s, time_ns)
        _go_on(line, nodes, tick)
        more = one_pass(top, steps[0])
        _queue(line, nodes, 0, tick)
        for row in range(len(phases)):
            i = phases[row, 0]
            tick = tick_at(line.per_s, time_ns + phases[row, 1])
            _go_on(line, nodes, tick)
            if more or top.passes != before:  # else it has not sent
                pass_or_finish(nodes[i], steps[i])
                _queue(line, nodes, i, tick)
        if not more:
            _go_on(line, nodes, tick + _REST_BITS * line.bit)
            end_run(nodes, steps)
            return 0
    return 1


@cache
def run_over_line(count: int) -> Any:
    """Return `run(nodes, steps, line, phases, cycles)` for that many, compiled on first use.

    `phases`: (count - 1, 2), node and ns behind the executive, in the order of the time.
    """
    kinds = types.UniTuple(N, count), types.UniTuple(STEPS, count), lines.N, i8[:, ::1], i8
    return loop(i8(*kinds))(_run)

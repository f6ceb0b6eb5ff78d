"""Frames lost on purpose, at their receivers: singly or in bursts, the same in every run.

    two states, good and lost, a draw a frame (Gilbert):
    good -> lost with p,  lost -> good with q = 1/burst,  p = q share/(1 - share)           (1)

Each frame has a generator of its own, so that the order in which frames come does not matter, and a
virtual run loses what a run on a bus loses.
"""

from collections.abc import Mapping

from pcpc.drivers.can import dbc
from pcpc.drivers.compiled.jit import loop_inline
from pcpc.executive.loop.draws import FACTOR, PRIME, first
from pcpc.executive.loop.layout import Loop


def install(
    loop: Loop, frames: list[dbc.Frame], losses: Mapping[str, tuple[float, float]], seed: int
) -> None:
    """Write the losses of the received `frames` into the LOOP record: share and burst by name."""
    for row, frame in enumerate(frames):
        share, burst = losses.get(frame.name, (0.0, 1.0))
        if share > 0.0:
            leave = 1.0 / burst
            loop.rx.loss[row] = (min(leave * share / (1.0 - share), 1.0), leave)
            loop.rx.loss_state[row] = (first(seed, frame.name), 0)
            loop.faults.spoiled[row] = 1


@loop_inline
def is_lost(n: Loop, row: int) -> int:
    """Draw whether the frame that has just come in on `row` is lost (1)."""
    loss, state = n.rx.loss[row], n.rx.loss_state[row]
    if loss.enter <= 0.0:
        return False
    s = state.draw * FACTOR % PRIME
    state.draw = s
    turns = s / PRIME < (loss.leave if state.lost != 0 else loss.enter)
    if turns:
        state.lost = 1 - state.lost
    return state.lost != 0

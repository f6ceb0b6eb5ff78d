"""The turn of the blocks in a cycle: each steps on its views of the table; what they send."""

from pcpc.drivers.compiled.jit import loop_function, loop_inline, loop_part
from pcpc.drivers.compiled.stage import Steps, call, part
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import now
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.injected_values import OUTPUTS, PARAMETERS, SENT, spoil
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.limits import limit_commands
from pcpc.executive.loop.rings import push_event
from pcpc.executive.loop.sending import copy_inputs
from pcpc.executive.loop.variables import FALLBACK, T_S


@loop_function
def step(n: Loop, steps: Steps) -> None:
    """Step the blocks for this cycle; after a stall the emulator's for the periods it owes."""
    owed = n.clock.behind if n.blocks.owe_periods != 0 else 0
    if n.faults.n_values > 0:
        spoil(n, PARAMETERS)
    for k in range(n.k - owed, n.k + 1):
        step_blocks(n, steps, k)
    note_changes(n)
    n.timing.stepped = now(n.clock)


@loop_inline
def step_blocks(n: Loop, steps: Steps, k: int) -> None:
    """Step every block at time k T on its views of the table."""
    v, blocks, dt = n.v, n.blocks, n.clock.period_ns * 1e-9
    v[T_S] = k * dt
    for b in range(blocks.n):
        if b == (blocks.controller if v[FALLBACK] > 0.0 else blocks.fallback):
            continue
        copy_inputs(n, b)
        if n.faults.n_values > 0:
            spoil(n, b)
        at = blocks.views[b]
        n.control.stepping = b + 1
        p, x, u, y = part(v, at.p), part(v, at.x), part(v, at.u), part(v, at.y)
        call(steps[b], v[T_S], dt, p, x, u, y)
        if n.faults.n_values > 0:
            spoil(n, OUTPUTS + b)
    n.control.stepping = 0


@loop_inline
def note_changes(n: Loop) -> None:
    """Tell which of the rig's noted variables changed."""
    blocks = n.blocks
    for i in range(blocks.n_noted):
        value = n.v[blocks.noted_index[i]]
        if value != blocks.noted[i]:
            push_event(n, Event.CHANGE, blocks.noted_index[i], value)
            blocks.noted[i] = value


@loop_part
def limit(n: Loop) -> None:
    """Carry the outputs into what is sent; clamp them, limit their rate, ramp them to safe."""
    copy_inputs(n, sh.MAX_BLOCKS)
    if n.faults.n_values > 0:
        spoil(n, SENT)
    limit_commands(n)

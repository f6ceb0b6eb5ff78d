"""The open loop as it is measured: the rig in virtual time, a multisine added to a command.

    d_k  = a sum_i sqrt(n_i) cos(2 pi n_i k/N + phase_i),   n_i odd, phases drawn                (1)
    w    = u + d                        u: what the law commands, w: what is sent            (2)
    L    = -U/W                         of the lines n_i, over whole periods                 (3)

The same loop, codec, limits, delay and noise as in any run. d enters where faults of actuators do:
behind the law, before limits and codec. U and W are both taken inside the closed loop, so that (3)
has no bias at the lines: what is no answer to d falls as the periods are averaged, and the spread
over them says how much of it is left.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import UserError
from pcpc.drivers.jit import VIEW, i8, loop, types
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import supervisor as sv
from pcpc.executive.loop.cycle import STEPS, N, one_pass
from pcpc.executive.loop.exchange import meet, pass_on, work_below
from pcpc.executive.loop.faults import reason
from pcpc.executive.loop.injection import VALUE
from pcpc.executive.loop.variables import STATE
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.nodes.watched import watched
from pcpc.executive.rig.reading import Rig
from pcpc.tools.margin.loops import Loop
from pcpc.tools.margin.operating import INJECTED, excited, lasting

Vector = NDArray[np.float64]
PERIODS = 4
_PIECE = 1000  # cycles between two looks at the nodes
_LINES = 120


@dataclass(frozen=True)
class Multisine:
    """(1): `lines` n_i (m,), a period `d` (N,) whose largest value is the amplitude."""

    lines: NDArray[np.int64]
    d: Vector


@dataclass(frozen=True)
class Measured:
    """L at the lines f_hz (m,), its spread over the periods relative to its size, and the run.

    `coherence` of u with d, 0 to 1; `clamped`: values that a limit or the codec held in bounds;
    `command`: its mean before anything was injected, `alone`: how much it moved, rms.
    """

    f_hz: Vector
    response: NDArray[np.complex128]
    spread: Vector
    coherence: Vector
    amplitude: float
    clamped: int
    command: float
    alone: float


def multisine(
    rate_hz: float, lowest_hz: float, amplitude: float, seed: int, highest_hz: float | None = None,
    first_hz: float = 0.0,
) -> Multisine:  # fmt: skip
    """Return lines from `lowest_hz` to half the rate or `highest_hz`, by logarithm.

    `first_hz`: leaves those below out; the period is still that of `lowest_hz`.
    """
    n = 2 * round(0.5 * rate_hz / lowest_hz)
    top = min(0.5 * n - 1, np.inf if highest_hz is None else n * highest_hz / rate_hz)
    raw = np.geomspace(1.0, max(top, 1.0), _LINES)
    lines = np.unique(2 * np.round(0.5 * (raw - 1.0)).astype(np.int64) + 1)
    lines = lines[(lines <= top) & (lines * rate_hz >= first_hz * n)]
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(lines))
    turns = np.outer(lines, np.arange(n)) % n
    waves = np.cos(2.0 * np.pi / n * turns + phases[:, None])
    d = (np.sqrt(lines)[:, None] * waves).sum(axis=0)
    return Multisine(lines, amplitude / np.abs(d).max() * d)


def measure(
    rig: Rig, cut: Loop, held: Mapping[str, float], sines: Multisine, settle_s: float,
    periods: int = PERIODS,
) -> Measured:  # fmt: skip
    """Run the rig with the excitation; UserError where it ends in a fault."""
    rate, n = rig.config.rate_hz, len(sines.d)
    settle = round(settle_s * rate)
    total = settle + (periods + 1) * n
    d = np.concatenate((np.zeros(settle), np.tile(sines.d, periods + 1)))
    made = excited(lasting(rig, (total + 10) / rate), cut, held)
    u, clamped = _run(VirtualRun(made, None), cut, d)
    alone = u[settle // 2 : settle]
    command, moves = float(alone.mean()), float(alone.std())
    u = u[settle + n :].reshape(periods, n)
    before = np.fft.rfft(u, axis=1)[:, sines.lines]
    after = before + np.fft.rfft(sines.d)[sines.lines]
    mean_before, mean_after = before.mean(axis=0), after.mean(axis=0)
    response = -mean_before / mean_after
    each = -before / after
    spread = np.abs(each - response).max(axis=0) / np.maximum(np.abs(response), 1e-300)
    power = np.mean(np.abs(before) ** 2, axis=0)
    coherence = np.abs(mean_before) ** 2 / np.maximum(power, 1e-300)
    size = float(np.abs(sines.d).max())
    return Measured(
        sines.lines * rate / n, response, spread, coherence, size, clamped, command, moves
    )


def commands(rig: Rig, cut: Loop) -> Vector:
    """Return what a law commands in every cycle of the rig as it is; UserError at a fault."""
    n = round(rig.config.duration_s * rig.config.rate_hz)
    made = excited(lasting(rig, (n + 10) / rig.config.rate_hz), cut, {})
    return _run(VirtualRun(made, None), cut, np.zeros(n))[0]


def _run(run: VirtualRun, cut: Loop, d: Vector) -> tuple[Vector, int]:
    """Return what the law commanded in every cycle, and how often a value was clamped."""
    at = [made.role for made in run.plans].index(cut.role)
    table, loops = run.plans[at].table.index, tuple(block.loop for block in run.blocks)
    places = np.array([at, table[f"fault.{INJECTED}.left"] + VALUE, table[cut.source]])
    control, drive, u, begin = run.blocks[at]["control"], _drive_of(len(loops)), np.empty(len(d)), 0
    for first in range(0, len(d), _PIECE):
        part = slice(first, first + _PIECE)
        wanted = d[part].copy()
        answer = np.empty_like(wanted)
        done = watched(partial(drive, loops, run.steps, places, wanted, answer), loops)
        u[part] = answer
        _let_go(run)
        if done < len(wanted) or any(block.loop.v[STATE] == sv.FAULT for block in run.blocks):
            raise UserError(_why(run, first + done))
        if first == 0:
            begin = int(control[sh.SATURATED])
    return u, int(control[sh.SATURATED]) - begin


def _drive(nodes: Any, steps: Any, places: Any, d: Any, u: Any) -> Any:
    """Do a cycle of all nodes for each of `d`, note the command; return how many were done."""
    top, values = nodes[0], nodes[places[0]].v
    if top.passes == 0:
        meet(nodes)
        work_below(nodes, steps)
    for k in range(len(d)):
        values[places[1]] = d[k]
        if not one_pass(top, steps[0]):
            return k
        pass_on(nodes, 0)
        work_below(nodes, steps)
        u[k] = values[places[2]]
    return len(d)


@cache
def _drive_of(count: int) -> Any:
    """Return `_drive` for that many nodes, compiled on first use."""
    kinds = types.UniTuple(N, count), types.UniTuple(STEPS, count), i8[::1], VIEW, VIEW
    return loop(i8(*kinds))(_drive)


def _let_go(run: VirtualRun) -> None:
    """Forget the records of the nodes."""
    for block in run.blocks:
        for name in ("record", "frame", "event"):
            block[f"{name}_taken"][0] = block[f"{name}_ends"][sh.PUT]


def _why(run: VirtualRun, k: int) -> str:
    faults = [
        f"{block.description['node']}: {reason(block.description, block['control'])}"
        for block in run.blocks if block["control"][sh.FAULT]
    ]  # fmt: skip
    what = f"the measured run ended after {k} cycles: {next(iter(faults), 'no fault')}"
    return f"{what}; a smaller --amplitude or another --at or --set may keep it in bounds"

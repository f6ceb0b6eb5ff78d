"""The open loop as it is measured: the rig in virtual time, a multisine added to a command.

    d_k  = a sum_i sqrt(n_i) cos(2 pi n_i k/N + phase_i),   n_i odd, phases drawn                (1)
    w    = u + d                        u: what the law commands, w: what is sent            (2)
    g    = mean U/D,  S = 1 + g,  L = -g/(1 + g)        of the lines n_i, over realisations   (3)
    e    = std(U/D)/sqrt(realisations),   error of S: e,   of L: e/(|g| |1 + g|) of it        (4)

The same loop, codec, limits, delay and noise as in any run. d enters where faults of actuators do:
behind the law, before limits and codec. U is what u has more than in a run of the same noise
without d, so that disturbances are none of it. Every realisation has phases of its own, and time
to settle: what is no linear answer to d (quanta, play, friction, chaos) differs from one to the
next, also where it is the same in every period, and (4) tells how much of it is left. Behind the
last one nothing is injected: a loop that goes on by itself has a limit cycle.

Source of (3), (4): Pintelon, Schoukens, System Identification (Wiley 2012), 4.3, robust method.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np

from pcpc.drivers.compiled.jit import VIEW, i8, loop, types
from pcpc.drivers.errors import UserError
from pcpc.executive.loop.cycle import STEPS, N, one_pass
from pcpc.executive.loop.exchange import meet, pass_on, work_below
from pcpc.executive.loop.faults import reason
from pcpc.executive.loop.injection import VALUE
from pcpc.executive.loop.states import State
from pcpc.executive.loop.variables import STATE
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.nodes.watched import watched_result
from pcpc.executive.rig.reading import Rig
from pcpc.tools.study.arrays import Complex, Places, Vector
from pcpc.tools.study.margin.loops import CutLoop
from pcpc.tools.study.margin.operating import INJECTED, with_injection

PERIODS = 4
_PIECE = 1000  # cycles between two looks at the nodes
_LINES = 120
_AT_LIMIT = 0.05  # of the time
ENOUGH, _MOST = 0.02, 0.3  # errors of L at a line: good, and no matter how bad


@dataclass(frozen=True)
class Multisine:
    """(1): `lines` n_i (m,), periods `d` (PERIODS, N) whose largest value is the amplitude."""

    lines: Places
    d: Vector


@dataclass(frozen=True)
class MeasuredLoop:
    """L at the lines f_hz (m,), its spread over realisations relative to its size, and the run.

    `coherence` of u with d, 0 to 1; `noise`: e of (4), smoothed over neighbours; `clamped`: values
    that a limit or the codec held in bounds; `quiet`: what is commanded without any injection,
    `command`: its mean, `alone`: how it moves at last, `after`: how it moves once all is over.
    """

    f_hz: Vector
    response: Complex
    spread: Vector
    coherence: Vector
    noise: Vector
    amplitude: float
    clamped: int
    command: float
    alone: "Moves"
    after: "Moves"
    quiet: Vector

    @property
    def answers(self) -> bool:
        """Whether most lines are more than their errors."""
        return bool((np.abs(self.response) > 1e-12).any() and np.median(self.error) <= 1.0)

    def lasting_motion(self) -> tuple["Moves", str] | None:
        """Return how the command moves, and when, if it goes on or is at a limit: no margins."""
        least = max(3.0 * self.alone.rms, 0.05 * self.amplitude)
        for moves, when in ((self.alone, "by itself"), (self.after, "once moved")):
            if (moves.rms > least and moves.lasts) or moves.at_limit > _AT_LIMIT:
                return moves, when
        return None

    @property
    def left(self) -> float:
        """The mean error of all lines, no line counting more than a hidden one."""
        return float(np.minimum(self.error, _MOST).mean())

    @property
    def error(self) -> Vector:
        """The error of L, relative to its size: (4)."""
        size = np.abs(self.response) / np.abs(1.0 + self.response) ** 2
        return np.asarray(self.noise / np.maximum(size, 1e-300))


@dataclass(frozen=True)
class Moves:
    """How a command moves by itself: rms, its strongest line, the share of the time at a limit.

    `pure`: how much of the power is at that line and its neighbours; noise has little there.
    `lasts`: as much in the second half, and several turns: no end of what was before.
    """

    rms: float
    f_hz: float
    pure: float
    at_limit: float
    lasts: bool

    @property
    def cycles(self) -> bool:
        """Whether most of it is at one frequency."""
        return self.pure > 0.5


def multisine(
    rate_hz: float,
    lowest_hz: float,
    amplitude: float,
    seed: int,
    highest_hz: float | None = None,
    first_hz: float = 0.0,
) -> Multisine:
    """Return lines from `lowest_hz` to half the rate or `highest_hz`, by logarithm.

    `first_hz`: leaves those below out; the period is still that of `lowest_hz`.
    """
    n = 2 * round(0.5 * rate_hz / lowest_hz)
    top = min(0.5 * n - 1, np.inf if highest_hz is None else n * highest_hz / rate_hz)
    raw = np.geomspace(1.0, max(top, 1.0), _LINES)
    lines = np.unique(2 * np.round(0.5 * (raw - 1.0)).astype(np.int64) + 1)
    lines = lines[(lines <= top) & (lines * rate_hz >= first_hz * n)]
    spectrum = np.zeros((PERIODS, n // 2 + 1), complex)
    turns = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, (PERIODS, len(lines)))
    spectrum[:, lines] = np.sqrt(lines) * np.exp(1j * turns)
    d = np.fft.irfft(spectrum, n, axis=1)
    return Multisine(lines, amplitude / np.abs(d).max(axis=1, keepdims=True) * d)


def measure(
    rig: Rig,
    cut: CutLoop,
    held: Mapping[str, float],
    sines: Multisine,
    settle_s: float,
    quiet: Vector | None = None,
) -> MeasuredLoop:
    """Run the rig with the excitation; UserError where it ends in a fault.

    quiet   what the law commands without any, for as long; None: another run
    """
    rate, (count, n) = rig.config.rate_hz, sines.d.shape
    settle = round(settle_s * rate)
    still, turns = np.zeros(settle), 1 + max(-(-settle // (2 * n)), 1)
    d = np.concatenate((still, np.tile(sines.d, (1, turns)).ravel(), still))
    made = with_injection(rig.changed(duration_s=(len(d) + 10) / rate), cut, held)
    if quiet is None:
        quiet = _run(VirtualRun(made, None), cut, np.zeros(len(d)))[0]
    u, clamped = _run(VirtualRun(made, None), cut, d)
    alone, after = quiet[-(settle - settle // 2) :], u[-(settle - settle // 2) :]
    seen = (u - quiet)[settle : len(u) - settle].reshape(count, turns, n)[:, -1]
    given = np.fft.rfft(sines.d, axis=1)[:, sines.lines]
    each = np.fft.rfft(seen, axis=1)[:, sines.lines] / given
    g = each.mean(axis=0)
    response, one = -g / _nonzero(1.0 + g), -each / _nonzero(1.0 + each)
    spread = np.abs(one - response).max(axis=0) / np.maximum(np.abs(response), 1e-300)
    power = np.mean(np.abs(each) ** 2, axis=0)
    variance = np.sum(np.abs(each - g) ** 2, axis=0) / (count - 1) / count
    return MeasuredLoop(
        sines.lines * rate / n,
        response,
        spread,
        np.abs(g) ** 2 / np.maximum(power, 1e-300),
        np.sqrt(_smooth(variance)),
        float(np.abs(sines.d).max()),
        clamped,
        float(alone.mean()),
        _moves(alone, rate, cut),
        _moves(after, rate, cut),
        quiet,
    )


def _nonzero(value: Complex) -> Complex:
    """Return values none of which is 0."""
    return np.where(np.abs(value) < 1e-150, 1e-150, value)


def _smooth(variance: Vector) -> Vector:
    """Return the mean over five neighbours, or the own one where it is larger: few are known."""
    mean = np.convolve(np.pad(variance, 2, "edge"), np.full(5, 0.2), mode="valid")
    return np.asarray(np.maximum(mean, variance))


def _moves(u: Vector, rate: float, cut: CutLoop) -> Moves:
    power = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(len(u)))) ** 2
    k = int(np.argmax(power))
    pure = float(power[max(k - 2, 0) : k + 3].sum() / max(power.sum(), 1e-300))
    at_limit = float(np.mean((u >= cut.high) | (u <= cut.low)))
    first, second = np.array_split(u, 2)
    lasts = bool(k >= 4 and second.std() > 0.8 * first.std())
    return Moves(float(u.std()), k * rate / len(u), pure, at_limit, lasts)


def best_measurement(
    rig: Rig,
    cut: CutLoop,
    held: Mapping[str, float],
    about: tuple[float, float, int],
    sizes: Sequence[float],
    settle_s: float,
) -> MeasuredLoop:
    """Return what the rig answers to that of rising sizes which leaves the least error.

    about   the rate, the lowest line and the seed

    Raises UserError where the first ends in a fault.
    """
    found: MeasuredLoop | None = None
    for size in sizes:
        try:
            quiet = None if found is None else found.quiet
            own = measure(rig, cut, held, multisine(*about[:2], size, about[2]), settle_s, quiet)
        except UserError:
            if found is None:
                raise
            break
        if found is not None and (own.clamped > found.clamped or own.left > found.left):
            if own.after.rms > found.after.rms + 0.1 * own.amplitude:
                return own  # louder, it does not come to rest again
            continue
        found = own
        if own.error.max() < ENOUGH:
            break
    assert found is not None, "there is a size"
    return found


def commands(rig: Rig, cut: CutLoop) -> Vector:
    """Return what a law commands in every cycle of the rig as it is; UserError at a fault.

    Shape (n,).
    """
    n = round(rig.config.duration_s * rig.config.rate_hz)
    made = with_injection(rig.changed(duration_s=(n + 10) / rig.config.rate_hz), cut, {})
    return _run(VirtualRun(made, None), cut, np.zeros(n))[0]


def _run(run: VirtualRun, cut: CutLoop, d: Vector) -> tuple[Vector, int]:
    """Return what the law commanded in every cycle, and how often a value was clamped."""
    at = [made.role for made in run.plans].index(cut.role)
    table, loops = run.plans[at].table.index, tuple(block.loop for block in run.blocks)
    places = np.array([at, table[f"fault.{INJECTED}.left"] + VALUE, table[cut.source]])
    control, drive, u, begin = run.blocks[at].control, _drive_of(len(loops)), np.empty(len(d)), 0
    for first in range(0, len(d), _PIECE):
        part = slice(first, first + _PIECE)
        wanted = d[part].copy()
        answer = np.empty_like(wanted)
        done = watched_result(partial(drive, loops, run.steps, places, wanted, answer), loops)
        u[part] = answer
        _drop_records(run)
        if done < len(wanted) or any(block.loop.v[STATE] == State.FAULT for block in run.blocks):
            raise UserError(_end_reason(run, first + done))
        if first == 0:
            begin = int(control.saturated)
    return u, int(control.saturated) - begin


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


def _drop_records(run: VirtualRun) -> None:
    """Forget the records of the nodes."""
    for block in run.blocks:
        for name in ("record", "frame", "event"):
            block[f"{name}_taken"][0] = block.ends(name).head


def _end_reason(run: VirtualRun, k: int) -> str:
    faults = [
        f"{block.description['node']}: {reason(block.description, block.control)}"
        for block in run.blocks
        if block.control.fault
    ]
    what = f"the measured run ended after {k} cycles: {next(iter(faults), 'no fault')}"
    return f"{what}; a smaller --amplitude or another --at or --set may keep it in bounds"

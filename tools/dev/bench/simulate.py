"""A virtual run of slew10, plant and executive, against C and against scipy's solve_ivp.

    Python   `executive.loop.exchange`: both nodes, frames encoded, checked and decoded, 16
             Runge-Kutta steps a period, records in memory
    C        the same, equal records, as `pcpc generate c slew10 --check` compiles it at -O2: no
             counters, CRC or supervisor; a digest of each record instead of its row
    scipy    the plant alone, no control, no frames, no noise: solve_ivp on the compiled derivative
             over SEGMENT_S of the move with the torque held, a smooth stretch

Accuracy is matched on the muzzle angle: the reference is DOP853 at 1e-12; the error of a method is
the largest one at the ends of the control periods. Of RK45 and DOP853, each with the loosest
tolerance (a decade apart, absolute a thousandth of relative) whose error is no larger than that of
the plant's own steps, the quicker one counts. Processor time, ms per simulated second.
"""

import ctypes
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.stage import stage
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.exchange import run_of
from pcpc.executive.nodes.plan import cycles_of, plan
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.plants.atb1000 import dynamics, model
from pcpc.plants.atb1000.ports import External, Motion, Outputs, Parameters, States
from pcpc.tools.dev.bench import compiler
from pcpc.tools.dev.bench.cycle import RIG, new_loop
from pcpc.tools.dev.bench.ratio import Measurement, Ratio, interleave, processor_time
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.make.generate.closed import ClosedLoop
from pcpc.tools.make.generate.device import same_files
from pcpc.tools.terminal.progress import Progress

SUITE = "simulate"
SOURCE = Path(__file__).with_name("both_nodes.c")
DURATION_S = 2.0  # a run: the move up and rest
SEGMENT_AT_S, SEGMENT_S = 0.7, 0.05
TOLERANCES = tuple(10.0**-k for k in range(2, 12))
REFERENCE = 1e-12


@dataclass(frozen=True)
class Nodes:
    """Both nodes in memory and their start; a run leaves them at its end."""

    loops: tuple[Any, Any]
    steps: tuple[tuple[Any, ...], tuple[Any, ...]]
    starts: tuple[Any, Any]

    def restore(self) -> None:
        """Put both back to the start."""
        for n, start in zip(self.loops, self.starts, strict=True):
            for name in KEPT:
                n[name] = start[name]


KEPT = tuple(name for name in sh.LOOP.names or () if name not in ("record", "frame", "event"))


def slew10(seconds: float = DURATION_S) -> Rig:
    """Return the rig; RigError."""
    return load_rig(RIG, settings=[f"duration_s={seconds}"])


def nodes(seconds: float = DURATION_S) -> Nodes:
    """Return both nodes of slew10; RigError."""
    rig = slew10(seconds)
    made = [plan(rig, role, "lockstep") for role in ("executive", "plant")]
    loops, starts = [], []
    for one in made:
        n = new_loop(one)
        n.guard.cycles = round(seconds * rig.config.rate_hz)
        loops.append(n)
        starts.append(n.copy())
    return Nodes((loops[0], loops[1]), (made[0].steps, made[1].steps), (starts[0], starts[1]))


def in_python(n: Nodes) -> None:
    """Run from start to end, compiled."""
    run_of(2)(n.loops, n.steps, n.loops[0].guard.cycles + 1)


def library(rig: Rig) -> ctypes.CDLL:
    """Return both nodes of a rig in C; CompilerError, Untranslatable."""
    texts = ClosedLoop(rig).files(cycles_of(rig))
    texts["closed_loop.inc"] = texts.pop("main.c")
    fixed = same_files(fd=False)
    texts |= {name: fixed[name] for name in ("codec.c", "codec.h")}
    c = compiler.library([SOURCE], texts)
    c.run.restype = ctypes.c_uint64
    return c


@dataclass(frozen=True)
class Segment:
    """The plant amid the move: parameters, state, period in s; `held` is the torque, N m."""

    p: NDArray[np.float64]
    x: NDArray[np.float64]
    t: float
    dt: float
    held: float

    @property
    def periods(self) -> int:
        """The control periods in it."""
        return round(SEGMENT_S / self.dt)


def segment() -> Segment:
    """Return the plant as a virtual run leaves it at SEGMENT_AT_S."""
    run = VirtualRun(load_rig(RIG, settings=[f"duration_s={SEGMENT_AT_S}"]), None)
    for _ in run.advance():
        pass
    n = run.blocks[1].loop
    at = n.blocks.views[0]
    x = n.v[at.x : at.x_end].copy()
    dt = n.clock.period_ns * 1e-9
    return Segment(n.v[at.p : at.p_end].copy(), x, n.k * dt, dt, float(States(x).held_Nm))


def own_muzzle(s: Segment) -> NDArray[np.float64]:
    """Return the muzzle angle, rad, after each period of the plant's own steps."""
    x, u, y = s.x.copy(), np.array([s.held]), np.zeros(model.BLOCK.size(model.BLOCK.outputs))
    found = []
    for i in range(s.periods):
        model.BLOCK.step(s.t + i * s.dt, s.dt, s.p, x, u, y)
        found.append(Outputs(y).muzzle_rad)
    return np.array(found)


@stage
def slopes(t: float, dt: float, p: Parameters, x: Motion, u: External, y: Motion) -> None:
    """Write the derivative of the motion."""
    dynamics.derivative(p, x, u, y)


def by_scipy(s: Segment, method: str, tolerance: float) -> NDArray[np.float64]:
    """Return the muzzle angle, rad, after each period as solve_ivp finds it."""
    from scipy.integrate import solve_ivp  # no other suite needs it

    w = States(s.x).external.values().copy()
    External(w).command_Nm = s.held
    out = np.empty(Motion.size)

    def derivative(t: float, state: NDArray[np.float64]) -> NDArray[np.float64]:
        slopes(t, s.dt, s.p, state, w, out)
        return out.copy()

    ends = s.dt * np.arange(1, s.periods + 1)
    solved = solve_ivp(
        derivative,
        (0.0, ends[-1]),
        States(s.x).motion.values().copy(),
        method,
        ends,
        rtol=tolerance,
        atol=1e-3 * tolerance,
    )
    slope, motions = Parameters(s.p).slope, [Motion(column) for column in solved.y.T]
    return np.array([motion.theta_rad + slope @ motion.q for motion in motions])


def matched_methods(s: Segment) -> list[tuple[str, float]]:
    """Return each method with the loosest tolerance that is as accurate as the plant's steps."""
    exact = by_scipy(s, "DOP853", REFERENCE)
    allowed = float(np.abs(own_muzzle(s) - exact).max())
    found = []
    for method in ("RK45", "DOP853"):
        for tolerance in TOLERANCES:
            if np.abs(by_scipy(s, method, tolerance) - exact).max() <= allowed:
                found.append((method, tolerance))
                break
    if not found:
        raise BenchError(f"solve_ivp does not reach the plant's error of {allowed:.1e} rad")
    return found


def run_time() -> Measurement:
    """Return a measurement of a run from its start, ms per simulated second."""
    n = nodes()
    once = processor_time(lambda: in_python(n), DURATION_S * 1e6)

    def side() -> float:
        n.restore()
        return once()

    return side


def run_time_in_c() -> Measurement:
    """Return the same in C; CompilerError."""
    rig = slew10()
    c, cycles = library(rig), cycles_of(rig)
    return processor_time(lambda: c.run(cycles), DURATION_S * 1e6)


def rival_times(s: Segment) -> dict[str, Measurement]:
    """Return measurements of scipy's methods, as accurate as the plant's steps, ms per second."""
    return {
        f"{method} at {tolerance:.0e}, plant only": processor_time(
            partial(by_scipy, s, method, tolerance), SEGMENT_S * 1e6
        )
        for method, tolerance in matched_methods(s)
    }


def quickest(names: Iterable[str], times: Iterable[NDArray[np.float64]]) -> tuple[str, Any]:
    """Return the shortest times and their name."""
    return min(zip(names, times, strict=True), key=lambda one: float(np.median(one[1])))


def measure(progress: Progress, rounds: int = 15) -> list[Ratio]:
    """Return the ratios to C and to solve_ivp; CompilerError, BenchError, RigError."""
    in_c = run_time_in_c()
    progress.show("simulate: matching scipy's accuracy")
    rivals = rival_times(segment())
    sides = [run_time(), in_c, *rivals.values()]
    own, plain, *others = interleave(progress, SUITE, rounds, sides)
    return [
        Ratio.from_rounds(SUITE, "slew10", against, own, base, "ms/s")
        for against, base in (("C -O2, both nodes", plain), quickest(rivals, others))
    ]

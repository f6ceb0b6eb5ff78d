"""From a rig with play or friction to the gain at which it begins to cycle, and runs beside it.

The rig without them, by the settings of a file as plants/atb1000/linear.yaml, is linear: the factor
of the gain at which a pole leaves the unit circle, and its eigenvector, begin the branch of
`balance.py`, at half of the command's range. Then the settings that are asked for come back, in
steps, and the amplitude falls. What is predicted stands beside runs of the same rig, and of the rig
as it is, with all that the file took away.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.study.arrays import Complex, Vector
from pcpc.tools.study.margin import balance, linear, loops, operating
from pcpc.tools.study.margin.cycle_map import CycleMap
from pcpc.tools.study.margin.facts import Point, StepAtFactor
from pcpc.tools.study.margin.limit_cycle_result import LimitCycle, onset_index
from pcpc.tools.study.margin.loops import CutLoop
from pcpc.tools.study.margin.measured import commands

_SETTLE_S = 2.0
_SHARE = 0.5  # of the command's range, at which the branch begins
_GROW = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
_NO_PART = ("noise", "model")  # in the names of what does not come back by itself
_FALL, _MOST, _ABOVE = 0.85, 40, 5
_AFTER_S, _LOOK_S = 2.0, 1.0


class _ClosedLoop:
    """A closed loop as a map of the states of its open one, with a gain and grown settings."""

    def __init__(self, cycle: CycleMap, cut: CutLoop, names: list[str], gain: int) -> None:
        self.cycle, self.cut = cycle, cut
        self.places = np.array([cycle.index[name] for name in names])
        self.start, self.k = cycle.v.copy(), cycle.k
        self.gain, self.nominal = gain, float(cycle.v[gain])
        self.sent = cycle.place(cut.role, cut.sent)

    def step(self, x: Vector, gain: float) -> Vector:
        self.cycle.v[:], self.cycle.k = self.start, self.k
        self.cycle.v[self.gain] = gain * self.nominal
        self.cycle.v[self.places] = x
        self.cycle.advance()
        return self.cycle.v[self.places].copy()

    def point(self, found: balance.BalancedCycle) -> Point:
        def and_sent(x: Vector, gain: float) -> Vector:
            return np.append(self.step(x[:-1], gain), self.cycle.v[self.sent])

        more = replace(found, phi=np.append(found.phi, 0.0), mean=np.append(found.mean, 0.0))
        sent = balance.after_cycle(and_sent, more)[:, -1]
        size = float(np.abs(balance.first_harmonic(sent)))
        step = size * 2.0 * np.sin(0.5 * found.omega) / np.sqrt(2.0)
        return Point(found.gain, found.omega / (2.0 * np.pi * self.cycle.dt), size, float(step))

    def run(self, x: Vector, gain: float) -> float:
        """Return the step of the command, rms, long after the map began at x."""
        self.step(x, gain)
        rest, look = (round(one / self.cycle.dt) for one in (_AFTER_S, _LOOK_S))
        sent = np.empty(rest + look)
        for k in range(rest + look):
            self.cycle.advance()
            sent[k] = self.cycle.v[self.sent]
        return _step_rms(sent[rest:])


def limit_cycle(
    rig: Path,
    controller: str | None,
    settings: Sequence[str],
    linear_settings: Sequence[str],
    gain: str,
    grown: Sequence[str] | None = None,
    factors: Sequence[float] | None = None,
    name: str | None = None,
) -> LimitCycle:
    """Return where limit cycles of a rig begin as a gain grows, and runs at some factors of it.

    linear_settings   make it linear, as for `--set`
    gain              the setting that grows, as controller.kv_Nms_rad
    grown             settings of the linear ones that come back to the rig's: play, friction;
                      None: all but noise and what switches a model
    factors           of the gain, for runs; None: six up to that of the linear loop

    Raises UserError where the linear loop is not stable as it is, or nothing makes it unstable.
    """
    whole = operating.without_disturbances(load_rig(rig, controller, list(settings)))
    bare = operating.without_disturbances(load_rig(rig, controller, [*settings, *linear_settings]))
    plans = operating.plans_of(bare)
    cut, _ = loops.choose(bare, plans, name)
    rest = operating.at_rest(plans, operating.reference_values(plans, 0.0), _SETTLE_S)
    own = CycleMap(operating.plans_of(whole))
    taken = _names(linear_settings)
    if grown is None:
        grown = [one for one in taken if not any(word in one for word in _NO_PART)]
    back = {one: float(own.v[_place(own, one)]) for one in grown}
    place = _place(rest.cycle, gain)
    loop = _critical(rest.cycle, cut, gain, place)
    closed_loop = _ClosedLoop(rest.cycle, cut, loop.found.states, place)
    first = _first(closed_loop, loop)
    cycles = _branch(closed_loop, first, back)
    points = [closed_loop.point(one) for one in cycles]
    rows = []
    if factors is None:
        least = min([loop.factor, *(point.factor for point in points)])
        factors = np.round(np.linspace(min(1.0, 0.9 * least), 0.95 * loop.factor, 6), 2).tolist()
    for factor in factors:
        alone = closed_loop.run(_state_near(cycles, points, factor), factor)
        more = [*settings, f"{gain}={factor * closed_loop.nominal!r}"]
        run = _command_step_in_run(
            operating.without_disturbances(load_rig(rig, controller, more)), cut
        )
        rows.append(StepAtFactor(factor, stable_cycle_at(points, factor), alone, run))
    return LimitCycle(
        whole.config.rig,
        whole.config.controller,
        gain,
        back,
        loop.factor,
        loop.omega / (2.0 * np.pi * rest.cycle.dt),
        points,
        rows,
        cut.signal,
        cut.unit,
    )


def _names(settings: Sequence[str]) -> list[str]:
    """Return the names in options as of `--set`, also of those in files."""
    found = list[str]()
    for one in settings:
        more = yamlfile.load(one[1:]).data if one.startswith("@") else [one.partition("=")[0]]
        found += [str(name) for name in more]
    return found


def linear_file(rig: Path) -> Path:
    """Return the file linear.yaml in the rig's folder or one above; UserError without one."""
    for folder in list(rig.resolve().parents)[:2]:
        if (folder / "linear.yaml").is_file():
            return folder / "linear.yaml"
    what = "no linear.yaml beside the rig or above; name what makes it linear with --linear"
    raise UserError(f"{rig}: {what} @FILE or NAME=VALUE, as for --set")


@dataclass(frozen=True)
class _Critical:
    """The linear loop at the factor at which a pole leaves the unit circle, and its direction."""

    factor: float
    found: linear.Linear
    phi: Complex
    omega: float


def _critical(cycle: CycleMap, cut: CutLoop, gain: str, place: int) -> _Critical:
    nominal = float(cycle.v[place])

    def linear_at(factor: float) -> linear.Linear:
        cycle.v[place] = factor * nominal
        found = linear.differences(cycle, cut)
        cycle.v[place] = nominal
        return found

    def leaves(factor: float) -> bool:
        return bool(np.abs(linear_at(factor).closed()).max(initial=0.0) > 1.0 + 1e-7)

    if leaves(1.0):
        raise UserError(f"the linear loop is unstable as it is; give a lower {gain} with --set")
    low, high = 1.0, 1.25
    while not leaves(high):
        low, high = high, 1.25 * high
        if high > 1e3:
            raise UserError(f"{gain}: the linear loop is stable up to a thousand times its value")
    while high / low > 1.0 + 1e-5:
        middle = np.sqrt(low * high)
        low, high = (low, middle) if leaves(middle) else (middle, high)
    found = linear_at(high)
    values, vectors = np.linalg.eig(found.a + np.outer(found.b, found.c) / (1.0 - found.d))
    i = int(np.argmax(np.abs(values)))
    omega, phi = float(np.angle(values[i])), vectors[:, i]
    if abs(omega) < 1e-6:
        raise UserError(f"{gain}: the linear loop leaves its point without a swing, at {high:.4g}")
    return _Critical(high, found, phi if omega > 0.0 else phi.conj(), abs(omega))


def _first(closed_loop: _ClosedLoop, loop: _Critical) -> balance.BalancedCycle:
    """Return the cycle of the linear loop with half of the command's range as its amplitude."""
    half = 0.5 * (closed_loop.cut.high - closed_loop.cut.low)
    if not 0.0 < half < 1e9:
        half = 1.0
    mean = closed_loop.start[closed_loop.places]
    size = abs(loop.found.c @ loop.phi) / (1.0 - loop.found.d)
    phi = loop.phi * _SHARE * half / size
    return balance.BalancedCycle(phi, mean, loop.omega, loop.factor, 0.0, 0.0)


def _branch(
    closed_loop: _ClosedLoop, first: balance.BalancedCycle, wanted: dict[str, float]
) -> list[balance.BalancedCycle]:
    """Return the branch, once what was taken away has come back."""
    places = {name: _place(closed_loop.cycle, name) for name in wanted}
    began = {name: float(closed_loop.start[place]) for name, place in places.items()}
    plant = [closed_loop.cycle.names[p].startswith("plant:") for p in closed_loop.places]
    state = int(np.argmax(np.where(plant, np.abs(first.phi), -1.0)))
    amplitude = float(abs(first.phi[state]))
    closed_loop.start[list(places.values())] = list(wanted.values())
    at = replace(first, waiting=balance.waiting_states(closed_loop.step, first))
    for share in _GROW:
        for name, value in wanted.items():
            now = began[name] + share * (value - began[name])
            closed_loop.start[places[name]] = now
        new = balance.balance(closed_loop.step, at, state, amplitude)
        if new is None:
            what = f"no limit cycle found with {share:.0%} of {', '.join(wanted)}"
            raise UserError(f"{what}, at half of the command's range")
        at = new
    up = balance.branch(closed_loop.step, at, state, 1.0 / _FALL, _ABOVE)
    down = balance.branch(closed_loop.step, at, state, _FALL, _MOST)
    return [*up[:0:-1], *down]


def _state_near(cycles: list[balance.BalancedCycle], points: list[Point], factor: float) -> Vector:
    """Return a state of the stable cycle whose gain is nearest."""
    stable = cycles[: onset_index(points) + 1]
    return next(min(stable, key=lambda one: abs(one.gain - factor)).states())


def stable_cycle_at(points: Sequence[Point], factor: float) -> Point | None:
    """Return the stable cycle at a factor, between two of the branch: the first from above."""
    for above, below in pairwise(points[: onset_index(points) + 1]):
        if above.factor >= factor >= below.factor:
            share = (above.factor - factor) / max(above.factor - below.factor, 1e-12)
            pairs = zip(astuple(above)[1:], astuple(below)[1:], strict=True)
            return Point(factor, *(float(a ** (1.0 - share) * b**share) for a, b in pairs))
    return None


def _command_step_in_run(rig: Rig, cut: CutLoop) -> float:
    """Return the step of the command, rms, in a run of the rig; nan where it ends in a fault."""
    try:
        return _step_rms(commands(rig, cut))
    except UserError:
        return float("nan")


def _step_rms(command: Vector) -> float:
    return float(np.sqrt(np.mean(np.diff(command) ** 2)))


def _place(cycle: CycleMap, name: str) -> int:
    """Return where a setting stands; UserError."""
    for one in (name, *(f"{role}:{name}" for role in cycle.roles)):
        if one in cycle.index:
            return cycle.index[one]
    raise UserError(f"{name}: not a number that a step reads; it cannot grow")

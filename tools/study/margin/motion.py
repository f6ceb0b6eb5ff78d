"""The loop of a rig in motion, for where at rest there is none: stuck, in a gap, at a limit.

The rig's own run, its references moving, is looked at from time to time: a cycle's map by
differences, as at rest. The loop of an instant is that of a rig that stays in this motion.
"""

from dataclasses import dataclass

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.roles import Role
from pcpc.tools.study.arrays import Vector
from pcpc.tools.study.margin import linear
from pcpc.tools.study.margin.cycle_map import CycleMap
from pcpc.tools.study.margin.linear import UNSTABLE, Linear
from pcpc.tools.study.margin.loops import CutLoop
from pcpc.tools.study.margin.margins import margins
from pcpc.tools.study.margin.operating import Rest

_LOOKS, _MOST = 40, 40_000
_POINTS = 300
_AS_GOOD = 0.9
_LOOK_S = 4.0
STUCK = "no gain around this loop at this point (stuck, in a gap, or at a limit)"


@dataclass(frozen=True)
class Motion:
    """The instant `at_s` whose loop is nearest to instability; of `looks`, how many had a loop.

    `unstable` of those are not stable; then so is the one that is told.
    """

    found: Linear
    at_s: float
    looks: int
    loops: int
    unstable: int


def in_motion(plans: dict[Role, Plan], cut: CutLoop) -> Motion | None:
    """Return the worst loop along the rig's own run, None where there is none."""
    cycle = CycleMap(plans, moving=True)
    cycle.begin({})
    config = plans["executive"].rig.config
    n = min(round(config.duration_s * config.rate_hz), _MOST)
    looks = set(np.linspace(1, n, _LOOKS + 1).astype(int)[:-1].tolist())
    seen = list[tuple[float, float, Linear]]()
    for k in range(1, n):
        cycle.advance()
        if not np.isfinite(cycle.v[cycle.place(cut.role, cut.source)]):
            break
        if k in looks:
            one = linear.differences(cycle, cut)
            if one.passes(cycle.of_kind(cut.role, "received")):
                seen.append((_stability(one, config.rate_hz), k * cycle.dt, one))
    if not seen:
        return None
    unstable = [one for one in seen if one[0] <= 0.0]
    often = len(unstable) > 0.5 * len(seen)
    _, at_s, found = min(unstable if often else seen, key=lambda one: _order(one[0], often))
    return Motion(found, at_s, len(looks), len(seen), len(unstable))


def _order(size: float, often: bool) -> float:
    """Return what is least for the loop to tell: passing instability is none of the loop's."""
    return size if often or size > 0.0 else np.inf


def _stability(one: Linear, rate: float) -> float:
    """Return the disk margin, or how far a pole is outside, below 0."""
    largest = float(np.abs(one.closed()).max(initial=0.0))
    if largest > 1.0 + UNSTABLE:
        return 1.0 - largest
    return margins(f := _grid(rate), one.response(f), rate).disk_margin


def _grid(rate: float) -> Vector:
    return np.geomspace(rate / 1e5, 0.5 * rate, _POINTS)


def check_rest(rest: Rest, cut: CutLoop) -> None:
    """Raise UserError where a command goes on that would be still if its loop were open.

    Noise and disturbances of the plant move it in the open loop, too; what fades is no cycle.
    """
    cycle, n = rest.cycle, round(_LOOK_S / rest.cycle.dt)
    start, k = cycle.v.copy(), cycle.k
    command, sent = float(rest.mean[cycle.cut_places(cut)[0]]), cycle.place(cut.role, cut.source)
    moved = np.empty((2, n))
    for i, opened in enumerate((None, cut)):
        cycle.v[:], cycle.k = start, k
        for j in range(n):
            cycle.advance(opened, command)
            moved[i, j] = cycle.v[sent]
    cycle.v[:], cycle.k = start, k
    by_itself, second = moved[0].std(), moved[0, n // 2 :].std()
    lasts = second > 0.95 * moved[0, : n // 2].std()
    if (
        lasts
        and moved[1, n // 2 :].std() < 0.1 * second
        and by_itself > 1e-3 * max(1.0, abs(command))
    ):
        what = f"the loop cycles by itself: the command moves by {by_itself:.3g} rms"
        raise UserError(f"{what}, and would be at rest in the open loop; a lower gain may end it")


def worse_in_motion(plans: dict[Role, Plan], cut: CutLoop, disk_margin: float) -> list[str]:
    """Return what has to be said of the loop in motion beside that of a point, as its disk margin.

    The point is none of rest, or a gate, a gap or friction may be on another side in motion.
    """
    one = in_motion(plans, cut)
    if one is None:
        return []
    where = f"at {one.loops} of {one.looks} times of its own run there is a loop"
    if 2 * one.unstable > one.loops:
        return [f"in motion it is another: {where}, at {one.unstable} of those it is unstable"]
    rate = 1.0 / one.found.dt
    numbers = margins(f := _grid(rate), one.found.response(f), rate)
    if numbers.disk_margin > _AS_GOOD * disk_margin:
        return []
    gain = f"gain margin {numbers.gain_margin:.4g}, disk margin {numbers.disk_margin:.4g}"
    worst = f"the worst, at {one.at_s:.4g} s, has phase margin {numbers.phase_margin_deg:.4g} deg"
    return [f"in motion it is another: {where}; {worst}, {gain}"]


def stuck_note(cut: CutLoop) -> str:
    """Return what is said of a point at which the command has no effect on itself."""
    return f"{cut.signal} has no effect on itself: {STUCK}"


def motion_notes(cut: CutLoop, one: Motion) -> list[str]:
    """Return what has to be said of a loop in motion beside one that is stuck."""
    what = f"in motion, at {one.loops} of {one.looks} times of its own run, it has one"
    where = f"the worst of them, at {one.at_s:.4g} s, is shown here"
    notes = [f"{stuck_note(cut)}; {what}: {where}"]
    if one.unstable:
        notes.append(f"at {one.unstable} of those the loop in motion is unstable, in passing")
    return notes

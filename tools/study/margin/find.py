"""From a rig to its margins: the point, both responses, what has to be said of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.start.rigs import find
from pcpc.tools.start.settings import settings
from pcpc.tools.study.arrays import Vector
from pcpc.tools.study.margin import linear, loops, measured, motion, notes, operating
from pcpc.tools.study.margin.commands import SETTLE_S, Method, Question
from pcpc.tools.study.margin.margins import margins
from pcpc.tools.study.margin.result import Margin, Response
from pcpc.tools.study.margin.sizes import measured_margins
from pcpc.tools.study.margin.visible import without_below

_POINTS = 600
_LONGER = (1.0, 2.0, 4.0)  # times of rest that a drift is given to fade


def margin(
    rig: str | Path,
    controller: str | None = None,
    *,
    set: Mapping[str, Any] | None = None,
    loop: str | None = None,
    at_s: float = 0.0,
    method: Method = "both",
    amplitude: float | None = None,
    seed: int = 1,
    settle_s: float = SETTLE_S,
    lowest_hz: float | None = None,
) -> Margin:
    """Return the margins of a rig's loop, linearised and measured in virtual time.

    rig, controller, set   as in `pcpc.simulate`
    loop        the command signal that closes the loop, as CMD.motor_torque; None: the first
    at_s        hold the reference of this time of the run, s
    method      "linearised", "measured" or "both"
    amplitude   the largest injected value, in the signal's unit; None: 2 to 30 % of half its range
                or 16, 256, ... times less, the one with the least error. A number that half of it
                moves is not measured
    seed        of the phases of the injection
    settle_s    time to come to rest before, s; up to eight of them where the rig drifts
    lowest_hz   the lowest frequency; None: rate/4000

    Raises pcpc.Error: the rig has no loop, is unstable, ends in a fault or has no gain.
    """
    question = Question(
        loop=loop,
        at_s=at_s,
        method=method,
        amplitude=amplitude,
        seed=seed,
        settle_s=settle_s,
        lowest_hz=lowest_hz,
    )
    return margin_of(load_rig(find(str(rig)), controller, settings(set)), question)


@np.errstate(all="ignore")  # what is no number is looked for
def margin_of(rig: Rig, question: Question) -> Margin:
    """Return what `margin` does, of a rig that was read."""
    question.check(rate := rig.config.rate_hz)
    rig, method = operating.without_disturbances(rig), question.method
    plans = operating.plans_of(rig)
    cut, known = loops.choose(rig, plans, question.loop)
    held = operating.reference_values(plans, question.at_s)
    point, own, remarks, sizes = _Point(None), None, list[str](), list[float]()
    if method != "linearised":
        sizes = [question.amplitude] if question.amplitude else cut.amplitudes()
    if method != "measured":
        try:
            point = _linear(plans, cut, held, question.settle_s)
        except UserError as error:
            if method == "linearised":
                raise
            point = _Point(None, [f"not linearised: {error}"])
    if sizes:
        about = rate, question.lowest(rate), question.seed
        try:
            best = measured_margins(rig, cut, held, about, sizes, question.settle_s)
            own, visible = best.loop, best.margins
            remarks += notes.measured_notes(best, cut)
        except UserError as error:
            if point.found is None:
                raise UserError("; ".join((str(error), *point.remarks)), error.code) from None
            own, remarks = None, [f"not measured: {error}"]
    responses, found = dict[str, Response](), point.found
    if found is not None:
        responses["linearised"] = _linearised(found, rate, question.lowest(rate), own)
    if own is not None:
        if found is not None:
            ours = responses["linearised"].margins
            visible, more = notes.comparison(ours, own, visible, found.response(own.f_hz))
        else:
            visible, below = without_below(visible, own.f_hz, own.response)
            more = notes.unsure_notes(below)
        small = point
        if method == "measured":
            small = _loop_at_rest(plans, cut, held, question.settle_s)
        if small.found is None or np.isfinite(small.moving_s):
            why = small.remarks[0] if found is None else ""
            more += notes.no_small_loop(own, cut, why)
        elif found is None:
            ours = _linearised(small.found, rate, question.lowest(rate), own).margins
            more += notes.other_small_loop(own, cut, visible, ours, small.found)
        remarks += more
        theirs = own.f_hz, own.response, visible, own.spread, own.coherence
        responses["measured"] = Response(*theirs)
    for name, one in responses.items():
        if notes.contradiction(one.margins):
            peak, f = one.margins.sensitivity_peak, one.margins.sensitivity_peak_hz
            what = f"{name}: the sensitivity peak, {peak:.3g} at {f:.4g} Hz, belongs to a crossing"
            remarks.append(f"{what} that was not found; its margins are not known")
            responses[name] = replace(one, margins=notes.without_crossings(one.margins))
    return Margin(
        rig.config.rig,
        rig.config.controller,
        cut.signal,
        cut.unit,
        [one.signal for one in known],
        rate,
        held,
        found.command if found else own.command if own else np.nan,
        responses.get("linearised"),
        responses.get("measured"),
        np.empty(0, complex) if found is None else found.closed(),
        [] if found is None else found.kinks,
        np.nan if own is None else own.amplitude,
        [*point.remarks, *remarks],
        point.moving_s,
    )


@dataclass(frozen=True)
class _Point:
    """A linear loop, what has to be said of it, and when of the rig's own run it was found."""

    found: notes.Found | None
    remarks: list[str] = field(default_factory=list)
    moving_s: float = np.nan


def _linear(
    plans: dict[Role, Plan], cut: loops.CutLoop, held: dict[str, float], settle_s: float
) -> _Point:
    """Return the loop at rest, or in motion where there is none at rest; UserError."""
    rest = _rest(plans, cut, held, settle_s)
    found = linear.linearise(rest, cut)
    if found.passes(rest.cycle.of_kind(cut.role, "received")):
        moves = notes.command_rms(rest, cut)
        restless = notes.is_restless(moves, found.command)
        remarks = notes.linear_notes(found, cut, moves)
        if restless and not found.rounded:  # which cycles by steps
            motion.check_rest(rest, cut)
        if found.kinks or found.idle or restless:
            f = np.geomspace(1e-5, 0.5, _POINTS) / found.dt
            disk = margins(f, found.response(f), 1.0 / found.dt).disk_margin
            remarks += motion.worse_in_motion(plans, cut, disk)
        return _Point(found, remarks)
    moving = motion.in_motion(plans, cut)
    if moving is None:
        what = f"{motion.stuck_note(cut)}, nor in its own run"
        raise UserError(f"{what}; --at, --set or --loop choose another")
    remarks = motion.motion_notes(cut, moving)
    try:
        own = notes.linear_notes(moving.found, cut, 0.0)
    except UserError as error:
        head = remarks[0].partition(":")[0]
        raise UserError(f"{head}: {motion.STUCK}; in motion {error}") from None
    return _Point(moving.found, remarks + own, moving.at_s)


def _loop_at_rest(
    plans: dict[Role, Plan], cut: loops.CutLoop, held: dict[str, float], settle_s: float
) -> _Point:
    """Return the linear loop at rest, or a remark why there is none that is stable."""
    try:
        rest = _rest(plans, cut, held, settle_s)
        found = linear.linearise(rest, cut)
        notes.check_stable(found)
    except UserError as error:
        return _Point(None, [str(error)])
    passes = found.passes(rest.cycle.of_kind(cut.role, "received"))
    return _Point(found) if passes else _Point(None, [motion.stuck_note(cut)])


def _rest(
    plans: dict[Role, Plan], cut: loops.CutLoop, held: dict[str, float], settle_s: float
) -> operating.Rest:
    """Return where a rig rests after a time, or up to eight of them if it drifts."""
    rest = operating.at_rest(plans, held, settle_s)
    place = rest.cycle.place(cut.role, cut.sent)
    for factor in _LONGER:
        if not notes.is_restless(notes.command_rms(rest, cut), float(rest.mean[place])):
            break
        later = operating.later_rest(rest, place, factor * settle_s)
        if later is rest:
            break
        rest = later
    return rest


def _linearised(
    found: notes.Found, rate: float, lowest: float, own: measured.MeasuredLoop | None
) -> Response:
    """Return the response at a grid, near the poles, and at the measured lines.

    Margins are those of all frequencies, also below the lowest that is told.
    """
    poles = np.array([*found.poles(), *found.closed()])
    slow = np.abs(np.log(poles[np.abs(poles) > 1e-9])) * rate / (2.0 * np.pi)
    slowest = slow[slow > 1e-7 * rate].min(initial=lowest)
    below = np.geomspace(max(0.01 * min(slowest, lowest), 1e-9 * rate), lowest, _POINTS // 2)
    every = [
        np.geomspace(lowest, 0.5 * rate, _POINTS),
        *(_resonance_frequencies(pole, rate) for pole in poles),
    ]
    every += [] if own is None else [own.f_hz]
    whole = np.unique(np.concatenate((below, *every)))
    whole = whole[(whole >= below[0]) & (whole <= 0.5 * rate)]
    response, told = found.response(whole), whole >= lowest
    return Response(whole[told], response[told], margins(whole, response, rate))


def _resonance_frequencies(pole: complex, rate: float) -> Vector:
    """Return frequencies about a resonance."""
    if abs(pole) < 1e-9:
        return np.empty(0)
    s = np.log(pole) * rate / (2.0 * np.pi)
    return np.asarray(abs(s.imag) + max(abs(s.real), 1e-6 * rate) * np.linspace(-6.0, 6.0, 49))

"""What has to be said of a loop's margins, and what makes them none."""

from dataclasses import replace

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.tools.study.arrays import Complex
from pcpc.tools.study.margin import impulse, linear, loops, measured, operating, sizes
from pcpc.tools.study.margin.margins import Margins
from pcpc.tools.study.margin.visible import (
    CURVES,
    PLACES,
    STRONG,
    UNSURE,
    Unsure,
    differences,
    is_empty,
    without_unsure,
)

Found = linear.Linear | impulse.Impulse
_MARGINAL = 1e5  # of |S| beside a pole on the unit circle
_PAIRS = (
    ("gain_margin", "gain_margin_hz", "gain margin"),
    ("phase_margin_deg", "crossover_hz", "phase margin"),
    ("delay_margin_s", "crossover_hz", "delay margin"),
    ("disk_margin", "disk_margin_hz", "disk margin"),
)
_NEAR, _WORSE = 1.03, 0.9
_WITHIN, _CLOSE = 3.0, 0.03  # of a line: errors, and of its size: no other loop


def linear_notes(found: Found, cut: loops.CutLoop, moves: float) -> list[str]:
    """Return what has to be said of a linear loop; UserError if it has no margins.

    moves   how the command moves at the point, rms
    """
    check_stable(found)
    if not cut.low < found.command < cut.high:
        what = f"the command is at its limit, {found.command:g}: there is no loop"
        raise UserError(f"{what}; another --at or --set may leave it room")
    notes = []
    if found.kinks:
        what = "two slopes meet here (play, friction, a limit), their mean was taken"
        notes.append(f"not differentiable in {_some(found.kinks, 4)}: {what}")
    if isinstance(found, impulse.Impulse):
        what = "the loop is another map in every cycle (a delay line, a schedule)"
        notes.append(f"{what}: found by {len(found.s)} cycles after an impulse, without poles")
    for name, step in found.rounded.items():
        what = f"{name} is rounded in the plant or a law, in steps of {step:.3g}"
        notes.append(f"{what}: its slope is that from step to step")
    if found.idle:
        what = "a gate, a dead band or a limit keeps them out of the loop at this point"
        notes.append(f"not in the loop: {_some(found.idle, 3)}; {what}")
    if is_restless(moves, found.command):
        unit = f" {cut.unit}" if cut.unit else ""
        what = f"the command moves by {moves:.2g}{unit} rms (noise, a limit cycle or a drift)"
        notes.append(f"not at rest: {what}; linearised at the mean")
    return notes


def _some(names: list[str], most: int) -> str:
    return ", ".join([*names[:most], *["..."] * (len(names) > most)])


def check_stable(found: Found) -> None:
    """Raise UserError for poles outside, or on, the unit circle."""
    poles = found.closed()
    largest = float(np.abs(poles).max(initial=0.0))
    cure = "a lower gain, or another --at or --set, may be stable"
    if largest > 1.0 + linear.UNSTABLE:
        raise UserError(f"the closed loop is unstable: a pole at |z| = {largest:.6f}; {cure}")
    for pole in poles[np.abs(poles) > 1.0 - linear.UNSTABLE].tolist():
        f = abs(np.angle(pole)) / (2.0 * np.pi * found.dt)
        beside = found.response(np.array([f + linear.UNSTABLE / found.dt]))[0]
        if abs(1.0 + beside) < 1.0 / _MARGINAL:
            what = f"the closed loop is at the edge of stability: a pole at |z| = 1, {f:.4g} Hz"
            raise UserError(f"{what}; {cure}")


def measured_notes(measurement: sizes.MeasuredMargins, cut: loops.CutLoop) -> list[str]:
    """Return what has to be said of a measured loop; UserError if it does not answer."""
    own, seen = measurement.loop, measurement.margins
    unit = f" {cut.unit}" if cut.unit else ""
    size = _size(own, cut)
    if (lasting := own.lasting_motion()) is not None:
        what = f"{lasting[1]} the command goes on, {_motion_text(lasting[0], unit)}"
        raise UserError(f"{what}; there is no loop that has margins; a lower gain may end it")
    if not own.answers:
        what = f"the measured loop does not answer to {size}"
        moved = f"by itself the command moves by {own.alone.rms:.3g}{unit} rms"
        cure = "stuck, unstable, a limit cycle, or noise: inject more with --amplitude"
        raise UserError(f"{what}: {moved}; {cure}, or lower the gain")
    peak, lowest = seen.sensitivity_peak, own.f_hz[0]
    if peak > 2.0 and seen.sensitivity_peak_hz < 1.01 * lowest:
        what = f"the sensitivity peak, {peak:.3g}, lies at the lowest line, {lowest:.4g} Hz"
        cure = "give a lower --lowest; or no loop passes through the plant"
        raise UserError(f"{what}, or below: {cure}")
    notes, weak = list[str](), own.f_hz[own.error > STRONG]
    if is_empty(seen) and any(one.why == sizes.HALF for one in measurement.unsure):
        what = f"no margin is known: {sizes.HALF}, also at {size}, the best of what was tried"
        raise UserError(f"{what}; play, friction or a limit; another --at or --set may avoid it")
    worst = float(own.error.max())
    if is_empty(seen) and worst <= measured.ENOUGH:
        what = f"{len(own.f_hz)} lines from {lowest:.4g} Hz on are too few to know any margin"
        raise UserError(f"{what}; give a lower --lowest")
    if is_empty(seen):
        hidden = f"{len(weak)} of {len(own.f_hz)} lines at {size}"
        what = f"noise or a nonlinearity hides {hidden}, and with them every margin"
        if not len(weak):
            moves = f"moves L by up to {100.0 * worst:.2g} % at {size}"
            what = f"noise or a nonlinearity {moves}, so that no margin is known"
        moved = f"by itself the command moves {_motion_text(own.alone, unit)}"
        raise UserError(f"{what}; {moved}; --amplitude sets what is injected")
    if own.alone.rms > 0.1 * own.amplitude:
        cause = "a limit cycle, or a disturbance of the plant's" if own.alone.cycles else "noise"
        notes.append(
            f"measured: by itself the command moves {_motion_text(own.alone, unit)}: {cause}"
        )
    if own.clamped:
        notes.append(f"{own.clamped} values were clamped: inject less with --amplitude")
    if len(weak):
        what = f"{len(weak)} of {len(own.f_hz)} lines, the lowest at {weak[0]:.4g} Hz"
        cure = "is not measured; --amplitude sets what is injected"
        hides = f"noise or a nonlinearity hides {what}: a margin that one of them may hide {cure}"
        notes.append(f"measured: {hides}")
    return notes + unsure_notes(measurement.unsure)


def unsure_notes(unsure: list[Unsure]) -> list[str]:
    """Return which margins the lines leave open, and why."""
    found = list[str]()
    for why in dict.fromkeys(one.why for one in unsure):
        own = [one for one in unsure if one.why == why]
        named = ", ".join(_label(one.name) for one in own)
        places = sorted({f"{one.f_hz:.4g} Hz" for one in own if np.isfinite(one.f_hz)})
        about = f", about {' and '.join(places)}" if places else ""
        what = f"not known within {100.0 * UNSURE:g} %, as {why}{about}"
        found.append(f"measured: {named}: {what}; another --lowest or --amplitude may show it")
    return found


def _motion_text(moves: measured.Moves, unit: str) -> str:
    at = f", {100.0 * moves.at_limit:.0f} % of the time at its limit" if moves.at_limit else ""
    where = f" at {moves.f_hz:.4g} Hz" if moves.cycles else ""
    return f"by {moves.rms:.3g}{unit} rms{where}{at}"


def comparison(
    ours: Margins, own: measured.MeasuredLoop, seen: Margins, response: Complex
) -> tuple[Margins, list[str]]:
    """Return the measured margins with why some are other than the linearised ones.

    Those that lie between other frequencies than the lines are not measured, nor are those that
    differ where both loops have the same lines beside them.

    ours, response   of the linear loop, that at the measured lines (m,)
    """
    unsure = dict[str, str]()
    for name, share in differences(seen, ours).items():
        f = getattr(ours, PLACES[name])
        if share > UNSURE and own.f_hz[0] <= f <= own.f_hz[-1] and _is_equal(own, response, f):
            unsure[name] = CURVES
    seen, told = without_unsure(seen, unsure)
    better, worse, why_worse = dict[str, str](), list[str](), ""  # of the better ones, why
    for name, where, what in _PAIRS:
        linear_one, one, f = getattr(ours, name), getattr(seen, name), getattr(ours, where)
        if one > _NEAR * linear_one and not own.f_hz[0] <= f <= own.f_hz[-1]:
            seen, _ = without_unsure(seen, {name: ""})
        elif one > _NEAR * linear_one:
            better[what] = _reason(own, response, f)
        elif one < _WORSE * linear_one:
            place = getattr(seen, where)
            worse.append(what)
            why_worse = why_worse or _reason(own, response, place if np.isfinite(place) else f)
    for name in ("gain_reduction", "sensitivity_peak"):  # worse where they are larger
        where = PLACES[name]
        linear_one, one, f = getattr(ours, name), getattr(seen, name), getattr(ours, where)
        if linear_one > _NEAR * one and not own.f_hz[0] <= f <= own.f_hz[-1]:
            seen, _ = without_unsure(seen, {name: ""})
    notes = unsure_notes(told)
    if better:
        why = next(iter(better.values()))
        notes.append(f"measured better than linearised: {', '.join(better)}: {why}")
    if worse:
        notes.append(f"measured worse than linearised: {', '.join(worse)}: {why_worse}")
    return seen, notes


def _reason(own: measured.MeasuredLoop, response: Complex, f_hz: float) -> str:
    off, error, line_hz = _apart(own, response, f_hz)
    if off <= _WITHIN * error + _CLOSE:
        return f"within its error, {100.0 * max(off, error):.2g} % of L at {line_hz:.4g} Hz"
    what = f"at {line_hz:.4g} Hz both loops differ by {100.0 * off:.2g} %, by what is not linear"
    return f"{what} at an amplitude of {own.amplitude:.3g}; the smaller one counts"


def _apart(
    own: measured.MeasuredLoop, response: Complex, f_hz: float
) -> tuple[float, float, float]:
    """Return how far two loops are apart at the line next to f_hz, its error, and its place."""
    at = int(np.argmin(np.abs(np.log(own.f_hz / f_hz))))
    off = abs(own.response[at] / response[at] - 1.0)
    return float(off), float(own.error[at]), float(own.f_hz[at])


def _is_equal(own: measured.MeasuredLoop, response: Complex, f_hz: float) -> bool:
    """Return whether two loops are equal, within errors, at the lines on both sides of f_hz."""
    above = max(1, int(np.searchsorted(own.f_hz, f_hz)))
    both = slice(above - 1, above + 1)
    off = np.abs(own.response[both] / response[both] - 1.0)
    return bool((off <= _WITHIN * own.error[both] + _CLOSE).all())


def no_small_loop(own: measured.MeasuredLoop, cut: loops.CutLoop, why: str) -> list[str]:
    """Return that measured numbers are those of their amplitude, as there is no loop at rest."""
    what = f"the numbers are those of {_size(own, cut)}, what is small may have others"
    said = "there is no stable linear loop at rest"
    return [f"measured: {what}: {': '.join((said, *why.split(';')[:1]))}".removesuffix(": ")]


def other_small_loop(
    own: measured.MeasuredLoop, cut: loops.CutLoop, seen: Margins, ours: Margins, small: Found
) -> list[str]:
    """Return which measured numbers are those of their amplitude, as the loop at rest has others.

    seen, ours   the measured margins, and those of the loop `small` at rest
    """
    response, other = small.response(own.f_hz), list[str]()
    for name, share in differences(seen, ours).items():
        places = [getattr(each, PLACES[name]) for each in (ours, seen)]
        f = next(iter(filter(np.isfinite, places)), np.nan)
        if share > UNSURE and own.f_hz[0] <= f <= own.f_hz[-1]:
            off, error, _ = _apart(own, response, f)
            other += [_label(name)] * (off > _WITHIN * error + _CLOSE)
    if not other:
        return []
    what = f"measured: {', '.join(other)}: those of {_size(own, cut)}, where this rig is not linear"
    return [f"{what}; what is small has others, see --method linearised"]


def _size(own: measured.MeasuredLoop, cut: loops.CutLoop) -> str:
    return f"{own.amplitude:.3g} {cut.unit}".rstrip()


def _label(name: str) -> str:
    return name.replace("_deg", "").replace("_s", " ").replace("_", " ").strip()


def contradiction(one: Margins) -> bool:
    """Return whether no crossing was found though S has a peak that none explains."""
    crosses = np.isfinite(one.phase_margin_deg) or np.isfinite(one.gain_margin)
    return bool(not crosses and one.gain_reduction == 0.0 and one.sensitivity_peak > 2.0)


def without_crossings(one: Margins) -> Margins:
    """Return margins in which what comes from crossings is not known."""
    names = "gain_margin", "phase_margin_deg", "delay_margin_s", "delay_margin_samples"
    return replace(one, **dict.fromkeys(names, np.nan))


def is_restless(moves: float, command: float) -> bool:
    """Return whether a command that moves by that much, rms, is not at rest."""
    return moves > 1e-6 * max(1.0, abs(command))


def command_rms(rest: operating.Rest, cut: loops.CutLoop) -> float:
    """Return how much the command moves at rest, rms."""
    return float(rest.deviation[rest.cycle.place(cut.role, cut.sent)])

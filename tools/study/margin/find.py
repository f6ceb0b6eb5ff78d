"""From a rig to its margins: the point, both responses, what has to be said of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.start.rigs import find
from pcpc.tools.start.settings import settings
from pcpc.tools.study.margin import linear, loops, measured, motion, notes, operating
from pcpc.tools.study.margin.margins import margins
from pcpc.tools.study.margin.result import Margin, Response, Vector
from pcpc.tools.study.margin.shown import shown

Method = Literal["both", "linearised", "measured"]
SETTLE_S = 4.0
_POINTS = 600
_PERIODS = 4000  # of the rate in the period of the lowest line


def margin(
    rig: str | Path, controller: str | None = None, *, set: Mapping[str, Any] | None = None,
    loop: str | None = None, at_s: float = 0.0, method: Method = "both",
    amplitude: float | None = None, seed: int = 1, settle_s: float = SETTLE_S,
    lowest_hz: float | None = None,
) -> Margin:  # fmt: skip
    """Return the margins of a rig's loop, linearised and measured in virtual time.

    rig, controller, set   as of `pcpc.simulate`
    loop        the signal by which the loop is known, as CMD.motor_torque; None: the first
    at_s        the reference is held at what it is at this time of the run, s
    method      "linearised", "measured" or "both"
    amplitude   the largest value that is injected, in the signal's unit; None: of 2, 5, 12 and
                30 % of half its range the one that leaves the least error
    seed        of the phases of what is injected
    settle_s    how long the rig comes to rest before, s
    lowest_hz   the lowest frequency; None: the rate by 4000

    Raises pcpc.Error for a rig without a loop, one that is unstable, ends in a fault or has no
    gain.
    """
    loaded = load_rig(find(str(rig)), controller, settings(set))
    return of(loaded, loop, at_s, method, amplitude, seed, settle_s, lowest_hz)


def of(
    rig: Rig, name: str | None, at_s: float, method: Method, amplitude: float | None, seed: int,
    settle_s: float, lowest_hz: float | None,
) -> Margin:  # fmt: skip
    """Return what `margin` does, of a rig that was read."""
    rate = rig.config.rate_hz
    lowest = rate / _PERIODS if lowest_hz is None else lowest_hz
    _check(rate, at_s, method, amplitude, settle_s, lowest)
    if seed < 0:
        raise UserError(f"--seed {seed}: expected 0 or a whole number above it")
    with np.errstate(all="ignore"):  # what is no number is looked for
        return _of(
            operating.undisturbed(rig), name, at_s, method, amplitude, seed, settle_s, lowest
        )


def _of(
    rig: Rig, name: str | None, at_s: float, method: Method, amplitude: float | None, seed: int,
    settle_s: float, lowest: float,
) -> Margin:  # fmt: skip
    plans, rate = operating.plans_of(rig), rig.config.rate_hz
    cut, known = loops.chosen(rig, plans, name)
    held = operating.held(plans, at_s)
    point, own, said = _Point(None), None, list[str]()
    sizes = [] if method == "linearised" else [amplitude] if amplitude else cut.amplitudes()
    if method != "measured":
        try:
            point = _linear(plans, cut, held, settle_s)
        except UserError as error:
            if method == "linearised":
                raise
            said = [f"not linearised: {error}"]
    if sizes:
        try:
            own = measured.loudest(rig, cut, held, (rate, lowest, seed), sizes, settle_s)
            seen = shown(own.f_hz, own.response, own.noise, rate)
            said += notes.of_measured(own, cut, said, seen)
        except UserError as error:
            if point.found is None:
                raise
            own, said = None, [*said, f"not measured: {error}"]
    found = point.found
    ours = None if found is None else _linearised(found, rate, lowest, own)
    if found is not None and own is not None and ours is not None:
        seen, more = notes.compared(ours.margins, own, seen, found.response(own.f_hz))
        said += more
    theirs = None if own is None else Response(
        own.f_hz, own.response, seen, own.spread, own.coherence
    )  # fmt: skip
    ours, theirs, more = _consistent(ours, theirs)
    return Margin(
        rig.config.rig, rig.config.controller, cut.signal, cut.unit, [one.signal for one in known],
        rate, held, found.command if found else own.command if own else np.nan, ours, theirs,
        np.empty(0, complex) if found is None else found.closed(),
        [] if found is None else found.kinks, np.nan if own is None else own.amplitude,
        [*point.said, *said, *more], point.moving_s,
    )  # fmt: skip


@dataclass(frozen=True)
class _Point:
    """A linear loop, what has to be said of it, and when of the rig's own run it was found."""

    found: notes.Found | None
    said: list[str] = field(default_factory=list)
    moving_s: float = np.nan


def _linear(
    plans: dict[Role, Plan], cut: loops.Loop, held: dict[str, float], settle_s: float
) -> _Point:
    """Return the loop at rest, or in motion where there is none at rest; UserError."""
    rest = operating.at_rest(plans, held, settle_s)
    found = linear.linearised(rest, cut)
    if found.passes(rest.cycle.received(cut.role)):
        moves = notes.moves_at(rest, cut)
        said = notes.of_linear(found, cut, moves)
        if notes.restless(moves, found.command) and not found.rounded:  # which cycles by steps
            motion.check_rest(rest, cut)
        if found.kinks or found.idle or notes.restless(moves, found.command):
            f = np.geomspace(1e-5, 0.5, _POINTS) / found.dt
            disk = margins(f, found.response(f), 1.0 / found.dt).disk_margin
            said += motion.beside(plans, cut, disk)
        return _Point(found, said)
    seen = motion.in_motion(plans, cut)
    if seen is None:
        what = f"{motion.at_rest_words(cut)}, nor in its own run"
        raise UserError(f"{what}; --at, --set or --loop choose another")
    said = motion.words(cut, seen)
    try:
        return _Point(seen.found, said + notes.of_linear(seen.found, cut, 0.0), seen.at_s)
    except UserError as error:
        raise UserError(f"{said[0].partition(':')[0]}: {motion.STUCK}; in motion {error}") from None


def _consistent(
    ours: Response | None, seen: Response | None
) -> tuple[Response | None, Response | None, list[str]]:
    """Return both, without margins that the peak of S contradicts, and what that is."""
    said, found = list[str](), list[Response | None]()
    for name, one in (("linearised", ours), ("measured", seen)):
        if one is not None and notes.contradiction(one.margins):
            peak, f = one.margins.sensitivity_peak, one.margins.sensitivity_peak_hz
            what = f"{name}: the sensitivity peak, {peak:.3g} at {f:.4g} Hz, belongs to a crossing"
            said.append(f"{what} that was not found; its margins are not known")
            one = replace(one, margins=notes.without_crossings(one.margins))
        found.append(one)
    return found[0], found[1], said


def _check(
    rate: float, at_s: float, method: str, amplitude: float | None, settle_s: float, lowest: float
) -> None:
    if method not in ("both", "linearised", "measured"):
        raise UserError(f"method {method}: expected both, linearised or measured")
    if not 0.0 <= at_s <= 1e6:
        raise UserError(f"--at {at_s:g} s: expected a time of the run, 0 or later")
    if amplitude is not None and not 0.0 < amplitude < 1e300:
        raise UserError(f"--amplitude {amplitude:g}: expected a number above 0")
    if not 1.0 / rate <= settle_s <= 1e4:
        raise UserError(f"--settle {settle_s:g} s: expected {1.0 / rate:g} s to 10000 s")
    if not rate / 1e6 <= lowest <= rate / 8.0:
        what = f"expected {rate / 1e6:g} to {rate / 8.0:g} Hz, an eighth of the rate"
        raise UserError(f"--lowest {lowest:g} Hz: {what}")


def _linearised(
    found: notes.Found, rate: float, lowest: float, own: measured.Measured | None
) -> Response:
    """Return the response at a grid, near the poles, and at the measured lines.

    Margins are those of all frequencies, also below the lowest that is told.
    """
    poles = np.array([*found.poles(), *found.closed()])
    slow = np.abs(np.log(poles[np.abs(poles) > 1e-9])) * rate / (2.0 * np.pi)
    slowest = slow[slow > 1e-7 * rate].min(initial=lowest)
    below = np.geomspace(max(0.01 * min(slowest, lowest), 1e-9 * rate), lowest, _POINTS // 2)
    every = [np.geomspace(lowest, 0.5 * rate, _POINTS), *(_near(pole, rate) for pole in poles)]
    every += [] if own is None else [own.f_hz]
    whole = np.unique(np.concatenate((below, *every)))
    whole = whole[(whole >= below[0]) & (whole <= 0.5 * rate)]
    response, told = found.response(whole), whole >= lowest
    return Response(whole[told], response[told], margins(whole, response, rate))


def _near(pole: complex, rate: float) -> Vector:
    """Return frequencies about a resonance."""
    if abs(pole) < 1e-9:
        return np.empty(0)
    s = np.log(pole) * rate / (2.0 * np.pi)
    return np.asarray(abs(s.imag) + max(abs(s.real), 1e-6 * rate) * np.linspace(-6.0, 6.0, 49))

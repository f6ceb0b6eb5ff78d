"""From a rig to its margins: the point, both responses, what has to be said of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.api.settings import settings
from pcpc.tools.margin import impulse, linear, loops, measured, operating
from pcpc.tools.margin.margins import margins
from pcpc.tools.margin.result import Margin, Response, Vector
from pcpc.tools.rigs import find

Method = Literal["both", "linearised", "measured"]
Found = linear.Linear | impulse.Impulse
SETTLE_S = 4.0
_POINTS = 600
_UNSTABLE = 1e-7  # beyond 1: what rounding of several poles at 1 does not reach
_COHERENT = 0.9  # of a line that counts
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
    amplitude   the largest value that is injected, in the signal's unit; None: 2 % of half its
                range
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
    rig = operating.undisturbed(rig)
    plans = operating.plans_of(rig)
    cut, known = loops.chosen(rig, plans, name)
    held = operating.held(plans, at_s)
    notes, found, lines = list[str](), None, None
    if method != "linearised":
        size = cut.amplitude() if amplitude is None else amplitude
        lines = measured.multisine(rate, lowest, size, seed)
    if method != "measured":
        try:
            rest = operating.at_rest(plans, held, settle_s)
            found = linear.linearised(rest, cut)
            notes += _of_linear(found, rest, cut)
        except UserError as error:
            if method == "linearised":
                raise
            found, notes = None, [f"not linearised: {error}"]
    own = None
    if lines is not None:
        try:
            own = measured.measure(rig, cut, held, lines, settle_s)
            notes += _of_measured(own, cut, notes if found is None else [])
        except UserError as error:
            if found is None:
                raise
            own, notes = None, [*notes, f"not measured: {error}"]
    return Margin(
        rig.config.rig, rig.config.controller, cut.signal, cut.unit, [one.signal for one in known],
        rate, held, found.command if found else own.command if own else np.nan,
        None if found is None else _linearised(found, rate, lowest, own),
        None if own is None else _measured(own, rate),
        np.empty(0, complex) if found is None else found.closed(),
        [] if found is None else found.kinks, np.nan if own is None else own.amplitude, notes,
    )  # fmt: skip


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
    found: Found, rate: float, lowest: float, own: measured.Measured | None
) -> Response:
    """Return the response at a grid, near the poles, and at the measured lines."""
    f = np.geomspace(lowest, 0.5 * rate, _POINTS)
    every = [f, *(_near(pole, rate) for pole in (*found.poles(), *found.closed()))]
    every += [] if own is None else [own.f_hz]
    whole = np.unique(np.concatenate(every))
    whole = whole[(whole >= lowest) & (whole <= 0.5 * rate)]
    response = found.response(whole)
    return Response(whole, response, margins(whole, response, rate))


def _measured(own: measured.Measured, rate: float) -> Response:
    """Return the response with the margins of the lines that noise does not hide."""
    strong = own.coherence >= _COHERENT
    numbers = margins(own.f_hz[strong], own.response[strong], rate)
    return Response(own.f_hz, own.response, numbers, own.spread, own.coherence)


def _near(pole: complex, rate: float) -> Vector:
    """Return frequencies about a resonance."""
    if abs(pole) < 1e-9:
        return np.empty(0)
    s = np.log(pole) * rate / (2.0 * np.pi)
    return np.asarray(abs(s.imag) + max(abs(s.real), 1e-6 * rate) * np.linspace(-6.0, 6.0, 49))


def _of_linear(found: Found, rest: operating.Rest, cut: loops.Loop) -> list[str]:
    """Return what has to be said of a linear loop; UserError if it has no margins."""
    if not found.gains:
        what = f"{cut.signal} has no effect on itself: no gain around this loop at this point"
        raise UserError(f"{what}; --at, --set or --loop choose another")
    largest = float(np.abs(found.closed()).max(initial=0.0))
    if largest > 1.0 + _UNSTABLE:
        what = f"the closed loop is unstable: a pole at |z| = {largest:.6f}"
        raise UserError(f"{what}; a lower gain, or another --at or --set, may be stable")
    notes = []
    if found.kinks:
        names = ", ".join(found.kinks[:4]) + (", ..." if len(found.kinks) > 4 else "")
        what = "two slopes meet here (play, friction, a limit), their mean was taken"
        notes.append(f"not differentiable in {names}: {what}")
    if isinstance(found, impulse.Impulse):
        what = "the loop is another map in every cycle (a delay line, a schedule)"
        notes.append(f"{what}: found by {len(found.s)} cycles after an impulse, without poles")
    for name, step in found.rounded.items():
        what = f"{name} is rounded in the plant or a law, in steps of {step:.3g}"
        notes.append(f"{what}: its slope is that from step to step")
    if found.idle:
        names = ", ".join(found.idle[:3]) + (", ..." if len(found.idle) > 3 else "")
        what = "a gate, a dead band or a limit keeps them out of the loop at this point"
        notes.append(f"no part of it: {names}; {what}")
    moved = float(rest.deviation[rest.cycle.place(cut.role, cut.sent)])
    if moved > 1e-6 * max(1.0, abs(found.command)):
        unit = f" {cut.unit}" if cut.unit else ""
        what = f"the command moves by {moved:.2g}{unit} rms (noise, a limit cycle or a drift)"
        notes.append(f"not at rest: {what}; linearised at the mean")
    if not cut.low < found.command < cut.high:
        notes.append(f"the command stands at its limit, {found.command:g}: there is no loop")
    return notes


def _of_measured(own: measured.Measured, cut: loops.Loop, before: list[str]) -> list[str]:
    """Return what has to be said of a measured loop; UserError if it does not answer."""
    notes = []
    unit = f" {cut.unit}" if cut.unit else ""
    weak = own.f_hz[own.coherence < _COHERENT]
    if len(weak) > 0.5 * len(own.f_hz):
        what = f"the measured loop does not answer to {own.amplitude:.3g}{unit}"
        moves = f"by itself the command moves by {own.alone:.3g}{unit} rms"
        cure = "unstable, a limit cycle, or noise: inject more with --amplitude, or lower the gain"
        raise UserError("; ".join((f"{what}: {moves}", cure, *before)))
    if own.alone > 0.5 * own.amplitude:
        what = f"moves by {own.alone:.3g}{unit} rms, as much as what is injected"
        notes.append(f"measured: by itself the command {what}: noise or a limit cycle")
    if own.clamped:
        notes.append(f"{own.clamped} values were clamped: inject less with --amplitude")
    if len(weak):
        what = f"{len(weak)} of {len(own.f_hz)} lines, the lowest at {weak[0]:.4g} Hz"
        notes.append(f"measured: noise hides {what}; inject more with --amplitude")
    return notes

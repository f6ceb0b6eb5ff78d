"""Reference generators in any unit: a value with its first two derivatives.

    step       y = A                                             from t0 on                   (1)
    ramp       y = V (t - t0)                                    from t0 to t1, then held     (2)
    sine       y = A sin(2 pi F (t - t0) + phase)                from t0 on                   (3)
    chirp      y = A sin(2 pi (F0 s + (F1 - F0) s^2/(2 T)) + phase), s = t - t0, up to T; then
               on with F1                                                                     (4)
    quintic    y = A (10 s^3 - 15 s^4 + 6 s^5), s = (t - t0)/T: up at t_up, back at t_back    (5)
    sequence   segments one after the other, each from where the last one ended to its own end: a
               step, a line, (5), or nothing; with `repeat` again and again                   (6)

Before t0 y = 0. The offset is added to all but (6), which has a begin. The unit is that of the port
that the value feeds (`executive.rig.wired_units`), seconds otherwise; a step is one code for all
units. All are closed forms of t, so that a skipped cycle or a replay changes nothing.
"""

from pcpc.executive.laws.block import Block, Nothing, Ports, inline, port, stage
from pcpc.executive.laws.emath import floor, sincos, where
from pcpc.executive.laws.ports import ANY_UNIT
from pcpc.executive.laws.references import TWO_PI, rise, within

SEGMENTS = 16
HOLD, STEP, LINE, QUINTIC = 0.0, 1.0, 2.0, 3.0  # shapes of a segment
NEVER_S = 1e9
_SAME_S = 1e-9  # k T and a time of a rig are the same, but for their last bits
_UNIT, _RATE, _LARGE = ANY_UNIT, f"{ANY_UNIT}/s", 1e12


class Desired(Ports):
    """What all give."""

    value = port(_UNIT, "desired value")
    rate = port(_RATE, "its first derivative")
    acc = port(f"{ANY_UNIT}/s2", "its second derivative")


class Start(Ports):
    """Of all but a sequence."""

    offset = port(_UNIT, "added to the value at all times", 0.0, -_LARGE, _LARGE)
    start_s = port("s", "start", 0.0, 0.0, NEVER_S)


class Step(Start):
    """Of (1)."""

    amplitude = port(_UNIT, "A", None, -_LARGE, _LARGE)


class Ramp(Start):
    """Of (2)."""

    slope = port(_RATE, "V", None, -_LARGE, _LARGE)
    end_s = port("s", "t1", NEVER_S, 0.0, NEVER_S)


class Sine(Step):
    """Of (3)."""

    frequency_hz = port("Hz", "F", None, 0.0, 1e4)
    phase_rad = port("rad", "at t0", 0.0, -7.0, 7.0)


class Chirp(Step):
    """Of (4)."""

    from_hz = port("Hz", "F0", None, 0.0, 1e4)
    to_hz = port("Hz", "F1", None, 0.0, 1e4)
    sweep_s = port("s", "T", None, 1e-3, 1e6)
    phase_rad = port("rad", "at t0", 0.0, -7.0, 7.0)


class Quintic(Step):
    """Of (5)."""

    move_s = port("s", "duration of the move", None, 1e-3, 1e6)
    back_s = port("s", "start back", NEVER_S, 0.0, NEVER_S)


class Sequence(Ports):
    """Of (6); `segments` of a rig file gives what is numbered."""

    begin = port(_UNIT, "value before the first segment", 0.0, -_LARGE, _LARGE)
    start_s = port("s", "start of the first segment", 0.0, 0.0, NEVER_S)
    repeat = port("", "1: behind the last segment the first begins again", 0.0, 0.0, 1.0)
    to = port(_UNIT, "end of segment #", 0.0, -_LARGE, _LARGE, shape=SEGMENTS, named="to_#")
    over_s = port("s", "duration of segment #", 0.0, 0.0, 1e6, shape=SEGMENTS, named="over_#_s")
    shape = port(
        "",
        "of segment #: 0 hold, 1 step, 2 line, 3 quintic",
        0.0,
        0.0,
        QUINTIC,
        shape=SEGMENTS,
        named="shape_#",
    )


@inline
def _swing(cycles: float, phase_rad: float) -> tuple[float, float]:
    """Return sine and cosine of so many turns; whole ones are taken away first."""
    return sincos(TWO_PI * (cycles - floor(cycles)) + phase_rad)


@stage
def step_step(t: float, dt: float, p: Step, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (1)."""
    y.value = p.offset + where(t < p.start_s - _SAME_S, 0.0, p.amplitude)
    y.rate = 0.0
    y.acc = 0.0


@stage
def ramp_step(t: float, dt: float, p: Ramp, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (2)."""
    last = where(p.end_s < p.start_s, p.start_s, p.end_s)
    now = where(t < p.start_s, p.start_s, where(t > last, last, t))
    moving = (t >= p.start_s - _SAME_S) & (t < last - _SAME_S)
    y.value = p.offset + p.slope * (now - p.start_s)
    y.rate = where(moving, p.slope, 0.0)
    y.acc = 0.0


@stage
def sine_step(t: float, dt: float, p: Sine, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (3)."""
    waiting = t < p.start_s - _SAME_S
    amplitude, omega = where(waiting, 0.0, p.amplitude), TWO_PI * p.frequency_hz
    s, c = _swing(p.frequency_hz * (t - p.start_s), p.phase_rad)
    y.value = p.offset + amplitude * s
    y.rate = amplitude * omega * c
    y.acc = -amplitude * omega * omega * s


@stage
def chirp_step(t: float, dt: float, p: Chirp, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (4)."""
    waiting = t < p.start_s - _SAME_S
    amplitude = where(waiting, 0.0, p.amplitude)
    since = t - p.start_s
    swept = where(since > p.sweep_s, p.sweep_s, since)
    climb = (p.to_hz - p.from_hz) / p.sweep_s  # Hz/s
    hz = p.from_hz + climb * swept
    cycles = (p.from_hz + 0.5 * climb * swept) * swept + p.to_hz * (since - swept)
    s, c = _swing(cycles, p.phase_rad)
    omega = TWO_PI * hz
    omega_rate = where(since < p.sweep_s, TWO_PI * climb, 0.0)
    y.value = p.offset + amplitude * s
    y.rate = amplitude * omega * c
    y.acc = amplitude * (omega_rate * c - omega * omega * s)


@stage
def quintic_step(t: float, dt: float, p: Quintic, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (5), up and back."""
    u0, u1, u2 = rise((t - p.start_s) / p.move_s)
    b0, b1, b2 = rise((t - p.back_s) / p.move_s)
    y.value = p.offset + p.amplitude * (u0 - b0)
    y.rate = p.amplitude * (u1 - b1) / p.move_s
    y.acc = p.amplitude * (u2 - b2) / (p.move_s * p.move_s)


@stage
def sequence_step(t: float, dt: float, p: Sequence, x: Nothing, u: Nothing, y: Desired) -> None:
    """Equation (6): the last segment that has begun says it."""
    zero = p.begin - p.begin  # of one run, or of each lane
    total = zero
    for i in range(SEGMENTS):
        total += p.over_s[i]
    since = t - p.start_s + _SAME_S
    rounds = floor(since / where(total > 0.0, total, 1.0))
    again = (p.repeat > 0.5) & (total > 0.0) & (since > 0.0)
    since -= where(again, rounds * total, 0.0)
    value, rate, acc = p.begin, zero, zero
    start, origin = zero, p.begin
    for i in range(SEGMENTS):
        lasts = p.over_s[i]
        moves = lasts > 0.0
        over = where(moves, lasts, 1.0)
        s = within(where(moves, (since - _SAME_S - start) / over, 1.0))
        far = where(p.shape[i] < 0.5, 0.0, p.to[i] - origin)
        end = where(p.shape[i] < 0.5, origin, p.to[i])
        r0, r1, r2 = rise(s)
        smooth = p.shape[i] > 2.5
        still = (p.shape[i] < 1.5) | (s >= 1.0)
        begun = since >= start
        line = where(smooth, r0, s)
        here = where(still, end, origin + far * line)
        slope = where(smooth, r1, 1.0) / over
        bend = where(smooth, r2, 0.0) / (over * over)
        value = where(begun, here, value)
        rate = where(begun, where(still, 0.0, far * slope), rate)
        acc = where(begun, where(still, 0.0, far * bend), acc)
        start += lasts
        origin = end
    y.value = value
    y.rate = rate
    y.acc = acc


step = Block(step_step)
ramp = Block(ramp_step)
sine = Block(sine_step)
chirp = Block(chirp_step)
quintic = Block(quintic_step)
sequence = Block(sequence_step)

"""The quarter car as one block: a valve command in, samples of six sensors and truths out.

    x1 = zs, x2 = zs'   body      x3 = zs - zu   strut, 0 at mid stroke      x4 = zu'   wheel
    x5 = P2, x6 = P1    rod and bore side        x7 = xv   valve spool       v3 = x2 - x4

    zr  = za sin(wr t)                                  road                                 (1)
    Ff  = Fc tanh(v3/vfr)                               strut friction                       (2)
    Fb  = min(0, -Kb (x3 - L) - Cb v3)                  for x3 > L: bump stop, it only
          max(0, -Kb (x3 + L) - Cb v3)                  for x3 < -L  pushes                  (3)
    Ft  = F - Ff + Fb                                   up on the body                       (4)
    x2' = Ft/ms - g,  x4' = (-Ft + Kt (zr - zu))/mu - g,  x1' = x2,  x3' = v3                (5)
    x5', x6' and F                                      hydraulic_strut.py                   (6)
    x7' = (u - x7)/Tv                                   servovalve                           (7)

    strut      0   F = -Ks x3 - Bs v3     spring and damper without preload                  (8)
               1   F = Ac x6 - Aa x5
               2   F = the commanded force, as if a strut could have any
    limits_on  0   Fb = 0

    call k of `step` at t = k T:  k = 0  samples of the initial state
                                  k > 0  integrates [t - T, t] in equal Runge-Kutta steps of about
                                         `step_s` under the command computed from the sample of
                                         t - T (`delay_samples` older ones), then samples

zr is taken at the stages' own times. After each step P1, P2 >= 1e5 Pa, |xv| <= xvmax. Start: zu by
the static load, x3 in the rest of its strut: 0; of the spring of (8) on its lower stop, or without
stops at -ms g/Ks; P1 = P2 = P0. The tyre is linear, undamped, and never lifts off. A sample is
rounded to a multiple of its `..._lsb_...`, 0 none. Up is positive. m, m/s, N, Pa, kg, s.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 6.
"""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.emath import clip, sin, tanh, where
from pcpc.executive.laws.models import hydraulic_strut as hydraulic
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

_CAR = (
    Port("ms_kg", "kg", "ms, body over this wheel", None, 1.0, 1e5),
    Port("mu_kg", "kg", "mu, wheel", None, 0.1, 1e4),
    Port("kt_N_m", "N/m", "Kt, tyre", None, 1.0, 1e8),
    Port("ks_N_m", "N/m", "Ks, spring of the passive element", None, 1.0, 1e8),
    Port("bs_Ns_m", "N s/m", "Bs, damper of the passive element", None, 0.0, 1e6),
    Port("gravity_m_s2", "m/s2", "g", None, 0.0, 100.0),
    Port("fc_N", "N", "Fc, strut friction", None, 0.0, 1e5),
    Port("vfr_m_s", "m/s", "vfr, speed that smooths it", None, 1e-6, 10.0),
    Port("stop_m", "m", "L, travel to either stop", None, 1e-3, 10.0),
    Port("kb_N_m", "N/m", "Kb, bump stop", None, 0.0, 1e9),
    Port("cb_Ns_m", "N s/m", "Cb, its damping", None, 0.0, 1e7),
    Port("valve_lag_s", "s", "Tv, servovalve", None, 1e-4, 10.0),
    Port("spool_max_m", "m", "xvmax, travel of the spool", None, 1e-6, 1.0),
    Port("road_m", "m", "za, amplitude of the road; 0 is flat", None, 0.0, 10.0),
    Port("road_rad_s", "rad/s", "wr, frequency of the road", None, 0.0, 1e3),
    Port("strut", "", "0 spring and damper, 1 hydraulic, 2 ideal force", None, 0.0, 2.0),
    Port("limits_on", "", "1 with bump stops", None, 0.0, 1.0),
    Port("delay_samples", "", "age of the command that acts, whole", 0.0, 0.0, DELAY_SIZE - 1.0),
    Port("rate_lsb_m_s", "m/s", "quantum of the speed samples, 0 none", 0.0, 0.0, 10.0),
    Port("extension_lsb_m", "m", "quantum of the extension samples, 0 none", 0.0, 0.0, 1.0),
    Port("pressure_lsb_Pa", "Pa", "quantum of the pressure samples, 0 none", 0.0, 0.0, 1e8),
    Port("spool_lsb_m", "m", "quantum of the spool samples, 0 none", 0.0, 0.0, 1.0),
)
_HYDRAULICS = tuple(Port(*row) for row in hydraulic.HYDRAULICS)
_DIMENSIONS = tuple(Port(*row[:3], None, *row[4:]) for row in hydraulic.DIMENSIONS)
PARAMETERS = (*_CAR, Port("substeps", "", "Runge-Kutta steps a period"), *_HYDRAULICS)
SETTINGS = (
    *_CAR,
    *_DIMENSIONS,
    Port("step_s", "s", "integration step, made to fit a period", None, 1e-7, 1e-2),
    Port("kick_m_s", "m/s", "speed of the body at the start", 0.0, -10.0, 10.0),
)
(MS, MU, KT, KS, BS, G, FC, VFR, STOP, KB, CB, LAG, SPOOL_MAX, ROAD, ROAD_RATE, STRUT, LIMITS,
 DELAY, RATE_LSB, EXTENSION_LSB, PRESSURE_LSB, SPOOL_LSB, SUBSTEPS, H) = range(24)  # fmt: skip
PASSIVE, HYDRAULIC, IDEAL = 0.0, 1.0, 2.0

N = 7
STATES = (
    Port("x1_m", "m", "zs, body"),
    Port("x2_m_s", "m/s", "zs'"),
    Port("x3_m", "m", "zs - zu, strut"),
    Port("x4_m_s", "m/s", "zu'"),
    Port("x5_Pa", "Pa", "P2"),
    Port("x6_Pa", "Pa", "P1"),
    Port("x7_m", "m", "xv"),
    Port("held", "", "commands on their way", size=DELAY_SIZE, recorded=False),
    Port("scratch", "", "of Runge-Kutta: stage, rates, their sum", size=3 * N, recorded=False),
)
(X1, X2, X3, X4, X5, X6, X7, HELD) = range(8)
SCRATCH = HELD + DELAY_SIZE
RATES, TOTAL = SCRATCH + N, SCRATCH + 2 * N

INPUTS = (
    Port("spool_m", "m", "newest valid command to the valve", 0.0),
    Port("force_N", "N", "newest valid desired force, for the ideal strut", 0.0),
)
OUTPUTS = (
    Port("body_sample_m_s", "m/s", "sensor: body speed"),
    Port("extension_sample_m", "m", "sensor: strut extension"),
    Port("wheel_sample_m_s", "m/s", "sensor: wheel speed"),
    Port("p1_sample_Pa", "Pa", "sensor: bore side"),
    Port("p2_sample_Pa", "Pa", "sensor: rod side"),
    Port("spool_sample_m", "m", "sensor: valve spool"),
    Port("body_rate_m_s", "m/s", "true body speed"),
    Port("extension_m", "m", "true strut extension"),
    Port("wheel_rate_m_s", "m/s", "true wheel speed"),
    Port("body_m", "m", "body, from its place over an unloaded tyre"),
    Port("wheel_m", "m", "wheel, likewise"),
    Port("ground_m", "m", "road under the wheel, zr"),
    Port("p1_Pa", "Pa", "true pressure of the bore side"),
    Port("p2_Pa", "Pa", "true pressure of the rod side"),
    Port("spool_true_m", "m", "true spool position"),
    Port("strut_N", "N", "strut force F"),
    Port("friction_N", "N", "strut friction Ff"),
    Port("bump_N", "N", "bump stops Fb"),
    Port("acting", "", "command that acted up to this sample, m or N"),
)


@inline
def road(t: float, p: Any) -> float:
    """Return zr (1), m."""
    return p[ROAD] * sin(p[ROAD_RATE] * t)


@inline
def bump_stop(x3: float, v3: float, p: Any) -> float:
    """Return Fb (3), N."""
    upper = -p[KB] * (x3 - p[STOP]) - p[CB] * v3
    lower = -p[KB] * (x3 + p[STOP]) - p[CB] * v3
    down = where((x3 > p[STOP]) & (upper < 0.0), upper, 0.0)
    up = where((x3 < -p[STOP]) & (lower > 0.0), lower, 0.0)
    return p[LIMITS] * (down + up)


@inline
def strut_force(command: float, p: Any, s: Any) -> float:
    """Return F of the chosen strut (8), N."""
    if p[STRUT] == PASSIVE:
        return -p[KS] * s[X3] - p[BS] * (s[X2] - s[X4])
    if p[STRUT] == IDEAL:
        return command
    return hydraulic.force(s[X6], s[X5], tail(p, H))


@inline
def rates(t: float, command: float, p: Any, s: Any, d: Any) -> None:
    """Write the seven derivatives (5) to (7) at `s` to `d`."""
    x3, v3 = s[X3], s[X2] - s[X4]
    friction = p[FC] * tanh(v3 / p[VFR])  # (2)
    total = strut_force(command, p, s) - friction + bump_stop(x3, v3, p)  # (4)
    d[X1] = s[X2]
    d[X2] = total / p[MS] - p[G]
    d[X3] = v3
    d[X4] = (p[KT] * (road(t, p) - (s[X1] - x3)) - total) / p[MU] - p[G]
    d[X5], d[X6], d[X7] = 0.0, 0.0, 0.0
    if p[STRUT] == HYDRAULIC:
        h = tail(p, H)
        leak = hydraulic.orifice_flow(s[X6], s[X5], h)
        supply = hydraulic.valve_gain(s[X7], s[X6], h) * s[X7]
        bore, rod = h[hydraulic.AC], h[hydraulic.AA]
        d[X5] = hydraulic.stiffness_2(x3, s[X5], h) * (rod * v3 + leak)
        d[X6] = hydraulic.stiffness_1(x3, s[X6], h) * (-bore * v3 - leak + supply)
        d[X7] = (command - s[X7]) / p[LAG]  # (7)


@inline
def advance(t: float, dt: float, command: float, p: Any, x: Any) -> None:
    """One Runge-Kutta step of the seven states from t to t + dt."""
    between, d, total = tail(x, SCRATCH), tail(x, RATES), tail(x, TOTAL)
    for i in range(N):
        d[i] = 0.0
        total[i] = 0.0
    for k in range(4):
        at = 0.0 if k == 0 else (dt if k == 3 else 0.5 * dt)
        weight = 2.0 if k == 1 or k == 2 else 1.0
        for i in range(N):
            between[i] = x[i] + at * d[i]
        rates(t + at, command, p, between, d)
        for i in range(N):
            total[i] += weight * d[i]
    for i in range(N):
        x[i] += dt / 6.0 * total[i]
    for i in range(X5, X7):
        x[i] = where(x[i] < hydraulic.P_MIN_PA, hydraulic.P_MIN_PA, x[i])
    x[X7] = clip(x[X7], -p[SPOOL_MAX], p[SPOOL_MAX])


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Advance to t, sample; see the module header."""
    if t > 0.0:
        command = u[1] if p[STRUT] == IDEAL else u[0]
        y[18] = delayed(command, p[DELAY], x, HELD)
        h = dt / p[SUBSTEPS]
        for i in range(int(p[SUBSTEPS])):
            advance(t - dt + i * h, h, y[18], p, x)
    v3 = x[X2] - x[X4]
    y[0] = rounded(x[X2], p[RATE_LSB])
    y[1] = rounded(x[X3], p[EXTENSION_LSB])
    y[2] = rounded(x[X4], p[RATE_LSB])
    y[3] = rounded(x[X6], p[PRESSURE_LSB])
    y[4] = rounded(x[X5], p[PRESSURE_LSB])
    y[5] = rounded(x[X7], p[SPOOL_LSB])
    y[6] = x[X2]
    y[7] = x[X3]
    y[8] = x[X4]
    y[9] = x[X1]
    y[10] = x[X1] - x[X3]
    y[11] = road(t, p)
    y[12] = x[X6]
    y[13] = x[X5]
    y[14] = x[X7]
    y[15] = strut_force(y[18], p, x)
    y[16] = p[FC] * tanh(v3 / p[VFR])
    y[17] = bump_stop(x[X3], v3, p)


def rest(settings: Mapping[str, float]) -> float:
    """Return x3 at rest, m."""
    if settings["strut"] != PASSIVE:
        return 0.0
    weight, ks = settings["ms_kg"] * settings["gravity_m_s2"], settings["ks_N_m"]
    left = weight - ks * settings["stop_m"]  # for the lower stop
    if settings["limits_on"] == 0.0 or left <= 0.0:
        return -weight / ks
    return -(settings["stop_m"] + left / (settings["kb_N_m"] + ks))


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters and the car at rest, but for the kick."""
    shared = {port.name: settings[port.name] for port in _CAR}
    shared["substeps"] = float(max(1, round(1.0 / (rate_hz * settings["step_s"]))))
    weight = settings["ms_kg"] * settings["gravity_m_s2"]
    both = weight + settings["mu_kg"] * settings["gravity_m_s2"]
    extension = rest(settings)
    pressure = hydraulic.static_pressure(settings, weight)
    states = {
        "x1_m": extension - both / settings["kt_N_m"],
        "x2_m_s": settings["kick_m_s"],
        "x3_m": extension,
        "x5_Pa": pressure,
        "x6_Pa": pressure,
    }
    return Prepared({**shared, **hydraulic.hydraulics(settings, weight)}, states)


BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    states=STATES,
    settings=SETTINGS,
    prepare=prepare,
)

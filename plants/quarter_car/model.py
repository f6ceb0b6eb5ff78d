"""The quarter car as one block: a valve command in, samples of six sensors and truths out.

    x1 = zs, x2 = zs'   body      x3 = zs - zu   strut, 0 at mid stroke      x4 = zu'   wheel
    x5 = P2, x6 = P1    rod and bore side        x7 = xv   valve spool       v3 = x2 - x4

    zr  = za sin(wr t)                                  road                                 (1)
    Ff  = Fc tanh(v3/vfr)                               strut friction                       (2)
    Fb  = min(0, -Kb (x3 - L) - Cb v3)                  for x3 > L: bump stop, it only
          max(0, -Kb (x3 + L) - Cb v3)                  for x3 < -L  pushes                  (3)
    Ft  = F - Ff + Fb                                   up on the body                       (4)
    x2' = Ft/ms - g,  x4' = (-Ft + Kt (zr - zu))/mu - g,  x1' = x2,  x3' = v3                (5)
    x5', x6' and F                                      equations.py                         (6)
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

from pcpc.executive.laws.block import (
    Block,
    Ports,
    Prepared,
    group,
    inline,
    port,
    required,
    stage,
)
from pcpc.executive.laws.emath import clip, sin, tanh, where
from pcpc.plants.integrate import runge_kutta, scratch
from pcpc.plants.quarter_car import equations as hydraulic
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

PASSIVE, HYDRAULIC, IDEAL = 0.0, 1.0, 2.0


class Car(Ports):
    """The car, its road and its sensors."""

    ms_kg = port("kg", "ms, body over this wheel", None, 1.0, 1e5)
    mu_kg = port("kg", "mu, wheel", None, 0.1, 1e4)
    kt_N_m = port("N/m", "Kt, tyre", None, 1.0, 1e8)
    ks_N_m = port("N/m", "Ks, spring of the passive element", None, 1.0, 1e8)
    bs_Ns_m = port("N s/m", "Bs, damper of the passive element", None, 0.0, 1e6)
    gravity_m_s2 = port("m/s2", "g", None, 0.0, 100.0)
    fc_N = port("N", "Fc, strut friction", None, 0.0, 1e5)
    vfr_m_s = port("m/s", "vfr, speed that smooths it", None, 1e-6, 10.0)
    stop_m = port("m", "L, travel to either stop", None, 1e-3, 10.0)
    kb_N_m = port("N/m", "Kb, bump stop", None, 0.0, 1e9)
    cb_Ns_m = port("N s/m", "Cb, its damping", None, 0.0, 1e7)
    valve_lag_s = port("s", "Tv, servovalve", None, 1e-4, 10.0)
    spool_max_m = port("m", "xvmax, travel of the spool", None, 1e-6, 1.0)
    road_m = port("m", "za, amplitude of the road; 0 is flat", None, 0.0, 10.0)
    road_rad_s = port("rad/s", "wr, frequency of the road", None, 0.0, 1e3)
    strut = port("", "0 spring and damper, 1 hydraulic, 2 ideal force", None, 0.0, 2.0)
    limits_on = port("", "1 with bump stops", None, 0.0, 1.0)
    delay_samples = port("", "age of the command that acts, whole", 0.0, 0.0, DELAY_SIZE - 1.0)
    rate_lsb_m_s = port("m/s", "quantum of the speed samples, 0 none", 0.0, 0.0, 10.0)
    extension_lsb_m = port("m", "quantum of the extension samples, 0 none", 0.0, 0.0, 1.0)
    pressure_lsb_Pa = port("Pa", "quantum of the pressure samples, 0 none", 0.0, 0.0, 1e8)
    spool_lsb_m = port("m", "quantum of the spool samples, 0 none", 0.0, 0.0, 1.0)


class Parameters(Car):
    """What `prepare` makes of the settings."""

    substeps = port("", "Runge-Kutta steps a period")
    h = group(hydraulic.Hydraulics, "h_")


class Run(Ports):
    """What is set of a run."""

    step_s = port("s", "integration step, made to fit a period", None, 1e-7, 1e-2)
    kick_m_s = port("m/s", "speed of the body at the start", 0.0, -10.0, 10.0)


class Settings(Car, required(hydraulic.Dimensions), Run):  # type: ignore[misc]
    """What a rig gives: all dimensions too, for the plant has no strut of its own."""


class Motion(Ports):
    """What is integrated."""

    x1_m = port("m", "zs, body")
    x2_m_s = port("m/s", "zs'")
    x3_m = port("m", "zs - zu, strut")
    x4_m_s = port("m/s", "zu'")
    x5_Pa = port("Pa", "P2")
    x6_Pa = port("Pa", "P1")
    x7_m = port("m", "xv")


class States(Ports):
    """The motion, and commands on their way."""

    car = group(Motion)
    held = port("", "commands on their way", shape=DELAY_SIZE, recorded=False)
    integrator = group(scratch(Motion))


class Inputs(Ports):
    """One of them acts, as the strut has it."""

    spool_command_m = port("m", "newest valid command to the valve", 0.0)
    force_command_N = port("N", "newest valid desired force, for the ideal strut", 0.0)


class Outputs(Ports):
    """Samples and truths."""

    sample_body_rate_m_s = port("m/s", "sensor: body speed")
    sample_extension_m = port("m", "sensor: strut extension")
    sample_wheel_rate_m_s = port("m/s", "sensor: wheel speed")
    sample_p1_Pa = port("Pa", "sensor: bore side")
    sample_p2_Pa = port("Pa", "sensor: rod side")
    sample_spool_m = port("m", "sensor: valve spool")
    body_rate_m_s = port("m/s", "true body speed")
    extension_m = port("m", "true strut extension")
    wheel_rate_m_s = port("m/s", "true wheel speed")
    body_m = port("m", "body, from its place over an unloaded tyre")
    wheel_m = port("m", "wheel, likewise")
    ground_m = port("m", "road under the wheel, zr")
    p1_Pa = port("Pa", "true pressure of the bore side")
    p2_Pa = port("Pa", "true pressure of the rod side")
    spool_m = port("m", "true spool position")
    strut_N = port("N", "strut force F")
    friction_N = port("N", "strut friction Ff")
    bump_N = port("N", "bump stops Fb")
    acting = port("", "command that acted up to this sample, m or N")


@inline
def road(t: float, p: Parameters) -> float:
    """Return zr (1), m."""
    return p.road_m * sin(p.road_rad_s * t)


@inline
def friction(v3: float, p: Parameters) -> float:
    """Return Ff (2), N."""
    return p.fc_N * tanh(v3 / p.vfr_m_s)


@inline
def bump_stop(x3: float, v3: float, p: Parameters) -> float:
    """Return Fb (3), N."""
    upper = -p.kb_N_m * (x3 - p.stop_m) - p.cb_Ns_m * v3
    lower = -p.kb_N_m * (x3 + p.stop_m) - p.cb_Ns_m * v3
    down = where((x3 > p.stop_m) & (upper < 0.0), upper, 0.0)
    up = where((x3 < -p.stop_m) & (lower > 0.0), lower, 0.0)
    return p.limits_on * (down + up)


@inline
def strut_force(command: float, p: Parameters, s: Motion) -> float:
    """Return F of the chosen strut (8), N."""
    if p.strut == PASSIVE:
        return -p.ks_N_m * s.x3_m - p.bs_Ns_m * (s.x2_m_s - s.x4_m_s)
    if p.strut == IDEAL:
        return command
    return hydraulic.force(s.x6_Pa, s.x5_Pa, p.h)


@inline
def rates(t: float, p: Parameters, command: float, s: Motion, d: Motion) -> None:
    """Write the derivatives (5) to (7) at `s` to `d`."""
    x3, v3 = s.x3_m, s.x2_m_s - s.x4_m_s
    total = strut_force(command, p, s) - friction(v3, p) + bump_stop(x3, v3, p)  # (4)
    d.x1_m = s.x2_m_s
    d.x2_m_s = total / p.ms_kg - p.gravity_m_s2
    d.x3_m = v3
    d.x4_m_s = (p.kt_N_m * (road(t, p) - (s.x1_m - x3)) - total) / p.mu_kg - p.gravity_m_s2
    d.x5_Pa, d.x6_Pa, d.x7_m = 0.0, 0.0, 0.0
    if p.strut == HYDRAULIC:
        leak = hydraulic.orifice_flow(s.x6_Pa, s.x5_Pa, p.h)
        supply = hydraulic.valve_gain(s.x7_m, s.x6_Pa, p.h) * s.x7_m
        bore, rod = p.h.bore_m2, p.h.annulus_m2
        d.x5_Pa = hydraulic.stiffness_2(x3, s.x5_Pa, p.h) * (rod * v3 + leak)
        d.x6_Pa = hydraulic.stiffness_1(x3, s.x6_Pa, p.h) * (-bore * v3 - leak + supply)
        d.x7_m = (command - s.x7_m) / p.valve_lag_s  # (7)


@inline
def above_suction(pressure: float) -> float:
    """Return what a liquid under this pressure has."""
    return where(pressure < hydraulic.P_MIN_PA, hydraulic.P_MIN_PA, pressure)


@inline
def advance(t: float, h: float, command: float, p: Parameters, x: States) -> None:
    """One Runge-Kutta step from t to t + h, and the limits."""
    s = x.car
    runge_kutta(rates, t, h, p, command, s, x.integrator)
    s.x5_Pa = above_suction(s.x5_Pa)
    s.x6_Pa = above_suction(s.x6_Pa)
    s.x7_m = clip(s.x7_m, -p.spool_max_m, p.spool_max_m)


@inline
def sample(p: Parameters, s: Motion, y: Outputs) -> None:
    """Write what the sensors say."""
    y.sample_body_rate_m_s = rounded(s.x2_m_s, p.rate_lsb_m_s)
    y.sample_extension_m = rounded(s.x3_m, p.extension_lsb_m)
    y.sample_wheel_rate_m_s = rounded(s.x4_m_s, p.rate_lsb_m_s)
    y.sample_p1_Pa = rounded(s.x6_Pa, p.pressure_lsb_Pa)
    y.sample_p2_Pa = rounded(s.x5_Pa, p.pressure_lsb_Pa)
    y.sample_spool_m = rounded(s.x7_m, p.spool_lsb_m)


@inline
def show(t: float, p: Parameters, s: Motion, y: Outputs) -> None:
    """Write the truths."""
    v3 = s.x2_m_s - s.x4_m_s
    y.body_rate_m_s, y.extension_m, y.wheel_rate_m_s = s.x2_m_s, s.x3_m, s.x4_m_s
    y.body_m, y.wheel_m, y.ground_m = s.x1_m, s.x1_m - s.x3_m, road(t, p)
    y.p1_Pa, y.p2_Pa, y.spool_m = s.x6_Pa, s.x5_Pa, s.x7_m
    y.strut_N = strut_force(y.acting, p, s)
    y.friction_N = friction(v3, p)
    y.bump_N = bump_stop(s.x3_m, v3, p)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance to t, sample; see the module header."""
    if t > 0.0:
        command = u.force_command_N if p.strut == IDEAL else u.spool_command_m
        y.acting = delayed(command, p.delay_samples, x.held)
        h = dt / p.substeps
        for i in range(int(p.substeps)):
            advance(t - dt + i * h, h, y.acting, p, x)
    sample(p, x.car, y)
    show(t, p, x.car, y)


def rest(settings: Mapping[str, float]) -> float:
    """Return x3 at rest, m."""
    if settings["strut"] != PASSIVE:
        return 0.0
    weight, ks = settings["ms_kg"] * settings["gravity_m_s2"], settings["ks_N_m"]
    stop_force = weight - ks * settings["stop_m"]  # for the lower stop
    if settings["limits_on"] == 0.0 or stop_force <= 0.0:
        return -weight / ks
    return -(settings["stop_m"] + stop_force / (settings["kb_N_m"] + ks))


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters and the car at rest, but for the kick."""
    shared = {one.name: settings[one.name] for one in Car.ports}
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


BLOCK = Block(step, settings=Settings, prepare=prepare)

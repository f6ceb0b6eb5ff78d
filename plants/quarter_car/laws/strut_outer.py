"""The desired force of an active strut: a spring and damper that fade, skyhook, ride height.

    v3  = x2 - x4                         strut speed
    xb' = wb (v3 - xb)                    damping only below wb                              (1)
    xk' = wk (x3 - xk)                    spring only above wk; xk starts at x3              (2)
    Fd  = -Bs xb - Ks (x3 - xk) - Bsky x2 + Krh (x3d - x3),  Krh x3d = weight                (3)
    F   = Ac P1 - Aa P2,  ef = Fd - F     measured                                           (4)

(3) uses xb, xk from before the tick, which are then advanced exactly for an input held over it.
x3d makes mid stroke the equilibrium; without Krh, the washed-out spring lets the car drift away.
The law of this file sends Fd for a strut that can have any force, and keeps the valve closed:
nothing happens on a passive element, and a liquid strut is a spring with an orifice.

The files strut_*.py share inputs, settings, filters and

    d += (1 - exp(-T/tf)) ((s_k - s_k-1)/T - d)   filtered difference; d = 0 at the first    (5)

m, m/s, Pa, N, s; up is positive. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 6; that damping
is rolled off above and the spring below the wheel's frequency is the book's, wb = wk = sqrt(Kt/mu)
this project's.
"""

from collections.abc import Mapping

from pcpc.executive.laws.block import Block, Ports, Prepared, group, inline, port, stage
from pcpc.executive.laws.emath import exp, where
from pcpc.plants.quarter_car import equations as hydraulic


class Inputs(Ports):
    """What the sensors say."""

    body_rate_m_s = port("m/s", "measured body speed, x2")
    extension_m = port("m", "measured strut extension, x3")
    wheel_rate_m_s = port("m/s", "measured wheel speed, x4")
    p1_Pa = port("Pa", "measured pressure of the bore side")
    p2_Pa = port("Pa", "measured pressure of the rod side")
    spool_m = port("m", "measured spool position, x7")
    missing_cycles = port("", "cycles since the last measurement; 0 if it is new")


class Outputs(Ports):
    """The command and what led to it."""

    command_m = port("m", "u, to the valve")
    desired_N = port("N", "Fd (3)")
    force_N = port("N", "F (4)")
    ef_N = port("N", "ef (4)")


class Gains(Ports):
    """Springs, dampers and corners of the desired force."""

    bs_Ns_m = port("N s/m", "Bs, damper", None, 0.0, 1e6)
    ks_N_m = port("N/m", "Ks, spring", None, 0.0, 1e8)
    bsky_Ns_m = port("N s/m", "Bsky, skyhook", None, 0.0, 1e6)
    krh_N_m = port("N/m", "Krh, ride height", None, 1.0, 1e8)
    wb_rad_s = port("rad/s", "wb, damping fades above", None, 0.1, 1e3)
    wk_rad_s = port("rad/s", "wk, spring fades below", None, 0.1, 1e3)


class Settings(Gains):
    """The gains, and the car as known to the law."""

    mass_kg = port("kg", "body, as known to the law", 290.0, 1.0, 1e5)
    gravity_m_s2 = port("m/s2", "g", 9.81, 0.0, 100.0)
    dimensions = group(hydraulic.Dimensions)


class Parameters(Gains):
    """The gains, and what follows from the car."""

    weight_N = port("N", "Krh x3d, static load of the strut")
    h = group(hydraulic.Hydraulics, "h_")


class States(Ports):
    """The filters."""

    xb_m_s = port("m/s", "xb (1)")
    xk_m = port("m", "xk (2)")
    started = port("", "1 after the first tick")


def _weight(settings: Mapping[str, float]) -> float:
    return settings["mass_kg"] * settings["gravity_m_s2"]


def known_parameters(settings: Mapping[str, float]) -> dict[str, float]:
    """Return Parameters by name."""
    gains = {one.name: settings[one.name] for one in Gains.ports}
    weight = _weight(settings)
    return {**gains, "weight_N": weight, **hydraulic.hydraulics(settings, weight)}


def known_gain(settings: Mapping[str, float]) -> float:
    """Return G of equations.py at rest, N/(m s)."""
    return hydraulic.nominal_gain(settings, _weight(settings))


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters."""
    return Prepared(known_parameters(settings))


@inline
def desired_force(p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Write Fd (3), F and ef (4); xk starts at x3 (2)."""
    x3 = u.extension_m
    x.xk_m = where(x.started > 0.5, x.xk_m, x3)
    fading = -p.bs_Ns_m * x.xb_m_s - p.ks_N_m * (x3 - x.xk_m)
    y.desired_N = fading - p.bsky_Ns_m * u.body_rate_m_s + (p.weight_N - p.krh_N_m * x3)  # (3)
    y.force_N = hydraulic.force(u.p1_Pa, u.p2_Pa, p.h)
    y.ef_N = y.desired_N - y.force_N  # (4)


@inline
def advance(dt: float, p: Parameters, x: States, u: Inputs) -> None:
    """Advance (1) and (2), at the end of a tick."""
    v3 = u.body_rate_m_s - u.wheel_rate_m_s
    x.xb_m_s += (1.0 - exp(-p.wb_rad_s * dt)) * (v3 - x.xb_m_s)
    x.xk_m += (1.0 - exp(-p.wk_rad_s * dt)) * (u.extension_m - x.xk_m)
    x.started = 1.0


@inline
def difference(s: float, last: float, d: float, started: float, tf: float, dt: float) -> float:
    """Return the new d of (5) for the sample `s`, from `last` = s_k-1 and the old d."""
    before = where(started > 0.5, last, s)
    return d + (1.0 - exp(-dt / tf)) * ((s - before) / dt - d)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    desired_force(p, x, u, y)
    y.command_m = 0.0
    advance(dt, p, x, u)


BLOCK = Block(step, settings=Settings, prepare=prepare)

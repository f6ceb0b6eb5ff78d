"""A two-chamber liquid strut with a servovalve, as its plant and its controllers know it.

    F   = Ac P1 - Aa P2,  Aa = Ac - Ar       up on the body; x3 > 0, v3 > 0: strut extends   (1)
    V1  = V0 + Ac x3,  V2 = V0 - Aa x3       each at least V0/20                             (2)
    B   = B0 + b1 max(P, Pmin)               bulk modulus of a compressible liquid           (3)
    QL  = Co dp/(dp^2 + eq^2)^(1/4)          orifice, chamber 1 to 2; dp = P1 - P2           (4)
    psi = max(Pa/2 + sat(xv/ev) (Pa/2 - P1), 1e4)   pressure across the open edge            (5)
    Q   = Cv sqrt(psi) xv                    into chamber 1; xv < 0 drains it                (6)
    P1' = B1/V1 (-Ac v3 - QL + Q),  P2' = B2/V2 (Aa v3 + QL)                                 (7)
    F'  = f + G xv,  G = Ac B1/V1 Cv sqrt(psi)                                               (8)
    f   = Ac B1/V1 (-Ac v3 - QL) - Aa B2/V2 (Aa v3 + QL)                                     (9)

    Co = Cd Ao sqrt(2/rho),  Cv = Cd w sqrt(2/rho),  P0 = weight/Ar (static, P1 = P2)       (10)
    Pa = 2 P0,  V0 = B(P0) Ar^2/(2 K)        K: spring rate with the valve closed           (11)

Chamber 1 is the bore side, which shrinks when the strut does; the accumulator holds Pa. (4) to (6)
are smoothed at zero: a square-root orifice is infinitely stiff there. Pa, m3/s, m, N, kg/m3.
`h` has the ports of Hydraulics. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 6;
the printed force formula is lost: (1) is the force balance. That fluid flows between accumulator
and strut in both directions, as the book says, needs the three-way valve (5).
"""

import math
from collections.abc import Mapping

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import clip, sqrt, where
from pcpc.executive.laws.ports import Ports, port

P_MIN_PA = 1e5  # one atmosphere: no suction
DP_SMOOTH_PA = 1e5
SPOOL_SMOOTH_M = 1e-5
PSI_MIN_PA = 1e4
VOLUME_FLOOR = 0.05  # of V0: a chamber never vanishes


class Dimensions(Ports):
    """What the strut is built of, as its controllers know it."""

    ac_m2 = port("m2", "Ac, bore area", 5.0e-4, 1e-6, 1.0)
    ar_m2 = port("m2", "Ar, rod area", 1.5e-4, 1e-7, 1.0)
    ao_m2 = port("m2", "Ao, damping orifice", 9.6e-6, 0.0, 1.0)
    fluid_kg_m3 = port("kg/m3", "rho, density of the fluid", 900.0, 1.0, 1e4)
    discharge = port("", "Cd, of orifice and valve", 0.6, 0.0, 1.0)
    port_width_m = port("m", "w, width of the valve's ports", 0.02, 0.0, 1.0)
    bulk_Pa = port("Pa", "B0, bulk modulus at no pressure", 0.80e9, 1e6, 1e12)
    bulk_slope = port("", "b1, its rise with pressure", 10.0, 0.0, 100.0)
    liquid_rate_N_m = port("N/m", "K, spring rate with the valve closed", 16812.0, 1.0, 1e9)


class Hydraulics(Ports):
    """What the equations take of them; in a block, `h = group(Hydraulics, "h_")`."""

    bore_m2 = port("m2", "Ac")
    annulus_m2 = port("m2", "Aa")
    orifice = port("m3/(s Pa0.5)", "Co (10)")
    valve = port("m2/(s Pa0.5)", "Cv (10)")
    bulk_Pa = port("Pa", "B0")
    bulk_slope = port("", "b1")
    supply_Pa = port("Pa", "Pa (11)")
    volume_m3 = port("m3", "V0 (11)")


def static_pressure(settings: Mapping[str, float], weight_N: float) -> float:
    """Return P0 of (10), Pa."""
    return weight_N / settings["ar_m2"]


def hydraulics(settings: Mapping[str, float], weight_N: float) -> dict[str, float]:
    """Return Hydraulics by name, h_ before it, from Dimensions in `settings`: (10) (11)."""
    ac, ar = settings["ac_m2"], settings["ar_m2"]
    p0 = static_pressure(settings, weight_N)
    jet = settings["discharge"] * math.sqrt(2.0 / settings["fluid_kg_m3"])
    bulk_0 = settings["bulk_Pa"] + settings["bulk_slope"] * max(p0, P_MIN_PA)
    return {
        "h_bore_m2": ac,
        "h_annulus_m2": ac - ar,
        "h_orifice": jet * settings["ao_m2"],
        "h_valve": jet * settings["port_width_m"],
        "h_bulk_Pa": settings["bulk_Pa"],
        "h_bulk_slope": settings["bulk_slope"],
        "h_supply_Pa": 2.0 * p0,
        "h_volume_m3": bulk_0 * ar * ar / settings["liquid_rate_N_m"] / 2.0,
    }


def nominal_gain(settings: Mapping[str, float], weight_N: float) -> float:
    """Return G of (8) at x3 = 0, P1 = P0 and a closed valve, N/(m s)."""
    h = hydraulics(settings, weight_N)
    p0 = static_pressure(settings, weight_N)
    bulk_0 = h["h_bulk_Pa"] + h["h_bulk_slope"] * p0
    opening = h["h_valve"] * math.sqrt(0.5 * h["h_supply_Pa"])
    return h["h_bore_m2"] * bulk_0 / h["h_volume_m3"] * opening


@inline
def force(p1: float, p2: float, h: Hydraulics) -> float:
    """Return F (1), N."""
    return h.bore_m2 * p1 - h.annulus_m2 * p2


@inline
def stiffness(volume: float, pressure: float, h: Hydraulics) -> float:
    """Return B/V of a chamber by (2) (3), Pa/m3."""
    least = VOLUME_FLOOR * h.volume_m3
    bulk = h.bulk_Pa + h.bulk_slope * where(pressure > P_MIN_PA, pressure, P_MIN_PA)
    return bulk / where(volume > least, volume, least)


@inline
def stiffness_1(x3: float, p1: float, h: Hydraulics) -> float:
    """Return B1/V1 by (2) (3), Pa/m3."""
    return stiffness(h.volume_m3 + h.bore_m2 * x3, p1, h)


@inline
def stiffness_2(x3: float, p2: float, h: Hydraulics) -> float:
    """Return B2/V2 by (2) (3), Pa/m3."""
    return stiffness(h.volume_m3 - h.annulus_m2 * x3, p2, h)


@inline
def orifice_flow(p1: float, p2: float, h: Hydraulics) -> float:
    """Return QL (4), m3/s."""
    dp = p1 - p2
    return h.orifice * dp / sqrt(sqrt(dp * dp + DP_SMOOTH_PA * DP_SMOOTH_PA))


@inline
def valve_gain(xv: float, p1: float, h: Hydraulics) -> float:
    """Return Q/xv by (5) (6), m2/s."""
    half = 0.5 * h.supply_Pa
    psi = half + clip(xv / SPOOL_SMOOTH_M, -1.0, 1.0) * (half - p1)
    return h.valve * sqrt(where(psi > PSI_MIN_PA, psi, PSI_MIN_PA))


@inline
def input_gain(x3: float, p1: float, xv: float, h: Hydraulics) -> float:
    """Return G (8), N/(m s); of `xv` only the sign counts, beyond the smoothing."""
    return h.bore_m2 * stiffness_1(x3, p1, h) * valve_gain(xv, p1, h)


@inline
def drift(x3: float, v3: float, p1: float, p2: float, h: Hydraulics) -> float:
    """Return f (9), N/s."""
    leak = orifice_flow(p1, p2, h)
    bore = h.bore_m2 * stiffness_1(x3, p1, h) * (-h.bore_m2 * v3 - leak)
    return bore - h.annulus_m2 * stiffness_2(x3, p2, h) * (h.annulus_m2 * v3 + leak)

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
from typing import Any

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.emath import exp, where
from pcpc.executive.laws.models import hydraulic_strut as hydraulic

INPUTS = (
    Port("body_m_s", "m/s", "measured body speed, x2"),
    Port("extension_m", "m", "measured strut extension, x3"),
    Port("wheel_m_s", "m/s", "measured wheel speed, x4"),
    Port("p1_Pa", "Pa", "measured pressure of the bore side"),
    Port("p2_Pa", "Pa", "measured pressure of the rod side"),
    Port("spool_m", "m", "measured spool position, x7"),
    Port("missing_cycles", "", "cycles since the last measurement; 0 if it is new"),
)
OUTPUTS = (
    Port("command_m", "m", "u, to the valve"),
    Port("desired_N", "N", "Fd (3)"),
    Port("force_N", "N", "F (4)"),
    Port("ef_N", "N", "ef (4)"),
)
GAINS = (
    Port("bs_Ns_m", "N s/m", "Bs, damper", None, 0.0, 1e6),
    Port("ks_N_m", "N/m", "Ks, spring", None, 0.0, 1e8),
    Port("bsky_Ns_m", "N s/m", "Bsky, skyhook", None, 0.0, 1e6),
    Port("krh_N_m", "N/m", "Krh, ride height", None, 1.0, 1e8),
    Port("wb_rad_s", "rad/s", "wb, damping fades above", None, 0.1, 1e3),
    Port("wk_rad_s", "rad/s", "wk, spring fades below", None, 0.1, 1e3),
)
_LOAD = (
    Port("mass_kg", "kg", "body, as known to the law", 290.0, 1.0, 1e5),
    Port("gravity_m_s2", "m/s2", "g", 9.81, 0.0, 100.0),
)
SETTINGS = (*GAINS, *_LOAD, *(Port(*row) for row in hydraulic.DIMENSIONS))
PARAMETERS = (
    *GAINS,
    Port("weight_N", "N", "Krh x3d, static load of the strut"),
    *(Port(*row) for row in hydraulic.HYDRAULICS),
)
STATES = (
    Port("xb_m_s", "m/s", "xb (1)"),
    Port("xk_m", "m", "xk (2)"),
    Port("started", "", "1 after the first tick"),
)
(BS, KS, BSKY, KRH, WB, WK, WEIGHT, H) = range(8)
(XB, XK, STARTED) = range(len(STATES))
SIZE_P, SIZE_X = len(PARAMETERS), len(STATES)
(X2, X3, X4, P1, P2, X7, MISSING) = range(len(INPUTS))


def known(settings: Mapping[str, float]) -> dict[str, float]:
    """Return PARAMETERS by name."""
    weight = settings["mass_kg"] * settings["gravity_m_s2"]
    gains = {port.name: settings[port.name] for port in GAINS}
    return {**gains, "weight_N": weight, **hydraulic.hydraulics(settings, weight)}


def known_gain(settings: Mapping[str, float]) -> float:
    """Return G of hydraulic_strut.py at rest, N/(m s)."""
    return hydraulic.nominal_gain(settings, settings["mass_kg"] * settings["gravity_m_s2"])


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters."""
    return Prepared(known(settings))


@inline
def desired_force(p: Any, x: Any, u: Any, y: Any) -> float:
    """Return ef, write OUTPUTS but the command; `p`, `x` begin with PARAMETERS, STATES."""
    x3 = u[X3]
    x[XK] = where(x[STARTED] > 0.5, x[XK], x3)
    fading = -p[BS] * x[XB] - p[KS] * (x3 - x[XK])
    y[1] = fading - p[BSKY] * u[X2] + (p[WEIGHT] - p[KRH] * x3)  # (3)
    y[2] = hydraulic.force(u[P1], u[P2], tail(p, H))
    y[3] = y[1] - y[2]  # (4)
    return y[1] - y[2]


@inline
def advance(dt: float, p: Any, x: Any, u: Any) -> None:
    """Advance (1) and (2), at the end of a tick."""
    x[XB] = x[XB] + (1.0 - exp(-p[WB] * dt)) * (u[X2] - u[X4] - x[XB])
    x[XK] = x[XK] + (1.0 - exp(-p[WK] * dt)) * (u[X3] - x[XK])
    x[STARTED] = 1.0


@inline
def difference(s: float, dt: float, tf: float, started: float, x: Any, at: int) -> float:
    """Return d of (5) for the sample `s`; x[at], x[at + 1] hold s_k-1 and d."""
    last = where(started > 0.5, x[at], s)
    x[at + 1] = x[at + 1] + (1.0 - exp(-dt / tf)) * ((s - last) / dt - x[at + 1])
    x[at] = s
    return x[at + 1]


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    desired_force(p, x, u, y)
    y[0] = 0.0
    advance(dt, p, x, u)


BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    states=STATES,
    settings=SETTINGS,
    prepare=prepare,
)

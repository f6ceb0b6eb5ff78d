"""Fuzzy backstepping force control of a liquid strut with a slow servovalve.

    F'  = G (xv - H),  H = -f/G           f: unknown drift; G: known, hydraulic_strut.py     (1)
    Hh  = Th'm(X)                         fuzzy system (8)                                   (2)
    x7d = sat(Hh + (Fd' + k1 ef)/G, xvmax)                wanted spool position              (3)
    u   = sat(x7 + Tv (x7d' + lam e), 3 xvmax),  e = x7d - x7                                (4)
    ef' = -k1 ef + G (H - Hh) + G e,  e' = -lam e         closed loop, nothing saturated     (5)
    Th' = Gam (m G ef - kap |G ef| Th)    e-modification; explicit Euler, Th(0) = 0          (6)
    Gam = (w_a/G0)^2                      w_a: natural frequency of (5) with (6) at G0       (7)

    m_i = mu_i/sum mu,  mu: product of Gaussians exp(-(X - c)^2/(2 s^2)),
    X   = (x3/0.1 m, v3/2 m/s, (P1 - P2)/10 MPa) each clipped to +-1.2; centres evenly on
          [-1, 1], 3 x 7 x 7 of them; s = 0.5, 0.2, 0.2                                      (8)

Fd, ef and the filtered differences Fd', x7d' are those of strut_outer.py; psi in G takes the sign
of x7d of the tick before (0 at the first). (2) uses Th from before the tick. With Th~ = Th* - Th,
G (H - Hh) = G (Th~'m + eps):

    L   = ef^2/2 + Th~'Gam^-1 Th~/2 + c e^2/2
    L'  = -k1 ef^2 + G ef e - c lam e^2 + kap |G ef| Th~'Th + G ef eps                       (9)

for any c > 0: uniformly ultimately bounded by completing squares, for any k1, lam > 0.

`fl_on` 0: Hh = 0 and Th rests, the same law without a fuzzy system. `exact_drift` 1: Hh = -f/G
computed from all that the plant knows, which no real law could. m, N, Pa, s. Source: Lewis, Campos,
Selmic (SIAM 2002), chapter 6; rules and gains are this project's.
"""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.controllers.strut import strut_outer as outer
from pcpc.executive.laws.emath import clip, expmsq, sqrt, where
from pcpc.executive.laws.models import hydraulic_strut as hydraulic

SQRT_2 = 1.4142135623730951
RANGE = 1.2  # of the scaled inputs
SCALES = (0.1, 2.0, 10e6)  # m, m/s, Pa
COUNTS = (3, 7, 7)
WIDTHS = (0.5, 0.2, 0.2)
RULES = COUNTS[0] * COUNTS[1] * COUNTS[2]
SCRATCH = sum(COUNTS) + RULES

_OWN = (
    Port("tf_s", "s", "tf, filter of the differences", None, 1e-4, 1.0),
    Port("spool_max_m", "m", "xvmax, travel of the spool", None, 1e-6, 1.0),
    Port("valve_lag_s", "s", "Tv, servovalve, as known to the law", None, 1e-4, 10.0),
    Port("k1_per_s", "1/s", "k1, force loop", None, 0.0, 1e4),
    Port("lam_per_s", "1/s", "lam, spool loop", None, 0.0, 1e4),
    Port("kap_per_m", "1/m", "kap, e-modification", None, 0.0, 1e5),
    Port("fl_on", "", "1 with the fuzzy system, 0 without", 1.0, 0.0, 1.0),
    Port("exact_drift", "", "1 replaces it by the true drift", 0.0, 0.0, 1.0),
)
SETTINGS = (
    *outer.SETTINGS,
    *_OWN,
    Port("adaptation_rad_s", "rad/s", "w_a (7)", None, 0.0, 1e3),
)
PARAMETERS = (
    *outer.PARAMETERS,
    *_OWN,
    Port("gam_m2_N2", "m2/N2", "Gam (7)", None, 0.0, 1.0),
)
STATES = (
    *outer.STATES,
    Port("last_desired_N", "N", "Fd of the last tick"),
    Port("desired_rate_N_s", "N/s", "Fd', filtered difference"),
    Port("last_spool_m", "m", "x7d of the last tick"),
    Port("wanted_rate_m_s", "m/s", "x7d', filtered difference"),
    Port("theta", "m", "Th, consequents of the rules", size=RULES, recorded=False),
    Port("scratch", "", "memberships, m", size=SCRATCH, recorded=False),
)
OUTPUTS = (
    *outer.OUTPUTS,
    Port("wanted_spool_m", "m", "x7d (3)"),
    Port("drift_m", "m", "Hh (2)"),
    Port("norm_theta_m", "m", "Euclidean norm of Th"),
    Port("largest_theta_m", "m", "largest magnitude in Th"),
)
(TF, SPOOL_MAX, LAG, K1, LAM, KAP, FL_ON, EXACT, GAM) = range(outer.SIZE_P, outer.SIZE_P + 9)
(LAST_FD, FD_RATE, LAST_SPOOL, SPOOL_RATE, THETA) = range(outer.SIZE_X, outer.SIZE_X + 5)
MEMBERS = THETA + RULES
FIRED = MEMBERS + sum(COUNTS)


@inline
def memberships(value: float, count: int, width: float, out: Any, at: int) -> None:
    """Write the normalised memberships (8) of one scaled input to out[at..at + count - 1]."""
    clipped, total = clip(value, -RANGE, RANGE), 0.0
    for i in range(count):
        centre = 2.0 * i / (count - 1.0) - 1.0
        out[at + i] = expmsq((clipped - centre) / (SQRT_2 * width))
        total += out[at + i]
    for i in range(count):
        out[at + i] = out[at + i] / total


@inline
def fire(x3: float, v3: float, dp: float, members: Any, fired: Any) -> None:
    """Write m(X) of (8) to `fired`; the sum of products is the product of the sums."""
    n0, n1, n2 = COUNTS
    memberships(x3 / SCALES[0], n0, WIDTHS[0], members, 0)
    memberships(v3 / SCALES[1], n1, WIDTHS[1], members, n0)
    memberships(dp / SCALES[2], n2, WIDTHS[2], members, n0 + n1)
    for i in range(n0):
        for j in range(n1):
            both = members[i] * members[n0 + j]
            for k in range(n2):
                fired[(i * n1 + j) * n2 + k] = both * members[n0 + n1 + k]


@inline
def tune(dt: float, drive: float, p: Any, theta: Any, fired: Any, y: Any) -> None:
    """Advance (6) by `dt` under `drive` = G ef; write norm and largest entry from before."""
    squares, largest = 0.0, 0.0
    for i in range(RULES):
        old = theta[i]
        squares += old * old
        largest = where(abs(old) > largest, abs(old), largest)
        theta[i] = old + dt * p[GAM] * (fired[i] * drive - p[KAP] * abs(drive) * old)
    y[6] = sqrt(squares)
    y[7] = largest


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    theta, fired, h = tail(x, THETA), tail(x, FIRED), tail(p, outer.H)
    x3, v3, p1, p2 = u[outer.X3], u[outer.X2] - u[outer.X4], u[outer.P1], u[outer.P2]
    ef = outer.desired_force(p, x, u, y)
    started = x[outer.STARTED]
    fd_rate = outer.difference(y[1], dt, p[TF], started, tail(x, LAST_FD), 0)
    gain = hydraulic.input_gain(x3, p1, x[LAST_SPOOL], h)  # (1)

    fire(x3, v3, p1 - p2, tail(x, MEMBERS), fired)
    learned = 0.0
    for i in range(RULES):
        learned += theta[i] * fired[i]
    true = -hydraulic.drift(x3, v3, p1, p2, h) / gain
    y[5] = where(p[EXACT] > 0.5, true, where(p[FL_ON] > 0.5, learned, 0.0))  # (2)
    y[4] = clip(y[5] + (fd_rate + p[K1] * ef) / gain, -p[SPOOL_MAX], p[SPOOL_MAX])  # (3)
    rate = outer.difference(y[4], dt, p[TF], started, tail(x, LAST_SPOOL), 0)
    x7 = u[outer.X7]
    command = x7 + p[LAG] * (rate + p[LAM] * (y[4] - x7))
    y[0] = clip(command, -3.0 * p[SPOOL_MAX], 3.0 * p[SPOOL_MAX])  # (4)

    learns = (p[FL_ON] > 0.5) & (p[EXACT] < 0.5) & (u[outer.MISSING] < 0.5)
    tune(where(learns, dt, 0.0), gain * ef, p, theta, fired, y)
    outer.advance(dt, p, x, u)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters, with the tuning rate (7)."""
    own = {port.name: settings[port.name] for port in _OWN}
    root = settings["adaptation_rad_s"] / outer.known_gain(settings)
    return Prepared({**outer.known(settings), **own, "gam_m2_N2": root * root})


BLOCK = Block(
    step,
    inputs=outer.INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    states=STATES,
    settings=SETTINGS,
    prepare=prepare,
)

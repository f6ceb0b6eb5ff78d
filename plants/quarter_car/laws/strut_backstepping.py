"""Fuzzy backstepping force control of a liquid strut with a slow servovalve.

    F'  = G (xv - H),  H = -f/G           f: unknown drift; G: known, equations.py           (1)
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

from pcpc.executive.laws.block import Array, Block, Ports, Prepared, inline, port, stage
from pcpc.executive.laws.emath import clip, expmsq, sqrt, where
from pcpc.plants.quarter_car import equations as hydraulic
from pcpc.plants.quarter_car.laws import strut_outer as outer

SQRT_2 = 1.4142135623730951
RANGE = 1.2  # of the scaled inputs
EXTENSION_M, SPEED_M_S, PRESSURE_PA = 0.1, 2.0, 10e6  # what scales them
EXTENSIONS, SPEEDS, PRESSURES = 3, 7, 7  # centres
EXTENSION_WIDTH, SPEED_WIDTH, PRESSURE_WIDTH = 0.5, 0.2, 0.2
RULES = EXTENSIONS * SPEEDS * PRESSURES


class Own(Ports):
    """Filter, limits, loops and the fuzzy system."""

    tf_s = port("s", "tf, filter of the differences", None, 1e-4, 1.0)
    spool_max_m = port("m", "xvmax, travel of the spool", None, 1e-6, 1.0)
    valve_lag_s = port("s", "Tv, servovalve, as known to the law", None, 1e-4, 10.0)
    k1_per_s = port("1/s", "k1, force loop", None, 0.0, 1e4)
    lam_per_s = port("1/s", "lam, spool loop", None, 0.0, 1e4)
    kap_per_m = port("1/m", "kap, e-modification", None, 0.0, 1e5)
    fl_on = port("", "1 with the fuzzy system, 0 without", 1.0, 0.0, 1.0)
    exact_drift = port("", "1 replaces it by the true drift", 0.0, 0.0, 1.0)


class Settings(outer.Settings, Own):
    """Those of the desired force, its own, and the speed of learning."""

    adaptation_rad_s = port("rad/s", "w_a (7)", None, 0.0, 1e4)


class Parameters(outer.Parameters, Own):
    """Those of the desired force, its own, and the tuning rate."""

    gam_m2_N2 = port("m2/N2", "Gam (7)", None, 0.0, 1.0)


class States(outer.States):
    """The filters and the fuzzy system."""

    last_desired_N = port("N", "Fd of the last tick")
    desired_rate_N_s = port("N/s", "Fd', filtered difference")
    last_spool_m = port("m", "x7d of the last tick")
    wanted_rate_m_s = port("m/s", "x7d', filtered difference")
    theta = port("m", "Th, consequents of the rules", shape=RULES, recorded=False, adapts=True)
    at_extension = port("", "memberships of x3", shape=EXTENSIONS, recorded=False)
    at_speed = port("", "memberships of v3", shape=SPEEDS, recorded=False)
    at_pressure = port("", "memberships of P1 - P2", shape=PRESSURES, recorded=False)
    fired = port("", "m", shape=RULES, recorded=False)


class Outputs(outer.Outputs):
    """Those of the desired force, the wanted spool and what was learned."""

    wanted_spool_m = port("m", "x7d (3)")
    drift_m = port("m", "Hh (2)")
    norm_theta_m = port("m", "Euclidean norm of Th")
    largest_theta_m = port("m", "largest magnitude in Th")


@inline
def memberships(value: float, width: float, mu: Array) -> None:
    """Write the normalised memberships (8) of one scaled input to `mu` (sets,)."""
    clipped, total = clip(value, -RANGE, RANGE), 0.0
    for i in range(len(mu)):
        centre = 2.0 * i / (len(mu) - 1.0) - 1.0
        mu[i] = expmsq((clipped - centre) / (SQRT_2 * width))
        total += mu[i]
    for i in range(len(mu)):
        mu[i] = mu[i] / total


@inline
def fire_rules(x3: float, v3: float, dp: float, x: States) -> None:
    """Write m(X) of (8); the sum of products is the product of the sums."""
    memberships(x3 / EXTENSION_M, EXTENSION_WIDTH, x.at_extension)
    memberships(v3 / SPEED_M_S, SPEED_WIDTH, x.at_speed)
    memberships(dp / PRESSURE_PA, PRESSURE_WIDTH, x.at_pressure)
    rule = 0
    for i in range(EXTENSIONS):
        for j in range(SPEEDS):
            both = x.at_extension[i] * x.at_speed[j]
            for k in range(PRESSURES):
                x.fired[rule] = both * x.at_pressure[k]
                rule += 1


@inline
def learned_drift(x: States) -> float:
    """Return Th'm (2)."""
    total = 0.0
    for i in range(RULES):
        total += x.theta[i] * x.fired[i]
    return total


@inline
def tune(dt: float, drive: float, p: Parameters, x: States, y: Outputs) -> None:
    """Advance (6) by `dt` under `drive` = G ef; write norm and largest entry from before."""
    squares, largest = 0.0, 0.0
    for i in range(RULES):
        old = x.theta[i]
        squares += old * old
        largest = where(abs(old) > largest, abs(old), largest)
        x.theta[i] = old + dt * p.gam_m2_N2 * (x.fired[i] * drive - p.kap_per_m * abs(drive) * old)
    y.norm_theta_m = sqrt(squares)
    y.largest_theta_m = largest


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: outer.Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    x3, v3, x7 = u.extension_m, u.body_rate_m_s - u.wheel_rate_m_s, u.spool_m
    outer.desired_force(p, x, u, y)
    fd, ef = y.desired_N, y.ef_N
    fd_rate = outer.difference(fd, x.last_desired_N, x.desired_rate_N_s, x.started, p.tf_s, dt)
    x.last_desired_N, x.desired_rate_N_s = fd, fd_rate
    gain = hydraulic.input_gain(x3, u.p1_Pa, x.last_spool_m, p.h)  # (1)

    fire_rules(x3, v3, u.p1_Pa - u.p2_Pa, x)
    true = -hydraulic.drift(x3, v3, u.p1_Pa, u.p2_Pa, p.h) / gain
    adaptive = where(p.fl_on > 0.5, learned_drift(x), 0.0)
    y.drift_m = where(p.exact_drift > 0.5, true, adaptive)  # (2)
    wanted = y.drift_m + (fd_rate + p.k1_per_s * ef) / gain
    x7d = clip(wanted, -p.spool_max_m, p.spool_max_m)  # (3)
    x7d_rate = outer.difference(x7d, x.last_spool_m, x.wanted_rate_m_s, x.started, p.tf_s, dt)
    x.last_spool_m, x.wanted_rate_m_s = x7d, x7d_rate
    command = x7 + p.valve_lag_s * (x7d_rate + p.lam_per_s * (x7d - x7))
    y.wanted_spool_m = x7d
    y.command_m = clip(command, -3.0 * p.spool_max_m, 3.0 * p.spool_max_m)  # (4)

    learns = (p.fl_on > 0.5) & (p.exact_drift < 0.5) & (u.missing_cycles < 0.5)
    tune(where(learns, dt, 0.0), gain * ef, p, x, y)  # (6)
    outer.advance(dt, p, x, u)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters, with the tuning rate (7)."""
    own = {one.name: settings[one.name] for one in Own.ports}
    root = settings["adaptation_rad_s"] / outer.known_gain(settings)
    return Prepared({**outer.known_parameters(settings), **own, "gam_m2_N2": root * root})


BLOCK = Block(step, settings=Settings, prepare=prepare)

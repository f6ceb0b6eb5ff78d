"""PID force control of a liquid strut that takes the valve for ideal: the comparison.

    u = sat(kp ef + ki I + kd d, xvmax)      d: filtered difference of ef                    (1)
    I' = ef                                  only while u is not at its limit                (2)
    kp = g/G0,  ki = i kp,  kd = t kp        G0: gain from spool to force rate at rest       (3)

ef and the difference are those of strut_outer.py; (1) uses I from before the tick. The lag of the
valve is ignored, which is what makes this law naive. m, N, s; up is positive. Source: Lewis,
Campos, Selmic (SIAM 2002), chapter 6; the gains are this project's, high enough to excite the mode
of the valve.
"""

from collections.abc import Mapping

from pcpc.executive.laws.block import Block, Ports, Prepared, port, stage
from pcpc.executive.laws.emath import clip, where
from pcpc.plants.quarter_car.laws import strut_outer as outer


class Own(Ports):
    """Filter and limit."""

    tf_s = port("s", "tf, filter of the difference", None, 1e-4, 1.0)
    spool_max_m = port("m", "xvmax, largest command", None, 1e-6, 1.0)


class Settings(outer.Settings, Own):
    """Those of the desired force, and the gains as (3) has them."""

    gain_per_s = port("1/s", "g: kp G0", None, 0.0, 1e5)
    integral_per_s = port("1/s", "i: ki/kp", None, 0.0, 1e5)
    derivative_s = port("s", "t: kd/kp", None, 0.0, 1.0)


class Parameters(outer.Parameters, Own):
    """Those of the desired force, and the gains as (1) has them."""

    kp_m_N = port("m/N", "kp (3)", None, 0.0, 1.0)
    ki_m_Ns = port("m/(N s)", "ki (3)", None, 0.0, 1.0)
    kd_ms_N = port("m s/N", "kd (3)", None, 0.0, 1.0)


class States(outer.States):
    """The filters and the integral."""

    last_N = port("N", "ef of the last tick")
    ef_rate_N_s = port("N/s", "d, filtered difference of ef")
    integral_Ns = port("N s", "I (2)", adapts=True)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: outer.Inputs, y: outer.Outputs) -> None:
    """One control period; see the module header."""
    outer.desired_force(p, x, u, y)
    ef = y.ef_N
    x.ef_rate_N_s = outer.difference(ef, x.last_N, x.ef_rate_N_s, x.started, p.tf_s, dt)
    x.last_N = ef
    wanted = p.kp_m_N * ef + p.ki_m_Ns * x.integral_Ns + p.kd_ms_N * x.ef_rate_N_s
    y.command_m = clip(wanted, -p.spool_max_m, p.spool_max_m)  # (1)
    free = (y.command_m == wanted) & (u.missing_cycles < 0.5)
    x.integral_Ns += where(free, dt * ef, 0.0)  # (2)
    outer.advance(dt, p, x, u)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters, with the gains (3)."""
    kp = settings["gain_per_s"] / outer.known_gain(settings)
    gains = {
        "kp_m_N": kp,
        "ki_m_Ns": settings["integral_per_s"] * kp,
        "kd_ms_N": settings["derivative_s"] * kp,
    }
    own = {one.name: settings[one.name] for one in Own.ports}
    return Prepared({**outer.known_parameters(settings), **own, **gains})


BLOCK = Block(step, settings=Settings, prepare=prepare)

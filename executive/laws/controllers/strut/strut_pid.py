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
from typing import Any

from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.controllers.strut import strut_outer as outer
from pcpc.executive.laws.emath import clip, where

_OWN = (
    Port("tf_s", "s", "tf, filter of the difference", None, 1e-4, 1.0),
    Port("spool_max_m", "m", "xvmax, largest command", None, 1e-6, 1.0),
)
SETTINGS = (
    *outer.SETTINGS,
    *_OWN,
    Port("gain_per_s", "1/s", "g: kp G0", None, 0.0, 1e5),
    Port("integral_per_s", "1/s", "i: ki/kp", None, 0.0, 1e5),
    Port("derivative_s", "s", "t: kd/kp", None, 0.0, 1.0),
)
PARAMETERS = (
    *outer.PARAMETERS,
    *_OWN,
    Port("kp_m_N", "m/N", "kp (3)", None, 0.0, 1.0),
    Port("ki_m_Ns", "m/(N s)", "ki (3)", None, 0.0, 1.0),
    Port("kd_ms_N", "m s/N", "kd (3)", None, 0.0, 1.0),
)
STATES = (
    *outer.STATES,
    Port("last_N", "N", "ef of the last tick"),
    Port("ef_rate_N_s", "N/s", "d, filtered difference of ef"),
    Port("integral_Ns", "N s", "I (2)"),
)
(TF, SPOOL_MAX, KP, KI, KD) = range(outer.SIZE_P, outer.SIZE_P + 5)
(LAST, RATE, INTEGRAL) = range(outer.SIZE_X, outer.SIZE_X + 3)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    ef = outer.desired_force(p, x, u, y)
    rate = outer.difference(ef, dt, p[TF], x[outer.STARTED], tail(x, LAST), 0)
    wanted = p[KP] * ef + p[KI] * x[INTEGRAL] + p[KD] * rate
    y[0] = clip(wanted, -p[SPOOL_MAX], p[SPOOL_MAX])  # (1)
    free = (y[0] == wanted) & (u[outer.MISSING] < 0.5)
    x[INTEGRAL] = x[INTEGRAL] + where(free, dt * ef, 0.0)  # (2)
    outer.advance(dt, p, x, u)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters, with the gains (3)."""
    kp = settings["gain_per_s"] / outer.known_gain(settings)
    gains = {
        "kp_m_N": kp,
        "ki_m_Ns": settings["integral_per_s"] * kp,
        "kd_ms_N": settings["derivative_s"] * kp,
    }
    own = {port.name: settings[port.name] for port in _OWN}
    return Prepared({**outer.known(settings), **own, **gains})


BLOCK = Block(
    step,
    inputs=outer.INPUTS,
    outputs=outer.OUTPUTS,
    parameters=PARAMETERS,
    states=STATES,
    settings=SETTINGS,
    prepare=prepare,
)

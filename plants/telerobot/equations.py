"""A joint as a pair of equal poles, sampled exactly: the model that predictor and identifier share.

    x' = As x + B u,  As = [[0, 1], [A21, A22]],  A21 = -a^2,  A22 = -2 a,  a = 5 1/s        (1)
    x+ = Ad x + Bd u,  Ad = e^(-a h) [[1 + a h, h], [-a^2 h, 1 - a h]]                       (2)
    Bd = [(1 - e^(-a h) (1 + a h))/a^2; h e^(-a h)],  zero-order hold over h                 (3)

x = (position, rate) of one joint, rad and rad/s; u in rad/s2. Source: Lewis, Campos, Selmic (SIAM
2002), chapter 8; the poles are chosen.
"""

import math

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.ports import Ports, port

POLE_PER_S = 5.0
A21, A22 = -POLE_PER_S * POLE_PER_S, -2.0 * POLE_PER_S
JOINTS = 2


class Joints(Ports):
    """x of both joints."""

    q = port("rad", "positions", shape=JOINTS, recorded=False)
    v = port("rad/s", "rates", shape=JOINTS, recorded=False)


class Sampled(Ports):
    """Ad and Bd."""

    q_of_q = port("", "Ad, position from position", named="model_0")
    q_of_v = port("", "Ad, position from rate", named="model_1")
    v_of_q = port("", "Ad, rate from position", named="model_2")
    v_of_v = port("", "Ad, rate from rate", named="model_3")
    q_of_u = port("", "Bd, position", named="model_4")
    v_of_u = port("", "Bd, rate", named="model_5")


def sampled(period_s: float) -> dict[str, float]:
    """Return Ad and Bd of (2) (3), Sampled by name."""
    a, h = POLE_PER_S, period_s
    fall = math.exp(-a * h)
    ad = [fall * (1.0 + a * h), fall * h, -fall * a * a * h, fall * (1.0 - a * h)]
    values = [*ad, (1.0 - fall * (1.0 + a * h)) / (a * a), h * fall]
    return {one.name: value for one, value in zip(Sampled.ports, values, strict=True)}


@inline
def advance(m: Sampled, x: Joints, u: Array) -> None:
    """Advance both joints (2); `m` is Sampled, `x` Joints, `u` (2,) has one value a joint."""
    for j in range(JOINTS):
        q, v = x.q[j], x.v[j]
        x.q[j] = m.q_of_q * q + m.q_of_v * v + m.q_of_u * u[j]
        x.v[j] = m.v_of_q * q + m.v_of_v * v + m.v_of_u * u[j]

"""A fuzzy-logic precompensator that learns both widths of a deadzone, in discrete time.

    e1 = x1(k) - xd(k-1),  e2 = x2(k) - xd(k),  r = e2 + lam e1                              (1)
    f  = -cf x1/(1 + x2^2) + x2                        the plant as known                    (2)
    w  = xd(k+1) - lam e2 - f + Kv r                   all that PD sends                     (3)
    X(w) = [1, 0] for w >= 0, [0, -1] for w < 0        firing of the two rules               (4)
    u  = w + d+ X_1 + d- X_2                           d+, d-: widths learned so far         (5)
    r(k+1) = Kv r + (f_true - f) + (d+ - D+) X_1 + (d- - D-) X_2      beyond the deadzone    (6)

Tuning at the start of tick k, with X of tick k-1 and the r(k) that came of it; d+ = d- = 0 at k = 0
and stay so in that tick:

    d <- d - alpha X(k-1) r(k) - Gam |I - alpha X X'| d                                      (7)
    |I - alpha X X'|_2 = max(1, |1 - alpha|)           for X has one entry of size 1         (8)

By (6) dr(k+1)/dd = X, so the gradient step has a minus where the error is x - xd, as here; laws
whose error is the reference minus the state have a plus. The torque is not measured.

Guard: as soon as |r| is no finite number within its limit, the command is 0 and tuning ends, for
good. Without units: neither rad nor N m.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3; lam, Kv, alpha and Gam are this project's.
"""

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.emath import where
from pcpc.executive.laws.models.second_order_map import drift

INPUTS = (
    Port("x1", "", "measured x1(k)"),
    Port("x2", "", "measured x2(k)"),
    Port("xd_previous", "", "xd(k-1)"),
    Port("xd", "", "xd(k)"),
    Port("xd_next", "", "xd(k+1)"),
)
OUTPUTS = (
    Port("u", "", "command (5)"),
    Port("w", "", "wanted input of the plant (3)"),
    Port("e", "", "error e2 of (1)"),
    Port("r", "", "filtered error (1)"),
    Port("diverged", "", "1 once the guard has ended the control"),
)
FUZZY_OUTPUTS = (
    Port("d_plus", "", "width learned on the positive side"),
    Port("d_minus", "", "width learned on the negative side, a magnitude"),
)
GAINS = (
    Port("lam", "", "weight of the older error", None, -1.0, 1.0),
    Port("kv", "", "Kv, what remains of r after a step", None, -1.0, 1.0),
    Port("cf", "", "coefficient of the plant, as known", None, 0.0, 1.0),
    Port("r_max", "", "|r| at which control ends", None, 0.0, 1e6),
)
TUNING = (
    Port("alpha", "", "learning rate", None, 0.0, 2.0),
    Port("gam", "", "Gam, decay of the widths", None, 0.0, 1.0),
)
GUARD = (Port("ended", "", "1 once the guard has ended the control"),)
STATES = (
    *GUARD,
    Port("width_plus", "", "d+", 0.0),
    Port("width_minus", "", "d-", 0.0),
    Port("fired_plus", "", "X_1 of the last tick"),
    Port("fired_minus", "", "X_2 of the last tick"),
)
LAM, KV, CF, R_MAX, ALPHA, GAM = range(len(GAINS) + len(TUNING))
ENDED, PLUS, MINUS, FIRED_PLUS, FIRED_MINUS = range(len(STATES))


@inline
def follow(p: Any, x: Any, u: Any, y: Any) -> bool:
    """Write (1) and (3) to `y`; return whether control goes on, latched."""
    x1, x2, previous, now, following = u[0], u[1], u[2], u[3], u[4]
    e2 = x2 - now
    r = e2 + p[LAM] * (x1 - previous)  # (1)
    y[1] = following - p[LAM] * e2 - drift(x1, x2, p[CF]) + p[KV] * r  # (2) (3)
    y[2] = e2
    y[3] = r
    x[ENDED] = where(abs(r) <= p[R_MAX], x[ENDED], 1.0)  # NaN ends it too
    y[4] = x[ENDED]
    return x[ENDED] < 0.5


@stage
def pd_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One tick of (1) to (3) alone."""
    good = follow(p, x, u, y)
    y[0] = where(good, y[1], 0.0)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One tick; see the module header."""
    good = follow(p, x, u, y)
    alpha = where(good, p[ALPHA], 0.0)
    size = abs(1.0 - alpha)
    leak = where(good, p[GAM], 0.0) * where(size > 1.0, size, 1.0)  # (8)
    x[PLUS] = x[PLUS] - alpha * x[FIRED_PLUS] * y[3] - leak * x[PLUS]  # (7)
    x[MINUS] = x[MINUS] - alpha * x[FIRED_MINUS] * y[3] - leak * x[MINUS]
    w = y[1]
    x[FIRED_PLUS] = where(w >= 0.0, 1.0, 0.0)  # (4)
    x[FIRED_MINUS] = where(w >= 0.0, 0.0, -1.0)
    u_k = w + x[PLUS] * x[FIRED_PLUS] + x[MINUS] * x[FIRED_MINUS]  # (5)
    y[0] = where(good, u_k, 0.0)
    y[5] = x[PLUS]
    y[6] = x[MINUS]


PD = Block(pd_step, inputs=INPUTS, outputs=OUTPUTS, settings=GAINS, states=GUARD)
BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=(*OUTPUTS, *FUZZY_OUTPUTS),
    settings=(*GAINS, *TUNING),
    states=STATES,
)

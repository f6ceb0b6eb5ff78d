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

(1) to (3) and the guard are those of `map_pd.py`, which calls w tau_d.

By (6) dr(k+1)/dd = X, so the gradient step has a minus where the error is x - xd, as here; laws
whose error is the reference minus the state have a plus. The torque is not measured.

Guard: as soon as |r| is no finite number within its limit, the command is 0 and tuning ends, for
good. Without units: neither rad nor N m.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3; lam, Kv, alpha and Gam are this project's.
"""

from pcpc.executive.laws.block import Block, Ports, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.laws.map_pd import States as Guard
from pcpc.plants.families.maps.laws.map_pd import desired, is_sound


class Inputs(Ports):
    """Both states, and three values of the reference."""

    x1 = port("", "measured x1(k)")
    x2 = port("", "measured x2(k)")
    x_d_previous = port("", "xd(k-1)")
    x_d = port("", "xd(k)")
    x_d_next = port("", "xd(k+1)")


class Outputs(Ports):
    """The command and what led to it."""

    command = port("", "command (5)")
    tau_d = port("", "wanted input of the plant (3)")
    e = port("", "error e2 of (1)")
    r = port("", "filtered error (1)")
    diverged = port("", "1 once the guard has ended the control")


class FuzzyOutputs(Outputs):
    """Those of PD, and what was learned."""

    d_plus = port("", "width learned on the positive side")
    d_minus = port("", "width learned on the negative side, a magnitude")


class Gains(Ports):
    """The filtered error, the model and the guard."""

    lam = port("", "weight of the older error", None, -1.0, 1.0)
    kv = port("", "Kv, what remains of r after a step", None, -1.0, 1.0)
    model_c = port("", "coefficient of the plant, as known", None, 0.0, 1.0)
    r_max = port("", "|r| at which control ends", None, 0.0, 1e6)


class Parameters(Gains):
    """Those of PD, and of the tuning."""

    alpha = port("", "learning rate", None, 0.0, 2.0)
    gam = port("", "Gam, decay of the widths", None, 0.0, 1.0)


class States(Guard):
    """The guard, the widths, and which rule fired."""

    width_plus = port("", "d+", 0.0, adapts=True)
    width_minus = port("", "d-", 0.0, adapts=True)
    fired_plus = port("", "X_1 of the last tick")
    fired_minus = port("", "X_2 of the last tick")


@inline
def tune(alpha: float, gam: float, r: float, x: States) -> None:
    """Step (7) of both widths, with X of the last tick."""
    size = abs(1.0 - alpha)
    leak = gam * where(size > 1.0, size, 1.0)  # (8)
    x.width_plus = x.width_plus - alpha * x.fired_plus * r - leak * x.width_plus  # (7)
    x.width_minus = x.width_minus - alpha * x.fired_minus * r - leak * x.width_minus


@inline
def compensated_command(p: Ports, good: bool, x: States, y: Ports) -> float:
    """Tune (7), and return u (5) of the tau_d and r in `y`; write both widths."""
    tune(where(good, p.alpha, 0.0), where(good, p.gam, 0.0), y.r, x)
    x.fired_plus = where(y.tau_d >= 0.0, 1.0, 0.0)  # (4)
    x.fired_minus = where(y.tau_d >= 0.0, 0.0, -1.0)
    y.d_plus = x.width_plus
    y.d_minus = x.width_minus
    return y.tau_d + x.width_plus * x.fired_plus + x.width_minus * x.fired_minus  # (5)


@stage
def pd_step(t: float, dt: float, p: Gains, x: Guard, u: Inputs, y: Outputs) -> None:
    """One tick of (1) to (3) alone."""
    desired(p, u, y)  # (1) to (3), w for tau_d
    y.command = where(is_sound(p, x, y), y.tau_d, 0.0)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: FuzzyOutputs) -> None:
    """One tick; see the module header."""
    desired(p, u, y)  # (1) to (3), w for tau_d
    good = is_sound(p, x, y)
    u_k = compensated_command(p, good, x, y)
    y.command = where(good, u_k, 0.0)


PD = Block(pd_step)
BLOCK = Block(step)

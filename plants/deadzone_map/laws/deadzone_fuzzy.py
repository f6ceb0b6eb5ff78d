"""A fuzzy-logic precompensator that learns both widths of a deadzone, in discrete time.

    e1 = x1(k) - xd(k-1),  e2 = x2(k) - xd(k),  r = e2 + lam e1                              (1)
    f  = -cf x1/(1 + x2^2) + x2                        the plant as known                    (2)
    w  = xd(k+1) - lam e2 - f + Kv r                   all that PD sends                     (3)
    u  = w + d+ X_1 + d- X_2                           fuzzy_widths.py (1) to (4)            (4)
    r(k+1) = Kv r + (f_true - f) + (d+ - D+) X_1 + (d- - D-) X_2      beyond the deadzone    (5)

(1) to (3) and the guard are those of `map_pd.py`, which calls w tau_d.

By (5) dr(k+1)/dd = X, so the gradient step has a minus where the error is x - xd, as here; laws
whose error is the reference minus the state have a plus. The torque is not measured.

Guard: as soon as |r| is no finite number within its limit, the command is 0 and tuning ends, for
good. Without units: neither rad nor N m.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3; lam, Kv, alpha and Gam are this project's.
"""

from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.laws.fuzzy_widths import States, Tuning, Widths, compensated_command
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

    command = port("", "command (4)")
    tau_d = port("", "wanted input of the plant (3)")
    e = port("", "error e2 of (1)")
    r = port("", "filtered error (1)")
    diverged = port("", "1 once the guard has ended the control")


class FuzzyOutputs(Outputs, Widths):
    """Those of PD, and what was learned."""


class Gains(Ports):
    """The filtered error, the model and the guard."""

    lam = port("", "weight of the older error", None, -1.0, 1.0)
    kv = port("", "Kv, what remains of r after a step", None, -1.0, 1.0)
    model_c = port("", "coefficient of the plant, as known", None, 0.0, 1.0)
    r_max = port("", "|r| at which control ends", None, 0.0, 1e6)


class Parameters(Gains, Tuning):
    """Those of PD, and of the tuning."""


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

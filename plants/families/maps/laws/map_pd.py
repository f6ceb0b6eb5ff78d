"""PD with an exact model for the second-order map: what one step of the plant is to be given.

    e2 = x2 - x_d(k),  e1 = x1 - x_d(k-1),  r = e2 + lam e1                                  (1)
    tau_d(k) = x_d(k+1) - lam e2 - F(x1, x2) + Kv r        F: equations.py (1)               (2)
    u(k) = tau_d(k)                                                                          (3)

gives r(k+1) = Kv r(k) - (tau_d(k) - tau(k)). The answer to the sample of k is for step k, so that
`ahead` is 0.
Beyond |r| = r_max the law is latched off and sends 0: `diverged`. Without units.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.3; lam and Kv are chosen.
"""

from pcpc.executive.laws.block import Block, Ports, inline, port, stage
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.equations import drift


class Inputs(Ports):
    """Three values of the reference, and both states."""

    x_d_previous = port("", "x_d(k-1)")
    x_d = port("", "x_d(k)")
    x_d_next = port("", "x_d(k+1)")
    x1 = port("", "measured x1")
    x2 = port("", "measured x2")


class Gains(Ports):
    """The filtered error, the model and the latch."""

    lam = port("", "lam of the filtered error", 0.2, -1.0, 1.0)
    kv = port("", "Kv, what is left of r after a step", 0.998, 0.0, 1.0)
    model_c = port("", "coefficient of F in the law", 0.1875, 0.0, 1.0)
    r_max = port("", "filtered error at which the law is latched off", 1000.0, 0.0, 1e12)


class States(Ports):
    """The latch."""

    latched = port("", "1 once the law was latched off")


class Outputs(Ports):
    """The command and what led to it."""

    command = port("", "u, 0 once latched off")
    ahead = port("", "1: u is for the step after the sample's")
    e = port("", "e2")
    r = port("", "r")
    tau_d = port("", "tau_d (2)")
    diverged = port("", "1 once the law was latched off")


@inline
def desired(p: Ports, u: Ports, y: Ports) -> None:
    """Write e2, r (1) and tau_d (2); the ports are named as here."""
    y.e = u.x2 - u.x_d
    y.r = y.e + p.lam * (u.x1 - u.x_d_previous)
    y.tau_d = u.x_d_next - p.lam * y.e - drift(u.x1, u.x2, p.model_c) + p.kv * y.r


@inline
def is_sound(p: Ports, x: Ports, y: Ports) -> bool:
    """Return whether the law was never latched off; `x` has States."""
    healthy = abs(y.r) <= p.r_max  # false for NaN
    x.latched = where(healthy, x.latched, 1.0)
    y.diverged = x.latched
    return bool(x.latched < 0.5)


@stage
def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
    """One step of the map; see the module header."""
    desired(p, u, y)
    y.command = where(is_sound(p, x, y), y.tau_d, 0.0)  # (3)
    y.ahead = 0.0


BLOCK = Block(step)

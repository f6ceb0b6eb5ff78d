"""Both widths of a deadzone, learned by a fuzzy precompensator: a part of laws, without a block.

    X(w) = [1, 0] for w >= 0, [0, -1] for w < 0        firing of the two rules               (1)
    u  = w + d+ X_1 + d- X_2                           d+, d-: widths learned so far         (2)
    d <- d - alpha X(k-1) r(k) - Gam |I - alpha X X'| d                                      (3)
    |I - alpha X X'|_2 = max(1, |1 - alpha|)           for X has one entry of size 1         (4)

(3) at the start of tick k, with X of tick k-1 and the r(k) that came of it; d+ = d- = 0 at k = 0
and stay so in that tick. w is `map_pd.py`'s tau_d. Without units: neither rad nor N m.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3.
"""

from pcpc.executive.laws.block import Ports, inline, port
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.laws.map_pd import States as Guard


class Tuning(Ports):
    """Of both widths."""

    alpha = port("", "learning rate", None, 0.0, 2.0)
    gam = port("", "Gam, decay of the widths", None, 0.0, 1.0)


class Widths(Ports):
    """What was learned."""

    d_plus = port("", "width learned on the positive side")
    d_minus = port("", "width learned on the negative side, a magnitude")


class States(Guard):
    """The guard, the widths, and which rule fired."""

    width_plus = port("", "d+", 0.0, adapts=True)
    width_minus = port("", "d-", 0.0, adapts=True)
    fired_plus = port("", "X_1 of the last tick")
    fired_minus = port("", "X_2 of the last tick")


@inline
def tune(alpha: float, gam: float, r: float, x: States) -> None:
    """Step (3) of both widths, with X of the last tick."""
    size = abs(1.0 - alpha)
    leak = gam * where(size > 1.0, size, 1.0)  # (4)
    x.width_plus = x.width_plus - alpha * x.fired_plus * r - leak * x.width_plus  # (3)
    x.width_minus = x.width_minus - alpha * x.fired_minus * r - leak * x.width_minus


@inline
def compensated_command(p: Ports, good: bool, x: States, y: Ports) -> float:
    """Tune (3), and return u (2) of the tau_d and r in `y`; write both widths."""
    tune(where(good, p.alpha, 0.0), where(good, p.gam, 0.0), y.r, x)
    x.fired_plus = where(y.tau_d >= 0.0, 1.0, 0.0)  # (1)
    x.fired_minus = where(y.tau_d >= 0.0, 0.0, -1.0)
    y.d_plus = x.width_plus
    y.d_minus = x.width_minus
    return y.tau_d + x.width_plus * x.fired_plus + x.width_minus * x.fired_minus  # (2)

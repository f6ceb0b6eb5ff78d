"""A chain of two or three delays as a difference equation, the second-order map made longer.

    x1(k+1) = x2(k),  x2(k+1) = x3(k),  x3(k+1) = F + tau(k)
    F = drift(x_first, x3) + kappa o/(1 + x3^2),   drift: families/maps/equations.py         (1)

x_first is x2 in a chain of second order, whose x1 acts on nothing, and x1 in one of third order;
o is the newest state of another chain. With kappa = 0 a chain of second order is the map of
that family, bit for bit.

Without units. Source: Lewis, Campos, Selmic (SIAM 2002), chapters 4.3 and 5.3, whose plants are
chains of m inputs and any order; F is chosen, for the book leaves it open.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import where
from pcpc.plants.families.maps.equations import drift


@inline
def chain_drift(
    x1: float, x2: float, x3: float, other: float, order: float, c: float, kappa: float
) -> float:
    """Return F of (1) for a chain of `order` 2 or 3."""
    first = where(order > 2.5, x1, x2)
    return drift(first, x3, c) + kappa * other / (1.0 + x3 * x3)

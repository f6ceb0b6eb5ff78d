"""A second-order plant as a difference equation, of the book's discrete-time examples.

    x1(k+1) = x2(k)
    x2(k+1) = F(x1, x2) + tau(k),   F = -c x1/(1 + x2^2) + x2                                (1)

Without units; c = 3/16. Source: Lewis, Campos, Selmic (SIAM 2002), chapters 4.3 and 5.3; the map
itself is lost in the available copies and stands here as it is known from the literature.
"""

from pcpc.drivers.compiled.jit import inline


@inline
def drift(x1: float, x2: float, c: float) -> float:
    """Return F of (1)."""
    return -c * x1 / (1.0 + x2 * x2) + x2

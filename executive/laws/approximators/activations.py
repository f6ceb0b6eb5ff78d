"""Activations of hidden nodes: value and slope at once, chosen by a constant.

    LOGISTIC     s = 1/(1 + exp(-z))         s' = s (1 - s)                                  (1)
    TANH         s = tanh z                  s' = 1 - s^2                                    (2)
    SYMMETRIC    s = 2/(1 + exp(-z)) - 1     s' = (1 - s^2)/2        tanh(z/2), in +-1       (3)
    GAUSSIAN     s = exp(-z^2)               s' = -2 z s                                     (4)
    HARD_LIMIT   s = 1 for z >= 0, else 0    s' = 0: no Jacobian, first layer not tunable    (5)

Source: Lewis, Campos, Selmic (SIAM 2002), chapter 1.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import expmsq, logistic, tanh, where

LOGISTIC, TANH, SYMMETRIC, GAUSSIAN, HARD_LIMIT = range(5)
NAMES = ("logistic", "tanh", "symmetric", "gaussian", "hard_limit")


@inline
def activate(kind: int, z: float) -> tuple[float, float]:
    """Return s and s' (1) to (5); `kind` is configuration: one of this file's constants."""
    if kind == LOGISTIC:
        s = logistic(z)
        return s, s * (1.0 - s)
    if kind == TANH:
        s = tanh(z)
        return s, 1.0 - s * s
    if kind == SYMMETRIC:
        s = tanh(0.5 * z)
        return s, 0.5 * (1.0 - s * s)
    if kind == GAUSSIAN:
        s = expmsq(z)
        return s, -2.0 * z * s
    return where(z >= 0.0, 1.0, 0.0), 0.0

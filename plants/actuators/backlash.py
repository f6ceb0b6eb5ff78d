"""Backlash of a driven gap, the play operator: the output waits until the input has crossed it.

    tau' = m u'  if (u' > 0 and tau = m (u - d+)) or (u' < 0 and tau = m (u - d-)), else 0   (1)
    tau_k+1 = min(max(tau_k, m (u_k+1 - d+)), m (u_k+1 - d-))                                (2)
    inverse   u_k+1 = w_k+1/m + d+ if w rises, w_k+1/m + d- if it falls, else u_k            (3)

m > 0, d+ > 0 > d-. (2) solves (1) exactly for any monotone move of u between two calls. Call it
once per step of the plant, with the u of that step; under a held u further calls change nothing.
(2) after (3) gives w back once tau_0 = m (u_0 - d+) or m (u_0 - d-). The inverse jumps by d+ - d-
where w turns.

Source: Lewis, Campos, Selmic (SIAM 2002), chapter 2; (2) is the play operator of the hysteresis
literature.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import where


@inline
def backlash(tau: float, u: float, d_plus: float, d_minus: float, m: float = 1.0) -> float:
    """Return the output of (2) after the input moved to `u`; `tau` is the output before."""
    low, high = m * (u - d_plus), m * (u - d_minus)
    pushed = where(tau < low, low, tau)
    return where(pushed > high, high, pushed)


@inline
def backlash_inverse(
    u: float, w_before: float, w: float, d_plus: float, d_minus: float, m: float = 1.0
) -> float:
    """Return the input of (3) that moves the output from `w_before` to `w`; `u` is the present."""
    rising = where(w > w_before, w / m + d_plus, u)
    return where(w < w_before, w / m + d_minus, rising)

"""A deadzone: no output within a band, straight lines of their own slope outside.

    D(u)    = m+ (u - d+)  u >= d+;   0;   m- (u + d-)  u <= -d-                             (1)
    D(u)    = m(u) (u - sat_d(u)),  m(u) = m+ if u > 0 else m-,  sat_d = clip(u, -d-, d+)    (2)
    Dinv(w) = w/m+ + d+  w > 0;   0;   w/m- - d-  w < 0                                      (3)
    y^(z)   = z/m+ + d+  z > 0;   (d+ - d-)/2;   z/m- - d-  z < 0                            (4)

(3) stands in front of a deadzone at the input: D(Dinv(w)) = w. (4) stands behind one at the output,
z = D(y): the centre of the band is the estimate with the smallest worst error, (d+ + d-)/2; outside
y^ = y. D(y^(z)) = z for every z that D can give.

d+, d- >= 0 are magnitudes, m+, m- > 0. Memoryless: evaluate it wherever u changes. For slopes other
than 1, u - D(u) is not bounded; only (2) keeps a bounded second path.

Source: Lewis, Campos, Selmic (SIAM 2002), chapter 2.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import clip, where


@inline
def deadzone(
    u: float, d_plus: float, d_minus: float, m_plus: float = 1.0, m_minus: float = 1.0
) -> float:
    """Return D(u) of (2)."""
    slope = where(u > 0.0, m_plus, m_minus)
    return slope * (u - clip(u, -d_minus, d_plus))


@inline
def deadzone_inverse(
    w: float, d_plus: float, d_minus: float, m_plus: float = 1.0, m_minus: float = 1.0
) -> float:
    """Return the u with D(u) = w (3)."""
    return where(w > 0.0, w / m_plus + d_plus, where(w < 0.0, w / m_minus - d_minus, 0.0))


@inline
def output_estimate(
    z: float, d_plus: float, d_minus: float, m_plus: float = 1.0, m_minus: float = 1.0
) -> float:
    """Return y^ of (4), the estimate of the input of a deadzone whose output is `z`."""
    beyond = deadzone_inverse(z, d_plus, d_minus, m_plus, m_minus)
    return where(z == 0.0, 0.5 * (d_plus - d_minus), beyond)

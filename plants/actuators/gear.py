"""A gear of ratio N with play, a torsion spring and a damper, seen at its output shaft.

    d    = th_m/N - rel                            wind-up before the play is subtracted  (1)
    pen  = d - gap/2  for d >  gap/2,                                                     (2)
           d + gap/2  for d < -gap/2,  else 0      penetration of the flank
    T    = ks pen + cs min(1, |pen|/p0) dd,        dd = d'                                (3)
           but 0 where its sign differs from that of pen: flanks push, they never pull

rad, N m. `gap` is the total play at the output. T acts + on the load and -T/N on the rotor. The
factor min(1, |pen|/p0) makes T continuous at touch.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import where


@inline
def penetration(wind_up: float, gap: float) -> float:
    """Return pen of (2); rad."""
    half = 0.5 * gap
    return where(wind_up > half, wind_up - half, where(wind_up < -half, wind_up + half, 0.0))


@inline
def shaft_torque(pen: float, wind_up_rate: float, ks: float, cs: float, p0: float) -> float:
    """Return T of (3), N m at the output; `p0` > 0 rad."""
    depth = abs(pen) / p0
    torque = ks * pen + cs * where(depth < 1.0, depth, 1.0) * wind_up_rate
    return where(torque * pen > 0.0, torque, 0.0)

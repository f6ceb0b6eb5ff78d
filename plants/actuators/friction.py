"""Dry friction in two models: LuGre with its bristle state z, and the static Stribeck curve.

    g(v) = Fc + (Fs - Fc) exp(-(v/vs)^2)                     steady sliding friction            (1)
    z'   = v - a z,  a = sig0 |v|/g(v)                       bristle deflection                 (2)
    z'   = a (sign(v) g/sig0 - z),  a = 2/h                  instead of (2) where a >= 2/h      (3)
    T    = sig0 z + sig1 exp(-(v/vd)^2) z' + sig2 v          LuGre torque                       (4)
    T    = g(v) tanh(v/v0) + sig2 v                          Stribeck torque                    (5)
    T    = Tc tanh(v/v0) + b v                               Coulomb torque                     (6)

v rad/s, z rad, T N m; T opposes v, so subtract it. (2) alone is unstable at speed; (3) goes to the
same steady state at the fastest rate that a Runge-Kutta step h can follow. The fading of sig1 with
vd keeps (4) passive.

Source: Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of systems with
friction, IEEE Trans. Automatic Control 40 (1995).
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import expmsq, sign, tanh, where


@inline
def sliding(v: float, coulomb: float, breakaway: float, v_stribeck: float) -> float:
    """Return g(v) > 0 of (1), N m; `coulomb` Fc > 0, `breakaway` Fs, `v_stribeck` vs > 0."""
    return coulomb + (breakaway - coulomb) * expmsq(v / v_stribeck)


@inline
def lugre(
    v: float, z: float, g: float, sig0: float, sig1: float, sig2: float, v_damp: float, h: float
) -> tuple[float, float]:
    """Return the torque of (4) and z' of (2) or (3); `g` from `sliding`, `h` the step in s."""
    rate = sig0 * abs(v) / g
    fastest = 2.0 / h
    limited = fastest * (sign(v) * g / sig0 - z)  # (3)
    dz = where(rate >= fastest, limited, v - rate * z)
    return sig0 * z + sig1 * expmsq(v / v_damp) * dz + sig2 * v, dz  # (4)


@inline
def stribeck(v: float, g: float, v_reverse: float, sig2: float) -> float:
    """Return the torque of (5); `g` from `sliding`; the sign changes over about +-`v_reverse`."""
    return g * tanh(v / v_reverse) + sig2 * v


@inline
def coulomb_viscous(v: float, coulomb: float, v_reverse: float, viscous: float) -> float:
    """Return the torque of (6)."""
    return coulomb * tanh(v / v_reverse) + viscous * v

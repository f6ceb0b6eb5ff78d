"""The adaptive inverse of a deadzone after Tao and Kokotovic, in discrete time, with projection.

    D(u) = m+ u - c+ for u beyond c+/m+, m- u + c- for u below -c-/m-, else 0                (1)
    w    = what PD sends, (1) to (3) of deadzone_fuzzy.py; X+ = 1 for w >= 0, X- = 1 - X+    (2)
    u    = X+ (w + c+)/m+ + X- (w - c-)/m-             with the estimates of c and m         (3)
    v    = [X+, -X+ u, -X-, -X- u],  th = [c+, m+, c-, m-]                                   (4)
    eps  = r(k) - Kv r(k-1) = (th - TH)'v(k-1) + (f_true - f) + d_N                          (5)
    th  <- project(th - gam v(k-1) eps/(1 + |v(k-1)|^2))                                     (6)
        onto the box 0 <= c <= C, M1 <= m <= M2

TH is the deadzone's own; d_N is 0 where u came through it, and within its width otherwise. With
an exact model and d_N = 0 every step (6) brings th closer to TH for 0 < gam < 2, since a box
projects no point farther from one inside. Differs from deadzone_fuzzy.py in three ways: driven by
the error of the prediction (5) instead of r itself, normalised, and bounded by the box instead of
a decay; it also learns the slopes. M1 = M2 = 1 gives it what that law takes for granted.

All estimates begin at c = 0, m = 1, or at the box's nearest point. Guard as in deadzone_fuzzy.py.
Without units. Source: Tao, Kokotovic, Adaptive control of plants with unknown dead-zones, IEEE
Trans. Automatic Control 39 (1994), 59-68; in discrete time: Discrete-time adaptive control of
systems with unknown deadzones, Int. J. Control 61 (1995), 1-17; gam and the box are this project's.
"""

from pcpc.executive.laws.block import Block, inline, port, stage
from pcpc.executive.laws.emath import clip, where
from pcpc.plants.deadzone_map.laws.deadzone_fuzzy import FuzzyOutputs, Gains, Inputs
from pcpc.plants.families.maps.laws.map_pd import States as Guard
from pcpc.plants.families.maps.laws.map_pd import desired, is_sound


class Parameters(Gains):
    """Those of PD, the rate and the box."""

    gam = port("", "gam, rate of (6)", None, 0.0, 2.0)
    offset_max = port("", "C, c+ and c- lie in 0..this", None, 0.0, 1e3)
    slope_min = port("", "M1, least slope", None, 1e-3, 1e3)
    slope_max = port("", "M2, largest slope", None, 1e-3, 1e3)


class States(Guard):
    """The guard, the estimates, and what the last tick sent."""

    offset_plus = port("", "c+", 0.0, adapts=True)
    slope_plus = port("", "m+", 1.0, adapts=True)
    offset_minus = port("", "c-", 0.0, adapts=True)
    slope_minus = port("", "m-", 1.0, adapts=True)
    fired_plus = port("", "X+ of the last tick")
    fired_minus = port("", "X- of the last tick")
    sent = port("", "u of the last tick")
    r_before = port("", "r of the last tick")


class Outputs(FuzzyOutputs):
    """Those of the fuzzy law, and what else is learned; widths are c/m."""

    m_plus = port("", "slope learned on the positive side")
    m_minus = port("", "slope learned on the negative side")
    prediction_error = port("", "eps (5)")


@inline
def tune(p: Parameters, x: States, eps: float) -> None:
    """Step (6), with v of the last tick."""
    plus, minus, u = x.fired_plus, x.fired_minus, x.sent
    size = (plus + minus) * (1.0 + u * u)
    step = p.gam * eps / (1.0 + size)
    x.offset_plus = clip(x.offset_plus - step * plus, 0.0, p.offset_max)
    x.slope_plus = clip(x.slope_plus + step * plus * u, p.slope_min, p.slope_max)
    x.offset_minus = clip(x.offset_minus + step * minus, 0.0, p.offset_max)
    x.slope_minus = clip(x.slope_minus + step * minus * u, p.slope_min, p.slope_max)


@inline
def inverse(w: float, x: States) -> float:
    """Return u of (3); fired_plus and fired_minus are those of this tick."""
    right = (w + x.offset_plus) / x.slope_plus
    left = (w - x.offset_minus) / x.slope_minus
    return where(x.fired_plus > 0.5, right, left)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    desired(p, u, y)  # w for tau_d
    good = is_sound(p, x, y)
    begun = x.fired_plus + x.fired_minus
    y.prediction_error = where(begun > 0.5, y.r - p.kv * x.r_before, 0.0)  # (5)
    tune(p, x, where(good, y.prediction_error, 0.0))  # (6)
    x.fired_plus = where(y.tau_d >= 0.0, 1.0, 0.0)  # (2)
    x.fired_minus = 1.0 - x.fired_plus
    y.command = where(good, inverse(y.tau_d, x), 0.0)  # (3)
    x.sent, x.r_before = y.command, y.r
    y.d_plus, y.d_minus = x.offset_plus / x.slope_plus, x.offset_minus / x.slope_minus
    y.m_plus, y.m_minus = x.slope_plus, x.slope_minus


BLOCK = Block(step)

"""Theorem 6.3.1 on runs of the strut under fuzzy backstepping: its proof term by term.

    ef' = Fd' - f - G xv,  H = -f/G = Th*'m + eps                                            (1)
    ef' = -k1 ef + Gh (Th~'m + e) + w,  e = x7d - xv,  Gh: G as the law knows it             (2)
    V   = ef^2/2 + |Th~|^2/(2 Gam)                                                           (3)
    V'  = -k1 ef^2 + ef (Gh e + w) + kap |Gh ef| Th~'Th                                      (4)

This is (9) of strut_backstepping.py for c = 0, which asks for the spool's e to be bounded: e' =
-lam e, whatever ef does, but for what the filtered differences and the limits leave. f and G are
the strut's own, of the true pressures and the true spool; Fd' is the difference quotient of Fd. w:
eps, G against Gh, filtered against true derivatives, x7d at its limit. Gh e counts to |w|, and so
does the part of the leak by which Gh is above its least value of the run. eps is looked for over
states drawn from 1.25 times the ranges of the run. N, m, s. Source: Lewis, Campos, Selmic (SIAM
2002), chapter 6.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.quarter_car.equations import nominal_gain
from pcpc.plants.theorem import (
    Cycles,
    NoTheorem,
    Theorem,
    around,
    fitted_weights,
    inner,
    layered,
    never,
    positive,
)
from pcpc.plants.weights import Layer, Vector

P_MIN_PA, DP_SMOOTH_PA, SPOOL_SMOOTH_M, PSI_MIN_PA, FLOOR = 1e5, 1e5, 1e-5, 1e4, 0.05
RANGE, SCALES = 1.2, (0.1, 2.0, 10e6)
COUNTS, WIDTHS = (3, 7, 7), (0.5, 0.2, 0.2)
RULES, DRAWN, RIDGE = 147, 20_000, 1e-4
HYDRAULIC = 1.0
STATE = "executive:controller."


@dataclass(frozen=True)
class Strut:
    """The strut's constants; methods take states of n cycles and return values, (n,) each."""

    bore_m2: float
    annulus_m2: float
    orifice: float
    valve: float
    bulk_Pa: float
    bulk_slope: float
    supply_Pa: float
    volume_m3: float

    def stiffness(self, volume: Vector, pressure: Vector) -> Vector:
        """Return B/V, Pa/m3."""
        bulk = self.bulk_Pa + self.bulk_slope * np.maximum(pressure, P_MIN_PA)
        return np.asarray(bulk / np.maximum(volume, FLOOR * self.volume_m3))

    def gain(self, x3: Vector, p1: Vector, spool: Vector) -> Vector:
        """Return G, N/(m s)."""
        half = 0.5 * self.supply_Pa
        psi = half + np.clip(spool / SPOOL_SMOOTH_M, -1.0, 1.0) * (half - p1)
        open_by = self.valve * np.sqrt(np.maximum(psi, PSI_MIN_PA))
        stiff = self.stiffness(self.volume_m3 + self.bore_m2 * x3, p1)
        return np.asarray(self.bore_m2 * stiff * open_by)

    def drift(self, x3: Vector, v3: Vector, p1: Vector, p2: Vector) -> Vector:
        """Return f, N/s."""
        dp = p1 - p2
        leak = self.orifice * dp / (dp**2 + DP_SMOOTH_PA**2) ** 0.25
        bore = self.stiffness(self.volume_m3 + self.bore_m2 * x3, p1) * (-self.bore_m2 * v3 - leak)
        rod = self.stiffness(self.volume_m3 - self.annulus_m2 * x3, p2)
        return np.asarray(
            self.bore_m2 * bore - self.annulus_m2 * rod * (self.annulus_m2 * v3 + leak)
        )


def memberships(x3: Vector, v3: Vector, dp: Vector) -> Vector:
    """Return m (n, 147) at x3, v3, dp, each (n,)."""
    parts = []
    for value, scale, count, width in zip((x3, v3, dp), SCALES, COUNTS, WIDTHS, strict=True):
        seen = np.clip(value / scale, -RANGE, RANGE)[:, None]
        mu = np.exp(-0.5 * ((seen - np.linspace(-1.0, 1.0, count)) / width) ** 2)
        parts.append(mu / mu.sum(axis=1, keepdims=True))
    return np.einsum("ni,nj,nk->nijk", *parts).reshape(len(x3), RULES)


def largest_eps(strut: Strut, states: list[Vector], spool: Vector, ideal: Vector) -> float:
    """Return the largest G eps over states drawn from the ranges of the run, N/s.

    `states` and `spool`: (n,) each; `ideal`: (147,).
    """
    draw = np.random.default_rng(0)
    x3, v3, p1, p2 = (around(one, draw, DRAWN) for one in states)
    gain = strut.gain(x3, p1, draw.choice(np.sign(spool), DRAWN))
    return float(
        np.abs(-strut.drift(x3, v3, p1, p2) - gain * (memberships(x3, v3, p1 - p2) @ ideal)).max()
    )


def bound(run: Cycles, w: Layer, known: Vector, eps: float) -> Constants:
    """Return the constants for the largest of all that stands in w beside the leak, N/s."""
    k1, kap = run.laws("k1_per_s", "kap_per_m")
    least = float(known.min())
    surplus = float((kap * (known - least)).max())
    return Constants(k1, kap * least, w.norm, eps + surplus * w.norm**2 / 4.0)


def asked(run: Cycles, wanted: Vector, e: Vector) -> tuple[Assumption, ...]:
    """Return what the theorem asks of a run."""
    kap, lam, limit, on, exact = run.laws(
        "kap_per_m", "lam_per_s", "spool_max_m", "fl_on", "exact_drift"
    )
    off = float(np.linalg.norm(run.slope(e)[:-1] + lam * e[:-1]))
    follows = off / max(lam * float(np.linalg.norm(e)), 1e-300)
    return (
        positive("leak kap", kap),
        Assumption(
            "the rules are on",
            on > 0.5 and exact < 0.5,
            f"fl_on {on:g}, exact_drift {exact:g}",
            needed=True,
        ),
        Assumption(
            "e' = -lam e",
            follows < 0.01,
            f"filters, limits and sampling add {100.0 * follows:.3g} % of lam e, rms",
        ),
        never(
            "the spool's travel is enough", ~(np.abs(wanted) < limit), "x7d is at its limit in {}"
        ),
    )


def prove(run: Cycles) -> Proof:
    """Return the proof of a run; NoTheorem for another strut."""
    if run.setting("plant:car.strut") != HYDRAULIC:
        raise NoTheorem("the strut of this rig is not the hydraulic one")
    strut = Strut(*run.settings("plant:car.h_", [*Strut.__annotations__]))
    k1, kap = run.laws("k1_per_s", "kap_per_m")
    x3, p1, p2, spool = (
        run.column(f"plant:car.{name}") for name in ("extension_m", "p1_Pa", "p2_Pa", "spool_m")
    )
    v3 = run.column("plant:car.body_rate_m_s") - run.column("plant:car.wheel_rate_m_s")
    desired, wanted = run.column(f"{STATE}desired_N"), run.column(f"{STATE}wanted_spool_m")
    ef, e = desired - run.column("plant:car.strut_N"), wanted - spool
    known = strut.gain(x3, p1, run.earlier(f"{STATE}wanted_spool_m"))  # Gh
    gain, drift = strut.gain(x3, p1, spool), strut.drift(x3, v3, p1, p2)
    ef_rate = run.slope(desired) - drift - gain * spool  # (1)

    m, state, back = memberships(x3, v3, p1 - p2), run.state(f"{STATE}theta", RULES), known * ef
    ideal = fitted_weights(m, -drift / gain, RIDGE)
    rate, leak = run.rate("gam_m2_N2"), kap * np.abs(back)
    w = state.layer("Gam", rate, ideal, m * back[:, None], leak)
    rest = ef_rate + k1 * ef - known * (e + inner(w.lacks, m))  # w of (2)
    apart = known * e + rest
    off_rules = np.abs(apart - known * (-drift / gain - m @ ideal)).max()
    eps = largest_eps(strut, [x3, v3, p1, p2], spool, ideal)
    surplus = kap * (known - float(known.min()))
    return layered(
        run,
        ("Theorem 6.3.1", "|ef| [N]"),
        (w,),
        v=0.5 * ef**2,  # (3)
        damping=k1 * ef**2,  # (4)
        terms={
            "ef Gh e, the spool on its way": ef * known * e,
            "ef w, what the rules do not cancel": ef * rest,
            "leak of the rules": leak * w.leaked,
        },
        error=np.abs(ef),
        rest=np.abs(apart) + surplus * np.maximum(w.leaked, 0.0),
        constants=bound(run, w, known, float(eps + off_rules)),
        asked=asked(run, wanted, e),
    )


def declared_rate(settings: Mapping[str, float]) -> float:
    """Return Gam as (7) of the law has it, of what the rig gives, m2/N2."""
    weight_N = settings["mass_kg"] * settings["gravity_m_s2"]
    return float((settings["adaptation_rad_s"] / nominal_gain(settings, weight_N)) ** 2)


STATES = ("controller.theta_*",)
RATES = ("gam_m2_N2",)
THEOREMS = {
    "strut_backstepping": Theorem(
        prove, STATES, RATES, derived={"gam_m2_N2": ("adaptation_rad_s", declared_rate)}
    )
}

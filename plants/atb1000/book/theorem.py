"""Theorem 3.2.2 on runs of the barrel's neural laws, as far as it goes: its inequality, no bound.

    M r' = -tau + f,  f = W*'phi(V*'x) + eps                                                 (1)
    tau  = Kv r + y + Kz (|Z| + Z_B) r + u_F                 as asked, before its limit      (2)
    w    = f - u_F - y - [W~'(phi - phi'z) + W'phi'V~'x],  z = V'x                           (3)
    V    = M r^2/2 + sum |W~|^2/(2 F) + |V~|^2/(2 G)         F, FJ by node                   (4)
    V'   = -(Kv + Kz (|Z| + Z_B)) r^2 + r w + (r - r_t) [...] + kappa |r_t| tr(Z~'Z)         (5)

The theorem is one of a rigid hub that tau turns. Here f is whatever is missing for that: friction,
gravity and the hull, and also bending, the shaft with its play, the current loop, the inner torque
loop of the backstepping law. Those depend on what was commanded before, so that nothing bounds f
from constants: c0 is of the run, and the bound says what the law does with such an f, not that f
stays so. M is the inertia of hub, straight barrel and rotor at the output; M r' is the difference
quotient of the true rate, so that only the tuning is derived twice. r_t, by which the law tunes, is
the measured r within +-0.3 rad/s, 0 in its dead band: the product with (r - r_t) in (5) is what
this costs. V* is V as drawn, W* comes of least squares. rad, rad/s, N m. Source: Lewis, Campos,
Selmic (SIAM 2002), chapters 3 and 9.
"""

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.book.hidden import Hidden
from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    Theorem,
    fitted_weights,
    inner,
    layered,
    never,
    positive,
)
from pcpc.plants.weights import Layer, State, Vector, norm

INPUTS, NODES, JUMPS = 7, 10, 4
ALL, NEAR, FAR = 1 + NODES + JUMPS, slice(0, 1 + NODES), slice(1 + NODES, None)
R_MAX_RAD_S, DEAD_BAND_RAD = 0.3, 1e-4
LAW, PLANT, REFERENCE = "executive:controller.", "plant:barrel.", "executive:reference."


def signals(run: Cycles, m: float) -> tuple[Vector, Vector]:
    """Return r and M r' of (1), (n,) each."""
    lam, turns = run.law("lam_per_s"), run.column(f"{PLANT}theta_rate_rad_s")
    e = run.column(f"{REFERENCE}q_d_rad") - run.column(f"{PLANT}theta_rad")
    e_rate = run.column(f"{REFERENCE}q_d_rate_rad_s") - turns
    acc_d = run.column(f"{REFERENCE}q_d_acc_rad_s2")
    return e_rate + lam * e, m * (acc_d + lam * e_rate - run.slope(turns))


def moving(run: Cycles) -> NDArray[np.bool_]:
    """Return in which cycles the law is not in its dead band, (n,)."""
    accelerates = np.abs(run.column(f"{REFERENCE}q_d_acc_rad_s2")) > 1e-6
    return (np.abs(run.column(f"{LAW}e_rad")) > DEAD_BAND_RAD) | accelerates


def layers(run: Cycles, f: Vector, w: State, hidden: Hidden) -> tuple[Vector, Layer, Layer]:
    """Return r_t, and W and V as it tunes them."""
    seen = np.clip(run.column(f"{LAW}r_rad_s"), -R_MAX_RAD_S, R_MAX_RAD_S)
    r_t = seen * moving(run) * (run.column(f"{LAW}network_on") > 0.5)
    flat, slope, _ = hidden.linear
    leak = run.law("kappa") * np.abs(r_t)
    back = slope * w.w[:, 1 : 1 + NODES] * r_t[:, None]
    ideal = fitted_weights(hidden.known[:-1], f[:-1])
    return (
        r_t,
        w.layer("F", run.rate("f_rate"), ideal, flat * r_t[:, None], leak),
        hidden.layer("G", run.rate("g_rate"), back, leak),
    )


def asked(run: Cycles) -> tuple[Assumption, ...]:
    """Return what the theorem asks of a run."""
    engaged, tau = run.column(f"{LAW}network_on") > 0.5, np.abs(run.column(f"{LAW}tau_Nm"))
    kappa, limit = run.laws("kappa", "tau_max_Nm")
    opened = run.column(f"{PLANT}penetration_rad") == 0.0
    return (
        positive("leak kappa", kappa),
        Assumption(
            "the network is on in the end",
            bool(engaged[-1]),
            f"it is in {100.0 * float(engaged.mean()):.3g} % of the cycles",
            needed=True,
        ),
        Assumption(
            "the hub is rigid, tau turns it", False, "bending, shaft and current loop are in w"
        ),
        never("the gap is never open", opened, "it is in {}"),
        never("tuning rests in no cycle", ~moving(run), "the dead band holds it in {}"),
        Assumption(
            "tau is not limited",
            bool((tau < limit).all()),
            f"up to {tau.max():.3g} of {limit:g} N m",
        ),
    )


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    kv, kz, z_bound, kappa = run.laws("kv_Nms_rad", "kz", "z_bound", "kappa")
    rotor = run.setting(f"{PLANT}motor_inertia_kg_m2") * run.setting(f"{PLANT}gear_ratio") ** 2
    m = run.setting(f"{PLANT}rigid_inertia_kg_m2") + rotor
    r, m_r_rate = signals(run, m)
    state, phi = run.state(f"{LAW}w", ALL), run.array(f"{LAW}phi", ALL)
    hidden = Hidden(run.state(f"{LAW}v", INPUTS, NODES), run.array(f"{LAW}x", INPUTS), phi)
    y, robust = inner(state.w, phi), kz * (norm(state.w, hidden.v.w) + z_bound)
    f = m_r_rate + (kv * r + y + robust * r)  # (1) (2), less u_F, which is the run's as well
    r_t, w, v = layers(run, f, state, hidden)
    flat, _, turned = hidden.linear
    cancelled = inner(w.lacks, flat) + inner(w.w[:, 1 : 1 + NODES], turned)
    rest = f - y - cancelled  # (3)
    inside = 0.5 * m * (run.after(r) ** 2 - r**2) / run.period_s - r * m_r_rate
    layer_constants = hidden.constants(w.norm, float(np.abs(f - hidden.known @ w.ideal)[:-1].max()))
    return layered(
        run,
        ("Theorem 3.2.2, for a rigid hub", "|r| [rad/s]"),
        (w, v),
        rates=(w.part("F", w.rate, NEAR), w.part("FJ", run.rate("fj_rate"), FAR), v),
        v=0.5 * m * r**2,  # (4)
        damping=kv * r**2 + robust * r**2,  # (5)
        terms={
            "r w, what no network cancels": r * rest,
            "leak of the weights": np.abs(r_t) * (kappa * (w.leaked + v.leaked)),
        },
        beyond={
            "tuning by what is measured, clipped, in a dead band": (r - r_t) * cancelled,
            "r within a cycle, jumps of the reference": inside,
        },
        error=np.abs(r),
        rest=np.abs(rest),
        constants=Constants(kv + kz * z_bound, kappa, *layer_constants, low=m, high=m),
        asked=asked(run),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w", "v", "x", "phi"))
RATES = ("f_rate", "fj_rate", "g_rate")
THEOREMS = {
    law: Theorem(prove, STATES, RATES) for law in ("pd_nn", "pd_nn_fast", "nn_backstepping")
}

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

import math

import numpy as np

from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    Theorem,
    fitted_weights,
    inner,
    linearised,
    logistic,
    never,
    positive,
    rates_positive,
    size,
    with_threshold,
)
from pcpc.plants.weights import Weights

INPUTS, NODES, JUMPS = 7, 10, 4
R_MAX_RAD_S, DEAD_BAND_RAD = 0.3, 1e-4
LAW, PLANT, REFERENCE = "executive:controller.", "plant:barrel.", "executive:reference."


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    lam, kv, kz, z_bound, kappa, limit = run.laws(
        "lam_per_s", "kv_Nms_rad", "kz", "z_bound", "kappa", "tau_max_Nm"
    )
    rotor = run.setting(f"{PLANT}motor_inertia_kg_m2") * run.setting(f"{PLANT}gear_ratio") ** 2
    m = run.setting(f"{PLANT}rigid_inertia_kg_m2") + rotor
    turns = run.column(f"{PLANT}theta_rate_rad_s")
    e = run.column(f"{REFERENCE}q_d_rad") - run.column(f"{PLANT}theta_rad")
    e_rate = run.column(f"{REFERENCE}q_d_rate_rad_s") - turns
    acc_d = run.column(f"{REFERENCE}q_d_acc_rad_s2")
    r = e_rate + lam * e
    m_r_rate = m * (acc_d + lam * e_rate - (run.after(turns) - turns) / run.period_s)

    w = run.used(f"{LAW}w", 1 + NODES + JUMPS)
    v = run.used(f"{LAW}v", INPUTS, NODES)
    x, phi = run.array(f"{LAW}x", INPUTS), run.array(f"{LAW}phi", 1 + NODES + JUMPS)
    y, norm = inner(w, phi), np.sqrt(size(w) ** 2 + size(v) ** 2)
    asked = kv * r + y + kz * (norm + z_bound) * r
    f = m_r_rate + asked  # less u_F, which is the run's as well
    v_ideal = v[0]
    known = np.concatenate((with_threshold(logistic(x @ v_ideal)), phi[:, 1 + NODES :]), axis=1)
    w_ideal = fitted_weights(known[:-1], f[:-1, None])[:, 0]
    w_lacks, v_lacks = w_ideal - w, v_ideal - v
    flat, slope, turned = linearised(phi, v, x, v_lacks)
    cancelled = inner(w_lacks, flat) + inner(w[:, 1 : 1 + NODES], turned)
    rest = f - y - cancelled

    seen, off = run.column(f"{LAW}r_rad_s"), run.column(f"{LAW}e_rad")
    inside = 0.5 * m * (run.after(r) ** 2 - r**2) / run.period_s - r * m_r_rate
    engaged = run.column(f"{LAW}network_on") > 0.5
    tunes = (np.abs(off) > DEAD_BAND_RAD) | (np.abs(acc_d) > 1e-6)
    tuned = np.clip(seen, -R_MAX_RAD_S, R_MAX_RAD_S) * tunes * engaged
    moved = run.moved(f"{LAW}w", 1 + NODES + JUMPS)
    held = kappa * np.abs(tuned)
    back = slope * w[:, 1 : 1 + NODES] * tuned[:, None]
    drive = flat * tuned[:, None] - held[:, None] * w
    drive_v = x[:, :, None] * back[:, None, :] - held[:, None, None] * v
    near, far = slice(0, 1 + NODES), slice(1 + NODES, None)
    weights = (
        Weights("F", run.rate("f_rate"), w_lacks[:, near], moved[:, near], drive[:, near]),
        Weights("FJ", run.rate("fj_rate"), w_lacks[:, far], moved[:, far], drive[:, far]),
        Weights("G", run.rate("g_rate"), v_lacks, run.moved(f"{LAW}v", INPUTS, NODES), drive_v),
    )
    leak = kappa * (inner(w_lacks, w) + inner(v_lacks, v))
    outer, first = float(np.linalg.norm(w_ideal)), float(np.linalg.norm(v_ideal))
    eps = float(np.abs(f - known @ w_ideal)[:-1].max())
    tau, opened = run.column(f"{LAW}tau_Nm"), run.column(f"{PLANT}penetration_rad") == 0.0
    damping = kv + kz * z_bound
    return Proof(
        theorem="Theorem 3.2.2, for a rigid hub",
        error_is="|r| [rad/s]",
        t_s=run.t_s,
        v=0.5 * m * r**2 + sum(one.energy for one in weights),
        tuned=weights,
        damping=kv * r**2 + kz * (norm + z_bound) * r**2,
        terms={
            "r w, what no network cancels": r * rest,
            "leak of the weights": np.abs(tuned) * leak,
        },
        beyond={
            "tuning by what is measured, clipped, in a dead band": (r - tuned) * cancelled,
            "r within a cycle, jumps of the reference": inside,
        },
        error=np.abs(r),
        weights=np.sqrt(size(w_lacks) ** 2 + size(v_lacks) ** 2),
        rest=np.abs(rest),
        constants=Constants(
            damping=damping,
            kappa=kappa,
            ideal=math.hypot(outer, first),
            c0=eps + outer * math.sqrt(NODES),
            c1=(float(size(x @ v_ideal).max()) + outer * float(size(x).max())) / 4.0,
            low=m,
            high=m,
            gamma=min(one.metric for one in weights),
        ),
        asked=(
            rates_positive(weights),
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
            never("tuning rests in no cycle", ~tunes, "the dead band holds it in {}"),
            Assumption(
                "tau is not limited",
                bool((np.abs(tau) < limit).all()),
                f"up to {np.abs(tau).max():.3g} of {limit:g} N m",
            ),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w", "v", "x", "phi"))
RATES = ("f_rate", "fj_rate", "g_rate")
THEOREMS = {
    law: Theorem(prove, STATES, RATES) for law in ("pd_nn", "pd_nn_fast", "nn_backstepping")
}

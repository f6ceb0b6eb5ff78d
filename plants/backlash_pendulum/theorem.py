"""The theorem of chapter 5.2 on runs of the pendulum behind a gap: its proof term by term.

    r'  = -Kv r - tt,  tau' = phi + B                        B: what the gap takes of phi    (1)
    tt' = -Kb tt - v2 + y - B + (tau_d' - D)                                                 (2)
    B - (tau_d' - D) = W*'s(V*'x) + eps                                                      (3)
    w   = y - B + (tau_d' - D) + W~'(s - s'z) + W's'V~'x,  z = V'x                           (4)
        = -[W*'(s* - s - s'(z* - z)) + W~'s'z* + eps]
    V   = r^2/2 + tt^2/2 + |W~|^2/(2 S) + |V~|^2/(2 T_V)                                     (5)
    V'  = -[Kv r^2 + r tt + Kb tt^2 + v2 tt] + tt w + kappa |tt| tr(Z~'Z)                    (6)

B is of the plant's own torque, phi of the command; tau_d' is the difference quotient of tau_d. The
last two terms of (4) are what tuning cancels. A half of Kv is left for r, so that of tt^2

    K = Kb + Kz1 Z_M - 1/(2 Kv).

V* is V as drawn, W* comes of least squares: any choice obeys (6). eps is the largest of the run,
for in the gap B is no function of x. rad, rad/s, N m. Source: Lewis, Campos, Selmic (SIAM 2002),
chapter 5.2.
"""

import math

import numpy as np

from pcpc.plants.lyapunov import Asked, Constants, Proof
from pcpc.plants.theorem import (
    Theorem,
    Told,
    fitted,
    inner,
    logistic,
    rates_positive,
    size,
    with_threshold,
)
from pcpc.plants.weights import Weights

INPUTS, NODES = 6, 10
STATE, PLANT = "executive:controller.", "plant:pendulum."


def prove(told: Told) -> Proof:
    """Return the proof of a run."""
    period = told.period_s
    lam, kv, kb, kz1, z_bound, kappa = (
        told.law(name)
        for name in ("lam_per_s", "kv_Nms_rad", "kb_per_s", "kz1_per_s", "z_bound", "kappa")
    )
    e1 = told.column(f"{PLANT}q_rad") - told.column("executive:reference.q_d_rad")
    e2 = told.column(f"{PLANT}rate_rad_s") - told.column("executive:reference.q_d_rate_rad_s")
    r = e2 + lam * e1
    tau, tau_d = told.column(f"{PLANT}torque_Nm"), told.column(f"{STATE}tau_d_Nm")
    tt, command = tau_d - tau, told.column(f"{STATE}u_Nm")
    phi = (command - told.earlier(f"{STATE}u_Nm")) / period
    y, robust = told.column(f"{STATE}network_Nm_s"), told.column(f"{STATE}robust_Nm_s")
    derivative = phi - kb * tt - robust + y
    taken = (told.after(tau) - tau) / period - phi
    lags = (told.after(tau_d) - tau_d) / period - derivative

    w = told.used(f"{STATE}w", 1 + NODES)
    v = told.used(f"{STATE}v", INPUTS, NODES)
    x = told.array(f"{STATE}x", INPUTS)
    z = np.einsum("nij,ni->nj", v, x)
    s = with_threshold(logistic(z))
    slope = s[:, 1:] * (1.0 - s[:, 1:])
    v_ideal, target = v[0], taken - lags
    known = with_threshold(logistic(x @ v_ideal))
    w_ideal = fitted(known[:-1], target[:-1, None])[:, 0]
    w_lacks, v_lacks = w_ideal - w, v_ideal - v
    flat = np.concatenate((s[:, :1], s[:, 1:] - slope * z), axis=1)
    turned = slope * np.einsum("nij,ni->nj", v_lacks, x)
    rest = y - target + inner(w_lacks, flat) + inner(w[:, 1:], turned)

    leak = kappa * np.abs(tt)
    back = -slope * w[:, 1:] * tt[:, None]
    drive = -flat * tt[:, None] - leak[:, None] * w
    drive_v = x[:, :, None] * back[:, None, :] - leak[:, None, None] * v
    moved, moved_v = (
        told.array(f"{STATE}w", 1 + NODES) - w,
        told.array(f"{STATE}v", INPUTS, NODES) - v,
    )
    weights = (
        Weights("S", told.rate("s_rate"), w_lacks, moved, drive),
        Weights("T_V", told.rate("t_rate"), v_lacks, moved_v, drive_v),
    )
    lacks = np.sqrt(size(w_lacks) ** 2 + size(v_lacks) ** 2)
    outer = float(np.linalg.norm(w_ideal))
    eps = float(np.abs(target - known @ w_ideal)[:-1].max())
    acts = told.after(told.column(f"{PLANT}acting_Nm"))
    resting = (told.after(tau) == tau) & (phi != 0.0)
    weight = (told.setting(f"{PLANT}{name}") for name in ("mass_kg", "gravity_m_s2", "length_m"))
    off_weight = abs(told.law("model_gravity_Nm") - math.prod(weight))
    off_time = abs(told.law("model_time_constant_s") - told.setting(f"{PLANT}time_constant_s"))
    late = float(np.abs(acts - told.column(f"{STATE}command_Nm"))[:-1].max())
    return Proof(
        theorem="theorem of chapter 5.2",
        error_is="|tt| [N m]",
        t_s=told.t_s,
        v=0.5 * (r**2 + tt**2) + sum(one.stored for one in weights),
        tuned=weights,
        damping=kv * r**2 + r * tt + kb * tt**2 + robust * tt,
        terms={
            "tt w, gap and filter": tt * rest,
            "leak of the weights": leak * (inner(w_lacks, w) + inner(v_lacks, v)),
        },
        error=np.abs(tt),
        weights=lacks,
        rest=np.abs(rest),
        constants=Constants(
            damping=kb + kz1 * z_bound * told.law("robust_on") - 0.5 / kv,
            kappa=kappa,
            ideal=math.hypot(outer, float(np.linalg.norm(v_ideal))),
            c0=eps + outer * math.sqrt(NODES),
            c1=(float(size(x @ v_ideal).max()) + outer * float(size(x).max())) / 4.0,
            gamma=min(one.metric for one in weights),
            other_rate=0.5 * kv,
        ),
        asked=(
            rates_positive(weights),
            Asked("leak kappa above 0", kappa > 0.0, f"kappa {kappa:g}", needed=True),
            Asked(
                "the network is on",
                told.law("network_on") > 0.5,
                f"network_on {told.law('network_on'):g}",
                needed=True,
            ),
            Asked(
                "the model of the pendulum is exact",
                max(off_weight, off_time) < 1e-9,
                f"G is off by {off_weight:.3g} N m, T_m by {off_time:.3g} s",
            ),
            Asked(
                "the gap is never open",
                not resting.any(),
                f"tau rests in {100.0 * float(resting.mean()):.3g} % of the cycles",
            ),
            Asked("what acts is u", late < 1e-9, f"they differ by up to {late:.2g} N m"),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w", "v", "x"))
THEOREMS = {"backlash_nn": Theorem(prove, STATES, ("s_rate", "t_rate"))}

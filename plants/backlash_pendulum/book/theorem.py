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
    switched_on,
    with_threshold,
)
from pcpc.plants.weights import Weights

INPUTS, NODES = 6, 10
STATE, PLANT = "executive:controller.", "plant:pendulum."


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    period = run.period_s
    lam, kv, kb, kz1, z_bound, kappa = run.laws(
        "lam_per_s", "kv_Nms_rad", "kb_per_s", "kz1_per_s", "z_bound", "kappa"
    )
    e1 = run.column(f"{PLANT}q_rad") - run.column("executive:reference.q_d_rad")
    e2 = run.column(f"{PLANT}rate_rad_s") - run.column("executive:reference.q_d_rate_rad_s")
    r = e2 + lam * e1
    tau, tau_d = run.column(f"{PLANT}torque_Nm"), run.column(f"{STATE}tau_d_Nm")
    tt, command = tau_d - tau, run.column(f"{STATE}u_Nm")
    phi = (command - run.earlier(f"{STATE}u_Nm")) / period
    y, robust = run.column(f"{STATE}network_Nm_s"), run.column(f"{STATE}robust_Nm_s")
    derivative = phi - kb * tt - robust + y
    taken = (run.after(tau) - tau) / period - phi
    lags = (run.after(tau_d) - tau_d) / period - derivative

    w = run.used(f"{STATE}w", 1 + NODES)
    v = run.used(f"{STATE}v", INPUTS, NODES)
    x = run.array(f"{STATE}x", INPUTS)
    s = with_threshold(logistic(np.einsum("nij,ni->nj", v, x)))
    v_ideal, target = v[0], taken - lags
    known = with_threshold(logistic(x @ v_ideal))
    w_ideal = fitted_weights(known[:-1], target[:-1, None])[:, 0]
    w_lacks, v_lacks = w_ideal - w, v_ideal - v
    flat, slope, turned = linearised(s, v, x, v_lacks)
    rest = y - target + inner(w_lacks, flat) + inner(w[:, 1:], turned)

    leak = kappa * np.abs(tt)
    back = -slope * w[:, 1:] * tt[:, None]
    drive = -flat * tt[:, None] - leak[:, None] * w
    drive_v = x[:, :, None] * back[:, None, :] - leak[:, None, None] * v
    moved, moved_v = run.moved(f"{STATE}w", 1 + NODES), run.moved(f"{STATE}v", INPUTS, NODES)
    weights = (
        Weights("S", run.rate("s_rate"), w_lacks, moved, drive),
        Weights("T_V", run.rate("t_rate"), v_lacks, moved_v, drive_v),
    )
    lacks = np.sqrt(size(w_lacks) ** 2 + size(v_lacks) ** 2)
    outer = float(np.linalg.norm(w_ideal))
    eps = float(np.abs(target - known @ w_ideal)[:-1].max())
    acts = run.after(run.column(f"{PLANT}acting_Nm"))
    resting = (run.after(tau) == tau) & (phi != 0.0)
    weight = run.settings(PLANT, ("mass_kg", "gravity_m_s2", "length_m"))
    off_weight = abs(run.law("model_gravity_Nm") - math.prod(weight))
    off_time = abs(run.law("model_time_constant_s") - run.setting(f"{PLANT}time_constant_s"))
    late = float(np.abs(acts - run.column(f"{STATE}command_Nm"))[:-1].max())
    return Proof(
        theorem="theorem of chapter 5.2",
        error_is="|tt| [N m]",
        t_s=run.t_s,
        v=0.5 * (r**2 + tt**2) + sum(one.energy for one in weights),
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
            damping=kb + kz1 * z_bound * run.law("robust_on") - 0.5 / kv,
            kappa=kappa,
            ideal=math.hypot(outer, float(np.linalg.norm(v_ideal))),
            c0=eps + outer * math.sqrt(NODES),
            c1=(float(size(x @ v_ideal).max()) + outer * float(size(x).max())) / 4.0,
            gamma=min(one.metric for one in weights),
            other_rate=0.5 * kv,
        ),
        asked=(
            rates_positive(weights),
            positive("leak kappa", kappa),
            switched_on(run, "the network is on", "network_on"),
            Assumption(
                "the model of the pendulum is exact",
                max(off_weight, off_time) < 1e-9,
                f"G is off by {off_weight:.3g} N m, T_m by {off_time:.3g} s",
            ),
            never("the gap is never open", resting, "tau rests in {}"),
            Assumption("what acts is u", late < 1e-9, f"they differ by up to {late:.2g} N m"),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w", "v", "x"))
THEOREMS = {"backlash_nn": Theorem(prove, STATES, ("s_rate", "t_rate"))}

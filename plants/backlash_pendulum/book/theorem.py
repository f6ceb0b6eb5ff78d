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
    switched_on,
)
from pcpc.plants.weights import Layer, Vector

INPUTS, NODES = 6, 10
STATE, PLANT = "executive:controller.", "plant:pendulum."


def signals(run: Cycles) -> tuple[Vector, ...]:
    """Return r, tt, phi, and the left side of (3), (n,) each."""
    lam, kb = run.laws("lam_per_s", "kb_per_s")
    e1 = run.column(f"{PLANT}q_rad") - run.column("executive:reference.q_d_rad")
    e2 = run.column(f"{PLANT}rate_rad_s") - run.column("executive:reference.q_d_rate_rad_s")
    tau, tau_d = run.column(f"{PLANT}torque_Nm"), run.column(f"{STATE}tau_d_Nm")
    phi = (run.column(f"{STATE}u_Nm") - run.earlier(f"{STATE}u_Nm")) / run.period_s
    y, v2 = run.column(f"{STATE}network_Nm_s"), run.column(f"{STATE}robust_Nm_s")
    tt = tau_d - tau
    taken = run.slope(tau) - phi  # B of (1)
    lags = run.slope(tau_d) - (phi - kb * tt - v2 + y)  # tau_d' - D of (2)
    return e2 + lam * e1, tt, phi, taken - lags


def layers(run: Cycles, tt: Vector, target: Vector, hidden: Hidden) -> tuple[Layer, Layer]:
    """Return W, with W* of (3), and V; what tunes them cancels the last two terms of (4)."""
    w = run.state(f"{STATE}w", 1 + NODES)
    ideal = fitted_weights(hidden.known[:-1], target[:-1])
    flat, slope, _ = hidden.linear
    leak = run.law("kappa") * np.abs(tt)
    back = -slope * w.w[:, 1:] * tt[:, None]
    return (
        w.layer("S", run.rate("s_rate"), ideal, -flat * tt[:, None], leak),
        hidden.layer("T_V", run.rate("t_rate"), back, leak),
    )


def model_exact(run: Cycles) -> Assumption:
    """Return whether the law knows the pendulum's G and T_m."""
    weight = run.settings(PLANT, ("mass_kg", "gravity_m_s2", "length_m"))
    off_weight = abs(run.law("model_gravity_Nm") - math.prod(weight))
    off_time = abs(run.law("model_time_constant_s") - run.setting(f"{PLANT}time_constant_s"))
    return Assumption(
        "the model of the pendulum is exact",
        max(off_weight, off_time) < 1e-9,
        f"G is off by {off_weight:.3g} N m, T_m by {off_time:.3g} s",
    )


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    kv, kb, kz1, z_bound, on, kappa = run.laws(
        "kv_Nms_rad", "kb_per_s", "kz1_per_s", "z_bound", "robust_on", "kappa"
    )
    r, tt, phi, target = signals(run)
    y, v2 = run.column(f"{STATE}network_Nm_s"), run.column(f"{STATE}robust_Nm_s")
    hidden = Hidden.of(run.state(f"{STATE}v", INPUTS, NODES), run.array(f"{STATE}x", INPUTS))
    w, v = layers(run, tt, target, hidden)
    flat, _, turned = hidden.linear
    rest = y - target + inner(w.lacks, flat) + inner(w.w[:, 1:], turned)  # (4)
    eps = float(np.abs(target - hidden.known @ w.ideal)[:-1].max())
    k = kb + kz1 * z_bound * on - 0.5 / kv
    tau, acts = run.column(f"{PLANT}torque_Nm"), run.after(run.column(f"{PLANT}acting_Nm"))
    rests = (run.after(tau) == tau) & (phi != 0.0)
    late = float(np.abs(acts - run.column(f"{STATE}command_Nm"))[:-1].max())
    return layered(
        run,
        ("theorem of chapter 5.2", "|tt| [N m]"),
        (w, v),
        v=0.5 * (r**2 + tt**2),  # (5)
        damping=kv * r**2 + r * tt + kb * tt**2 + v2 * tt,  # (6)
        terms={
            "tt w, gap and filter": tt * rest,
            "leak of the weights": kappa * np.abs(tt) * (w.leaked + v.leaked),
        },
        error=np.abs(tt),
        rest=np.abs(rest),
        constants=Constants(k, kappa, *hidden.constants(w.norm, eps), other_rate=0.5 * kv),
        asked=(
            positive("leak kappa", kappa),
            switched_on(run, "the network is on", "network_on"),
            model_exact(run),
            never("the gap is never open", rests[:-1], "tau rests in {}"),
            Assumption("what acts is u", late < 1e-9, f"they differ by up to {late:.2g} N m"),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w", "v", "x"))
THEOREMS = {"backlash_nn": Theorem(prove, STATES, ("s_rate", "t_rate"))}

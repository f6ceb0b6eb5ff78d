"""The theorem of chapter 5.3 on runs of the map behind a gap: exact, from step to step.

    sg  = tt + c_r r,  sg+ = m W~'s + w                                                      (1)
    w   = Y - m W*'s + g,  Y = tau_d+ - m (tau_d + step - Kb tt) + c_r r+,
          |g| <= m (d+ - d-)/2: what play does to a command, in contact or not               (2)
    W+  = W + alpha s sg+ - G W,  G = Gam |I - alpha s s'|                                   (3)
    V   = sg^2/2 + m |W~|^2/(2 alpha)                                                        (4)
    V+ - V = -[sg^2 + (1 - m alpha |s|^2) sg+^2]/2 + sg+ w
             + (m G/alpha) W~'W - m G sg+ s'W + m G^2 |W|^2/(2 alpha)                        (5)

by (1) and (3) without a rest; m: slope of the gap's flanks. W*'s fits Y/m by least squares over the
run; `step`: the law's g. The error of a step is that after it, |sg+|; |s|^2 <= 11 for ten smooth
nodes and one jump node gives K = (1 - 11 m alpha)/2. With (1), r+ = (Kv + c_r) r - sg: |r| is at
most |sg|/(1 - |Kv + c_r|) after its transient. Source: Lewis, Campos, Selmic (SIAM 2002), chapter
5.3.
"""

import numpy as np

from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    Theorem,
    fitted_weights,
    inner,
    never,
    positive,
    rates_positive,
    size,
    switched_on,
)
from pcpc.plants.weights import Weights

NODES, JUMPS = 10, 2
STATE, GOAL = "executive:controller.", "executive:reference.now"


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    lam, kv, kb, gam, cr = run.laws("lam", "kv", "kb", "gamma", "cr")
    alpha, m = run.rate("alpha"), run.setting("plant:map.slope")
    rate = abs(alpha) or 1.0
    gap = run.setting("plant:map.d_plus") - run.setting("plant:map.d_minus")
    x1, x2, tau = (run.column(f"plant:map.{name}") for name in ("x1", "x2", "tau"))
    x_d, x_d_before = run.column(GOAL), run.earlier(GOAL)
    r = x2 - x_d + lam * (x1 - x_d_before)
    tau_d, foretold = run.column(f"{STATE}tau_d"), run.column(f"{STATE}foretold")
    tt = tau_d - tau
    sg = tt + cr * r
    after = run.after(sg)
    s = run.array(f"{STATE}s", 1 + NODES + JUMPS)[:, 1:]
    w = run.array(f"{STATE}w", NODES + JUMPS)
    wanted = run.after(tau_d) - m * (foretold - kb * tt) + cr * run.after(r)
    ideal = fitted_weights(s[:-1], wanted[:-1, None] / m)[:, 0]
    lacks, square = ideal - w, inner(s, s)
    rest = after - m * inner(lacks, s)
    forgets = gam * np.maximum(1.0, np.abs(1.0 - alpha * square))
    leak = (
        (m / rate) * forgets * inner(lacks, w)
        - m * forgets * after * inner(s, w)
        + 0.5 * m * forgets**2 * inner(w, w) / rate
    )
    moved = np.concatenate((np.diff(w, axis=0), np.zeros_like(w[:1])))
    drive = s * after[:, None] - (forgets / rate)[:, None] * w
    weights = Weights("alpha", alpha, lacks, moved, drive)
    kappa = m * gam / rate
    extra = np.maximum(leak - kappa * inner(lacks, w), 0.0)
    damping = 0.5 * (1.0 - m * alpha * (NODES + 1.0))
    eps = float(np.abs(wanted - m * (s @ ideal))[:-1].max())
    command, limit = run.column(f"{STATE}command"), run.law("u_max")
    resting = run.after(tau) == tau
    contracts = 1.0 - abs(kv + cr)
    late = run.t_s >= run.t_s[len(run.t_s) // 2]
    reach = float(np.abs(sg[late]).max()) / max(contracts, 1e-9)
    return Proof(
        theorem="theorem of chapter 5.3",
        error_is="|tt + c_r r| after the step",
        t_s=run.t_s,
        v=0.5 * sg**2 + m * weights.energy,
        tuned=(weights,),
        damping=0.5 * sg**2 + 0.5 * (1.0 - m * alpha * square) * after**2,
        terms={"sg+ w, prediction and gap": after * rest, "forgetting of the weights": leak},
        error=np.abs(after),
        weights=size(lacks),
        rest=np.abs(rest),
        extra=extra,
        constants=Constants(
            damping=damping,
            kappa=kappa,
            ideal=float(np.linalg.norm(ideal)),
            c0=eps + 0.5 * m * gap,
            gamma=rate / m,
            leak="constant",
            extra=float(extra.max()),
        ),
        asked=(
            rates_positive([weights]),
            positive("forgetting Gam", gam),
            switched_on(run, "the network is on", "network_on"),
            Assumption(
                "11 m alpha < 1, |Kv + c_r| < 1",
                damping > 0.0 and contracts > 0.0,
                f"K {damping:.3g}, Kv + c_r {kv + cr:.3g}",
                needed=True,
            ),
            Assumption(
                "the model is exact",
                run.law("model_c") == run.setting("plant:map.c"),
                f"c {run.setting('plant:map.c'):g}, as known {run.law('model_c'):g}",
            ),
            never("the gap is never open", resting, "tau rests in {}"),
            Assumption(
                "u is not limited",
                bool((np.abs(command) < limit).all()),
                f"|u| up to {np.abs(command).max():.3g} of {limit:g}",
            ),
            Assumption(
                "|r| <= |tt + c_r r|/(1 - |Kv + c_r|) in the second half",
                float(np.abs(r[late]).max()) <= reach,
                f"{np.abs(r[late]).max():.3g} of {reach:.3g}",
            ),
        ),
        step_s=1.0,
    )


STATES = ("controller.w_*", "controller.s_*")
THEOREMS = {"backlash_nn_discrete": Theorem(prove, STATES, ("alpha",))}

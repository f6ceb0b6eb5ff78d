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
    layered,
    never,
    positive,
    switched_on,
)
from pcpc.plants.weights import Layer, State, Vector

NODES, JUMPS = 10, 2
STATE, GOAL = "executive:controller.", "executive:reference.now"


def signals(run: Cycles) -> tuple[Vector, ...]:
    """Return r, sg, Y of (1) (2), (n,) each."""
    lam, kb, cr = run.laws("lam", "kb", "cr")
    x1, x2, tau = (run.column(f"plant:map.{name}") for name in ("x1", "x2", "tau"))
    r = x2 - run.column(GOAL) + lam * (x1 - run.earlier(GOAL))
    tau_d, foretold = run.column(f"{STATE}tau_d"), run.column(f"{STATE}foretold")
    tt = tau_d - tau
    predicted = run.setting("plant:map.slope") * (foretold - kb * tt)
    return r, tt + cr * r, run.after(tau_d) - predicted + cr * run.after(r)


def bound(run: Cycles, w: Layer, eps: float, extra: float) -> Constants:
    """Return the constants for the largest eps of Y and the largest `extra`."""
    m = run.setting("plant:map.slope")
    gap = run.setting("plant:map.d_plus") - run.setting("plant:map.d_minus")
    return Constants(
        damping=0.5 * (1.0 - m * w.rate * (NODES + 1.0)),
        kappa=m * run.law("gamma") / w.metric,
        ideal=w.norm,
        c0=eps + 0.5 * m * gap,
        leak="constant",
        extra=extra,
    )


def asked(run: Cycles, r: Vector, sg: Vector, damping: float) -> tuple[Assumption, ...]:
    """Return what the theorem asks of a run."""
    kv, cr, known, limit = run.laws("kv", "cr", "model_c", "u_max")
    true, contracts = run.setting("plant:map.c"), 1.0 - abs(kv + cr)
    tau, command = run.column("plant:map.tau"), np.abs(run.column(f"{STATE}command"))
    late = run.t_s >= run.t_s[len(run.t_s) // 2]
    largest, reach = np.abs(r[late]).max(), np.abs(sg[late]).max() / max(contracts, 1e-9)
    return (
        positive("forgetting Gam", run.law("gamma")),
        switched_on(run, "the network is on", "network_on"),
        Assumption(
            "11 m alpha < 1, |Kv + c_r| < 1",
            damping > 0.0 and contracts > 0.0,
            f"K {damping:.3g}, Kv + c_r {kv + cr:.3g}",
            needed=True,
        ),
        Assumption("the model is exact", known == true, f"c {true:g}, as known {known:g}"),
        never("the gap is never open", (run.after(tau) == tau)[:-1], "tau rests in {}"),
        Assumption(
            "u is not limited",
            bool((command < limit).all()),
            f"|u| up to {command.max():.3g} of {limit:g}",
        ),
        Assumption(
            "|r| <= |tt + c_r r|/(1 - |Kv + c_r|) in the second half",
            bool(largest <= reach),
            f"{largest:.3g} of {reach:.3g}",
        ),
    )


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    m, alpha, gam = run.setting("plant:map.slope"), run.rate("alpha"), run.law("gamma")
    r, sg, wanted = signals(run)
    after, s = run.after(sg), run.array(f"{STATE}s", 1 + NODES + JUMPS)[:, 1:]
    square, state = inner(s, s), State.of_steps(run.array(f"{STATE}w", NODES + JUMPS))
    forgets = gam * np.maximum(1.0, np.abs(1.0 - alpha * square))  # (3)
    ideal, rate = fitted_weights(s[:-1], wanted[:-1] / m), abs(alpha) or 1.0
    w = state.layer("alpha", alpha, ideal, s * after[:, None], forgets / rate)
    leak = (  # of (5)
        (m / rate) * forgets * w.leaked
        - m * forgets * after * inner(s, w.w)
        + 0.5 * m * forgets**2 * inner(w.w, w.w) / rate
    )
    rest = after - m * inner(w.lacks, s)  # w of (1)
    extra = np.maximum(leak - m * gam / rate * w.leaked, 0.0)
    eps = float(np.abs(wanted - m * (s @ ideal))[:-1].max())
    constants = bound(run, w, eps, float(extra.max()))
    return layered(
        run,
        ("theorem of chapter 5.3", "|tt + c_r r| after the step"),
        (w,),
        scale=m,
        v=0.5 * sg**2,  # (4)
        damping=0.5 * sg**2 + 0.5 * (1.0 - m * alpha * square) * after**2,  # (5)
        terms={"sg+ w, prediction and gap": after * rest, "forgetting of the weights": leak},
        error=np.abs(after),
        rest=np.abs(rest),
        extra=extra,
        constants=constants,
        asked=asked(run, r, sg, constants.damping),
        step_s=1.0,
    )


STATES = ("controller.w_*", "controller.s_*")
THEOREMS = {"backlash_nn_discrete": Theorem(prove, STATES, ("alpha",))}

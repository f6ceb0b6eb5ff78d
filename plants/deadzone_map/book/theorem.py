"""The theorem of chapter 4.3 on runs of the map behind a deadzone: exact, from step to step.

    r+ = Kv r - X'd~ + w,  d~ = D - d                                                        (1)
    d+ = d - alpha X r+ - Gam d,  |X| = 1                                                    (2)
    V  = r^2/2 + |d~|^2/(2 alpha)                                                            (3)
    V+ - V = -[r^2/2 - (1 - Gam) Kv r r+ + (1 - alpha - 2 Gam) r+^2/2]
             + (1 - Gam) r+ w + Gam r+ X'D + (1 - Gam/2) (Gam/alpha) d~'d
             + Gam^2 D'd/(2 alpha)                                                           (4)

by (1) (2) without a rest, for alpha below 1, where the norm in the law's decay is 1. D, the true
widths, are the ideal weights. w: F against what the law knows of it, and what the deadzone does to
a command that does not leave it, at most the true width. The error of a step is that after it, r+;
K = (1 - alpha - 2 Gam - (1 - Gam)^2 Kv^2)/2. The last term counts for |d| up to 2 |D|. Source:
Lewis, Campos, Selmic (SIAM 2002), chapter 4.3.
"""

import numpy as np

from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import Cycles, Theorem, inner, never, positive, rates_positive, size
from pcpc.plants.weights import Weights

MARGIN = 1.25  # of the range that w is looked for in, over that of the run
STATE, GOAL = "executive:controller.", "executive:reference.now"


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    kv, lam, known, gam = run.laws("kv", "lam", "model_c", "gam")
    alpha = run.rate("alpha")
    rate = abs(alpha) or 1.0
    true, width = run.setting("plant:map.c"), run.setting("plant:map.d")
    x1, x2 = run.column("plant:map.x1"), run.column("plant:map.x2")
    before, now = run.earlier(GOAL), run.column(GOAL)
    r = x2 - now + lam * (x1 - before)
    after = run.after(r)
    d = np.stack((run.column(f"{STATE}width_plus"), run.column(f"{STATE}width_minus")), axis=1)
    x = np.stack((run.column(f"{STATE}fired_plus"), run.column(f"{STATE}fired_minus")), axis=1)
    lacks = width - d
    moved = np.concatenate((np.diff(d, axis=0), np.zeros_like(d[:1])))
    drive = -x * after[:, None] - (gam / rate) * d
    weights = Weights("alpha", alpha, lacks, moved, drive)
    tau_d, command = run.column(f"{STATE}tau_d"), run.column(f"{STATE}command")
    acts = run.after(run.column("plant:map.tau"))
    bend = (known - true) * x1 / (1.0 + x2**2)
    w = bend + acts - tau_d + inner(x, lacks)
    ideal = width * np.ones_like(d)
    fired = inner(x, ideal)
    error = np.abs(after)
    damping = 0.5 * (1.0 - alpha - 2.0 * gam - ((1.0 - gam) * kv) ** 2)
    norm = float(np.sqrt(2.0)) * width
    rest = (1.0 - gam) * w + gam * fired
    reach = MARGIN * float(np.abs(x1).max())
    inside = np.abs(command) < width
    return Proof(
        theorem="theorem of chapter 4.3",
        error_is="|r| after the step",
        t_s=run.t_s,
        v=0.5 * r**2 + weights.stored,
        tuned=(weights,),
        damping=0.5 * r**2
        - (1.0 - gam) * kv * r * after
        + 0.5 * (1.0 - alpha - 2.0 * gam) * after**2,
        terms={
            "r+ w, model and deadzone": (1.0 - gam) * after * w,
            "forgetting of the widths": gam * after * fired
            + (1.0 - 0.5 * gam) * (gam / rate) * inner(lacks, d)
            + 0.5 * gam**2 * inner(ideal, d) / rate,
        },
        error=error,
        weights=size(lacks),
        rest=np.abs(rest),
        extra=0.5 * gam**2 * np.maximum(inner(ideal, d), 0.0) / rate,
        constants=Constants(
            damping=damping,
            kappa=(gam / rate) * (1.0 - 0.5 * gam),
            ideal=norm,
            c0=abs(known - true) * reach + (1.0 - gam) * width + gam * width,
            gamma=rate,
            leak="constant",
            extra=gam**2 * norm**2 / rate,
        ),
        asked=(
            rates_positive([weights]),
            positive("forgetting Gam", gam),
            Assumption(
                "Kv^2 < 1 - alpha, about",
                damping > 0.0,
                f"Kv {kv:g}, alpha {alpha:g}, K {damping:.3g}",
                needed=True,
            ),
            Assumption("the model is exact", known == true, f"c {true:g}, as known {known:g}"),
            never("the command leaves the deadzone", inside, "it does not in {}"),
        ),
        ideal_by="the true widths",
        step_s=1.0,
    )


THEOREMS = {"deadzone_fuzzy": Theorem(prove, (), ("alpha",))}

"""The theorem of chapter 4.3 on runs of two coupled chains: exact, from step to step.

(1) to (4) of plants/deadzone_map/book/theorem.py for either chain; V is the sum of both. What one
chain does to the other and the law does not know counts to w, as the model's error does. The error
of a step is the size of both r after it. With a gap instead of a deadzone there is no theorem here.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3, for m inputs.
"""

import numpy as np

from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    NoTheorem,
    Theorem,
    inner,
    never,
    positive,
    rates_positive,
    size,
)
from pcpc.plants.weights import Vector, Weights

MARGIN = 1.25  # of the range that w is looked for in, over that of the run
CHAINS, LAW, PLANT = "ab", "executive:controller.", "plant:chains."


def both(run: Cycles, name: str) -> Vector:
    """Return NAME with {} for a, b, (n, 2)."""
    return np.stack([run.column(name.format(chain)) for chain in CHAINS], axis=1)


def drift(x: tuple[Vector, Vector, Vector], order: float, c: float, kappa: float) -> Vector:
    """Return F of both chains, (n, 2); x: x1, x2, x3."""
    first = x[0] if order > 2.5 else x[1]
    bent = 1.0 + x[2] ** 2
    return -c * first / bent + x[2] + kappa * x[2][:, ::-1] / bent


def prove(run: Cycles) -> Proof:
    """Return the proof of a run; NoTheorem for chains with gaps."""
    if max(run.settings(PLANT, ("a_gap", "b_gap"))) > 0.0:
        raise NoTheorem("these chains have gaps, and the law's theorem is one of deadzones")
    kv, lam, lam_2, order, known, known_kappa, gam = run.laws(
        "kv", "lam", "lam_2", "order", "model_c", "model_coupling", "gam"
    )
    true, kappa, actual = run.settings(PLANT, ("c", "coupling", "order"))
    alpha = run.rate("alpha")
    rate = abs(alpha) or 1.0
    width = np.array(run.settings(PLANT, ("a_dead", "b_dead")))
    x = (both(run, PLANT + "{}_x1"), both(run, PLANT + "{}_x2"), both(run, PLANT + "{}_x3"))
    now, previous, older = (
        both(run, "executive:reference_{}." + name) for name in ("now", "previous", "older")
    )
    r = x[2] - now + lam * (x[1] - previous) + lam_2 * (x[0] - older)
    after = np.stack([run.after(column) for column in r.T], axis=1)
    d = np.stack([both(run, LAW + f"{{}}_width_{side}") for side in ("plus", "minus")], axis=2)
    fired = np.stack([both(run, LAW + f"{{}}_fired_{side}") for side in ("plus", "minus")], axis=2)
    ideal = np.broadcast_to(width[:, None], d.shape)
    lacks = ideal - d
    moved = np.concatenate((np.diff(d, axis=0), np.zeros_like(d[:1])))
    drive = -fired * after[:, :, None] - (gam / rate) * d
    weights = Weights("alpha", alpha, lacks, moved, drive)
    acts = np.stack([run.after(column) for column in both(run, PLANT + "{}_tau").T], axis=1)
    command = both(run, LAW + "{}_command")
    off = drift(x, actual, true, kappa) - drift(x, order, known, known_kappa)
    w = off + acts - both(run, LAW + "{}_tau_d") + np.sum(fired * lacks, axis=2)
    helps = np.sum(fired * ideal, axis=2)
    damping = 0.5 * (1.0 - alpha - 2.0 * gam - ((1.0 - gam) * kv) ** 2)
    norm = float(np.sqrt(2.0) * np.linalg.norm(width))
    reach = MARGIN * max(float(np.abs(one).max()) for one in x)
    apart = (abs(known - true) + abs(known_kappa - kappa)) * reach
    inside = np.asarray((np.abs(command) < width).any(axis=1))
    return Proof(
        theorem="theorem of chapter 4.3",
        error_is="|r| of both after the step",
        t_s=run.t_s,
        v=0.5 * size(r) ** 2 + weights.stored,
        tuned=(weights,),
        damping=0.5 * size(r) ** 2
        - (1.0 - gam) * kv * inner(r, after)
        + 0.5 * (1.0 - alpha - 2.0 * gam) * size(after) ** 2,
        terms={
            "r+ w, model, coupling, deadzones": (1.0 - gam) * inner(after, w),
            "forgetting of the widths": gam * inner(after, helps)
            + (1.0 - 0.5 * gam) * (gam / rate) * inner(lacks, d)
            + 0.5 * gam**2 * inner(ideal, d) / rate,
        },
        error=size(after),
        weights=size(lacks),
        rest=size((1.0 - gam) * w + gam * helps),
        extra=0.5 * gam**2 * np.maximum(inner(ideal, d), 0.0) / rate,
        constants=Constants(
            damping=damping,
            kappa=(gam / rate) * (1.0 - 0.5 * gam),
            ideal=norm,
            c0=float(np.sqrt(2.0)) * apart + float(np.linalg.norm(width)),
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
            Assumption(
                "the model is exact",
                (known, known_kappa, order) == (true, kappa, actual),
                f"c {true:g}, coupling {kappa:g}; as known {known:g}, {known_kappa:g}",
            ),
            never("the commands leave the deadzones", inside, "one does not in {}"),
        ),
        ideal_by="the true widths",
        step_s=1.0,
    )


THEOREMS = {"chains_fuzzy": Theorem(prove, (), ("alpha",))}

"""The proof of chapter 4.3 for one or several maps behind deadzones: exact, from step to step.

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
from pcpc.plants.theorem import Cycles, inner, never, positive, rates_positive, size
from pcpc.plants.weights import Vector, Weights

MARGIN = 1.25  # of the range that w is looked for in, over that of the run
SIDES = ("plus", "minus")


def proof(
    run: Cycles,
    r: Vector,
    after: Vector,
    d: Vector,
    fired: Vector,
    ideal: Vector,
    off: Vector,
    off_most: float,
    words: tuple[str, str],
    known: Assumption,
    inside: Assumption,
) -> Proof:
    """Return the proof of a run of m maps.

    r (n, m), `after` a step; d, X as `fired`, D as `ideal`, (n, m, 2); `off` (n, m): F less what
    the law knows of it, tau less what it wants; `off_most`: the most of F's part. `words`: of the
    error and of w.
    """
    kv, gam = run.laws("kv", "gam")
    alpha = run.rate("alpha")
    rate = abs(alpha) or 1.0
    lacks = ideal - d
    moved = np.concatenate((np.diff(d, axis=0), np.zeros_like(d[:1])))
    drive = -fired * after[:, :, None] - (gam / rate) * d
    weights = Weights("alpha", alpha, lacks, moved, drive)
    w = off + np.sum(fired * lacks, axis=2)
    helps = np.sum(fired * ideal, axis=2)
    damping = 0.5 * (1.0 - alpha - 2.0 * gam - ((1.0 - gam) * kv) ** 2)
    norm = float(np.linalg.norm(ideal[0]))
    return Proof(
        theorem="theorem of chapter 4.3",
        error_is=f"|r|{words[0]} after the step",
        t_s=run.t_s,
        v=0.5 * inner(r, r) + weights.energy,
        tuned=(weights,),
        damping=0.5 * inner(r, r)
        - (1.0 - gam) * kv * inner(r, after)
        + 0.5 * (1.0 - alpha - 2.0 * gam) * inner(after, after),
        terms={
            f"r+ w, {words[1]}": (1.0 - gam) * inner(after, w),
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
            c0=off_most + norm / float(np.sqrt(2.0)),
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
            known,
            inside,
        ),
        ideal_by="the true widths",
        step_s=1.0,
    )


def within(what: str, command: Vector, width: Vector, words: str) -> Assumption:
    """Return whether commands (n, m) leave their deadzones, of `width` (m,)."""
    return never(what, np.asarray((np.abs(command) < width).any(axis=1)), words)

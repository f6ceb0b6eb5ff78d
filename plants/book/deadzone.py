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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import Cycles, inner, layered, never, positive, size
from pcpc.plants.weights import Layer, State, Vector

SIDES = ("plus", "minus")


@dataclass(frozen=True)
class Maps:
    """m maps of a run over n steps.

    r (n, m); d as each step finds it, X as `fired`, (n, m, 2); D as `width`, (m,). `off` (n, m): F
    less what the law knows of it, tau less what it wants; `off_most`: the most of F's part.
    """

    run: Cycles
    r: Vector
    d: Vector
    fired: Vector
    width: Vector
    off: Vector
    off_most: float

    @cached_property
    def after(self) -> Vector:
        """r+ of (1), (n, m)."""
        return self.run.after(self.r)

    @cached_property
    def tuned(self) -> Layer:
        """The widths d, as (2) tunes them."""
        alpha, ideal = self.run.rate("alpha"), np.stack((self.width, self.width), axis=1)
        leak = self.run.law("gam") / (abs(alpha) or 1.0)
        drive = -self.fired * self.after[:, :, None]
        return State.of_steps(self.d).layer("alpha", alpha, ideal, drive, leak)

    @property
    def rest(self) -> Vector:
        """The rest w of (1), (n, m)."""
        return self.off + np.sum(self.fired * self.tuned.lacks, axis=2)

    @property
    def helps(self) -> Vector:
        """X'D, (n, m)."""
        return np.sum(self.fired * self.tuned.ideal, axis=2)


def damping(run: Cycles) -> float:
    """Return K."""
    kv, gam = run.laws("kv", "gam")
    return 0.5 * (1.0 - run.rate("alpha") - 2.0 * gam - ((1.0 - gam) * kv) ** 2)


def bound(maps: Maps) -> Constants:
    """Return the constants."""
    gam, d = maps.run.law("gam"), maps.tuned
    return Constants(
        damping=damping(maps.run),
        kappa=(gam / d.metric) * (1.0 - 0.5 * gam),
        ideal=d.norm,
        c0=maps.off_most + d.norm / float(np.sqrt(2.0)),
        leak="constant",
        extra=gam**2 * d.norm**2 / d.metric,
    )


def contracts(run: Cycles) -> Assumption:
    """Return whether K is above 0."""
    k, what = damping(run), f"Kv {run.law('kv'):g}, alpha {run.rate('alpha'):g}"
    return Assumption("Kv^2 < 1 - alpha, about", k > 0.0, f"{what}, K {k:.3g}", needed=True)


def within(what: str, command: Vector, width: Vector, words: str) -> Assumption:
    """Return whether commands (n, m) leave their deadzones, of `width` (m,)."""
    return never(what, np.asarray((np.abs(command) < width).any(axis=1)), words)


def proof(maps: Maps, error_is: str, rest_is: str, asked: Sequence[Assumption]) -> Proof:
    """Return the proof of a run; `rest_is`: what w is."""
    run, r, after, d = maps.run, maps.r, maps.after, maps.tuned
    (kv, gam), rest = run.laws("kv", "gam"), maps.rest
    along = inner(d.w, d.ideal)  # D'd
    return replace(
        layered(
            run,
            ("theorem of chapter 4.3", error_is),
            (d,),
            v=0.5 * inner(r, r),  # (3)
            damping=0.5 * inner(r, r)  # (4)
            - (1.0 - gam) * kv * inner(r, after)
            + 0.5 * (1.0 - run.rate("alpha") - 2.0 * gam) * inner(after, after),
            terms={
                f"r+ w, {rest_is}": (1.0 - gam) * inner(after, rest),
                "forgetting of the widths": gam * inner(after, maps.helps)
                + (1.0 - 0.5 * gam) * (gam / d.metric) * d.leaked
                + 0.5 * gam**2 * along / d.metric,
            },
            error=size(after),
            rest=size((1.0 - gam) * rest + gam * maps.helps),
            extra=0.5 * gam**2 * np.maximum(along, 0.0) / d.metric,
            constants=bound(maps),
            asked=(positive("forgetting Gam", gam), contracts(run), *asked),
            step_s=1.0,
        ),
        ideal_by="the true widths",
    )

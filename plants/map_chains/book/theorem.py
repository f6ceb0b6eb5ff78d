"""The theorem of chapter 4.3 on runs of two coupled chains: exact, from step to step.

(1) to (4) of plants/book/deadzone.py for either chain; V is the sum of both. What one
chain does to the other and the law does not know counts to w, as the model's error does. The error
of a step is the size of both r after it. With a gap instead of a deadzone there is no theorem here.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.3, for m inputs.
"""

import numpy as np

from pcpc.plants.book.deadzone import SIDES, Maps, proof, within
from pcpc.plants.lyapunov import Assumption, Proof
from pcpc.plants.theorem import MARGIN, Cycles, NoTheorem, Theorem
from pcpc.plants.weights import Vector

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
    lam, lam_2, order, known, known_kappa = run.laws(
        "lam", "lam_2", "order", "model_c", "model_coupling"
    )
    true, kappa, actual = run.settings(PLANT, ("c", "coupling", "order"))
    width = np.array(run.settings(PLANT, ("a_dead", "b_dead")))
    x = (both(run, PLANT + "{}_x1"), both(run, PLANT + "{}_x2"), both(run, PLANT + "{}_x3"))
    now, previous, older = (
        both(run, "executive:reference_{}." + name) for name in ("now", "previous", "older")
    )
    r = x[2] - now + lam * (x[1] - previous) + lam_2 * (x[0] - older)
    d, fired = (
        np.stack([both(run, f"{LAW}{{}}_{name}_{side}") for side in SIDES], axis=2)
        for name in ("width", "fired")
    )
    acts = run.after(both(run, PLANT + "{}_tau"))
    off = drift(x, actual, true, kappa) - drift(x, order, known, known_kappa)
    off = off + acts - both(run, LAW + "{}_tau_d")
    reach = MARGIN * max(float(np.abs(one).max()) for one in x)
    apart = (abs(known - true) + abs(known_kappa - kappa)) * reach
    command = both(run, LAW + "{}_command")
    return proof(
        Maps(run, r, d, fired, width, off, float(np.sqrt(2.0)) * apart),
        "|r| of both after the step",
        "model, coupling, deadzones",
        (
            Assumption(
                "the model is exact",
                (known, known_kappa, order) == (true, kappa, actual),
                f"c {true:g}, coupling {kappa:g}; as known {known:g}, {known_kappa:g}",
            ),
            within("the commands leave the deadzones", command, width, "one does not in {}"),
        ),
    )


THEOREMS = {"chains_fuzzy": Theorem(prove, (), ("alpha",))}

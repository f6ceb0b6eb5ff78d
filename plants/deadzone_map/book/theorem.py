"""The theorem of chapter 4.3 on runs of the map behind a deadzone: plants/book/deadzone.py."""

import numpy as np

from pcpc.plants.book.deadzone import SIDES, Maps, proof, within
from pcpc.plants.lyapunov import Assumption, Proof
from pcpc.plants.theorem import MARGIN, Cycles, Theorem

STATE, GOAL = "executive:controller.", "executive:reference.now"


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    lam, known = run.laws("lam", "model_c")
    true, width = run.setting("plant:map.c"), np.array([run.setting("plant:map.d")])
    x1, x2 = run.column("plant:map.x1"), run.column("plant:map.x2")
    r = x2 - run.column(GOAL) + lam * (x1 - run.earlier(GOAL))
    d, fired = (
        np.stack([run.column(f"{STATE}{name}_{side}") for side in SIDES], axis=1)[:, None]
        for name in ("width", "fired")
    )
    acts, wanted = run.after(run.column("plant:map.tau")), run.column(f"{STATE}tau_d")
    off = (known - true) * x1 / (1.0 + x2**2) + acts - wanted
    off_most = abs(known - true) * MARGIN * float(np.abs(x1).max())
    command = run.column(f"{STATE}command")[:, None]
    return proof(
        Maps(run, r[:, None], d, fired, width, off[:, None], off_most),
        "|r| after the step",
        "model and deadzone",
        (
            Assumption("the model is exact", known == true, f"c {true:g}, as known {known:g}"),
            within("the command leaves the deadzone", command, width, "it does not in {}"),
        ),
    )


THEOREMS = {"deadzone_fuzzy": Theorem(prove, (), ("alpha",))}

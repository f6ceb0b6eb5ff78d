"""Fits with the right and with the wrong model of friction, and what each predicts elsewhere."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.study import markdown
from pcpc.tools.study.fit.book._identified_seeds import RIG, START, true_values

Array = NDArray[np.float64]
TRAINED, ELSEWHERE = ("slew10", "lowspeed"), ("slew10", "lowspeed", "sin0.5")
KINDS = {2.0: "LuGre", 1.0: "Stribeck"}  # of barrel.friction_model
SEED, TOLD = 1001, ("FB_A.encoder", "FB_A.hub_rate", "FB_B.shaft_torque", "FB_C.motor_speed")
NAMES = ("coulomb_Nm", "breakaway_Nm", "stribeck_rad_s", "sig2_Nms_rad", "hub_inertia_kg_m2",
         "unbalance_Nm", "gap_rad")  # fmt: skip


@dataclass(frozen=True)
class StructureFit:
    """A fit: estimates and half widths (p,), residuals over noise by sensor.

    `missed`: rms error of the predicted hub angle on other runs, rad, by rig.
    """

    rig: str
    kind: float
    values: Array
    half: Array
    left: Mapping[str, float]
    missed: Mapping[str, float]
    warned: bool


@dataclass(frozen=True)
class Structure:
    """A rig whose run is fitted, and the model of friction that the fit believes in."""

    rig: str
    kind: float
    runs: int = 1

    def done(self) -> list[StructureFit]:
        """Run and fit in this process."""
        from pcpc.tools.study.fit.fitting import fit  # numba

        model, log = self._model(self.rig), _log(self.rig)
        found = fit(model, log)
        values = np.array([one.value for one in found.parameters])
        half = np.array([0.5 * (one.high - one.low) for one in found.parameters])
        left = {s.name: s.residual / s.noise for s in found.sensors if s.name in TOLD}
        missed = {name: self._prediction_error(name, values) for name in ELSEWHERE}
        warned = any("leaves more" in note for note in found.notes)
        return [StructureFit(self.rig, self.kind, values, half, left, missed, warned)]

    def _model(self, rig: str) -> Any:
        from pcpc.executive.rig.reading import load_rig  # numba
        from pcpc.tools.study.fit.fitting import Model

        return Model(load_rig(_file(rig), None, [f"barrel.friction_model={self.kind}"]))

    def _prediction_error(self, rig: str, values: Array) -> float:
        """Return the rms error, rad, of the hub angle that the fitted model predicts there."""
        from pcpc.tools.study.fit.record import record_of  # numba

        model = self._model(rig)
        record = record_of(_log(rig), model.plant, list(model.sensors))
        j = list(model.sensors).index("FB_A.encoder")
        predicted = model.predicted(values[None], record.given, record.first)[0, :, j]
        return float(np.sqrt(np.nanmean((predicted - record.measured[:, j]) ** 2)))


def _file(rig: str) -> Any:
    return RIG.with_name(f"{rig}.yaml")


def _log(rig: str) -> Any:
    from pcpc.executive.nodes.virtual import in_memory  # numba
    from pcpc.executive.rig.reading import load_rig

    return in_memory(load_rig(_file(rig), None, [f"seed={SEED}"]))


def pieces() -> list[Structure]:
    """Return all fits, the long ones first."""
    return [Structure(rig, kind) for rig in reversed(TRAINED) for kind in KINDS]


TEXT = """## The right and the wrong model of friction

The plant's friction is LuGre. The same runs (seed {seed}, PD, each fit from the true values) are
fitted with LuGre and with the static Stribeck curve, which has no bristles and so no presliding.
Left: rms of what the model leaves, over the sensor's own noise. Missed: rms error of the hub angle,
mrad, that the fitted model predicts from the commands alone, of its own run and of others.
"""


def table(found: Sequence[StructureFit]) -> str:
    """Return the section with its tables."""
    ordered = sorted(found, key=lambda one: (one.rig != "slew10", -one.kind))
    head = ("fitted to", "believes", *(f"left, {name}" for name in TOLD),
            *(f"missed, {rig}" for rig in ELSEWHERE), "warned")  # fmt: skip
    rows = [
        (one.rig, KINDS[one.kind], *(f"{one.left[name]:.3g}" for name in TOLD),
         *(f"{1e3 * one.missed[rig]:.3g}" for rig in ELSEWHERE), "yes" if one.warned else "no")
        for one in ordered
    ]  # fmt: skip
    true = true_values()
    values = [
        (
            f"`barrel.{name}`",
            f"{true[i]:g}",
            *(
                f"{one.values[i]:.4g} +- {one.half[i]:.1g}"
                + ("" if abs(one.values[i] - true[i]) <= one.half[i] else " (out)")
                for one in ordered
            ),
        )
        for i, name in enumerate(NAMES)
    ]
    assert [f"barrel.{name}" for name in NAMES] == list(START)
    columns = ("parameter", "true", *(f"{one.rig}, {KINDS[one.kind]}" for one in ordered))
    return f"{TEXT.format(seed=SEED)}\n{markdown(head, rows)}\n{markdown(columns, values)}"

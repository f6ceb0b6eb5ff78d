"""Fits of the barrel to runs that differ in the seed of the sensors' noise alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc import plants
from pcpc.plants.pages import BLACK, BLUE, VERMILION
from pcpc.plants.study import markdown

Array = NDArray[np.float64]
RIG = Path(plants.__file__).resolve().parent / "atb1000" / "rigs" / "slew10.yaml"
SEEDS = range(1001, 1101)  # none of them was looked at before the estimator was as it is
START = {  # of every fit: wrong by a fifth to a half
    "barrel.coulomb_Nm": 2.6, "barrel.breakaway_Nm": 4.0, "barrel.stribeck_rad_s": 0.015,
    "barrel.sig2_Nms_rad": 0.5, "barrel.hub_inertia_kg_m2": 1.5, "barrel.unbalance_Nm": 2.0,
    "barrel.gap_rad": 1.5e-3,
}  # fmt: skip
WANTED = 95  # of 100 inside
DRAWN = ("barrel.coulomb_Nm", "barrel.hub_inertia_kg_m2", "barrel.gap_rad")


@dataclass(frozen=True)
class SeedFit:
    """Fits of a seed's run: values, values before rounding was modelled, half widths; (p,) each."""

    seed: int
    values: Array
    before: Array
    half: Array
    runs: int


@dataclass(frozen=True)
class Seeds:
    """Seeds that are run and fitted together."""

    seeds: tuple[int, ...]

    @property
    def runs(self) -> int:
        """How many fits these are."""
        return len(self.seeds)

    def done(self) -> list[SeedFit]:
        """Run and fit them in this process."""
        from pcpc.executive.batch.runs import Case  # numba
        from pcpc.tools.study.fit.fitting import estimate_of
        from pcpc.tools.study.fit.record import record_of

        model, runs = _bench()
        found = []
        for seed, made in zip(self.seeds, runs.done([Case(s) for s in self.seeds]), strict=True):
            assert made.log is not None, made.refused
            record = record_of(made.log, model.plant, list(model.sensors))
            one = estimate_of(model, record)
            half = 0.5 * (one.interval[:, 1] - one.interval[:, 0])
            found.append(SeedFit(seed, one.values, one.before, half, one.evaluations))
        return found


def pieces(seeds: Sequence[int] = SEEDS) -> list[Seeds]:
    """Return the seeds in pieces that fill the lanes."""
    from pcpc.drivers.compiled.lanes import WIDTH  # numba

    return [Seeds(tuple(seeds[i : i + WIDTH])) for i in range(0, len(seeds), WIDTH)]


@lru_cache(maxsize=1)
def _bench() -> Any:
    from pcpc.executive.batch.runs import BatchRuns  # numba
    from pcpc.executive.rig.reading import load_rig
    from pcpc.tools.study.fit.fitting import Model

    model = Model(load_rig(RIG, None, [f"{name}={value!r}" for name, value in START.items()]))
    heard = [f"rx.{name}" for name in model.sensors]
    given = [f"rx.{name}" for name in model.plant.received]
    wanted: Any = {"plant": given, "executive": [*heard, "supervisor.missing_cycles"]}
    return model, BatchRuns(RIG, None, (), wanted)


def true_values() -> Array:
    """Return what the plant of the runs has, (p,), in the order of START."""
    from pcpc.executive.rig.reading import load_rig  # numba
    from pcpc.tools.study.fit.fitting import Model

    own = Model(load_rig(RIG)).own
    return np.array([own[name] for name in START])


TEXT = """## {n} noise seeds of the nominal barrel

`slew10`, PD, noise seeds {first} to {last}: one run of 6 s and one fit each, which starts from
values that are wrong by a fifth to a half. "Inside" counts the 95 % intervals that hold the true
value; of exactly right ones 91 to 99 of 100 would, in 19 of 20 such tables. "Before" is the same
count for the estimate that takes rounding for white noise. Bias and scatter are those of the
estimates over the seeds, in units of the mean standard error that the fits state. Intervals that
are no wider than need be have a scatter of 1.00. These are wider: they count rounding as noise,
although the estimate no longer suffers from it.
"""


def table(found: Sequence[SeedFit]) -> tuple[str, list[str]]:
    """Return the section with the table, and what is not as it should be."""
    true, values = true_values(), np.stack([one.values for one in found])
    before = np.stack([one.before for one in found])
    half = np.stack([one.half for one in found])
    inside = np.sum(np.abs(values - true) <= half, axis=0)
    was_inside = np.sum(np.abs(before - true) <= half, axis=0)
    error = half.mean(axis=0) / 1.96
    rows = [
        (
            f"`{name}`", f"{true[i]:g}", f"{START[name]:g}", f"{values[:, i].mean():.7g}",
            f"{half[:, i].mean():.2g}", f"{100.0 * half[:, i].mean() / true[i]:.3f} %",
            f"{(values[:, i].mean() - true[i]) / error[i]:+.2f}",
            f"{values[:, i].std(ddof=1) / error[i]:.2f}", f"{inside[i]}", f"{was_inside[i]}",
        )
        for i, name in enumerate(START)
    ]  # fmt: skip
    head = ("parameter", "true", "start", "mean fit", "half width", "of the value", "bias",
            "scatter", "inside", "before")  # fmt: skip
    text = TEXT.format(n=len(found), first=found[0].seed, last=found[-1].seed)
    runs = np.mean([one.runs for one in found])
    missed = [
        f"{name}: the true value is inside of {count} of {len(found)} intervals"
        for name, count in zip(START, inside, strict=True)
        if count * 100 < WANTED * len(found)
    ]
    return f"{text}\n{markdown(head, rows)}\n{runs:.0f} runs of the model a fit.\n", missed


def draw(found: Sequence[SeedFit], path: Path) -> None:
    """Draw the intervals of all seeds, each as a line, with the true value."""
    from matplotlib.figure import Figure

    page = Figure((12.0, 2.3 * len(DRAWN)), layout="constrained")
    axes = page.subplots(len(DRAWN), 1, sharex=True)
    true, names = true_values(), list(START)
    seeds = [one.seed for one in found]
    for axis, name in zip(axes, DRAWN, strict=True):
        i = names.index(name)
        values = np.array([one.values[i] for one in found])
        half = np.array([one.half[i] for one in found])
        outside = np.abs(values - true[i]) > half
        axis.vlines(
            seeds,
            values - half,
            values + half,
            color=np.where(outside, VERMILION, BLUE),
            linewidth=1.4,
        )
        axis.plot(seeds, values, ".", color=BLACK, markersize=3)
        axis.axhline(true[i], color=BLACK, linewidth=0.8)
        axis.ticklabel_format(axis="y", useOffset=float(true[i]))
        axis.set_ylabel(name.removeprefix("barrel."))
        axis.set_title(
            f"{name}: {int((~outside).sum())} of {len(found)} intervals hold the true "
            f"value {true[i]:g}",
            fontsize=10,
        )
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("noise seed")
    page.savefig(path, dpi=110)

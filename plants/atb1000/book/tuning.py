"""How the laws of the barrel are tuned: the same rule and the same budget for each.

    candidates   HAND, and CANDIDATES points of Sobol's sequence over the logarithms of RANGES
    runs         on the nominal barrel only: SCENARIOS, each with SEEDS of sensor noise
    score        geometric mean over scenarios and seeds of (muzzle error rms)/(that of pd)      (1)
    chatter      largest of the command's steps from cycle to cycle, rms of each run, N m        (2)
    margin       disk margin of the linear barrel (linear.yaml), of super_twisting measured      (3)
    choice       the least (1) with (2) <= STEP_NM, (3) >= MARGIN and no run that ended early

Super-twisting has an infinite slope at zero, hence no linear loop: (3) is what AMPLITUDE_NM,
injected at the motor, finds; less of it finds less. `pd_star` is `pd` with other gains, and so has
no candidates of its own. What pd and the laws made from it had before is kept: what was chosen for
them stands beside it as NAME_tuned. `pcpc experiment tuning` writes tuning.csv anew.
"""

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcpc.plants.book.tables import case_maker, controller_of, grouped, label_of, rig_name
from pcpc.plants.study import Case, CaseResult

FOLDER = Path(__file__).resolve().parent
RIGS = FOLDER.parent / "rigs"
_case = case_maker(__file__)
TABLE = FOLDER / "tuning.csv"
SCENARIOS = ("slew10", "sin0.5", "hull", "lowspeed")
SEEDS = (11, 12)
CANDIDATES = 32
STEP_NM, MARGIN, AMPLITUDE_NM = 0.25, 0.75, 0.4
MEASURED = ("super_twisting",)
RMS, STEP = "muzzle_error_rms_mrad", "command_step_rms_Nm"

Range = tuple[float, float, float]  # by hand, lowest, highest
KV, LAM = (110.0, 60.0, 200.0), (16.0, 8.0, 40.0)
DAMPING, SMOOTH, JUMP = (0.1, 0.05, 0.2), (80.0, 20.0, 320.0), (400.0, 100.0, 1600.0)
REVERSE = (4e-3, 1e-3, 1.6e-2)
PD: dict[str, Range] = {"kv_Nms_rad": KV, "lam_per_s": LAM}
NETWORK: dict[str, Range] = {**PD, "f_rate": SMOOTH, "fj_rate": JUMP}
RANGES: dict[str, dict[str, Range]] = {
    "pd": PD,
    "pid": {**PD, "ki_Nm_rad": (500.0, 125.0, 2000.0)},
    "pd_fast": {**PD, "damping_wanted": DAMPING},
    "pd_nn": NETWORK,
    "pd_nn_fast": {**NETWORK, "damping_wanted": DAMPING},
    "nn_backstepping": {**NETWORK, "kb_per_s": (20.0, 5.0, 80.0)},
    "pd_feedforward": {**PD, "friction_share": (1.0, 0.7, 1.1), "reverse_rad_s": REVERSE},
    "pd_observer": {**PD, "observer_per_s": (15.0, 4.0, 60.0)},
    "super_twisting": {**PD, "k1_Nm": (5.0, 0.6, 10.0), "k2_Nm_s": (20.0, 5.0, 80.0)},
    "pd_adaptive": {
        **PD, "coulomb_rate": (400.0, 100.0, 1600.0), "breakaway_rate": (400.0, 100.0, 1600.0),
        "unbalance_rate": (80.0, 20.0, 320.0), "reverse_rad_s": REVERSE,
    },
    "lqg": {
        "rate_weight_rad_s": (0.05, 0.0125, 0.2), "torque_weight_Nm": (2.0, 0.5, 8.0),
        "torque_noise_Nm": (0.3, 0.075, 1.2), "drift_Nm": (0.3, 0.075, 1.2),
    },
}  # fmt: skip
RIVALS = ("pd_feedforward", "pd_observer", "super_twisting", "pd_adaptive", "lqg")


@dataclass(frozen=True)
class Candidate:
    """A candidate: its gains by name, rms in mrad by scenario (mean of the seeds), (1) to (3)."""

    law: str
    number: int
    gains: Mapping[str, float]
    rms: tuple[float, ...]
    score: float
    step_Nm: float
    margin: float
    chosen: bool = False

    @property
    def allowed(self) -> bool:
        """Whether it may be chosen."""
        return math.isfinite(self.score) and self.step_Nm <= STEP_NM and self.margin >= MARGIN


def candidates(law: str) -> list[dict[str, float]]:
    """Return the gains of all candidates, the first by hand; three digits each."""
    from scipy.stats import qmc

    ranges = RANGES[law]
    engine = qmc.Sobol(len(ranges), scramble=False)
    engine.fast_forward(1)  # the first point is a corner
    gains_of_all = [{name: one[0] for name, one in ranges.items()}]
    for point in engine.random(CANDIDATES):
        pairs = zip(ranges.items(), point, strict=True)
        gains_of_all.append(
            {name: float(f"{low * (high / low) ** u:.3g}") for (name, (_, low, high)), u in pairs}
        )
    return gains_of_all


def settings(gains: Mapping[str, float]) -> tuple[str, ...]:
    """Return gains as `--set` takes them."""
    return tuple(f"controller.{name}={value!r}" for name, value in gains.items())


def cases(laws: Iterable[str] = tuple(RANGES)) -> Iterator[Case]:
    """Yield the runs of all candidates of laws; the label is the number of the candidate."""
    for law in laws:
        for number, gains in enumerate(candidates(law)):
            for scenario in SCENARIOS:
                for seed in SEEDS:
                    own = (*settings(gains), f"seed={seed}")
                    yield _case("tuning", scenario, law, str(number), *own)


def rows(
    results: Sequence[CaseResult], margins: Mapping[tuple[str, int], float]
) -> list[Candidate]:
    """Return what became of the candidates; those of pd have to be among them."""
    runs = grouped(results, controller_of, label_of, rig_name)
    base = np.array([[_rms(r) for r in runs["pd", "0", s]] for s in SCENARIOS])
    candidate_rows = []
    for law, label in dict.fromkeys(names[:2] for names in runs):
        own, number = [runs[law, label, s] for s in SCENARIOS], int(label)
        rms = np.array([[_rms(r) for r in some] for some in own])
        steps = [r.metric(STEP) for some in own for r in some]
        score = float(np.exp(np.mean(np.log(rms / base))))
        seen = tuple(rms.mean(axis=1).tolist())
        gains, margin = candidates(law)[number], margins[law, number]
        candidate_rows.append(Candidate(law, number, gains, seen, score, max(steps), margin))
    return marked_rows(candidate_rows)


def _rms(result: CaseResult) -> float:
    return math.inf if result.failed else result.metric(RMS)


def choice(found: Sequence[Candidate], law: str) -> Candidate | None:
    """Return the allowed candidate of a law with the least score; None if there is none."""
    allowed = [row for row in found if row.law == law and row.allowed]
    return min(allowed, key=lambda row: row.score, default=None)


def marked_rows(candidate_rows: Sequence[Candidate]) -> list[Candidate]:
    """Return rows of which those that are chosen say so."""
    best = [choice(candidate_rows, law) for law in RANGES]
    keys = {(row.law, row.number) for row in best if row is not None}
    return [replace(row, chosen=(row.law, row.number) in keys) for row in candidate_rows]


_HEAD = ("law", "candidate", "gains", *(f"{s}_mrad" for s in SCENARIOS), "score", "step_Nm",
         "disk_margin", "chosen")  # fmt: skip


def write(candidate_rows: Sequence[Candidate], path: Path) -> None:
    """Write a line a candidate."""
    with path.open("w", newline="", encoding="utf-8") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(_HEAD)
        for row in candidate_rows:
            gains = " ".join(f"{name}={value:g}" for name, value in row.gains.items())
            numbers = (*row.rms, row.score, row.step_Nm, row.margin)
            texts = [f"{value:.4g}" for value in numbers]
            lines.writerow((row.law, row.number, gains, *texts, "x" if row.chosen else ""))


def read(path: Path = TABLE) -> list[Candidate]:
    """Return the candidates of a table, with the choice that stands in it."""
    candidate_rows = []
    with path.open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            pairs = (pair.split("=") for pair in line["gains"].split())
            gains = {name: float(value) for name, value in pairs}
            rms = tuple(float(line[f"{s}_mrad"]) for s in SCENARIOS)
            score, step, margin = (float(line[n]) for n in ("score", "step_Nm", "disk_margin"))
            about = line["law"], int(line["candidate"]), gains, rms
            candidate_rows.append(Candidate(*about, score, step, margin, line["chosen"] == "x"))
    return candidate_rows


def controller(law: str) -> str:
    """Return the name of a rig's controller with the gains that were chosen."""
    return law if law in RIVALS else f"{law}_tuned"

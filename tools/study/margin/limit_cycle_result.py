"""What `pcpc margin --limit-cycle` finds: the branch, its least gain, predictions beside runs."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Point:
    """A limit cycle: factor of the gain, frequency, the command's amplitude and its step, rms."""

    factor: float
    f_hz: float
    amplitude: float
    step_rms: float


@dataclass(frozen=True)
class Row:
    """The command's step at a factor, rms: `predicted` (None: no cycle), of the map, of the rig.

    `alone`: the map of the balance, begun in the cycle and left alone for 2 s; `run`: the rig as it
    is, with its reference, nan where it ended in a fault.
    """

    factor: float
    predicted: Point | None
    alone: float
    run: float


@dataclass(frozen=True)
class LimitCycle:
    """The branch from large to small amplitudes, and runs; `grown`: what is not linear in it."""

    rig: str
    controller: str
    gain: str
    grown: dict[str, float]
    linear_factor: float
    linear_hz: float
    branch: list[Point]
    rows: list[Row]
    signal: str
    unit: str

    @property
    def onset(self) -> Point:
        """The cycle of the least gain."""
        return self.branch[lowest(self.branch)]

    def json(self) -> dict[str, Any]:
        """Return all as plain values."""
        found = asdict(self) | {"onset": asdict(self.onset)}
        for row in found["rows"]:
            row["run"] = row["run"] if math.isfinite(row["run"]) else None
        return found

    def save(self, folder: str | Path) -> Path:
        """Write limit_cycle.json and limit_cycle.png into a folder; return it. ImportError."""
        from pcpc.tools.study.margin import drawing

        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "limit_cycle.json").write_text(json.dumps(self.json(), indent=1) + "\n")
        drawing.limit_cycle(self, folder / "limit_cycle.png")
        return folder

    def text(self) -> str:
        """Return the table, at most 80 columns wide."""
        onset, unit = self.onset, f" [{self.unit}]" if self.unit else ""
        lines = [
            f"{self.rig}, {self.controller}: limit cycles as {self.gain} grows",
            *(f"with      {name} = {value:g}" for name, value in self.grown.items()),
            f"linear    unstable from factor {self.linear_factor:.4g}, {self.linear_hz:.4g} Hz",
            f"cycles    predicted from factor {onset.factor:.4g}, {onset.f_hz:.4g} Hz",
            "",
            f"step of {self.signal}, rms{unit}",
            "  factor         predicted   amplitude          Hz       alone     the rig",
        ]
        for row in self.rows:
            if row.predicted is None:
                cells = ["no cycle", "", ""]
            else:
                one = row.predicted
                cells = [f"{one.step_rms:.4g}", f"{one.amplitude:.4g}", f"{one.f_hz:.4g}"]
            cells += [f"{row.alone:.3g}", f"{row.run:.3g}" if math.isfinite(row.run) else "fault"]
            lines.append(f"{row.factor:8.4g}      " + "".join(f"{cell:>12}" for cell in cells))
        return "\n".join(lines) + "\n"


def lowest(points: Sequence[Point]) -> int:
    """Return the place of the least gain: before it, at larger amplitudes, cycles are stable."""
    return min(range(len(points)), key=lambda i: points[i].factor)

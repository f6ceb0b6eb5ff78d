"""What `pcpc margin` finds: the open loop by both methods, the margins of each, how they agree."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.tools.study.margin.margins import Margins

Vector = NDArray[np.float64]
_ROWS = (  # of the table: what, attribute, where, format
    ("gain margin", "gain_margin", "gain_margin_hz", "{:.4g}"),
    ("  in dB", "gain_margin_db", "", "{:.2f} dB"),
    ("gain reduction to", "gain_reduction", "gain_reduction_hz", "{:.4g}"),
    ("phase margin", "phase_margin_deg", "crossover_hz", "{:.2f} deg"),
    ("delay margin", "delay_margin_ms", "", "{:.4g} ms"),
    ("  in samples", "delay_margin_samples", "", "{:.4g}"),
    ("disk margin", "disk_margin", "disk_margin_hz", "{:.4g}"),
    ("sensitivity peak", "sensitivity_peak", "sensitivity_peak_hz", "{:.4g}"),
)


@dataclass(frozen=True)
class Response:
    """The open loop L (n,) over f_hz (n,), with its margins.

    `spread`: of a measured one, how far L of single periods lies from their mean, relative to it;
    `coherence` of the command with what was injected.
    """

    f_hz: Vector
    response: NDArray[np.complex128]
    margins: Margins
    spread: Vector | None = None
    coherence: Vector | None = None

    def json(self) -> dict[str, Any]:
        """Return it as plain values."""
        found: dict[str, Any] = {
            "margins": self.margins.json(), "f_hz": self.f_hz.tolist(),
            "real": self.response.real.tolist(), "imaginary": self.response.imag.tolist(),
        }  # fmt: skip
        if self.spread is not None and self.coherence is not None:
            found |= {"spread": self.spread.tolist(), "coherence": self.coherence.tolist()}
        return found


@dataclass(frozen=True)
class Margin:
    """A rig's loop: numbers of the linearised response, else of the measured one, as attributes.

        found = pcpc.margin("sin0.5", "pd")
        found.gain_margin, found.phase_margin_deg, found.delay_margin_s, found.disk_margin
        found.linearised.f_hz, found.linearised.response       arrays; the same of found.measured

    `reference`: what is held; `command`: where the command stands; `poles` z of the closed loop;
    `kinks`: states at which it cannot be differentiated; `amplitude` of what was injected;
    `moving_s`: when of its own run the rig is looked at, nan: at rest;
    `deviation`: between both, at the measured lines, relative to the linearised one.
    """

    rig: str
    controller: str
    loop: str
    unit: str
    loops: list[str]
    rate_hz: float
    reference: Mapping[str, float]
    command: float
    linearised: Response | None
    measured: Response | None
    poles: NDArray[np.complex128] = field(default_factory=lambda: np.empty(0, complex))
    kinks: list[str] = field(default_factory=list)
    amplitude: float = math.nan
    notes: list[str] = field(default_factory=list)
    moving_s: float = math.nan

    @property
    def margins(self) -> Margins:
        """The numbers that count: of the linearised loop, else of the measured one."""
        one = self.linearised or self.measured
        assert one is not None, "one of both was asked for"
        return one.margins

    def __getattr__(self, name: str) -> Any:
        """Return a number of the margins."""
        if name.startswith("_") or name not in _NUMBERS:
            raise AttributeError(f"Margin has no {name}; it has {', '.join(sorted(_NUMBERS))}")
        return getattr(self.margins, name)

    @property
    def deviation(self) -> Vector:
        """|measured/linearised - 1| at the measured lines, (m,); nan without both."""
        if self.linearised is None or self.measured is None:
            return np.full(1, math.nan)
        f, lines = self.linearised.f_hz, self.measured.f_hz
        i = np.searchsorted(f, lines * (1.0 - 1e-12))
        return np.abs(self.measured.response / self.linearised.response[i] - 1.0)

    def json(self) -> dict[str, Any]:
        """Return all as plain values, as `--json` prints it."""
        found: dict[str, Any] = {
            "rig": self.rig, "controller": self.controller, "loop": self.loop, "unit": self.unit,
            "loops": self.loops, "rate_hz": self.rate_hz, "reference": dict(self.reference),
            "command": self.command, "notes": self.notes, "kinks": self.kinks,
            "amplitude": self.amplitude if math.isfinite(self.amplitude) else None,
            "moving_s": self.moving_s if math.isfinite(self.moving_s) else None,
            "largest_pole": float(np.abs(self.poles).max()) if len(self.poles) else None,
        }  # fmt: skip
        for name in ("linearised", "measured"):
            one = getattr(self, name)
            found[name] = None if one is None else one.json()
        return found

    def save(self, folder: str | Path) -> Path:
        """Write margin.json, bode.png and nyquist.png into a folder; return it. ImportError."""
        from pcpc.tools.study.margin import drawing

        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "margin.json").write_text(json.dumps(self.json(), indent=1) + "\n")
        drawing.bode(self, folder / "bode.png")
        drawing.nyquist(self, folder / "nyquist.png")
        return folder

    @property
    def _when(self) -> str:
        return f"in motion, at {self.moving_s:.4g} s" if math.isfinite(self.moving_s) else "at rest"

    def text(self) -> str:
        """Return the table, at most 80 columns wide."""
        unit = f" {self.unit}" if self.unit else ""
        held = [f"{name} = {value:.6g}" for name, value in self.reference.items()]
        lines = [
            f"{self.rig}, {self.controller}: loop of {self.loop}, {self.rate_hz:g} Hz",
            *(_wrapped("held      ", held) if held else ()),
            f"command   {self.command:.6g}{unit} {self._when}",
        ]
        if math.isfinite(self.amplitude):
            lines.append(f"injected  at most {self.amplitude:.4g}{unit}")
        if len(self.loops) > 1:
            lines += _wrapped("loops     ", self.loops)
        known = {
            name: one.margins
            for name, one in (("linearised", self.linearised), ("measured", self.measured))
            if one is not None
        }
        if math.isfinite(self.moving_s) and self.linearised is not None:
            known = {
                f"{name}{' in motion' * (name == 'linearised')}": known[name] for name in known
            }
        lines += ["", f"{'':20}" + "".join(f"{name:>28}" for name in known)]
        for what, name, where, form in _ROWS:
            cells = (_cell(one, name, where, form) for one in known.values())
            lines.append(f"{what:20}" + "".join(f"{cell:>28}" for cell in cells))
        lines += ["", *(line for note in self.notes for line in _wrapped("", note.split(" "), " "))]
        return "\n".join(lines).rstrip() + "\n"


_NUMBERS = {
    *Margins.__dataclass_fields__, "gain_margin_db", "disk_gain", "disk_phase_deg",
}  # fmt: skip


def _cell(one: Margins, name: str, where: str, form: str) -> str:
    value = 1e3 * one.delay_margin_s if name == "delay_margin_ms" else getattr(one, name)
    if math.isnan(value):
        return "not measured"
    if not math.isfinite(value) or (name == "gain_reduction" and value == 0.0):
        return "any" if name != "gain_reduction" else "0"
    at = getattr(one, where) if where else math.nan
    return form.format(value) + (f" at {at:.4g} Hz" if math.isfinite(at) else "")


def _wrapped(head: str, words: Any, between: str = ", ") -> list[str]:
    """Return words behind a head in lines of at most 80 columns."""
    lines, line = list[str](), ""
    for word in words:
        if line and len(head) + len(line) + len(between) + len(word) > 79:
            lines.append(line + between.rstrip())
            line = ""
        line += (between if line else "") + word
    lines.append(line)
    return [head + lines[0], *(" " * len(head) + one for one in lines[1:])]

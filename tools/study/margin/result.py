"""What `pcpc margin` finds: the open loop by both methods, the margins of each, how they agree."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.tools.study.arrays import Complex, Vector
from pcpc.tools.study.margin.facts import LoopFacts, ResponseFacts
from pcpc.tools.study.margin.margins import Margins, facts_of
from pcpc.tools.study.result import Result, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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

    `spread` (n,) of a measured loop: relative deviation of single periods from their mean;
    `coherence` (n,) of the command with the injection.
    """

    f_hz: Vector
    response: Complex
    margins: Margins
    spread: Vector | None = None
    coherence: Vector | None = None

    def _facts(self) -> ResponseFacts:
        """Return the response and its margins."""
        parts = self.f_hz, self.response.real, self.response.imag
        found = ResponseFacts(facts_of(self.margins), *(part.tolist() for part in parts))
        if self.spread is not None and self.coherence is not None:
            found.spread, found.coherence = self.spread.tolist(), self.coherence.tolist()
        return found

    def json(self) -> dict[str, Any]:
        """Return the response as plain values."""
        return plain(self._facts())


@dataclass(frozen=True)
class Margin(Result):
    """A rig's loop: margins of the linearised response, or of the measured one, as attributes.

        found = pcpc.margin("sin0.5", "pd")
        found.gain_margin, found.phase_margin_deg, found.delay_margin_s, found.disk_margin
        found.linearised.f_hz, found.linearised.response       (n,) each; the same of found.measured

    `reference`: the constant reference; `command`: the command there; `poles` (p,): z of the closed
    loop; `kinks`: states where it is not differentiable; `amplitude` of the injection; `moving_s`:
    time of the run at which the loop is taken, nan: at rest.
    """

    name = "margin"

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
    poles: Complex = field(default_factory=lambda: np.empty(0, complex))
    kinks: list[str] = field(default_factory=list)
    amplitude: float = math.nan
    notes: list[str] = field(default_factory=list)
    moving_s: float = math.nan

    @property
    def responses(self) -> dict[str, Response]:
        """The responses by method."""
        both = {"linearised": self.linearised, "measured": self.measured}
        return {method: one for method, one in both.items() if one is not None}

    @property
    def margins(self) -> Margins:
        """The margins of the linearised loop, or of the measured one."""
        return next(iter(self.responses.values())).margins

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

    def facts(self) -> LoopFacts:
        """Return all; of the poles the largest."""
        found = {name: value for name, value in vars(self).items() if name != "poles"}
        found |= {method: one._facts() for method, one in self.responses.items()}
        return LoopFacts(**found, largest_pole=max(np.abs(self.poles).tolist(), default=None))

    def pictures(self) -> Mapping[str, "Figure"]:
        """Return Bode's and Nyquist's."""
        from pcpc.tools.study.margin import drawing  # time

        return {"bode": drawing.bode(self), "nyquist": drawing.nyquist(self)}

    def lines(self) -> Iterator[str]:
        """Yield the point, the table of both methods, what has to be said."""
        unit, moves = f" {self.unit}".rstrip(), math.isfinite(self.moving_s)
        when = f"in motion, at {self.moving_s:.4g} s" if moves else "at rest"
        yield f"{self.rig}, {self.controller}: loop of {self.loop}, {self.rate_hz:g} Hz"
        if self.reference:
            held = ", ".join(f"{name} = {value:.6g}" for name, value in self.reference.items())
            yield f"held      {held}"
        yield f"command   {self.command:.6g}{unit} {when}"
        if math.isfinite(self.amplitude):
            yield f"injected  at most {self.amplitude:.4g}{unit}"
        if len(self.loops) > 1:
            yield f"loops     {', '.join(self.loops)}"
        heads = (
            f"{method} in motion" if moves and method == "linearised" else method
            for method in self.responses
        )
        yield from ("", f"{'':20}" + "".join(f"{head:>28}" for head in heads))
        for what, *how in _ROWS:
            cells = (_cell(one.margins, *how) for one in self.responses.values())
            yield f"{what:20}" + "".join(f"{cell:>28}" for cell in cells)
        yield ""
        yield from self.notes


_NUMBERS = {*Margins.__dataclass_fields__, "gain_margin_db", "disk_gain", "disk_phase_deg"}


def _cell(one: Margins, name: str, where: str, form: str) -> str:
    value = 1e3 * one.delay_margin_s if name == "delay_margin_ms" else getattr(one, name)
    if math.isnan(value):
        return "not measured"
    if name == "gain_reduction" and value == 0.0:
        return "0"
    if math.isinf(value):
        return "any"
    at = getattr(one, where) if where else math.nan
    return form.format(value) + (f" at {at:.4g} Hz" if math.isfinite(at) else "")

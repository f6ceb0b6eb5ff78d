"""What `pcpc margin --json` prints; null: not finite."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from msgspec import UNSET, Meta, Struct, UnsetType

from pcpc.tools.study.margin.margins import MarginFacts
from pcpc.tools.terminal.answer import Finite


class ResponseFacts(Struct):
    """The open loop L over frequency."""

    margins: MarginFacts
    f_hz: list[float]
    real: list[float]
    "of L"
    imaginary: list[float]
    "of L"
    spread: list[float] | UnsetType = UNSET
    "of single periods, relative to their mean; only of a measured loop"
    coherence: list[float] | UnsetType = UNSET
    "of the command with the injection; only of a measured loop"


class LoopFacts(Struct):
    """The margins of a rig's loop."""

    rig: str
    controller: str
    loop: str
    "the command signal that closes it"
    unit: str
    "of it; empty: none"
    loops: list[str]
    "all of the rig"
    rate_hz: Finite
    "Hz"
    reference: Mapping[str, float]
    "constant, by name, in the unit of each"
    command: float
    "there, in unit"
    linearised: ResponseFacts | None
    "null: --method measured"
    measured: ResponseFacts | None
    "null: --method linearised"
    kinks: list[str]
    "states where it is not differentiable"
    amplitude: float
    "injected at most, in unit; null: nothing was"
    notes: list[str]
    "what to mind"
    moving_s: float
    "time of the run at which the loop is taken, s; null: at rest"
    largest_pole: float | None
    "|z| of the closed loop; null: not computed"


@dataclass(frozen=True)
class Point:
    """A limit cycle."""

    factor: float
    "of the gain"
    f_hz: float
    amplitude: float
    "of the command, in unit"
    step_rms: float
    "of the command from cycle to cycle, in unit"


@dataclass(frozen=True)
class StepAtFactor:
    """The command's step at a factor, rms, in unit."""

    factor: Finite
    "of the gain"
    predicted: Point | None
    "null: no cycle"
    alone: float
    "of the map of the balance, begun in the cycle and left alone for 2 s"
    run: float
    "of the rig as it is, with its reference; null: it ended in a fault"


class LimitCycleFacts(Struct):
    """--limit-cycle."""

    rig: str
    controller: str
    gain: str
    "the setting that grows"
    grown: dict[str, Finite]
    "the nonlinearities, by setting"
    linear_factor: float
    "of the gain, from which the linear loop is unstable"
    linear_hz: float
    branch: Annotated[list[Point], Meta(min_length=1)]
    "from large to small amplitudes"
    rows: list[StepAtFactor]
    signal: str
    "the command"
    unit: str
    "of it; empty: none"
    onset: Point
    "the cycle of the least gain"

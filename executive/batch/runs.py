"""Runs of one rig with other settings and seeds: in lanes where it can be, else alone.

A Case gives settings of blocks and a seed. All that depends on them are values of the tables, so
that the rig is laid out once. What lanes cannot do is done one by one, from the rig's file on, with
the same bits: `Done.alone` says why.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.lanes import WIDTH, LanesDiffer
from pcpc.drivers.errors import UserError
from pcpc.executive.batch.group import LaneGroup, NotInLanes, Traces, hanging_step
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import Columns
from pcpc.executive.loop.faults import FAULT_NAMES
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.nodes.watched import StepError
from pcpc.executive.own_laws.preparation import prepared_values
from pcpc.executive.rig.blocks import BlockSpec, law_keys
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role

_DIFFERS = "a step branches differently with these settings"
_ODD = "it left the path of a run without a fault"
METADATA = {"pacing": "virtual", "bus": "memory"}


@dataclass(frozen=True)
class Case:
    """A run to do: `settings` are "<block>.<setting>", or other keys of the rig."""

    seed: int
    settings: Mapping[str, float] = field(default_factory=dict)

    def words(self) -> list[str]:
        """Return the case as `--set` options."""
        return [
            *(f"{name}={value!r}" for name, value in self.settings.items()),
            f"seed={self.seed}",
        ]


@dataclass(frozen=True)
class RunResult:
    """A run: its log with the wanted columns, or all; `fault` in words, "" without.

    `alone`: why it was not done in lanes, "" if it was. `refused`: why it was not done at all.
    """

    log: logs.Log | None
    fault: str = ""
    alone: str = ""
    refused: str = ""


class BatchRuns:
    """Runs of one rig and controller, for one thread."""

    def __init__(
        self,
        path: Path,
        controller: str | None,
        settings: Sequence[str],
        wanted: Mapping[Role, Sequence[str]],
        traces: Traces | None = None,
    ) -> None:
        """Lay the rig out once. Raises RigError, BusError.

        `settings`: as `--set`, of all runs; `wanted`: the variables that are kept, by node;
        `traces`: see `LaneGroup`.
        """
        self.path, self.controller, self.settings = path, controller, list(settings)
        self.rig, self.why = load_rig(path, controller, settings), ""
        self.wanted = {role: list(wanted.get(role, ())) for role in self.rig.roles}
        self._own = {
            f"{spec.name}.{name}": (role, spec, name)
            for role, node in self.rig.nodes().items()
            for spec in node.blocks
            for name in spec.settings
        }
        self._known: dict[tuple[Role, str], dict[str, int]] = {}
        try:
            self.group: LaneGroup | None = LaneGroup(self.rig, wanted, traces)
        except NotInLanes as error:
            self.group, self.why = None, str(error)

    def done(self, cases: Sequence[Case]) -> list[RunResult]:
        """Return at most WIDTH runs, in the order of `cases`. ValueError: too many cases."""
        if len(cases) > WIDTH:
            raise ValueError(f"{len(cases)} cases; a group holds {WIDTH}")
        why = self.why or self._why_alone(cases)
        if why or (group := self.group) is None:
            return [self._alone(case, why) for case in cases]
        results: dict[int, RunResult] = {}
        waiting = [dict(enumerate(cases))]
        while waiting:
            some = waiting.pop()
            if len(some) == 1 < len(cases):
                results |= {i: self._alone(case, _DIFFERS) for i, case in some.items()}
                continue
            refused = self._fill(group, list(some.values()))
            results |= {
                i: RunResult(None, refused=why) for i, why in zip(some, refused, strict=True) if why
            }
            able = {i: case for i, case in some.items() if i not in results}
            try:
                odd_lanes = group.run()
            except LanesDiffer:
                waiting += _case_parts(able)
                continue
            traces = group.columns()
            for lane, (i, case) in enumerate(some.items()):
                if i in able:
                    results[i] = (
                        self._alone(case, _ODD)
                        if odd_lanes[lane]
                        else RunResult(self._log(group, case, lane, traces))
                    )
        return [results[i] for i in range(len(cases))]

    def _places(self, group: LaneGroup, role: Role, spec: BlockSpec) -> Mapping[str, int]:
        """Return the places of a block's own names in the table of its node."""
        known = self._known.setdefault((role, spec.name), {})
        if not known:
            index, before = group.plans[role].table.index, f"{spec.name}."
            known |= {k.removeprefix(before): i for k, i in index.items() if k.startswith(before)}
        return known

    def _why_alone(self, cases: Sequence[Case]) -> str:
        other = {name for case in cases for name in case.settings if name not in self._own}
        return f"{', '.join(sorted(other))} is not a setting of a block" if other else ""

    def _fill(self, group: LaneGroup, cases: Sequence[Case]) -> list[str]:
        """Put the cases into the lanes; return why one is refused, "" for the others."""
        group.begin()
        refusals = []
        for lane, case in enumerate(cases):
            try:
                for role, spec in self._specs(case):
                    rate_hz = self.rig.config.rate_hz
                    pairs = prepared_values(spec.block, spec.settings, rate_hz, case.seed)
                    places = self._places(group, role, spec)
                    values = {places[name]: value for name, value in (*pairs[0], *pairs[1])}
                    group.put(lane, role, values)
                group.put_seed(lane, case.seed)
                refusals.append("")
            except (ValueError, RigError) as error:
                refusals.append(str(error))
        if "" in refusals:  # lanes without a run do what another does: none is stopped by them
            group.repeat(
                refusals.index(""), [i for i in range(WIDTH) if i >= len(refusals) or refusals[i]]
            )
        return refusals

    def _specs(self, case: Case) -> Iterator[tuple[Role, BlockSpec]]:
        """Yield the blocks that a case changes, with its settings. ValueError: out of range."""
        changed: dict[tuple[Role, str], dict[str, float]] = {}
        for name, value in case.settings.items():
            role, spec, setting = self._own[name]
            _check_range(name, spec, setting, value)
            changed.setdefault((role, spec.name), {})[setting] = value
        for role, node in self.rig.nodes().items():
            for spec in node.blocks:
                changed_settings = changed.get((role, spec.name), {})
                seeded = spec.block.prepare is not None and case.seed != self.rig.config.seed
                if changed_settings or seeded:
                    yield role, replace(spec, settings=spec.settings | changed_settings)

    def _log(self, group: LaneGroup, case: Case, lane: int, traces: Traces) -> logs.Log:
        """Return what was kept of a lane, as a log; `traces`: of all, see `LaneGroup.columns`."""
        nodes = {}
        for role, description in group.described.items():
            rows = group.cycles + (role == "plant")
            columns = {
                name: trace[lane, :rows]
                for name, trace in zip(self.wanted[role], traces[role], strict=True)
            }
            timing = set(description["timing_columns"])
            nodes[str(role)] = logs.NodeLog(
                self._cycles[:rows],
                self._stamps_ns[:rows],
                Columns(description["state_columns"], columns.__getitem__),
                {name: one for name, one in columns.items() if name in timing},
                np.empty(0, logs.FRAME),
                [],
                [],
                description,
            )
        metadata = {str(role): METADATA for role in group.plans}
        return logs.Log(Path(), nodes, {}, metadata, [], rig=self._data(case))

    @cached_property
    def _cycles(self) -> NDArray[np.int64]:
        """The cycles of the plant: those of every run, and one more."""
        return np.arange(cycles_of(self.rig) + 1)

    @cached_property
    def _stamps_ns(self) -> NDArray[np.int64]:
        return self._cycles * self.rig.config.period_ns

    def _data(self, case: Case) -> dict[str, Any]:
        """Return the effective rig of a case: the common one, what is changed in copies."""
        data = {**self.rig.effective(), "seed": case.seed}
        for name, value in case.settings.items():
            role, spec, setting = self._own[name]
            section: Any = data
            for key in (*law_keys(self.rig.config, role, spec.name), "parameters"):
                section[key] = dict(section[key])
                section = section[key]
            section[setting] = value
        return data

    def rig_of(self, case: Case) -> Rig:
        """Return the rig of a case, read from its file. RigError for what cannot be.

        UserError: the file is no longer that of the other runs.
        """
        rig = load_rig(self.path, self.controller, [*self.settings, *case.words()])
        if rig.document.sources != self.rig.document.sources:
            raise UserError(f"{self.path}: has changed since the first run; begin again")
        return rig

    def _alone(self, case: Case, why: str) -> RunResult:
        """Return a run done by itself."""
        try:
            run = VirtualRun(self.rig_of(case), None)
        except RigError as error:
            return RunResult(None, alone=why, refused=str(error))
        try:
            for _ in run.advance():
                pass
        except StepError:  # one that raises is a fault of this run; one that hangs goes on hanging
            for block in run.blocks:
                if what := hanging_step(block.description, block.control):
                    raise StepError(what) from None
        codes = [int(block.control.fault) for block in run.blocks]
        fault = next((FAULT_NAMES[code] for code in codes if code), "")
        return RunResult(run.memory.log(), fault, why)


def _case_parts(cases: dict[int, Case]) -> list[dict[int, Case]]:
    """Return the cases in parts: by the setting with the fewest values, else in halves."""
    names = {name for case in cases.values() for name in case.settings}
    values = {name: {case.settings.get(name) for case in cases.values()} for name in names}
    few = [name for name in sorted(names) if 1 < len(values[name]) < len(cases)]
    if few:
        name = min(few, key=lambda name: len(values[name]))
        return [
            {i: case for i, case in cases.items() if case.settings.get(name) == value}
            for value in values[name]
        ]
    half, own = len(cases) // 2, list(cases.items())
    return [dict(part) for part in (own[:half], own[half:]) if part]


def _check_range(name: str, spec: BlockSpec, setting: str, value: float) -> None:
    port = next(port for port in spec.block.settings if setting in port.names())
    if not (port.low <= value <= port.high and math.isfinite(value)):
        unit = f" {port.unit}" if port.unit else ""
        raise ValueError(
            f"{name} = {value:.12g} is outside {port.low:.12g}..{port.high:.12g}{unit}"
        )

"""One round of `pcpc jitter` of the product itself: plants/probe, run as `pcpc run` runs it.

The figures are those of the log, every cycle of the nodes; nothing is timed from outside.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.timing_layout import Stage
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.machine.jitter import nines
from pcpc.tools.machine.jitter.loops import JitterError, Setup
from pcpc.tools.run.commands import RunRequest
from pcpc.tools.run.run import Host
from pcpc.tools.start.folder import LOG
from pcpc.tools.terminal.arguments import RunFolder
from pcpc.tools.terminal.progress import Progress

RIG = Path(__file__).resolve().parents[3] / "plants" / "probe" / "rig.yaml"
STAGES = Stage.words()[: Stage.WORK]
_PLANT_BELOW = 10  # of the executive's priority, as in every rig
ROLES = ("executive", "plant")
_COUNTERS = ("passes", "late_cycles", "skipped_cycles", "send_errors", "held_cycles")
_UNPACED = {"executive": 0, "plant": 1}  # first cycles that a frame started, not the clock
Ints = NDArray[np.int64]
Vector = NDArray[np.float64]


@dataclass(frozen=True)
class ProbedNode:
    """One node, one round or several: each stage of each cycle, (n,) us; pids and priority.

    `publish` has one value less a round: a cycle tells how long the previous one published.
    `paths_us`: `nines.WAYS` of the executive.
    """

    stages_us: dict[str, Vector]
    missed: int
    late: int
    pid: int
    priority: int
    paths_us: dict[str, Vector] = field(default_factory=dict)

    @property
    def cycles(self) -> int:
        """Cycles that were done."""
        return len(self.stages_us["wake_late"])

    @property
    def late_ns(self) -> Ints:
        """Lateness of each cycle, ns, as the loop took it."""
        return np.rint(1e3 * self.stages_us["wake_late"]).astype(np.int64)


@dataclass(frozen=True)
class Probe:
    """A round: its nodes by name, none if it was interrupted before its first cycle."""

    nodes: dict[str, ProbedNode]
    fifo: bool
    interrupted: bool
    bus: str
    metadata: dict[str, str] = field(default_factory=dict)


class _LabelledProgress(Progress):
    """Shows the host's progress behind `label`; what it would say every round is left out."""

    def __init__(self, progress: Progress, label: str) -> None:
        super().__init__()
        self._to, self._label = progress, label

    def due(self) -> bool:
        return self._to.due()

    def show(self, text: str) -> None:
        self._to.show(f"{self._label} {text}")

    def say(self, text: str) -> None:
        pass

    def close(self) -> None:
        self._to.close()


def settings_of(setup: Setup) -> list[str]:
    """Return the `--set` options of a round."""
    settings = [
        f"rate_hz={1e9 / setup.interval_ns!r}",
        f"duration_s={setup.round_s!r}",
        f"realtime.executive.priority={setup.priority}",
        f"realtime.plant.priority={max(setup.priority - _PLANT_BELOW, 1)}",
    ]
    for thread, role in enumerate(("executive", "plant")):
        if (cpu := setup.cpu(thread)) is not None:
            settings.append(f"realtime.{role}.cpu={cpu}")
    return settings


def run(setup: Setup, folder: Path, progress: Progress, label: str) -> Probe:
    """Run the probe into the existing empty `folder`; RigError, BusError, SharedError, JitterError.

    JitterError also tells a fault, the death of a process, or a log that is not whole.
    """
    rig = load_rig(RIG, None, settings_of(setup), resolve=False)
    request = RunRequest(
        rig=str(RIG),
        set=settings_of(setup),
        bus=setup.bus,
        pacing="real",
        kept=RunFolder(quiet=True, no_figure=True),
        begin_ns=time.monotonic_ns(),
    )
    host = Host(request, rig, ("plant", "executive"), folder)
    host.progress = _LabelledProgress(progress, label)
    if (code := host.run()) >= 0:
        raise JitterError("", Exit(code))
    outcome, bus = host.outcome, str(host.bus)
    if outcome.faults:
        raise JitterError("; ".join(outcome.faults), Exit.LOSS)
    pids = {role: child.process.pid for role, child in host.children.items()}
    try:
        nodes, metadata = read(folder / LOG, setup, pids, outcome.interrupted)
    except logs.LogError as error:
        if outcome.interrupted:
            return Probe({}, False, True, bus)
        raise JitterError(str(error), Exit.LOSS) from None
    fifo = all(bool(block.control.realtime) for block in host.blocks.values())
    return Probe(nodes, fifo, outcome.interrupted, bus, metadata)


def read(
    log: Path, setup: Setup, pids: dict[str, int], interrupted: bool = False
) -> tuple[dict[str, ProbedNode], dict[str, str]]:
    """Return the nodes of a log and the executive's metadata; LogError, JitterError for a loss."""
    names = [f"timing.{stage}_us" for stage in STAGES]
    names += [f"health.{name}" for name in _COUNTERS]
    parts: dict[str, dict[str, list[Vector]]] = {
        node: {name: [] for name in names} for node in ROLES
    }
    missing: list[str] = []
    metadata: dict[str, str] = {}
    stamps: dict[str, list[Ints]] = {name: [] for name in ("wake", "CMD", "SYNC")}
    for piece, _ in logs.pieces(log):
        missing += piece.missing
        for name, part in piece.node.items():
            if name == "executive":
                metadata |= piece.metadata[name]
                _add_stamps(stamps, part)
            for column, rows in parts[name].items() if len(part.cycle) else ():
                rows.append(part.timing[column])
    nodes = {}
    for name, columns in parts.items():
        table = {column: np.concatenate(rows or [np.empty(0)]) for column, rows in columns.items()}
        passes = table["health.passes"]
        if not np.array_equal(passes, np.arange(len(passes))) or not len(passes):
            missing.append(f"{name}: cycles are not in the log")
            continue
        nodes[name] = _node(name, table, setup, pids.get(name, 0), interrupted)
        if name == "executive":
            paths = _paths(stamps, table, setup, interrupted)
            missing += [] if paths else ["executive: frames are not in the log"]
            nodes[name] = replace(nodes[name], paths_us=paths)
    if missing and not interrupted:
        raise JitterError(f"the log is incomplete: {'; '.join(missing)}", Exit.LOSS)
    return nodes, metadata


def _add_stamps(stamps: dict[str, list[Ints]], part: logs.NodeLog) -> None:
    """Add cycle and stamp, ns, of each wake-up, command and SYNC."""
    stamps["wake"].append(np.stack([part.cycle, part.stamp_ns]))
    for word, name in part.description["frames"].items():
        if name in stamps:
            frames = part.frames[(part.frames["id"] == int(word)) & (part.frames["direction"] == 0)]
            stamps[name].append(np.stack([frames["cycle"], frames["stamp_ns"]]))


def _paths(
    stamps: dict[str, list[Ints]],
    table: dict[str, Vector],
    setup: Setup,
    interrupted: bool,
) -> dict[str, Vector]:
    """Return the executive's `nines.WAYS`, none if a command or a SYNC of a cycle is not there."""
    cycle, wakes_ns = np.concatenate(stamps["wake"], axis=1)
    sent_ns = []
    for name, wanted in (("CMD", cycle), ("SYNC", np.concatenate([cycle[:1], cycle]))):
        rows = np.concatenate(stamps[name], axis=1)
        rows = rows[:, rows[0] <= cycle[-1]]  # the frames of the end come after
        if not np.array_equal(rows[0], wanted):
            return {}
        sent_ns.append(rows[1])
    commands_ns, syncs_ns = sent_ns
    refused, held = (
        np.diff(table[f"health.{what}"], prepend=0.0) > 0.0
        for what in ("send_errors", "held_cycles")
    )
    return nines.whole_path(
        cycle,
        table["timing.wake_late_us"],
        wakes_ns,
        commands_ns,
        syncs_ns,
        refused,
        held,
        setup.interval_ns / 1000.0,
        int(cycle[-1]) + 1 if interrupted else setup.periods,
    )


def _node(
    name: str, table: dict[str, Vector], setup: Setup, pid: int, interrupted: bool
) -> ProbedNode:
    first, ran = _UNPACED[name], len(table["health.passes"])
    stages = {stage: table[f"timing.{stage}_us"][first:] for stage in STAGES}
    stages["publish"] = table["timing.publish_us"][first + 1 :]
    missed = int(table["health.skipped_cycles"][-1])
    if name == "executive" and not interrupted:  # also those skipped at the very end
        missed = setup.periods - ran
    priority = setup.priority
    if name == "plant":
        priority = max(priority - _PLANT_BELOW, 1)
    return ProbedNode(stages, missed, int(table["health.late_cycles"][-1]), pid, priority)


def join_rounds(rounds: Sequence[ProbedNode]) -> ProbedNode:
    """Return several rounds of a node as one; pid and priority are the last one's."""
    stages = {stage: np.concatenate([one.stages_us[stage] for one in rounds]) for stage in STAGES}
    missed, late = sum(one.missed for one in rounds), sum(one.late for one in rounds)
    paths = {
        way: np.concatenate([one.paths_us[way] for one in rounds if one.paths_us])
        for way in (nines.WAYS if any(one.paths_us for one in rounds) else ())
    }
    return ProbedNode(stages, missed, late, rounds[-1].pid, rounds[-1].priority, paths)

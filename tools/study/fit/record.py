"""What a log tells a fit: the commands as the plant got them, the sensors as the other node did.

given      the plant's own record of what it received; of a log without the plant, hardware's,
           what was sent to it one cycle before, rounded to the bus
measured   what came of the plant over the bus, in the cycles in which a frame was due and came
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcpc.executive.batch.driven import DrivenPlant
from pcpc.executive.errors import RigError
from pcpc.executive.log.reader import Log, NodeLog
from pcpc.tools.study.arrays import Array

LEAST_ROWS = 50


@dataclass(frozen=True)
class MeasuredRun:
    """Commands `given` (rows, received) and samples `measured` (rows, sensors), NaN for none.

    `first`: the cycle of the first row.
    """

    given: Array
    measured: Array
    first: int
    period_s: float

    @property
    def t_s(self) -> Array:
        """Time of the rows, s."""
        return np.asarray((self.first + np.arange(len(self.given))) * self.period_s, np.float64)


def record_of(log: Log, plant: DrivenPlant, sensors: Sequence[str]) -> MeasuredRun:
    """Return what `log` tells of `plant`; a sensor BLOCK.PORT is the plant's own record of it.

    RigError for a log of another plant, one that is too short, or one with tunings of the plant.
    """
    own = log.node.get("plant")
    other = next(
        (log.node[name] for name in ("executive", "local") if _hears(log, name, sensors)), None
    )
    nodes = [node for node in (own, other) if node is not None]
    if not nodes:
        raise RigError(f"{log.path}: no cycles of the plant, nor of a node that receives it")
    _check(log, plant, nodes, sensors)
    first = max(int(node.cycle[0]) for node in nodes)
    rows = min(int(node.cycle[-1]) for node in nodes) + 1 - first
    if rows < LEAST_ROWS:
        raise RigError(f"{log.path}: {max(rows, 0)} cycles of the plant; a fit takes {LEAST_ROWS}")
    measured = np.stack([_samples(plant, own, other, name, first, rows) for name in sensors], 1)
    return MeasuredRun(
        _given_signals(plant, own, other, first, rows),
        measured,
        first,
        1.0 / plant.rig.config.rate_hz,
    )


def _hears(log: Log, name: str, sensors: Sequence[str]) -> bool:
    node = log.node.get(name)
    return node is not None and any(f"rx.{one}" in node.columns for one in sensors)


def _check(log: Log, plant: DrivenPlant, nodes: Sequence[NodeLog], sensors: Sequence[str]) -> None:
    """Raise RigError for a log that is not of this plant."""
    rate_hz = plant.rig.config.rate_hz
    for node in nodes:
        if not len(node.cycle):
            raise RigError(f"{log.path}: it holds no cycle")
        if node.description["period_ns"] != round(1e9 / rate_hz):
            what = f"{1e9 / node.description['period_ns']:g} cycles a second, the rig {rate_hz:g}"
            raise RigError(f"{log.path}: it has {what}; give the rig of the log")
    known = {name for node in nodes for name in node.columns}
    lacks = [
        name
        for name in (*plant.received, *sensors)
        if not {name, f"rx.{name}", f"tx.{name}"} & known
    ]
    if lacks:
        named = ", ".join(lacks[:3]) + (", ..." if len(lacks) > 3 else "")
        raise RigError(f"{log.path}: it has no {named}; give the rig of the log")
    tuned = [entry.get("name") for node in nodes for entry in node.tunings]
    if found := [name for name in tuned if name in plant.settings]:
        raise RigError(f"{log.path}: {found[0]} was tuned in it; a fit needs a constant plant")


def _given_signals(
    plant: DrivenPlant, own: NodeLog | None, other: NodeLog | None, first: int, rows: int
) -> Array:
    found = np.zeros((rows, len(plant.received)))
    for i, name in enumerate(plant.received):
        if own is not None:
            found[:, i] = _held_values(own, f"rx.{name}", first, rows, 0)
        elif other is not None and f"tx.{name}" in other.columns:
            found[:, i] = plant.rounded(name, _held_values(other, f"tx.{name}", first, rows, 1))
    return found


def _held_values(node: NodeLog, name: str, first: int, rows: int, later: int) -> Array:
    """Return a column by cycle, each value until the next one; `later` cycles later."""
    at = np.searchsorted(node.cycle, first + np.arange(rows) - later, side="right") - 1
    values = np.asarray(node.columns[name])[np.maximum(at, 0)]
    return np.where(at < 0, 0.0, values)


def _samples(
    plant: DrivenPlant, own: NodeLog | None, other: NodeLog | None, name: str, first: int, rows: int
) -> Array:
    """Return the samples of a sensor (rows,), NaN where none was due or came."""
    heard = other is not None and f"rx.{name}" in other.columns
    node = other if heard else own
    assert node is not None
    cycles = first + np.arange(rows)
    at = np.minimum(np.searchsorted(node.cycle, cycles), len(node.cycle) - 1)
    there = (node.cycle[at] == cycles) & (cycles % plant.every.get(name, 1) == 0)
    if heard and "supervisor.missing_cycles" in node.columns:
        there &= np.asarray(node.columns["supervisor.missing_cycles"])[at] == 0.0
    column = f"rx.{name}" if heard else name if name in node.columns else f"tx.{name}"
    return np.where(there, np.asarray(node.columns[column])[at], np.nan)

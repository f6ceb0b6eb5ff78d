"""The rig's limits of received signals, planned for one node: checked, counted, installed."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pcpc.drivers.can import dbc
from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.table import Table, Variable
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import Plausible

COUNT = "health.implausible."  # and the signal


def signal_limits(rig: Rig, role: Role) -> Mapping[str, Plausible]:
    """Return the limits of the signals that a node receives."""
    return rig.config.sections[role].plausible


def add_counts(rig: Rig, role: Role, table: Table) -> None:
    """Add the counter of each limited signal; RigError for limits that make no sense."""
    received = {v.name[3:]: v for v in table.variables if v.kind == "received"}
    for name, limit in signal_limits(rig, role).items():
        key = f"{role}.plausible.{name}"
        if name not in received:
            what = f"{rig.config.sections[role].node} receives no signal {name}"
            raise rig.error(key, what + did_you_mean(name, received))
        if not limit.low < limit.high:
            raise rig.error(key, f"low {limit.low:g} is not below high {limit.high:g}")
        signal = received[name]
        if limit.high < signal.low or limit.low > signal.high:
            span = f"{signal.low:g}..{signal.high:g} {signal.unit}".rstrip()
            raise rig.error(key, f"no value of {name}, {span}, lies within these bounds")
        if limit.rate_per_s is not None and not math.isfinite(limit.rate_per_s):
            what = f"expected a finite number, got {limit.rate_per_s:g}; null is no rate limit"
            raise rig.error(f"{key}.rate_per_s", what)
        help = f"values of {name} that were not taken"
        table.add(Variable(COUNT + name, "", "health", "loop", help))
    if len(signal_limits(rig, role)) > sh.MAX_LIMITS:
        raise rig.error(f"{role}.plausible", f"one node holds {sh.MAX_LIMITS} limits")


def install_plausible(
    rig: Rig, role: Role, table: Table, frames: Sequence[dbc.Frame], loop: Any
) -> None:
    """Write the limits of received signals into the LOOP record."""
    these, default = loop.plausible, rig.config.supervisor.fault_after_cycles
    rows = {frame.name: row for row, frame in enumerate(frames)}
    for i, (name, limit) in enumerate(signal_limits(rig, role).items()):
        rate = math.inf if limit.rate_per_s is None else limit.rate_per_s / rig.config.rate_hz
        these.row[i] = rows[name.partition(".")[0]]
        these.place[i], these.count_place[i] = table.index[f"rx.{name}"], table.index[COUNT + name]
        these.still_cycles[i] = limit.still_cycles or 2**62
        these.fault_after[i] = limit.fault_after or default
        these.bounds[i] = limit.low, limit.high, rate
        these.taken_at[i], these.came[i] = -1, math.nan
    these.n = len(signal_limits(rig, role))

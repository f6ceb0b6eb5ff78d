"""The rig's limits of received signals, planned for one node: checked, counted, installed."""

import math
from collections.abc import Mapping

from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.table import Variable
from pcpc.executive.nodes.part import Part, Plan, Size
from pcpc.executive.rig.node_keys import Plausible as Limits
from pcpc.executive.rig.reading import Rig

COUNT = "health.implausible."  # and the signal


class Plausible(Part):
    """Received values that cannot be true, and how many there were."""

    def variables(self, made: Plan) -> None:
        """Add the counter of each limited signal; RigError for limits that make no sense."""
        rig, received = made.rig, made.of_kind("received")
        for name, limit in _limits(made).items():
            key = f"{made.role}.plausible.{name}"
            if name not in received:
                problem = f"{rig.config.sections[made.role].node} receives no signal {name}"
                raise rig.error(key, problem + did_you_mean(name, received))
            if not limit.low < limit.high:
                raise rig.error(key, f"low {limit.low:g} is not below high {limit.high:g}")
            signal = received[name]
            if limit.high < signal.low or limit.low > signal.high:
                span = f"{signal.low:g}..{signal.high:g} {signal.unit}".rstrip()
                raise rig.error(key, f"no value of {name}, {span}, lies within these bounds")
            if limit.rate_per_s is not None and not math.isfinite(limit.rate_per_s):
                problem = (
                    f"expected a finite number, got {limit.rate_per_s:g}; null is no rate limit"
                )
                raise rig.error(f"{key}.rate_per_s", problem)
            help = f"values of {name} that were not taken"
            made.add(Variable(COUNT + name, "", "health", "loop", help))

    def sizes(self, made: Plan) -> list[Size]:
        """Return how many signals are limited."""
        return [("limits of received values", len(_limits(made)), sh.MAX_LIMITS)]

    def in_no_lane(self, rig: Rig) -> str:
        """Return that received values are limited."""
        return (
            "it limits what it receives"
            if any(section.plausible for section in rig.config.sections.values())
            else ""
        )

    def install(self, made: Plan, loop: Loop) -> None:
        """Write the limits."""
        these, config, index = loop.plausible, made.rig.config, made.table.index
        rows = {frame.name: row for row, frame in enumerate(made.rx_frames)}
        for i, (name, limit) in enumerate(_limits(made).items()):
            rate = math.inf if limit.rate_per_s is None else limit.rate_per_s / config.rate_hz
            these.row[i] = rows[name.partition(".")[0]]
            these.place[i], these.count_place[i] = index[f"rx.{name}"], index[COUNT + name]
            these.still_cycles[i] = limit.still_cycles or 2**62
            these.fault_after[i] = limit.fault_after or config.supervisor.fault_after_cycles
            these.bounds[i] = limit.low, limit.high, rate
            these.taken_at[i], these.came[i] = -1, math.nan
        these.n = len(_limits(made))


def _limits(made: Plan) -> Mapping[str, Limits]:
    return made.rig.config.sections[made.role].plausible

"""The commands of a node: limits of what it sends, safe values of what it receives."""

import math

from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes.part import Part, Plan, Size
from pcpc.executive.rig.commands import commands


class Commands(Part):
    """`limits` and `safe` of a rig."""

    def variables(self, made: Plan) -> None:
        """Find the limits of what is sent; RigError for a signal that is not there."""
        sent = made.of_kind("sent")
        for key, names, known in (
            ("limits", made.spec.limits, sent),
            ("safe", made.spec.safe, made.of_kind("received")),
        ):
            for name in names:
                if name not in known:
                    place = made.rig.where(f"{made.role}.{key}.{name}")
                    what = f"{made.spec.name} has no such signal {name}{did_you_mean(name, known)}"
                    raise RigError(f"{place}: {what}")
        made.limits = commands(made.rig, made.role, sent)

    def sizes(self, made: Plan) -> list[Size]:
        """Return how many limits there are, of the direction that has more."""
        return [("limits", max(len(made.limits), len(made.spec.safe)), sh.MAX_LIMITS)]

    def install(self, made: Plan, loop: Loop) -> None:
        """Write them; a rate is one a cycle."""
        guard, limits, index = loop.guard, loop.limits, made.table.index
        period_s = loop.clock.period_ns * 1e-9
        for i, (name, limit) in enumerate(made.limits.items()):
            rate = math.inf if limit.rate_per_s is None else limit.rate_per_s * period_s
            limits.place[i] = index[f"tx.{name}"]
            limits.table[i] = (limit.low, limit.high, rate, *(limit.safe or 0.0,) * 3)
        for i, (name, value) in enumerate(made.spec.safe.items()):
            guard.safe_index[i] = index[f"rx.{name}"]
            guard.safe[i] = (0.0, value)
        limits.n, guard.n_safe = len(made.limits), len(made.spec.safe)

"""What of a node's plan is where in C, for a node alone (`node`) and for a device (`rig_source`).

A block NAME has four structs: parameters p, states x, inputs u, outputs y; one without ports is
left out, as in the C of its law (`tools.make.generate.translator.law`).
"""

import math
from collections.abc import Iterator

from pcpc.executive.loop.table import Variable, Views
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.schema import FALLBACK
from pcpc.tools.make.generate.translator.law import LETTERS, ROLES, elements, law_files, signature
from pcpc.tools.make.generate.words import identifier


class Wiring:
    """Where each variable of a plan is in C; a subclass says how it is called there."""

    def __init__(self, made: Plan) -> None:
        self.plan = made
        both = zip(made.spec.blocks, made.views, strict=True)
        self.blocks = [(spec, views) for spec, views in both if spec.name != FALLBACK]
        self.period_s = made.rig.config.period_ns * 1e-9
        self.places = {
            place: f"{self.part(spec, role)}.{text}"
            for spec, views in self.blocks
            for role, ports in zip(ROLES, spec.block.step.declared, strict=True)
            for place, text in zip(getattr(views, role), elements(ports.layout), strict=True)
        }

    def part(self, spec: BlockSpec, role: str) -> str:
        """Return the expression of one of a block's structs."""
        raise NotImplementedError

    def other(self, variable: Variable) -> str:
        """Return the expression of a variable of no block."""
        raise NotImplementedError

    def law(self, spec: BlockSpec) -> str:
        """Return the name of a block's law in C."""
        return identifier(spec.name)

    def at(self, place: int) -> str:
        """Return the expression of a variable."""
        if place not in self.places:
            self.places[place] = self.other(self.plan.table.variables[place])
        return self.places[place]

    def copies(self, block: int) -> list[str]:
        """Return the assignments before a block, or (-1) to what is sent."""
        copies = self.plan.copies[block]
        return [f"    {self.at(target)} = {self.at(source)};" for source, target in copies]

    def pointers(self, spec: BlockSpec, letters: str = "pxuy") -> list[str]:
        """Return pointers to those structs of a block, as its functions take them."""
        roles = [role for role in signature(spec.block) if LETTERS[role] in letters]
        return [f"&{self.part(spec, role)}" for role in roles]

    def step(self, spec: BlockSpec, *times: str) -> list[str]:
        """Return what carries a block through a cycle: what it takes, then its step."""
        given = ", ".join((*times, *self.pointers(spec)))
        block = [one.name for one in self.plan.spec.blocks].index(spec.name)
        return [*self.copies(block), f"    {self.law(spec)}_step({given});"]

    def limits(self) -> Iterator[tuple[str, tuple[float, ...]]]:
        """Yield what is limited, with its low, high, most change in a cycle and safe value."""
        for name, limit in self.plan.limits.items():
            rate = math.inf if limit.rate_per_s is None else limit.rate_per_s * self.period_s
            where = self.at(self.plan.table.index[f"tx.{name}"])
            yield where, (limit.low, limit.high, rate, limit.safe or 0.0)

    def law_files(self, spec: BlockSpec, views: Views) -> dict[str, str]:
        """Return the files of a block, which begins with the rig's values."""
        variables, values = self.plan.table.variables, self.plan.values
        parameters, states = (
            [(variables[i].name, values.get(i, 0.0)) for i in places]
            for places in (views.parameters, views.states)
        )
        return law_files(spec.block, self.law(spec), (parameters, states))

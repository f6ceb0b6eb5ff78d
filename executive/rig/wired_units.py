"""The unit of a reference of any unit (`law: profiles:step`): that of the input which it feeds.

    value [m] feeds x_d_m [m]       rate is in m/s, acc in m/s2, the amplitude in m
    only rate feeds v_d_m_s [m/s]   the value is in m
    no block is fed                 `unit: m` at the block says it

Given units are compared with the wiring as all others are, by `executive.loop.table`.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

from pcpc.executive.laws.units import unit
from pcpc.executive.rig.yamlfile import Document, Keys

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block

ORDERS = {"value": 0, "rate": 1, "acc": 2}  # outputs, and which derivative each is


class WiredBlock(Protocol):
    """A block with what it is wired to."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def block(self) -> "Block": ...  # noqa: D102
    @property
    def inputs(self) -> Mapping[str, str]: ...  # noqa: D102


def is_free(block: "Block") -> bool:
    """Return whether the block takes its unit from the wiring."""
    from pcpc.executive.laws.ports import ANY_UNIT  # here, because it imports numba

    return any(ANY_UNIT in port.unit for port in block.outputs)


def in_its_unit(
    document: Document,
    keys: Keys,
    name: str,
    block: "Block",
    named_unit: str | None,
    others: Sequence[WiredBlock],
) -> "Block":
    """Return the block `name` in `named_unit`, or in the unit that the `others` have; RigError."""
    if not is_free(block):
        if named_unit is not None:
            what = "only references of any unit take it, as law: profiles:step"
            raise document.error((*keys, "unit"), what)
        return block
    its = _fed_unit(document, keys, name, others) if named_unit is None else named_unit.strip()
    return block.with_units(lambda text: _derived_unit(text, its))


def _fed_unit(document: Document, keys: Keys, name: str, others: Sequence[WiredBlock]) -> str:
    """Return the unit of what the block's value feeds, or its derivatives."""
    for output, order in ORDERS.items():
        for other in others:
            ports = {one: port.unit for port in other.block.inputs for one in port.names()}
            for target, source in other.inputs.items():
                if source != f"{name}.{output}" or target not in ports:
                    continue
                its = _integrated_unit(ports[target], order)
                if its is None:
                    problem = f"{source} feeds {other.name}.{target}, whose unit "
                    kind = "a rate" if order == 1 else "an acceleration"
                    problem += f"'{ports[target]}' is not {kind}"
                    raise document.error(keys, f"{problem}; give `unit: ...` for the value")
                return its
    problem = "no input defines its unit: wire its value to one"
    raise document.error(keys, f'{problem}, or give `unit: m` (`unit: ""`: a plain number)')


def _derived_unit(text: str, its_unit: str) -> str:
    """Return "?", "?/s" or "?/s2" with `its_unit` for the ?; other texts as they are."""
    head, mark, _ = text.partition("?")
    return head + unit(its_unit).per_second(unit(text).order).text if mark else text


def _integrated_unit(given: str, order: int) -> str | None:
    """Return the unit whose derivative of this order is `given`; None if there is none."""
    known = unit(given)
    return known.per_second(-order).text if known.order >= order else None

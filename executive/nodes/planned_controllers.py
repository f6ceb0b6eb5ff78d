"""Several controllers in one executive: the one of the rig, others on standby, one for overruns.

With `standby` the executive has, behind its controllers, the block `handover` of
`executive.laws.handover`. `controller.` are then the parameters, states and inputs of the rig's own
controller, and the outputs of whoever is in charge; what each law wants stands under its own name,
and so does the rest of those on standby. The loop does not know of it: a hand-over is a tuning.
"""

import dataclasses
from collections.abc import Iterator, Mapping

from pcpc.executive.laws import handover
from pcpc.executive.laws.block import Block, Port
from pcpc.executive.loop.table import Table, Views, add_block
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.reading import NodeSpec, Rig
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import FALLBACK
from pcpc.executive.rig.standby import BLOCK, IN_CHARGE, TO, laws

_OWN = "controller"
_blocks: dict[str, Block] = {}  # that were made in this process, by their arguments


def complete(rig: Rig, role: Role) -> NodeSpec:
    """Return what a node computes, with the hand-over where there is one; RigError."""
    spec, names = rig.nodes()[role], laws(rig.config)
    if role != "executive" or len(names) == 1:
        return spec
    blocks = _by_law(rig, spec)
    adapted = list(_adapting_values(blocks))
    outputs = _outputs(rig, spec, blocks)
    about = names, outputs, [port for _, _, port in adapted], [owner for owner, _, _ in adapted]
    block = _blocks.get(repr(about)) or handover.block(*about)
    _blocks[repr(about)] = block
    config = rig.config.handover
    if config.to > len(names) - 1:
        raise rig.error("handover.to", f"{config.to:g}; expected 0 to {len(names) - 1}")
    sources = [
        f"{names[j if one.has[j] else 0]}.{one.name}" for j in range(len(names)) for one in outputs
    ] + [f"{_prefix(names, owner)}.{name}" for owner, name, _ in adapted]
    inputs = dict(zip((port.name for port in block.inputs), sources, strict=True))
    settings = {"to": config.to, "over_s": config.over_s}
    made = BlockSpec(BLOCK, block, settings, inputs, {"": rig.where("standby")})
    at = 1 + max(spec.blocks.index(one) for one in spec.blocks if one.name in (_OWN, *names))
    return dataclasses.replace(spec, blocks=[*spec.blocks[:at], made, *spec.blocks[at:]])


def _by_law(rig: Rig, spec: NodeSpec) -> list[Block]:
    """Return the blocks of the controllers that one can hand over to, the rig's own first."""
    found = {one.name: one.block for one in spec.blocks}
    return [found[_OWN], *(found[name] for name in rig.config.standby)]


def _prefix(names: tuple[str, ...], law: int) -> str:
    """Return how states and parameters of a law begin."""
    return names[law] if law else _OWN


def _adapting_values(blocks: list[Block]) -> Iterator[tuple[int, str, Port]]:
    """Yield law, name and port of each value that adapts."""
    for owner, block in enumerate(blocks):
        for port in block.states:
            if port.adapts:
                yield from ((owner, name, port) for name in port.names())


def _outputs(rig: Rig, spec: NodeSpec, blocks: list[Block]) -> list[handover.Output]:
    """Return the controller's outputs; RigError if a law on standby lacks one that is a command."""
    known = [
        {name: port.unit for port in block.outputs for name in port.names()} for block in blocks
    ]
    wired = [*spec.transmit.values(), *(s for one in spec.blocks for s in one.inputs.values())]
    outputs = [
        handover.Output(
            name, unit, [one.get(name) == unit for one in known], f"{_OWN}.{name}" in wired
        )
        for name, unit in known[0].items()
    ]
    commands = {spec.transmit[signal] for signal in _commands(rig, spec) if signal in spec.transmit}
    for output in outputs:
        for law, has in zip(laws(rig.config), output.has, strict=True):
            if not has and f"{_OWN}.{output.name}" in commands:
                what = f"{law} has no output {output.name} [{output.unit}], which is a command of "
                what += f"{rig.config.controller}; it cannot be on standby for it"
                raise rig.error("standby", what)
    return outputs


def _commands(rig: Rig, spec: NodeSpec) -> set[str]:
    """Return the sent signals that have limits, or a safe value where they are received."""
    theirs = {name for node in rig.nodes().values() for name in node.safe}
    return theirs | set(spec.limits)


def views(rig: Rig, table: Table, made: list[Views], spec: BlockSpec, all_: list[str]) -> Views:
    """Add a block's variables; RigError if a fallback has other outputs than its controller.

    `made`: the views of the blocks before; `all_`: the names of all.
    """
    names = laws(rig.config)
    if spec.name == FALLBACK:
        return _of_fallback(rig, table, made[all_.index(_OWN)], spec)
    if BLOCK not in all_ or spec.name not in (_OWN, BLOCK, *names):
        return add_block(table, spec.name, spec.block)
    if spec.name == BLOCK:
        return _of_handover(rig, table, spec)
    law = names[0] if spec.name == _OWN else spec.name
    return Views(
        table.add_ports(spec.name, spec.block.parameters, "parameter", False),
        table.add_ports(spec.name, spec.block.states, "state", True),
        table.add_ports(spec.name, spec.block.inputs, "input", False),
        table.add_ports(law, spec.block.outputs, "output", True),
        judged=0,
    )


def _of_handover(rig: Rig, table: Table, spec: BlockSpec) -> Views:
    """Add the variables of the hand-over: first the outputs of whoever is in charge."""
    own = _by_law(rig, rig.nodes()["executive"])[0]
    outputs = table.add_ports(_OWN, own.outputs, "output", True)
    rest = table.add_ports(BLOCK, spec.block.outputs[len(outputs) :], "output", True)
    return Views(
        table.add_ports(BLOCK, spec.block.parameters, "parameter", False),
        table.add_ports(BLOCK, spec.block.states, "state", True),
        table.add_ports(BLOCK, spec.block.inputs, "input", False),
        range(outputs.start, rest.stop),
        judged=len(outputs),
    )


def standby_copies(spec: NodeSpec, table: Table) -> list[tuple[int, int]]:
    """Return the copies that keep what a law on standby adapts: from `kept`, to its state."""
    states = [
        source
        for made in spec.blocks
        if made.name == BLOCK
        for name, source in made.inputs.items()
        if name.startswith("adapted_")
    ]
    return [(table.index[f"{BLOCK}.kept_{i}"], table.index[name]) for i, name in enumerate(states)]


def beginning(spec: NodeSpec, table: Table, values: Mapping[int, float]) -> dict[int, float]:
    """Return what the hand-over begins with: states that are kept, and who is in charge."""
    first_values = {kept: values[state] for kept, state in standby_copies(spec, table)}
    if TO in table.index:
        to = values[table.index[TO]]
        first_values |= {table.index[IN_CHARGE]: to, table.index[f"{BLOCK}.asked"]: to}
    return first_values


def _of_fallback(rig: Rig, table: Table, controller: Views, spec: BlockSpec) -> Views:
    """Add the variables of a fallback, which writes the first outputs of the controller."""
    outputs = [name for port in spec.block.outputs for name in port.names()]
    names = (table.variables[place].name for place in controller.outputs)
    known = [name.partition(".")[2] for name in names]
    if outputs != known[: len(outputs)]:
        raise rig.error(
            "overrun.fallback",
            f"its outputs ({', '.join(outputs)}) are not the first of the controller's "
            f"({', '.join(known)}); choose another law",
        )
    first = controller.outputs.start
    return Views(
        table.add_ports(FALLBACK, spec.block.parameters, "parameter", False),
        table.add_ports(FALLBACK, spec.block.states, "state", True),
        table.add_ports(FALLBACK, spec.block.inputs, "input", False),
        range(first, first + len(outputs)),
    )

"""The wiring of a node: what is copied into each block before its step, and into what is sent."""

from pcpc.drivers.can import dbc
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes import planned_controllers
from pcpc.executive.nodes.part import Part, Plan, Size
from pcpc.executive.rig import standby


class Wiring(Part):
    """Copies from variable to variable."""

    def variables(self, made: Plan) -> None:
        """Resolve all `inputs`, then `transmit` to the last copies; RigError."""
        _wire_blocks(made)
        _wire_frames(made)

    def sizes(self, made: Plan) -> list[Size]:
        """Return how many copies there are."""
        return [("wires", sum(map(len, made.copies)), sh.MAX_COPIES)]

    def install(self, made: Plan, loop: Loop) -> None:
        """Write them, and where those of each block end."""
        row, blocks = 0, loop.blocks
        for i, copies in enumerate(made.copies):
            for pair in copies:
                blocks.copies[row] = pair
                row += 1
            blocks.copies_end[i] = row

    def described(self, made: Plan) -> NodeDescription:
        """Return where each value comes from, the blocks in their order, who can take over."""
        names = made.names
        return {
            "sources": {
                names[target]: names[source] for copies in made.copies for source, target in copies
            },
            "blocks": [spec.name for spec in made.spec.blocks],
            "laws": list(standby.laws(made.rig.config)) if standby.IN_CHARGE in names else [],
        }


def _wire_blocks(made: Plan) -> None:
    for spec, views in zip(made.spec.blocks, made.views, strict=True):
        ports = {name: port for port in spec.block.inputs for name in port.names()}
        for name in spec.inputs:
            if name not in ports:
                raise RigError(
                    f"{spec.where(f'inputs.{name}')}: {spec.name} has no input {name}"
                    + did_you_mean(name, ports)
                )
        copies = []
        for target, (name, port) in zip(views.inputs, ports.items(), strict=True):
            if name not in spec.inputs:
                raise RigError(
                    f"{spec.where()}: {spec.name}.{name} [{port.unit}] is not wired: {port.help}; "
                    f"add it to inputs"
                )
            place = spec.where(f"inputs.{name}")
            source = _source(made, spec.inputs[name], port.unit, place, f"{spec.name}.{name}")
            copies.append((source, target))
        made.copies.append(copies)


def _wire_frames(made: Plan) -> None:
    table, sent = made.table, made.of_kind("sent")
    copies = planned_controllers.standby_copies(made.spec, table)
    for name, variable in made.spec.transmit.items():
        place = made.rig.where(f"{made.role}.transmit.{name}")
        if name not in sent:
            raise RigError(
                f"{place}: {made.spec.name} sends no signal {name}{did_you_mean(name, sent)}; "
                "the DBC file says which node sends a frame"
            )
        source = _source(made, variable, sent[name].unit, place, name)
        copies.append((source, table.index[f"tx.{name}"]))
    made.copies += [[] for _ in range(sh.MAX_BLOCKS - len(made.copies))] + [copies]


def _source(made: Plan, name: str, unit: str, place: str, target: str) -> int:
    """Return the index of a wiring source; RigError with the cures of a wrong unit."""
    try:
        return made.table.source(name, unit, place, target)
    except RigError as error:
        cure = _other_cure(made, name, target) if name in made.table.index else ""
        raise RigError(f"{error}{cure}") from None


def _other_cure(made: Plan, name: str, target: str) -> str:
    """Return what else cures a wiring of two units: a reference from a table, the DBC file."""
    block = made.rig.config.sections[made.role].blocks.get(name.partition(".")[0])
    law = "" if block is None else block.law or ""
    if law.startswith("references:"):
        return "; these references are angles; for another unit: law: profiles:step (docs/rig.md)"
    if law.startswith("profiles:"):
        cure = "value, rate and acc are in its unit, unit/s and unit/s2"
        return f"; {cure}, the unit being that of the first input it feeds, or `unit: ...`"
    for path in (name.removeprefix("rx."), target):
        frame, _, signal = path.partition(".")
        if frame in (one.name for one in (*made.rx_frames, *made.tx_frames)):
            where = dbc.place(made.rig.dbc, frame, signal)
            return f"; or change unit and scale in {where}: nothing is converted"
    return ""

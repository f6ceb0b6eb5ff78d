"""The blocks of a node: their variables, parameters and first states, and where these lie."""

from pcpc.executive.errors import RigError
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes import planned_controllers
from pcpc.executive.nodes.part import Part, Plan, Size
from pcpc.executive.own_laws.carried_files import add_reads, noted_reads
from pcpc.executive.own_laws.preparation import prepared_values
from pcpc.executive.rig.blocks import BlockSpec


class Blocks(Part):
    """What a node computes."""

    def variables(self, made: Plan) -> None:
        """Add the ports of each block, with what its settings make of them; RigError."""
        names = [spec.name for spec in made.spec.blocks]
        for spec in made.spec.blocks:
            try:
                view = planned_controllers.views(made.rig, made.table, made.views, spec, names)
                made.views.append(view)
            except RigError as error:
                raise RigError(f"{spec.where()}: {error}") from None
            _prepare(made, spec)
        made.values |= planned_controllers.beginning(made.spec, made.table, made.values)

    def sizes(self, made: Plan) -> list[Size]:
        """Return how many blocks there are."""
        return [("blocks", len(made.spec.blocks), sh.MAX_BLOCKS)]

    def install(self, made: Plan, loop: Loop) -> None:
        """Write where the views of each block begin and end."""
        blocks = loop.blocks
        blocks.n = len(made.spec.blocks)
        for i, views in enumerate(made.views):
            ranges = (views.parameters, views.states, views.inputs, views.outputs)
            blocks.views[i] = tuple(edge for r in ranges for edge in (r.start, r.stop))
            if views.judged is not None:
                blocks.views[i].y_end = views.outputs.start + views.judged


def _prepare(made: Plan, spec: BlockSpec) -> None:
    """Note parameters and initial states of a block, computed by its `prepare` where it has one."""
    table, config = made.table, made.rig.config
    try:
        with noted_reads() as reads:
            pairs = prepared_values(spec.block, spec.settings, config.rate_hz, config.seed)
    except ValueError as error:
        raise RigError(f"{spec.where()}: {spec.name}: {error}") from None
    add_reads(made.read, reads)
    for name, value in (*pairs[0], *pairs[1]):
        made.values[table.index[f"{spec.name}.{name}"]] = value

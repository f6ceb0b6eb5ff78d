"""The rig's scheduled tunings, and the variables whose changes are noted: of the executive."""

import math

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes.part import Part, Plan, Size
from pcpc.executive.rig import standby


class Schedule(Part):
    """What is tuned when, by the rig or by another part; what is noted."""

    def variables(self, made: Plan) -> None:
        """Resolve `schedule` and `note`; RigError for a variable that is not there."""
        if made.leads:
            _resolve_tunings(made)
            _resolve_notes(made)

    def sizes(self, made: Plan) -> list[Size]:
        """Return how many tunings and noted variables there are."""
        return [
            ("scheduled values", len(made.schedule), sh.MAX_SCHEDULE),
            ("noted variables", len(made.noted), sh.MAX_LIMITS),
        ]

    def install(self, made: Plan, loop: Loop) -> None:
        """Write them."""
        tuning, blocks = loop.tuning, loop.blocks
        for i, (cycle, place, value) in enumerate(made.schedule):
            tuning.schedule[i] = (cycle, place)
            tuning.value[i] = value
        for i, place in enumerate(made.noted):
            blocks.noted_index[i] = place
        tuning.n, blocks.n_noted = len(made.schedule), len(made.noted)


def _resolve_tunings(made: Plan) -> None:
    table, config = made.table, made.rig.config
    tunable = [v.name for v in table.variables if v.kind == "parameter"]
    for i, tuning in enumerate(config.schedule):
        for name, value in standby.scheduled_values(made.rig.document, config, i, tuning).items():
            path = f"schedule[{i}].set.{name}"
            made.rig.known(path, name, tunable, "parameter")
            variable = table.variables[table.index[name]]
            if not (variable.low <= value <= variable.high and math.isfinite(value)):
                span = f"{variable.low:g}..{variable.high:g} {variable.unit}"
                raise made.rig.error(path, f"{value:g} is outside {span}")
            made.tune_at(round(tuning.at_s * config.rate_hz), table.index[name], value)


def _resolve_notes(made: Plan) -> None:
    index = made.table.index
    for i, name in enumerate(made.rig.config.note):
        made.rig.known(f"note[{i}]", name, index, "variable")
        made.noted.append(index[name])
    if standby.IN_CHARGE in index:
        made.noted.append(index[standby.IN_CHARGE])

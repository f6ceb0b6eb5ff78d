"""From a rig to the plan of one node: its table, its wiring, its frames; every mistake has a place.

plan(rig, role, ...)      checks the wiring and lays out the table; opens nothing; of the loop it
                          compiles nothing, the steps of laws when they are imported
describe(plan, ...)       what the node's memory and its log say of it
install(plan, loop)       in `executive.nodes.install`: writes it into a zeroed LOOP record
failures(plan), close     what went wrong while it ran; what was opened is given back

Each walks the PARTS.
"""

from collections.abc import Iterator
from dataclasses import replace

from pcpc.executive.log import signals  # noqa: F401  tables may be signals of a log
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.nodes import planned_controllers
from pcpc.executive.nodes.part import Plan
from pcpc.executive.nodes.parts import PARTS
from pcpc.executive.nodes.planned_run import cycles_of
from pcpc.executive.rig import standby
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

__all__ = ["Plan", "check_pacing", "close", "cycles_of", "describe", "failures", "plan"]


def plan(rig: Rig, role: Role, pacing: str) -> Plan:
    """Check the wiring of one node and lay out its table; RigError, BusError say what is wrong."""
    made = Plan(rig, role, planned_controllers.complete(rig, role), pacing)
    for part in PARTS:
        part.variables(made)
    for items, size, most in (size for part in PARTS for size in part.sizes(made)):
        if size > most:
            holds = f"one node holds {most} (see executive/loop/sizes.py)"
            raise rig.error(role, f"{size} {items}; {holds}")
    return made


def describe(made: Plan, metadata: dict[str, str], kept: bool = True) -> NodeDescription:
    """Return the JSON head of the node's shared block; it also goes into the log.

    Not `kept`: without the effective rig's text, for a run whose log is not written.
    """
    told, description = replace(made, metadata=metadata, has_text=kept), NodeDescription()
    for part in PARTS:
        description |= part.described(told)
    return description


def failures(made: Plan) -> Iterator[str]:
    """Yield a line for each thing of a node that failed while it ran; before `close`."""
    for part in PARTS:
        yield from part.failures(made)


def close(made: Plan) -> None:
    """Give back what the parts of a node, whose loop has ended, have opened."""
    for part in PARTS:
        part.close(made)


def check_pacing(rig: Rig, pacing: str) -> None:
    """Raise RigError if the controller cannot run on a clock and `pacing` is one."""
    for name in standby.laws(rig.config):
        why = rig.config.controllers[name].lockstep_only
        if why and pacing in ("real", "sync"):
            others = [n for n, law in rig.config.controllers.items() if not law.lockstep_only]
            cure = f", or --controller {' or '.join(others)}" if others else ""
            raise rig.error(
                f"controllers.{name}.lockstep_only",
                f"{name} does not run in pacing {pacing}: {why}; use --pacing lockstep{cure}",
            )

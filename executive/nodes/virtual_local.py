"""Virtual time of a rig with a local node: `run_virtual` for three nodes.

A cycle k of all nodes: the plant samples, the local node takes that sample and what the executive
sent in k - 1, the executive takes what the local node passed on. That is the order of lockstep. At
the end each node has done one cycle more than the one above it, as a plant always has.
"""

from typing import Any

from pcpc.drivers import wire
from pcpc.drivers.jit import i8, loop, loop_function
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.cycle import STEPS, N, finish, one_pass, pass_or_finish
from pcpc.executive.loop.reception import wait_for_peer
from pcpc.executive.loop.sending import announce, request_first_sample


@loop_function
def _meet(executive: Any, local: Any, plant: Any) -> None:
    """Let the local node find the plant, then the executive the local node."""
    announce(plant)
    wire.carry(plant.wire, local.wire)
    wait_for_peer(local)
    request_first_sample(local)
    wire.deal(local.wire, executive.wire, plant.wire)
    wait_for_peer(executive)
    request_first_sample(executive)
    wire.carry(executive.wire, local.wire)


@loop_function
def _pass_below(executive: Any, local: Any, relays: Any, plant: Any, models: Any) -> None:
    """Do a pass of the plant, then one of the local node on its sample."""
    pass_or_finish(plant, models)
    wire.carry(plant.wire, local.wire)
    pass_or_finish(local, relays)
    wire.deal(local.wire, executive.wire, plant.wire)


@loop(i8(N, STEPS, N, STEPS, N, STEPS, i8))
def run_virtual_with_local(
    executive: Any, laws: Any, local: Any, relays: Any, plant: Any, models: Any, cycles: Any
) -> Any:
    """Run at most `cycles` cycles; return 1 while the rig goes on, 0 at its end."""
    if executive.passes == 0:
        _meet(executive, local, plant)
        _pass_below(executive, local, relays, plant, models)
    for _ in range(cycles):
        before = executive.passes
        more = one_pass(executive, laws)
        if executive.passes != before:  # it has sent
            wire.carry(executive.wire, local.wire)
            _pass_below(executive, local, relays, plant, models)
        if not more:
            finish(executive)
            wire.carry(executive.wire, local.wire)
            _pass_below(executive, local, relays, plant, models)
            while (
                local.control[sh.DONE] == 0 and local.guard.pace > 0.0
            ):  # its own commands become safe
                _pass_below(executive, local, relays, plant, models)
            if local.control[sh.DONE] == 0:
                finish(local)
                wire.deal(local.wire, executive.wire, plant.wire)
            pass_or_finish(plant, models)
            if plant.control[sh.DONE] == 0:
                finish(plant)
            return 0
    return 1

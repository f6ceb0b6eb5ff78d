"""What an operator asks of a running executive: arm, hold, who is in charge.

Each is a tuning, which the node judges, takes between two cycles and logs; a replay repeats it.
"""

from collections.abc import Mapping

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop import faults
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.rig.standby import IN_CHARGE, TO

DISARMED = "supervisor.disarmed"
_WITHIN_S = 2.0  # a node that runs needs a few cycles


def arm(live: Live) -> int:
    """Let an executive that is disarmed close its loop; return the cycle that takes it.

    LiveError: the loop is already closed, in INIT or FAULT (NOT_MET), or what `Live.tune` says.
    """
    now = live.read()
    state = int(now["supervisor.state"])
    if state == State.FAULT:
        why = faults.reason(live.block.description, live.block.control)
        raise LiveError(f"{live.name}: FAULT, {why}; `pcpc operate reset` first", Exit.NOT_MET)
    if state == State.INIT:
        raise LiveError(f"{live.name}: waits for the other node; try again later", Exit.NOT_MET)
    if now[DISARMED] == 0.0:
        raise LiveError(f"{live.name}: the loop is already closed")
    return live.tune({DISARMED: 0.0})


def hold(live: Live) -> int:
    """Ramp commands to their safe values, until `arm`; return the cycle that takes it.

    LiveError: the loop is already open, or what `Live.tune` says.
    """
    if live[DISARMED] != 0.0:
        raise LiveError(f"{live.name}: the loop is already open")
    return live.tune({DISARMED: 1.0})


def laws(live: Live) -> list[str]:
    """Return the controllers that one can hand over to, the rig's own first; [] without standby."""
    return [str(name) for name in live.block.description.get("laws", ())]


def in_charge(live: Live, now: Mapping[str, float]) -> str:
    """Return the controller whose outputs count in the values `now`; "" without standby."""
    names = laws(live)
    return names[int(now[IN_CHARGE])] if names else ""


def hand_over(live: Live, controller: str) -> int:
    """Let `controller` take over; return the first cycle with it.

    LiveError: not on standby, in charge already, not usable (NOT_MET), or what `Live.tune` says.
    """
    names = laws(live)
    if not names:
        what = "no controller is on standby; start the run with --standby NAME"
        raise LiveError(f"{live.name}: {what}")
    if controller not in names:
        cure = did_you_mean(controller, names)
        raise LiveError(f"{live.name}: {controller} is not on standby{cure}")
    now = live.read()
    if int(now[IN_CHARGE]) == names.index(controller):
        raise LiveError(f"{live.name}: {controller} is already in charge")
    if now[f"handover.usable_{controller}"] == 0.0:
        raise LiveError(_refusal(live, controller), Exit.NOT_MET)
    wanted = float(names.index(controller))
    if now[TO] == wanted:  # asked before and refused; only a change is a request
        live.tune({TO: now[IN_CHARGE]})
    cycle = live.tune({TO: wanted})
    found = live.wait_until(lambda now: now.cycle >= cycle, _WITHIN_S, "the cycle of a hand-over")
    if found[IN_CHARGE] != wanted and found[TO] == wanted:
        live.tune({TO: found[IN_CHARGE]})
        raise LiveError(_refusal(live, controller), Exit.NOT_MET)
    return cycle


def _refusal(live: Live, controller: str) -> str:
    stays = in_charge(live, live.read())
    what = f"{controller} cannot take over: one of its outputs is not finite"
    return f"{live.name}: {what}; {stays} stays in charge"

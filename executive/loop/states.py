"""The states of a node, what each does, and one pure transition table.

    INIT   waiting for the other node          READY  the other node is there; armed?
    RUN    the loop is closed                  HOLD   a cycle ran on the last valid sample
    FAULT  the command ramps to its safe value STOP   the command is safe, the node ends

               NONE   FRESH  MISSED  LOSS   STOP_REQUEST  RAMPED  RESET  DISARMED
      INIT     INIT   READY  INIT    FAULT  STOP          INIT    INIT   INIT
      READY    READY  RUN    READY   FAULT  STOP          READY   READY  READY
      RUN      RUN    RUN    HOLD    FAULT  STOP          RUN     RUN    READY
      HOLD     HOLD   RUN    HOLD    FAULT  STOP          HOLD    HOLD   READY
      FAULT    FAULT  FAULT  FAULT   FAULT  STOP          STOP    INIT   FAULT
      STOP     STOP   STOP   STOP    STOP   STOP          STOP    STOP   STOP

      state   runs  expects  ramps  sends  NMT
      INIT    0     0        0      0      pre-operational
      READY   0     1        0      1      pre-operational
      RUN     1     1        0      1      operational
      HOLD    1     1        0      1      operational
      FAULT   0     1        1      1      stopped
      STOP    0     1        1      1      stopped

runs: the loop is closed, a cycle without input is a held one. expects: the other node is known, so
that its silence is a fault. ramps: commands go from their last value to the safe one. sends: what
the law wants may be a command; without, commands are safe (but a local node's, which already acts
on what it hears from below). Its state as a drive of CiA 402 stands in `executive.loop.drive`.

The same table serves the executive (fresh = a complete valid set of feedback) and the emulator
(fresh = a valid command), whose FAULT is its watchdog. From here come the C of a device
(`tools.make.generate.declared`) and the value tables of DBC files (`tools.make.dbc`).
"""

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.canopen.layout import Heartbeat
from pcpc.drivers.compiled.jit import loop_inline
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.executive.loop.faults import Fault


class State(NumberedEnum):
    """A state: runs, expects, ramps, sends, heartbeat."""

    runs: int
    expects: int
    ramps: int
    sends: int
    heartbeat: Heartbeat

    def __new__(
        cls, runs: int, expects: int, ramps: int, sends: int, heartbeat: Heartbeat
    ) -> "State":
        """Return the next member."""
        state = int.__new__(cls, len(cls.__members__))
        state._value_ = int(state)
        state.runs, state.expects, state.ramps, state.sends = runs, expects, ramps, sends
        state.heartbeat = heartbeat
        return state

    INIT = 0, 0, 0, 0, Heartbeat.PRE_OPERATIONAL
    READY = 0, 1, 0, 1, Heartbeat.PRE_OPERATIONAL
    RUN = 1, 1, 0, 1, Heartbeat.OPERATIONAL
    HOLD = 1, 1, 0, 1, Heartbeat.OPERATIONAL
    FAULT = 0, 1, 1, 1, Heartbeat.STOPPED
    STOP = 0, 1, 1, 1, Heartbeat.STOPPED


class Condition(NumberedEnum):
    """What leads from one state to the next: the columns of the table."""

    NONE, FRESH, MISSED, LOSS, STOP_REQUEST, RAMPED, RESET, DISARMED = range(8)


def _numbers(attribute: str) -> NDArray[np.int64]:
    """Return what each state does, for compiled code."""
    return np.array([getattr(state, attribute) for state in State], np.int64)


def _next() -> NDArray[np.int64]:
    INIT, READY, RUN, HOLD, FAULT, STOP = State
    return np.array(
        [
            [INIT, READY, INIT, FAULT, STOP, INIT, INIT, INIT],
            [READY, RUN, READY, FAULT, STOP, READY, READY, READY],
            [RUN, RUN, HOLD, FAULT, STOP, RUN, RUN, READY],
            [HOLD, RUN, HOLD, FAULT, STOP, HOLD, HOLD, READY],
            [FAULT, FAULT, FAULT, FAULT, STOP, STOP, INIT, FAULT],
            [STOP, STOP, STOP, STOP, STOP, STOP, STOP, STOP],
        ],
        np.int64,
    )


STATE_NAMES = State.names()
NEXT = _next()
RUNS, EXPECTS, RAMPS, SENDS = map(_numbers, ("runs", "expects", "ramps", "sends"))
HEARTBEATS = _numbers("heartbeat").astype(np.float64)


@loop_inline
def next_state(
    state: int, fresh: bool, fault: int, stopping: bool, ramped: bool, disarmed: bool
) -> int:
    """Return the next state. `fresh`: this cycle's input is complete; `fault`: a fault code.

    In FAULT no fault code means that a reset was granted. Being disarmed keeps no node in INIT.
    """
    condition = Condition.MISSED
    if stopping:
        condition = Condition.STOP_REQUEST
    elif state == State.FAULT:
        condition = Condition.RAMPED if ramped else Condition.NONE
        if fault == Fault.NONE:
            condition = Condition.RESET
    elif fault != Fault.NONE:
        condition = Condition.LOSS
    elif disarmed and state != State.INIT:
        condition = Condition.DISARMED
    elif fresh:
        condition = Condition.FRESH
    return NEXT[state, condition]

"""The supervisor of a node: six states, one pure transition table, one ramp.

    INIT   waiting for the other node          READY  the first valid sample is here
    RUN    the loop is closed                  HOLD   a cycle ran on the last valid sample
    FAULT  the command ramps to its safe value STOP   the command is safe, the node ends

               NONE   FRESH  MISSED  LOSS   STOP_REQUEST  RAMPED
      INIT     INIT   READY  INIT    FAULT  STOP          INIT
      READY    READY  RUN    READY   FAULT  STOP          READY
      RUN      RUN    RUN    HOLD    FAULT  STOP          RUN
      HOLD     HOLD   RUN    HOLD    FAULT  STOP          HOLD
      FAULT    FAULT  FAULT  FAULT   FAULT  STOP          STOP
      STOP     STOP   STOP   STOP    STOP   STOP          STOP

A run is over when its duration is, when the host asks, or when a frame of the node above says STOP.
While a command with a rate limit is then farther from its safe value than one cycle may move it,
the node goes on in its state (so that its peer still takes the command), `supervisor.gain` falls
from 1 as in FAULT, no missing input is a fault, and STOP comes with the frame that is safe. A ramp
is as fast as `supervisor.ramp_s` says, or as slow as the slowest command's rate limit.

FAULT is latched: only a new start leaves it. The same table serves the executive (fresh = a
complete valid set of feedback) and the emulator (fresh = a valid command), whose FAULT is its
watchdog.
"""

from typing import Any

import numpy as np

from pcpc.drivers.jit import loop_inline

INIT, READY, RUN, HOLD, FAULT, STOP = range(6)
STATE_NAMES = ("INIT", "READY", "RUN", "HOLD", "FAULT", "STOP")

NONE, FRESH, MISSED, LOSS, STOP_REQUEST, RAMPED = range(6)

NEXT = np.array(
    [
        [INIT, READY, INIT, FAULT, STOP, INIT],
        [READY, RUN, READY, FAULT, STOP, READY],
        [RUN, RUN, HOLD, FAULT, STOP, RUN],
        [HOLD, RUN, HOLD, FAULT, STOP, HOLD],
        [FAULT, FAULT, FAULT, FAULT, STOP, STOP],
        [STOP, STOP, STOP, STOP, STOP, STOP],
    ],
    np.int64,
)

NO_FAULT, INPUT_MISSING, COMMAND_NOT_FINITE, PEER_SILENT, BUS_FAILED, OVERRUN = range(6)
ANOTHER_SENDER, REPEATED_INPUT = 6, 7
OUTPUT_NOT_FINITE, PLANT_NOT_FINITE, STEP_RAISED, STEP_HANGS = 8, 9, 10, 11
FAULT_NAMES = (
    "none",
    "no valid input frame for the rig's limit of cycles",
    "a command was not a finite number",
    "the other node fell silent",
    "the bus failed",
    "cycles ran past their end, more in a row than the rig allows",
    "another sender of one of its frames is on the bus",
    "an awaited frame was repeated again and again: somebody else sends it",
    "an output was not a finite number",
    "the plant diverged: an output was not a finite number",
    "a step ended with an exception",
    "a step does not return",
)

NMT = np.array([127.0, 127.0, 5.0, 5.0, 4.0, 4.0])  # CANopen heartbeat state of each state


@loop_inline
def advance(state: Any, fresh: Any, fault: Any, stopping: Any, ramped: Any) -> Any:
    """Return the next state. `fresh`: this cycle's input is complete; `fault`: a fault code."""
    event = MISSED
    if stopping:
        event = STOP_REQUEST
    elif state == FAULT:
        event = RAMPED if ramped else NONE
    elif fault != NO_FAULT:
        event = LOSS
    elif fresh:
        event = FRESH
    return NEXT[state, event]

"""The supervisor of a node: six states, one pure transition table, one ramp.

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

What a state does stands beside it (`DOES`), and the loop reads it there:

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

A run is over when its duration is, when the host asks, or when a frame of the node above says STOP.
While a command with a rate limit is then farther from its safe value than one cycle may move it,
the node goes on in its state (so that its peer still takes the command), `supervisor.gain` falls
from 1 as in FAULT, no missing input is a fault, and STOP comes with the frame that is safe. A ramp
is as fast as `supervisor.ramp_s` says, or as slow as the slowest command's rate limit.

FAULT is latched. Its ramp ends in STOP, or, where the rig says `on_fault: wait`, it lasts until a
reset that was asked for: in a cycle with valid input, commands safe, and no detector having seen a
fault since the cycle before. The laws went on all the while and keep their states; `gain` rises
from 0 to 1 as fast as it fell, so that commands begin where they are.

An executive that is disarmed, by its operator or from its start (`arm: manual`, where a fault
disarms, too), is in READY at most: commands go the way of FAULT to their safe values and stay
there, without a fault. Time, references and laws go on, with the measured feedback. Armed, it is in
RUN with the next complete input, and `gain` rises as after a reset.

The same table serves the executive (fresh = a complete valid set of feedback) and the emulator
(fresh = a valid command), whose FAULT is its watchdog.
"""

from typing import Any, NamedTuple

import numpy as np

from pcpc.drivers.jit import loop_inline

INIT, READY, RUN, HOLD, FAULT, STOP = range(6)
STATE_NAMES = ("INIT", "READY", "RUN", "HOLD", "FAULT", "STOP")

NONE, FRESH, MISSED, LOSS, STOP_REQUEST, RAMPED, RESET, DISARMED = range(8)

NEXT = np.array(
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

# What each state does: a row a state; NMT is its CANopen heartbeat.
RUNS, EXPECTS, RAMPS, SENDS = range(4)
DOES = np.array(
    [[0, 0, 0, 0], [0, 1, 0, 1], [1, 1, 0, 1], [1, 1, 0, 1], [0, 1, 1, 1], [0, 1, 1, 1]], np.int64
)
NMT = np.array([127.0, 127.0, 5.0, 5.0, 4.0, 4.0])


SOFTWARE, LAW, EXTERNAL, BUS, HEARTBEAT, BACK_FROM_OFF, COLLISION, PROTOCOL, SENSOR = (
    0x6100, 0x6200, 0x9000, 0x8100, 0x8130, 0x8140, 0x8150, 0x8200, 0x7300
)  # fmt: skip
GENERIC, COMMUNICATION = 0x01, 0x11


class Fault(NamedTuple):
    """A named fault: what it says, the cycles in which it is noticed, what follows.

    `within` may be a key of the rig; without one, a time of its own is in `why`. `code` and
    `register` are those of CiA 301's emergency frame.
    """

    says: str
    within: int | str | None
    reaction: str
    why: str = ""
    code: int = SOFTWARE
    register: int = GENERIC


RAMP = "ramp to safe values"
QUICK = "quick stop"
END = "the node ends with its safe values"
DIES = "the node ends; the watchdog of the other one acts"
FAULTS = (
    Fault("none", None, "none", code=0, register=0),
    Fault("no valid input frame for the rig's limit of cycles",
          "supervisor.fault_after_cycles", RAMP, "", HEARTBEAT, COMMUNICATION),
    Fault("a command was not a finite number", 1, RAMP, "its last value is sent in that cycle"),
    Fault("the other node fell silent", None, END, "without a clock, after 5 s", HEARTBEAT,
          COMMUNICATION),
    Fault("the bus failed", 1, RAMP, "as told by the system", BUS, COMMUNICATION),
    Fault("cycles ran past their end, more in a row than the rig allows",
          "overrun.fault_after", RAMP),
    Fault("another sender of one of its frames is on the bus", 3, RAMP, "3 frames in 10 cycles",
          COLLISION, COMMUNICATION),
    Fault("an awaited frame was repeated again and again: somebody else sends it", 10, RAMP,
          "10 frames in 100 cycles", PROTOCOL, COMMUNICATION),
    Fault("an output was not a finite number", 1, RAMP),
    Fault("the plant diverged: an output was not a finite number", 1, RAMP),
    Fault("a step ended with an exception", 1, DIES, "", LAW),
    Fault("a step does not return", None, DIES, "after 3 s or 20 periods", LAW),
    Fault("the emergency stop is pressed", 1, QUICK, "", EXTERNAL),
    Fault("a stop frame came", 1, QUICK, "", EXTERNAL),
    Fault("received values were not plausible", "supervisor.fault_after_cycles", RAMP,
          "or the signal's fault_after, in a row", SENSOR),
    Fault("a frame comes from two senders", 3, RAMP,
          "1 or 3 signs, if `supervisor.intrusion` says so", COLLISION, COMMUNICATION),
    Fault("the CAN controller went bus-off", 1, RAMP, "as told by an error frame", BACK_FROM_OFF,
          COMMUNICATION),
)  # fmt: skip
FAULT_NAMES = tuple(fault.says for fault in FAULTS)
ERROR_CODES = np.array([float(fault.code) for fault in FAULTS])
ERROR_REGISTERS = np.array([float(fault.register) for fault in FAULTS])
NO_FAULT, INPUT_MISSING, COMMAND_NOT_FINITE, PEER_SILENT, BUS_FAILED, OVERRUN = range(6)
ANOTHER_SENDER, REPEATED_INPUT = 6, 7
OUTPUT_NOT_FINITE, PLANT_NOT_FINITE, STEP_RAISED, STEP_HANGS = 8, 9, 10, 11
EMERGENCY_STOP, STOP_FRAME, NOT_PLAUSIBLE, INTRUSION, BUS_OFF = range(12, 17)


@loop_inline
def advance(state: Any, fresh: Any, fault: Any, stopping: Any, ramped: Any, disarmed: Any) -> Any:
    """Return the next state. `fresh`: this cycle's input is complete; `fault`: a fault code.

    In FAULT no fault code means that a reset was granted. Being disarmed keeps no node in INIT.
    """
    event = MISSED
    if stopping:
        event = STOP_REQUEST
    elif state == FAULT:
        event = RESET if fault == NO_FAULT else RAMPED if ramped else NONE
    elif fault != NO_FAULT:
        event = LOSS
    elif disarmed and state != INIT:
        event = DISARMED
    elif fresh:
        event = FRESH
    return NEXT[state, event]

"""The variables that the loop itself writes, at the head of every table."""

from pcpc.executive.loop.control import BUS_COUNTERS, COUNTERS, FROM_FRAMES

HEAD = (
    ("time.t_s", "s", "time of the cycle, k T"),
    ("supervisor.state", "", "0 INIT, 1 READY, 2 RUN, 3 HOLD, 4 FAULT, 5 STOP"),
    ("supervisor.fault", "", "0 none, else the reason of FAULT"),
    ("supervisor.gain", "", "share of the command that is sent: 1, or on a ramp to safe"),
    ("supervisor.missing_cycles", "", "consecutive cycles without complete valid input"),
    ("supervisor.nmt", "", "CANopen heartbeat state"),
    ("supervisor.fallback", "", "1 once the rig's fallback controller has taken over"),
    ("supervisor.saturated", "", "1 if a value sent in the previous cycle was clamped"),
)
T_S, STATE, FAULT, GAIN, MISSING, NMT, FALLBACK, CLAMPED = range(8)
TIMING = (
    ("timing.wake_late_us", "us", "start of the cycle behind its deadline"),
    ("timing.receive_us", "us", "draining and decoding"),
    ("timing.step_us", "us", "supervisor, tunings, blocks"),
    ("timing.send_us", "us", "limits, encoding, sending"),
    ("timing.publish_us", "us", "snapshot and record of the previous cycle"),
    *((name, "", meaning) for _, name, meaning in COUNTERS),
    ("timing.wall_s", "s", "wall time of the cycle's start, since 1970; k T in virtual time"),
    *(
        (f"timing.{stage}_{figure}_us", "us", f"{what}: {figure} so far, renewed now and then")
        for stage, what in (("wake_late", "lateness"), ("work", "wake-up to end of cycle"))
        for figure in ("min", "mean", "max", "p50", "p99", "p999")
    ),
)
RESETS = (("timing.reset", "", "set to 1: timing statistics start anew"),)
REFUSALS = (("health.requests_refused", "", "requests for tunings that the loop refused"),)
REQUESTS = (  # parameters of the loop itself: name, unit, meaning, highest value
    ("supervisor.reset", "", "set to 1: out of a FAULT that waits, if its cause is gone", 1.0),
    ("supervisor.stop", "", "set to 1: the run ends; to 2: as a quick stop", 2.0),
    ("supervisor.disarmed", "", "1: commands are safe until it is armed again", 1.0),
)
DRIVE = (  # as CiA 402 and CiA 301 have them, see `executive.loop.drive`
    ("supervisor.status_word", "", "CiA 402: state of the drive"),
    ("supervisor.error_code", "", "CiA 301: 0 without a fault"),
    ("supervisor.error_register", "", "CiA 301: kind of the fault"),
)
BUS = tuple((name, "", meaning) for _, name, meaning in BUS_COUNTERS)
TIMING_AT = len(HEAD)
COUNTERS_AT = TIMING_AT + [name for name, *_ in TIMING].index(COUNTERS[0][1])
WALL = TIMING_AT + [name for name, *_ in TIMING].index("timing.wall_s")
RESET = TIMING_AT + len(TIMING)
REFUSED = RESET + len(RESETS)
RESET_ASKED = REFUSED + len(REFUSALS)
STOP_ASKED = RESET_ASKED + 1
DISARMED = STOP_ASKED + 1
STATUS_WORD = DISARMED + 1
ERROR_CODE, ERROR_REGISTER = STATUS_WORD + 1, STATUS_WORD + 2
BUS_AT = ERROR_REGISTER + 1
STATISTICS_AT = RESET - 12
COUNTED = tuple(name for word, name, _ in COUNTERS if word in FROM_FRAMES)

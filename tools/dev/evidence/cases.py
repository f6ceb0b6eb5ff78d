"""What is injected, how soon something has to notice it, and what has to follow.

`limit`: cycles from the first one in which the fault acts to the one in which it is noticed; None
where nothing can notice it, which the matrix says. `by`: who may notice it first. `answer`: the
most that follows: none, HOLD or FAULT.
"""

from typing import NamedTuple

CHECK, MISSING, FAULT = "counter or CRC", "missing input", "fault"
RIGS = {"faults": "", "limited": ", limited", "crc16": ", CRC-16"}  # and how their rows are named


class Case(NamedTuple):
    """One row of the matrix: faults of `faults.yaml` that begin together."""

    faults: tuple[str, ...]
    cycles: int  # for which they are on
    limit: int | None
    answer: str
    share: float = 1.0  # of the runs that have to be noticed within the limit
    rig: str = "faults"  # limited says what may be received, crc16 has another protection

    @property
    def name(self) -> str:
        """The names of its faults, and the rig where that is another one."""
        return " + ".join(self.faults) + RIGS[self.rig]


def _of(name: str, cycles: int, limit: int | None, answer: str, share: float = 1.0) -> Case:
    return Case((name,), cycles, limit, answer, share)


def _limited(name: str, cycles: int, limit: int, answer: str, share: float = 1.0) -> Case:
    return Case((name,), cycles, limit, answer, share, "limited")


def _wide(name: str, cycles: int, limit: int | None, answer: str, share: float = 1.0) -> Case:
    return Case((name,), cycles, limit, answer, share, "crc16")


HOLD, NONE = "HOLD", "none"
ONE_IN_256, ONE_IN_65536 = 1.0 - 1.0 / 256.0, 1.0 - 1.0 / 65536.0
CASES = (
    # a frame that is refused is a cycle without input: noticed in it
    _of("corruption_1", 1, 0, HOLD),
    _of("corruption_2", 1, 0, HOLD, 1.0 - 1.0 / 64.0),  # twice the same bit is no change
    _of("corruption_many", 1, 0, HOLD, ONE_IN_256),
    _of("repetition", 1, 0, NONE),
    _of("sequence", 10, 0, HOLD),
    _of("loss", 1, 0, HOLD),
    _of("loss", 2, 0, HOLD),
    _of("blocked", 50, 0, "FAULT"),
    _of("delay_2", 30, 0, HOLD),
    _of("delay_6", 30, 0, "FAULT"),
    _of("insertion", 1, 0, HOLD, ONE_IN_256),
    _of("masquerade", 1, None, NONE),
    _of("addressing", 1, 0, HOLD, ONE_IN_256),
    _of("length", 1, 0, HOLD),
    _of("counter_frozen", 10, 1, "FAULT"),
    _of("counter_drawn", 1, 0, HOLD, 15.0 / 16.0),  # one of 16 is the right one
    _of("counter_ahead", 10, 0, HOLD),
    _of("counter_ahead_2", 10, 0, HOLD),
    _of("checksum_drawn", 1, 0, HOLD, ONE_IN_256),
    _of("checksum_frozen", 10, 1, "FAULT", ONE_IN_256),
    _of("payload_frozen", 30, None, NONE),
    _of("command_corruption", 1, 0, HOLD, ONE_IN_256),
    _of("command_loss", 2, 0, HOLD),
    _of("command_blocked", 50, 0, "FAULT"),
    _of("command_delay", 30, 0, "FAULT"),
    _of("command_insertion", 1, 0, HOLD, ONE_IN_256),
    _of("command_masquerade", 1, None, NONE),
    _of("sync_loss", 1, None, NONE),
    _of("encoder_bias", 100, None, NONE),
    _of("encoder_drift", 100, None, NONE),
    _of("encoder_stuck", 100, None, NONE),
    _of("encoder_noise", 100, None, NONE),
    _of("encoder_quantised", 100, None, NONE),
    _of("encoder_dropout", 100, None, NONE),
    _of("encoder_delay", 100, None, NONE),
    _of("encoder_jump", 100, None, NONE),
    _of("torque_lost", 100, None, NONE),
    _of("torque_half", 100, None, NONE),
    _of("torque_limited", 100, None, NONE),
    _of("torque_slow", 100, None, NONE),
    _of("torque_dead_zone", 100, None, NONE),
    _of("law_nan", 1, 1, "FAULT"),
    _of("law_huge", 1, 1, "FAULT"),
    _of("wrong_gain", 100, None, NONE),
    _of("plant_nan", 1, 1, "FAULT"),
    _of("friction_x5", 100, None, NONE),
    _of("executive_stall_2", 2, 1, HOLD),  # its last frames still come
    _of("executive_stall_6", 6, 1, "FAULT"),
    _of("plant_stall_2", 2, 0, HOLD),
    _of("plant_stall_6", 6, 0, "FAULT"),
    # pairs at the same time
    Case(("loss", "command_loss"), 2, 0, HOLD),
    Case(("corruption_1", "encoder_stuck"), 20, 0, "FAULT"),
    Case(("delay_2", "torque_half"), 30, 0, HOLD),
    Case(("executive_stall_2", "corruption_1"), 2, 0, HOLD),
    # one of 256 passes, with a wrong counter: the frames behind it are refused as well
    Case(("encoder_noise", "command_corruption"), 2, 0, "FAULT", ONE_IN_256),
    # where the rig says what may be received, and two senders are a fault
    _limited("forgery", 10, 0, "FAULT"),
    _limited("command_forgery", 10, 0, "FAULT"),
    _limited("counter_ahead", 10, 0, "FAULT"),
    _limited("masquerade", 1, 0, NONE, 1.0 - 0.004 / 25.13),  # drawn beside the true angle
    _limited("command_masquerade", 1, 0, NONE, 1.0 - 0.4 / 6.5536),
    _limited("payload_frozen", 30, 21, "FAULT"),
    _limited("encoder_bias", 100, 0, "FAULT"),
    _limited("encoder_jump", 100, 0, "FAULT"),
    _limited("encoder_noise", 100, 39, "FAULT"),
    _limited("encoder_quantised", 100, 99, "FAULT"),
    _limited("encoder_stuck", 300, 201, "FAULT"),
    # what counter and CRC are for, with a CRC-16 and a counter of 8 bits
    _wide("corruption_1", 1, 0, HOLD),
    _wide("corruption_2", 1, 0, HOLD, 1.0 - 1.0 / 64.0),
    _wide("corruption_many", 1, 0, HOLD, ONE_IN_65536),
    _wide("repetition", 1, 0, NONE),
    _wide("sequence", 10, 0, HOLD),
    _wide("loss", 1, 0, HOLD),
    _wide("insertion", 1, 0, HOLD, ONE_IN_65536),
    _wide("masquerade", 1, None, NONE),
    _wide("addressing", 1, 0, HOLD, ONE_IN_65536),
    _wide("length", 1, 0, HOLD),
    _wide("counter_frozen", 10, 1, "FAULT"),
    _wide("counter_drawn", 1, 0, HOLD, ONE_IN_256),  # one of 256 is the right one
    _wide("counter_ahead", 10, 0, HOLD),
    _wide("counter_ahead_2", 10, 0, HOLD),
    _wide("checksum_drawn", 1, 0, HOLD, ONE_IN_65536),
    _wide("checksum_frozen", 10, 1, "FAULT", ONE_IN_65536),
    _wide("payload_frozen", 30, None, NONE),
    _wide("command_corruption", 1, 0, HOLD),  # three wrong bits: all are seen, twice the same too
    _wide("command_insertion", 1, 0, HOLD, ONE_IN_65536),
)

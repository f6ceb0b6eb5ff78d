"""What a drawn world may have, by name, and which two of it never come together."""

import random
from itertools import combinations, product
from typing import Any

from pcpc.executive.loop.fault_kinds import WrongFrame, WrongNode, WrongValue

RATES_HZ, SLOW_MS = (100, 250, 500, 1000, 1000, 2000, 4000), (10, 20, 50, 100, 500)
ODD = "odd fault"  # which may be refused, or run
KINDS = {  # faults, by features
    f"{of} {kind.word}": kind
    for of, kinds in (("value", WrongValue), ("frame", WrongFrame), ("node", WrongNode))
    for kind in kinds
}
REFERENCES = tuple(
    f"reference {name}" for name in ("step", "sine", "chirp", "ramp", "quintic", "sequence")
)
_RATES = tuple(f"{rate:g} Hz" for rate in sorted({*RATES_HZ}))
_SLOW = tuple(f"slow frames each {ms} ms" for ms in SLOW_MS)
FEATURES = (
    *_RATES, *_SLOW, *REFERENCES, *KINDS,
    "one plant", "many plants", "plain", "multiplexer", "emergency stop", "no E2E", "CRC 8",
    "CRC 16", "FD", "big endian", "float", "waits in FAULT", "intrusion limits", "quick stop",
    "armed by hand", "overrun policy", "limits", "rate limit", "plausibility", "requirement",
    "errors allowed", "line", "bit errors", "losses", "faults", "share of a fault", "fault again",
    "end asked", "request", "second sender", "slow frame", "drive", ODD, "standby", "tuning",
    "reset 1", "stop 1", "stop 2", "disarmed 1", "disarmed 0", "wrong rig",
)  # fmt: skip
_PARENTS = {"rate limit": "limits", "bit errors": "line", "line": "one plant", "drive": "one plant"}
_PARENTS |= dict.fromkeys((*KINDS, "share of a fault", "fault again"), "faults")
_SURE = 5  # features that a world has if it can
_SIMPLE_SHARE = 0.2  # of worlds, which run in lanes as a rule
_IN_LANES = {"limits", "rate limit", "losses", "requirement", "tuning"}  # as often in these
NOT_TOGETHER = (  # two lists: no feature of one with one of the other
    *((_RATES[:i], _RATES[i:]) for i in range(1, len(_RATES))),  # a rig has one rate,
    *((_SLOW[:i], _SLOW[i:]) for i in range(1, len(_SLOW))),  # and one time of heartbeats
    (("many plants",), ("one plant",)),
    (("many plants",), ("node stall",)),  # of three nodes none may stand still: the rig is refused
    (("drive",), ("many plants", "line", "bit errors")),
    (("line", "bit errors"), ("many plants", "2000 Hz", "4000 Hz")),  # 1 Mbit/s carries no more
)  # fmt: skip


def possible_pairs() -> set[tuple[str, str]]:
    """Return all pairs of features that a drawn rig may have, each in order of the alphabet."""
    never = {tuple(sorted(two)) for one, other in NOT_TOGETHER for two in product(one, other)}
    return {*combinations(sorted(FEATURES), 2)} - never


class Drawing:
    """Draws; notes which features there are."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(f"swarm {seed}")
        self.features: list[str] = []
        rare = {ODD, "wrong rig"}  # which ends the rest as a rule
        simple = self.random.random() < _SIMPLE_SHARE
        known = [one for one in FEATURES if one not in rare]
        self.sure = {"plain"} if simple else {*self.random.sample(known, _SURE)}
        for _ in range(2):  # parents of parents
            self.sure |= {_PARENTS.get(one, one) for one in self.sure}
        self.often = 1.0  # how much of what is drawn is there
        self.span_s = 1.0  # in which a short history has to come to something

    def has(self, share: float, *features: str) -> bool:
        """Return whether a feature is there, in this share of worlds, and note it."""
        often = self.often if _IN_LANES.isdisjoint(features) else 1.0
        found = self.random.random() < share * often or not self.sure.isdisjoint(features)
        self.features += features * found
        return found

    def one(self, *values: Any) -> Any:
        """Return one of these."""
        return self.random.choice(values)

    def named(self, name: str, *values: Any) -> Any:
        """Return one of these, one whose name is sure to be there if there is one."""
        sure = [value for value in values if name.format(value) in self.sure]
        return self.random.choice(sure or values)

    def near(self, low: float, high: float) -> float:
        """Return a number of few digits between two."""
        return float(f"{self.random.uniform(low, high):.4g}")

    def time_s(self, low: float, high: float) -> float:
        """Return a time of a history of 1 s, in a shorter one less."""
        return self.near(low * self.span_s, high * self.span_s)

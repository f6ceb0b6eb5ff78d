"""Requests to a node: the words in which a client asks and the loop answers, locks, refusals.

In `mail`: the number of the request, how many of the slots it takes, a Lock. In `answer`: the
number of the request that was answered, the cycle, a Refusal and the slot that is its reason.
"""

from pcpc.drivers.compiled.numbered import NumberedEnum, WordedEnum
from pcpc.drivers.compiled.records import Element, line

SLOTS = 64  # variables of a request


class Mail(Element):
    """What a client asks."""

    request: int
    count: int
    lock: int = line()


class Answer(Element):
    """What the loop answers."""

    request: int = line()
    cycle: int
    refusal: int
    entry: int


class Lock(NumberedEnum):
    """What clients may not do; any other number locks all."""

    NONE, TUNE, ALL = range(3)


class Refusal(WordedEnum):
    """Why a request is refused."""

    ACCEPTED = ""
    BAD_COUNT = "the request is not valid"
    NO_PARAMETER = "it is not a parameter"
    OUT_OF_RANGE = "it is out of range"
    LOCKED = "it is locked"
    NO_RESET = "no fault waits for a reset with safe commands"

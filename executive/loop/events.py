"""The kinds of events in a node's ring: number, word in a log, what each is about."""

from pcpc.drivers.compiled.numbered import NumberedEnum

VARIABLE, FRAME = "variable", "frame"  # whose place or id the argument is


class Event(NumberedEnum):
    """A kind of event: number, word in a log, what it is about."""

    says: str
    about: str

    def __new__(cls, number: int, says: str, about: str = "") -> "Event":
        """Return the next member."""
        event = int.__new__(cls, number)
        event._value_, event.says, event.about = number, says, about
        return event

    FAULT = 1, "fault"
    STATE = 2, "state"
    TUNING = 3, "tuning"
    SKIP = 4, "skip"
    CHANGE = 5, "change", VARIABLE
    LATE = 6, "late"
    FALLBACK = 7, "fallback"
    REFUSED = 8, "refused"
    NOT_FINITE = 9, "not finite", VARIABLE
    FOREIGN = 12, "foreign", FRAME
    IMPLAUSIBLE = 13, "implausible", VARIABLE
    TWO_SENDERS = 14, "two senders", FRAME
    AHEAD = 15, "counter ahead", FRAME
    TWO_PLACES = 16, "heartbeat from two places", FRAME

"""How a command ends: the exit codes, and what a user gets to see instead of a traceback."""

from enum import IntEnum


class Exit(IntEnum):
    """The exit codes of all commands and processes; `meaning` is also a run's verdict."""

    meaning: str

    def __new__(cls, code: int, meaning: str = "") -> "Exit":
        """Return the code with its meaning beside it."""
        found = int.__new__(cls, code)
        found._value_, found.meaning = code, meaning
        return found

    OK = 0, "ok"
    NOT_MET = 1, "expectation not met"
    WRONG_INPUT = 2, "wrong input"
    LOSS = 3, "loss"
    ENVIRONMENT = 4, "environment"
    SAFETY_STOP = 5, "safety stop"
    INTERRUPTED = 130, "interrupted"


class UserError(Exception):
    """One line for the user: where, what was expected, what to do; `code` is the exit code."""

    code = Exit.WRONG_INPUT

    def __init__(self, message: str = "", code: Exit | None = None) -> None:
        super().__init__(message)
        self.code = self.code if code is None else code


class BusError(UserError):
    """A bus, a frame or a device that this machine cannot use."""

    code = Exit.ENVIRONMENT


class DbcError(BusError):
    """A DBC file that is wrong, or says what the loop cannot do, on any machine."""

    code = Exit.WRONG_INPUT


def printable(text: str, kept: str = "\xa0") -> str:
    """Return a text without characters that would steer a terminal; they become escapes."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in kept else repr(c)[1:-1] for c in text)

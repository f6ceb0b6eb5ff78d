"""Numbers with names, declared once: states, faults, kinds of events (no numba in here).

    class Pace(Numbered):
        SLOW, FAST = range(2)

A member is its number everywhere: in logs, in C (`tools.make.generate.words`), and in compiled
code, where `Pace.FAST` is a constant (`drivers.compiled.structures`).
"""

from enum import EnumMeta, IntEnum


class NumberedKind(EnumMeta):
    """The class of such classes, by which numba knows them."""


class NumberedEnum(IntEnum, metaclass=NumberedKind):
    """A declaration: names and their numbers."""

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names in the order of their numbers."""
        return tuple(cls.__members__)

    @classmethod
    def words(cls) -> tuple[str, ...]:
        """Return the names as a rig has them, in small letters."""
        return tuple(name.lower() for name in cls.__members__)


class WordedEnum(NumberedEnum):
    """Names numbered from 0 on, each with what it says to a reader."""

    says: str

    def __new__(cls, says: str) -> "WordedEnum":
        """Return the next member."""
        one = int.__new__(cls, len(cls.__members__))
        one._value_, one.says = int(one), says
        return one

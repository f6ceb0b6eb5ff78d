"""Whose code of a log may run: what `tools.after.log.rig` asks before it runs Python of a log.

And how the folder is called in which its files are laid out, which no word of a run names.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from pcpc.tools.terminal.arguments import CodeOfLaws


class Trust(NamedTuple):
    """The answer of a user, as the options of these names."""

    trust: bool = False
    law: Sequence[str] = ()
    rig: str | None = None
    fmu: Sequence[str] = ()

    @classmethod
    def of(cls, given: CodeOfLaws) -> "Trust":
        """Return what a command line gives."""
        return cls(given.trust, given.law, given.rig, given.fmu)


FOLDER = "pcpc-rig-"  # how its name begins
ASKED = Trust()  # none but what lies unchanged where it lay


def words_of(error: object) -> str:
    """Return an error in words, without the folder that a log's files are laid out in."""
    return re.sub(rf"\S*{FOLDER}\w+/", "", str(error))

"""What is injected, how soon something has to notice it, and what has to follow: cases.csv.

rig      faults.yaml; limited says what may be received, crc16 has another protection
faults   of that rig; they begin together, for `cycles`
limit    cycles from the first one in which the fault acts to the one in which it is noticed;
none where nothing can notice it, which the matrix says. A frame that is refused is a
cycle without input: noticed in it, after 0
answer   the most that follows: none, HOLD or FAULT
unseen   the share of the runs that need not be noticed within the limit
"""

import csv
from pathlib import Path
from typing import NamedTuple

RIGS = {"faults": "", "limited": ", limited", "crc16": ", CRC-16"}  # and how their rows are named


class Case(NamedTuple):
    """One row of the matrix: faults of a rig that begin together."""

    faults: tuple[str, ...]
    cycles: int  # for which they are on
    limit: int | None
    answer: str
    share: float = 1.0  # of the runs that have to be noticed within the limit
    rig: str = "faults"

    @property
    def name(self) -> str:
        """The names of its faults, and the rig where that is another one."""
        return " + ".join(self.faults) + RIGS[self.rig]

    @classmethod
    def from_row(cls, row: dict[str, str]) -> "Case":
        """Return the case of a row of cases.csv."""
        part, _, whole = row["unseen"].partition("/")
        share = 1.0 - float(part) / float(whole or 1)
        limit = int(row["limit"]) if row["limit"] else None
        faults = tuple(row["faults"].split())
        return cls(faults, int(row["cycles"]), limit, row["answer"], share, row["rig"])


with Path(__file__).with_suffix(".csv").open(encoding="utf-8", newline="") as _file:
    CASES = tuple(map(Case.from_row, csv.DictReader(_file)))

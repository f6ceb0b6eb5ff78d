"""What the recorder counts of a node that stands still while frames come."""

import numpy as np
import pytest

from pcpc.executive.log.run_counts import Absences
from pcpc.executive.loop.ring_layout import OfFrame

PIECES, EACH = 40, 25  # of frames, one a cycle


def test_frames_that_wait_are_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    joined = list[int]()

    def counted(parts: list[np.ndarray]) -> np.ndarray:
        joined.append(sum(len(part) for part in parts))
        return true(parts)

    true = np.concatenate
    absences = Absences()
    absences.add_cycles(np.arange(3))
    rows = np.zeros((PIECES * EACH, max(OfFrame) + 1), np.int64)
    rows[:, OfFrame.CYCLE] = 10 + np.arange(len(rows))
    rows[:, OfFrame.ABOUT] = 0x202 | 1 << 40  # received, in order
    monkeypatch.setattr(np, "concatenate", counted)
    for piece in np.array_split(rows, PIECES):
        absences.add_frames(piece)
    assert sum(joined) == 0, "none of a cycle that was recorded"
    absences.add_cycles(np.arange(10, 10 + len(rows)))
    assert absences.longest() == {0x202: 3}
    assert sum(joined) < 4 * len(rows), "not once a piece: that were 20 times"

"""Which messages of a log are new: by their cycle, over the wrap of its number."""

import numpy as np
import pytest

from pcpc.executive.log.inventory import SEQUENCE, Inventory


@pytest.mark.parametrize("first", [0, 7, 2**31 - 3, 2**32 - 3])
def test_pieces_that_stand_twice_or_fall_behind_are_left_out(first: int) -> None:
    inventory, kept = Inventory(), []
    for cycles in (range(4), range(2, 6), range(3), range(3, 9), range(9, 12)):
        low = np.array([(first + k) % 2**32 for k in cycles], "<u4")
        rows = np.zeros((len(low), SEQUENCE.stop), np.uint8)
        rows[:, SEQUENCE] = low.view(np.uint8).reshape(-1, 4)
        new = inventory.new_rows("/state", rows)[:, SEQUENCE]
        kept.append([(int.from_bytes(one.tobytes(), "little") - first) % 2**32 for one in new])
    assert kept == [[0, 1, 2, 3], [4, 5], [], [6, 7, 8], [9, 10, 11]]

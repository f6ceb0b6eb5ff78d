"""The same bits by every way: each rig, each way, is equal or refused with the reason of a table.

A feature of a node brings a rig, see `rigs`, and no test of bits; a way is a function of `ways`.
"""

from pathlib import Path

import pytest
from recorded import Recorded, Refused
from rigs import pairs
from ways import HEAVY, SLOW, WAYS, refusal


@pytest.mark.parametrize(("rig", "way"), list(pairs(WAYS, SLOW, HEAVY)))
def test_the_bits_are_the_same(rig: str, way: str, run: Recorded, tmp_path: Path) -> None:
    why = refusal(rig, way)
    try:
        found = WAYS[way](run, tmp_path)
    except Refused as refused:
        assert why and why in str(refused), f"refused: {refused}"
    else:
        assert not why, "it is not refused any more"
        assert found == []

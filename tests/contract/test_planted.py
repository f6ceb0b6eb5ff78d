"""The contract can fail: a difference planted in one way is found by the rig of a feature.

Each row spoils one function, or table, of one way: by a bit, a cycle, a frame or a seed.
"""

import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded import Recorded
from ways import WAYS

from pcpc.drivers.errors import UserError

Spoil = Callable[[Any], Any]  # what is true: what stands in its place


def _off_by_a_bit(true: Any) -> Any:
    """Restore a keyframe whose values are off by one unit in the last place."""

    def restored(loop: Any, held: Any, state: bytes) -> None:
        true(loop, held, state)
        values = loop.v[: held[0][3] // 8]
        places = values != np.trunc(values)
        values[places] = np.nextafter(values[places], np.inf)

    return restored


def _without(record: str, name: str) -> Spoil:
    """Restore a keyframe without one of its fields."""

    def spoiled(true: Any) -> Any:
        def restored(loop: Any, held: Any, state: bytes) -> None:
            before = np.copy(loop[record][name])
            true(loop, held, state)
            loop[record][name] = before

        return restored

    return spoiled


def _a_lane_off(true: Any) -> Any:
    """Begin with lanes of which the last has a state that is off by a bit."""

    def begun(group: Any) -> None:
        true(group)
        values = group.seats["plant"].values[:, -1]
        place = np.flatnonzero(values != np.trunc(values))[0]
        values[place] = np.nextafter(values[place], np.inf)

    return begun


def _fast(true: Any) -> Any:
    """Compile C as if sums could be taken in any order."""
    return lambda folder, flags: true(folder, ["-O2", "-ffast-math"])


RESTORE = "pcpc.executive.nodes.planned_keyframes.put_back"
BRANCHING = "pcpc.tools.after.branch.branching"
NONE_LEFT: Spoil = lambda true: lambda self: {}  # noqa: E731
PLANTED: list[tuple[str, str, str, Spoil]] = [
    ("again", "losses", "pcpc.executive.loop.losses.first",
     lambda true: lambda seed, frame: true(seed + 1, frame)),
    ("from_a_keyframe", "profile", RESTORE, _off_by_a_bit),
    ("from_a_keyframe", "losses", RESTORE, _without("rx", "loss_state")),
    ("from_a_keyframe", "faults_of_values", RESTORE, _without("faults", "seed")),
    ("from_a_keyframe", "fd", RESTORE, _without("rx", "state")),
    ("replayed", "handover", "pcpc.executive.nodes.slices.tuning_of",
     lambda true: lambda entry: (true(entry)[0] + 1, *true(entry)[1:])),
    ("branched", "fd", f"{BRANCHING}.hand_on", lambda true: lambda nodes, before: None),
    ("branched", "moteus", f"{BRANCHING}.Branch._left_there", NONE_LEFT),
    ("branched", "reset", f"{BRANCHING}._tune_later", lambda true: lambda node, later: None),
    ("branched_on_a_bus", "moteus", f"{BRANCHING}.Branch._left_there", NONE_LEFT),
    ("in_lanes", "losses", "pcpc.executive.batch.group.LaneGroup.begin", _a_lane_off),
    ("in_parts", "three_plants", "pcpc.executive.log.long_logs._column_slice",
     lambda true: lambda columns, begin, end: true(columns, max(begin - 1, 0), end - 1)),
    ("in_c", "lowspeed-nn_backstepping", "ways.in_place", _fast),
]  # fmt: skip


CASES = [pytest.param(*one, id=f"{one[0]}-{one[1]}-{k}") for k, one in enumerate(PLANTED)]


@pytest.mark.parametrize(("way", "rig", "place", "spoil"), CASES)
def test_a_planted_difference_is_found(
    way: str, rig: str, place: str, spoil: Spoil, run: Recorded, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    (tmp_path / "true").mkdir()
    assert WAYS[way](run, tmp_path / "true") == []
    monkeypatch.setattr(place, spoil(pkgutil.resolve_name(place)))
    (tmp_path / "spoiled").mkdir()
    try:
        found = WAYS[way](run, tmp_path / "spoiled")
    except UserError as error:
        found = [str(error)]
    assert found != []

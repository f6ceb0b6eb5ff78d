"""Random and mutated frames: a few of each kind, and that a wrong judgement is told."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from pcpc.drivers.can.wire_layout import Arrival
from pcpc.tools.dev.evidence import cli, expected, frames, report

pytestmark = pytest.mark.deep

COUNT = 400


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    return [frames.fates_of_kind(*task[:2], COUNT, seed=5) for task in frames.tasks(1, 1)]


def test_frames_of_every_kind_are_survived_counted_and_judged_as_the_rules_say(
    rows: list[dict[str, Any]],
) -> None:
    assert [row for row in rows if not row["kept"]] == []
    assert all(sum(row["fates"].values()) == COUNT for row in rows)
    used = {(row["format"], row["kind"]): row["used"] for row in rows}
    for name in frames.formats():
        assert 60 < used[name, "any counter"] < 140 and used[name, "one wrong bit"] == 0, used
    assert used["udp_multicast datagram", "a wrong bit anywhere"] > COUNT / 2, used
    fates = {fate for row in rows for fate in row["fates"]}
    assert fates == {*frames.FATES} - {"lost", "counted twice"}, fates


def test_another_share_than_the_predicted_one_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    one = frames.formats()["struct can_frame"]
    make, share = one.kinds["any counter"]
    for other in (0.5 * (share or 0.0), 0.0):
        changed = one._replace(kinds={"any counter": (make, other)})
        monkeypatch.setattr(frames, "formats", lambda changed=changed: {"a": changed})
        row = frames.fates_of_kind("a", "any counter", COUNT, 5)
        assert not row["kept"] and "any counter" in cli.failures({"frames": [row]})[0], row


def test_a_receiver_that_judges_otherwise_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    rules = expected.ExpectedReceiver.check
    monkeypatch.setattr(
        expected.ExpectedReceiver,
        "check",
        lambda self, data, length: rules(
            dataclasses.replace(self, last=self.last + 1), data, length
        ),
    )
    row = frames.fates_of_kind("struct can_frame", "any counter", COUNT, 5)
    assert row["misjudged"] > 10 and not row["kept"], row


@pytest.mark.parametrize(("told", "fate"), [
    ((Arrival.NOTHING, 0, 0, 0, 0, 0), "lost"), ((Arrival.FRAME, 1, 0, 0, 0, 0), "used"),
    ((Arrival.FRAME, 0, 0, 0, 0, 0), "another id"), ((Arrival.FRAME, 0, 0, 0, 0, 1), "own id"),
    ((Arrival.FRAME, 1, 1, 0, 0, 0), "counted twice"),
    ((Arrival.FRAME, 0, 0, 0, 2, 0), "counted twice"),
    ((Arrival.FOREIGN, 1, 0, 0, 0, 0), "counted twice"),
    ((Arrival.BUS_ERROR, *[0] * 5), "bus error"),
])  # fmt: skip
def test_what_became_of_a_frame_is_what_was_counted(told: tuple[int, ...], fate: str) -> None:
    found = frames._fates(np.array([told]))
    assert frames.FATES[int(found[0])] == fate


def test_the_page_tells_every_kind(rows: list[dict[str, Any]]) -> None:
    page = "".join(report._parts({"frames": json.loads(json.dumps(rows))}))
    assert f"{COUNT * len(rows):,} frames" in page
    assert all(row["kind"] in " ".join(page.split()) for row in rows)

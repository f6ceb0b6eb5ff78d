"""Faults of CAN FD frames: what they do is what they do to the classic twin of the rig."""

from pathlib import Path
from typing import Any

import pytest
from fd_rig import PROBE, fd_rig

from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig

ACTS = "from: 0.1s, for: 0.1s, share: 0.3"
KINDS = {
    "loss": "", "repetition": "", "sequence": "", "corruption": ", value: 3",
    "delay": ", value: 3", "length": ", value: 3", "counter": ", how: freeze",
    "payload": ", how: freeze",
}  # fmt: skip
COUNTS = ("lost", "missed", "crc_errors", "repeated", "wrong_sequence", "held", "intrusions",
          "received", "stale")  # fmt: skip


def outcome(rig: Path) -> tuple[dict[str, bytes], dict[str, int]]:
    """Return the bits of what the nodes computed, and their counts."""
    run = VirtualRun(load_rig(rig, None, ["duration_s=0.3"]), None)
    for _ in run.advance():
        pass
    states = {
        f"{role} {name}": values.tobytes()
        for role, node in run.memory.log().node.items()
        for name, values in node.columns.items()
    }
    controls: list[Any] = [block.control for block in run.blocks]
    counts = {f"{i} {key}": int(one[key]) for i, one in enumerate(controls) for key in COUNTS}
    return states, counts


@pytest.mark.parametrize("frame", ["CMD", "FB"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_of_an_fd_frame_is_that_of_a_classic_one(
    kind: str, frame: str, tmp_path: Path
) -> None:
    """All but those that need as many random data as a frame has."""
    fault = f"faults: {{x: {{kind: {kind}, frame: {frame}, {ACTS}{KINDS[kind]}}}}}"
    lines = (fault, "supervisor: {hold_cycles: 1000, fault_after_cycles: 2000}")
    twin = tmp_path / "twin.yaml"
    twin.write_text("\n".join([f"base: {PROBE / 'rig.yaml'}", *lines]))
    found = outcome(fd_rig(tmp_path, *lines))
    assert found == outcome(twin)
    plain = tmp_path / "plain"
    plain.mkdir()
    assert found != outcome(fd_rig(plain, lines[1])), "it acts"


def test_frames_of_another_sender_are_an_intrusion_on_can_fd_too(tmp_path: Path) -> None:
    """A right counter, one in sixteen, hides the random frame from that check; the CRC does not."""
    fault = f"faults: {{x: {{kind: insertion, frame: FB, {ACTS}}}}}"
    states, counts = outcome(fd_rig(tmp_path, fault))
    plain = tmp_path / "plain"
    plain.mkdir()
    undisturbed = outcome(fd_rig(plain))[0]
    assert {name: states[name] for name in undisturbed} == undisturbed
    assert 20 < counts["0 intrusions"] < 40 and counts["1 intrusions"] == 0

"""What counts as the same run: each part of each frame that was sent, and each variable."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from logcommand import PLANT, barrel_log, run_here
from numpy.typing import NDArray
from replays import replayed

from pcpc.executive.log import reader as logs
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.variables import COUNTED
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after import replay as replaying
from pcpc.tools.after.differences import SENT, unequal_texts
from pcpc.tools.after.replayed import Verdict, compare_frames, plain, report


def frames(count: int) -> Any:
    """Return frames that differ in every part."""
    made = np.zeros(count, logs.FRAME)
    made["cycle"], made["id"], made["dlc"] = np.arange(count), 0x100 + np.arange(count), 8
    made["data"] = np.arange(8 * count, dtype=np.uint8).reshape(count, 8)
    return made


@pytest.mark.parametrize("part", ["cycle", "id", "dlc", *range(8)])
@pytest.mark.parametrize("at", [0, 2, 4])
def test_a_frame_that_differs_in_one_bit_is_found(part: str | int, at: int) -> None:
    verdict, other = Verdict("executive", 1000.0), frames(5)
    value = other["data"][:, part] if isinstance(part, int) else other[part]
    value[at] ^= 1
    compare_frames(verdict, frames(5), other)
    assert not verdict.agrees and verdict.differences[SENT].count == 1, verdict
    assert verdict.differences[SENT].cycle == at


@pytest.mark.parametrize(("ours", "theirs"), [(5, 4), (4, 5), (1, 0), (0, 3)])
def test_a_frame_more_or_less_is_found(ours: int, theirs: int) -> None:
    verdict = Verdict("executive", 1000.0)
    compare_frames(verdict, frames(ours), frames(theirs))
    assert verdict.differences[SENT].count == abs(ours - theirs)
    assert verdict.differences[SENT].cycle == min(ours, theirs)


@pytest.mark.parametrize("byte", range(8))
def test_a_byte_of_a_sent_frame_that_the_log_has_otherwise_is_told(
    byte: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = logs._frames

    def other(found: Any, name: str, notes: list[str], kind: Any) -> Any:
        made = original(found, name, notes, kind).copy()
        sent = np.flatnonzero((made["direction"] == 0) & (made["dlc"] > byte))
        if name == "plant" and len(sent):
            made["data"][sent[len(sent) // 2], byte] ^= 1
        return made

    monkeypatch.setattr(logs, "_frames", other)
    assert told(barrel_log("pd"))["plant"].first().name == SENT
    assert told(barrel_log("pd"))["executive"].identical


@pytest.mark.parametrize("left_out", [False, True])
def test_a_heartbeat_after_the_meeting_is_compared(
    left_out: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, ids = logs._frames, {"executive": 0x701, "plant": 0x702}

    def other(found: Any, name: str, notes: list[str], kind: Any) -> Any:
        made = original(found, name, notes, kind).copy()
        own = (made["direction"] == 0) & (made["id"] == ids[name])
        beat = np.flatnonzero(own & (made["cycle"] == 200))
        made["data"][beat, 0] ^= 1
        return np.delete(made, beat) if left_out else made

    monkeypatch.setattr(logs, "_frames", other)
    for role, verdict in told(barrel_log("pd")).items():
        found = [(d.name, d.cycle) for d in verdict.differences.values()]
        assert found == [(SENT, 200)], (role, verdict)
        assert verdict.state == "DIFFERENT", verdict


@pytest.mark.parametrize("role", ["executive", "plant"])
def test_a_bit_of_each_state_and_of_each_counter_of_frames_is_compared(role: str) -> None:
    def other(columns: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
        made = {name: values.copy() for name, values in columns.items()}
        for name in compared & made.keys():
            made[name][-1:].view(np.int64)[0] ^= 1  # in the last cycle, so that nothing follows
        return made

    log = logs.read(barrel_log("pd"))
    node = log.node[role]
    compared = {*node.columns, *COUNTED}
    changed = replace(node, columns=other(node.columns), timing=other(node.timing))
    rig = load_rig(PLANT / "rigs" / "slew10.yaml", "pd", ["duration_s=0.3"])
    comparison, last = replaying.NodeComparison(log, rig, role), int(node.cycle[-1])
    comparison.take(replace(log, node={role: changed}), last, True)
    verdict = comparison.verdict
    assert verdict.differences.keys() == compared, compared ^ verdict.differences.keys()
    found = verdict.differences.values()
    assert {(one.cycle, one.ulp) for one in found} == {(last, 1)}, found


@pytest.mark.parametrize("moved", [0, 1])
def test_a_frame_that_comes_in_a_later_piece_of_a_log_makes_it_incomplete(moved: int) -> None:
    log = logs.read(barrel_log("pd"))
    node = log.node["executive"]
    rig = load_rig(PLANT / "rigs" / "slew10.yaml", "pd", ["duration_s=0.3"])
    comparison, middle = replaying.NodeComparison(log, rig, "executive"), int(node.cycle[150])
    later = node.frames["cycle"] >= middle
    received = np.flatnonzero((node.frames["direction"] == 1) & ~later)
    later[received[-50 : len(received) - 50 + moved]] = True

    def piece(cycles: slice, frames: NDArray[np.bool_]) -> logs.Log:
        both = ({n: v[cycles] for n, v in c.items()} for c in (node.columns, node.timing))
        columns, timing = both
        part = replace(
            node, cycle=node.cycle[cycles], stamp_ns=node.stamp_ns[cycles],
            columns=columns, timing=timing, frames=node.frames[frames],
        )  # fmt: skip
        return replace(log, node={"executive": part})

    comparison.take(piece(slice(0, 150), ~later), middle - 1, False)
    comparison.take(piece(slice(150, None), later), int(node.cycle[-1]), True)
    assert comparison.verdict.identical == (not moved), comparison.verdict
    assert ("stands before earlier ones" in comparison.verdict.incomplete) == bool(moved)


@pytest.mark.parametrize("role", [0, 1])
def test_a_bus_that_failed_fails_again_in_its_cycle(role: int, tmp_path: Path) -> None:
    run = VirtualRun(load_rig(PLANT / "rigs" / "slew10.yaml"), tmp_path / "log.mcap")
    for cycles in run.advance():
        if cycles == 1000:
            run.blocks[role].loop.guard.faulted = Fault.BUS_FAILED
    run.close()
    log = logs.read(tmp_path / "log.mcap")
    fault = log.node[("executive", "plant")[role]].columns["supervisor.fault"]
    assert Fault.BUS_FAILED in fault, np.unique(fault)
    for verdict in told(tmp_path / "log.mcap").values():
        assert verdict.identical, (verdict.role, verdict.incomplete, verdict.first())


def told(log: Path) -> dict[str, Any]:
    """Replay in this process; return the verdicts by node."""
    return {one.role: one for one in replayed(log)}


@pytest.mark.parametrize(
    ("setting", "which"),
    [("controller.kv_Nms_rad=117", "executive"), ("barrel.gap_rad=0.003", "plant")],
)
def test_a_replay_with_one_node_that_differs_is_not_met(setting: str, which: str) -> None:
    done = run_here("replay", barrel_log("pd"), "--json", "--quiet", "--set", setting)
    identical = {one["node"]: one["identical"] for one in holds("replay", done.out)}
    assert identical == {role: role != which for role in ("executive", "plant")}, done
    assert done.code == 1, done


@pytest.mark.parametrize("missing", [[], ["/state: 1 of 300 messages"]])
@pytest.mark.parametrize("incomplete", ["", "cycles are missing"])
@pytest.mark.parametrize("differs", [False, True])
def test_only_a_whole_log_without_a_difference_is_identical(
    missing: list[str], incomplete: str, differs: bool
) -> None:
    verdict = Verdict("plant", 1000.0, 300, 400, 7, missing=missing, incomplete=incomplete)
    if differs:
        compare_frames(verdict, frames(1), frames(0))
    assert verdict.identical == (not (missing or incomplete or differs))
    assert verdict.agrees == (not (incomplete or differs))
    assert (verdict.state == "bit-identical") == verdict.identical
    assert verdict.state.startswith("DIFFERENT") == differs
    assert verdict.code == (1 if differs else 3 if missing or incomplete else 0)
    assert report(verdict, False)[0].startswith("plant      300 of 400 cycles, 7 variables, ")


@pytest.mark.parametrize(
    ("cycles", "variables", "frames", "code"),
    [(0, 0, 0, 3), (0, 7, 0, 3), (9, 0, 0, 3), (0, 0, 5, 3), (9, 7, 0, 0), (9, 0, 5, 0)],
)
def test_nothing_compared_is_no_pass(cycles: int, variables: int, frames: int, code: int) -> None:
    verdict = Verdict("device", 1000.0, cycles, 400, variables, frames)
    assert verdict.code == code
    for changed in (False, True):
        line = " ".join(report(verdict, changed)[0].split())
        assert ("nothing to compare" in line) == (code == 3), line
    assert plain(verdict).identical == (code == 0)


def test_a_byte_behind_the_length_of_a_frame_is_seen_in_the_texts() -> None:
    a, b = np.zeros((2, 1), logs.FRAME)
    a["dlc"] = b["dlc"] = 3
    b["data"][0, 5] = 0x2A
    texts = unequal_texts(a, b, 0)
    assert texts[0] != texts[1] and "behind it 00002A0000" in texts[1], texts
    b["data"][0, 5], b["cycle"] = 0, 9
    assert "cycle 9" in unequal_texts(a, b, 0)[1]

"""A part of a log recomputed, and its keyframes held against the state that is recomputed."""

import csv
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from logcommand import run_here
from processes import PATIENT, RIGS, own_bus, pcpc

from pcpc.executive.log import keyframes
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes import planned_keyframes
from pcpc.executive.nodes.plan import describe, plan
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.keyframe_check import OTHER_LAYOUT
from pcpc.tools.after.replay import NodeComparison, recomputed_pieces

SHORT = ("duration_s=0.45", "record.keyframe=100ms")
PLAN = plan(load_rig(RIGS / "engage.yaml"), "executive", "lockstep")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("span") / "log.mcap"
    simulate(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), path)
    return path


def replay(log: Path, *words: str) -> tuple[int, dict[str, dict[str, Any]]]:
    done = run_here("replay", log, "--json", "--quiet", *words)
    return done.code, {one["node"]: one for one in holds("replay", done.out)}


def rewritten(
    path: Path,
    change: Callable[[dict[str, Any], bytearray], dict[str, Any]],
    patch: pytest.MonkeyPatch,
    which: Sequence[int] = (299,),
) -> Path:
    """Return a log whose executive's keyframes of cycles `which` `change` has made."""
    true = keyframes._packed_state

    def packed(passes: int, layout: str, state: bytes) -> dict[str, Any]:
        if passes not in which or layout != LAYOUT:
            return true(passes, layout, state)
        other = bytearray(state)
        told = change(true(passes, layout, state), other)
        return true(passes, layout, bytes(other)) | told

    with patch.context() as here:
        here.setattr(keyframes, "_packed_state", packed)
        simulate(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), path)
    return path


LAYOUT = describe(PLAN, {})["keyframe_layout"]


def test_all_keyframes_are_held_against_what_is_recomputed(log: Path) -> None:
    code, nodes = replay(log)
    assert code == 0 and [one["keyframes"] for one in nodes.values()] == [4, 4]
    run = run_here("replay", "--brief", log, "--quiet", "--json")
    assert run.code == 0, run


def test_a_hidden_state_that_is_another_is_a_difference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = PLAN.table.index["controller.w_0"]

    def other(entry: dict[str, Any], state: bytearray) -> dict[str, Any]:
        state[8 * place] ^= 1  # a ULP; the checksum is that of the new state
        return {}

    path = rewritten(tmp_path / "log.mcap", other, monkeypatch)
    assert "controller.w_0" not in logs.read(path).node["executive"].columns
    code, nodes = replay(path)
    found = nodes["executive"]["first"]
    assert code == 1 and (found["name"], found["cycle"], found["ulp"]) == ("controller.w_0", 299, 1)
    assert nodes["plant"]["identical"]
    assert run_here("replay", "--brief", path, "--quiet").code == 1
    begun = run_here("branch", path, "--cycle", "350", "-o", tmp_path / "b", "--quiet")
    assert begun.code == 2 and "controller.w_0 in cycle 299" in begun.err, begun


@pytest.mark.parametrize("at", range(0, 40, 6))
def test_each_field_that_a_keyframe_holds_is_compared(
    at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of all but the variables one byte is changed: found, unless it is a clock's or a counter."""
    spans = planned_keyframes.spans(len(PLAN.table.variables), bool(PLAN.faults))
    record, name, _, size = spans[1 + at % (len(spans) - 1)]
    start = sum(one[3] for one in spans[: 1 + at % (len(spans) - 1)])

    def other(entry: dict[str, Any], state: bytearray) -> dict[str, Any]:
        state[start] ^= 1
        return {}

    code, nodes = replay(rewritten(tmp_path / "log.mcap", other, monkeypatch))
    measured = record == "control" and name in planned_keyframes._MEASURED
    names = [one["name"] for one in nodes["executive"]["differences"]]
    assert code == (0 if measured else 1), (record, name)
    assert names == ([] if measured else [f"{record}.{name}[0]"]) and size


NAN = np.float64(np.nan).tobytes()
DAMAGED: dict[str, tuple[Callable[[dict[str, Any], bytearray], dict[str, Any]], str]] = {
    "checksum": (lambda entry, state: {"crc": entry["crc"] ^ 1}, "its checksum does not match"),
    "layout": (lambda entry, state: {"layout": "0" * 16}, "its layout is of another version"),
    "text": (lambda entry, state: {"state": "?"}, "is left out"),
    "impossible": (lambda entry, state: state.__setitem__(slice(0, 8), NAN) or {}, "no run has"),
    "pass": (lambda entry, state: {"passes": 298}, "the log has no such pass"),
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_one_is_told_and_is_no_pass(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change, said = DAMAGED[kind]
    path = rewritten(tmp_path / "log.mcap", change, monkeypatch)
    code, nodes = replay(path)
    (told,) = nodes["executive"]["missing"]
    assert code == 3 and said in told and nodes["executive"]["keyframes"] == 3, told
    assert nodes["plant"]["identical"]
    verified = run_here("replay", "--brief", path, "--quiet")
    assert verified.code == 3 and "keyframe" in verified.out, verified


def of_another_layout(
    path: Path, patch: pytest.MonkeyPatch, changed: Sequence[int] = (), shorter: int = 0
) -> Path:
    """Return a log of a version with other names of layouts.

    `changed`: cycles whose states have another bit; `shorter`: bytes that all states have less.
    """
    packed, size_of, place = keyframes._packed_state, planned_keyframes.size_of, len(PLAN.names)

    def other(passes: int, name: str, state: bytes) -> dict[str, Any]:
        bit = bytes([state[8 * place] ^ (passes in changed)])  # of the first control word
        return packed(passes, name, state[: 8 * place] + bit + state[8 * place + 1 :])

    with patch.context() as here:
        here.setattr(planned_keyframes, "name_of", lambda *_: "0" * 16)
        here.setattr(planned_keyframes, "size_of", lambda held: size_of(held) - shorter)
        here.setattr(keyframes, "_packed_state", other)
        simulate(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), path)
    return path


def test_those_of_another_layout_are_compared_if_they_have_the_bits_of_this_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = of_another_layout(tmp_path / "log.mcap", monkeypatch)
    code, nodes = replay(path)
    assert code == 0 and [one["keyframes"] for one in nodes.values()] == [4, 4]
    assert not any(one["from_record"] for one in nodes.values())
    assert run_here("replay", "--brief", path, "--quiet").code == 0


@pytest.mark.parametrize(("changed", "shorter"), [((99,), 0), ((399,), 0), ((99, 399), 0), ((), 8)])
def test_other_bits_of_another_layout_are_neither_compared_nor_a_difference(
    changed: Sequence[int], shorter: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = of_another_layout(tmp_path / "log.mcap", monkeypatch, changed, shorter)
    code, nodes = replay(path)
    found = nodes["executive"]
    assert code == 0 and found["keyframes"] == 0 and found["missing"] == []
    assert found["from_record"] == [OTHER_LAYOUT] and found["first"] is None
    verified = run_here("replay", "--brief", path, "--quiet")
    assert verified.code == 3 and "the version that wrote the log" in verified.out, "not all judged"


def test_with_a_change_they_are_not_compared(log: Path) -> None:
    _, nodes = replay(log, "--set", "controller.kv_Nms_rad=9", "--node", "executive")
    found = nodes["executive"]
    assert found["keyframes"] == 0 and found["from_record"] == []
    assert {one["name"].partition(".")[0] for one in found["differences"]} >= {"controller"}


def test_real_time_leaves_no_difference_but_of_clocks(tmp_path: Path) -> None:
    words = "--set", "duration_s=1", "--set", "record.keyframe=100ms", "--no-figure", "--quiet"
    done = pcpc("run", "telerobot-u1", "--bus", own_bus(), *PATIENT, *words, "-o", str(tmp_path))
    assert done.code in (0, 1), done
    code, nodes = replay(tmp_path / "log.mcap")
    assert code == 0 and all(one["keyframes"] > 5 for one in nodes.values()), nodes


# --------------------------------------------------------------------------------------- a part


def table(log: Path, *words: str) -> list[list[str]]:
    done = run_here("replay", log, "--quiet", *words)
    assert done.code == 0, done
    return list(csv.reader(io.StringIO(done.out)))


def test_a_part_is_recomputed_from_the_keyframe_before(log: Path) -> None:
    code, nodes = replay(log, "--from", "0.25", "--to", "0.310")
    assert code == 0 and [one["cycles"] for one in nodes.values()] == [111, 111]
    assert [one["keyframes"] for one in nodes.values()] == [1, 1], "that of cycle 299"
    code, nodes = replay(log, "--from", "0.4", "--node", "plant")
    assert nodes["plant"]["cycles"] == 51 and nodes["plant"]["keyframes"] == 0


def test_any_variable_is_shown_with_the_bits_that_were_recorded(log: Path) -> None:
    node = logs.read(log).node["plant"]
    rows = table(log, "--from", "0.123", "--to", "0.345", "--node", "plant", "--show", "*")
    names = [head.partition(" ")[0] for head in rows[0]]
    assert [int(row[1]) for row in rows[1:]] == [*range(123, 346)]
    for name in node.columns.keys() & {*names}:
        shown = np.array([float(row[names.index(name)]) for row in rows[1:]])
        assert shown.tobytes() == node.columns[name][123:346].tobytes(), name
    assert {*names} > {*node.columns}, "hidden ones too"


def test_a_part_shows_what_step_shows_of_its_cycles(log: Path) -> None:
    rows = table(log, "--from", "0.2", "--to", "0.21", "--show", "controller.w_*")
    for row in (rows[1], rows[-1]):
        done = run_here(
            "replay", log, "--cycle", row[1], "--quiet", "--json", "--show", "controller.w_*"
        )
        (values,) = [one["values"] for one in holds("replay --cycle", done.out) if one["values"]]
        assert [float(text) for text in row[2:]] == [*values.values()]
        assert len(values) > 3


def test_seeks_anywhere_agree_with_the_log(log: Path) -> None:
    """Each begins where chance says; all recorded variables of both nodes are compared there."""
    head, draws = logs.head(log), np.random.default_rng(351)
    rig = load_rig(RIGS / "engage.yaml", settings=list(SHORT))
    read = logs.read(log)
    for cycle in map(int, draws.integers(0, 450, 12)):
        nodes = [NodeComparison(head, rig, role, cycle, seek=cycle) for role in rig.roles]
        for _ in recomputed_pieces(log, nodes, since_ns=min(node.since_ns for node in nodes)):
            pass
        for node in nodes:
            node.require_end()
            index, loop = node.replay.plan.table.index, node.replay.block.loop
            for name, values in read.node[node.role].columns.items():
                assert loop.v[index[name]].tobytes() == values[cycle].tobytes(), (name, cycle)

"""Logs read in pieces have what they have as a whole, wherever the pieces end."""

import tempfile
from dataclasses import replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rings import block_of, put, put_cycle, put_event

from pcpc.executive.log import long_logs, mcap_writer, recovery
from pcpc.executive.log import reader as logs
from pcpc.executive.log.recorder import FLUSH_NS, Recorder
from pcpc.executive.loop.events import Event

CYCLES, DRAIN = 300, 30
LATE = 200  # of the plant's first cycle
WRAP = 1 << 32
KINDS = ["whole", "cut", "flipped", "anew", "anew and cut", "anew and sorted"]


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a log have many pieces, and chunks in which states are without timing."""
    monkeypatch.setattr(mcap_writer, "CHUNK_BYTES", 4000)
    monkeypatch.setattr(logs, "pieces", partial(logs.pieces, size=2000))


def written(
    path: Path, name: str, kind: str, monkeypatch: pytest.MonkeyPatch, first: int = 0
) -> logs.Log:
    """Record an executive and a plant that comes late; return the log, which is made anew or hurt.

    One that is made anew has a channel of the plant only where its first message is.
    """
    now_ns = 0
    executive, plant = block_of(name), block_of(f"{name}-plant", "plant", ["barrel.angle"])
    log = Recorder(path, [executive, plant], clock=lambda: now_ns)
    for cycle in range(CYCLES):
        for node in (executive, plant) if cycle >= LATE else (executive,):
            put_cycle(node, first + cycle, frames=1)
        if cycle % DRAIN == DRAIN - 1:
            put(executive, "frame", [0, 1, first + cycle, 99 << 32, 0])  # of 99 bytes
            put_event(executive, first + cycle, Event.TUNING, 1, 1.0)
            put_event(executive, first + cycle, Event.FAULT, 1, 0.0)
            now_ns += FLUSH_NS
            log.drain()
    log.finish()
    if "sorted" in kind:  # by topic
        walk = recovery.walk
        in_order = lambda *given: iter(sorted(walk(*given), key=itemgetter(0)))  # noqa: E731
        monkeypatch.setattr(recovery, "walk", in_order)
    if "anew" in kind:
        recovery.recover(path, path.with_name("anew.mcap"))
        path.with_name("anew.mcap").replace(path)
    data = bytearray(path.read_bytes())
    if "flipped" in kind:
        data[data.index(b"executive.json") + 500] ^= 1
    path.write_bytes(data[:-100] if "cut" in kind else data)  # the summary
    return logs.read(path)


def bits(values: np.ndarray) -> list[int]:
    """Return values bit by bit."""
    return np.ascontiguousarray(values).view(np.int64).tolist()


def contents(node: logs.NodeLog) -> dict[str, Any]:
    """Return what a node has besides its frames."""
    columns = {key: bits(node.columns[key]) for key in node.columns}
    timing = {key: bits(node.timing[key]) for key in node.timing}
    cycles = {"cycle": bits(node.cycle), "stamp": bits(node.stamp_ns)}
    return cycles | {"columns": columns, "timing": timing, "entries": [node.events, node.tunings]}


def foreseen(log: logs.Log) -> long_logs.Wanted:
    """Return the columns of the nodes that have come, but for one."""
    return {name: [*node.columns, *node.timing][1:] for name, node in log.node.items()}


@pytest.mark.parametrize("short", [10, 250, CYCLES])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("first", [0, WRAP - LATE - 50])
def test_a_log_in_pieces_has_what_the_whole_has(
    first: int, kind: str, short: int, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = written(tmp_path / "log.mcap", name, kind, monkeypatch, first)
    log = long_logs.read(whole.path, foreseen, short=short)
    assert isinstance(log, long_logs.LongLog) == (short < CYCLES)
    assert len(whole.node["executive"].cycle) == CYCLES, whole.missing
    assert len(whole.node["plant"].cycle) == CYCLES - LATE, whole.missing
    for role, node in whole.node.items():
        assert len(log.node[role].frames) == 0, role
        found, expected = contents(log.node[role]), contents(node)
        assert [key for key in expected if found[key] != expected[key]] == [], role
        assert list(found["columns"]) == list(expected["columns"]), role


@pytest.mark.parametrize("kind", KINDS)
def test_the_pieces_of_a_log_add_up_to_it_and_tell_once_what_is_missing(
    kind: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = written(tmp_path / "log.mcap", name, kind, monkeypatch)
    pieces = [piece for piece, _ in logs.pieces(whole.path)]
    assert len(pieces) > 3
    for role, node in whole.node.items():
        own = [piece.node[role] for piece in pieces]
        assert np.concatenate([one.cycle for one in own]).tolist() == node.cycle.tolist(), role
        assert sum(len(one.frames) for one in own) == len(node.frames), role
    impossible = "executive: 10 frames that no bus could have carried"
    assert impossible in whole.missing
    read = long_logs.read(whole.path, short=10)
    assert sum(int(line.split()[1]) for line in read.missing if "no bus" in line) == 10
    told = [line for line in whole.missing if line != impossible]
    for missing in read.missing, [line for piece in pieces for line in piece.missing]:
        assert sorted(line for line in missing if "no bus" not in line) == sorted(told)


def test_states_wait_for_their_timing_in_bounded_memory(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = written(tmp_path / "log.mcap", name, "anew and sorted", monkeypatch)
    monkeypatch.setattr(logs, "_PATIENCE_BYTES", 5000)
    pieces = [piece for piece, _ in logs.pieces(whole.path)]
    told = [line for piece in pieces for line in piece.missing if "have no timing" in line]
    assert 1 < len(told) < 12, told


@pytest.mark.parametrize("most", [0, 3, 5])
def test_events_of_a_long_log_are_bounded(
    most: int, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = written(tmp_path / "log.mcap", name, "whole", monkeypatch)
    monkeypatch.setattr(long_logs, "MOST_ENTRIES", most)
    log = long_logs.read(whole.path, short=2 * DRAIN)
    begin = next(logs.pieces(whole.path, short=2 * DRAIN))[0].node["executive"]
    for kind in ("events", "tunings"):
        own, of_all = getattr(log.node["executive"], kind), getattr(whole.node["executive"], kind)
        assert own == of_all[: max(most, len(getattr(begin, kind)))], kind


def test_a_table_ends_with_its_last_whole_row(tmp_path: Path) -> None:
    with (tmp_path / "table").open("w+b") as file:
        table = long_logs.ColumnFile(file, ["a", "b", "a"])
        rows = np.arange(12).reshape(3, 4)
        table.append(rows)
        file.write(b"cut")  # its recorder was killed
        assert table.rows().tolist() == rows.tolist()
        assert [bits(table.column(key)) for key in "ab"] == [[2, 6, 10], [3, 7, 11]]


def test_a_table_has_no_number_for_what_a_piece_lacks(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = written(tmp_path / "log.mcap", name, "whole", monkeypatch).node["plant"]
    with (tmp_path / "table").open("w+b") as file:
        table = long_logs.ColumnFile(file, ["barrel.angle", "not.there"])
        table.write(node)
        assert bits(table.column("barrel.angle")) == bits(node.columns["barrel.angle"])
        assert np.isnan(table.column("not.there")).all()


@pytest.mark.parametrize("short", [CYCLES, CYCLES - 1])
def test_tables_beside_a_log_are_its_whole_run_if_all_are_there(
    short: int, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = written(tmp_path / "log.mcap", name, "whole", monkeypatch)
    wanted = {role: list(node.columns)[:1] for role, node in log.node.items()}
    bare = {role: replace(node, cycle=node.cycle[:0]) for role, node in log.node.items()}
    kept = replace(log, node=bare)
    for role, node in log.node.items():
        assert long_logs.whole_run(kept, wanted, short) is kept, f"without that of the {role}"
        table = long_logs.ColumnFile(long_logs.sidecar(log.path, role).open("wb"), wanted[role])
        table.write(node)
        table.close()
    whole = long_logs.whole_run(kept, wanted, short)
    assert isinstance(whole, long_logs.LongLog) == (short < CYCLES)
    for role, node in log.node.items():
        assert whole.node[role].cycle.tolist() == node.cycle.tolist(), role
        (column,) = wanted[role]
        assert bits(whole.node[role].columns[column]) == bits(node.columns[column]), role


def test_a_log_in_a_folder_that_takes_no_file_is_read(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = written(tmp_path / "log.mcap", name, "whole", monkeypatch)
    usual = tempfile.TemporaryFile

    def elsewhere(**at: Any) -> Any:
        if at:
            raise PermissionError(13, "Permission denied")
        return usual()

    monkeypatch.setattr(tempfile, "TemporaryFile", elsewhere)
    log = long_logs.read(whole.path, foreseen, short=10)
    assert contents(log.node["plant"]) == contents(whole.node["plant"])


@pytest.mark.parametrize("part", [7, 100, CYCLES])
def test_parts_of_a_long_log_have_a_cycle_more_at_both_ends(
    part: int, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = written(tmp_path / "log.mcap", name, "whole", monkeypatch)
    log = long_logs.read(whole.path, foreseen, short=10, part=part)
    assert isinstance(log, long_logs.LongLog)
    own = []
    for stretch, first, past in log.parts("executive"):
        cycle = stretch.node["executive"].cycle.tolist()
        own += cycle[first:past]
        assert first == (cycle[0] > 0) and len(cycle) - past == (cycle[-1] < CYCLES - 1), cycle
        plant = stretch.node["plant"].cycle
        near = range(max(cycle[0] - 2, LATE), cycle[-1] + 1)  # stamped up to two periods before
        assert set(near) <= set(plant.tolist()) and len(plant) <= len(near) + 6, (cycle, plant)
    assert own == list(range(CYCLES))

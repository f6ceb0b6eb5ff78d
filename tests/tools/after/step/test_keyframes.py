"""Keyframes: a node that begins behind one goes on with the bits of one that began at the start."""

import base64
import itertools
import json
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from json_schemas import holds
from logcommand import run_here
from processes import PATIENT, RIGS, ROOT, own_bus, pcpc

from pcpc.executive.log import keyframes, mcap_reader
from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes import planned_keyframes
from pcpc.executive.nodes.install import install_in_memory
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.replay import NodeComparison, recomputed_pieces

ALL_RIGS = sorted(ROOT.glob("plants/*/rigs/*.yaml"))
SHORT = ("duration_s=0.45", "record.keyframe=100ms")
# clocks, rings and statistics; the wire and the meeting, which a replay does not have; when the
# next one is due
NOT_STATE = {
    "answer", "stages", "histogram", "latest", "snapshot", "seq", "record", "frame", "event",
    "meeting", "keyframe", "keyframe_seq", "wire", "timing", "keep",
    "mail", "mail_index", "mail_value",
    *(f"{ring}_{word}" for ring in sh.RINGS for word in ("ends", "taken")),
    "end_of_published", "end_of_mailbox",
}  # fmt: skip
FAULTS = """faults:
  late: {kind: delay, frame: FB_A, value: 5, from: 150ms, for: 200ms}
  gone: {kind: loss, frame: FB_B, share: 0.3, from: 50ms, for: 400ms}
  held: {kind: stuck, at: controller.hub_rate_rad_s, from: 180ms, for: 100ms}
  past: {kind: delay, at: controller.encoder_rad, value: 20, from: 190ms, for: 220ms}
"""


def leaves(kind: Any, at: int = 0, name: str = "") -> Iterator[tuple[str, int, int]]:
    for field in kind.names:
        inner, place = kind.fields[field][:2]
        if name or field not in NOT_STATE:
            if inner.names:
                yield from leaves(inner, at + place, f"{name}{field}.")
            else:
                yield f"{name}{field}", at + place, inner.itemsize


def state_of(node: NodeComparison) -> dict[str, bytes]:
    """Return all that a node has in its memory, by the name of the field."""
    loop, made = node.replay.block.loop, node.replay.plan
    data = np.asarray(loop).tobytes()
    found = {name: data[at : at + size] for name, at, size in leaves(sh.LOOP)}
    del found["control.sent"]  # a replay does not count what was said in the meeting
    del found["tuning.schedule"], found["tuning.value"]  # what is left of tunings that are done
    kept = [i for i, one in enumerate(made.table.variables) if not one.timing]
    return found | {"v": loop.v[kept].tobytes()}


def compared(log: Path, cycle: int, seek: int, rig: Any) -> list[NodeComparison]:
    head = logs.head(log)
    nodes = [NodeComparison(head, rig, role, cycle, seek=seek) for role in rig.roles]
    for _ in recomputed_pieces(log, nodes, since_ns=min(node.since_ns for node in nodes)):
        pass
    for node in nodes:
        node.require_end()
    return nodes


def same_state_behind(log: Path, cycle: int, rig: Any) -> None:
    """Hold a node that begun behind a keyframe against one that began at the start."""
    sought, whole = compared(log, cycle, cycle, rig), compared(log, cycle, 0, rig)
    for one, other in zip(sought, whole, strict=True):
        assert one.verdict.cycles < other.verdict.cycles, "it began at the start"
        assert one.verdict.cycles > 0, "the cycle itself is recomputed, not taken from its keyframe"
        mine, wanted = state_of(one), state_of(other)
        assert not (wrong := [name for name in wanted if mine[name] != wanted[name]]), wrong


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[] if path.stem == "hull" else pytest.mark.deep)
        for path in ALL_RIGS
    ],
)
def test_all_that_a_node_carries_is_in_a_keyframe(path: Path, tmp_path: Path) -> None:
    every = max(1, round(0.1 * load_rig(path).config.rate_hz))
    duration = (4 * every + 9) / load_rig(path).config.rate_hz
    rig = load_rig(path, settings=["record.keyframe=100ms", f"duration_s={duration}"])
    simulate(rig, tmp_path / "log.mcap")
    for cycle in sorted({every + 1, 2 * every, 3 * every - 1, 4 * every + 3}):
        same_state_behind(tmp_path / "log.mcap", cycle, rig)


def test_faults_on_purpose_are_in_the_middle_of_it(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(f"base: {RIGS / 'engage.yaml'}\n{FAULTS}")
    rig = load_rig(tmp_path / "rig.yaml", settings=list(SHORT))
    simulate(rig, tmp_path / "log.mcap")
    for cycle in (160, 203, 310, 440):
        same_state_behind(tmp_path / "log.mcap", cycle, rig)


# ------------------------------------------------------------------------ what a log has of them


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("keyframes") / "log.mcap"
    simulate(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), path)
    return path


def entries(log: Path, role: str = "executive") -> list[dict[str, Any]]:
    return [json.loads(text) for text in logs.payloads(log, logs.topic(role, "keyframes"))]


def stepped(log: Path, cycle: int) -> Any:
    done = run_here("replay", log, "--cycle", str(cycle), "--quiet", "--json")
    assert done.code == 0, done
    return holds("replay --cycle", done.out)


def test_there_is_one_each_time(log: Path) -> None:
    for role in ("executive", "plant"):
        assert [one["cycle"] for one in entries(log, role)] == [99, 199, 299, 399]
        assert [one["passes"] for one in entries(log, role)] == [99, 199, 299, 399]
    assert logs.read(log).missing == []


def test_a_rig_says_how_often_and_none_is_none(tmp_path: Path) -> None:
    rig = RIGS / "engage.yaml"
    simulate(load_rig(rig, settings=["duration_s=0.1", "record.keyframe=0s"]), tmp_path / "a.mcap")
    assert "/keyframes" not in {c.topic for c in logs.scan(tmp_path / "a.mcap").channels.values()}
    for wrong in ("99ms", "13e9s", "-1s", "1"):
        done = run_here("check", rig, "--set", f"record.keyframe={wrong}")
        assert done.code == 2 and "keyframe" in done.err and done.err.count("\n") == 1, done


def test_a_node_whose_state_is_elsewhere_has_none() -> None:
    made = plan(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), "executive", "lockstep")
    assert planned_keyframes.passes_of(made) == 100
    made.external["controller"] = None
    assert planned_keyframes.passes_of(made) == 0


def test_what_a_fault_makes_of_a_parameter_is_a_state_that_a_run_has() -> None:
    probe = ROOT / "plants/probe/rig.yaml"
    fault = "faults: {far: {kind: value, at: controller.gain, value: 1.0e+12, from: 10ms}}"
    text = f"base: {probe}\nrig: far\nduration_s: 0.25\nrecord: {{keyframe: 100ms}}\n{fault}\n"
    run = VirtualRun(load_rig(probe.with_name("far.yaml"), text=text), None)
    for _ in run.advance():
        pass
    made, frame = run.plans[0], keyframes.Keyframes(run.blocks[0]).newest()
    assert frame is not None and frame.cycle == 199
    assert planned_keyframes.why_none(made, frame.state) == ""
    made.faults.clear()
    said = planned_keyframes.why_none(made, frame.state)
    assert said == "controller.gain is 1e+12, which no run has"


def test_a_fault_of_a_frame_spoils_no_variable() -> None:
    probe = ROOT / "plants/probe/rig.yaml"
    text = f"base: {probe}\nrig: far\nfaults: {{bits: {{kind: corruption, frame: FB}}}}\n"
    made = plan(load_rig(probe.with_name("far.yaml"), text=text), "executive", "lockstep")
    state = bytearray(planned_keyframes.size_of(planned_keyframes.held_spans(made)))
    place = made.faults[0].target
    assert made.table.variables[place].kind not in planned_keyframes._ANY_NUMBER
    state[8 * place : 8 * place + 8] = np.float64(np.nan).tobytes()
    said = planned_keyframes.why_none(made, bytes(state))
    assert said == f"{made.names[place]} is nan, which no run has"


def test_what_a_drive_says_is_a_number_and_what_frames_and_laws_say_may_be_none() -> None:
    made = plan(load_rig(ROOT / "tests/drivers/canopen/mastered.yaml"), "plant", "lockstep")
    values = np.array([made.values.get(i, 0.0) for i in range(len(made.names))])
    rest = bytes(planned_keyframes.size_of(planned_keyframes.held_spans(made)) - values.nbytes)
    signals = {
        i: one.writer == "drive"
        for i, one in enumerate(made.table.variables)
        if one.kind in planned_keyframes._ANY_NUMBER
    }
    assert set(signals.values()) == {True, False}
    for i, of_drive in signals.items():
        (wrong := values.copy())[i] = np.nan
        said = planned_keyframes.why_none(made, wrong.tobytes() + rest)
        assert said == (f"{made.names[i]} is nan, which no run has" if of_drive else "")


def test_a_layout_has_its_name_from_fields_types_and_variables_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    held, names = planned_keyframes.held_spans(PLAN), PLAN.names
    own = planned_keyframes.name_of(held, names)
    moved = [(record, name, offset + 64, size) for record, name, offset, size in held]
    assert planned_keyframes.name_of(moved, names) == own, "another record grew"
    assert planned_keyframes.name_of(held[:-1], names) != own
    assert planned_keyframes.name_of([*held[:-2], held[-1], held[-2]], names) != own
    assert planned_keyframes.name_of(held, [*names[:-1], "another"]) != own
    monkeypatch.setattr(planned_keyframes, "_kind_of", lambda *_: "<i4")
    assert planned_keyframes.name_of(held, names) != own


def test_of_a_record_the_columns_that_it_carries_are_put_back_and_no_others() -> None:
    loop: Any = np.recarray(1, sh.LOOP, sh.blank())[0]
    install_in_memory(PLAN, loop)
    before, held = loop.copy(), planned_keyframes.held_spans(PLAN)
    planned_keyframes.put_back(loop, held, b"\1" * planned_keyframes.size_of(held))
    for record, name, _, _ in held[1:]:
        columns = planned_keyframes.KEPT[record][name]
        for column in loop[record][name].dtype.names or ():
            same = loop[record][name][column].tobytes() == before[record][name][column].tobytes()
            assert same == (bool(columns) and column not in columns), (record, name, column)


def test_all_cycles_are_those_of_a_log_without(log: Path, tmp_path: Path) -> None:
    settings = ["duration_s=0.45", "record.keyframe=0s"]
    simulate(load_rig(RIGS / "engage.yaml", settings=settings), tmp_path / "log.mcap")
    for cycle in (0, 99, 100, 101, 250, 400, 449):
        assert stepped(log, cycle) == stepped(tmp_path / "log.mcap", cycle), cycle


def test_a_ring_of_a_log_can_be_stepped_behind_its_first_keyframe(tmp_path: Path) -> None:
    settings = [*SHORT, "record.keep=200ms", "record.on=tuning",
                "schedule=[{at_s: 0.3, set: {controller.network_on: 1.0}}]"]  # fmt: skip
    simulate(load_rig(RIGS / "engage.yaml", settings=settings), tmp_path / "log.mcap")
    read = logs.read(tmp_path / "log.mcap")
    assert read.missing == [] and read.node["executive"].cycle[0] == 100
    for one in stepped(tmp_path / "log.mcap", 320):
        node = read.node[one["node"]]
        row = int(np.flatnonzero(node.cycle == 320)[0])
        for name in node.columns.keys() & one["values"].keys():
            assert float(one["values"][name]) == node.columns[name][row], name
    early = run_here("replay", tmp_path / "log.mcap", "--cycle", "150")
    assert early.code == 2 and "not with the start of the run" in early.err, early


def with_state(change: Callable[[bytearray], Any]) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return what changes the state of an entry, with a checksum that is right."""

    def of(entry: dict[str, Any]) -> dict[str, Any]:
        state = bytearray(zstandard.decompress(base64.b64decode(entry["state"])))
        change(state)
        text = base64.b64encode(zstandard.compress(bytes(state))).decode()
        return entry | {"state": text, "crc": zlib.crc32(state)}

    return of


def put(field: tuple[str, str], value: int, index: int = 0) -> Callable[[bytearray], None]:
    """Return what puts a value into a field of a state."""

    def into(state: bytearray) -> None:
        at = 0
        for record, name, _, size in planned_keyframes.spans(VARIABLES, False):
            if (record, name) == field:
                at += 8 * index
                state[at : at + 8] = np.int64(value).tobytes()
                return
            at += size
        raise AssertionError(field)

    return into


PLAN = plan(load_rig(RIGS / "engage.yaml"), "executive", "lockstep")
VARIABLES = len(PLAN.table.variables)
PARAMETER = next(i for i, one in enumerate(PLAN.table.variables) if one.low > -1e11)
BELOW = int(np.float64(-1e12).view(np.int64))
WRONG: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "bit": (lambda e: e | {"crc": e["crc"] ^ 1}, "its checksum does not match"),
    "layout": (lambda e: e | {"layout": "0" * 16}, "its layout is of another version"),
    "base64": (lambda e: e | {"state": "?" + e["state"][1:]}, "left out"),
    "zstd": (lambda e: e | {"state": base64.b64encode(b"no zstd at all").decode()}, "left out"),
    "cut": (lambda e: e | {"state": e["state"][: len(e["state"]) // 8 * 4]}, "left out"),
    "size": (with_state(lambda s: s.extend(bytes(8))), "its state does not have"),
    "short": (with_state(lambda s: s.__delitem__(slice(-8, None))), "its state does not have"),
    "count": (with_state(put(("control", "sent"), (1 << 63) - 1)), "control.sent is"),
    "negative": (with_state(put(("rx", "state"), -(1 << 63))), "rx.state"),
    "nan": (with_state(lambda s: s.__setitem__(slice(0, 8), np.float64(np.nan).tobytes())), "nan"),
    "large": (
        with_state(lambda s: s.__setitem__(slice(0, 8), np.float64(1e300).tobytes())),
        "1e+300",
    ),
    "parameter": (with_state(put(("", "v"), BELOW, PARAMETER)), "is -1e+12"),
    "kind": (lambda e: e | {"passes": "7"}, "left out"),
    "beyond": (lambda e: e | {"passes": -1}, "left out"),
    "absent": (lambda e: {k: v for k, v in e.items() if k != "crc"}, "left out"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_one_is_left_out_and_told_and_the_one_before_serves(
    kind: str, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoil, said = WRONG[kind]
    true = keyframes._packed_state
    made = itertools.count()

    def packed(*words: Any) -> Any:
        whole = true(*words)
        return spoil(whole) if next(made) in (4, 5) else whole  # those of cycle 299

    monkeypatch.setattr(keyframes, "_packed_state", packed)
    path = tmp_path / "log.mcap"
    simulate(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), path)
    assert stepped(path, 350) == stepped(log, 350)
    head, rig = logs.head(path), load_rig(RIGS / "engage.yaml", settings=list(SHORT))
    node = NodeComparison(head, rig, "executive", 350, seek=350)
    (told,) = node.notes
    assert "a keyframe of the executive is left out" in told and said in told, told
    assert node.recorded.behind == 199


def test_a_search_goes_back_as_far_as_it_has_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true, made = keyframes._packed_state, itertools.count()
    spoiled = lambda *words: true(*words) | ({"crc": 0} if next(made) > 3 else {})  # noqa: E731
    rig = load_rig(RIGS / "engage.yaml", settings=["duration_s=1.5", "record.keyframe=100ms"])
    with monkeypatch.context() as patch:
        patch.setattr(keyframes, "_packed_state", spoiled)
        simulate(rig, tmp_path / "log.mcap")
    node = NodeComparison(logs.head(tmp_path / "log.mcap"), rig, "plant", 1450, seek=1450)
    assert node.recorded.behind == 199, "two of each node are right"
    (told,) = node.notes
    assert "cycle 1399" in told and told.endswith("; and 11 more"), told


def test_the_user_is_told_what_was_left_out_and_of_another_version_once(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(planned_keyframes, "name_of", lambda *_: "0" * 16)
        simulate(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), tmp_path / "log.mcap")
    words = "--cycle", "350", "--node", "plant", "--json"
    done = run_here("replay", tmp_path / "log.mcap", "--quiet", *words)
    told = "the keyframes of the plant are left out: its layout is of another version"
    assert done.code == 0 and done.err.count("\n") == 1 and told in done.err, done
    assert holds("replay --cycle", done.out) == [
        one for one in stepped(log, 350) if one["node"] == "plant"
    ]


def test_a_log_that_was_cut_has_those_before_the_cut(log: Path, tmp_path: Path) -> None:
    whole, path = log.read_bytes(), tmp_path / "log.mcap"
    for size in (len(whole) - 9, len(whole) * 95 // 100, len(whole) * 9 // 10):
        path.write_bytes(whole[:size])
        read = logs.read(path)
        last = min(int(node.cycle[-1]) for node in read.node.values())
        cycle = min(last - 120, 430)
        assert stepped(path, cycle) == stepped(log, cycle), (size, cycle)


def test_a_flipped_bit_is_never_another_value(log: Path, tmp_path: Path) -> None:
    whole, wanted = log.read_bytes(), stepped(log, 350)
    for place in np.random.default_rng(35).integers(200, len(whole) - 200, 12):
        spoiled = bytearray(whole)
        spoiled[place] ^= 1 << int(place % 8)
        (tmp_path / "log.mcap").write_bytes(bytes(spoiled))
        done = run_here("replay", tmp_path / "log.mcap", "--cycle", "350", "--quiet", "--json")
        assert done.code != 0 or holds("replay --cycle", done.out) == wanted, int(place)


def test_a_part_of_a_log_is_what_the_whole_has_there(log: Path, tmp_path: Path) -> None:
    found = logs.scan(log)
    times = [
        (channel, int(row.view(logs.message_dtype(0))["log_time"][0]), row.tobytes())
        for channel, rows in found.pieces
        for row in np.ascontiguousarray(rows[:, :31])
    ]
    first, last = min(t for _, t, _ in times), max(t for _, t, _ in times)
    (tmp_path / "cut.mcap").write_bytes(log.read_bytes()[:-40])
    for path in (log, tmp_path / "cut.mcap"):
        for low, high in ((first, first), (first + 10**8, first + 2 * 10**8), (last, last)):
            part = logs.Scan()
            got = {
                row.tobytes()
                for _, rows in logs.walk(path, part, (low, high))
                for row in np.ascontiguousarray(rows[:, :31])
            }
            assert {row for _, time, row in times if low <= time <= high} <= got, (low, high)
        assert not list(logs.walk(path, logs.Scan(), mcap_reader.NONE))


def test_a_state_in_the_making_is_not_taken(log: Path) -> None:
    run = VirtualRun(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), None)
    block = run.blocks[0]
    watch = keyframes.Keyframes(block)
    assert watch.newest() is None
    for _ in run.advance():
        break
    block["keyframe_seq"][0] += 1
    assert not list(watch.look()), "odd: it is being written"
    block["keyframe_seq"][0] += 1
    ((_, cycle, _),) = watch.look()
    assert cycle == 99 and not list(watch.look())


class Overtaken:
    """A node's memory, in which a further keyframe is written while the first is copied."""

    def __init__(self, block: Any) -> None:
        self.description, self._block, self.looks = block.description, block, 0

    def __getitem__(self, name: str) -> Any:
        if name == "keyframe_seq":
            self.looks += 1
            if self.looks == 2:
                self._block[name][0] += 2
                self._block["keyframe"][1] += 100  # its cycle
        return self._block[name]


def test_a_state_that_another_overtakes_is_copied_again() -> None:
    run = VirtualRun(load_rig(RIGS / "engage.yaml", settings=list(SHORT)), None)
    next(run.advance())
    memory: Any = Overtaken(run.blocks[0])
    frame = keyframes.Keyframes(memory).newest()
    assert frame is not None and frame.cycle == 199 and memory.looks == 4


def test_a_cycle_is_recomputed_from_a_keyframe_of_one_before_it(log: Path) -> None:
    node = logs.read(log).node["executive"]
    size, layout = node.description["keyframe_bytes"], node.description["keyframe_layout"]
    text = node.others["keyframes"][1]
    found = [keyframes.keyframe_of(text, 0, size, layout, before) for before in (198, 199, 200)]
    assert [frame and frame.cycle for frame in found] == [None, None, 199]


def test_processes_that_keep_time_have_them_too(tmp_path: Path) -> None:
    words = "--set", "duration_s=1.2", "--set", "record.keyframe=200ms", "--no-figure"
    done = pcpc(
        "run",
        str(RIGS / "engage.yaml"),
        "--bus",
        own_bus(),
        *PATIENT,
        *words,
        "-o",
        str(tmp_path / "run"),
    )
    assert done.code in (0, 1), done
    path = tmp_path / "run/log.mcap"
    cycles = logs.read(path).node["executive"].cycle
    for cycle in (int(cycles[len(cycles) // 2]), int(cycles[-2])):
        found = {one["node"]: one for one in stepped(path, cycle)}
        node = logs.read(path).node["executive"]
        row = int(np.flatnonzero(node.cycle == cycle)[0])
        for name in node.columns.keys() & found["executive"]["values"].keys():
            assert float(found["executive"]["values"][name]) == node.columns[name][row], name
    assert len(entries(path)) >= 4

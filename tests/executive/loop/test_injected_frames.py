"""Faults of communication: what comes in the place of each frame, and what the receiver says."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fd_rig import PROBE, fd_rig
from numpy.typing import NDArray
from places import ROOT

from pcpc.drivers.can import e2e_states as e2e
from pcpc.drivers.can.e2e import crc8
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader
from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.evidence.expected import crc16
from pcpc.tools.make.dbc import dbc_text, frames_of, rigs_of

FROM, TO = 30, 40  # cycles whose frames are disturbed
FB, CMD = 0x120, 0x0A0
Frames = NDArray[np.void]


def run(folder: Path, fault: str, *settings: str, crc_bits: int = 8) -> reader.Log:
    """Return the log of a short run of the motor with a fault of 10 cycles."""
    motor = folder / "motor"
    if not motor.exists():
        shutil.copytree(ROOT / "tools/make/template", motor)
        if crc_bits == 16:
            rigs = rigs_of(motor / "rig.yaml")
            frames = frames_of(rigs, crc_bits)
            (motor / "motor.dbc").write_text(dbc_text(frames, ["EXEC", "PLANT"], 1000.0))
    text = (ROOT / "tools/make/template/rig.yaml").read_text().partition("watch:")[0]
    text = text.replace("duration_s: 1.0", "duration_s: 0.1")
    path, log = motor / "wrong.yaml", folder / "log.mcap"
    path.write_text(f"{text}faults:\n  it: {{{fault}, from: 30ms, for: 10ms}}\n")
    log.unlink(missing_ok=True)
    simulate(load_rig(path, settings=list(settings)), log)
    return reader.read(log)


def frame_id(log: reader.Log, name: str) -> int:
    """Return the id of a frame by its name."""
    known = log.node["executive"].description["frames"]
    return next(int(number) for number, text in known.items() if text == name)


def come(log: reader.Log, name: str, node: str = "executive") -> tuple[Frames, Frames, Frames]:
    """Return what came as it is sent, what was taken from the wire, what was put in its place."""
    frames = log.node[node].frames
    own = frames[(frames["direction"] == 1) & (frames["id"] == frame_id(log, name))]
    state = own["e2e"]
    taken = own[state == FrameState.LOST_ON_PURPOSE]
    return own[state < FrameState.LOST_ON_PURPOSE], taken, own[state >= e2e.INJECTED]


def states(frames: Frames) -> list[str]:
    """Return what the receiver made of injected frames."""
    return [FrameState.names()[int(state) - e2e.INJECTED] for state in frames["e2e"]]


def data(frames: Frames) -> NDArray[np.uint8]:
    """Return the data bytes, a row a frame."""
    return np.ascontiguousarray(frames["data"])


def ones(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return in how many bits rows differ."""
    return np.unpackbits(a ^ b, axis=1).sum(axis=1)


def test_a_blocked_channel_holds_then_faults_and_frames_are_in_the_log(tmp_path: Path) -> None:
    true, taken, put = come(run(tmp_path, "kind: loss, frame: FB"), "FB")
    assert list(taken["cycle"]) == list(range(FROM, TO)) and not len(put)
    assert not set(range(FROM, TO)) & set(true["cycle"])
    log = run(
        tmp_path,
        "kind: loss, frame: FB",
        "supervisor.hold_cycles=2",
        "supervisor.fault_after_cycles=3",
    )
    state = log.node["executive"].columns["supervisor.state"]
    assert [int(x) for x in state[FROM - 1 : FROM + 3]] == [2, 3, 3, 4]


def test_inverted_bits_are_found_by_the_crc(tmp_path: Path) -> None:
    for bits, differ in ((1, {1}), (2, {0, 2})):  # twice the same bit is none
        _, taken, put = come(run(tmp_path, f"kind: corruption, frame: FB, value: {bits}"), "FB")
        found = ones(data(taken), data(put))
        assert set(found) <= differ and max(found) == bits
        assert (np.array(states(put)) == "ERROR").tolist() == (found > 0).tolist()


def test_a_repeated_frame_comes_after_the_true_one_and_is_not_used(tmp_path: Path) -> None:
    log = run(tmp_path, "kind: repetition, frame: FB", "faults.it.for=3ms")
    _, taken, put = come(log, "FB")
    late = ["OK_SOME_LOST", "WRONG_SEQUENCE"]  # the counter goes back, and jumps forth
    assert states(put) == ["OK", "WRONG_SEQUENCE", *late, *late]
    np.testing.assert_array_equal(data(put)[0::2], data(taken))
    np.testing.assert_array_equal(data(put)[3::2], data(taken)[:-1])


def test_frames_in_exchanged_order(tmp_path: Path) -> None:
    _, taken, put = come(run(tmp_path, "kind: sequence, frame: FB"), "FB")
    order = np.arange(10).reshape(-1, 2)[:, ::-1].ravel()
    np.testing.assert_array_equal(data(put), data(taken)[order])
    assert set(states(put)[1::2]) == {"WRONG_SEQUENCE"}


def test_a_delay_is_lost_first_then_late(tmp_path: Path) -> None:
    log = run(tmp_path, "kind: delay, frame: FB, value: 3")
    true, taken, put = come(log, "FB")
    np.testing.assert_array_equal(data(put), data(taken)[:7])
    assert list(put["cycle"]) == list(range(FROM + 3, TO))
    assert states(put) == ["OK"] * 7, "a counter does not notice a delay that stays"
    assert true["e2e"][true["cycle"] == TO][0] == FrameState.OK_SOME_LOST


def test_an_inserted_frame_has_no_right_crc(tmp_path: Path) -> None:
    _, taken, put = come(run(tmp_path, "kind: insertion, frame: FB"), "FB")
    np.testing.assert_array_equal(data(put)[0::2], data(taken))
    assert states(put)[0::2] == ["OK"] * 10 and states(put)[1::2] == ["ERROR"] * 10


def test_a_masquerade_is_taken_for_true(tmp_path: Path) -> None:
    _, taken, put = come(run(tmp_path, "kind: masquerade, frame: FB", "faults.it.for=3ms"), "FB")
    assert states(put) == ["OK"] * 3, "CRC and counter stop nobody who knows them"
    assert (ones(data(taken), data(put)) > 5).all()


def test_data_of_another_frame_are_found_by_the_id_in_the_crc(tmp_path: Path) -> None:
    hull = ROOT / "plants/atb1000/rigs/hull.yaml"
    path = tmp_path / "hull.yaml"
    path.write_text(
        f"base: {hull}\nrig: addressed\n"
        "faults:\n  it: {kind: addressing, frame: FB_B, data_of: FB_A, from: 30ms, for: 2ms}\n"
    )
    rig = load_rig(path, settings=["duration_s=0.05"])
    simulate(rig, tmp_path / "log.mcap")
    log = reader.read(tmp_path / "log.mcap")
    _, taken, put = come(log, "FB_B")
    assert len(taken) == 2 and states(put) == ["ERROR"] * 2
    frames = log.node["executive"].frames
    other = frames[(frames["id"] == frame_id(log, "FB_A")) & np.isin(frames["cycle"], (30, 31))]
    np.testing.assert_array_equal(data(put), data(other))


def test_a_wrong_length(tmp_path: Path) -> None:
    _, _, put = come(run(tmp_path, "kind: length, frame: FB, value: 4"), "FB")
    assert set(put["dlc"]) == {4} and set(states(put)) == {"ERROR"}


COUNTERS = [
    ("counter, how: freeze", ["OK"] + ["REPEATED"] * 9),
    ("counter, how: offset, value: 8", ["WRONG_SEQUENCE"] + ["OK"] * 9),
    ("counter, how: offset, value: 2", ["OK_SOME_LOST"] + ["OK"] * 9),
    ("checksum, how: offset, value: 1", ["ERROR"] * 10),
    ("payload, how: freeze", ["OK"] * 10),
]


@pytest.mark.parametrize("crc_bits", [8, 16])
@pytest.mark.parametrize(("kind", "found"), COUNTERS)
def test_counters_and_checksums(kind: str, found: list[str], crc_bits: int, tmp_path: Path) -> None:
    _, _, put = come(run(tmp_path, f"kind: {kind}, frame: FB", crc_bits=crc_bits), "FB")
    assert states(put) == found
    fits = [
        crc8(int(put["id"][0]), row, 7) == row[7]
        if crc_bits == 8
        else crc16(bytes(row[2:]) + bytes([FB & 255, FB >> 8])) == int.from_bytes(row[:2], "little")
        for row in data(put)
    ]
    assert set(fits) == {not kind.startswith("checksum")}, "the CRC fits what it protects"
    if kind.startswith("payload"):
        changed = np.flatnonzero((data(put) != data(put)[0]).any(axis=0))
        assert len(changed) <= 1 + crc_bits // 8, "counter and CRC go on, nothing else"


def test_all_bits_of_a_crc_of_16_are_drawn(tmp_path: Path) -> None:
    fault = "kind: checksum, how: random, frame: FB"
    _, taken, put = come(run(tmp_path, fault, crc_bits=16), "FB")
    assert set(states(put)) == {"ERROR"}
    np.testing.assert_array_equal(data(put)[:, 2:], data(taken)[:, 2:])
    for byte in (0, 1):
        assert len(set(data(put)[:, byte])) > 5, "of ten drawn ones"


@pytest.mark.parametrize("kind", ["forgery", "masquerade", "corruption", "addressing"])
def test_faults_of_frames_with_a_crc_of_16_are_judged_as_of_others(
    kind: str, tmp_path: Path
) -> None:
    other = ", data_of: HB_PLANT" if kind == "addressing" else ""
    fault, reaction = f"kind: {kind}, frame: FB{other}", "supervisor.intrusion=count"
    logs = [run(tmp_path / f"{n}", fault, reaction, crc_bits=n) for n in (8, 16)]
    wanted, found = (set(states(come(log, "FB")[2])) for log in logs)
    assert found == wanted != set()


def test_other_frames_and_other_cycles_are_as_sent(tmp_path: Path) -> None:
    log = run(tmp_path, "kind: corruption, frame: FB, value: 1, share: 0.5, burst: 2")
    true, taken, put = come(log, "FB")
    assert 0 < len(taken) < 10 and len(put) == len(taken)
    assert sorted({*true["cycle"], *taken["cycle"]}) == sorted({*true["cycle"], *put["cycle"]})
    assert not len(come(log, "CMD", "plant")[1])


@pytest.mark.parametrize(
    ("kind", "gone"),
    [("loss", 3), ("corruption, value: 1", 3), ("masquerade", 0), ("repetition", 0),
     ("delay, value: 2", 2)],
)  # fmt: skip
def test_what_is_lost_on_purpose_and_what_is_used_is_counted(
    kind: str, gone: int, tmp_path: Path
) -> None:
    clean, log = (
        run(tmp_path, f"kind: {kind}, frame: FB", f"faults.it.for={span}").node["executive"].timing
        for span in ("0s", "3ms")
    )
    assert log["health.frames_lost_on_purpose"][-1] == gone
    assert clean["health.frames_received"][-1] - log["health.frames_received"][-1] == gone


def test_a_counter_goes_on_from_where_the_fault_left_it(tmp_path: Path) -> None:
    fault = "kind: counter, how: freeze, frame: FB, goes_on: true"
    true, _, put = come(run(tmp_path, fault, "faults.it.for=3ms"), "FB")
    assert states(put)[:3] == ["OK", "REPEATED", "REPEATED"] and set(states(put)[3:]) == {"OK"}
    assert max(true["cycle"]) == FROM - 1, "every later frame has another counter than was sent"
    plain = come(run(tmp_path, fault.replace("true", "false"), "faults.it.for=3ms"), "FB")
    assert plain[0]["e2e"][plain[0]["cycle"] == FROM + 3][0] == FrameState.OK_SOME_LOST


def test_a_fault_that_the_rig_has_not_is_given_with_the_command(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "tools/make/template", tmp_path / "motor")
    rig = tmp_path / "motor/rig.yaml"
    fault = "faults.late={kind: loss, frame: FB, from: 30ms, for: 10ms}"
    cut = "duration_s=0.1"
    simulate(load_rig(rig, settings=[cut, fault, "faults.late.for=2ms"]), tmp_path / "log.mcap")
    assert list(come(reader.read(tmp_path / "log.mcap"), "FB")[1]["cycle"]) == [FROM, FROM + 1]
    for wrong, what in (
        ("faults.late={kind: los, frame: FB}", "no kind los; did you mean loss"),
        ("faults.late={kind: loss, fram: FB}", "unknown key; did you mean frame"),
        ("faults.late=3", "or --set 'faults.late={kind: ...}'"),
    ):
        with pytest.raises(RigError, match=what):
            simulate(load_rig(rig, settings=[cut, wrong]), tmp_path / "log.mcap")


# ------------------------------------------------------------------------------------------ CAN FD

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
    bits = {
        f"{role} {name}": values.tobytes()
        for role, node in run.memory.log().node.items()
        for name, values in node.columns.items()
    }
    controls: list[Any] = [block.control for block in run.blocks]
    counts = {f"{i} {key}": int(one[key]) for i, one in enumerate(controls) for key in COUNTS}
    return bits, counts


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
    bits, counts = outcome(fd_rig(tmp_path, fault))
    plain = tmp_path / "plain"
    plain.mkdir()
    undisturbed = outcome(fd_rig(plain))[0]
    assert {name: bits[name] for name in undisturbed} == undisturbed
    assert 20 < counts["0 intrusions"] < 40 and counts["1 intrusions"] == 0

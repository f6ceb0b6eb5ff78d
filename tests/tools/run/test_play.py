"""`pcpc play`: which frames, in which order, at which time; who drives whom; what is refused."""

import json
import shutil
import signal
import statistics
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from playing import Playing, Sent
from processes import RIGS, Running, blocks_left, own_bus

from pcpc.executive.log import reader as logs
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log import frames as play_frames
from pcpc.tools.after.log.frames import PEER
from pcpc.tools.cli import main, parsed_options
from pcpc.tools.machine.jitter import loops
from pcpc.tools.run import play
from pcpc.tools.run.commands import PlayRequest
from pcpc.tools.terminal.progress import Progress

SLEW10 = str(RIGS / "slew10.yaml")
PATIENT = ("supervisor.hold_cycles=100000", "supervisor.fault_after_cycles=100000")
FEEDBACK, SYNC = ("FB_A", "FB_B", "FB_C"), 0x80


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of 0.3 s of virtual time."""
    path = tmp_path_factory.mktemp("play") / "log.mcap"
    simulate(load_rig(SLEW10, settings=["duration_s=0.3"]), path)
    return path


@pytest.fixture(scope="module")
def log(path: Path) -> logs.Log:
    return logs.read(path)


@pytest.fixture(scope="module")
def frames(log: logs.Log) -> play_frames.LoggedFrames:
    return play_frames.bus_frames(log)


def chosen(frames: play_frames.LoggedFrames, *words: str) -> play_frames.LoggedFrames:
    options = parsed_options(["play", "LOG", *words])
    return play.chosen_frames(frames, PlayRequest.from_options(options))


def recorded(rows: np.ndarray) -> list[Sent]:
    """Return (id, data) of rows of a log."""
    return [(int(row["id"]), row["data"][: row["dlc"]].tobytes()) for row in rows]


def raw(frames: play_frames.LoggedFrames) -> list[Sent]:
    words = frames.words.tolist()
    return [(w, r[8 : 8 + r[4]].tobytes()) for w, r in zip(words, frames.raw, strict=True)]


def with_frames(log: logs.Log, **changed: np.ndarray) -> logs.Log:
    """Return the log with other frames for the nodes named."""
    node = {name: replace(log.node[name], frames=rows) for name, rows in changed.items()}
    return replace(log, node=log.node | node)


# Which frames, and in which order


def test_every_frame_that_was_sent_is_played_once(
    log: logs.Log, frames: play_frames.LoggedFrames
) -> None:
    sent = [log.node[name].frames for name in PEER]
    expected = Counter(f for rows in sent for f in recorded(rows[rows["direction"] == 0]))
    found = Counter(raw(frames))
    assert found == expected, f"{len(frames)} frames, differing: {found - expected}"


def test_frames_of_equal_stamps_keep_the_order_of_the_recording_node(
    log: logs.Log, frames: play_frames.LoggedFrames
) -> None:
    bus = recorded(log.node["executive"].frames)
    played = raw(frames)[: len(bus)]
    first = next((i for i, (a, b) in enumerate(zip(played, bus, strict=True)) if a != b), -1)
    assert first < 0, f"frame {first}: {played[first]}, recorded {bus[first]}"


def test_a_frame_counts_at_the_stamp_of_its_sender(
    log: logs.Log, frames: play_frames.LoggedFrames
) -> None:
    late = {name: log.node[name].frames.copy() for name in PEER}
    for rows in late.values():
        rows["stamp_ns"][rows["direction"] == 1] += 300_000
    found = play_frames.bus_frames(with_frames(log, **late))
    moved = int(np.abs(found.stamp_ns - frames.stamp_ns).max())
    assert moved == 0, f"a receiver's stamp moved a frame by {moved} ns"


def test_what_the_sender_has_not_recorded_counts_at_the_receivers_stamp(log: logs.Log) -> None:
    plant, executive = log.node["plant"].frames.copy(), log.node["executive"].frames.copy()
    executive["stamp_ns"][executive["direction"] == 1] += 300_000
    lost = np.flatnonzero(plant["direction"] == 0)[100:150]
    found = play_frames.bus_frames(
        with_frames(log, executive=executive, plant=np.delete(plant, lost))
    )
    late = int((found.stamp_ns % 1_000_000 == 300_000).sum())
    assert late == len(lost), f"{late} frames have the receiver's stamp, {len(lost)} were lost"


def test_a_frame_put_in_by_somebody_else_is_played_too(
    log: logs.Log, frames: play_frames.LoggedFrames
) -> None:
    executive = log.node["executive"].frames
    wrong = executive[np.flatnonzero(executive["direction"] == 1)[50:51]].copy()
    wrong["data"][:, -1] ^= 0xFF
    found = play_frames.bus_frames(with_frames(log, executive=np.concatenate([executive, wrong])))
    assert len(found) == len(frames) + 1, f"{len(found)} frames, without it {len(frames)}"
    assert found.sent_by("plant").sum() == frames.sent_by("plant").sum() + 1


def test_of_one_node_alone_all_frames_are_played(log: logs.Log) -> None:
    for name in ("executive", "bus"):
        alone = replace(log, node={name: log.node["executive"]})
        n = len(play_frames.bus_frames(alone))
        assert n == len(log.node["executive"].frames), f"{name}: {n} frames"


def test_as_parts_the_frames_between_the_nodes(frames: play_frames.LoggedFrames) -> None:
    parts = [chosen(frames, "--as", name) for name in PEER]
    assert sum(map(len, parts)) == len(frames), f"{[len(part) for part in parts]} frames"
    names = [{part.label(i) for i in range(len(part))} for part in parts]
    assert {"SYNC", "CMD", "HB_EXEC"} <= names[0] and {*FEEDBACK, "HB_PLANT"} <= names[1], names
    assert not names[0] & names[1], names


def test_only_takes_names_and_hexadecimal_ids(frames: play_frames.LoggedFrames) -> None:
    found = chosen(frames, "--only", "FB_A", "--only", "0x080", "--only", "a0")
    words = set(found.words.tolist())
    assert words == {0x120, SYNC, 0xA0}, f"{[hex(word) for word in words]}"


def test_start_and_duration_are_seconds_of_the_recording(frames: play_frames.LoggedFrames) -> None:
    found = chosen(frames, "--start", "0.1", "--duration", "0.05", "--only", "SYNC")
    assert (len(found), int(found.stamp_ns[0])) == (50, 100_000_000), f"{len(found)} frames"


def test_a_cycle_to_step_begins_where_the_recording_nodes_cycle_does(
    frames: play_frames.LoggedFrames,
) -> None:
    ends = play_frames.cycles(frames)
    begins = Counter(frames.label(int(i)) for i in ends[1:300])  # behind them the nodes end
    assert set(begins) == {"FB_A", "MOTPOS"}, f"{begins}"


# The command on a bus


def test_the_bus_carries_the_recording_frame_by_frame(
    path: Path, frames: play_frames.LoggedFrames
) -> None:
    with Playing(path, own_bus()) as playing:
        playing.hear(len(frames))
        code, result, err = playing.result()
    assert code == 0, err
    assert playing.heard == raw(frames), f"{len(playing.heard)} of {len(frames)} frames heard"
    assert result["frames"] == result["frames_planned"] == len(frames)
    assert (result["send_errors"], result["missing"], result["interrupted"]) == (0, [], False)


def test_the_rate_divides_the_time(path: Path) -> None:
    with Playing(path, own_bus(), "-r", "2", "--loop", "2", "--only", "SYNC") as playing:
        code, result, err = playing.result()
    planned_s = result["duration_s"] / (1.0 + 0.01 * result["total_error_percent"])
    assert code == 0, err
    assert abs(planned_s - 0.3005) < 0.0011, f"two laps of 0.3 s at rate 2: {planned_s:.4f} s"


def test_at_rate_0_nothing_is_timed(path: Path, frames: play_frames.LoggedFrames) -> None:
    with Playing(path, own_bus(), "-r", "0") as playing:
        code, result, err = playing.result()
    assert (code, result["frames"]) == (0, len(frames)), err
    assert result["timing_error_us"] is result["total_error_percent"] is None
    assert result["duration_s"] < 0.3, f"{result['duration_s']:.3f} s for 0.3 s recorded"


@pytest.mark.parametrize(("step", "sent"), [("frame", 2), ("cycle", 22)])
def test_each_enter_sends_one_step(path: Path, step: str, sent: int) -> None:
    with Playing(path, own_bus(), "--step", step) as playing:
        code, result, err = playing.result("\n\n")
    assert (code, result["frames"]) == (0, sent), err
    assert "cycle 0: HB_PLANT" in err, err


def test_ctrl_c_ends_with_130_and_what_was_played_so_far(path: Path) -> None:
    with Playing(path, own_bus(), "--loop") as playing:
        playing.hear(3000)  # in the second lap
        playing.process.send_signal(signal.SIGINT)
        code, result, err = playing.result()
    assert (code, result["interrupted"]) == (130, True), err
    assert result["frames"] >= 3000 and result["frames_planned"] is None, result
    assert result["timing_error_us"]["p50"] > 0.0, result


def test_of_a_damaged_log_the_rest_is_played(
    path: Path, tmp_path: Path, frames: play_frames.LoggedFrames
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size - 30_000])
    with Playing(cut, own_bus(), "-r", "0") as playing:
        code, result, err = playing.result()
    assert code == 3, f"exit code {code}: {err}"
    assert 0 < result["frames"] <= len(frames), f"{result['frames']} of {len(frames)} frames"
    assert result["missing"] and f"{cut}: missing: {result['missing'][0]}" in err, err


def test_a_node_opposite_that_nobody_starts_is_given_up_with_its_frames(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(play, "PEER_S", 0.2)
    assert main(["play", str(path), "--as", "executive", "--bus", own_bus(), "--quiet"]) == 4
    err = capsys.readouterr().err
    assert "no frame of the plant (0x120, " in err and "start it, or play with" in err, err


def test_a_log_without_frames_is_refused(log: logs.Log) -> None:
    empty = np.empty(0, logs.FRAME)
    with pytest.raises(play_frames.PlayError, match="holds no frames"):
        play_frames.bus_frames(with_frames(log, executive=empty, plant=empty))


# One node recorded, the other alive


@pytest.fixture(scope="module")
def long_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("long") / "log.mcap"
    simulate(load_rig(SLEW10, settings=["duration_s=1.2"]), path)
    return path


def patient() -> list[str]:
    """Return settings of a node that no stall of a busy machine brings down."""
    return [word for setting in PATIENT for word in ("--set", setting)]


def test_a_recorded_plant_drives_a_live_executive(long_path: Path, tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    words = ["--bus", bus, "--json", "--quiet", "--no-figure", "-o", str(folder), *patient()]
    with (
        Playing(long_path, bus, "--as", "plant") as playing,
        Running(
            "run", "--only=executive", SLEW10, "--set", "duration_s=1.0", "--pacing", "real", *words
        ) as executive,
    ):
        done = executive.done()
        code, result, err = playing.result()
    assert (done.ran, code) == (True, 0), f"{done}\n{err}"
    assert "open loop" in err, err
    counted = done.summary["frames"]
    assert (counted["crc_errors"], counted["lost"]) == (0, 0), counted
    node = logs.read(folder / "log.mcap").node["executive"]
    states = node.columns["supervisor.state"]
    assert states[-1] in (State.RUN, State.HOLD), f"the executive ended in state {states[-1]:g}"
    driven = np.count_nonzero(states == State.RUN)
    assert driven > 100, f"{driven} cycles with an input; it holds where the machine stands still"
    assert node.cycle[-1] == 999, f"{node.cycle[-1]} was the last cycle of 1000"
    assert result["send_errors"] == 0 and not blocks_left(bus)


@pytest.mark.parametrize("pacing", ["sync", "lockstep"])
def test_a_recorded_executive_drives_a_live_plant(long_path: Path, pacing: str) -> None:
    bus = own_bus()
    with (
        Playing(long_path, bus, "--as", "executive") as playing,
        Running(
            "run", "--only=plant", SLEW10, "--pacing", pacing, "--bus", bus, "--quiet", *patient()
        ) as plant,
    ):
        playing.hear(10**9)
        code, _, err = playing.result()
        done = plant.done()
    assert (done.code, code) == (0, 0), f"{done}\n{err}"
    answers = sum(can_id == 0x120 for can_id, _ in playing.heard)
    syncs = sum(can_id == SYNC for can_id, _ in playing.heard)
    assert answers >= syncs - 2 > 1190, f"{answers} samples for {syncs} SYNC"


# The yardstick


@dataclass(frozen=True)
class Round:
    """Timing errors of one play: of one in 100 frames, us; and of the whole length, %."""

    p99_us: float
    total_percent: float
    within_200us_percent: float = 0.0


def played_once(path: Path) -> Round:
    words = [sys.executable, "-P", "-m", "pcpc.tools.cli", "play", str(path), "--bus", own_bus()]
    done = subprocess.run([*words, "--json", "--quiet"], capture_output=True, text=True, check=True)
    said = json.loads(done.stdout)
    total, within = abs(said["total_error_percent"]), said["within_200us_percent"]
    return Round(said["timing_error_us"]["p99"], total, within)


def woken_once(setup: loops.Setup, folder: Path) -> Round:
    late_ns = loops.run("c", setup, folder, Progress(quiet=True), "").late_ns
    total = 100.0 * abs(int(late_ns[-1] - late_ns[0])) / (1e9 * setup.round_s)
    return Round(1e-3 * float(np.percentile(late_ns, 99)), total)


def test_our_timing_is_that_of_a_bare_loop_in_c_in_the_same_rounds(
    path: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    setup = loops.Setup(1_000_000, 300, PlayRequest(log="LOG").priority)  # the periods of the log
    if shutil.which("cc") is None:
        request.applymarker(pytest.mark.xfail(reason="no C compiler", raises=loops.JitterError))
    if missing := loops.prepare(("c",), setup, tmp_path):
        raise missing["c"]
    for attempt in ("first", "retry"):  # the other tests take processors away
        rounds = [(played_once(path), woken_once(setup, tmp_path)) for _ in range(5)]
        ours, c = zip(*rounds, strict=True)
        within = statistics.median(one.within_200us_percent for one in ours)
        ratio = statistics.median(o.p99_us for o in ours) / statistics.median(o.p99_us for o in c)
        told = f"{attempt}: {within:.2f} % within 200 us, p99 {ratio:.2f} x C, which only wakes"
        if within >= 99.0 or ratio <= 1.2:
            break
    assert within >= 99.0 or ratio <= 1.2, told
    total, c_total = (statistics.median(one.total_percent for one in all_) for all_ in (ours, c))
    assert total < max(0.1, 1.2 * c_total), f"total error {total:.4f} %, C {c_total:.4f} %"

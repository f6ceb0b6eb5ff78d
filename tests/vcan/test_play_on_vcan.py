"""`pcpc play` on a real vcan0: what candump hears is what the log holds, when the log says it."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live import CHANNEL, ROOT, Frame, candump_into, cansend, frames_in, until

from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import frames as play_frames

pytestmark = pytest.mark.vcan

HB_EXEC, STRANGER = 0x701, 0x7FE
RATE = 0.05  # an emulated processor is 50 times slower
BEGIN_S, PART_S = 0.5, 0.1
SLOWLY = ("-r", str(RATE), "--start", str(BEGIN_S), "--duration", str(PART_S))
SLACK_NS = 1_000  # candump writes whole microseconds


@dataclass(frozen=True)
class Played:
    """One playing: exit code, its JSON, stderr, candump's log."""

    code: int
    result: dict[str, Any]
    err: str
    candump: Path

    @property
    def heard(self) -> list[Frame]:
        """The frames that candump saw."""
        return frames_in(self.candump)

    @property
    def stamps_ns(self) -> np.ndarray:
        """When candump's kernel had them, (n,)."""
        words = [line.split()[0].strip("()") for line in self.candump.read_text().splitlines()]
        return np.array([round(float(word[-13:]) * 1e9) for word in words])


@pytest.fixture(scope="module")
def log(simulated: Path) -> Path:
    return simulated / "log.mcap"


@pytest.fixture(scope="module")
def frames(log: Path) -> play_frames.LoggedFrames:
    return play_frames.bus_frames(logs.read(log))


def sent(frames: play_frames.LoggedFrames) -> list[Frame]:
    words = frames.words.tolist()
    return [(w, r[8 : 8 + r[4]].tobytes()) for w, r in zip(words, frames.raw, strict=True)]


def start(log: Path, *words: str) -> subprocess.Popen[str]:
    """Start a player on one processor; vcan has a queue for each: who moves overtakes himself."""
    words = (str(log), "--bus", CHANNEL, "--json", *words)
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "pcpc.tools.cli", "play", *words],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))}),
    )


def ended(process: subprocess.Popen[str], candump: Path) -> Played:
    out, err = process.communicate()
    assert out, f"{process.returncode}, no result: {err}"
    return Played(process.returncode, json.loads(out), err, candump)


@pytest.fixture(scope="module")
def part(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Return the playing of a part of the log, slowed down."""
    candump = tmp_path_factory.mktemp("part") / "candump.log"
    with candump_into(candump):
        process = start(log, *SLOWLY)
        process.wait()
    return ended(process, candump)


@pytest.fixture(scope="module")
def stand_in(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Played:
    """Return the playing of the plant; a stranger's frame comes first, then the executive's."""
    candump = tmp_path_factory.mktemp("stand_in") / "candump.log"
    with candump_into(candump):
        before = listeners(HB_EXEC)
        process = start(log, "--as", "plant", "-r", "0")
        until(
            lambda: listeners(HB_EXEC) > before or process.poll() is not None, "the player listens"
        )
        cansend(STRANGER, b"\x01")
        cansend(HB_EXEC, b"\x7f")
        process.wait()
    return ended(process, candump)


def listeners(can_id: int) -> int:
    """Return how many sockets on vcan0 let in this id by its own filter."""
    with open("/proc/net/can/rcvlist_sff") as receivers:
        words = (line.split() for line in receivers)
        return sum(w[:1] == [CHANNEL] and int(w[1], 16) == can_id for w in words)


def test_candump_hears_the_recording_frame_by_frame(
    part: Played, frames: play_frames.LoggedFrames
) -> None:
    since_s = 1e-9 * (frames.stamp_ns - frames.stamp_ns[0])
    expected = sent(frames.keep((since_s >= BEGIN_S) & (since_s < BEGIN_S + PART_S)))
    assert part.code == 0, part.err
    assert part.heard == expected, f"{len(part.heard)} of {len(expected)} frames heard"
    assert part.result["send_errors"] == 0, part.result


def test_the_error_that_is_reported_is_the_one_on_the_bus(part: Played) -> None:
    heard_ns = int(part.stamps_ns[-1] - part.stamps_ns[0])
    reported_ns = 1e9 * part.result["duration_s"]
    largest_ns = 1e3 * part.result["timing_error_us"]["max"]
    apart_ns = abs(heard_ns - reported_ns)
    assert apart_ns <= largest_ns + SLACK_NS, f"{apart_ns:.0f} ns between candump's time and ours"


def test_the_time_of_the_whole_is_kept(part: Played) -> None:
    error = abs(part.result["total_error_percent"])
    largest = 100e-6 * part.result["timing_error_us"]["max"] / part.result["duration_s"]
    assert error < max(0.1, largest), f"total error {error:.4f} %, of the worst frame {largest:.4f}"


def test_the_player_waits_for_the_node_opposite_and_hears_nobody_else(
    stand_in: Played, frames: play_frames.LoggedFrames
) -> None:
    plant = sent(frames.keep(frames.sent_by("plant")))
    assert stand_in.code == 0, stand_in.err
    expected = [(STRANGER, b"\x01"), (HB_EXEC, b"\x7f"), *plant]
    assert stand_in.heard == expected, f"{len(stand_in.heard)} of {len(expected)} frames heard"


def test_can_utils_own_player_puts_the_same_on_the_bus(part: Played, tmp_path: Path) -> None:
    candump = tmp_path / "candump.log"
    with candump_into(candump):
        subprocess.run(["canplayer", "-I", str(part.candump)], check=True)
    assert frames_in(candump) == part.heard, f"{len(frames_in(candump))} frames heard"

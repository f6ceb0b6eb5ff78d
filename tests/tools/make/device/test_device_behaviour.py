"""What is said of a device's frames, from frames made up: rates, silence, restarts."""

import numpy as np
import pytest
from processes import ROOT

from pcpc.drivers.can.e2e import MAX_DELTA
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.device.behaviour import LATE_SHARE, Behaviour, behaviour, rate_of

RIG = load_rig(ROOT / "plants" / "probe" / "device" / "rig.yaml", resolve=False)
T_NS, N = 1_000_000, 2000
SYNC, CMD, HEARTBEAT = 0x080, 0x0A0, 0x701


def frames_of(can_id: int, cycle: np.ndarray, stamp_ns: np.ndarray) -> np.ndarray:
    found = np.zeros(len(cycle), logs.FRAME)
    found["id"], found["cycle"], found["stamp_ns"], found["direction"] = can_id, cycle, stamp_ns, 1
    return found


def good(cycles: np.ndarray, period_ns: int = T_NS) -> list[np.ndarray]:
    stamps = cycles * period_ns
    beats = frames_of(HEARTBEAT, cycles[::100], stamps[::100])
    beats["data"][:, 0] = 5
    return [frames_of(SYNC, cycles, stamps), frames_of(CMD, cycles, stamps), beats]


def judged(frames: list[np.ndarray], pacing: str) -> Behaviour:
    cycle = np.arange(N)
    node = logs.NodeLog(cycle, cycle * T_NS, {}, {}, np.concatenate(frames), [], [], {})
    return behaviour(RIG, logs.Log(ROOT, {"plant": node}, {}, {}, []), pacing)


@pytest.mark.parametrize("pacing", ["real", "sync", "lockstep"])
def test_nothing_is_said_of_a_good_device(pacing: str) -> None:
    assert judged(good(np.arange(N)), pacing).problems == []


@pytest.mark.parametrize("hz", [500.0, 985.0, 1015.0, 1100.0])
def test_another_rate_is_named(hz: float) -> None:
    stamps = (np.arange(N) * 1e9 / hz).astype(np.int64)
    own = good(np.arange(N))
    own[0] = frames_of(SYNC, np.arange(N), stamps)
    said = judged(own, "sync").problems
    assert said == [f"device: its cycle is {hz:.4g} Hz, the rig's is 1000 Hz"]


@pytest.mark.parametrize("hz", [800.0, 1000.0, 1100.0])
def test_a_rate_is_told_from_stamps_of_another_clock(hz: float) -> None:
    came = (np.arange(N) * 1e9 / hz).astype(np.int64)
    seen = -(-came // T_NS) * T_NS
    assert rate_of(seen) == pytest.approx(hz, rel=0.003)


def test_stalls_that_are_caught_up_and_silence_change_no_rate() -> None:
    stamps = np.arange(N) * T_NS
    for begin in range(100, N, 200):
        stamps[begin : begin + 15] = stamps[begin + 15]
    assert rate_of(stamps) == pytest.approx(1000.0, rel=0.005)
    silent = np.arange(N) * T_NS
    silent[1500:] += 300 * T_NS
    assert rate_of(silent) == pytest.approx(1000.0, rel=0.005)


def test_a_silence_is_told_with_its_length_and_end() -> None:
    cycles = np.arange(N)
    own = good(cycles[(cycles < 300) | (cycles >= 520)])
    said = [line for line in judged(own, "real").problems if "silent" in line]
    assert said == ["device: CMD: silent for 220 cycles (0.22 s) from 0.3 s on"]
    said = [line for line in judged(good(cycles[:1700]), "real").problems if "silent" in line]
    assert said == ["device: CMD: silent for 300 cycles (0.3 s) from 1.7 s on, to the end"]


def test_single_late_cycles_are_excused_by_a_clock_only() -> None:
    cycles = np.arange(N)
    late = np.arange(10, 10 + 20 * (MAX_DELTA - 1), 20)
    own = good(cycles)
    own[1] = own[1][~np.isin(cycles, late)]
    assert len(late) < LATE_SHARE * N
    found = judged(own, "sync")
    assert found.problems == [] and found.late_cycles == len(late)
    assert judged(own, "lockstep").problems == [
        f"device: CMD: late in {len(late)} of {N - 1:,} cycles, first in cycle 10 (0.01 s)"
    ]


def test_a_greeting_after_work_is_a_restart() -> None:
    own = good(np.arange(N))
    own[2]["data"][7, 0] = 127
    said = judged(own, "real").problems
    assert said == ["device: restarted, its heartbeat begins again in cycle 700 (0.7 s)"]
    own[2]["data"][:, 0] = 127
    assert judged(own, "real").problems == []

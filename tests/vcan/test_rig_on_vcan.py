"""One rig on a real vcan0, in real processes: as users, candump, cantools and python-can see it."""

import itertools
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import cantools
import numpy as np
import pytest
from cantools.database.can import Database
from live import (
    CMD,
    DBC,
    FB_A,
    N_CORRUPT,
    N_HEARD,
    PATIENCE_S,
    Done,
    Frame,
    Observed,
    Pair,
    crc8_j1850,
)

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.log import reader as logs

pytestmark = pytest.mark.vcan

SENT, RECEIVED = 0, 1
PROTECTED = {"sequence", "counter"}  # what counts, beside `crc`


@pytest.fixture(scope="module")
def database() -> Database:
    loaded = cantools.database.load_file(DBC)
    assert isinstance(loaded, Database)
    return loaded


def frames_of(log: logs.Log, node: str, direction: int) -> list[Frame]:
    rows = log.node[node].frames
    return [
        (int(row["id"]), row["data"][: row["dlc"]].tobytes())
        for row in rows[rows["direction"] == direction]
    ]


def place_of(part: Sequence[Frame], whole: Sequence[Frame]) -> int:
    """Return where `part` stands in `whole` without a gap, -1 if nowhere."""
    starts = (i for i in range(len(whole) - len(part) + 1) if whole[i] == part[0])
    return next((i for i in starts if whole[i : i + len(part)] == part), -1)


def by_id(frames: Sequence[Frame]) -> Iterator[tuple[int, list[bytes]]]:
    ordered = sorted(frames, key=lambda frame: frame[0])  # stable: the order of the bus is kept
    for can_id, group in itertools.groupby(ordered, key=lambda frame: frame[0]):
        yield can_id, [data for _, data in group]


@pytest.mark.parametrize("topic", ["/state", "/plant/state"])
def test_lockstep_on_vcan0_equals_virtual_time_bit_for_bit(
    lockstep: Observed, simulated: Path, topic: str
) -> None:
    assert lockstep.run.code == 0, f"{lockstep.run}"
    on_bus = logs.payloads(lockstep.run.folder / "log.mcap", topic)
    virtual = logs.payloads(simulated / "log.mcap", topic)
    differ = [k for k, pair in enumerate(zip(on_bus, virtual, strict=False)) if len(set(pair)) > 1]
    assert len(on_bus) == len(virtual) > 999, f"{len(on_bus)} messages, virtual {len(virtual)}"
    assert not differ, f"{len(differ)} messages differ, first {differ[0]}"


def test_nothing_is_lost_in_lockstep(lockstep: Observed) -> None:
    summary = lockstep.run.summary
    assert summary["bus"] == "socketcan:vcan0", f"{summary['bus']}"
    wrong = {key: summary["frames"][key] for key in ("lost", "stale", "crc_errors", "repeated")}
    assert not any(wrong.values()) and summary["verdict"] == "ok", f"{lockstep.run}"


@pytest.mark.parametrize("sender", ["executive", "plant"])
def test_candump_saw_what_the_log_says_was_sent(
    lockstep: Observed, database: Database, sender: str
) -> None:
    node = {"executive": "EXEC", "plant": "PLANT"}[sender]
    ids = {message.frame_id for message in database.messages if node in message.senders}
    seen = [frame for frame in lockstep.frames if frame[0] in ids]
    sent = frames_of(lockstep.run.log, sender, SENT)
    # A node greets until the other one is there; without a clock the log has one greeting of all.
    seen = seen[greetings(seen) - greetings(sent) :]
    differ = [i for i, pair in enumerate(zip(seen, sent, strict=False)) if pair[0] != pair[1]]
    assert not differ, f"frame {differ[0]}: {seen[differ[0]]} seen, {sent[differ[0]]} sent"
    assert len(seen) == len(sent) > 2000, f"{len(seen)} frames seen, {len(sent)} sent"


def greetings(frames: list[Frame]) -> int:
    """Return how often the first frame, a heartbeat, stands at the start."""
    assert 0x700 <= frames[0][0] < 0x780, f"{frames[0]}"
    return sum(1 for _ in itertools.takewhile(lambda frame: frame == frames[0], frames))


@pytest.mark.parametrize("receiver", ["executive", "plant"])
def test_a_node_received_what_candump_saw_without_a_gap(
    lockstep: Observed, database: Database, receiver: str
) -> None:
    node = {"executive": "EXEC", "plant": "PLANT"}[receiver]
    ids = {m.frame_id for m in database.messages if node in m.receivers}
    seen = [frame for frame in lockstep.frames if frame[0] in ids]
    received = frames_of(lockstep.run.log, receiver, RECEIVED)
    assert len(received) > 2000, f"{len(received)} frames received"
    assert place_of(received, seen) >= 0, f"{len(received)} received, {len(seen)} seen"


def test_every_protected_frame_has_its_crc_and_the_next_counter(
    lockstep: Observed, database: Database
) -> None:
    checked = 0
    for can_id, datas in by_id(lockstep.frames):
        message = database.get_message_by_frame_id(can_id)
        counts = [signal for signal in message.signals if signal.name in PROTECTED]
        if not counts:
            continue
        head = can_id.to_bytes(2, "little")
        wrong = [i for i, data in enumerate(datas) if crc8_j1850(head + data[:-1]) != data[-1]]
        assert not wrong, f"{message.name}: {len(wrong)} wrong CRCs, first in frame {wrong[0]}"
        start, modulo = counts[0].start, 1 << counts[0].length
        numbers = [(int.from_bytes(data, "little") >> start) % modulo for data in datas]
        steps = {(after - before) % modulo for before, after in itertools.pairwise(numbers)}
        assert steps == {1}, f"{message.name}: the counter steps by {steps}"
        checked += len(datas)
    assert checked > 5000, f"{checked} protected frames"


def test_python_can_reads_the_bus_beside_the_loop(lockstep: Observed) -> None:
    seen = [frame for frame in lockstep.frames if frame[0] in (CMD, FB_A)]
    assert len(lockstep.python_can) == N_HEARD, f"{len(lockstep.python_can)} frames"
    assert lockstep.python_can == seen[:N_HEARD], "python-can and candump differ"


def test_auto_is_vcan0(real: Done) -> None:
    assert real.summary.get("bus") == "socketcan:vcan0", f"{real}"


@pytest.mark.parametrize("pacing", ["real", "sync"])
def test_a_paced_run_loses_nothing(real: Done, sync: Pair, pacing: str) -> None:
    run = real if pacing == "real" else sync.executive
    assert sync.plant.code == 0, f"{sync.plant}"
    summary = run.summary
    strangers = N_CORRUPT if pacing == "real" else 0  # whose frames cost the run its ok
    wanted = (3, "loss") if strangers else (0, "ok")
    assert (run.code, summary["verdict"]) == wanted and summary["pacing"] == pacing, f"{run}"
    assert summary["frames"]["foreign"] == strangers, f"{run}"
    frames = {key: summary["frames"][key] for key in ("lost", "stale", "repeated")}
    assert frames == dict.fromkeys(frames, 0), f"{frames}"
    assert summary["cycles"] == 125, f"{summary['cycles']} cycles"
    assert set(run.log.node) == {"executive", "plant"}, f"{list(run.log.node)} in the log"


def test_a_clean_run_has_no_crc_errors(sync: Pair) -> None:
    assert sync.executive.summary["frames"]["crc_errors"] == 0, f"{sync.executive}"
    assert sync.plant.code == 0, f"{sync.plant}"


def test_corrupt_feedback_is_counted_and_the_run_goes_on(real: Done) -> None:
    executive = real.log.node["executive"]
    errors = executive.frames[executive.frames["e2e"] == FrameState.ERROR]
    assert set(errors["id"]) == {FB_A} and len(errors) == N_CORRUPT, f"{errors}"
    counted = real.summary["frames"]["crc_errors"]
    assert counted == N_CORRUPT, f"{counted} counted"
    after = executive.columns["supervisor.state"][executive.cycle > errors["cycle"].max()]
    assert len(after) > 0 and np.isin(after, [2.0, 3.0]).all(), f"states {after} after the last"


def test_cantools_decodes_every_line_of_candump(
    lockstep: Observed, decoding: tuple[subprocess.Popen[str], Path], database: Database
) -> None:
    process, decoded = decoding
    assert process.wait(PATIENCE_S) == 0, f"exit code {process.returncode}"
    names = [line.split(" :: ")[1].partition("(")[0] for line in decoded.read_text().splitlines()]
    expected = [database.get_message_by_frame_id(can_id).name for can_id, _ in lockstep.frames]
    assert names == expected, f"{len(names)} of {len(expected)} frames decoded"


def test_one_of_two_executives_is_refused(sync: Pair) -> None:
    refused = sync.refused
    assert (sync.executive.code, refused.code) == (0, 4), f"{sync.executive}\n{refused}"
    assert f"already in use by process {sync.executive_pid};" in refused.err, f"{refused}"
    assert not refused.folder.exists(), "a refused run leaves a folder"


def test_a_missing_interface_is_named_with_the_cure(vcan7: Done) -> None:
    assert vcan7.code == 4, f"{vcan7}"
    assert "vcan7: no such interface; create it with" in vcan7.err, f"{vcan7}"
    assert "Traceback" not in vcan7.err, f"{vcan7}"

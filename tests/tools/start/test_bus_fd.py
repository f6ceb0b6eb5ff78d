"""`pcpc bus` and the emulated line for the frames of nine drives on CAN FD, 1 and 5 Mbit/s, 1 kHz.

One command of 48 bytes for all, and an answer of 12 bytes of each: SYNC 87 us, CMD 137 us, nine
answers of 64 us each, 0.8 ms of a cycle. 64 bytes each way for each would take 3 ms.
"""

from pathlib import Path

import pytest
from fd_rig import fd_rig
from json_schemas import holds

from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.cli import main
from pcpc.tools.start.bus import traffic
from pcpc.tools.start.bus.traffic import Setup

DRIVES = 9
BUS = "bus: {emulate: 1 Mbit/s, data_bitrate: 5000000, queue: 64}"
_SIGNAL = ' SG_ position : 0|32@1- (1e-06,0) [-2147.483648|2147.483647] "" EXEC\n'


def nine_drives(folder: Path, size: int) -> Path:
    """Write a rig with an answer of `size` bytes, 12 or 64, of each of nine drives."""
    ids = [289 + k for k in range(DRIVES - 1)]
    frames = "".join(f"BO_ {i} FB{i - 287}: {size} PLANT\n{_SIGNAL}\n" for i in ids)
    attributes = "".join(
        f'BA_ "{name}" BO_ {i} {value};\n'
        for i in ids
        for name, value in (("VFrameFormat", 14), ("GenMsgCycleTime", 1), ("GenMsgSendType", 0))
    )
    changes = (
        ("BO_ 1793 HB_EXEC", f"{frames}BO_ 1793 HB_EXEC"),
        ('BA_ "VFrameFormat" BO_ 128 14;', f'{attributes}BA_ "VFrameFormat" BO_ 128 14;'),
        *(
            (
                ("BO_ 288 FB: 64", "BO_ 288 FB: 12"),
                (" SG_ position : 407|32@0-", " SG_ position : 0|32@1-"),
                (" SG_ crc : 504|8@1+", " SG_ crc : 88|8@1+"),
            )
            if size == 12
            else ()
        ),
    )
    transmit = "".join(f", FB{i - 287}.position: lag.position" for i in ids)
    sent = f"plant: {{transmit: {{FB.position: lag.position{transmit}}}}}"
    return fd_rig(folder, BUS, sent, changes=changes)


def rows_of(rig: Rig) -> list[traffic.FrameBounds]:
    (frames,) = traffic.buses(rig)
    return traffic.response_rows(frames, Setup(1000.0, 1_000_000, 5_000_000))


def test_nine_drives_fit_and_their_line_loses_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = nine_drives(tmp_path, 12)
    assert main(["bus", str(path), "--json"]) == 0
    (bus,) = holds("bus", capsys.readouterr().out)["buses"]
    assert bus["fits"] and 0.7 < bus["load"] < 0.9, bus["load"]
    rig = load_rig(path, None, ["duration_s=1.0"])
    run = VirtualRun(rig, None)
    for _ in run.advance():
        pass
    line = run.over[0]
    assert (line.refused.sum(), line.lost_off.sum(), line.waiting.sum()) == (0, 0, 0)
    assert line.sent[1] >= DRIVES * 1000
    assert 0.9 * bus["load"] < line.busy / (line.free_at - line.first) <= bus["load"]
    worst_ns = max(row.response_ns or 0 for row in rows_of(rig))
    longest_ns = 1e9 * int(line.longest.max()) / int(line.per_s)
    assert 0.8 * worst_ns < longest_ns <= worst_ns, f"{longest_ns} ns, bound {worst_ns} ns"


def test_nine_times_64_bytes_do_not_fit_and_their_line_loses_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = nine_drives(tmp_path, 64)
    assert main(["bus", str(path)]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert "fits not: FB" in told and "may still wait when its next one comes" in told, told
    assert main(["bus", str(path), "--rate", "500"]) == 0, "at 500 Hz they do"
    run = VirtualRun(load_rig(path, None, ["duration_s=0.5", "rate_hz=1000"]), None)
    for _ in run.advance():
        pass
    assert run.over[0].refused[1] > 100

"""The frames of drives in `pcpc bus`, against the emulated line, and their names in a log."""

import json
import shutil
from pathlib import Path

import pytest
from many import drives
from places import ROOT

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import VirtualRun, in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.start.bus import traffic

ROBOTS = Path(__file__).parents[1] / "robots"
TEMPLATES = ROOT / "tools/make/template"


def test_no_frame_on_the_line_is_later_than_its_bound(tmp_path: Path) -> None:
    """Nine drives: up to 281 Hz each frame is there in its cycle; the line has no more load."""
    rig = load_rig(drives(tmp_path, 9), settings=["rate_hz=250", "bus.emulate=1M"])
    setup = traffic.Setup(250.0, 1_000_000)
    (frames,) = traffic.buses(rig)
    rows = {row.sent.frame.can_id: row for row in traffic.response_rows(frames, setup)}
    assert {0x080, 0x185, 0x18D, 0x485, 0x505, 0x705, 0x70D, 0x748} <= rows.keys()
    assert traffic.fits(list(rows.values())) and not any(row.held for row in rows.values())
    run = VirtualRun(rig, None)
    for _ in run.advance():
        pass
    line = run.over[0]
    load = sum(row.transmission_ns / row.period_ns for row in rows.values())
    assert 0.4 * load < int(line.busy) / int(line.free_at - line.first) < load, load
    longest = max(row.response_ns or 0 for row in rows.values())
    assert 0.3 * longest < 1e3 * int(line.longest.max()) <= longest
    log = run.memory.log()
    assert log.node["executive"].columns["supervisor.missing_cycles"].max() == 0.0
    at_600 = load_rig(drives(tmp_path, 9), settings=["rate_hz=600", "bus.emulate=1M"])
    assert not traffic.fits(
        traffic.response_rows(*traffic.buses(at_600), traffic.Setup(6e2, 10**6))
    )
    assert in_memory(at_600).node["executive"].columns["supervisor.missing_cycles"].max() > 0.0


@pytest.mark.parametrize(
    ("rig", "own"),
    [
        ("cia402", {"TPDO1 5": 1, "heartbeat 5": 100}),
        ("odrive", {"heartbeat 0": 100, "encoder 0": 10}),
        ("mit", {"feedback 1": 1}),
        ("robstride", {"feedback 1": 1}),
    ],
)
def test_a_drive_s_own_frames_are_counted(
    rig: str, own: dict[str, int], capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(TEMPLATES / f"drive_{rig}.yaml")
    assert main(["bus", file, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["buses"][0]["frames"]
    found = {row["name"]: round(row["period_us"] / 1000) for row in rows}
    assert own.items() <= found.items(), found
    assert main(["bus", file]) == 0 and "SDOs, EMCY" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "inhibit", "period_ms"), [(3, 0, 3), (240, 500, 240), (254, 0, 1), (255, 500, 50)]
)
def test_a_tpdo_comes_with_each_nth_sync_or_after_its_inhibit_time(
    kind: int, inhibit: int, period_ms: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (TEMPLATES / "drive_cia402.yaml").read_text()
    objects = f'objects: {{"1800.2": {kind}, "1800.3": {inhibit}, '
    shutil.copytree(TEMPLATES, tmp_path / "rigs")
    file = tmp_path / "rigs/drive_cia402.yaml"
    file.write_text(text.replace("objects: {", objects))
    assert main(["bus", str(file), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["buses"][0]["frames"]
    assert [row["period_us"] for row in rows if row["name"] == "TPDO1 5"] == [1e3 * period_ms]


def test_a_log_names_them_but_for_those_of_the_dbc_file() -> None:
    log = in_memory(load_rig(Path(__file__).parent / "mastered.yaml", settings=["duration_s=0.01"]))
    names = logs.frame_names(log)
    assert names[0x705] == "heartbeat 5" and names[0x585] == "SDO answer 5" and names[0] == "NMT"
    assert names[0x485] == "TPDO4" and names[0x185] == "TPDO1 5"
    for rig, number, name in (("odrive", 0xC2, "estop 6"), ("mit", 0x101, "position 1")):
        names = logs.frame_names(
            in_memory(load_rig(ROBOTS / f"{rig}.yaml", settings=["duration_s=0.01"]))
        )
        assert names[number] == name, names

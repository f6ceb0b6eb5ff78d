"""`pcpc bus`: what it says of a rig's frames, and who else warns of what it finds."""

from collections.abc import Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import pytest
from json_schemas import holds
from places import ROOT
from processes import own_bus, pcpc

from pcpc.drivers.can import dbc
from pcpc.drivers.can.frame_bits import fd_bits
from pcpc.executive.rig.bus_load import bus_load
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.start.bus import figure, traffic
from pcpc.tools.start.bus.traffic import SentFrame, Setup

HULL = str(ROOT / "plants/atb1000/rigs/hull.yaml")
RELAY = ROOT / "tests/executive/relay/rig.yaml"
Screen = pytest.CaptureFixture[str]


# ----------------------------------------------------------------------------------- a rig's frames


def frames_of(rig: str | Path, *settings: str) -> list[list[SentFrame]]:
    return traffic.buses(load_rig(rig, None, settings, resolve=False))


def names(frames: Sequence[SentFrame]) -> list[str]:
    return [sent.frame.name for sent in frames]


def test_the_frames_of_each_bus_stand_by_priority() -> None:
    (hull,) = frames_of(HULL)
    assert [sent.frame.can_id for sent in hull] == sorted(sent.frame.can_id for sent in hull)
    assert names(hull)[:3] == ["SYNC", "CMD", "FB_A"]
    above, below = frames_of(RELAY)
    assert sorted(names(below)) == ["CMD", "FB", "HB_PLANT", "SYNC_LOCAL"]
    assert not set(names(above)) & set(names(below))


def test_xcp_has_a_row_an_id_however_many_frames_it_may_send(capsys: Screen) -> None:
    settings = "xcp={frames: 640}", "rate_hz=25"
    (hull,) = frames_of(HULL, *settings)
    assert names(hull)[-4:] == ["XCP x160", "XCP x640"] * 2
    words = [part for one in settings for part in ("--set", one)]
    assert main(["bus", HULL, *words]) == 0
    assert "0x7C3  XCP x640  PLANT" in capsys.readouterr().out
    rows = traffic.response_rows(hull, Setup(25.0, 1_000_000))
    responses_ns = [row.response_ns or 0 for row in rows[-4:]]
    for row, response_ns, above_ns in zip(rows[-3:], responses_ns[1:], responses_ns, strict=False):
        assert response_ns - above_ns >= (row.sent.count - 1) * row.transmission_ns, row


def test_of_equal_first_bits_the_11_bit_id_wins() -> None:
    def priority(can_id: int, extended: bool) -> tuple[int, bool, int]:
        frame = dbc.Frame("F", can_id, extended, 8, 0.0, False, False, (0, 0, 0), (), "")
        return SentFrame(frame, "").priority

    ids = [(0x080, False), (0x080 << 18, True), (0x080 << 18 | 5, True), (0x081, False)]
    assert [priority(*one) for one in ids] == sorted(priority(*one) for one in ids)


@pytest.mark.parametrize(
    ("settings", "frame", "share"),
    [
        ((), "CMD", 0.5), ((), "SYNC", 0.5), ((), "FB_A", 0.5), ((), "REF", 1.0),
        (("realtime.plant.phase=0.4",), "CMD", 0.4), (("realtime.plant.phase=0.4",), "FB_A", 0.6),
        (("realtime.plant.phase=0.0",), "CMD", 1.0), (("pacing=sync",), "FB_A", 0.5),
        (("pacing=lockstep",), "CMD", 1.0),
    ],
)  # fmt: skip
def test_a_frame_of_every_cycle_is_needed_by_its_receivers_next_one(
    settings: tuple[str, ...], frame: str, share: float
) -> None:
    (hull,) = frames_of(HULL, *settings)
    (found,) = (sent.wanted for sent in hull if sent.frame.name == frame)
    assert found == pytest.approx(share, abs=1e-12)


@pytest.mark.parametrize("rig", [HULL, RELAY], ids=["hull", "relay"])
def test_the_load_is_that_of_the_check(rig: str | Path) -> None:
    loaded = load_rig(rig, resolve=False)
    setup = Setup(loaded.config.rate_hz, 1_000_000)
    loads = [traffic.load(traffic.response_rows(bus, setup)) for bus in traffic.buses(loaded)]
    wanted = bus_load(loaded, dbc.load(loaded.dbc), loaded.config.rate_hz, 1e6)
    assert max(loads) == pytest.approx(wanted, rel=1e-12), loads


@pytest.mark.parametrize(
    ("good", "data_bitrate"), [*product([traffic.fits, traffic.in_time], [None, 2_000_000])]
)
def test_the_limits_are_the_last_that_hold(good: traffic.Good, data_bitrate: int | None) -> None:
    (hull,) = frames_of(HULL)
    setup = Setup(500.0, 500_000, data_bitrate)

    def holds(**changed: float) -> bool:
        return good(traffic.response_rows(hull, Setup(**{**vars(setup), **changed})))

    hz, bitrate = traffic.highest_hz(hull, setup, good), traffic.lowest_bitrate(hull, setup, good)
    assert bitrate is not None
    assert holds(rate_hz=float(hz)) and not holds(rate_hz=hz + 1.0), f"{hz} Hz"
    assert holds(bitrate=bitrate) and not holds(bitrate=bitrate - 1000), f"{bitrate} bit/s"
    assert (hz, bitrate) != (500, 500_000)


def test_where_nothing_holds_the_limits_say_so() -> None:
    (hull,) = frames_of(HULL)
    assert traffic.lowest_bitrate(hull, Setup(5000.0, 1_000_000), traffic.fits) is None
    assert traffic.highest_hz(hull, Setup(500.0, 1000), traffic.fits) == 0
    alone = [sent for sent in hull if sent.frame.name == "SYNC"]
    assert traffic.highest_hz(alone, Setup(1.0, 10**9), traffic.in_time) == traffic.MOST_HZ


# -------------------------------------------------------------------------------------- the command


def report(screen: Screen, *words: str, code: int = 0) -> dict[str, Any]:
    given = main(["bus", *words, "--json"])
    out, err = screen.readouterr()
    assert (given, err) == (code, ""), err
    found: dict[str, Any] = holds("bus", out)
    return found


def test_the_table_has_a_line_for_each_frame_by_priority(capsys: Screen) -> None:
    assert main(["bus", HULL]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if len(line) > 80] == []
    words = [line.split() for line in lines]
    assert lines[0] == "hull at 1000 Hz, bus at 1 Mbit/s (of the rig), classic CAN"
    assert words[3] == ["0x080", "SYNC", "EXEC", "2", "75", "1000", "75", "210", "500", "290"]
    assert words[7] == ["0x122", "FB_C", "PLANT", "8", "135", "1000", "135", "540", "500", "-40"]
    text = " ".join(" ".join(lines).split())
    for said in (
        "load 67.4%",
        "(up to 1333 Hz; at 1000 Hz from 750 kbit/s on)",
        "held FB_C may miss the receiver's cycle",
        "(none up to 925 Hz; at 1000 Hz at no CAN bit rate)",
    ):
        assert said in text, text


def test_where_no_rate_is_slow_enough_it_says_so(capsys: Screen) -> None:
    assert main(["bus", HULL, "--set", "rate_hz=1", "--jitter", "900ms"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "uses the previous frame (at any rate; at 1 Hz at no CAN bit rate)" in out, out


def test_each_bus_of_three_nodes_has_its_own_table_and_bit_rate(capsys: Screen) -> None:
    local = "local.bus={interface: udp_multicast, channel: '239.74.163.2:43999', bitrate: 500000}"
    above, below = report(capsys, str(RELAY), "--set", local)["buses"]
    assert (above["name"], below["name"]) == ("bus", "local bus")
    assert (above["bitrate"], below["bitrate"]) == (1_000_000, 500_000)
    assert {frame["name"] for frame in below["frames"]} == {"CMD", "FB", "HB_PLANT", "SYNC_LOCAL"}


def test_as_can_fd_the_data_travel_faster(capsys: Screen) -> None:
    (bus,) = report(capsys, HULL, "--rate", "2kHz", "--data-bitrate", "4M")["buses"]
    frame = bus["frames"][1]
    assert (frame["bits"], frame["data_bits"]) == fd_bits(8)
    assert frame["transmission_us"] == frame["bits"] + frame["data_bits"] / 4
    assert frame["period_us"] == 500.0 and bus["fits"], bus
    (classic,) = report(capsys, HULL, "--rate", "2kHz", code=1)["buses"]
    assert not classic["fits"] and classic["frames"][-1]["response_us"] is None


def test_jitter_and_errors_are_told_and_count(capsys: Screen) -> None:
    (plain,) = report(capsys, HULL)["buses"]
    (worse,) = report(capsys, HULL, "--jitter", "20us", "--error-every", "1s")["buses"]
    first, disturbed = plain["frames"][0], worse["frames"][0]
    assert disturbed["response_us"] == first["response_us"] + 20 + 31 + first["transmission_us"]
    assert main(["bus", HULL, "--jitter", "20us", "--error-every", "1s"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "jitter 20 us each, a bus error every 1000 ms" in out, out


def test_without_a_common_clock_the_response_times_are_those_of_any_phases(capsys: Screen) -> None:
    (kept,) = report(capsys, HULL)["buses"]
    (drifting,) = report(capsys, HULL, "--any-phase")["buses"]
    found = {frame["name"]: frame for frame in drifting["frames"]}
    assert (found["FB_C"]["response_us"], found["FB_C"]["deadline_us"]) == (750.0, 1000.0)
    assert found["CMD"]["response_us"] == 135 + 75 + 135, "one lower frame, SYNC, its own"
    assert (kept["phases_kept"], drifting["phases_kept"]) == (True, False)
    (sync,) = report(capsys, HULL, "--set", "pacing=sync")["buses"]
    assert [frame["response_us"] for frame in sync["frames"]] == [
        frame["response_us"] for frame in drifting["frames"]
    ]


def test_in_the_order_of_the_loop_slow_frames_are_ahead_of_the_command(capsys: Screen) -> None:
    (bus,) = report(capsys, HULL, "--in-order", "--rate", "500")["buses"]
    found = {frame["name"]: frame["response_us"] for frame in bus["frames"]}
    slow = 5 * 135 + 65
    assert found["CMD"] == slow + 135, "all slow frames, itself; the plant's are long gone"
    assert found["SYNC"] == found["CMD"] + 75, "the last of a cycle"
    (bus,) = report(capsys, HULL, "--in-order", code=1)["buses"]
    assert not bus["fits"] and not bus["in_time"], bus
    assert main(["bus", HULL, "--in-order"]) == 1
    out = capsys.readouterr().out
    assert "frames of a node in the order of its" in out, out
    assert [line for line in out.splitlines() if len(line) > 80] == []


@pytest.mark.parametrize("setup", [Setup(1000.0, 10**6), Setup(500.0, 10**6, in_order=True)])
def test_the_drawn_frames_are_there_by_their_worst_case(setup: Setup) -> None:
    (hull,) = frames_of(HULL)
    rows = traffic.response_rows(hull, setup)
    drawn = figure.arbitration(*traffic.queue_of(hull, setup))
    assert all(before[3] <= after[2] for before, after in pairwise(drawn)), "one at a time"
    assert {hull[m].frame.name for m, *_ in drawn} == set(names(hull))
    for m, due, begun, ended in drawn:
        most = rows[m].response_ns
        assert due <= begun and most is not None, hull[m]
        assert ended - due <= most, f"{hull[m].frame.name}: {ended - due} ns, bound {most} ns"


def test_the_fullest_cycle_is_drawn(tmp_path: Path, capsys: Screen) -> None:
    picture = tmp_path / "bus.png"
    assert main(["bus", str(RELAY), "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 10_000
    capsys.readouterr()
    assert main(["bus", HULL, "--plot", str(tmp_path / "bus.txt")]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "bus.txt: not a picture; expected" in err, err
    assert main(["bus", HULL, "--plot", str(tmp_path / "none" / "bus.png")]) == 2
    assert f"bus.png: there is no folder {tmp_path / 'none'}" in capsys.readouterr().err


def test_a_rig_without_a_bit_rate_is_judged_at_the_highest(capsys: Screen) -> None:
    (bus,) = report(capsys, "probe")["buses"]
    assert (bus["bitrate"], bus["bitrate_from"]) == (1_000_000, "assumed, the rig names none")
    (bus,) = report(capsys, "probe", "--bitrate", "500 kbit/s")["buses"]
    assert (bus["bitrate"], bus["bitrate_from"]) == (500_000, "--bitrate")


def test_what_is_wrong_in_a_dbc_file_is_told_with_its_name(tmp_path: Path, capsys: Screen) -> None:
    text = (ROOT / "plants/probe/probe.dbc").read_text().replace("BO_ 288 FB: 8", "BO_ 288 FB: 64")
    for name in ("rig.yaml", "law.py", "model.py"):
        (tmp_path / name).write_text((ROOT / "plants/probe" / name).read_text())
    (tmp_path / "probe.dbc").write_text(text)
    assert main(["bus", str(tmp_path / "rig.yaml")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and f"{tmp_path}/probe.dbc: frame FB: 64 bytes" in err, err


# ----------------------------------------------------------------------------------------- warnings


TIGHT = "bus.bitrate=700000"  # load 96 %: FB_C may wait when the next one comes


@pytest.mark.parametrize(
    ("settings", "warns"),
    [((), False), ((TIGHT,), True), (("bus.bitrate=null",), False),
     ((TIGHT, "rate_hz=933"), False), ((TIGHT, "rate_hz=934"), True),
     ((TIGHT, "rate_hz=1050"), False)],  # more than 100 %: refused
)  # fmt: skip
def test_a_rig_that_does_not_fit_its_bus_is_warned_of(
    settings: tuple[str, ...], warns: bool
) -> None:
    rig = load_rig(HULL, None, settings, resolve=False)
    for pacing in ("real", "sync"):
        said = traffic.warning(rig, pacing)
        assert bool(said) == warns, said
    assert traffic.warning(rig, "lockstep") == ""


def test_check_and_run_tell_it_in_a_line(tmp_path: Path, capsys: Screen) -> None:
    wanted = "FB_C may take 1071.43 us on a bus of 700000 bit/s, its period is 1000 us"
    assert main(["check", HULL, "--set", TIGHT]) == 0
    assert wanted in " ".join(capsys.readouterr().out.split())
    done = pcpc(
        "run",
        HULL,
        "-o",
        str(tmp_path / "run"),
        "--bus",
        own_bus(),
        "--no-figure",
        "--set",
        TIGHT,
        "--set",
        "duration_s=0.1",
    )
    assert sum(wanted in line for line in done.err.splitlines()) == 1, str(done)

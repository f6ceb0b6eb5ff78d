"""`pcpc bus emulate`: what it says at its end, how it ends, what it refuses."""

import json
import os
import signal
import subprocess
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import can
import pytest
from fd_rig import fd_rig
from json_schemas import holds
from processes import DEADLINE_S, PATIENT, PCPC, own_bus, pcpc, until

from pcpc.drivers.can import bus as buses
from pcpc.executive.errors import RigError
from pcpc.tools.cli import main
from pcpc.tools.start.bus import run_line as line
from pcpc.tools.start.bus.emulate import BusErrors
from pcpc.tools.start.children import Child

ROBSTRIDE = Path(__file__).parents[2] / "drivers/robots/robstride.yaml"
Screen = pytest.CaptureFixture[str]


def test_errors_are_given_in_any_order() -> None:
    assert BusErrors.from_text("seed=7, p=1e-5") == BusErrors(1e-5, 1.0, 7)
    assert BusErrors.from_text(None) == BusErrors()
    with pytest.raises(RigError, match="seed=-1"):
        BusErrors.from_text("seed=-1")


def port(text: str) -> can.BusABC:
    _, channel = buses.parse(text)
    group, number = buses.udp_address(str(channel))
    return can.Bus(group, interface="udp_multicast", port=number)


def test_python_can_programs_meet_over_the_line_and_the_end_tells_of_all() -> None:
    first = own_bus()
    sides = [first, str(buses.neighbour_of(buses.bus_named(*buses.parse(first))))]
    words = [PCPC, "bus", "emulate", *sides, "--bitrate", "125k", "--json", "--errors", "p=1e-4"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as gateway:
        assert gateway.stderr is not None
        for said in gateway.stderr:
            if "are one line of 125 kbit/s" in said:
                break
        with port(sides[0]) as a, port(sides[1]) as b:
            for k in range(50):
                a.send(can.Message(arbitration_id=0x100 + k, data=[k] * 8, is_extended_id=False))
                heard = b.recv(DEADLINE_S)
                assert heard is not None and heard.arbitration_id == 0x100 + k
        gateway.send_signal(signal.SIGINT)
        out, _ = gateway.communicate(timeout=DEADLINE_S)
    assert gateway.returncode == 130
    found: dict[str, Any] = holds("bus emulate", out)
    assert [side["sent"] for side in found["sides"]] == [50, 0]
    assert found["bitrate"] == 125_000 and found["not_taken"] == 0
    assert found["sides"][0]["longest_us"] >= 8 * 108 and found["sides"][0]["lost_off"] == 0
    assert 0.0 < found["load"] <= 1.0


def test_a_side_of_another_bit_rate_is_not_heard_and_told() -> None:
    first = own_bus()
    sides = [first, str(buses.neighbour_of(buses.bus_named(*buses.parse(first))))]
    rates = ["--bitrate", "500k", "--bitrate-b", "250k", "--for", "2s"]
    with subprocess.Popen(
        [PCPC, "bus", "emulate", *sides, *rates],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as gateway:  # fmt: skip
        assert gateway.stderr is not None
        for said in gateway.stderr:
            if "are one line of 500 kbit/s" in said:
                break
        with port(sides[0]) as a, port(sides[1]) as b:
            a.send(can.Message(arbitration_id=0x123, data=[1], is_extended_id=False))
            out, _ = gateway.communicate(timeout=DEADLINE_S)
            assert b.recv(0.0) is None
    assert gateway.returncode == 3, out
    said = f"line: {sides[1]} has a bit rate of 250 kbit/s, the line 500 kbit/s"
    assert said in " ".join(out.split()) and "1 times bus-off" in out, out


@pytest.mark.parametrize(("rate", "said"), [
    ("2M", "--bitrate-b 2 Mbit/s: classic CAN ends at 1 Mbit/s"),
    ("999983", "--bitrate-b: no clock up to 9 GHz gives"),
])  # fmt: skip
def test_a_bit_rate_of_b_that_cannot_be_is_refused(rate: str, said: str, capsys: Screen) -> None:
    assert (
        main(["bus", "emulate", "vcan0", "vcan1", "--bitrate", "499979", "--bitrate-b", rate]) == 2
    )
    assert said in capsys.readouterr().err.replace("\n", " ")


# --------------------------------------------------------------------------- a rig with bus.emulate


def test_a_refusal_stays_one_when_the_gateway_has_to_be_killed(
    monkeypatch: pytest.MonkeyPatch, capsys: Screen
) -> None:
    def deaf(ready: int) -> int:  # as one that still compiles
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
        os.close(ready)
        signal.pause()
        return 0

    def started(*_: object) -> Child:
        child = Child.serving("line", deaf)
        monkeypatch.setattr(child, "end", partial(child.end, ask_s=0.05))
        return child

    monkeypatch.setattr(line, "start", started)
    words = ["--set", "bus.emulate=100k", "--bus", own_bus()]
    assert main(["run", "hull", *words, "--quiet"]) == 2
    told = capsys.readouterr().err
    assert "lower rate_hz" in told and "SIGKILL" not in told, told


@pytest.mark.parametrize("kind", ["classic", "fd"])
def test_a_run_with_an_emulated_line_carries_all_frames_and_keeps_its_numbers(
    kind: str, tmp_path: Path
) -> None:
    """Classic by settings, CAN FD by the rig."""
    words, data_bitrate = ["probe", "--set", "bus.emulate=1M", "--set", "bus.queue=256"], None
    if kind == "fd":
        rates, data_bitrate = "emulate: 1 Mbit/s, data_bitrate: 5000000", 5_000_000
        words = [str(fd_rig(tmp_path, f"bus: {{{rates}, queue: 256}}"))]
    words += ["--set", "rate_hz=100", "--no-figure", "--json", "-o", str(tmp_path / "run")]
    done = pcpc("run", *words, "--bus", own_bus(), "--set", "duration_s=0.5", *PATIENT)
    assert done.code == 0, str(done)
    line = json.loads((tmp_path / "run" / "line.json").read_text())
    carried = sum(side["sent"] + side["waiting"] for side in line["sides"])
    assert carried == done.summary["frames"]["sent"] > 100
    assert done.summary["frames"]["received"] <= carried
    for key in ("refused", "lost_off", "not_carried"):
        assert [side[key] for side in line["sides"]] == [0, 0], key
    rates_found = line["bitrate"], line["data_bitrate"], line["not_taken"]
    assert rates_found == (1_000_000, data_bitrate, 0)
    assert "line: 1 Mbit/s" + (", data at 5 Mbit/s" if data_bitrate else "") in done.err
    first, second = (side["bus"] for side in line["sides"])
    assert done.summary["bus"] == first != second


@pytest.mark.parametrize(
    ("rig", "of"),
    [("probe", "executive"), ("probe", "plant"), (str(ROBSTRIDE), "plant"),
     (str(ROBSTRIDE), "executive")],
)  # fmt: skip
def test_a_bit_rate_mismatch_is_named_in_the_verdict_within_a_second(
    rig: str, of: str, tmp_path: Path, capsys: Screen
) -> None:
    words = ["--set", "bus.emulate=1M", "--set", f"bus.bitrates={{{of}: 500000}}", "--no-figure"]
    run = tmp_path / "run"
    assert main(["simulate", rig, *words, "--set", "duration_s=5.0", "-o", str(run)]) == 5
    summary = json.loads((run / "summary.json").read_text())
    said = f"line: {of} has a bit rate of 500 kbit/s, the line 1 Mbit/s: it and the others do not"
    assert summary["faults"][0].startswith(said), summary["faults"]
    assert summary["cycles"] < summary["rate_hz"], "a second"
    line = json.loads((run / "line.json").read_text())
    assert [side["sent"] for side in line["sides"]] == [0, 0]
    assert all(side["worst_tec"] >= 128 for side in line["sides"]), line
    assert said in capsys.readouterr().out.replace("\n           ", " ")


def test_a_run_ends_with_the_bit_rates_before_it_waits_for_a_second(tmp_path: Path) -> None:
    words = [
        "probe",
        "--set",
        "bus.emulate=1M",
        "--set",
        "bus.bitrates={plant: 500000}",
        "--no-figure",
    ]
    done = pcpc("run", *words, "-o", str(tmp_path / "run"), "--bus", own_bus(), "--json")
    assert done.code == 4 and "line: plant" not in done.out, str(done)
    assert "has a bit rate of 500 kbit/s, the line 1 Mbit/s: it and the others" in done.err, done
    assert "no frame of the other node" not in done.err and "other node on" not in done.err, done


@pytest.mark.parametrize(("words", "said"), [
    (["bus.bitrates={plant: 500000}"], "only an emulated line knows bit rates; give bus.emulate"),
    (["bus.emulate=1M", "bus.bitrates={plnt: 500000}"], "plnt is no node at the line; did you"),
    (["bus.emulate=1M", "bus.bitrates={plant: 999983}"], "no clock up to 9 GHz gives both"),
    (["bus.emulate=1M", "bus.bitrates={plant: 500000, executive: 500000}"], "leave it out"),
])  # fmt: skip
def test_bit_rates_that_cannot_be_are_refused(words: list[str], said: str, capsys: Screen) -> None:
    assert main(["simulate", "probe", *(part for one in words for part in ("--set", one))]) == 2
    told = capsys.readouterr().err.replace("\n", " ")
    assert said in told, told


def children(pid: int) -> dict[str, int]:
    """Return the processes that `pid` started, by name."""
    found = {}
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        with suppress(OSError):
            found[Path(f"/proc/{child}/comm").read_text().strip()] = int(child)
    return found


def test_a_run_whose_line_dies_ends_with_a_word_about_it(tmp_path: Path) -> None:
    words = ["--set", "bus.emulate=1M", "--set", "duration_s=600.0", "-o", str(tmp_path / "run")]
    with subprocess.Popen(
        [PCPC, "run", "probe", "--bus", own_bus(), *words, "--no-figure", "--quiet"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as run:
        until(lambda: "pcpc recorder" in children(run.pid), "it records")
        os.kill(children(run.pid)["pcpc line"], signal.SIGKILL)
        out, _ = run.communicate(timeout=DEADLINE_S)
    assert run.returncode == 5, out
    assert "line: ended by SIGKILL" in out


def test_a_simulated_line_tells_the_same(tmp_path: Path, capsys: Screen) -> None:
    words = ["--set", "bus.emulate=350k", "--set", "duration_s=0.2", "--no-figure"]
    assert main(["simulate", "probe", *words, "-o", str(tmp_path / "run")]) == 0
    found = json.loads((tmp_path / "run" / "line.json").read_text())
    assert [side["bus"] for side in found["sides"]] == ["executive", "plant"]
    assert found["sides"][0]["sent"] > 2 * 190 and found["sides"][1]["sent"] > 190
    assert 0.5 < found["load"] < 1.0
    assert f"line: 350 kbit/s, {sum(side['sent'] for side in found['sides'])} frames" in (
        capsys.readouterr().err
    )

"""`pcpc run RIG --device`: a device in C and in Python, right and wrong."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from processes import PCPC, ROOT, Done, Running, own_bus, pcpc

from pcpc.drivers.can import e2e, wire
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log import diff
from pcpc.tools.make.device.replay import DeviceComparison

FOLDER = ROOT / "plants" / "probe" / "device"
RIG = str(FOLDER / "rig.yaml")
PYTHON = (sys.executable, str(FOLDER / "probe.py"), "{bus}")
FAULTY = str(Path(__file__).with_name("faulty_device.py"))
CYCLES = 500
SHORT = ("--set", f"duration_s={CYCLES / 1000}", "--no-figure")
CLOCK = ("--set", "rate_hz=100", "--set", "duration_s=2", "--no-figure")


@pytest.fixture(scope="module")
def in_c(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    """Compile the device in C as its header says, without a warning."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    program = tmp_path_factory.mktemp("device") / "probe"
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
    words = ["cc", "-std=c11", "-O2", *warnings, "-ffp-contract=off", "-o", str(program)]
    subprocess.run([*words, str(FOLDER / "probe.c")], check=True)
    return str(program), "{bus}"


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> logs.Log:
    """Run the rig's own law in virtual time."""
    folder = tmp_path_factory.mktemp("simulated") / "run"
    done = pcpc("simulate", RIG, *SHORT, "-o", str(folder))
    assert done.code == 0, done
    return logs.read(folder / "log.mcap")


def with_device(folder: Path, device: Sequence[str], *options: str) -> Done:
    words = ("run", "--only=plant", RIG, "--bus", own_bus(), "-o", str(folder), "--json", *options)
    return pcpc(*words, "--device", *device)


def faulty(what: str, cycles: int = CYCLES, rate_hz: float = 0.0) -> list[str]:
    return [sys.executable, FAULTY, what, "{bus}", str(cycles), str(rate_hz)]


def said(summary: dict[str, Any]) -> str:
    keys = "faults", "expectations_failed", "frames_too_many"
    return "\n".join(line for key in keys for line in summary[key])


@pytest.mark.parametrize("kind", ["c", "python"])
def test_a_device_gives_the_bits_of_the_same_law_in_virtual_time(
    kind: str, tmp_path: Path, simulated: logs.Log, request: pytest.FixtureRequest
) -> None:
    device = PYTHON if kind == "python" else request.getfixturevalue("in_c")
    done = with_device(tmp_path / "run", (*device, str(CYCLES)), "--pacing", "lockstep", *SHORT)
    assert done.code == 0, done
    log = logs.read(tmp_path / "run" / "log.mcap")
    report = diff.compare(alone(simulated), log)
    assert report.equal, report
    assert report.frames > 3 * CYCLES
    assert done.summary["device"]["frames"]["CMD"] == {"received": CYCLES + 1, "ok": CYCLES + 1}
    assert done.summary["judged"] == ["always abs(plant:lag.position - 0.8) < 0.01, after 0.3s"]
    assert (done.summary["device"]["age_cycles"], done.summary["warned"]) == ({"CMD": 0}, [])


def alone(log: logs.Log) -> logs.Log:
    """Return a log as if its plant had been recorded alone."""
    return logs.Log(log.path, {"plant": log.node["plant"]}, {}, log.metadata, [])


def test_a_replay_of_a_device_without_a_cycle_is_no_pass(simulated: logs.Log) -> None:
    head = alone(simulated)
    comparison = DeviceComparison(head, load_rig(Path(RIG)))
    comparison.take(replace(head, node={}), -1, True)
    assert comparison.verdict.code == 3 and not comparison.verdict.identical
    assert "no cycle that a device has answered" in comparison.verdict.incomplete


def test_a_device_that_knows_no_duration_hears_of_the_end(tmp_path: Path) -> None:
    done = with_device(tmp_path / "run", PYTHON, "--pacing", "lockstep", *SHORT)
    assert done.code == 0, done
    assert done.summary["cycles"] == CYCLES


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("crc", "CMD: 1 frame with a wrong CRC or length, first in cycle 61"),
        ("twice", "CMD: 1 frame sent twice: the counter stood still, first in cycle 61"),
        ("jump", "CMD: 2 frames with a jump of the counter, first in cycle 61"),
        ("late", "CMD: late in "),
        ("never", "CMD never came"),
    ],
)
def test_what_a_device_sends_wrongly_is_named(what: str, words: str, tmp_path: Path) -> None:
    loose = ("--set", "supervisor.fault_after_cycles=1000000")
    device = faulty(what, 200)
    done = with_device(tmp_path / "run", device, "--pacing", "lockstep", *SHORT, *loose)
    assert words in said(done.summary), done
    assert done.code in (1, 3), done


@pytest.mark.parametrize(
    ("what", "words"),
    [("killed", "device: ended by SIGKILL after "), ("stopped", "device: CMD: silent for ")],
)
def test_of_a_device_that_falls_silent_the_plant_comes_to_rest(
    what: str, words: str, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    done = with_device(folder, faulty(what, 0, 100.0), "--pacing", "real", *CLOCK)
    assert done.code == 5, done
    assert words in said(done.summary), done
    assert "plant: no valid input frame" in said(done.summary), done
    command = logs.read(folder / "log.mcap").node["plant"].columns["rx.CMD.command"]
    assert np.abs(command).max() > 0.5 and command[-1] == 0.0


def test_commands_that_are_old_behind_right_counters_are_named(tmp_path: Path) -> None:
    loose = ("--set", "require=[]", "--no-figure", "--set", "duration_s=0.8")
    done = with_device(tmp_path / "run", faulty("old=256", 800), "--pacing", "lockstep", *loose)
    assert said(done.summary) == "device: CMD: its commands are 256 cycles old", done
    assert (done.code, done.summary["device"]["age_cycles"]) == (1, {"CMD": 256}), done


def test_a_device_that_starts_again_is_named(tmp_path: Path) -> None:
    loose = ("--set", "supervisor.fault_after_cycles=1000000")
    device = faulty("again", 0, 100.0)
    done = with_device(tmp_path / "run", device, "--pacing", "real", *CLOCK, *loose)
    assert "device: restarted, its heartbeat begins again in cycle " in said(done.summary), done


def test_a_wrong_rate_is_named(tmp_path: Path) -> None:
    device = (*PYTHON, "0", "125")
    done = with_device(tmp_path / "run", device, "--pacing", "sync", *CLOCK)
    assert "Hz, the rig's is 100 Hz" in said(done.summary), done
    of_age = "device: CMD: the age of its commands is known modulo 16 cycles only: "
    assert done.summary["warned"] == [of_age + "a run in lockstep compares them with the rig's law"]
    assert 110.0 < done.summary["device"]["timing"]["rate_hz"] < 140.0


def test_a_device_may_be_started_elsewhere(tmp_path: Path) -> None:
    bus = own_bus()
    words = ("--pacing", "lockstep", "--bus", bus, "-o", str(tmp_path / "run"), "--json", *SHORT)
    with Running("run", "--only=plant", RIG, *words, "--device") as plant:
        plant.pid("plant")
        device = [word.replace("{bus}", bus) for word in (*PYTHON, str(CYCLES))]
        assert subprocess.run(device).returncode == 0
        done = plant.done()
    assert done.code == 0, done
    assert done.summary["device"]["command"] == []


def test_a_plant_that_is_killed_is_named_before_the_device_that_ends_of_it(tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    words = ("--pacing", "lockstep", "--bus", own_bus(), "-o", str(tmp_path / "run"), "--json")
    device = faulty(f"kills={pid}")
    with Running("run", "--only=plant", RIG, *words, *SHORT, "--device", *device) as plant:
        pid.write_text(str(plant.pid("plant")))
        done = plant.done()
    told = [line.partition(" ")[0] for line in done.summary["faults"]]
    assert done.code == 5 and told == ["plant:", "device:"], done


def test_a_device_that_cannot_begin_is_told_with_its_own_words(tmp_path: Path) -> None:
    device = ("sh", "-c", "echo no probe found >&2; exit 4")
    done = with_device(tmp_path / "run", device, "--pacing", "lockstep", *SHORT)
    assert done.code == 5, done
    assert "device: ended with code 4 after 0 of 500 cycles" in done.err + done.out, done
    assert "device: no probe found" in done.err, done
    assert (tmp_path / "run" / "device.txt").read_text() == "no probe found\n"


@pytest.mark.parametrize("pacing", ["lockstep", "real"])
@pytest.mark.parametrize(
    ("what", "came"),
    [("greets", "HB_EXEC came"), ("greets and more", "SYNC (ERROR), HB_EXEC came")],
)
def test_what_was_heard_of_a_device_that_never_begins_is_told(
    what: str, came: str, pacing: str, tmp_path: Path
) -> None:
    rig, bus = tmp_path / "rig.yaml", own_bus()
    rig.write_text(f"base: {RIG}\nsupervisor: {{peer_timeout_s: 7.0}}\n")
    words = (
        "run",
        "--only=plant",
        str(rig),
        "--bus",
        bus,
        "--pacing",
        pacing,
        "-o",
        str(tmp_path / "run"),
    )
    device = subprocess.Popen([word.replace("{bus}", bus) for word in faulty(what, 0)])
    try:
        done = pcpc(*words, *SHORT, "--device")
    finally:
        device.kill()
        device.wait()
    assert done.code == 4, done
    last = done.err.splitlines()[-1]
    assert f"{came} from the device, but no valid SYNC" in last and "no run is kept" in last, done
    waits = [line for line in done.err.splitlines() if "waiting for the device" in line]
    assert 1 <= len(waits) <= 4, done
    assert not (tmp_path / "run").exists()


def test_a_device_that_says_nothing_is_told_so(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"base: {RIG}\nsupervisor: {{peer_timeout_s: 1.0}}\n")
    words = (
        "run",
        "--only=plant",
        str(rig),
        "--bus",
        own_bus(),
        "-o",
        str(tmp_path / "run"),
        *SHORT,
    )
    done = pcpc(*words, "--device")
    assert done.code == 4 and "no frame of a device on" in done.err, done
    assert "so no run is kept" in done.err and not (tmp_path / "run").exists(), done


def test_what_cannot_be_a_device_is_refused(tmp_path: Path) -> None:
    done = with_device(tmp_path / "run", ("./no-such-program",))
    assert done.code == 2 and "no such program" in done.err, done
    assert not (tmp_path / "run").exists()
    emulated = ("--set", "bus.emulate=500000", "--device", "sh")
    done = pcpc("run", "--only=plant", "hull", *emulated, cwd=tmp_path)
    assert done.code == 2 and "--set bus.emulate=null" in done.err, done


def test_the_summary_is_kept_with_what_the_device_did(tmp_path: Path) -> None:
    done = with_device(tmp_path / "run", faulty("crc", 200), "--pacing", "lockstep", *SHORT)
    kept = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert kept["device"] == done.summary["device"]
    assert kept["device"]["frames"]["CMD"]["wrong_crc"] == 1


def test_the_executive_is_a_device_like_any_other(tmp_path: Path) -> None:
    """The barrel is judged by its true motion and the rig's reference, without the executive."""
    own = (
        "run",
        "--only=executive",
        "slew10",
        "--bus",
        "{bus}",
        "--pacing",
        "lockstep",
        "--no-figure",
        "--quiet",
    )
    folder = tmp_path / "plant"
    words = (
        "run",
        "--only=plant",
        "slew10",
        "--pacing",
        "lockstep",
        "--json",
        "-o",
        str(folder),
        "--no-figure",
    )
    done = pcpc(*words, "--bus", own_bus(), "--device", PCPC, *own, "-o", str(tmp_path / "exec"))
    assert done.code == 0, done
    virtual = pcpc("simulate", "slew10", "--no-figure", "--json", "-o", str(tmp_path / "virtual"))
    told = done.summary["metrics"]
    expected = virtual.summary["metrics"]
    assert told.items() <= expected.items(), (told, expected)
    assert "muzzle_error_rms_mrad" in told and "command_rms_Nm" not in told
    assert done.summary["judged"] == ["muzzle_error_rms_mrad"]
    logs_of = [logs.read(tmp_path / name / "log.mcap") for name in ("virtual", "plant")]
    report = diff.compare(alone(logs_of[0]), logs_of[1])
    assert report.equal, report


def test_what_only_the_executive_knows_is_no_pass_where_all_must_be_judged(tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    words = ("run", "--only=plant", str(rig), "--pacing", "lockstep", "--json", *SHORT)
    device = (*PYTHON, str(CYCLES))
    for held, more, verdict in (
        ("", (), "not judged"),
        ("{always: time.t_s >= 0}, ", (), "ok"),
        ("{always: time.t_s >= 0}, ", ("--judge",), "expectation not met"),
    ):
        required = f"[{held}{{always: abs(controller.command) < 1e9}}]"
        rig.write_text(f"base: {RIG}\nrequire: {required}\n")
        folder = tmp_path / verdict
        done = pcpc(*words, *more, "-o", str(folder), "--bus", own_bus(), "--device", *device)
        assert len(done.summary["not_judged"]) == 1 and done.summary["verdict"] == verdict, done
        assert done.code == (verdict != "ok"), done


def test_the_bytes_of_the_contract_are_those_on_the_wire() -> None:
    page = (ROOT / "docs" / "device.md").read_text()
    shown = re.findall(r"^(\w+) +((?:[0-9a-f]{2} ?){2,})$", page, re.MULTILINE)
    told = {name: bytes.fromhex(text) for name, text in shown}
    db = cantools.database.load_file(FOLDER.parent / "probe.dbc")
    values = {"SYNC": {"sequence": 1}, "CMD": {"command": 0.8, "mode": 2, "counter": 5}}
    for name, signals in values.items():
        message = db.get_message_by_name(name)
        body = message.encode(signals | {"crc": 0})[:-1]
        crc = int(e2e.crc8(message.frame_id, np.frombuffer(body, np.uint8), len(body)))
        assert told[name] == bytes([*body, crc]), (name, told)
    frame = np.zeros(16, np.uint8)
    packet = b"".join(bytes.fromhex(text) for name, text in shown if name.startswith("datagram"))
    assert wire._read_packet(np.frombuffer(packet, np.uint8), len(packet), frame, 0)
    assert frame.tobytes() == bytes([0x80, 0, 0, 0, 2, 0, 0, 0, *told["SYNC"], *bytes(6)])

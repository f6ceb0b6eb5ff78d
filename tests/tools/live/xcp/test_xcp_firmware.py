"""A generated device is measured and calibrated by pyXCP on its bus, on Linux and a Cortex-M."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from can_master import GAIN, ROWS
from places import PATIENCE_S
from processes import PCPC, Done, own_bus, pcpc

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log import diff
from pcpc.tools.make.generate.device import device
from pcpc.tools.start.rigs import find

pytestmark = pytest.mark.deep

CYCLES = 300
RIG = ("hull", "--controller", "pd_nn_fast", "--set", f"duration_s={CYCLES / 1000}")
KV, IDS = "controller.kv_Nms_rad", "0x7E0,0x7E1"
MEASURED = ["time.t_s", "health.passes", "rx.FB_A.encoder", KV, "controller.e_rad"]  # by number


@dataclass(frozen=True)
class Made:
    """A device with an XCP slave, and where its variables are."""

    folder: Path
    address: dict[str, int]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("firmware")
    done = pcpc("generate", "c", *RIG, "--device", "--xcp", "-o", str(folder))
    assert done.code == 0 and "not in the device: timing.wake_late_us" in done.out, done
    rig = load_rig(find("hull"), "pd_nn_fast", [f"duration_s={CYCLES / 1000}"])
    names = [one.name for one in plan(rig, "executive", "lockstep").table.variables]
    return Made(folder, {name: 8 * i for i, name in enumerate(names)})


def command(made: Made, target: str, bus: str) -> list[str]:
    """Compile a target without a warning; return what runs it."""
    compiler = "cc" if target == "linux" else "arm-none-eabi-gcc"
    for program in (compiler, *["qemu-system-arm"] * (target != "linux")):
        if shutil.which(program) is None:
            pytest.skip(f"no {program}; make firmware-tools")
    words = ["make", "-s", "-C", str(made.folder), target, "CFLAGS=-O2 -Werror"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stdout + done.stderr) == (0, ""), done
    if target == "linux":
        return [str(made.folder / "linux"), bus]
    return [PCPC, "slcan", bus, "--", "sh", str(made.folder / "qemu.sh"), target]


@contextmanager
def going_on(*words: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a program, which ends with the test and all that it started."""
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def plant(bus: str, folder: Path, *device: str) -> Done:
    words = ("run", "--only=plant", *RIG, "--no-figure", "--bus", bus, "-o", str(folder), "--json")
    return pcpc(*words, "--pacing", "lockstep", "--device", *device)


def simulated(folder: Path, *more: str) -> logs.Log:
    done = pcpc("simulate", *RIG, "--no-figure", "-o", str(folder), *more)
    assert done.ran, done
    return logs.read(folder / "log.mcap")


def assert_same_plant(virtual: logs.Log, run: Path) -> None:
    alone = logs.Log(virtual.path, {"plant": virtual.node["plant"]}, {}, virtual.metadata, [])
    report = diff.compare(alone, logs.read(run / "log.mcap"))
    assert report.equal and report.frames > 5 * CYCLES, report


def session(made: Made, target: str, run: Path) -> dict[str, Any]:
    """Return what a session of pyXCP saw of a whole run."""
    bus = own_bus()
    addresses = json.dumps([made.address[name] for name in MEASURED])
    master = [sys.executable, str(Path(__file__).with_name("can_master.py")), bus]
    places = addresses, str(made.address[KV]), str(made.address["time.t_s"])
    with going_on(*command(made, target, bus)) as device:
        with going_on(*master, str(device.pid), *places) as one:
            assert one.stdout is not None and one.stdout.readline() == "ready\n"
            done = plant(bus, run)
            assert done.ran and done.summary["device"]["problems"] == [], done
            told = dict(json.loads(one.stdout.read()))
        assert device.wait(PATIENCE_S) == 0
    return told


@pytest.mark.parametrize("target", ["linux", "m7", "m4"])
def test_a_calibrated_run_has_the_bits_of_the_executive_with_the_same_schedule(
    target: str, made: Made, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    told = session(made, target, run)
    assert (told["rig"], told["read"], told["refused"]) == ("hull", GAIN, 0x23), told
    assert told["events"] == ["cycle", "cycle_10", "cycle_100"]
    (cycle,) = told["cycles"]
    assert ROWS <= cycle < CYCLES
    schedule = "--set", f"schedule=[{{at_s: {cycle / 1000}, set: {{{KV}: {GAIN}}}}}]"
    virtual = simulated(tmp_path / "virtual", *schedule)
    assert_same_plant(virtual, run)
    replayed = pcpc("replay", str(run), "--node", "device", *schedule, "--json")
    assert replayed.code == 0 and json.loads(replayed.out)[0]["identical"], replayed
    assert_measured(virtual.node["executive"], told["rows"], cycle)


def assert_measured(node: logs.NodeLog, rows: Sequence[Any], written: int) -> None:
    """Compare measured rows with the executive's log, bit by bit and stamp by stamp."""
    values = np.array([np.frombuffer(bytes.fromhex(row[1])) for row in rows])
    assert [row[0] for row in rows] == [1_000_000 * i for i in range(CYCLES)]
    for i, name in enumerate(MEASURED):
        if name == KV:
            before = np.arange(CYCLES) < written
            assert (values[:, i] == np.where(before, 110.0, GAIN)).all()
        else:
            logged = (node.columns | node.timing)[name][:CYCLES]
            assert (values[:, i].view(np.int64) == logged.view(np.int64)).all(), name


def test_without_a_master_the_run_is_that_of_a_device_without_xcp(
    made: Made, tmp_path: Path
) -> None:
    bus = own_bus()
    done = plant(bus, tmp_path / "run", *command(made, "linux", "{bus}"))
    assert done.ran and done.summary["device"]["problems"] == [], done
    assert_same_plant(simulated(tmp_path / "virtual"), tmp_path / "run")


def test_without_the_option_nothing_is_written_of_it() -> None:
    rig = load_rig(find("hull"))
    plain, served = device(rig), device(rig, IDS)
    assert {name for name in served if plain.get(name) != served[name]} == {
        "device.c", "rig.c", "run.c", "xcp.c", "xcp.h", "xcp_rig.h",
    }  # fmt: skip
    assert plain.keys() <= served.keys() and not any("xcp" in text for text in plain.values())


@pytest.mark.parametrize(
    ("ids", "told"),
    [("0x0A0,0x7E1", "0xA0 is CMD of the DBC file"), ("2016", "expected two ids"),
     ("0x7E0,0x7E0", "two different ids"), ("0x7E0,0x20000000", "at most 29 bits")],
)  # fmt: skip
def test_wrong_ids_are_refused(ids: str, told: str, tmp_path: Path) -> None:
    words = ("generate", "c", "hull", "--device", "--xcp", ids, "-o", str(tmp_path / "firmware"))
    done = pcpc(*words)
    assert done.code == 2 and told in done.err and not (tmp_path / "firmware").exists(), done

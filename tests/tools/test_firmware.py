"""A rig's executive as a device in C: on Linux, and in QEMU on a Cortex-M that speaks slcan."""

import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from processes import PCPC, ROOT, Done, own_bus, pcpc

from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.generate.device import device
from pcpc.tools.log import diff

PROBE = ROOT / "plants" / "probe" / "device" / "rig.yaml"
CYCLES = 500
SHORT = ("--set", f"duration_s={CYCLES / 1000}", "--no-figure")
QEMU = {"m7": "mps2-an500", "m4": "mps2-an386"}
LINE = "-display none -monitor none -chardev stdio,id=line,mux=on,signal=off -serial chardev:line"
HEADER = """
typedef struct { double gain; double target; } controller_parameters;
typedef struct { double position; } controller_inputs;
typedef struct { double command; } controller_outputs;
void controller_step(double t, double dt, const controller_parameters *p,
                     const controller_inputs *u, controller_outputs *y);
"""
SOURCE = """#include "controller.h"
void controller_step(double t, double dt, const controller_parameters *p,
                     const controller_inputs *u, controller_outputs *y)
{
    (void)t;
    (void)dt;
    y->command = p->gain * (p->target - u->position);
}
"""


def by_hand(_block: Any, name: str, _values: Mapping[str, float]) -> dict[str, str]:
    """Return the law of the probe in C."""
    assert name == "controller"
    return {"controller.h": HEADER, "controller.c": SOURCE}


def made(folder: Path, target: str) -> None:
    """Make one target of a device's folder, without a warning."""
    compiler = "cc" if target == "linux" else "arm-none-eabi-gcc"
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}; make firmware-tools")
    words = ["make", "-s", "-C", str(folder), target, "CFLAGS=-O2 -Werror"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stdout + done.stderr) == (0, ""), done


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("firmware")
    rig = load_rig(PROBE, None, [f"duration_s={CYCLES / 1000}"])
    for name, text in device(rig, by_hand).items():
        (folder / name).write_text(text)
    return folder


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> logs.Log:
    folder = tmp_path_factory.mktemp("simulated") / "run"
    done = pcpc("simulate", str(PROBE), *SHORT, "-o", str(folder))
    assert done.code == 0, done
    log = logs.read(folder / "log.mcap")
    return logs.Log(log.path, {"plant": log.node["plant"]}, {}, log.metadata, [])


def with_device(folder: Path, *device: str) -> Done:
    words = ("plant", str(PROBE), "--bus", own_bus(), "-o", str(folder), "--json", *SHORT)
    return pcpc(*words, "--pacing", "lockstep", "--device", *device)


@pytest.mark.parametrize("target", ["linux", "m7", "m4"])
def test_a_generated_device_gives_the_bits_of_the_executive(
    target: str, written: Path, simulated: logs.Log, tmp_path: Path
) -> None:
    made(written, target)
    if target == "linux":
        words = [str(written / "linux"), "{bus}"]
    else:
        if shutil.which("qemu-system-arm") is None:
            pytest.skip("no qemu-system-arm; make firmware-tools")
        image = f"-M {QEMU[target]} -kernel {written / target}.elf -semihosting".split()
        words = [PCPC, "slcan", "{bus}", "--", "qemu-system-arm", *image, *LINE.split()]
    done = with_device(tmp_path / "run", *words)
    assert done.code == 0, done
    log = logs.read(tmp_path / "run" / "log.mcap")
    report = diff.compare(simulated, log)
    assert report.equal, report
    assert report.frames > 3 * CYCLES
    assert done.summary["device"]["frames"]["CMD"] == {"received": CYCLES + 1, "ok": CYCLES + 1}
    assert done.summary["device"]["problems"] == []

"""Devices in the executive's place on a real vcan0: the bits of virtual time, in C and Python."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import HELD
from live import CHANNEL, PATIENCE_S, PCPC, ROOT

from pcpc.executive.log import reader as logs

pytestmark = pytest.mark.vcan

FOLDER = ROOT / "plants" / "probe" / "device"
CYCLES = 100
KINDS = ["python"] + (["c"] if shutil.which("cc") else [])


def recorded(folder: Path, *words: str) -> logs.NodeLog:
    """Return the plant's record of a command on the rig of the devices."""
    rig, short = str(FOLDER / "rig.yaml"), ["--set", f"duration_s={CYCLES / 1000}", "--set", HELD]
    command = [PCPC, words[0], rig, *short, "--no-figure", "-o", str(folder), *words[1:]]
    done = subprocess.run(command, cwd=ROOT, timeout=PATIENCE_S, capture_output=True, text=True)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return logs.read(folder / "log.mcap").node["plant"]


@pytest.fixture(scope="module")
def virtual(tmp_path_factory: pytest.TempPathFactory) -> logs.NodeLog:
    return recorded(tmp_path_factory.mktemp("virtual") / "run", "simulate")


@pytest.mark.parametrize("kind", KINDS)
def test_a_device_on_vcan_gives_the_bits_of_virtual_time(
    kind: str, tmp_path: Path, virtual: logs.NodeLog
) -> None:
    device = [sys.executable, str(FOLDER / "probe.py")]
    if kind == "c":
        device = [str(tmp_path / "probe")]
        source = str(FOLDER / "probe.c")
        subprocess.run(
            ["cc", "-std=c11", "-O2", "-ffp-contract=off", "-o", *device, source], check=True
        )
    on_vcan = ("run", "--only=plant", "--pacing", "lockstep", "--bus", CHANNEL, "--device")
    plant = recorded(tmp_path / "run", *on_vcan, *device, "{bus}", str(CYCLES))
    assert len(plant.cycle) == CYCLES + 1
    for name, column in virtual.columns.items():
        assert np.array_equal(plant.columns[name], column), name
    for field in ("cycle", "id", "dlc", "direction", "e2e", "data"):
        assert np.array_equal(plant.frames[field], virtual.frames[field]), field

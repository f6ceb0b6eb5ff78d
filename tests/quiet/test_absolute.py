"""Absolute gates for a machine of one's own, with nothing else on it: `make test-quiet`.

Never run by `make test`: on a shared or virtual machine these numbers say something about the
neighbours, and fail.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.quiet

PCPC = str(Path(sys.executable).with_name("pcpc"))
ROOT = Path(__file__).resolve().parents[2]
BUS = "udp_multicast:239.74.163.40:43140"


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the summary of 60 s of the main rig at 1 kHz."""
    folder = tmp_path_factory.mktemp("minute") / "run"
    done = subprocess.run(
        [PCPC, "run", "plants/atb1000/rigs/hull.yaml", "--set", "duration_s=60.0", "--bus", BUS,
         "-o", str(folder), "--json", "--quiet", "--no-figure"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return dict(json.loads(done.stdout))


def test_no_period_is_skipped_and_no_frame_lost_in_a_minute(minute: dict[str, Any]) -> None:
    assert minute["cycles"] == 60_000
    assert minute["skipped_cycles"] == 0, minute["latest_cycles"]
    assert (minute["frames"]["lost"], minute["frames"]["stale"]) == (0, 0)


def test_one_cycle_in_a_thousand_is_late_at_most(minute: dict[str, Any]) -> None:
    assert minute["late_cycles"] <= 60, minute["latest_cycles"]


def test_wake_up_and_work_stay_far_inside_the_period(minute: dict[str, Any]) -> None:
    timing = minute["timing_us"]
    assert timing["wake_late"]["p99"] < 70.0, timing
    assert minute["timing_share"] < 0.3, f"{minute['timing_share']:.1%} of the period at p99.9"


def test_a_machine_with_vcan0_is_up_in_15_s_without_kvm() -> None:
    subprocess.run([PCPC, "vm", "--", "true"], check=True)  # its kernel is there then
    command = [
        PCPC,
        "vm",
        "--accel",
        "tcg",
        "--timeout",
        "15s",
        "--",
        "ip",
        "link",
        "show",
        "vcan0",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "UP" in done.stdout, done

"""`pcpc doctor`: it says what really happens on this machine, and changes nothing."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from json_schemas import holds
from places import ROOT

from pcpc.drivers.can import bus
from pcpc.drivers.machine import claim
from pcpc.tools.cli import main
from pcpc.tools.machine.doctor import bus as doctor_bus
from pcpc.tools.machine.doctor import cli as doctor
from pcpc.tools.machine.doctor import machine as doctor_machine

Screen = pytest.CaptureFixture[str]

# Starts the doctor as somebody who may neither schedule with SCHED_FIFO nor lock memory.
UNPRIVILEGED = """
import ctypes, os, resource, sys
for capability in (14, 23):  # IPC_LOCK, SYS_NICE
    ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP; refused to all but root
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
os.execv(sys.executable, [sys.executable, "-m", "pcpc.tools.cli", "doctor", "--json"])
"""
ROWS = (
    "python", "packages", "matplotlib", "kernel", "SCHED_FIFO", "mlockall", "cpu_dma_latency",
    "timer slack", "isolated CPUs", "CPU governor", "clock source", "hypervisor", "AF_CAN",
    "CAN interfaces", "udp_multicast", "pcpc vm", "KVM", "node memory", "compile cache",
    "C compiler",
)  # fmt: skip


@pytest.fixture(scope="module")
def refused() -> dict[str, Any]:
    """Return what the doctor says without permissions."""
    command = [sys.executable, "-c", UNPRIVILEGED]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = holds("doctor", done.stdout)
    return found


def test_a_machine_that_runs_these_tests_can_run_a_rig(
    capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code = main(["doctor"])
    out, err = capsys.readouterr()
    assert (code, err) == (0, ""), err
    assert [line for line in out.splitlines() if len(line) > 80] == []
    assert [name for name in ROWS if name not in out] == [], out


def test_json_has_every_row_once_and_a_cost_where_it_is_not_ok(refused: dict[str, Any]) -> None:
    assert refused["can_run"] is True, refused
    assert tuple(row["name"] for row in refused["rows"]) == ROWS
    for row in refused["rows"]:
        assert row["state"] in ("ok", "warn"), row
        assert bool(row["cost"]) == (row["state"] != "ok"), row


@pytest.mark.parametrize("name", ["SCHED_FIFO", "mlockall"])
def test_a_refused_permission_is_a_warning_with_cost_and_command(
    refused: dict[str, Any], name: str
) -> None:
    row = next(row for row in refused["rows"] if row["name"] == name)
    assert row["state"] == "warn" and row["cost"], row
    assert "rtprio" in row["cure"] and "memlock" in row["cure"], row


def test_the_fifo_row_agrees_with_an_own_attempt() -> None:
    attempt = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(80))"
    allowed = subprocess.run([sys.executable, "-c", attempt], capture_output=True).returncode == 0
    rows = {row.name: row for row in doctor_machine.permission_rows(ROOT)}
    assert (rows["SCHED_FIFO"].state == "ok") == allowed, rows["SCHED_FIFO"]


def test_the_doctor_keeps_its_own_scheduling_and_slack() -> None:
    def settings() -> tuple[int, str]:
        return os.sched_getscheduler(0), Path("/proc/self/timerslack_ns").read_text()

    before = settings()
    list(doctor_machine.machine_rows(ROOT))
    assert settings() == before, f"{before} became {settings()}"


def test_a_broken_package_stops_every_rig_and_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Screen
) -> None:
    (tmp_path / "zstandard.py").write_text("raise ImportError('no libzstd')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    code = main(["doctor"])
    out, err = capsys.readouterr()
    assert code == 4, out
    assert err == "no rig can run on this machine: missing packages\n", err
    assert "zstandard: no libzstd" in out, out
    words = " ".join(out.replace(" \\\n", " ").split())
    assert f"{sys.executable} -m pip install -e {ROOT}" in words, out


def test_the_memory_of_a_node_is_tried_and_let_go() -> None:
    for _ in range(2):
        row = doctor.node_memory_row()
        assert row.state == "ok" and "MiB, sealed" in row.found, row
    assert not [name for name in claim.held_names("node/") if "doctor" in name]


def test_an_empty_cache_is_cold_and_one_with_code_is_warm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    cold = doctor.compile_cache_row()
    assert (cold.state, cold.cure[:14]) == ("warn", "pcpc simulate "), cold
    assert not any(tmp_path.iterdir()), "the doctor wrote into the cache"
    (tmp_path / "law.py").write_text(
        "from pcpc.drivers.compiled.jit import compiled, f8\n"
        "@compiled(f8(f8))\n"
        "def twice(x):\n"
        "    return 2.0 * x\n"
    )
    subprocess.run([sys.executable, "-c", "import law"], cwd=tmp_path, check=True)
    warm = doctor.compile_cache_row()
    assert (warm.state, warm.found[:6]) == ("ok", "warm, "), warm


def test_a_cache_that_cannot_be_written_is_a_warning_with_the_other_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(file))
    row = doctor.compile_cache_row()
    assert row.state == "warn" and str(file) in row.found, row
    assert f"pcpc-{os.geteuid()}" in row.cost, row


def test_a_datagram_makes_its_way_through_the_sockets_of_a_node() -> None:
    assert doctor_bus.multicast_heard() == ""


def test_can_interfaces_agree_with_what_the_auto_bus_finds() -> None:
    up = doctor_bus.can_interfaces().get("vcan0", False)
    assert up == (bus.bus_named("auto", None).interface == "socketcan"), doctor_bus.can_interfaces()


@pytest.mark.parametrize(
    ("version", "sys_realtime", "state", "model"),
    [
        ("#1 SMP PREEMPT_RT Debian 6.12.1-1", False, "ok", "PREEMPT_RT"),
        ("#1 SMP Debian 5.10 rt", True, "ok", "PREEMPT_RT"),
        ("#1 SMP PREEMPT_DYNAMIC Debian 6.1.0-1", False, "warn", "PREEMPT_DYNAMIC"),
        ("#1 SMP Debian 6.1.0-1", False, "warn", "no PREEMPT in uname -v"),
    ],
)
def test_the_preemption_model_is_read_from_the_kernels_own_words(
    version: str, sys_realtime: bool, state: str, model: str
) -> None:
    row = doctor_machine.kernel_row(version, sys_realtime)
    assert (row.state, row.found.rpartition(", ")[2]) == (state, model), row


def test_a_slow_clock_source_is_a_warning_with_the_better_one() -> None:
    row = doctor_machine.clock_row("hpet", "tsc hpet acpi_pm")
    assert row.state == "warn", row
    assert row.cure.startswith("echo tsc | sudo tee /sys/"), row
    assert doctor_machine.clock_row("tsc", "tsc hpet").state == "ok"


@pytest.mark.parametrize(("stat", "found"), [
    ("cpu  600 200 100 9000 50 0 20 100 0 0\ncpu0 1 1 1 1 1 1 1 1\n",
     "kvm; its host took 10 % of the time that programs wanted (steal)"),
    ("cpu  600 200 100 9000 50 0 20 0 0 0\n", "kvm"), ("", "kvm"),
])  # fmt: skip
def test_what_a_host_has_taken_is_told(stat: str, found: str) -> None:
    assert doctor_machine.hypervisor_row("kvm", stat).found == found
    assert doctor_machine.hypervisor_row("", stat).found == "none"


def test_the_doctor_needs_no_numba() -> None:
    code = "import sys; import pcpc.tools.machine.doctor.bus; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "False\n", done.stdout + done.stderr

"""Wrong input and a machine that lacks something: place, expectation and cure, said once, no trace.

All runs start in a folder with packages of our names that cannot be imported: it must not matter.
"""

import os
import re
import signal
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from processes import RIGS, Done, Running, blocks_left, own_bus, pcpc

from pcpc.drivers.errors import Exit

SLEW10 = RIGS / "slew10.yaml"
NO_PRIVILEGE = (
    "setpriv", "--bounding-set", "-sys_nice,-sys_resource,-ipc_lock", "--inh-caps", "-all"
)  # fmt: skip
PATIENT = (
    "--set",
    "supervisor.hold_cycles=100000",
    "--set",
    "supervisor.fault_after_cycles=100000",
)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """Return a user's folder; nothing but what was there is in it afterwards."""
    for name in ("executive", "drivers", "plants", "tools"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('the user's own')\n")
    before = sorted(os.listdir(tmp_path))
    yield tmp_path
    after = sorted(set(os.listdir(tmp_path)) - {"rig.yaml"})
    assert after == before, f"left behind: {set(after) - set(before)}"


def refuse(
    words: Sequence[str], folder: Path, code: int, *said: str, bus: str = "", lines: int = 1
) -> Done:
    """Run `words` in `folder`; check exit code, what is `said` (patterns), and all else left."""
    bus = bus or own_bus()
    given = [*words] if "--bus" in words or "simulate" in words else [*words, "--bus", bus]
    done = pcpc(*given, "--quiet", "--no-figure", cwd=folder)
    assert done.code == code, str(done)
    assert "Traceback" not in done.err and not done.out, str(done)
    spoken = done.err.splitlines()
    assert 1 <= len(spoken) <= lines and len(set(spoken)) == len(spoken), str(done)
    for pattern in said:
        assert re.search(pattern, done.err), f"{pattern!r} is not said:\n{done}"
    assert blocks_left(bus) == [], blocks_left(bus)
    return done


RIG_ERRORS = {
    "unknown key": (
        "rat_hz: 1000",
        (r"rig\.yaml:2:1: rat_hz: unknown key", "did you mean rate_hz"),
    ),
    "wrong type": (
        "duration_s: long",
        (r"rig\.yaml:2:1: duration_s: expected a number, got text 'long'",),
    ),
    "gain out of range": (
        "controllers: {pd: {parameters: {kv_Nms_rad: -5.0}}}",
        (r"rig\.yaml:2:33: controllers\.pd\.parameters\.kv_Nms_rad: -5 is outside 0\.\.",),
    ),
    "unknown variable": (
        "executive: {blocks: {controller: {inputs: {q_d_rad: reference.q_d}}}}",
        (r"rig\.yaml:2:44: controller\.q_d_rad: no variable", r"did you mean reference\.q_d_rad"),
    ),
    "unit mismatch": (
        "executive: {blocks: {controller: {inputs: {q_d_rad: rx.FB_A.hub_rate}}}}",
        (r"rig\.yaml:2:44: controller\.q_d_rad is in 'rad' but rx\.FB_A\.hub_rate is in 'rad/s'",),
    ),
    "two writers": (
        "plant:\n  transmit:\n"
        "    FB_A.encoder: barrel.encoder_rad\n    FB_A.encoder: barrel.motor_angle_rad",
        (r"rig\.yaml:5:5: FB_A\.encoder: given twice, first at .*rig\.yaml:4:5", "remove one"),
    ),
    "two blocks of a name": (
        "plant: {blocks: {reference: {law: references:step}}}",
        (r"rig\.yaml:2:18: plant\.blocks\.reference: the executive has this block", "rename one"),
    ),
    "missing DBC": ("dbc: nosuch.dbc", (r"rig\.yaml:2:1: dbc: no such file: .*nosuch\.dbc",)),
    "not YAML": ("limits: [1, 2\nseed: 3", (r"rig\.yaml:3:5: expected",)),
}


@pytest.mark.parametrize("error", RIG_ERRORS)
def test_wrong_rig_file_is_refused_with_its_place(error: str, folder: Path) -> None:
    text, said = RIG_ERRORS[error]
    (folder / "rig.yaml").write_text(f"base: {SLEW10}\n{text}\n")
    refuse(["run", "rig.yaml"], folder, Exit.WRONG_INPUT, *said)


OPTION_ERRORS = {
    "unknown controller": (["--controller", "pdd"], ("--controller pdd: ", "did you mean pd")),
    "unknown key": (["--set", "rate=3"], ("--set rate=3: no such", "did you mean rate_hz")),
    "no value": (["--set", "rate_hz"], ("--set rate_hz: expected NAME=VALUE",)),
    "unknown bus": (
        ["--bus", "vcann0"],
        ("--bus vcann0: no bus interface", "expected auto, vcan0"),
    ),
    "bad group": (
        ["--bus", "udp_multicast:10.0.0.1"],
        (r"udp_multicast:10\.0\.0\.1: expected an IPv4 multicast group", r"like 239\."),
    ),
    "bad port": (["--bus", "udp_multicast:239.1.1.1:99999"], ("239.1.1.1:99999: expected an",)),
    "no place": (["-o", "/proc/here"], ("/proc/here: ", "choose another folder with -o")),
    "not writable": (["-o", "/proc/sys"], ("/proc/sys: ", "choose another folder with -o")),
    "a file": (["-o", str(SLEW10)], (r"slew10\.yaml: is not a folder", "choose another folder")),
}


@pytest.mark.parametrize("error", OPTION_ERRORS)
def test_wrong_option_is_refused_and_named(error: str, folder: Path) -> None:
    words, said = OPTION_ERRORS[error]
    refuse(["run", str(SLEW10), *words], folder, Exit.WRONG_INPUT, *said)


def test_unknown_setting_of_a_block_is_refused_by_the_other_commands(folder: Path) -> None:
    setting = ["--set", "controller.kv=3"]
    for command in (["run", "--only=plant"], ["simulate"]):  # `run`: of its processes, as above
        said = "--set controller.kv=3: unknown parameter; did you mean kv_Nms_rad"
        refuse([*command, str(SLEW10), *setting], folder, Exit.WRONG_INPUT, said)


def test_missing_rig_file_is_refused(folder: Path) -> None:
    refuse(["run", "nosuch.yaml"], folder, Exit.WRONG_INPUT, r"nosuch\.yaml: no such file")


def test_rate_beyond_the_bus_is_refused_with_its_load(folder: Path) -> None:
    words = ["run", str(SLEW10), "--set", "rate_hz=2000"]
    refuse(
        words,
        folder,
        Exit.WRONG_INPUT,
        r"loads the bus with 12\d\.\d% of 1000000 bit/s",
        "lower rate_hz",
    )


def test_missing_can_interface_is_named_with_the_way_to_make_it(folder: Path) -> None:
    words = ["run", str(SLEW10), "--bus", "socketcan:vcan7"]
    cure = "sudo ip link add dev vcan7 type vcan"
    refuse(words, folder, Exit.ENVIRONMENT, "^vcan7: ", cure, "--bus udp_multicast")
    assert blocks_left("socketcan:vcan7") == [], blocks_left("socketcan:vcan7")


def test_adapter_that_python_can_cannot_open_is_named(folder: Path) -> None:
    words = ["run", str(SLEW10), "--bus", "slcan:/dev/nosuch"]
    said = "slcan:/dev/nosuch: python-can cannot open it: "
    refuse(words, folder, Exit.ENVIRONMENT, said, lines=2)  # python-can has a word of its own
    assert blocks_left("slcan:/dev/nosuch".replace("/", "_")) == []


def test_port_in_use_is_named_with_another(folder: Path) -> None:
    bus = own_bus()
    port = int(bus.rpartition(":")[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as greedy:
        greedy.bind(("", port))
        said = (f"port {port} is in use by a program that does not share it", f":{port + 1}")
        refuse(["run", str(SLEW10)], folder, Exit.ENVIRONMENT, *said, bus=bus)


def test_second_executive_on_a_bus_is_refused_and_the_first_undisturbed(folder: Path) -> None:
    bus = own_bus()
    usual = ["run", "--only=executive", str(SLEW10), "--bus", bus, "--quiet", "--no-figure"]
    with Running(*usual, "-o", str(folder / "tools" / "first"), cwd=folder) as first:
        block = first.block("slew10", bus, "executive")
        second = pcpc(*usual, cwd=folder)
        said = f"already in use by process {first.pid('executive')}; end it first"
        assert second.code == Exit.ENVIRONMENT and said in second.err, str(second)
        assert len(second.err.splitlines()) == 1 and not second.out, str(second)
        assert first.process.poll() is None and not block.control.fault, str(first)
        assert block.alive(), "the first one is gone"
        first.process.send_signal(signal.SIGINT)
        assert first.done(20.0).code == Exit.INTERRUPTED, str(first)
        assert first.left() == [], first.left()
    assert blocks_left(bus) == [], blocks_left(bus)


def test_run_without_the_right_to_real_time_warns_and_goes_on(tmp_path: Path) -> None:
    """Without FIFO a busy machine may hold cycles: a patient rig at 50 Hz has no other verdict."""
    before = [*(NO_PRIVILEGE if os.geteuid() == 0 else ()), "prlimit", "--rtprio=0:0"]
    done = pcpc(
        "run",
        str(SLEW10),
        "--bus",
        own_bus(),
        "--json",
        "--quiet",
        "--no-figure",
        "-o",
        str(tmp_path / "run"),
        "--set",
        "duration_s=0.5",
        "--set",
        "rate_hz=50",
        *PATIENT,
        before=before,
    )
    assert done.ran and done.summary["realtime"] is False, str(done)
    (warning,) = done.err.splitlines()
    said = "plant and executive: not hard real time: SCHED_FIFO refused"
    assert warning.startswith(said) and "run as root, or add" in warning, warning

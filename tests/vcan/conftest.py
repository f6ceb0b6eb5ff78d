"""Runs of one rig on a real vcan0, each made once: a node starts slowly in an emulated machine.

    simulated   virtual time, no bus: what lockstep must equal; or --simulated DIR
    lockstep    `pcpc run --pacing lockstep` beside candump and python-can
    real        `pcpc run --pacing real --bus auto`, corrupt frames put in between
    sync        two `pcpc run --only executive` at once and one `--only plant`, --pacing sync
    vcan7       `pcpc run --only executive` on an interface that does not exist

Nothing is judged here.
"""

import itertools
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from live import (
    CMD,
    DBC,
    FB_A,
    N_CORRUPT,
    N_HEARD,
    RIG,
    Command,
    Done,
    Observed,
    Pair,
    candump_into,
    cansend,
    heard,
    python_can,
    until,
)

HELD = "require=[{always: time.t_s >= 0}]"  # for the rig's own limits these runs are too short
ONE_SECOND = "duration_s=1.0", HELD
# An emulated processor is 50 times slower, and on a busy host it stalls for 0.1 s and more: 40 ms a
# cycle, 0.8 s of held input and coarse integration leave room; the gains go with that rate.
SLOW = (
    HELD, "rate_hz=25", "duration_s=5.0", "barrel.integrator_hz=2000", "supervisor.hold_cycles=20",
    "supervisor.fault_after_cycles=40", "controller.kv_Nms_rad=20", "controller.lam_per_s=2",
    "controller.km_Nms_rad=0",
)  # fmt: skip


def pytest_addoption(parser: pytest.Parser) -> None:
    about = " ".join(f"--set '{setting}'" for setting in ONE_SECOND)
    parser.addoption("--simulated", metavar="DIR", help=f"folder of: pcpc simulate {RIG} {about}")


@pytest.fixture(scope="session")
def simulated(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the run folder of the simulation."""
    made = request.config.getoption("--simulated", default=None)
    if made is not None:
        return Path(made)
    done = Command(tmp_path_factory.mktemp("simulated") / "run", "simulate", ONE_SECOND).done()
    assert done.code == 0, f"{done}"
    return done.folder


@pytest.fixture(scope="session")
def started_vcan7(tmp_path_factory: pytest.TempPathFactory) -> Command:
    """Return the command on vcan7, started beside the lockstep run, where time plays no part."""
    folder = tmp_path_factory.mktemp("vcan7") / "run"
    only = "--only=executive"
    bus = "--bus", "socketcan:vcan7"
    return Command(folder, "run", ONE_SECOND, only, *bus, "--pacing", "lockstep")


@pytest.fixture(scope="session")
def lockstep(tmp_path_factory: pytest.TempPathFactory, started_vcan7: Command) -> Observed:
    folder = tmp_path_factory.mktemp("lockstep")
    options = ("--bus", "socketcan:vcan0", "--pacing", "lockstep")
    with candump_into(folder / "candump.log"), python_can(CMD, FB_A) as bus:
        command = Command(folder / "run", "run", ONE_SECOND, *options)
        first = list(itertools.islice(heard(bus, command), N_HEARD))
        done = command.done()
    return Observed(done, folder / "candump.log", first)


@pytest.fixture(scope="session")
def decoding(
    lockstep: Observed, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """Return cantools at work on candump's log beside the next run's start, and its output."""
    out = tmp_path_factory.mktemp("decoded") / "decoded.txt"
    command = [sys.executable, "-m", "cantools", "decode", "--single-line", str(DBC)]
    with (
        lockstep.candump.open() as stdin,
        out.open("w") as stdout,
        subprocess.Popen(command, stdin=stdin, stdout=stdout, text=True) as process,
    ):
        yield process, out
        process.kill()


@pytest.fixture(scope="session")
def vcan7(started_vcan7: Command, lockstep: Observed) -> Done:
    return started_vcan7.done()


@pytest.fixture(scope="session")
def real(
    tmp_path_factory: pytest.TempPathFactory, decoding: tuple[subprocess.Popen[str], Path]
) -> Done:
    """Return a run into which N_CORRUPT copies of a feedback frame with a wrong CRC were sent."""
    folder = tmp_path_factory.mktemp("real") / "run"
    with python_can(CMD, FB_A) as bus:
        settings = (*SLOW, f"errors.crc={N_CORRUPT}")
        command = Command(folder, "run", settings, "--bus", "auto", "--pacing", "real")
        latest = dict(itertools.islice(heard(bus, command), 40))  # of twenty cycles
        if command.running:
            good = latest[FB_A]
            for _ in range(N_CORRUPT):
                cansend(FB_A, good[:-1] + bytes([good[-1] ^ 0xFF]))
        return command.done()


@pytest.fixture(scope="session")
def sync(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """Return both executives, which ask for the rig at the same time, and the plant."""
    options = ("--bus", "vcan0", "--pacing", "sync")
    plant = Command(tmp_path_factory.mktemp("plant") / "run", "run", SLOW, "--only=plant", *options)
    folders = [tmp_path_factory.mktemp("exec") / "run" for _ in range(2)]
    both = [Command(folder, "run", SLOW, "--only=executive", *options) for folder in folders]
    until(lambda: not all(command.running for command in both), "one executive is refused")
    pids = [command.children[0] for command in both if command.running and command.children]
    first, second = sorted((command.done() for command in both), key=lambda done: done.code)
    return Pair(first, plant.done(), second, pids[0] if pids else 0)

"""The memory of real nodes under bad treatment: garbage, kills, no /dev/shm, a run of one cycle."""

import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import RIGS, Running, alive, blocks_left, own_bus, pcpc, until

from pcpc.drivers.compiled.structures import words_of
from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.requests import SLOTS
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

SLEW10 = str(RIGS / "slew10.yaml")
USUAL = ("--pacing", "lockstep", "--json", "--quiet", "--no-figure")
PATIENT = tuple(
    word
    for setting in ("duration_s=600", "rate_hz=200", "supervisor.fault_after_cycles=100000",
                    "supervisor.hold_cycles=100000")
    for word in ("--set", setting)
)  # fmt: skip
STATES = ("/state", "/plant/state")
READ_ONLY = ["unshare", "-m", "sh", "-c", 'mount -t tmpfs -o ro none /dev/shm && exec "$@"', "sh"]


def states(folder: Path) -> list[list[bytes]]:
    return [logs.payloads(folder / "log.mcap", topic) for topic in STATES]


def nonsense(block: sh.NodeMemory, random: np.random.Generator) -> None:
    """Write random words into the mailbox of a node, and what comes closer to a request."""
    for name in ("mail_index", "mail_value", "mail"):
        words = words_of(block[name]).view(np.uint8)
        words[:] = random.integers(0, 256, len(words), np.uint8)
    block["mail_index"][:] = random.integers(-2, 300, SLOTS)
    block["mail_index"][0] = 1  # supervisor.state: whatever else, it is no request to be granted
    block.mail.count = random.integers(1, 80)
    block.mail.lock = random.integers(0, 2)
    request = int(block.mail.request)
    while int(block.answer.request) != request and not block.control.done:
        assert block.alive(), "it died of it"  # what changes meanwhile is not judged
        os.sched_yield()


def test_garbage_in_the_mailbox_changes_no_bit_of_a_run(tmp_path: Path) -> None:
    bus, random = own_bus(), np.random.default_rng(26)
    long = ("--set", "duration_s=8.0")
    with Running("run", SLEW10, "-o", str(tmp_path / "run"), "--bus", bus, *USUAL, *long) as run:
        block = run.block("slew10", bus, "executive")
        plant = run.block("slew10", bus, "plant")
        while run.process.poll() is None and not block.control.done:
            nonsense(block, random)
            nonsense(plant, random)
        done = run.done()
    assert done.code == 0, str(done)
    simulate(load_rig(SLEW10, None, ["duration_s=8.0"]), tmp_path / "virtual.mcap")
    wanted = [logs.payloads(tmp_path / "virtual.mcap", topic) for topic in STATES]
    assert states(tmp_path / "run") == wanted, f"other bits\n{done}"
    events = logs.read(tmp_path / "run" / "log.mcap").node["executive"].events
    refused = [event for event in events if event["event"] == "refused"]
    assert len(refused) > 3, f"{len(refused)} refusals in the log: the garbage was not seen"
    assert {event.get("name") for event in refused} & {"supervisor.state"}, refused[:3]


def test_garbage_in_all_that_clients_write_neither_ends_a_node_nor_hangs_it(
    tmp_path: Path,
) -> None:
    bus, random = own_bus(), np.random.default_rng(27)
    words = ("run", SLEW10, "-o", str(tmp_path / "run"), "--bus", bus, *USUAL[2:], *PATIENT)
    with Running(*words) as run:
        block = run.in_the_middle("slew10", bus)
        fields = [words_of(block[name]).view(np.uint8) for name in sh.MAILBOX_FIELDS]
        first = int(block.control.cycle)
        for _ in range(2000):
            for words in fields:
                words[:] = random.integers(0, 256, len(words), np.uint8)
        seen = int(block.control.cycle)
        goes_on = lambda: int(block.control.cycle) > seen + 100 or run.over()  # noqa: E731
        until(goes_on, f"it goes on after cycle {first} to {seen}\n{run}")
        run.process.send_signal(signal.SIGINT)
        done = run.done(30.0)
        assert run.left() == [], run.left()
    assert done.code == 130 and not done.summary["faults"], str(done)


def test_a_run_of_one_cycle_is_in_the_log(tmp_path: Path) -> None:
    bus = own_bus()
    done = pcpc(
        "run",
        SLEW10,
        "-o",
        str(tmp_path / "run"),
        "--bus",
        bus,
        *USUAL,
        "--set",
        "duration_s=0.001",
    )
    assert done.code in (0, 1), str(done)
    assert [len(topic) for topic in states(tmp_path / "run")] == [1, 2], str(done)
    assert blocks_left(bus) == [], blocks_left(bus)


def test_nothing_is_left_when_everything_is_killed(tmp_path: Path) -> None:
    bus = own_bus()
    words = ("run", SLEW10, "-o", str(tmp_path / "run"), "--bus", bus, "--quiet", "--no-figure")
    with Running(*words, *PATIENT) as run:
        block = run.in_the_middle("slew10", bus)
        opened = _opened(run.pid("executive")) + _opened(run.pid("recorder"))
        assert not [path for path in opened if path.startswith("/dev/shm")], opened
        for pid in (run.process.pid, *run.children.values()):
            os.kill(pid, signal.SIGKILL)
        until(lambda: not any(map(alive, (run.process.pid, *run.children.values()))), "all dead")
        cycles = int(block.control.cycle)
        assert cycles > 50 and int(block.ends("record").head) > 50, "read after its death"
        assert not block.alive()
    assert blocks_left(bus) == [], blocks_left(bus)
    again = pcpc(
        *words[:3], str(tmp_path / "again"), *words[4:], *PATIENT, "--set", "duration_s=0.2"
    )
    assert again.code in (0, 1, 3), str(again)


def _opened(pid: int) -> list[str]:
    folder = Path(f"/proc/{pid}/fd")
    return [os.readlink(path) for path in folder.iterdir() if path.is_symlink()]


def test_a_read_only_dev_shm_does_not_matter(tmp_path: Path) -> None:
    works = subprocess.run([*READ_ONLY, "sh", "-c", "! touch /dev/shm/x"], capture_output=True)
    before = READ_ONLY if works.returncode == 0 else []  # as root only; else nothing is to be seen
    done = pcpc(
        "run",
        SLEW10,
        "-o",
        str(tmp_path / "run"),
        "--bus",
        own_bus(),
        *USUAL,
        "--set",
        "duration_s=0.2",
        before=before,
    )
    assert done.code in (0, 1), str(done)
    assert len(states(tmp_path / "run")[0]) == 200, str(done)


@pytest.mark.parametrize("role", ["executive", "plant"])
def test_get_set_list_and_lock_reach_both_nodes_of_a_run(role: str, tmp_path: Path) -> None:
    bus = own_bus()
    words = ("run", SLEW10, "-o", str(tmp_path / "run"), "--bus", bus, *USUAL)
    with Running(*words, "--set", "duration_s=3600") as run:
        run.in_the_middle("slew10", bus)
        node = run.block("slew10", bus, role).name

        def said(*command: str) -> Any:
            done = pcpc(*command, "--node", node, "--json")
            assert done.code == 0, str(done)
            return json.loads(done.out)

        rows = {row["name"]: row for row in said("get", "-l")}
        assert rows["health.requests_refused"]["value"] == 0.0, rows["health.requests_refused"]
        assert said("operate", "lock", "all") == {"lock": "all"}
        assert pcpc("set", "timing.reset=1", "--node", node).code == 2
        assert said("operate", "lock", "none") == {"lock": "none"}
        assert said("set", "timing.reset=1")["cycle"] > 0
        assert said("get", "health.requests_refused") == {"health.requests_refused": 0.0}

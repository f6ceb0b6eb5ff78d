"""The recorder as a process: when it ends and with what, late and dead nodes, full disks."""

import resource
import select
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import standing
from places import PATIENCE_S, ROOT
from rings import MONOTONIC_NS, TESTS, WIDE, block_of, put_cycle

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.loop import shared, sharing


def start(path: Path, *names: str) -> subprocess.Popen[str]:
    """Start a real recorder process and wait until it says that it is ready."""
    command = [sys.executable, "-m", "pcpc.executive.log.recorder", str(path), *names]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def end(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for a recorder; return its exit code and what it said on stderr."""
    _, errors = process.communicate(timeout=PATIENCE_S)
    return process.returncode, errors


def test_process_records_until_the_nodes_are_done_also_a_late_plant(
    block: shared.NodeMemory, name: str, tmp_path: Path
) -> None:
    process = start(tmp_path / "log.mcap", name, f"{name}-plant")
    process.send_signal(signal.SIGINT)  # the terminal's Ctrl-C must not end it
    for cycle in range(200):
        put_cycle(block, cycle, frames=1)
    plant = block_of(f"{name}-plant", "plant")
    for cycle in range(100):
        put_cycle(plant, cycle)
    plant.control.done = block.control.done = 1
    code, errors = end(process)
    assert (code, errors) == (0, ""), errors
    read = logs.read(tmp_path / "log.mcap")
    assert [len(node.cycle) for node in read.node.values()] == [200, 100]


def test_a_recorder_lets_the_executive_go_once_it_has_the_other_nodes(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """A run may be over when it comes: with the executive its host lets the plant go."""
    description = dict(block_of(name).description)
    standing.end_all()
    executive, plant = (sharing.ServedMemory(n, description) for n in (name, f"{name}-plant"))
    for served in (executive, plant):
        served.open()
        request.addfinalizer(served.close)
    words = [sys.executable, "-m", "pcpc.executive.log.recorder", str(tmp_path / "log.mcap")]
    process = subprocess.Popen([*words, name, f"{name}-plant"], cwd=ROOT)
    select.select(executive.sockets(), [], [])
    executive.serve()
    select.select(plant.sockets(), [], [])  # it asks for the plant
    executive.serve()
    assert sharing.RECORDER not in executive.told
    plant.serve()
    while sharing.RECORDER not in executive.told:
        select.select(executive.sockets(), [], [])
        executive.serve()
    while sharing.RECORDER not in plant.told:
        select.select(plant.sockets(), [], [])
        plant.serve()
    for served in (executive, plant):
        served.block.control.done = 1
    assert process.wait(PATIENCE_S) == 0


def test_process_ends_in_order_on_sigterm(
    block: shared.NodeMemory, name: str, tmp_path: Path
) -> None:
    process = start(tmp_path / "log.mcap", name)
    for cycle in range(200):
        put_cycle(block, cycle)
    process.terminate()
    code, errors = end(process)
    read = logs.read(tmp_path / "log.mcap")
    assert (code, errors, read.missing) == (0, "", []), errors
    assert len(read.node["executive"].cycle) == 200


NODE = """
import sys
sys.path[:0] = {tests!r}
from rings import block_of, put_cycle
put_cycle(block_of({name!r}), 0)
print("stands", flush=True)
sys.stdin.read()
"""


def test_process_takes_what_is_there_and_ends_when_its_node_was_killed(
    name: str, tmp_path: Path
) -> None:
    node = subprocess.Popen(
        [sys.executable, "-c", NODE.format(tests=TESTS, name=name)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert node.stdout is not None and node.stdout.readline() == "stands\n"
    process = start(tmp_path / "log.mcap", name)
    node.kill()
    code, errors = end(process)
    node.communicate()  # reaped only now
    assert (code, errors) == (0, ""), errors
    assert len(logs.read(tmp_path / "log.mcap").node["executive"].cycle) == 1


def test_late_node_that_ended_in_this_run_is_recorded(name: str, tmp_path: Path) -> None:
    block, plant = block_of(name), block_of(f"{name}-plant", "plant")
    plant.control.done = 1
    put_cycle(plant, 1)
    log = Recorder(tmp_path / "log.mcap", [block], late=[f"{name}-plant"])
    log.finish()
    assert logs.read(tmp_path / "log.mcap").node["plant"].cycle.tolist() == [1]


def test_late_node_that_an_earlier_run_is_leaving_is_not_recorded(
    name: str, tmp_path: Path
) -> None:
    block, old = block_of(name), block_of(f"{name}-plant", "plant")
    old.control.done = 1
    put_cycle(old, 1)
    old["record"][0, 1] = MONOTONIC_NS - 1  # before the executive came
    log = Recorder(tmp_path / "log.mcap", [block], late=[f"{name}-plant"])
    log.drain()
    assert len(log.nodes) == 1
    new = block_of(f"{name}-plant", "plant")
    put_cycle(new, 2)
    log.finish()
    assert logs.read(tmp_path / "log.mcap").node["plant"].cycle.tolist() == [2]


@pytest.mark.parametrize("garbage", [-1, 10**9, -(2**63), 2**63 - 1])
def test_what_others_write_into_the_taken_words_costs_no_record(
    block: shared.NodeMemory, tmp_path: Path, garbage: int
) -> None:
    for ring in shared.RINGS:
        block[f"{ring}_taken"][0] = garbage
    log = Recorder(tmp_path / "log.mcap", [block])
    for cycle in range(300):
        for ring in shared.RINGS:
            block[f"{ring}_taken"][0] = 0  # or the bench's own ring would be full
        put_cycle(block, cycle)
        if cycle % 100 == 99:
            for ring in shared.RINGS:
                block[f"{ring}_taken"][0] = garbage
            log.drain()
    words = [int(block[f"{ring}_taken"][0]) for ring in shared.RINGS]
    assert words == [300, 600, 0], f"{words}: a loop that waits would wait for ever"
    log.finish()
    assert logs.read(tmp_path / "log.mcap").node["executive"].cycle.tolist() == list(range(300))


def test_a_recorder_that_is_told_too_little_is_taken_has_what_is_left(
    block: shared.NodeMemory, tmp_path: Path
) -> None:
    count = len(block["record"])
    for cycle in range(count + 5):
        for ring in shared.RINGS:
            block[f"{ring}_taken"][0] = block.ends(ring).head  # or the ring would be full
        put_cycle(block, cycle)
    for ring in shared.RINGS:
        block[f"{ring}_taken"][0] = 0
    Recorder(tmp_path / "log.mcap", [block]).finish()
    cycles = logs.read(tmp_path / "log.mcap").node["executive"].cycle
    assert cycles.tolist() == list(range(5, count + 5)), "what was overwritten is not there twice"


def test_dropped_rows_make_the_process_end_with_loss(name: str, tmp_path: Path) -> None:
    block = block_of(name, states=WIDE)
    for cycle in range(len(block["record"]) + 4):
        put_cycle(block, cycle, frames=0)
    block.control.done = 1
    code, errors = end(start(tmp_path / "log.mcap", name))
    assert code == Exit.LOSS and "'executive.record': 4" in errors, errors


def run(path: Path, *names: str, file_bytes: int = -1) -> tuple[int, str]:
    """Run a recorder to its end, with a limit on the size of files; return exit code and stderr."""

    def limit() -> None:
        if file_bytes >= 0:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))

    command = [sys.executable, "-B", "-m", "pcpc.executive.log.recorder", str(path), *names]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE_S, preexec_fn=limit, cwd=ROOT
    )
    return done.returncode, done.stderr


def test_what_cannot_be_written_is_one_clear_line(
    block: shared.NodeMemory, name: str, tmp_path: Path
) -> None:
    block.control.done = 1
    for path, why, expected in (
        (tmp_path / "none" / "log.mcap", "No such file or directory", Exit.ENVIRONMENT),
        (Path("/dev/full"), "No space left on device", Exit.LOSS),
    ):
        code, errors = run(path, name)
        assert code == expected and errors.count("\n") == 1, errors
        assert str(path) in errors and why in errors, errors
    code, errors = run(tmp_path / "log.mcap", "test-recorder-nobody")
    assert code == Exit.ENVIRONMENT and "no such node is running" in errors, errors


def test_disk_that_fills_up_leaves_a_readable_log(name: str, tmp_path: Path) -> None:
    states = [f"x.{i}" for i in range(200)]
    block = block_of(name, states=states)
    noise = np.random.default_rng(1).standard_normal((2000, len(states))).view(np.int64)
    for cycle in range(2000):
        put_cycle(block, cycle, frames=0)
    block["record"][:2000, 3 : 3 + len(states)] = noise
    block.control.done = 1
    code, errors = run(tmp_path / "log.mcap", name, file_bytes=2_000_000)
    assert code == Exit.LOSS and errors.count("\n") == 1 and "File too large" in errors, errors
    log = logs.read(tmp_path / "log.mcap")
    count = len(log.node["executive"].cycle)
    assert 500 < count < 2000 and len(log.missing) == 1, f"{count} cycles; {log.missing}"


def test_recorder_process_does_not_load_the_compiler() -> None:
    code = "import pcpc.executive.log.recorder, sys; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "False\n", done.stdout + done.stderr

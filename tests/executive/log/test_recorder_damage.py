"""Logs that are cut, damaged or no logs at all: what is whole is read, the rest is named."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import standing
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from places import PATIENCE_S, ROOT
from rings import PERIOD_NS, TESTS, TIMINGS, block_of, put_cycle

from pcpc.executive.log import reader as logs
from pcpc.executive.log import recovery
from pcpc.executive.log.recorder import Recorder

KILLED = """
import os, signal, sys
from pathlib import Path
sys.path[:0] = {tests!r}
from rings import PERIOD_NS, block_of, put_cycle
from pcpc.executive.log.recorder import Recorder
block, now_ns = block_of({name!r}), 0
log = Recorder(Path({path!r}), [block], clock=lambda: now_ns)
for cycle in range(3700):
    now_ns = cycle * PERIOD_NS
    put_cycle(block, cycle)
    if cycle % 20 == 19:
        log.drain()
os.kill(os.getpid(), signal.SIGKILL)
"""


def killed_log(name: str, path: Path) -> None:
    """Record 3.7 s at 1 kHz on a virtual clock in a process that then kills itself."""
    code = KILLED.format(tests=TESTS, name=name, path=str(path))
    process = subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=PATIENCE_S)
    assert process.returncode == -signal.SIGKILL


def test_kill_9_costs_less_than_a_second_and_the_log_can_be_recovered(
    name: str, tmp_path: Path
) -> None:
    path, whole = tmp_path / "log.mcap", tmp_path / "whole.mcap"
    killed_log(name, path)
    log = logs.read(path)
    node = log.node["executive"]
    lost_ns = 3700 * PERIOD_NS - (int(node.cycle[-1]) + 1) * PERIOD_NS
    assert 0 <= lost_ns <= 1_000_000_000, f"{lost_ns / 1e9} s missing"
    assert np.array_equal(node.cycle, np.arange(len(node.cycle)))
    assert len(log.missing) == 1 and "nothing is readable after byte" in log.missing[0], log.missing
    assert node.description["rig"] == "bench" and log.attachments["rig.yaml"]
    recovery.recover(path, whole)
    assert logs.digest(path, "/state") == logs.digest(whole, "/state")
    assert logs.read(whole).missing == log.missing, "what is gone stays told"
    with whole.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        count = sum(1 for _ in reader.iter_decoded_messages("/state"))
    assert count == len(node.cycle), f"{count} of {len(node.cycle)} after recovery"


def test_what_is_no_log_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("rate_hz: 1000\n")
    (tmp_path / "empty").touch()
    with (tmp_path / "foreign").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    for file_name in ("text", "empty", "foreign", "none"):
        with pytest.raises(logs.LogError) as caught:
            logs.read(tmp_path / file_name)
        assert file_name in str(caught.value) and "\n" not in str(caught.value), str(caught.value)


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a good log of several chunks."""
    path = tmp_path_factory.mktemp("intact") / "log.mcap"
    block = block_of(f"test-intact-{os.getpid()}")
    now_ns = 0
    log = Recorder(path, [block], clock=lambda: now_ns)
    for cycle in range(1000):
        now_ns += PERIOD_NS
        put_cycle(block, cycle)
        if cycle % 50 == 0:
            log.drain()
    log.finish()
    standing.end_all()
    return path


def test_damaged_chunk_is_named_and_the_others_are_read(intact: Path, tmp_path: Path) -> None:
    whole = intact.read_bytes()
    place = whole.index(b"zstd") + 400
    (tmp_path / "log.mcap").write_bytes(whole[:place] + b"damage" + whole[place + 6 :])
    log = logs.read(tmp_path / "log.mcap")
    node = log.node["executive"]
    assert 0 < len(node.cycle) < 1000 and node.cycle[-1] == 999, f"{len(node.cycle)} cycles"
    lost = 1000 - len(node.cycle)
    assert "chunk at byte" in log.missing[0] and f"/state: {lost} of 1000 messages" in log.missing
    assert len(node.timing[TIMINGS[0]]) == len(node.cycle)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_no_damage_is_a_crash_neither_in_reading_nor_in_recovery(
    intact: Path, data: st.DataObject
) -> None:
    whole = intact.read_bytes()
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)) | st.just(len(whole)))])
    for _ in range(data.draw(st.integers(0, 3)) if damaged else 0):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = intact.with_name("damaged.mcap")
    path.write_bytes(damaged)
    try:
        log = logs.read(path)
        recovery.recover(path, intact.with_name("recovered.mcap"))
        recovered = logs.read(intact.with_name("recovered.mcap"))
        for name, node in log.node.items():
            assert np.array_equal(recovered.node[name].cycle, node.cycle), f"{log.missing}"
    except logs.LogError as error:
        assert "\n" not in str(error), f"{error}"

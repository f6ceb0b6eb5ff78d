"""What a recording of the page has lost is told, by the page and in the file."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import standing
from hosting import ANSWER_S
from scoped import ROWS, stepping

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes import live as nodes
from pcpc.tools.live.host.recordings import Recordings
from pcpc.tools.live.host.sources import LiveNode, RunSource


@pytest.fixture
def ended() -> Iterator[None]:
    yield
    standing.end_all()


@pytest.mark.usefixtures("ended")
@pytest.mark.parametrize("jump", [0, 300_000])
def test_rows_that_were_overwritten_before_they_were_recorded_stand_in_the_file(
    jump: int, tmp_path: Path
) -> None:
    name = f"recorded{jump}.{os.getpid()}.executive"
    block, go_on = stepping(name, jump)
    source = RunSource("stand", True, {"executive": LiveNode(nodes.find(name))}, 1)
    recordings = Recordings(tmp_path)
    file = Path(recordings.start(source)["file"])
    go_on(0.0)
    end_s = time.monotonic() + ANSWER_S
    while not (told := recordings.state() or {})["cycles"]:
        assert time.monotonic() < end_s, told
    recordings.stop()
    told = recordings.state() or {}
    lost = jump + ROWS - len(block["record"]) + 1 if jump else 0
    assert told["lost"] == lost, told
    assert told["cycles"] == jump + ROWS - lost, told
    assert logs.read(file).metadata["run"]["dropped.executive.record"] == str(lost)

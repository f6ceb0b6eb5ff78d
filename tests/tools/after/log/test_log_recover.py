"""`pcpc log recover`: what is readable becomes a whole file, and the damaged one stays as it is."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from logcommand import PLANT, barrel_log, run
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from pcpc.executive.log import reader as logs
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a log of 2,000 cycles as a recorder leaves it that is killed after 1,000 of them."""
    path = tmp_path_factory.mktemp("killed") / "log.mcap"
    rig = load_rig(PLANT / "rigs" / "slew10.yaml", "pd", ["duration_s=2.0"])
    run = VirtualRun(rig, path)
    assert isinstance(run.recorder, Recorder)
    next(run.advance())
    run.recorder.writer.flush()
    content = path.read_bytes()
    run.close()
    return content


def test_killed_log_becomes_one_that_every_reader_opens(killed: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "log.mcap", tmp_path / "log-recovered.mcap"
    path.write_bytes(killed)
    done = run("recover", path)
    assert done.code == 0 and "executive: 1000 cycles, 1 s" in done.out, done
    assert "nothing is readable after byte" in done.err and path.read_bytes() == killed
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        count = sum(1 for _ in reader.iter_decoded_messages("/state"))
    before, after = logs.read(path), logs.read(out)
    assert count == 1000 and after.missing == before.missing, f"{count} messages; {after.missing}"
    for name, node in before.node.items():
        for column, values in node.columns.items():
            new = after.node[name].columns[column]
            assert np.array_equal(values.view(np.int64), new.view(np.int64)), column
        assert np.array_equal(node.frames, after.node[name].frames)
    assert after.attachments == before.attachments
    assert "nothing is readable" in after.metadata["recovered"]["missing 1"]


def test_nothing_is_overwritten(killed: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "log.mcap", tmp_path / "precious.mcap"
    path.write_bytes(killed)
    out.write_bytes(b"precious")
    done = run("recover", path, "-o", out)
    assert done.code == 2 and out.read_bytes() == b"precious", done
    assert "exists" in done.err and done.err.count("\n") == 1, done.err
    assert run("recover", path, "-o", path).code == 2 and path.read_bytes() == killed


@pytest.mark.parametrize("size", [0, 100, 5000])
def test_log_of_which_nothing_is_left_gives_no_file(
    size: int, killed: bytes, tmp_path: Path
) -> None:
    (tmp_path / "log.mcap").write_bytes(killed[:size])
    done = run("recover", tmp_path / "log.mcap")
    assert done.code == 2 and done.err.count("\n") == 1, done
    assert os.listdir(tmp_path) == ["log.mcap"], f"{os.listdir(tmp_path)}"


def test_report_tells_what_was_kept(tmp_path: Path) -> None:
    done = run("recover", barrel_log("pd"), "-o", tmp_path / "new.mcap", "--json")
    report = json.loads(done.out)
    assert report["nodes"]["plant"] == {"cycles": 301, "seconds": 0.301}, f"{report}"
    assert report["missing"] == [] and report["messages"]["/can/frames"] > 1000


def test_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    done = run("recover", barrel_log("pd"), "-o", tmp_path / "none" / "new.mcap")
    assert done.code == 2 and done.err.count("\n") == 1, done
    assert str(tmp_path / "none" / "new.mcap") in done.err, done.err

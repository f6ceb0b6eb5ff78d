"""A rig whose nodes send multiplexed frames: on a bus, in virtual time, replayed, decoded, in C."""

from pathlib import Path

import cantools
import numpy as np
import pytest
from places import ROOT
from processes import pcpc

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

RIG = ROOT / "tests/rigs/multiplexed/rig.yaml"
STATUS = 0x130
STATES_OF = ("rx.STATUS.which", "rx.STATUS.always", "rx.STATUS.first", "rx.STATUS.second")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a virtual run."""
    path = tmp_path_factory.mktemp("run") / "log.mcap"
    simulate(load_rig(RIG), path)
    return path


def test_a_signal_keeps_its_value_in_frames_of_other_layouts(log: Path) -> None:
    node = logs.read(log).node["executive"]
    found = np.stack([node.columns[name] for name in STATES_OF], 1)
    rows = node.frames[node.frames["id"] == STATUS]
    message = cantools.database.load_file(RIG.with_name("probe.dbc")).get_message_by_name("STATUS")
    now, expected, layouts = [0.0] * 4, [], set()
    for row in rows:
        data = bytearray(row["data"][:8].tobytes())
        layouts.add(data[0] >> 4 & 3)
        unknown = data[0] >> 4 & 3 == 2
        data[0] &= 0x0F if unknown else 0xFF
        decoded = message.decode(bytes(data), decode_choices=False)
        assert isinstance(decoded, dict)
        decoded |= {"which": 2.0, "first": now[2]} if unknown else {}
        assert not unknown or not any(data[3:])
        now = [
            float(decoded.get(name.rsplit(".")[2], old))
            for name, old in zip(STATES_OF, now, strict=True)
        ]
        expected.append(now)
    assert layouts == {0, 1, 2} and len(rows) > 450
    last = found[-len(expected) :]
    assert np.array_equal(last, np.array(expected)[-len(last) :])
    assert abs(found[-1, 3] - 2.0 * found[-1, 1]) < 0.01, "settled, so both are of one sample"


def test_imported_frames_are_decoded_with_what_came_before(log: Path, tmp_path: Path) -> None:
    recording, read = tmp_path / "bus.log", tmp_path / "bus.mcap"
    dbc = ["--dbc", str(RIG.with_name("probe.dbc"))]
    for command in (
        ["export", str(log), "-o", str(recording)],
        ["import", str(recording), *dbc, "-o", str(read)],
    ):
        done = pcpc("log", *command)
        assert done.code == 0, str(done)
    (node,) = logs.read(read).node.values()
    first, second, which = (
        node.columns[f"rx.STATUS.{name}"] for name in ("first", "second", "which")
    )
    assert np.isnan(first).sum() == np.argmax(which == 0.0) > 0
    ours = logs.read(log).node["executive"].columns["rx.STATUS.second"]
    known = second[~np.isnan(second)]
    assert list(dict.fromkeys(known)) == [one for one in dict.fromkeys(ours) if one in set(known)]
    assert len(set(known)) > 20, "before it settles"


def test_lanes_say_that_they_cannot(tmp_path: Path) -> None:
    done = pcpc(
        "sweep", str(RIG), "--vary", "lag.tau_s=0.1:0.2", "--draws", "2", "-o", str(tmp_path / "s")
    )
    assert done.code == 0, str(done)
    assert "frame STATUS is multiplexed" in done.out + done.err, str(done)


def test_generated_c_has_its_digest(tmp_path: Path) -> None:
    done = pcpc("generate", "c", str(RIG), "-o", str(tmp_path / "c"), "--check")
    assert done.code == 0, str(done)

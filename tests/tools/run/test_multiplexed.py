"""A rig whose nodes send multiplexed frames: on a bus, in virtual time, replayed, decoded, in C."""

import shutil
from pathlib import Path

import cantools
import numpy as np
import pytest
from places import ROOT
from processes import own_bus, pcpc

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

PROBE = ROOT / "plants" / "probe"
STATUS = 0x130
DBC = (
    (
        "BO_ 1793 HB",
        """BO_ 304 STATUS: 8 PLANT
 SG_ which M : 4|2@1+ (1,0) [0|3] "" EXEC
 SG_ always : 8|16@1- (0.001,0) [-32|32] "" EXEC
 SG_ first m0 : 24|32@1- (1e-06,0) [-2000|2000] "" EXEC
 SG_ second m1 : 31|16@0- (0.001,0) [-32|32] "" EXEC

BO_ 1793 HB""",
    ),
    (
        'BA_ "GenMsgCycleTime" BO_ 1793 100;',
        'BA_ "GenMsgCycleTime" BO_ 304 1;\n'
        'BA_ "GenMsgSendType" BO_ 304 0;\nBA_ "GenMsgCycleTime" BO_ 1793 100;',
    ),
)
MODEL = (
    (
        '    position = port("", "the sample", low=-2000.0, high=2000.0)\n',
        '    position = port("", "the sample", low=-2000.0, high=2000.0)\n'
        '    which = port("", "layout in turn")\n    twice = port("", "the sample, doubled")\n',
    ),
    (
        "    y.position = x.x\n",
        "    y.position = x.x\n"
        "    y.which = y.which + 1.0 if y.which < 2.0 else 0.0\n"
        "    y.twice = 2.0 * x.x\n",
    ),
)
RIG = (
    (
        "    FB.position: lag.position\n",
        "    FB.position: lag.position\n"
        "    STATUS.which: lag.which\n    STATUS.always: lag.position\n"
        "    STATUS.first: lag.twice\n    STATUS.second: lag.twice\n",
    ),
    ("position: rx.FB.position", "position: rx.STATUS.second"),
    ("duration_s: 10.0", "duration_s: 0.5"),
)
STATES_OF = ("rx.STATUS.which", "rx.STATUS.always", "rx.STATUS.first", "rx.STATUS.second")


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a probe whose law hears its sample in every third frame only."""
    folder = tmp_path_factory.mktemp("layouts") / "probe"
    folder.mkdir()
    shutil.copy(PROBE / "law.py", folder)
    for name, changes in (("probe.dbc", DBC), ("model.py", MODEL), ("rig.yaml", RIG)):
        text = (PROBE / name).read_text()
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (folder / name).write_text(text)
    return folder / "rig.yaml"


@pytest.fixture(scope="module")
def log(rig: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a virtual run."""
    path = tmp_path_factory.mktemp("run") / "log.mcap"
    simulate(load_rig(rig), path)
    return path


def test_a_signal_keeps_its_value_in_frames_of_other_layouts(log: Path, rig: Path) -> None:
    node = logs.read(log).node["executive"]
    found = np.stack([node.columns[name] for name in STATES_OF], 1)
    rows = node.frames[node.frames["id"] == STATUS]
    message = cantools.database.load_file(rig.with_name("probe.dbc")).get_message_by_name("STATUS")
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


def test_lockstep_on_a_bus_and_a_replay_have_the_bits_of_virtual_time(
    rig: Path, log: Path, tmp_path: Path
) -> None:
    words = ["--bus", own_bus(), "--pacing", "lockstep", "--quiet", "--no-figure"]
    done = pcpc("run", str(rig), "-o", str(tmp_path / "bus"), *words)
    assert done.code == 0, str(done)
    for command in (["verify", str(tmp_path / "bus"), str(log)], ["replay", str(log)]):
        done = pcpc(*command, "--quiet")
        assert done.code == 0, str(done)


def test_imported_frames_are_decoded_with_what_came_before(
    rig: Path, log: Path, tmp_path: Path
) -> None:
    recording, read = tmp_path / "bus.log", tmp_path / "bus.mcap"
    dbc = ["--dbc", str(rig.with_name("probe.dbc"))]
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


def test_lanes_say_that_they_cannot(rig: Path, tmp_path: Path) -> None:
    done = pcpc(
        "sweep", str(rig), "--vary", "lag.tau_s=0.1:0.2", "--draws", "2", "-o", str(tmp_path / "s")
    )
    assert done.code == 0, str(done)
    assert "frame STATUS is multiplexed" in done.out + done.err, str(done)


def test_generated_c_has_its_digest(rig: Path, tmp_path: Path) -> None:
    done = pcpc("generate", "c", str(rig), "-o", str(tmp_path / "c"), "--check")
    assert done.code == 0, str(done)

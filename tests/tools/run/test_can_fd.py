"""A rig on CAN FD from the DBC file to the log: its bits are those of its classic twin."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from fd_rig import PROBE, fd_rig
from free_bus import own_port
from processes import Done, pcpc

from pcpc.drivers.can import codec
from pcpc.drivers.can.bus import UDP_GROUP
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.compiled.rows import FrameRow
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.ring_layout import FRAME_WORDS, OfFrame
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.start import bus_load

BITRATES = "bus: {bitrate: 1000000, data_bitrate: 5000000}"
SYNC, CMD, FB, HB_EXEC = 0x80, 0xA0, 0x120, 0x701
KINDS = {SYNC: Flag.FD, CMD: Flag.FD | Flag.BRS, FB: Flag.FD | Flag.BRS, HB_EXEC: Flag.NONE}
LENGTHS = {SYNC: 2, CMD: 48, FB: 64, HB_EXEC: 1}
FAULTS = """faults:
  lost: {kind: loss, frame: FB, from: 0.1s, for: 0.1s, share: 0.1}
  bits: {kind: corruption, frame: CMD, from: 0.1s, for: 0.4s, share: 0.1, value: 3}
  data: {kind: masquerade, frame: FB, from: 0.2s, for: 0.3s, share: 0.1}
  size: {kind: length, frame: CMD, from: 0.2s, for: 0.1s, share: 0.2, value: 33}
  twice: {kind: repetition, frame: FB, from: 0.3s, for: 0.1s, share: 0.2}"""


def states(path: Path) -> dict[str, bytes]:
    """Return the bits of what the nodes computed."""
    log = logs.read(path)
    return {
        f"{role} {name}": values.tobytes()
        for role, node in log.node.items()
        for name, values in node.columns.items()
    }


def simulated(rig: Path, folder: Path, *settings: str) -> Path:
    folder.mkdir()
    simulate(load_rig(rig, None, settings), folder / "log.mcap")
    return folder / "log.mcap"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the rig, and the log of a virtual run."""
    folder = tmp_path_factory.mktemp("fd")
    rig = fd_rig(folder, BITRATES)
    return rig, simulated(rig, folder / "run")


def good(done: Done) -> Done:
    assert done.code == 0, str(done)
    return done


def test_it_computes_what_its_classic_twin_does(run: tuple[Path, Path], tmp_path: Path) -> None:
    twin = simulated(PROBE / "rig.yaml", tmp_path / "twin", "duration_s=0.6")
    assert states(run[1]) == states(twin)


def test_its_log_has_the_frames_with_their_kinds_and_lengths(run: tuple[Path, Path]) -> None:
    node = logs.read(run[1]).node["executive"]
    assert node.frames["data"].shape[1] == 64
    for number, flags in KINDS.items():
        rows = node.frames[node.frames["id"] == number]
        assert len(rows) and set(rows["flags"]) == {flags}, number
        assert set(rows["dlc"]) == {LENGTHS[number]}
        assert not rows["data"][:, LENGTHS[number] :].any()


def test_it_is_replayed_with_faults_of_its_frames(tmp_path: Path) -> None:
    log = simulated(fd_rig(tmp_path, FAULTS), tmp_path / "run")
    frames = logs.read(log).node["plant"].frames
    assert 48 in set(frames["dlc"][frames["e2e"] >= 16]), "a length of 33 is one of 48"
    good(pcpc("replay", str(log), "--quiet"))


@pytest.mark.parametrize("form", ["log", "blf", "asc"])
def test_what_is_exported_is_read_by_python_can(
    run: tuple[Path, Path], tmp_path: Path, form: str
) -> None:
    out = tmp_path / f"out.{form}"
    good(pcpc("log", "export", str(run[1]), "-o", str(out)))
    node = logs.read(run[1]).node["executive"]
    rows = node.frames[np.argsort(node.frames["stamp_ns"], kind="stable")]
    with can.LogReader(out) as reader:
        theirs = [told(message) for message in reader]
    ours = [
        (int(row["id"]), bool(row["flags"] & Flag.FD), bool(row["flags"] & Flag.BRS),
         row["data"][: row["dlc"]].tobytes())
        for row in rows
    ]  # fmt: skip
    assert theirs == ours and len(ours) > 1000


def told(message: can.Message) -> tuple[int, bool, bool, bytes]:
    number = message.arbitration_id
    return number, message.is_fd, message.bitrate_switch, bytes(message.data)


def test_cat_writes_it_as_candump_does(run: tuple[Path, Path]) -> None:
    lines = good(pcpc("log", "export", str(run[1]), "-o-", "--format", "candump")).out.splitlines()
    assert any(" 0A0##1" in line for line in lines) and any(" 080##0" in line for line in lines)


@pytest.mark.parametrize("row", ["classic", "fd", "brs"])
@pytest.mark.parametrize("flags", [0, 4, 5, 6, 7])
def test_a_frame_of_another_kind_has_a_wrong_length(row: str, flags: int) -> None:
    """It does not matter whether its sender is error passive, ESI."""
    frame: Any = np.zeros(72, np.uint8)
    frame[4], frame[5] = 8, flags
    rows = np.zeros(1, FrameRow.dtype)
    rows["fd_flags"] = wanted = {"classic": 0, "fd": 4, "brs": 5}[row]
    assert codec.length_of(frame, 0, rows) == (8 if flags & ~Flag.ESI == wanted else -1)


WRONG = {
    "47 bytes": (("BO_ 160 CMD: 48", "BO_ 160 CMD: 47"), "47 bytes; CAN FD has 48"),
    "50 bytes": (("BO_ 160 CMD: 48", "BO_ 160 CMD: 50"), "frame CMD: 50 bytes; CAN FD has 64"),
    "classic": (('BA_ "VFrameFormat" BO_ 160 14;\n', ""), "48 bytes need CAN FD; say VFrameFormat"),
    "9 bytes": ((" SG_ command : 300|32@1-", " SG_ command : 284|64@1-"), "64 bits lie in 9 bytes"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_dbc_file_that_cannot_be_is_one_line(
    name: str, refused: Callable[..., None], tmp_path: Path
) -> None:
    change, said = WRONG[name]
    refused(["check", fd_rig(tmp_path, changes=(change,))], said)


REFUSED = {
    "a data rate": ("bus probe_fd.yaml", "give bus.data_bitrate"),
    "a slow data rate": (
        "bus probe_fd.yaml --set bus.data_bitrate=500000",
        "data at 500 kbit/s is",
    ),
    "a load": (
        "run probe_fd.yaml --quiet --set bus.bitrate=1000000",
        "give the rig bus.data_bitrate",
    ),
    "a line": (
        "simulate probe_fd.yaml --quiet --set bus.emulate=1M",
        "CMD switches its bit rate; give",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_can_fd_yet_says_so(
    name: str, refused: Callable[..., None], tmp_path: Path
) -> None:
    fd_rig(tmp_path)
    refused(*REFUSED[name])


def test_the_bus_tells_what_fits(run: tuple[Path, Path]) -> None:
    """FB takes 169 us by `drivers.can.frame_bits`: 33 bits at 1 Mbit/s, 679 at 5 Mbit/s."""
    found = good(pcpc("bus", str(run[0]), "--json")).summary["buses"][0]
    row = next(one for one in found["frames"] if one["name"] == "FB")
    assert (found["data_bitrate"], row["transmission_us"]) == (5_000_000, pytest.approx(168.8))
    assert found["fits"] and found["load"] < 0.45


def test_the_load_of_its_log_is_that_of_both_bit_rates(run: tuple[Path, Path]) -> None:
    """At most, at 1 and 5 Mbit/s, by `drivers.can.frame_bits`; heartbeats apart."""
    node = logs.read(run[1]).node["executive"]
    counts = {number: int((node.frames["id"] == number).sum()) for number in KINDS}
    most = {SYNC: (87, 0), CMD: (33, 519), FB: (33, 679), HB_EXEC: (65, 0)}
    info = good(pcpc("log", "info", str(run[1]), "--json")).summary
    found = {int(row["id"], 16): row for row in info["frames"] if int(row["id"], 16) in KINDS}
    for number, (nominal, data) in most.items():
        assert found[number]["bits"] == counts[number] * (nominal + data), hex(number)
    counted = bus_load.FrameCounts(ring_rows(node.frames))
    wanted = sum(counts[number] * (a + b / 5) for number, (a, b) in most.items())
    beats = (node.frames["id"] == 0x702).sum()
    assert bus_load.bits(counted.seen, 0.2) == pytest.approx(wanted + 65 * beats)


def ring_rows(frames: Any) -> Any:
    """Return frames of a log as the rows of a node's ring."""
    rows = np.zeros((len(frames), FRAME_WORDS), np.int64)
    for name, place in (("id", 0), ("dlc", 32), ("direction", 40), ("e2e", 48), ("flags", 56)):
        rows[:, OfFrame.ABOUT] |= frames[name].astype(np.int64) << place
    return rows


@pytest.mark.parametrize("form", ["log", "blf", "asc"])
def test_a_recording_of_others_is_read_back(
    run: tuple[Path, Path], tmp_path: Path, form: str
) -> None:
    recording, back = tmp_path / f"r.{form}", tmp_path / "back.mcap"
    good(pcpc("log", "export", str(run[1]), "-o", str(recording)))
    dbc_file = str(run[0].with_suffix(".dbc"))
    good(pcpc("log", "import", str(recording), "--dbc", dbc_file, "-o", str(back)))
    ours, theirs = (logs.read(one).node["executive"].frames for one in (run[1], back))
    ours = ours[np.argsort(ours["stamp_ns"], kind="stable")]
    for name in ("id", "dlc", "flags", "data"):
        assert theirs[name].tobytes() == ours[name].tobytes(), name
    read = logs.read(back).node["executive"].columns["rx.FB.position"][-1]
    assert read == pytest.approx(
        logs.read(run[1]).node["plant"].columns["lag.position"][-1], abs=1e-6
    )


def test_it_is_played_to_others(run: tuple[Path, Path]) -> None:
    port = own_port(UDP_GROUP)  # on which python-can hears whoever else is there
    bus = f"udp_multicast:{UDP_GROUP}:{port}"
    with can.Bus(interface="udp_multicast", channel=UDP_GROUP, port=port) as ears:
        words = ["--bus", bus, "--only", "FB", "--duration", "0.1", "--quiet"]
        good(pcpc("play", str(run[1]), *words))
        heard = list(iter(lambda: ears.recv(0.2), None))
    frames = logs.read(run[1]).node["plant"].frames
    sent = frames[(frames["id"] == FB) & (frames["direction"] == 0)]
    assert [bytes(one.data) for one in heard] == [x["data"].tobytes() for x in sent[:100]]
    assert all(one.is_fd and one.bitrate_switch for one in heard)

"""`pcpc log import`: other people's recordings become logs; nothing is lost without a word."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest
from json_schemas import holds
from logcommand import DBC, Done, barrel_log, run
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from pcpc.executive.log import reader as logs

CAR = """VERSION ""
NS_ :
BS_:
BU_: ECU GATEWAY
BO_ 2147483939 ENGINE: 8 ECU
 SG_ speed : 7|16@0+ (0.25,-100) [0|16000] "rpm" GATEWAY
 SG_ torque : 16|12@1- (0.5,0) [-1024|1023.5] "N m" GATEWAY
 SG_ ratio : 32|32@1- (1,0) [-1000|1000] "" GATEWAY
BO_ 256 DOOR: 2 GATEWAY
 SG_ page M : 0|4@1+ (1,0) [0|15] "" ECU
 SG_ left m0 : 8|8@1+ (1,0) [0|255] "" ECU
 SG_ right m1 : 8|8@1+ (2,1) [0|511] "" ECU
BO_ 512 OTHER_CRC: 3 ECU
 SG_ level : 0|8@1+ (1,0) [0|255] "%" GATEWAY
 SG_ counter : 8|4@1+ (1,0) [0|15] "" GATEWAY
 SG_ crc : 16|8@1+ (1,0) [0|255] "" GATEWAY
SIG_VALTYPE_ 2147483939 ratio : 1;
"""
ENGINE = "00000123"


@pytest.fixture
def car(tmp_path: Path) -> Path:
    path = tmp_path / "car.dbc"
    path.write_text(CAR)
    return path


def imported(recording: Path, dbc: Path, *words: str) -> tuple[Done, logs.Log]:
    """Import a recording and read the log back; it is whole."""
    out = recording.with_suffix(".mcap")
    done = run("import", recording, "--dbc", dbc, "-o", out, *words)
    assert done.code == 0, done
    log = logs.read(out)
    assert not log.missing, log.missing
    return done, log


def candump(folder: Path, lines: Sequence[str]) -> Path:
    """Write lines `seconds id#data`, on can0 unless they name a channel."""
    path = folder / "drive.log"
    rows = [line.split() for line in lines]
    texts = [f"({row[0]}) {row[2] if len(row) > 2 else 'can0'} {row[1]}\n" for row in rows]
    path.write_text("".join(texts))
    return path


@pytest.mark.parametrize("suffix", [".log", ".blf", ".asc", ".mf4"])
def test_frames_come_back_from_an_export_bit_for_bit(suffix: str, tmp_path: Path) -> None:
    recording = tmp_path / f"own{suffix}"
    assert run("export", barrel_log(), "-o", recording).code == 0
    _, log = imported(recording, DBC)
    ours, theirs = logs.read(barrel_log()).node["executive"], log.node["executive"]
    for name in ("id", "dlc", "direction", "data", "e2e"):
        pair = [node.frames[name].reshape(len(node.frames), -1) for node in (ours, theirs)]
        differ = int((pair[0] != pair[1]).any(axis=1).sum())
        assert differ == 0, f"{name} differs in {differ} of {len(ours.frames)} frames"
    mine = np.diff(ours.frames["stamp_ns"])
    off = int(np.abs(np.diff(theirs.frames["stamp_ns"]) - mine).max())
    assert off <= (0 if suffix in (".blf", ".mf4") else 1000), f"an interval is off by {off} ns"


@pytest.mark.parametrize("node", [None, "EXEC"])
def test_signals_are_what_cantools_decodes(node: str | None, tmp_path: Path) -> None:
    recording = tmp_path / "own.log"
    assert run("export", barrel_log(), "-o", recording).code == 0
    _, log = imported(recording, DBC, *(["--node", node] if node else []))
    database, mine = cantools.database.load_file(DBC), log.node["executive"]
    assert isinstance(database, cantools.database.Database)
    latest: dict[str, float] = {}
    rows: list[dict[str, float]] = []
    clock = database.get_message_by_name(log.metadata["import"]["clock_frame"].strip('"')).frame_id
    for row in mine.frames:
        message = database.get_message_by_frame_id(int(row["id"]))
        found: Any = message.decode(row["data"][: row["dlc"]].tobytes(), decode_choices=False)
        side = "tx" if node in message.senders else "rx"
        latest |= {f"{side}.{message.name}.{name}": value for name, value in found.items()}
        if row["id"] == clock:
            rows.append(dict(latest))
    assert len(rows) == len(mine.cycle), f"{len(mine.cycle)} rows of {len(rows)}"
    assert len(mine.columns) > 30, sorted(mine.columns)
    for name, values in mine.columns.items():
        expected = np.array([row.get(name, np.nan) for row in rows], float)
        assert values.tobytes() == expected.tobytes(), name


def test_the_node_says_what_is_sent_and_what_received(tmp_path: Path) -> None:
    recording = candump(tmp_path, ["1.0 0A0#0000000000000000", "1.1 120#0000000000000000"])
    _, log = imported(recording, DBC, "--node", "PLANT")
    assert log.node["executive"].frames["direction"].tolist() == [1, 0]
    names = set(log.node["executive"].columns)
    assert {"rx.CMD.motor_torque", "tx.FB_A.encoder"} <= names, names


def test_stamps_keep_their_nanoseconds(car: Path, tmp_path: Path) -> None:
    stamps = ["1760000000.123456789", "1760000000.123456790", "1760000001.000000001"]
    recording = candump(tmp_path, [f"{s} {ENGINE}#0000000000000000" for s in stamps])
    _, log = imported(recording, car)
    expected = [int(s.replace(".", "")) for s in stamps]
    assert log.node["executive"].frames["stamp_ns"].tolist() == expected
    with recording.with_suffix(".mcap").open("rb") as file:
        times = [m.log_time for _, _, m in make_reader(file).iter_messages(["/state"])]
    assert times == expected, times


def test_blf_and_asc_keep_the_wall_time_of_their_start(car: Path, tmp_path: Path) -> None:
    for suffix, writer in ((".blf", can.BLFWriter), (".asc", can.ASCWriter)):
        path = tmp_path / f"drive{suffix}"
        with writer(path) as file:
            for at in (1_760_000_000.25, 1_760_000_000.75):
                file.on_message_received(
                    can.Message(timestamp=at, arbitration_id=0x123, data=bytes(8))
                )
        _, log = imported(path, car, "--force")
        stamps = log.node["executive"].frames["stamp_ns"].tolist()
        assert stamps == [1_760_000_000_250_000_000, 1_760_000_000_750_000_000], (suffix, stamps)


def test_what_the_tables_cannot_hold_goes_through_cantools(car: Path, tmp_path: Path) -> None:
    lines = ["1.0 100#0007", "1.1 00000123#0190F0FF0000C03F", "1.2 100#0109", "1.3 100#00FF"]
    _, log = imported(candump(tmp_path, lines), car)
    node = log.node["executive"]
    found = {name: values.tolist() for name, values in node.columns.items()}
    nan = pytest.approx(np.nan, nan_ok=True)
    assert found["rx.DOOR.left"] == [7.0, 7.0, 255.0], found
    assert found["rx.DOOR.right"] == [nan, 19.0, 19.0], found
    assert found["rx.ENGINE.speed"] == [nan, 0.0, 0.0], found
    assert found["rx.ENGINE.torque"] == [nan, -8.0, -8.0], found
    assert found["rx.ENGINE.ratio"] == [nan, 1.5, 1.5], found
    assert node.frames["id"].tolist() == [0x100, 1 << 31 | 0x123, 0x100, 0x100]
    assert logs.frame_names(log)[1 << 31 | 0x123] == "ENGINE"


def test_a_crc_of_another_kind_is_told_and_the_frame_decoded(car: Path, tmp_path: Path) -> None:
    lines = [f"{i}.0 200#{10 + i:02X}{i:02X}77" for i in range(4)]
    done, log = imported(candump(tmp_path, lines), car)
    assert log.node["executive"].columns["rx.OTHER_CRC.level"].tolist() == [10, 11, 12, 13]
    assert "CRC of another kind, not checked: OTHER_CRC" in done.out, done


def test_missing_and_corrupt_frames_are_counted(tmp_path: Path) -> None:
    recording = tmp_path / "own.log"
    assert run("export", barrel_log(), "-o", recording).code == 0
    lines = recording.read_text().splitlines(keepends=True)
    feedback = [i for i, line in enumerate(lines) if " 120#" in line]
    data = lines[feedback[50]].split("#")
    lines[feedback[50]] = f"{data[0]}#FF{data[1][2:]}"
    for i in (feedback[101], feedback[100]):
        del lines[i]
    recording.write_text("".join(lines))
    done, log = imported(recording, DBC, "--json")
    counts = holds("log import", done.out)
    assert (counts["lost"], counts["not_decoded"]) == (3, 1), counts
    values = log.node["executive"].columns["rx.FB_A.encoder"]
    assert abs(values).max() < 1.0, f"a corrupt encoder of {abs(values).max()} rad was decoded"


def test_everything_that_is_left_out_is_told(car: Path, tmp_path: Path) -> None:
    engine = f"{ENGINE}#0000000000000000"
    lines = [
        f"5.0 {engine}", f"4.0 {engine} can1", "5.1 20000004#0000000000000000",
        "5.2 200000AA#0000000000000000", "5.3 123#R", "5.4 123##100112233445566778899AABB",
        "5.5 7AB#01", "5.6 00000123#00",
    ]  # fmt: skip
    done, log = imported(candump(tmp_path, lines), car)
    for text in (
        "5 frames of 3 ids",
        "left out: 2 error, 1 remote frames",
        "kept as frames only: 0x123 (1), 0x7AB (1)",
        "kept as frames only: 1; wrong CRC",
        "stamped out of order, now sorted: 1 frames",
        "channels can0, can1 are merged",
    ):
        assert text in done.out, done
    assert log.node["executive"].frames["stamp_ns"].tolist() == [
        4_000_000_000, 5_000_000_000, 5_400_000_000, 5_500_000_000, 5_600_000_000,
    ]  # fmt: skip
    one = imported(candump(tmp_path, lines), car, "--force", "--channel", "can1")[1]
    assert len(one.node["executive"].frames) == 1


def test_the_log_is_one_that_mcap_readers_open(car: Path, tmp_path: Path) -> None:
    imported(candump(tmp_path, ["1.5 00000123#0190000000000000", "2.0 7FF#"]), car)
    with (tmp_path / "drive.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = {c.topic: m for _, c, _, m in reader.iter_decoded_messages()}
    assert decoded["/state"].rx_engine_speed == 0.0, decoded
    assert (decoded["/can/frames"].id, decoded["/can/frames"].dlc) == (0x7FF, 0), decoded


@pytest.mark.parametrize("rows", [4000, 8001])
def test_many_rows_are_cut_into_chunks_without_a_gap(rows: int, car: Path, tmp_path: Path) -> None:
    lines = [f"{i // 1000}.{i % 1000:03d} {ENGINE}#{i:016X}" for i in range(rows)]
    _, log = imported(candump(tmp_path, lines), car)
    node = log.node["executive"]
    assert node.cycle.tolist() == list(range(rows)) == node.frames["cycle"].tolist()
    numbers = node.frames["data"].copy().view(">u8")[:, 0].tolist()
    assert numbers == list(range(rows)), "frames are missing or out of order"
    assert log.metadata["executive"]["period_ns"] == "1000000"


def damaged(folder: Path, kind: str) -> Path:
    """Write a recording that is not whole."""
    recording = folder / f"bad.{kind.partition(' ')[2]}"
    if kind.startswith("cut"):
        assert run("export", barrel_log(), "-o", recording).code == 0
        recording.write_bytes(recording.read_bytes()[: 2 * recording.stat().st_size // 3 + 1])
        if recording.suffix == ".log":
            text = recording.read_text()
            recording.write_text(text[: text.rindex("#") - 2])
        if recording.suffix == ".asc":
            text = recording.read_text()
            recording.write_text(text[: text.rindex(" d 8") + 8])
    else:
        recording.write_bytes(b"\x00\xffnothing to be read here, not even once\n" * 20)
    return recording


@pytest.mark.parametrize("suffix", ["log", "blf", "asc"])
def test_of_a_cut_recording_all_before_the_cut_is_imported_and_the_loss_is_told(
    suffix: str, tmp_path: Path
) -> None:
    recording = damaged(tmp_path, f"cut {suffix}")
    done = run("import", recording, "--dbc", DBC, "-o", tmp_path / "o.mcap", "--quiet")
    assert done.code == 3 and done.err.count("\n") == 1 and str(recording) in done.err, done
    ours = logs.read(barrel_log()).node["executive"].frames
    theirs = logs.read(tmp_path / "o.mcap").node["executive"].frames
    assert 0 < len(theirs) < len(ours), done
    for name in ("id", "dlc", "data"):
        assert theirs[name].tolist() == ours[name][: len(theirs)].tolist(), name


@pytest.mark.parametrize(
    "kind",
    ["garbage log", "garbage blf", "garbage asc", "garbage db", "garbage trc", "garbage log.gz"],
)
def test_damaged_input_is_one_line_and_leaves_nothing(kind: str, tmp_path: Path) -> None:
    recording, out = damaged(tmp_path, kind), tmp_path / "out"
    out.mkdir()
    done = run("import", recording, "--dbc", DBC, "-o", out / "o.mcap")
    assert done.code == 2 and done.err.count("\n") == 1 and str(recording) in done.err, done
    assert not list(out.iterdir()), list(out.iterdir())

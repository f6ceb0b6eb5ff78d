"""`pcpc log export`: what other tools read is what the log holds."""

import csv
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from logcommand import barrel_log, run
from numpy.typing import NDArray
from pyarrow import parquet

from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import export, series

TYPES = {".log": can.CanutilsLogReader, ".blf": can.BLFReader, ".asc": can.ASCReader}
STEP_NS = {".log": 1000, ".blf": 1, ".asc": 1000}  # what a format resolves


@pytest.fixture(scope="module")
def log() -> logs.Log:
    return logs.read(barrel_log())


def wall_ns(log: logs.Log) -> NDArray[np.int64]:
    return log.node["executive"].frames["stamp_ns"] + series.wall_offset_ns(log, "executive")


def messages(path: Path) -> tuple[list[can.Message], list[int]]:
    """Return messages and their wall time, as far as a float64 keeps it: us, from BLF all ns."""
    as_dated = {"relative_timestamp": False} if path.suffix == ".asc" else {}
    reader: Any = TYPES[path.suffix](path, **as_dated)
    start_s, step = 0.0, 1e6
    if path.suffix == ".blf":
        start_s, reader.start_timestamp, step = reader.start_timestamp, 0.0, 1e9
    read = list(reader)
    whole_ns = round(start_s) * 10**9
    return read, [whole_ns + round(m.timestamp * step) * round(1e9 / step) for m in read]


@pytest.mark.parametrize("suffix", TYPES)
def test_python_can_reads_back_every_frame_bit_for_bit_and_in_order(
    log: logs.Log, suffix: str, tmp_path: Path
) -> None:
    done = run("export", log.path, "-o", tmp_path / f"frames{suffix}")
    assert done.code == 0, done
    read, stamps = messages(tmp_path / f"frames{suffix}")
    frames = log.node["executive"].frames
    ours = [(int(f["id"]), bool(f["direction"]), f["data"][: f["dlc"]].tobytes()) for f in frames]
    theirs = [(m.arbitration_id, m.is_rx, bytes(m.data)) for m in read]
    assert theirs == ours, f"{len(theirs)} of {len(ours)} frames"
    assert not any(m.is_extended_id for m in read), "an 11-bit id became a 29-bit one"
    off = np.abs(np.array(stamps) - wall_ns(log)).max()
    assert off <= STEP_NS[suffix] / 2, f"a stamp is off by {off} ns; {suffix} has {STEP_NS[suffix]}"


@pytest.mark.parametrize("suffix", TYPES)
def test_extended_ids_and_short_frames_stay_what_they_are(suffix: str, tmp_path: Path) -> None:
    frames = np.zeros(3, logs.FRAME)
    frames["id"], frames["dlc"] = (1 << 31 | 0x123, 0x123, 1 << 31 | 0x1FFFFFFF), (0, 1, 8)
    frames["stamp_ns"], frames["data"][2] = (0, 7_000_123, 1_999_999_999), range(8)
    log = fabricated(frames)
    job = export._Job(
        log,
        tmp_path / f"f{suffix}",
        export.FORMATS[suffix],
        None,
        (-np.inf, np.inf),
        export.Progress(quiet=True),
    )
    assert export._write_frames(job) == {"frames": 3}
    read, stamps = messages(job.path)
    found = [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in read]
    assert found == [(0x123, True, b""), (0x123, False, b"\0"), (0x1FFFFFFF, True, bytes(range(8)))]
    off = np.abs(np.array(stamps) - wall_ns(log)).max()
    assert off <= STEP_NS[suffix] / 2, f"a stamp is off by {off} ns"


def test_blf_keeps_every_nanosecond_of_an_hour(tmp_path: Path) -> None:
    frames = np.zeros(5000, logs.FRAME)
    frames["stamp_ns"] = np.sort(np.random.default_rng(1).integers(0, 3600 * 10**9, len(frames)))
    log = fabricated(frames)
    job = export._Job(
        log, tmp_path / "f.blf", "blf", None, (-np.inf, np.inf), export.Progress(quiet=True)
    )
    export._write_frames(job)
    _, stamps = messages(job.path)
    wrong = int((np.array(stamps) != wall_ns(log)).sum())
    assert wrong == 0, f"{wrong} of {len(stamps)} stamps are off"


def fabricated(frames: NDArray[Any]) -> logs.Log:
    """Return a log that holds nothing but these frames, from 999,999,999 ns after a second on."""
    facts = {"clock_wall_ns": str(1_760_000_000_999_999_999), "clock_monotonic_ns": "0"}
    none = np.empty(0, np.int64)
    node = logs.NodeLog(none, none, {}, {}, frames, [], [], {})
    return logs.Log(Path("made.mcap"), {"executive": node}, {}, {"executive": facts}, [])


def test_csv_holds_every_value_to_the_bit_with_its_unit(log: logs.Log, tmp_path: Path) -> None:
    done = run("export", log.path, "-o", tmp_path / "t.csv")
    assert done.code == 0, done
    with (tmp_path / "t.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    executive, plant = log.node["executive"], log.node["plant"]
    assert header[:3] == ["time_ns [ns]", "cycle [1]", "time.t_s [s]"], header[:3]
    assert len(rows) == len(executive.cycle), f"{len(rows)} rows"
    column = header.index("controller.e_rad [rad]")
    values = np.array([float(row[column]) for row in rows])
    assert values.tobytes() == executive.columns["controller.e_rad"].tobytes()
    column = header.index("plant.barrel.theta_rad [rad]")
    values = np.array([float(row[column]) for row in rows])
    same = np.searchsorted(plant.cycle, executive.cycle)
    assert values.tobytes() == plant.columns["barrel.theta_rad"][same].tobytes()


def test_parquet_holds_every_value_to_the_bit_with_unit_and_meaning(
    log: logs.Log, tmp_path: Path
) -> None:
    path = tmp_path / "t.parquet"
    done = run("export", log.path, "-o", path, "--topics", "/state", "/timing")
    assert done.code == 0, done
    table = parquet.read_table(path)
    executive = log.node["executive"]
    for name, values in (executive.columns | executive.timing).items():
        assert table[name].to_numpy().tobytes() == values.tobytes(), name
    about = table.schema.field("controller.e_rad").metadata
    assert about[b"unit"] == b"rad" and about[b"help"], about
    assert table.schema.metadata[b"executive.rig"] == b"slew10", table.schema.metadata


def test_start_and_end_cut_out_a_window(log: logs.Log, tmp_path: Path) -> None:
    window = ("--start", "100ms", "--end", "0.15")
    done = run("export", log.path, "-o", tmp_path / "t.csv", *window)
    assert f"{tmp_path}/t.csv: 50 rows" in done.out, done
    done = run("export", log.path, "-o", tmp_path / "t.log", *window)
    read, _ = messages(tmp_path / "t.log")
    span_s = read[-1].timestamp - read[0].timestamp
    assert span_s == pytest.approx(0.049, abs=1e-5), f"{span_s} s"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("-o", "{}/t.xyz"), "no known suffix; use .log, .blf"),
        (("-o", "{}/t.log", "--topics", "/can/frame"), "did you mean /can/frames?"),
        (("-o", "{}/t.csv", "--topics", "/states"), "did you mean /state?"),
        (("-o", "{}/t.log", "--start", "1d"), "1d: not a time"),
        (("-o", "{}/t.log", "--start", "100"), "see --topics, --start, --end"),
        (("-o", "{}/there.log"), "exists; choose another name, or overwrite it with --force"),
    ],
)
def test_wrong_input_is_one_line_and_writes_nothing(
    log: logs.Log, words: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    (tmp_path / "there.log").write_text("mine")
    done = run("export", log.path, *(word.format(tmp_path) for word in words))
    assert done.code == 2 and said in done.err and done.err.count("\n") == 1, done
    assert [p.name for p in tmp_path.iterdir()] == ["there.log"], list(tmp_path.iterdir())
    assert (tmp_path / "there.log").read_text() == "mine"


def test_force_overwrites(log: logs.Log, tmp_path: Path) -> None:
    (tmp_path / "there.log").write_text("mine")
    done = run("export", log.path, "-o", tmp_path / "there.log", "--force")
    assert done.code == 0 and len(messages(tmp_path / "there.log")[0]) > 1000, done


def test_a_cut_log_gives_what_is_left_and_exit_code_3(log: logs.Log, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.path.read_bytes()[:-1000])  # the index at the end
    done = run("export", cut, "-o", tmp_path / "t.log")
    assert done.code == 3 and str(cut) in done.err, done
    assert messages(tmp_path / "t.log")[0], done


def test_the_window_of_a_paced_plant_is_its_newest_record_not_from_the_future() -> None:
    def one(topic: str, time_ns: list[int]) -> series.Series:
        at = np.array(time_ns)
        return series.Series("v", "", "", topic, at, np.arange(len(at)), at.astype(float))

    rows = series.rows_of(one("/state", [10, 20, 30]), one("/plant/state", [11, 19, 31]), False)
    assert rows.tolist() == [-1, 1, 1], rows
